//! The journal of a store: the finished rows with their checksums, one JSON object per line.

use std::fs::{self, File, OpenOptions};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use crate::{Error, Result};

/// The beginning of the first line of every journal.
const FORMAT: &str = "{\"format\": \"voxflat rows 2\", ";

/// The line which records that all rows are finished and on the disk.
const COMPLETE: &str = "{\"complete\": true}";

#[derive(Debug, PartialEq)]
pub struct Entries {
    /// The checksum of each finished row.
    pub checksums: Vec<Option<u32>>,
    /// Whether the journal records that all rows are finished.
    pub complete: bool,
}

/// Returns the first line of a journal of these rows.
pub fn header(identity: &str, rows: usize, columns: usize) -> String {
    format!("{FORMAT}\"identity\": \"{identity}\", \"rows\": {rows}, \"columns\": {columns}}}")
}

/// Reads the journal at `path` for `rows` rows; returns nothing if there is no journal. Unreadable lines, such as a
/// truncated last line, are ignored: their rows are not finished.
/// Errors: [`Error::StoreForeign`] if it does not begin with `header`, [`Error::StoreFailed`].
pub fn read(path: &Path, header: &str, rows: usize) -> Result<Option<Entries>> {
    let bytes = match fs::read(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        result => result.map_err(Error::of_store("read", path))?,
    };
    let text = String::from_utf8_lossy(&bytes);
    let mut lines = text.lines();
    if lines.next() != Some(header) {
        return Err(Error::StoreForeign { path: path.display().to_string() });
    }
    let mut entries = Entries { checksums: vec![None; rows], complete: false };
    for line in lines {
        entries.complete |= line == COMPLETE;
        if let Some((row, checksum)) = entry(line)
            && let Some(place) = entries.checksums.get_mut(row)
        {
            *place = Some(checksum);
        }
    }
    Ok(Some(entries))
}

fn line(row: usize, checksum: u32) -> String {
    format!("{{\"row\": {row}, \"crc32\": \"{checksum:08x}\"}}\n")
}

fn entry(line: &str) -> Option<(usize, u32)> {
    let (row, checksum) = line.strip_prefix("{\"row\": ")?.strip_suffix("\"}")?.split_once(", \"crc32\": \"")?;
    Some((row.parse().ok()?, u32::from_str_radix(checksum, 16).ok()?))
}

#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    file: Mutex<File>,
}

impl Journal {
    /// Begins a journal with the known rows. It replaces an older journal once these are written.
    pub fn begin(path: PathBuf, header: &str, checksums: &[Option<u32>]) -> Result<Self> {
        let known = checksums.iter().enumerate().filter_map(|(row, known)| known.map(|sum| line(row, sum)));
        let text: String = std::iter::once(format!("{header}\n")).chain(known).collect();
        let beside = path.with_extension("new");
        let write = || {
            fs::write(&beside, text)?;
            OpenOptions::new().write(true).open(&beside)?.sync_all()?; // Windows cannot do so of a file to be read
            fs::rename(&beside, &path)?;
            OpenOptions::new().append(true).open(&path)
        };
        let file = Mutex::new(write().map_err(Error::of_store("write", &path))?);
        Ok(Self { path, file })
    }

    /// Enters a row whose values are written.
    pub fn add(&self, row: usize, checksum: u32) -> Result<()> {
        self.append(&line(row, checksum))
    }

    /// Enters that all rows are finished, once their values are on the disk.
    pub fn complete(&self) -> Result<()> {
        self.append(&format!("{COMPLETE}\n"))?;
        let file = self.file.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        file.sync_all().map_err(Error::of_store("write", &self.path))
    }

    fn append(&self, line: &str) -> Result<()> {
        let mut file = self.file.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        file.write_all(line.as_bytes()).map_err(Error::of_store("write", &self.path))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::tests::Folder;
    use proptest::prelude::*;

    fn header() -> String {
        super::header("12ab", 3, 7)
    }

    fn written(folder: &Folder) -> PathBuf {
        let path = folder.path().join("journal.jsonl");
        let journal = Journal::begin(path.clone(), &header(), &[None, Some(0xfe), None]).unwrap();
        journal.add(2, 77).unwrap();
        path
    }

    #[test]
    fn a_journal_says_what_was_entered() {
        let folder = Folder::new("journal");
        let path = folder.path().join("journal.jsonl");
        assert_eq!(read(&path, &header(), 3).unwrap(), None);
        written(&folder);
        let known = |complete| Some(Entries { checksums: vec![None, Some(0xfe), Some(77)], complete });
        assert_eq!(read(&path, &header(), 3).unwrap(), known(false));
        let journal = Journal::begin(path.clone(), &header(), &[None, Some(0xfe), Some(77)]).unwrap();
        journal.complete().unwrap();
        assert_eq!(read(&path, &header(), 3).unwrap(), known(true));
        assert!(matches!(read(&path, &super::header("12ab", 4, 7), 3), Err(Error::StoreForeign { .. })));
    }

    #[test]
    fn a_torn_line_says_nothing() {
        let folder = Folder::new("torn");
        let path = written(&folder);
        let whole = fs::read(&path).unwrap();
        let last = whole.len() - line(2, 77).len();
        for length in last..whole.len() - 1 {
            fs::write(&path, &whole[..length]).unwrap();
            assert_eq!(read(&path, &header(), 3).unwrap().unwrap().checksums, [None, Some(0xfe), None], "{length}");
        }
        fs::write(&path, &whole[..whole.len() - 1]).unwrap(); // only the end of the line is missing
        assert_eq!(read(&path, &header(), 3).unwrap().unwrap().checksums[2], Some(77));
    }

    proptest! {
        #[test]
        fn garbage_never_fails_nor_hides_other_lines(garbage in prop::collection::vec(any::<u8>(), 0..200)) {
            let folder = Folder::new("garbage");
            let path = written(&folder);
            let mut bytes = fs::read(&path).unwrap();
            bytes.extend(garbage);
            bytes.extend(format!("\n{}", line(0, 5)).bytes());
            fs::write(&path, bytes).unwrap();
            prop_assert_eq!(read(&path, &header(), 3).unwrap().unwrap().checksums[0], Some(5));
        }
    }
}
