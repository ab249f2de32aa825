//! Stores that are interrupted, damaged or shared have the same rows as after an uninterrupted run.

use std::fs;
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};

use super::*;
use crate::rows::DistanceRows;
use crate::surface::voxels::graph::VoxelGraph;
use crate::tests::{Altered, chained, with_threads};
use crate::volume::Mask;
use proptest::prelude::*;

/// A new directory that is removed when it is dropped.
pub struct Folder(PathBuf);

impl Folder {
    pub fn new(name: &str) -> Self {
        static COUNT: AtomicUsize = AtomicUsize::new(0);
        let count = COUNT.fetch_add(1, Ordering::Relaxed);
        let path = std::env::temp_dir().join(format!("voxflat-{name}-{}-{count}", std::process::id()));
        fs::create_dir(&path).unwrap();
        Self(path)
    }

    pub fn path(&self) -> &Path {
        &self.0
    }

    fn bytes(&self, name: &str) -> Vec<u8> {
        fs::read(self.0.join(name)).unwrap()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        fs::remove_dir_all(&self.0).unwrap();
    }
}

const COMPLETE: &[u8] = b"{\"complete\": true}\n";

const ROWS: usize = 53;

fn sheet() -> VoxelGraph {
    chained(&Mask::from_fn([9, 8, 1], |_| true).unwrap(), [1.0; 3]).1
}

fn sources() -> Vec<u32> {
    (0..ROWS as u32).map(|n| (n * 7 + 3) % 72).collect()
}

/// Returns a solver that counts rows, and fails after a number of them.
fn until<'a>(graph: &'a VoxelGraph, rows: &'a AtomicUsize, last: usize) -> impl Solver + 'a {
    rows.store(0, Ordering::Relaxed);
    let count = move |_: &mut [f32]| match rows.fetch_add(1, Ordering::Relaxed) < last {
        true => Ok(()),
        false => Err(Error::Cancelled),
    };
    Altered(graph, count)
}

fn compute<S: Solver>(folder: &Folder, solver: &S) -> Result<Store> {
    Store::compute(folder.path(), "a1", solver, &sources(), &Control::default())
}

fn all_rows(store: &impl Rows) -> Vec<f32> {
    let mut data = Vec::new();
    let mut collect = |first: usize, rows: &[f32]| {
        assert_eq!(first * store.columns(), data.len());
        data.extend_from_slice(rows);
        Ok(())
    };
    store.visit(&Control::default(), &mut collect).unwrap();
    data
}

#[test]
fn a_store_holds_the_rows_that_memory_would() {
    let graph = sheet();
    let control = Control::default();
    let expected = DistanceRows::compute(&graph, &sources(), &control).unwrap();
    let folder = Folder::new("same");
    let store = compute(&folder, &graph).unwrap();
    assert_eq!(store.found(), Found { rows: 0, damaged: 0 });
    assert_eq!(store.among(&control).unwrap(), expected.among(&control).unwrap());
    assert_eq!(all_rows(&store), expected.into_data());
    let bytes: Vec<u8> = all_rows(&store).iter().flat_map(|value| value.to_le_bytes()).collect();
    assert!(folder.bytes("rows.npy").ends_with(&bytes));
}

#[test]
fn a_complete_store_is_read_and_not_touched() {
    let graph = sheet();
    let folder = Folder::new("complete");
    drop(compute(&folder, &graph).unwrap());
    let (table, journal) = (folder.bytes("rows.npy"), folder.bytes("journal.jsonl"));
    assert!(journal.ends_with(COMPLETE));
    let rows = AtomicUsize::new(0);
    let again = compute(&folder, &until(&graph, &rows, 0)).unwrap();
    assert_eq!((again.found(), rows.into_inner()), (Found { rows: ROWS, damaged: 0 }, 0));
    assert!((table, journal) == (folder.bytes("rows.npy"), folder.bytes("journal.jsonl")));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn interrupted_runs_go_on_where_they_were(stops in prop::collection::vec(0..ROWS, 1..6), threads in 1usize..4) {
        let graph = sheet();
        let folder = Folder::new("stops");
        let mut finished = 0;
        for stop in stops {
            let rows = AtomicUsize::new(0);
            match with_threads(threads, || compute(&folder, &until(&graph, &rows, stop))) {
                Ok(store) => prop_assert!(store.found().rows == finished && rows.into_inner() == ROWS - finished),
                Err(error) => {
                    prop_assert_eq!(error, Error::Cancelled);
                    prop_assert!(!folder.bytes("journal.jsonl").ends_with(COMPLETE));
                }
            }
            let lines = String::from_utf8(folder.bytes("journal.jsonl")).unwrap();
            let now = lines.matches("crc32").count();
            // at most one row per thread is lost
            prop_assert!(now >= finished && now + threads >= finished + stop.min(ROWS - finished));
            finished = now;
        }
        let store = compute(&folder, &graph).unwrap();
        prop_assert_eq!(store.found(), Found { rows: finished, damaged: 0 });
        let expected = DistanceRows::compute(&graph, &sources(), &Control::default()).unwrap();
        prop_assert_eq!(all_rows(&store), expected.into_data());
    }

    #[test]
    fn whatever_is_damaged_is_computed_again(at in any::<prop::sample::Index>(), flip in 1u8..=255, cut in prop::option::of(any::<prop::sample::Index>())) {
        let graph = sheet();
        let folder = Folder::new("damage");
        drop(compute(&folder, &graph).unwrap());
        let sound = folder.bytes("rows.npy");
        let mut bytes = sound.clone();
        bytes[at.index(sound.len())] ^= flip;
        if let Some(cut) = cut {
            bytes.truncate(cut.index(sound.len()));
        }
        fs::write(folder.path().join("rows.npy"), &bytes).unwrap();
        let store = compute(&folder, &graph).unwrap();
        prop_assert_eq!(store.found().rows + store.found().damaged, ROWS);
        let is_header = at.index(sound.len()) < sound.len() - 4 * ROWS * 72;
        prop_assert!(cut.is_some() || (store.found().damaged == 0) == is_header);
        prop_assert!(folder.bytes("rows.npy") == sound);
        prop_assert!(folder.bytes("journal.jsonl").ends_with(COMPLETE));
    }
}

#[test]
fn damage_while_it_is_open_is_told() {
    let graph = sheet();
    let folder = Folder::new("open");
    let store = compute(&folder, &graph).unwrap();
    let mut bytes = folder.bytes("rows.npy");
    let last = bytes.len() - 1;
    bytes[last] ^= 1;
    fs::write(folder.path().join("rows.npy"), bytes).unwrap();
    let told = store.among(&Control::default()).unwrap_err();
    assert!(matches!(told, Error::StoreDamaged { row: 52, .. }), "{told}");
}

#[test]
fn parts_by_several_make_the_store_that_one_would() {
    let graph = sheet();
    let (alone, folder) = (Folder::new("alone"), Folder::new("parts"));
    drop(compute(&alone, &graph).unwrap());
    let control = Control::default();
    let count = AtomicUsize::new(0);
    let of = |part: &Path, rows: &[u32], last: usize| {
        Store::compute_part(folder.path(), part, "a1", &until(&graph, &count, last), &sources(), rows, &control)
    };
    let parts = ["first", "second"].map(|name| folder.path().join(name));
    parts.iter().for_each(|part| fs::create_dir(part).unwrap());
    let (first, second): (Vec<u32>, Vec<u32>) = (0..ROWS as u32).partition(|row| row % 3 == 1);
    let told = of(&parts[0], &first, ROWS).unwrap_err();
    assert!(matches!(told, Error::StoreFailed { .. })); // the table was not created
    let nothing = Store::create(folder.path(), "a1", ROWS, graph.columns(), &control).unwrap();
    assert_eq!(nothing, Found::default());
    assert_eq!(of(&parts[0], &first, 5), Err(Error::Cancelled));
    of(&parts[0], &first, ROWS).unwrap();
    assert_eq!(count.load(Ordering::Relaxed), first.len() - 5);
    of(&parts[1], &second, ROWS).unwrap();
    let lines = |folder: &Path| {
        let text = fs::read_to_string(folder.join(JOURNAL)).unwrap();
        let mut lines: Vec<String> =
            text.lines().skip(1).filter(|line| line.contains("row")).map(String::from).collect();
        lines.sort();
        lines
    };
    let mut both = [lines(&parts[0]), lines(&parts[1])].concat();
    both.sort();
    assert_eq!(both, lines(alone.path()));
    assert!(folder.bytes(TABLE) == alone.bytes(TABLE));
}

#[test]
fn a_store_of_others_is_refused_and_left_alone() {
    let graph = sheet();
    let folder = Folder::new("others");
    drop(compute(&folder, &graph).unwrap());
    let before = folder.bytes("rows.npy");
    let control = Control::default();
    let fewer = &sources()[1..];
    for (identity, sources) in [("b2", &sources()[..]), ("a1", fewer)] {
        let refused = Store::compute(folder.path(), identity, &graph, sources, &control).unwrap_err();
        assert!(matches!(refused, Error::StoreForeign { .. }), "{refused}");
    }
    assert!(folder.bytes("rows.npy") == before);
}

#[test]
fn two_at_once_are_refused() {
    let graph = sheet();
    let folder = Folder::new("lock");
    let first = compute(&folder, &graph).unwrap();
    let refused = compute(&folder, &graph).unwrap_err();
    let holder = format!("process {}", std::process::id());
    assert_eq!(refused, Error::StoreInUse { path: folder.path().display().to_string(), holder });
    drop(first);
    assert!(compute(&folder, &graph).is_ok());
}

#[test]
fn fingerprints_tell_graphs_apart() {
    let control = Control::default();
    let of = |mask: Mask, spacing| chained(&mask, spacing).1.fingerprint(&control).unwrap();
    let plate = || Mask::from_fn([5, 5, 1], |_| true).unwrap();
    let dented = Mask::from_fn([5, 5, 1], |[i, j, _]| (i, j) != (0, 0)).unwrap();
    let all = [of(plate(), [1.0; 3]), of(plate(), [1.0, 1.0, 2.0]), of(plate(), [1.01; 3]), of(dented, [1.0; 3])];
    assert!((0..4).all(|a| (0..a).all(|b| all[a] != all[b])));
    assert_eq!(all[0], of(plate(), [1.0; 3]));
}
