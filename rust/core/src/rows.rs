//! Distance rows: the distances from many sources, computed in parallel. In memory here, on disk in [`crate::store`].

use crate::control::Control;
use crate::error::{Error, Result};
use crate::geodesic::Solver;
use crate::geodesic::engine::{Engine, EngineScratch, Targets};
use crate::turns::in_turn;

/// Distance rows, wherever they are kept.
pub trait Rows {
    /// The vertices from which distances were measured.
    fn sources(&self) -> &[u32];

    /// Length of a row.
    fn columns(&self) -> usize;

    /// How many rows are visited at a time.
    fn block_rows(&self) -> usize;

    /// Passes all rows on, in the order of the sources: `visit(n, rows)` gets whole rows from the n-th on, one after the
    /// other.
    ///
    /// # Errors
    /// Those of `visit`, and of reading.
    fn visit(&self, control: &Control, visit: &mut dyn FnMut(usize, &[f32]) -> Result<()>) -> Result<()>;

    /// The columns of the sources only.
    ///
    /// # Errors
    /// Those of reading.
    ///
    /// # Panics
    /// If the rows do not reach to every source.
    fn among(&self, control: &Control) -> Result<DistanceRows> {
        let sources = self.sources();
        let mut data = Vec::with_capacity(sources.len() * sources.len());
        self.visit(control, &mut |_, rows| {
            for row in rows.chunks(self.columns().max(1)) {
                data.extend(sources.iter().map(|&column| row[column as usize]));
            }
            Ok(())
        })?;
        Ok(DistanceRows::new(sources.to_vec(), sources.len(), data))
    }
}

/// Distances from sources to columns, in mm.
#[derive(Debug, Clone, PartialEq)]
pub struct DistanceRows {
    sources: Vec<u32>,
    columns: usize,
    data: Vec<f32>,
}

impl DistanceRows {
    /// Rows from every source to every vertex.
    ///
    /// # Errors
    /// [`Error::Unreachable`] if a vertex lies in another component, [`Error::Cancelled`].
    pub fn compute<S: Solver>(solver: &S, sources: &[u32], control: &Control) -> Result<Self> {
        Self::by(&Engine::new(solver, sources.len(), control)?, sources, control)
    }

    /// Rows from every source to every vertex, by an engine that is there already.
    ///
    /// # Errors
    /// As [`DistanceRows::compute`].
    pub fn by<S: Solver>(engine: &Engine<S>, sources: &[u32], control: &Control) -> Result<Self> {
        let columns = engine.columns();
        let mut data = vec![0.0; sources.len() * columns];
        control.begin("measuring distances", sources.len() as u64);
        measure(engine, sources, None, &mut data, control)?;
        Ok(Self::new(sources.to_vec(), columns, data))
    }

    /// These rows as [`compute`](Self::compute) gives them, bit by bit: those of an engine that was made for more sources, and
    /// therefore goes another way, are measured again.
    ///
    /// # Errors
    /// As [`DistanceRows::compute`].
    pub fn as_computed<S: Solver>(self, engine: &Engine<S>, control: &Control) -> Result<Self> {
        if engine.goes_as_for(self.sources.len()) {
            return Ok(self);
        }
        let Self { sources, .. } = self;
        Self::compute(engine.solver(), &sources, control)
    }

    /// The distances among the sources only; whole rows exist one a thread at a time.
    ///
    /// # Errors
    /// As [`DistanceRows::compute`].
    pub fn among_sources<S: Solver>(solver: &S, sources: &[u32], control: &Control) -> Result<Self> {
        Self::among_by(&Engine::new(solver, sources.len(), control)?, sources, control)
    }

    /// The distances among the sources only, by an engine that is there already.
    ///
    /// # Errors
    /// As [`DistanceRows::compute`].
    pub fn among_by<S: Solver>(engine: &Engine<S>, sources: &[u32], control: &Control) -> Result<Self> {
        let columns = sources.len();
        let mut data = vec![0.0; columns * columns];
        control.begin("measuring distances", columns as u64);
        measure(engine, sources, Some(&engine.targets(sources)), &mut data, control)?;
        Ok(Self::new(sources.to_vec(), columns, data))
    }

    /// Rows that are known already, of `columns` distances each, one after the other.
    ///
    /// # Panics
    /// If there is not one row a source.
    pub fn new(sources: Vec<u32>, columns: usize, data: Vec<f32>) -> Self {
        assert_eq!(data.len(), sources.len() * columns, "one row a source");
        Self { sources, columns, data }
    }

    /// The vertices from which distances were measured.
    pub fn sources(&self) -> &[u32] {
        &self.sources
    }

    /// Length of a row.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// The distances from the n-th source.
    pub fn row(&self, n: usize) -> &[f32] {
        &self.data[n * self.columns..(n + 1) * self.columns]
    }

    /// All rows, one after the other.
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

    fn block_rows(&self) -> usize {
        self.sources.len()
    }

    fn visit(&self, _: &Control, visit: &mut dyn FnMut(usize, &[f32]) -> Result<()>) -> Result<()> {
        visit(0, &self.data)
    }
}

impl<R: Rows> Rows for &R {
    fn sources(&self) -> &[u32] {
        (**self).sources()
    }

    fn columns(&self) -> usize {
        (**self).columns()
    }

    fn block_rows(&self) -> usize {
        (**self).block_rows()
    }

    fn visit(&self, control: &Control, visit: &mut dyn FnMut(usize, &[f32]) -> Result<()>) -> Result<()> {
        (**self).visit(control, visit)
    }
}

/// Rows that are computed each time they are passed, so that only some of them exist at a time.
#[derive(Debug)]
pub struct PassingRows<'a, S> {
    engine: &'a Engine<'a, S>,
    sources: &'a [u32],
    at_once: usize,
}

impl<'a, S: Solver> PassingRows<'a, S> {
    /// Rows from every source to every vertex, as many at once as so many bytes hold.
    pub fn new(engine: &'a Engine<'a, S>, sources: &'a [u32], bytes: u64) -> Self {
        let row = 4 * engine.columns().max(1) as u64;
        Self { engine, sources, at_once: usize::try_from(bytes / row).unwrap_or(usize::MAX).max(1) }
    }
}

impl<S: Solver> Rows for PassingRows<'_, S> {
    fn sources(&self) -> &[u32] {
        self.sources
    }

    fn columns(&self) -> usize {
        self.engine.columns()
    }

    fn block_rows(&self) -> usize {
        self.at_once.min(self.sources.len())
    }

    fn visit(&self, control: &Control, visit: &mut dyn FnMut(usize, &[f32]) -> Result<()>) -> Result<()> {
        control.begin("measuring distances", self.sources.len() as u64);
        let columns = self.columns();
        let mut data = vec![0.0; self.block_rows() * columns];
        for (n, sources) in self.sources.chunks(self.at_once).enumerate() {
            let rows = &mut data[..sources.len() * columns];
            measure(self.engine, sources, None, rows, control)?;
            visit(n * self.at_once, rows)?;
        }
        Ok(())
    }
}

/// Computes the rows of sources, one after the other in `data`: bundles in turn by all threads.
fn measure<S: Solver>(
    engine: &Engine<S>,
    sources: &[u32],
    targets: Option<&Targets<'_>>,
    data: &mut [f32],
    control: &Control,
) -> Result<()> {
    let bundles = engine.bundles(sources, rayon::current_num_threads(), control)?;
    let mut rows = slices(data, sources.len());
    let turns: Vec<_> = bundles.iter().map(|bundle| take(bundle, sources, &mut rows)).collect();
    in_turn(
        turns.into_iter(),
        || engine.scratch(),
        |scratch, (bundle, mut rows)| fill(engine, &bundle, targets, &mut rows, scratch, control),
    )
}

/// The same by one thread.
pub(crate) fn measure_alone<S: Solver>(
    engine: &Engine<S>,
    sources: &[u32],
    data: &mut [f32],
    scratch: &mut EngineScratch<S::Scratch>,
    control: &Control,
) -> Result<()> {
    let mut rows = slices(data, sources.len());
    for bundle in engine.bundles(sources, 1, control)? {
        let (bundle, mut rows) = take(&bundle, sources, &mut rows);
        fill(engine, &bundle, None, &mut rows, scratch, control)?;
    }
    Ok(())
}

/// The rows in `data`, each for itself.
fn slices(data: &mut [f32], rows: usize) -> Vec<&mut [f32]> {
    let columns = data.len() / rows.max(1);
    data.chunks_exact_mut(columns.max(1)).collect()
}

/// The sources of a bundle, and their rows.
fn take<'d>(bundle: &[u32], sources: &[u32], rows: &mut [&'d mut [f32]]) -> (Vec<u32>, Vec<&'d mut [f32]>) {
    bundle.iter().map(|&n| (sources[n as usize], std::mem::take(&mut rows[n as usize]))).unzip()
}

/// Fills the rows of a bundle, and counts them, if they reach everything.
fn fill<S: Solver>(
    engine: &Engine<S>,
    bundle: &[u32],
    targets: Option<&Targets<'_>>,
    rows: &mut [&mut [f32]],
    scratch: &mut EngineScratch<S::Scratch>,
    control: &Control,
) -> Result<()> {
    engine.fill(bundle, targets, rows, scratch, control)?;
    for (row, &source) in rows.iter().zip(bundle) {
        // a look at all, which never ends early, is made of vector instructions
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
    use crate::geodesic::chain::LinkLengths;
    use crate::geodesic::chain::chain_graph;
    use crate::surface::VoxelSurface;
    use crate::surface::voxels::graph::VoxelGraph;
    use crate::volume::{Affine, Mask};

    fn sheet(gap: bool) -> VoxelGraph {
        let mask = Mask::from_fn([60, 50, 9], |[i, j, k]| k == j / 6 && !(gap && i == 30)).unwrap();
        let control = Control::default();
        let surface = VoxelSurface::from_mask(&mask, Affine::from_spacing([1.0, 1.0, 0.7]).unwrap(), &control).unwrap();
        chain_graph(&surface, LinkLengths::ChainCode, &control).unwrap()
    }

    fn with_threads<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(work)
    }

    #[test]
    fn rows_are_the_same_with_any_number_of_threads() {
        let graph = sheet(false);
        for count in [40, 700] {
            let sources: Vec<u32> = (0..count).map(|n| n * 4).collect();
            let control = Control::default();
            let is_swept = graph.sweep(sources.len(), u64::MAX, &control).unwrap().is_some();
            assert_eq!(is_swept, count == 700); // both ways are tested
            let rows = |threads| with_threads(threads, || DistanceRows::compute(&graph, &sources, &control).unwrap());
            let among =
                |threads| with_threads(threads, || DistanceRows::among_sources(&graph, &sources, &control).unwrap());
            let expected = rows(1);
            assert_eq!(expected.columns(), graph.vertices());
            assert_eq!(among(1), expected.among(&control).unwrap());
            for threads in [2, 7] {
                assert_eq!(rows(threads), expected);
                assert_eq!(among(threads), expected.among(&control).unwrap());
            }
        }
    }

    #[test]
    fn passing_rows_are_the_same_however_many_there_are_at_once() {
        let graph = sheet(false);
        for count in [40, 700] {
            let sources: Vec<u32> = (0..count).map(|n| n * 4).collect();
            let control = Control::default();
            let engine = Engine::new(&graph, sources.len(), &control).unwrap();
            let expected = DistanceRows::by(&engine, &sources, &control).unwrap().into_data();
            for (threads, rows) in [(1, 0), (2, 7), (3, 200), (2, 5000)] {
                let passing = PassingRows::new(&engine, &sources, 4 * rows * graph.vertices() as u64);
                let mut found = Vec::new();
                let mut take = |first: usize, data: &[f32]| {
                    assert_eq!(found.len(), first * graph.vertices());
                    found.extend_from_slice(data);
                    Ok(())
                };
                with_threads(threads, || passing.visit(&control, &mut take)).unwrap();
                assert_eq!(found, expected);
            }
        }
    }

    #[test]
    fn rows_of_an_engine_for_more_sources_are_those_that_are_computed() {
        let graph = sheet(false);
        let control = Control::default();
        let mut ways = Vec::new();
        for (count, more) in [(40, 20), (40, 700), (120, 700), (700, 900)] {
            let sources: Vec<u32> = (0..count).map(|n| n * 3).collect();
            let engine = Engine::new(&graph, more, &control).unwrap();
            let rows = DistanceRows::by(&engine, &sources, &control).unwrap();
            let computed = DistanceRows::compute(&graph, &sources, &control).unwrap();
            let goes_as_for = engine.goes_as_for(sources.len());
            if goes_as_for {
                assert_eq!(rows, computed);
            }
            assert_eq!(rows.as_computed(&engine, &control).unwrap(), computed);
            ways.push(goes_as_for);
        }
        assert_eq!(ways, [true, false, false, true]);
    }

    #[test]
    fn what_cannot_be_reached_is_refused_either_way() {
        let graph = sheet(true);
        for count in [40, 700] {
            let sources: Vec<u32> = (0..count).map(|n| n * (graph.vertices() as u32 / count)).collect();
            let control = Control::default();
            let found = DistanceRows::compute(&graph, &sources, &control).unwrap_err();
            assert!(matches!(found, Error::Unreachable { .. }));
            let found = DistanceRows::among_sources(&graph, &sources, &control).unwrap_err();
            assert!(matches!(found, Error::Unreachable { .. }));
        }
    }

    #[test]
    fn cancelling_ends_rows_either_way() {
        let graph = sheet(false);
        for count in [40, 700] {
            let control = Control::default();
            control.cancel();
            let sources: Vec<u32> = (0..count).collect();
            assert_eq!(DistanceRows::compute(&graph, &sources, &control), Err(Error::Cancelled));
        }
    }
}
