//! Distance rows: the distances from many sources, computed in parallel; [`crate::store`] keeps them on disk.

use crate::error::check_points;
use crate::geodesic::Solver;
use crate::parallel::in_turn;
use crate::{Control, Error, Result};

/// Distance rows in memory, on disk, or computed on demand.
pub trait Rows {
    /// Returns the vertices from which distances were computed.
    fn sources(&self) -> &[u32];

    /// Returns the length of a row.
    fn columns(&self) -> usize;

    /// Passes all rows in the order of the sources. `visit(n, rows)` receives complete rows from the n-th on.
    ///
    /// # Errors
    /// Those of `visit`, of computing the rows or of reading them, and [`Error::Cancelled`].
    fn visit(&self, control: &Control, visit: &mut dyn FnMut(usize, &[f32]) -> Result<()>) -> Result<()>;

    /// Returns the columns of the given vertices.
    ///
    /// # Errors
    /// [`Error::NoSuchPoint`] if the rows do not contain a target, and the errors of [`visit`](Self::visit).
    fn to(&self, targets: &[u32], control: &Control) -> Result<DistanceRows> {
        check_points(targets.iter().copied(), self.columns())?;
        let sources = self.sources();
        let mut data = Vec::with_capacity(sources.len() * targets.len());
        self.visit(control, &mut |_, rows| {
            for row in rows.chunks(self.columns().max(1)) {
                control.check()?;
                data.extend(targets.iter().map(|&column| row[column as usize]));
            }
            Ok(())
        })?;
        Ok(DistanceRows::new(sources.to_vec(), targets.len(), data))
    }

    /// Returns the columns of the sources.
    ///
    /// # Errors
    /// [`Error::NoSuchPoint`] if the rows do not contain a source, and the errors of [`visit`](Self::visit).
    fn among(&self, control: &Control) -> Result<DistanceRows> {
        self.to(self.sources(), control)
    }
}

/// Distances from sources (rows) to vertices (columns), in mm.
#[derive(Debug, Clone, PartialEq)]
pub struct DistanceRows {
    sources: Vec<u32>,
    columns: usize,
    data: Vec<f32>,
}

impl DistanceRows {
    /// Computes rows from every source to every vertex.
    ///
    /// # Errors
    /// [`Error::NoSuchPoint`], [`Error::Unreachable`] if a vertex lies in another component, and the errors of the
    /// solver.
    pub fn compute<S: Solver>(solver: &S, sources: &[u32], control: &Control) -> Result<Self> {
        Self::measured(solver, sources, None, control)
    }

    /// Computes rows from every source to the given vertices, which become the columns. Only one bundle of complete
    /// rows exists per thread.
    ///
    /// # Errors
    /// [`Error::NoSuchPoint`], [`Error::Unreachable`] if a target lies in another component, and the errors of the
    /// solver.
    pub fn compute_to<S: Solver>(solver: &S, sources: &[u32], targets: &[u32], control: &Control) -> Result<Self> {
        Self::measured(solver, sources, Some(targets), control)
    }

    /// Computes rows from every source to the other sources, and complete rows if these are to be kept.
    pub(crate) fn among_sources<S: Solver>(
        solver: &S, sources: &[u32], keep: bool, control: &Control,
    ) -> Result<(Self, Option<Self>)> {
        if keep {
            let rows = Self::compute(solver, sources, control)?;
            Ok((rows.among(control)?, Some(rows)))
        } else {
            Ok((Self::compute_to(solver, sources, sources, control)?, None))
        }
    }

    fn measured<S: Solver>(solver: &S, sources: &[u32], targets: Option<&[u32]>, control: &Control) -> Result<Self> {
        let columns = targets.map_or(solver.columns(), <[u32]>::len);
        let mut data = vec![0.0; sources.len() * columns];
        control.begin("measuring distances", sources.len() as u64);
        measure(solver, sources, targets, &mut data, control)?;
        Ok(Self::new(sources.to_vec(), columns, data))
    }

    /// Creates rows from known distances, `columns` per row, one row after the other.
    /// Panics if the number of rows differs from the number of sources.
    pub(crate) fn new(sources: Vec<u32>, columns: usize, data: Vec<f32>) -> Self {
        assert_eq!(data.len(), sources.len() * columns, "one row per source");
        Self { sources, columns, data }
    }

    /// Returns the vertices from which distances were computed.
    pub fn sources(&self) -> &[u32] {
        &self.sources
    }

    /// Returns the length of a row.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Returns the distances from the n-th source.
    ///
    /// # Panics
    /// If there are fewer sources.
    pub fn row(&self, n: usize) -> &[f32] {
        &self.data[n * self.columns..(n + 1) * self.columns]
    }

    /// Returns all rows, one after the other.
    pub fn into_data(self) -> Vec<f32> {
        self.data
    }
}

impl Rows for DistanceRows {
    fn sources(&self) -> &[u32] {
        &self.sources
    }

    fn columns(&self) -> usize {
        self.columns
    }

    fn visit(&self, _: &Control, visit: &mut dyn FnMut(usize, &[f32]) -> Result<()>) -> Result<()> {
        visit(0, &self.data)
    }
}

/// Rows that are recomputed each time they are passed, so that only some of them exist at a time.
#[derive(Debug)]
pub(crate) struct PassingRows<'a, S> {
    solver: &'a S,
    sources: &'a [u32],
    at_once: usize,
}

impl<'a, S: Solver> PassingRows<'a, S> {
    /// Creates rows from every source to every vertex, as many at a time as fit into `bytes` of memory.
    pub(crate) fn new(solver: &'a S, sources: &'a [u32], bytes: u64) -> Self {
        let row = 4 * solver.columns().max(1) as u64;
        Self { solver, sources, at_once: usize::try_from(bytes / row).unwrap_or(usize::MAX).max(1) }
    }
}

impl<S: Solver> Rows for PassingRows<'_, S> {
    fn sources(&self) -> &[u32] {
        self.sources
    }

    fn columns(&self) -> usize {
        self.solver.columns()
    }

    fn visit(&self, control: &Control, visit: &mut dyn FnMut(usize, &[f32]) -> Result<()>) -> Result<()> {
        control.begin("measuring distances", self.sources.len() as u64);
        let columns = self.columns();
        let mut data = vec![0.0; self.at_once.min(self.sources.len()) * columns];
        for (n, sources) in self.sources.chunks(self.at_once).enumerate() {
            let rows = &mut data[..sources.len() * columns];
            measure(self.solver, sources, None, rows, control)?;
            visit(n * self.at_once, rows)?;
        }
        Ok(())
    }
}

/// Computes the rows of sources, one after the other in `data`. Threads take bundles in turn.
fn measure<S: Solver>(
    solver: &S, sources: &[u32], targets: Option<&[u32]>, data: &mut [f32], control: &Control,
) -> Result<()> {
    check_points(sources.iter().chain(targets.unwrap_or_default()).copied(), solver.columns())?;
    let bundles = solver.bundles(sources, rayon::current_num_threads(), control)?;
    let columns = data.len() / sources.len().max(1);
    let mut rows: Vec<_> = data.chunks_exact_mut(columns.max(1)).collect();
    let with_rows = |bundle: Vec<u32>| {
        let own = bundle.iter().map(|&number| std::mem::take(&mut rows[number as usize])).collect();
        (bundle, own)
    };
    let turns: Vec<(Vec<u32>, Vec<&mut [f32]>)> = bundles.into_iter().map(with_rows).collect();
    let fill_next = |scratch: &mut S::Scratch, (bundle, mut rows): (Vec<u32>, Vec<&mut [f32]>)| {
        fill(solver, sources, &bundle, targets, &mut rows, scratch, control)
    };
    in_turn(turns.into_iter(), || solver.scratch(), fill_next)
}

/// Fills the rows of a bundle of sources, and counts them if all distances are finite.
pub(crate) fn fill<S: Solver>(
    solver: &S, sources: &[u32], bundle: &[u32], targets: Option<&[u32]>, rows: &mut [&mut [f32]],
    scratch: &mut S::Scratch, control: &Control,
) -> Result<()> {
    let members: Vec<u32> = bundle.iter().map(|&number| sources[number as usize]).collect();
    solver.rows(&members, targets, rows, scratch, control)?;
    for (row, source) in rows.iter().zip(members) {
        // inspecting all values without ending early compiles to vector instructions
        let reaches_all = row.iter().fold(true, |all, distance| all & !distance.is_infinite());
        if !reaches_all && let Some(vertex) = row.iter().position(|distance| distance.is_infinite()) {
            return Err(Error::Unreachable { source_vertex: source as usize, vertex });
        }
        control.advance();
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::adjacency::Links;
    use crate::surface::voxels::graph::VoxelGraph;
    use crate::tests::{chained, row, with_threads};
    use crate::volume::Mask;

    fn sheet(gap: bool) -> VoxelGraph {
        let mask = Mask::from_fn([60, 50, 9], |[i, j, k]| k == j / 6 && !(gap && i == 30)).unwrap();
        chained(&mask, [1.0, 1.0, 0.7]).1
    }

    /// Numbers of sources that are searched one by one, and that are bundled.
    const COUNTS: [u32; 2] = [20, 130];

    fn sources(graph: &VoxelGraph, count: u32) -> Vec<u32> {
        (0..count).map(|n| n * (graph.vertices() as u32 / count)).collect()
    }

    fn searched(graph: &VoxelGraph, sources: &[u32]) -> Vec<f32> {
        sources.iter().flat_map(|&source| row(graph, source)).collect()
    }

    #[test]
    fn rows_are_those_of_searches_with_any_number_of_threads() {
        let graph = sheet(false);
        let control = Control::default();
        for count in COUNTS {
            let sources = sources(&graph, count);
            let bundles = graph.bundles(&sources, 1, &control).unwrap();
            assert_eq!(bundles.len() < sources.len(), count == COUNTS[1]); // both ways are tested
            let expected = DistanceRows::new(sources.clone(), graph.vertices(), searched(&graph, &sources));
            for threads in [1, 2, 7, 200] {
                let rows = with_threads(threads, || DistanceRows::compute(&graph, &sources, &control).unwrap());
                assert_eq!(rows, expected);
                let among =
                    with_threads(threads, || DistanceRows::compute_to(&graph, &sources, &sources, &control).unwrap());
                assert_eq!(among, expected.among(&control).unwrap());
            }
        }
    }

    #[test]
    fn passing_rows_are_the_same_however_many_there_are_at_once() {
        let graph = sheet(false);
        let control = Control::default();
        for count in COUNTS {
            let sources = sources(&graph, count);
            let expected = searched(&graph, &sources);
            for (threads, rows) in [(1, 0), (2, 7), (3, 100), (2, 5000)] {
                let passing = PassingRows::new(&graph, &sources, 4 * rows * graph.vertices() as u64);
                let mut found = Vec::new();
                let mut take = |first: usize, data: &[f32]| {
                    assert_eq!(found.len(), first * graph.vertices());
                    found.extend_from_slice(data);
                    Ok(())
                };
                with_threads(threads, || passing.visit(&control, &mut take)).unwrap();
                assert!(found == expected);
            }
        }
    }

    #[test]
    fn what_cannot_be_reached_is_refused_either_way() {
        let graph = sheet(true);
        let control = Control::default();
        for count in COUNTS {
            let sources = sources(&graph, count);
            let found = DistanceRows::compute(&graph, &sources, &control).unwrap_err();
            assert!(matches!(found, Error::Unreachable { .. }));
            let found = DistanceRows::compute_to(&graph, &sources, &sources, &control).unwrap_err();
            assert!(matches!(found, Error::Unreachable { .. }));
        }
    }
}
