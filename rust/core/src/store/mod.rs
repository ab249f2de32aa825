//! Distance rows on disk: out of core, resumable, checked.
//!
//! A store is a directory with a table of all rows, `rows.npy`, and a journal, `journal.jsonl`. Rows are computed in blocks,
//! several at a time, each in the memory of one thread. A block's data are written to their place in the table; then its
//! checksum is entered in the journal. Whoever opens the store again reads every block that the journal knows, and computes
//! anew what does not agree with its checksum. So no order of writes needs to be forced on the disk: whatever a crash leaves,
//! of table and journal, only a block that is there as it was computed counts. Once all are, the table is synchronised with the
//! disk, and then the journal says that the store is complete.
//!
//! Numbers depend on the solver and the sources alone. Neither threads nor interruptions change a bit.

mod journal;
mod npy;

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read, Write};
use std::ops::Range;
use std::path::Path;
use std::time::{Duration, Instant};

use rayon::prelude::*;

use crate::control::Control;
use crate::error::{Error, Result};
use crate::geodesic::Solver;
use crate::geodesic::engine::{Engine, EngineScratch};
use crate::geodesic::sweep::LANES;
use crate::rows::{Rows, measure_alone};
use crate::turns::in_turn;
use journal::Journal;
use npy::{CHUNK, NpyFile, VALUE};

/// Most bytes of a block, if a row is not longer.
const BLOCK_BYTES: usize = 64 << 20;

/// Most rows of a block, as many as are best computed at once.
const MOST_ROWS: usize = LANES;

/// Few rows make so many blocks nevertheless, for many threads.
const FEWEST_BLOCKS: usize = 16;

/// Most bytes to prepare distances in: with the blocks in flight less than the rows that are kept on disk to save memory.
pub const PREPARED_BYTES: u64 = 512 << 20;

/// How long a lock is waited for: work that was cancelled lets it go within this time.
const PATIENCE: Duration = Duration::from_millis(500);

/// Rows of a block, of so many rows of so many columns. It must not depend on anything else: a store keeps its blocks.
///
/// # Examples
/// ```
/// use voxflat::store::block_rows;
///
/// assert_eq!(block_rows(1_000_000, 1000), 16); // 64 MiB
/// assert_eq!(block_rows(1000, 32), 2); // of few rows sixteen blocks
/// ```
pub fn block_rows(columns: usize, rows: usize) -> usize {
    (BLOCK_BYTES / (columns * VALUE).max(1)).clamp(1, rows.div_ceil(FEWEST_BLOCKS).clamp(1, MOST_ROWS))
}

/// The memory in bytes that computing a store needs at most: the blocks in flight, for each of them what is written at once, and
/// two entries of eight bytes a vertex to search.
///
/// # Examples
/// ```
/// use voxflat::store::memory_need;
///
/// assert!(memory_need(1_000_000, 1000, 2) < 4 * 1_000_000 * 1000 / 10); // less than a tenth of the rows
/// ```
pub fn memory_need(columns: usize, rows: usize, threads: usize) -> u64 {
    let height = block_rows(columns, rows);
    let at_once = threads.min(rows.div_ceil(height.max(1)));
    at_once as u64 * (CHUNK as u64 + (height * VALUE + 16) as u64 * columns as u64)
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
///
/// # Examples
/// ```
/// use voxflat::control::Control;
/// use voxflat::geodesic::graph::GeodesicGraph;
/// use voxflat::rows::{DistanceRows, Rows};
/// use voxflat::store::Store;
/// use voxflat::surface::mesh::shapes;
///
/// let control = Control::default();
/// let sheet = shapes::surface(shapes::sheet(8, 8)); // 8 by 8 squares of 1 mm
/// let graph = GeodesicGraph::new(&sheet, &control)?;
/// let directory = std::env::temp_dir().join(format!("voxflat-example-{}", std::process::id()));
/// std::fs::create_dir_all(&directory).unwrap();
/// drop(Store::compute(&directory, "sheet", &graph, &[0, 80], &control)?);
/// let again = Store::compute(&directory, "sheet", &graph, &[0, 80], &control)?;
/// assert_eq!(again.found().rows, 2); // nothing is computed twice
/// assert_eq!(again.among(&control)?, DistanceRows::compute(&graph, &[0, 80], &control)?.among(&control)?);
/// # drop(again);
/// # std::fs::remove_dir_all(directory).unwrap();
/// # Ok::<(), voxflat::Error>(())
/// ```
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
    ///
    /// # Errors
    /// [`Error::StoreInUse`], [`Error::StoreForeign`], [`Error::StoreFailed`]; [`Error::Unreachable`] if a vertex lies in
    /// another component; [`Error::Cancelled`]. Whatever happens, finished blocks are kept.
    pub fn compute<S: Solver>(
        directory: &Path,
        identity: &str,
        solver: &S,
        sources: &[u32],
        control: &Control,
    ) -> Result<Self> {
        let lock = lock(directory, control)?;
        let columns = solver.columns();
        let blocks = Blocks { rows: sources.len(), height: block_rows(columns, sources.len()) };
        let header = journal::header(identity, sources.len(), columns, blocks.height);
        let path = directory.join("journal.jsonl");
        let entries = journal::read(&path, &header, blocks.len())?;
        let table = NpyFile::new(directory.join("rows.npy"), sources.len(), columns);
        table.lay_out()?;

        let (known, is_complete) = entries.map_or((vec![None; blocks.len()], false), |e| (e.checksums, e.complete));
        let sound = verify(&table, blocks, &known, control)?;
        let rows_where = |keep: &dyn Fn(usize) -> bool| {
            (0..blocks.len()).filter(|&block| keep(block)).map(|block| blocks.range(block).len()).sum()
        };
        let found = Found {
            rows: rows_where(&|block| sound[block].is_some()),
            damaged: rows_where(&|block| known[block].is_some() && sound[block].is_none()),
        };
        let checksums = if is_complete && found.rows == sources.len() {
            sound.into_iter().flatten().collect()
        } else {
            let journal = Journal::begin(path, &header, &sound)?;
            let checksums = compute_missing(&table, &journal, blocks, &sound, solver, sources, control)?;
            table.sync()?;
            journal.complete()?;
            checksums
        };
        Ok(Self { table, sources: sources.to_vec(), columns, checksums, found, _lock: lock })
    }

    /// What was there already.
    pub fn found(&self) -> Found {
        self.found
    }

    fn blocks_of_rows(&self) -> Blocks {
        Blocks { rows: self.sources.len(), height: self.block_rows() }
    }
}

impl Rows for Store {
    fn sources(&self) -> &[u32] {
        &self.sources
    }

    fn columns(&self) -> usize {
        self.columns
    }

    fn block_rows(&self) -> usize {
        block_rows(self.columns, self.sources.len())
    }

    /// Reads block by block, and compares checksums.
    ///
    /// # Errors
    /// [`Error::StoreDamaged`], [`Error::StoreFailed`], [`Error::Cancelled`].
    fn visit(&self, control: &Control, visit: &mut dyn FnMut(usize, &[f32]) -> Result<()>) -> Result<()> {
        let blocks = self.blocks_of_rows();
        let mut rows = vec![0.0; blocks.range(0).len() * self.columns];
        for (block, &checksum) in self.checksums.iter().enumerate() {
            let Range { start, end } = blocks.range(block);
            let rows = &mut rows[..(end - start) * self.columns];
            if self.table.read(start, rows, control)? != checksum {
                let path = self.table.path().display().to_string();
                return Err(Error::StoreDamaged { path, first: start, last: end - 1 });
            }
            visit(start, rows)?;
        }
        Ok(())
    }
}

/// How rows are divided into blocks.
#[derive(Debug, Clone, Copy)]
struct Blocks {
    rows: usize,
    height: usize,
}

impl Blocks {
    fn len(self) -> usize {
        self.rows.div_ceil(self.height)
    }

    fn range(self, block: usize) -> Range<usize> {
        block * self.height..((block + 1) * self.height).min(self.rows)
    }
}

/// The known blocks whose data agree with their checksums.
fn verify(table: &NpyFile, blocks: Blocks, known: &[Option<u32>], control: &Control) -> Result<Vec<Option<u32>>> {
    control.begin("checking the store", known.iter().flatten().count() as u64);
    let agrees = |(block, checksum): (usize, &Option<u32>)| {
        let Some(checksum) = *checksum else { return Ok(None) };
        let rows = blocks.range(block);
        let is_sound = table.checksum(rows.start, rows.len(), control)? == checksum;
        control.advance();
        Ok(is_sound.then_some(checksum))
    };
    known.par_iter().enumerate().map(agrees).collect()
}

/// Computes and writes the blocks that have no checksum; the checksums of all blocks.
fn compute_missing<S: Solver>(
    table: &NpyFile,
    journal: &Journal,
    blocks: Blocks,
    known: &[Option<u32>],
    solver: &S,
    sources: &[u32],
    control: &Control,
) -> Result<Vec<u32>> {
    let engine = Engine::within(PREPARED_BYTES, solver, sources.len(), control)?;
    let missing = (0..known.len()).filter(|&block| known[block].is_none());
    control.begin("measuring distances", missing.map(|block| blocks.range(block).len() as u64).sum());
    let mut checksums = vec![0; known.len()];
    let compute = |(scratch, rows): &mut (EngineScratch<S::Scratch>, Vec<f32>),
                   (block, (known, checksum)): (usize, (&Option<u32>, &mut u32))| {
        if let Some(known) = *known {
            *checksum = known;
            return Ok(());
        }
        let range = blocks.range(block);
        rows.resize(range.len() * solver.columns(), 0.0);
        measure_alone(&engine, &sources[range.clone()], rows, scratch, control)?;
        *checksum = table.write(range.start, rows, control)?;
        journal.add(block, *checksum)
    };
    in_turn(known.iter().zip(&mut checksums).enumerate(), || (engine.scratch(), Vec::new()), compute)?;
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
