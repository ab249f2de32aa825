//! Distance rows on disk: out of core, resumable, checked.
//!
//! A store is a directory with a table of all rows, `rows.npy`, and a journal, `journal.jsonl`. Rows are computed bundle by
//! bundle, each in the memory of one thread. A row is written to its place in the table; then its checksum is entered in the
//! journal. Whoever opens the store again reads every row that the journal knows, and computes anew what does not agree with its
//! checksum. So no order of writes needs to be forced on the disk: whatever a crash leaves, of table and journal, only a row that
//! is there as it was computed counts. Once all are, the table is synchronised with the disk, and then the journal says that
//! the store is complete.
//!
//! Numbers depend on the solver and the sources alone. Neither threads nor interruptions change a bit.

mod journal;
mod npy;

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read, Write};
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use rayon::prelude::*;

use crate::control::Control;
use crate::error::{Error, Result};
use crate::geodesic::Solver;
use crate::geodesic::bundle::{BundleScratch, MOST_SOURCES};
use crate::rows::{Rows, fill};
use crate::turns::in_turn;
use journal::Journal;
use npy::{CHUNK, NpyFile, VALUE};

/// The names of what a store consists of.
const TABLE: &str = "rows.npy";
const JOURNAL: &str = "journal.jsonl";

/// How long a lock is waited for: work that was cancelled lets it go within this time.
const PATIENCE: Duration = Duration::from_millis(500);

/// The memory in bytes that computing a store needs at most: for each thread a bundle of rows, what is written at once, and what
/// it computes them in.
pub fn memory_need(columns: usize, rows: usize, threads: usize) -> u64 {
    let height = MOST_SOURCES.min(rows.div_ceil(threads.max(1)));
    let at_once = threads.min(rows) as u64;
    at_once * (CHUNK as u64 + (height * columns * VALUE) as u64 + BundleScratch::memory_need(columns))
}

/// What was in a store when it was opened.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Found {
    /// Rows that were finished and sound.
    pub rows: usize,
    /// Rows that did not agree with their checksum.
    pub damaged: usize,
}

/// All rows from some sources, on disk. No other process can compute them while this lives.
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
    /// Computes the rows from `sources` that are not in the store yet.
    ///
    /// The directory must exist; of an empty one a store is made. `identity` says what is measured (a hash in letters and
    /// digits): a store of another identity is refused.
    /// Errors: [`Error::StoreInUse`], [`Error::StoreForeign`], [`Error::StoreFailed`]; [`Error::Unreachable`] if a vertex lies in
    /// another component; [`Error::Cancelled`]. Whatever happens, finished rows are kept.
    pub fn compute<S: Solver>(
        directory: &Path,
        identity: &str,
        solver: &S,
        sources: &[u32],
        control: &Control,
    ) -> Result<Self> {
        let columns = solver.columns();
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

    /// Makes a store whose rows others compute, or finds what is in it.
    pub fn lay_out(directory: &Path, identity: &str, rows: usize, columns: usize, control: &Control) -> Result<Found> {
        Ok(open(directory, identity, rows, columns, control)?.found)
    }

    /// Computes some of the rows, by their numbers, of a store that another process has [laid out](Self::lay_out). They are entered in a
    /// journal of their own in the directory `part`, which must exist; what that knows is not computed again.
    /// Errors: Those of [`Store::compute`]; [`Error::StoreFailed`] if there is no table.
    pub fn compute_part<S: Solver>(
        directory: &Path,
        part: &Path,
        identity: &str,
        solver: &S,
        sources: &[u32],
        rows: &[u32],
        control: &Control,
    ) -> Result<()> {
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

    /// What was there already.
    pub fn found(&self) -> Found {
        self.found
    }
}

/// Reads rows of a store's table, whoever wrote them: the numbers of those that do not agree with their checksum, where one is known.
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

    /// Reads some rows at a time, and compares checksums.
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

/// A store, and what is in it.
struct Opened {
    lock: File,
    table: NpyFile,
    /// Where rows are to be entered, unless all of them are there.
    journal: Option<Journal>,
    found: Found,
    /// The checksum of each row that agrees with it.
    sound: Vec<Option<u32>>,
}

/// Opens a store, or makes one; reads all that is there.
fn open(directory: &Path, identity: &str, rows: usize, columns: usize, control: &Control) -> Result<Opened> {
    let lock = lock(directory, control)?;
    let header = journal::header(identity, rows, columns);
    let path = directory.join(JOURNAL);
    let entries = journal::read(&path, &header, rows)?;
    let table = NpyFile::new(directory.join(TABLE), rows, columns);
    table.lay_out()?;
    let (known, is_complete) = entries.map_or((vec![None; rows], false), |e| (e.checksums, e.complete));
    let sound = verify(&table, &known, control)?;
    let is_there = sound.iter().flatten().count();
    let found = Found { rows: is_there, damaged: known.iter().flatten().count() - is_there };
    let journal = if is_complete && is_there == rows { None } else { Some(Journal::begin(path, &header, &sound)?) };
    Ok(Opened { lock, table, journal, found, sound })
}

/// The known checksums of rows that agree with them.
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

/// Computes and writes those of the rows that have no checksum; all checksums that are known then.
fn compute_missing<S: Solver>(
    table: &NpyFile,
    journal: &Journal,
    mut checksums: Vec<Option<u32>>,
    rows: &[u32],
    solver: &S,
    sources: &[u32],
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

/// The lock of a store, which the system takes back when its holder ends, however that comes about. It holds the number of
/// its holder's process, for messages.
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
