//! Distance rows on disk: computed out of core, resumable, and checked.
//!
//! A store is a directory with a table of all rows, `rows.npy`, and a journal, `journal.jsonl`. Rows are computed in
//! bundles, each in the memory of one thread. A row is first written to its place in the table; then its checksum is
//! added to the journal. When a store is opened again, every row in the journal is read, and rows that do not match
//! their checksum are computed again. Therefore the order of writes to the disk does not matter: after a crash, only
//! rows that are stored as they were computed count. When all rows are finished, the table is synchronised with the
//! disk, and then the journal records that the store is complete.
//!
//! The values depend only on the solver and the sources. Threads and interruptions do not change a bit.

mod journal;
mod npy;

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read, Write};
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use rayon::prelude::*;

use crate::error::check_points;
use crate::geodesic::Solver;
use crate::geodesic::bundle::{BundleScratch, MOST_SOURCES};
use crate::parallel::in_turn;
use crate::rows::{Rows, fill};
use crate::{Control, Error, Result};
use journal::Journal;
use npy::{CHUNK, NpyFile, VALUE};

/// The names of the files in a store.
const TABLE: &str = "rows.npy";
const JOURNAL: &str = "journal.jsonl";

/// How long to wait for a lock. Cancelled work releases it within this time.
const PATIENCE: Duration = Duration::from_millis(500);

/// Returns the maximum memory in bytes for computing a store: a bundle of rows, a buffer and a solver per thread.
pub fn memory_need(columns: usize, rows: usize, threads: usize) -> u64 {
    let height = MOST_SOURCES.min(rows.div_ceil(threads.max(1)));
    let at_once = threads.min(rows) as u64;
    at_once * (CHUNK as u64 + (height * columns * VALUE) as u64 + BundleScratch::memory_need(columns))
}

/// The contents of a store when it was opened.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Found {
    /// The number of finished rows that match their checksum.
    pub rows: usize,
    /// The number of rows that do not match their checksum.
    pub damaged: usize,
}

/// All rows from some sources, on disk. No other process can compute them during the lifetime of this value.
#[derive(Debug)]
pub struct Store {
    table: NpyFile,
    sources: Vec<u32>,
    columns: usize,
    checksums: Vec<u32>,
    found: Found,
    _lock: File,
}

impl Store {
    /// Computes the rows from `sources` that the store does not contain yet.
    ///
    /// The directory must exist; if it is empty, a store is created. `identity` identifies the surface and the
    /// distances (a hash of letters and digits); a store with another identity is refused.
    ///
    /// # Errors
    /// [`Error::NoSuchPoint`]; [`Error::StoreInUse`], [`Error::StoreForeign`], [`Error::StoreFailed`];
    /// [`Error::Unreachable`] if a vertex lies in another component; and [`Error::Cancelled`]. Finished rows are kept
    /// in every case.
    pub fn compute<S: Solver>(
        directory: &Path, identity: &str, solver: &S, sources: &[u32], control: &Control,
    ) -> Result<Self> {
        let columns = solver.columns();
        check_points(sources.iter().copied(), columns)?;
        let Opened { lock, table, journal, found, sound } = open(directory, identity, sources.len(), columns, control)?;
        let checksums = match journal {
            None => sound,
            Some(journal) => {
                let all: Vec<u32> = (0..sources.len() as u32).collect();
                let checksums = compute_missing(&table, &journal, sound, &all, solver, sources, control)?;
                table.sync()?;
                journal.complete()?;
                checksums
            }
        };
        let checksums = checksums.into_iter().flatten().collect();
        Ok(Self { table, sources: sources.to_vec(), columns, checksums, found, _lock: lock })
    }

    /// Creates a store whose rows other processes compute, or opens an existing one.
    ///
    /// # Errors
    /// [`Error::StoreInUse`], [`Error::StoreForeign`], [`Error::StoreFailed`], and [`Error::Cancelled`].
    pub fn create(directory: &Path, identity: &str, rows: usize, columns: usize, control: &Control) -> Result<Found> {
        Ok(open(directory, identity, rows, columns, control)?.found)
    }

    /// Computes some rows, given by their numbers, of a store that another process created with
    /// [`create`](Self::create). They are entered in a separate journal in the directory `part`, which must exist.
    /// Rows in that journal are not computed again.
    ///
    /// # Errors
    /// Those of [`Store::compute`]; [`Error::StoreFailed`] if the table does not exist.
    pub fn compute_part<S: Solver>(
        directory: &Path, part: &Path, identity: &str, solver: &S, sources: &[u32], rows: &[u32], control: &Control,
    ) -> Result<()> {
        check_points(sources.iter().copied(), solver.columns())?;
        check_points(rows.iter().copied(), sources.len())?;
        let _lock = lock(part, control)?;
        let header = journal::header(identity, sources.len(), solver.columns());
        let path = part.join(JOURNAL);
        let known = journal::read(&path, &header, sources.len())?.map_or(vec![None; sources.len()], |e| e.checksums);
        let table = NpyFile::new(directory.join(TABLE), sources.len(), solver.columns());
        let sound = verify(&table, &known, control)?;
        let journal = Journal::begin(path, &header, &sound)?;
        compute_missing(&table, &journal, sound, rows, solver, sources, control)?;
        table.sync()
    }

    /// Returns the contents of the store when it was opened.
    pub fn found(&self) -> Found {
        self.found
    }
}

/// Reads rows of a store's table, and returns the numbers of those that do not match a known checksum.
///
/// # Errors
/// [`Error::StoreFailed`] if the table cannot be read, and [`Error::Cancelled`].
pub fn damaged_rows(directory: &Path, columns: usize, known: &[Option<u32>], control: &Control) -> Result<Vec<usize>> {
    let sound = verify(&NpyFile::new(directory.join(TABLE), known.len(), columns), known, control)?;
    Ok((0..known.len()).filter(|&row| sound[row] != known[row]).collect())
}

impl Rows for Store {
    fn sources(&self) -> &[u32] {
        &self.sources
    }

    fn columns(&self) -> usize {
        self.columns
    }

    /// Reads a few rows at a time, and compares checksums.
    fn visit(&self, control: &Control, visit: &mut dyn FnMut(usize, &[f32]) -> Result<()>) -> Result<()> {
        let mut rows = vec![0.0; MOST_SOURCES.min(self.sources.len()) * self.columns];
        for (n, checksums) in self.checksums.chunks(MOST_SOURCES).enumerate() {
            let first = n * MOST_SOURCES;
            let rows = &mut rows[..checksums.len() * self.columns];
            for ((number, &checksum), row) in (first..).zip(checksums).zip(rows.chunks_mut(self.columns.max(1))) {
                if self.table.read(number, row, control)? != checksum {
                    return Err(Error::StoreDamaged { path: self.table.path().display().to_string(), row: number });
                }
            }
            visit(first, rows)?;
        }
        Ok(())
    }
}

/// A store and its contents.
struct Opened {
    lock: File,
    table: NpyFile,
    /// The journal for new rows; none if all rows are finished.
    journal: Option<Journal>,
    found: Found,
    /// The checksum of each row that matches it.
    sound: Vec<Option<u32>>,
}

/// Opens or creates a store, and reads all of its contents.
fn open(directory: &Path, identity: &str, rows: usize, columns: usize, control: &Control) -> Result<Opened> {
    let lock = lock(directory, control)?;
    let header = journal::header(identity, rows, columns);
    let path = directory.join(JOURNAL);
    let entries = journal::read(&path, &header, rows)?;
    let table = NpyFile::new(directory.join(TABLE), rows, columns);
    table.allocate()?;
    let (known, is_complete) = entries.map_or((vec![None; rows], false), |e| (e.checksums, e.complete));
    let sound = verify(&table, &known, control)?;
    let is_there = sound.iter().flatten().count();
    let found = Found { rows: is_there, damaged: known.iter().flatten().count() - is_there };
    let journal = if is_complete && is_there == rows { None } else { Some(Journal::begin(path, &header, &sound)?) };
    Ok(Opened { lock, table, journal, found, sound })
}

/// Returns the known checksums of the rows that match them.
fn verify(table: &NpyFile, known: &[Option<u32>], control: &Control) -> Result<Vec<Option<u32>>> {
    control.begin("checking the store", known.iter().flatten().count() as u64);
    let agrees = |(row, checksum): (usize, &Option<u32>)| {
        let Some(checksum) = *checksum else { return Ok(None) };
        let is_sound = table.checksum(row, control)? == checksum;
        control.advance();
        Ok(is_sound.then_some(checksum))
    };
    known.par_iter().enumerate().map(agrees).collect()
}

/// Computes and writes the rows without a checksum, and returns all checksums.
fn compute_missing<S: Solver>(
    table: &NpyFile, journal: &Journal, mut checksums: Vec<Option<u32>>, rows: &[u32], solver: &S, sources: &[u32],
    control: &Control,
) -> Result<Vec<Option<u32>>> {
    let missing: Vec<usize> = rows.iter().map(|&row| row as usize).filter(|&row| checksums[row].is_none()).collect();
    let from: Vec<u32> = missing.iter().map(|&row| sources[row]).collect();
    control.begin("measuring distances", missing.len() as u64);
    let bundles = solver.bundles(&from, rayon::current_num_threads(), control)?;
    let columns = solver.columns();
    let known = Mutex::new(&mut checksums);
    let compute = |(scratch, data): &mut (S::Scratch, Vec<f32>), bundle: Vec<u32>| {
        data.resize(bundle.len() * columns, 0.0);
        let mut rows: Vec<&mut [f32]> = data.chunks_exact_mut(columns.max(1)).collect();
        fill(solver, &from, &bundle, None, &mut rows, scratch, control)?;
        for (number, values) in bundle.into_iter().zip(rows) {
            let row = missing[number as usize];
            let checksum = table.write(row, values, control)?;
            journal.add(row, checksum)?;
            known.lock().unwrap_or_else(PoisonError::into_inner)[row] = Some(checksum);
        }
        Ok(())
    };
    in_turn(bundles.into_iter(), || (solver.scratch(), Vec::new()), compute)?;
    Ok(checksums)
}

/// Locks a store. The operating system releases the lock when the holding process ends for any reason. The lock file
/// holds the process number of its holder, for messages.
fn lock(directory: &Path, control: &Control) -> Result<File> {
    let path = directory.join("lock");
    let failed = || Error::of_store("write", &path);
    let open = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&path);
    let mut file = open.map_err(failed())?;
    let start = Instant::now();
    loop {
        control.check()?;
        match file.try_lock() {
            Ok(()) => break,
            Err(TryLockError::Error(error)) => return Err(Error::of_store("lock", &path)(error)),
            Err(TryLockError::WouldBlock) if start.elapsed() > PATIENCE => {
                let mut holder = String::new();
                let known = file.read_to_string(&mut holder).is_ok_and(|read| read > 0);
                let holder = if known { format!("process {}", holder.trim()) } else { "another process".into() };
                return Err(Error::StoreInUse { path: directory.display().to_string(), holder });
            }
            Err(TryLockError::WouldBlock) => std::thread::sleep(Duration::from_millis(5)),
        }
    }
    let number = format!("{}\n", std::process::id());
    file.set_len(0).and_then(|()| file.write_all(number.as_bytes())).map_err(failed())?;
    Ok(file)
}

#[cfg(test)]
mod tests;
