//! A table of f32 on disk, in the format of `numpy.save`: little-endian, row by row, after a header of version 1.0.

use std::fs::{File, OpenOptions};
use std::io::{ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use crate::{Control, Error, Result};

pub const VALUE: usize = size_of::<f32>();

/// The number of bytes that are transferred between two checks for cancellation.
pub const CHUNK: usize = 1 << 20;

/// A file of `rows` × `columns` values. Each call opens it again, so that threads do not share a file position.
#[derive(Debug)]
pub struct NpyFile {
    path: PathBuf,
    header: Vec<u8>,
    rows: usize,
    columns: usize,
}

impl NpyFile {
    /// Describes the table of this shape at `path`, which need not exist.
    pub fn new(path: PathBuf, rows: usize, columns: usize) -> Self {
        Self { path, header: header(rows, columns), rows, columns }
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes the header and sets the length of the file where they are missing; existing values remain.
    pub fn allocate(&self) -> Result<()> {
        let write = || {
            let mut file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&self.path)?;
            let mut found = vec![0; self.header.len()];
            match file.read_exact(&mut found) {
                Err(error) if error.kind() != ErrorKind::UnexpectedEof => return Err(error),
                _ if found == self.header => {}
                _ => {
                    file.rewind()?;
                    file.write_all(&self.header)?;
                }
            }
            let length = self.offset(self.rows);
            if file.metadata()?.len() != length { file.set_len(length) } else { Ok(()) }
        };
        write().map_err(Error::of_store("write", &self.path))
    }

    /// Writes a row, and returns its checksum.
    pub fn write(&self, row: usize, values: &[f32], control: &Control) -> Result<u32> {
        let failed = || Error::of_store("write", &self.path);
        let mut file = OpenOptions::new().write(true).open(&self.path).map_err(failed())?;
        file.seek(SeekFrom::Start(self.offset(row))).map_err(failed())?;
        let mut hasher = crc32fast::Hasher::new();
        let mut bytes = Vec::with_capacity(CHUNK.min(values.len() * VALUE));
        for chunk in values.chunks(CHUNK / VALUE) {
            control.check()?;
            bytes.clear();
            bytes.extend(chunk.iter().flat_map(|value| value.to_le_bytes()));
            hasher.update(&bytes);
            file.write_all(&bytes).map_err(failed())?;
        }
        Ok(hasher.finalize())
    }

    /// Reads a row, and returns its checksum.
    pub fn read(&self, row: usize, values: &mut [f32], control: &Control) -> Result<u32> {
        let mut places = values.iter_mut();
        self.pass(row, control, |bytes| {
            for (value, place) in bytes.chunks_exact(VALUE).zip(&mut places) {
                *place = f32::from_le_bytes([value[0], value[1], value[2], value[3]]);
            }
        })
    }

    pub fn checksum(&self, row: usize, control: &Control) -> Result<u32> {
        self.pass(row, control, |_| ())
    }

    /// Waits until all written data are on the disk.
    pub fn sync(&self) -> Result<()> {
        let sync = || OpenOptions::new().write(true).open(&self.path)?.sync_all();
        sync().map_err(Error::of_store("write", &self.path))
    }

    /// Passes the bytes of a row to `visit`, in pieces, and returns their checksum.
    fn pass(&self, row: usize, control: &Control, mut visit: impl FnMut(&[u8])) -> Result<u32> {
        let failed = || Error::of_store("read", &self.path);
        let mut file = File::open(&self.path).map_err(failed())?;
        file.seek(SeekFrom::Start(self.offset(row))).map_err(failed())?;
        let mut hasher = crc32fast::Hasher::new();
        let mut left = self.columns * VALUE;
        let mut bytes = vec![0; CHUNK.min(left)];
        while left > 0 {
            control.check()?;
            let piece = &mut bytes[..CHUNK.min(left)];
            file.read_exact(piece).map_err(failed())?;
            hasher.update(piece);
            visit(piece);
            left -= piece.len();
        }
        Ok(hasher.finalize())
    }

    fn offset(&self, row: usize) -> u64 {
        self.header.len() as u64 + (row * self.columns) as u64 * VALUE as u64
    }
}

/// Returns the header of NumPy's format 1.0. Values begin at a multiple of 64 bytes.
fn header(rows: usize, columns: usize) -> Vec<u8> {
    let mut text = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({rows}, {columns}), }}");
    let prefix = 10; // magic, version, length
    let end = (prefix + text.len() + 1).next_multiple_of(64);
    text.push_str(&" ".repeat(end - prefix - text.len() - 1));
    text.push('\n');
    let mut header = b"\x93NUMPY\x01\x00".to_vec();
    header.extend((text.len() as u16).to_le_bytes()); // far below 65536
    header.extend(text.bytes());
    header
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::tests::Folder;

    #[test]
    fn what_was_written_is_read_again() {
        let folder = Folder::new("table");
        let columns = CHUNK / VALUE + 7; // rows that are no whole number of chunks
        let table = NpyFile::new(folder.path().join("rows.npy"), 3, columns);
        table.allocate().unwrap();
        let rows: Vec<Vec<f32>> = [3.0, 7.0].map(|by| (0..columns).map(|n| n as f32 / by).collect()).into();
        let control = Control::default();
        for (number, values) in (1..).zip(&rows) {
            let written = table.write(number, values, &control).unwrap();
            let mut again = vec![0.0; columns];
            assert_eq!(table.read(number, &mut again, &control).unwrap(), written);
            assert_eq!(table.checksum(number, &control).unwrap(), written);
            assert!(again == *values);
        }
        let mut first = vec![9.0; columns];
        table.read(0, &mut first, &control).unwrap();
        assert!(first.iter().all(|&value| value == 0.0));
    }

    #[test]
    fn a_truncated_table_gets_its_length_again() {
        let folder = Folder::new("truncated");
        let path = folder.path().join("rows.npy");
        let table = NpyFile::new(path.clone(), 2, 5);
        let control = Control::default();
        table.allocate().unwrap();
        assert_eq!(table.write(0, &[1.0; 5], &control), table.write(1, &[1.0; 5], &control));
        OpenOptions::new().write(true).open(&path).unwrap().set_len(128 + 20 + 8).unwrap();
        table.allocate().unwrap();
        let mut values = [9.0; 5];
        table.read(1, &mut values, &control).unwrap();
        assert_eq!(values, [1.0, 1.0, 0.0, 0.0, 0.0]);
    }
}
