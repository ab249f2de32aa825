//! Shortest paths that bend around the boundary.
//!
//! A shortest path that passes a vertex of the boundary between its ends is at least as long as the straight line that
//! a map without distortion would have there: around a notch, a hole or the end of a cut, it is longer. Its length is
//! only an upper bound for the distance in the plane (Rosman, Bronstein, Bronstein & Kimmel 2010, section 3: consistent
//! pairs). Pairs whose path does not pass the boundary are interior pairs.
//!
//! The last bit of a marked distance tells whether its path bends, which changes the distance by half a unit in the
//! last place at most. So rows remain rows wherever they are stored or selected.

use std::mem;

use pulp::{Arch, Simd, WithSimd};

use super::bundle::{BundleScratch, MOST_SOURCES};
use super::graph::GeodesicGraph;
use super::solver::Solver;
use crate::adjacency::Links;
use crate::rows::{DistanceRows, Rows};
use crate::{Control, Result};

/// The number of vertices between two checks for cancellation.
const CHECK: usize = 512;

/// Returns whether the path of a marked distance bends around the boundary.
#[inline(always)]
pub fn is_bent(distance: f32) -> bool {
    distance.to_bits() & 1 == 1
}

#[inline(always)]
pub(crate) fn marked(distance: f32, is_bent: bool) -> f32 {
    f32::from_bits(distance.to_bits() & !1 | u32::from(is_bent))
}

/// Marked distances from sources.
#[derive(Debug)]
pub struct MarkedRows(DistanceRows);

impl MarkedRows {
    /// Creates rows from marked distances.
    pub(crate) fn new(rows: DistanceRows) -> Self {
        Self(rows)
    }

    /// Computes the distances from sources to targets.
    ///
    /// # Errors
    /// Those of [`DistanceRows::compute_to`].
    pub(crate) fn compute_to<S: Solver>(
        marking: &Marking<S>, sources: &[u32], targets: &[u32], control: &Control,
    ) -> Result<Self> {
        Ok(Self(DistanceRows::compute_to(marking, sources, targets, control)?))
    }

    /// Selects targets from complete rows of the marking's solver.
    ///
    /// # Errors
    /// Those of reading the rows.
    pub(crate) fn take<S: Solver>(
        rows: &impl Rows, marking: &Marking<S>, targets: &[u32], control: &Control,
    ) -> Result<Self> {
        let (sources, columns) = (rows.sources(), rows.columns());
        let mut data = vec![0.0; sources.len() * targets.len()];
        let mut scratch = marking.scratch();
        rows.visit(control, &mut |first, some| {
            let numbers = (first..).zip(some.chunks(columns.max(1))).collect::<Vec<_>>();
            for group in numbers.chunks(MOST_SOURCES) {
                let (number, complete) = (group[0].0, group.iter().map(|&(_, row)| row).collect::<Vec<_>>());
                let of = number..number + group.len();
                let to = &mut data[of.start * targets.len()..of.end * targets.len()];
                let mut to: Vec<&mut [f32]> = to.chunks_exact_mut(targets.len().max(1)).collect();
                marking.mark(&sources[of], &complete, Some(targets), &mut to, &mut scratch, control)?;
            }
            Ok(())
        })?;
        Ok(Self(DistanceRows::new(sources.to_vec(), targets.len(), data)))
    }

    /// Returns the rows with other numbers of their sources. Panics if the number of sources differs.
    pub(crate) fn renamed(self, sources: Vec<u32>) -> Self {
        Self(DistanceRows::new(sources, self.0.columns(), self.0.into_data()))
    }

    /// Returns the rows, whose distances are marked.
    pub fn into_rows(self) -> DistanceRows {
        self.0
    }
}

/// The distances of a solver, marked by the paths along the links of a graph.
#[derive(Debug, Clone, Copy)]
pub struct Marking<'a, S = GeodesicGraph> {
    solver: &'a S,
    graph: &'a GeodesicGraph,
}

impl<'a> Marking<'a> {
    /// Returns the memory in bytes that one worker needs, beside that of the solver.
    pub(crate) const fn memory_need(vertices: usize) -> u64 {
        let (complete, lanes, order, interior) = (4 * MOST_SOURCES, 2 * size_of::<Lanes>(), 8, 2);
        (complete + lanes + order + interior) as u64 * vertices as u64
    }

    /// Marks the distances along the links themselves.
    pub fn new(graph: &'a GeodesicGraph) -> Self {
        Self { solver: graph, graph }
    }
}

impl<'a, S: Solver> Marking<'a, S> {
    /// Marks the distances of any solver on the same surface.
    pub fn of(solver: &'a S, graph: &'a GeodesicGraph) -> Self {
        Self { solver, graph }
    }

    /// Writes the marked distances to the targets, or to all vertices, given the solver's complete rows of a few sources.
    fn mark(
        &self, sources: &[u32], complete: &[&[f32]], targets: Option<&[u32]>, rows: &mut [&mut [f32]],
        scratch: &mut Scratch<S>, control: &Control,
    ) -> Result<()> {
        let Scratch { bundle, along_links, paths, .. } = scratch;
        if self.solver.is_along_straight_links() {
            paths.trace(self.graph, sources, complete, control)?;
        } else {
            along_links.resize(sources.len() * self.columns(), 0.0);
            let mut each: Vec<&mut [f32]> = along_links.chunks_exact_mut(self.columns().max(1)).collect();
            self.graph.rows(sources, None, &mut each, bundle, control)?;
            let each: Vec<&[f32]> = along_links.chunks_exact(self.columns().max(1)).collect();
            paths.trace(self.graph, sources, &each, control)?;
        }
        for (number, (row, to)) in complete.iter().zip(rows).enumerate() {
            for (column, to) in to.iter_mut().enumerate() {
                let target = targets.map_or(column, |targets| targets[column] as usize);
                *to = marked(row[target], !paths.is_interior(number, target));
            }
        }
        Ok(())
    }
}

/// The adjacent distances from up to [`MOST_SOURCES`] sources.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
struct Lanes([f32; MOST_SOURCES]);

const NONE: Lanes = Lanes([f32::INFINITY; MOST_SOURCES]);

/// For each vertex, the sources from which a shortest path does not pass the boundary, as bits. Buffers are reused.
#[derive(Debug, Default)]
struct InteriorPaths {
    distances: Vec<Lanes>,
    /// The vertices in the order of their distances from the first source, below the bits of these distances.
    order: Vec<u64>,
    interior: Vec<u16>,
    /// The distances of those whose paths may continue from each vertex; infinity for the others. From a vertex of the
    /// boundary, only paths continue that begin there.
    continued: Vec<Lanes>,
}

impl InteriorPaths {
    /// Finds the paths from some sources, given their complete distances along the links of a graph.
    fn trace(&mut self, graph: &GeodesicGraph, sources: &[u32], rows: &[&[f32]], control: &Control) -> Result<()> {
        let Self { distances, order, interior, continued } = self;
        let vertices = graph.vertices();
        distances.clear();
        distances.resize(vertices, NONE);
        for (lane, row) in rows.iter().enumerate() {
            control.check()?;
            distances.iter_mut().zip(*row).for_each(|(lanes, &distance)| lanes.0[lane] = distance);
        }
        order.clear();
        // distances are not negative, so their bits have the same order
        order.extend((0..).zip(rows[0]).map(|(vertex, from)| u64::from(from.to_bits()) << 32 | vertex));
        order.sort_unstable();
        interior.clear();
        interior.resize(vertices, 0);
        continued.clear();
        continued.resize(vertices, NONE);
        for (lane, &source) in sources.iter().enumerate() {
            interior[source as usize] |= 1 << lane;
            continued[source as usize].0[lane] = 0.0;
        }
        let all = u16::MAX >> (MOST_SOURCES - sources.len());
        Arch::new().dispatch(Tracing { graph, paths: self, all, control })
    }

    fn is_interior(&self, number: usize, vertex: usize) -> bool {
        self.interior[vertex] >> number & 1 == 1
    }
}

struct Tracing<'a> {
    graph: &'a GeodesicGraph,
    paths: &'a mut InteriorPaths,
    /// The bits of all sources.
    all: u16,
    control: &'a Control,
}

impl WithSimd for Tracing<'_> {
    type Output = Result<()>;

    /// Sweeps to and fro until nothing changes. Most vertices come after those before them on their paths.
    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _: S) -> Result<()> {
        let vertices = self.paths.order.len();
        loop {
            let forward = (0..vertices).try_fold(false, |changed, place| Ok(changed | self.visit(place)?))?;
            if !forward {
                return Ok(());
            }
            let backward = (0..vertices).rev().try_fold(false, |changed, place| Ok(changed | self.visit(place)?))?;
            if !backward {
                return Ok(());
            }
        }
    }
}

impl Tracing<'_> {
    /// Continues paths to the vertex at a place of the order; returns whether there are new ones.
    #[inline(always)]
    fn visit(&mut self, place: usize) -> Result<bool> {
        if place.is_multiple_of(CHECK) {
            self.control.check()?;
        }
        let InteriorPaths { distances, order, interior, continued } = &mut *self.paths;
        let vertex = order[place] as u32;
        let known = interior[vertex as usize];
        if known == self.all {
            return Ok(false);
        }
        let Lanes(reached) = distances[vertex as usize];
        let mut leads_here = [0u32; MOST_SOURCES];
        for arc in self.graph.arcs(vertex) {
            let Lanes(from) = &continued[arc.to as usize];
            for lane in 0..MOST_SOURCES {
                // the distances were made by the same sums of the same numbers, so equality is exact
                leads_here[lane] |= u32::from(from[lane] + arc.length == reached[lane]);
            }
        }
        let mut found = known;
        for lane in 0..MOST_SOURCES {
            let is_finite = leads_here[lane] > 0 && reached[lane] < f32::INFINITY;
            found |= u16::from(is_finite) << lane;
            if is_finite && !self.graph.is_on_boundary(vertex) {
                continued[vertex as usize].0[lane] = reached[lane];
            }
        }
        interior[vertex as usize] = found;
        Ok(found != known)
    }
}

/// Buffers of a worker that are reused for all rows.
#[derive(Debug)]
pub struct Scratch<S: Solver> {
    solver: S::Scratch,
    bundle: BundleScratch,
    along_links: Vec<f32>,
    complete: Vec<f32>,
    paths: InteriorPaths,
}

impl<S: Solver> Solver for Marking<'_, S> {
    type Scratch = Scratch<S>;

    fn scratch(&self) -> Scratch<S> {
        Scratch {
            solver: self.solver.scratch(),
            bundle: BundleScratch::new(self.graph),
            along_links: Vec::new(),
            complete: Vec::new(),
            paths: InteriorPaths::default(),
        }
    }

    fn columns(&self) -> usize {
        self.solver.columns()
    }

    fn row(&self, source: u32, row: &mut [f32], scratch: &mut Scratch<S>, control: &Control) -> Result<()> {
        self.rows(&[source], None, &mut [row], scratch, control)
    }

    fn bundles(&self, sources: &[u32], threads: usize, control: &Control) -> Result<Vec<Vec<u32>>> {
        self.solver.bundles(sources, threads, control)
    }

    fn rows(
        &self, bundle: &[u32], targets: Option<&[u32]>, rows: &mut [&mut [f32]], scratch: &mut Scratch<S>,
        control: &Control,
    ) -> Result<()> {
        let columns = self.columns();
        let mut complete = mem::take(&mut scratch.complete);
        complete.resize(bundle.len() * columns, 0.0);
        let mut each: Vec<&mut [f32]> = complete.chunks_exact_mut(columns.max(1)).collect();
        self.solver.rows(bundle, None, &mut each, &mut scratch.solver, control)?;
        let each: Vec<&[f32]> = complete.chunks_exact(columns.max(1)).collect();
        self.mark(bundle, &each, targets, rows, scratch, control)?;
        scratch.complete = complete;
        Ok(())
    }

    fn fingerprint(&self, control: &Control) -> Result<u64> {
        self.solver.fingerprint(control)
    }

    fn tells_bends(&self) -> bool {
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geodesic::exact::Exact;
    use crate::surface::{Surface, mesh::shapes};
    use crate::tests::with_threads;

    /// Returns a sheet of 30 x 20 mm with a notch of 10 x 15 mm.
    fn notched() -> Surface {
        let sheet = shapes::surface(shapes::sheet(30, 20));
        let is_kept = |p: &nalgebra::Vector3<f64>| !(p.x > 10.0 && p.x < 20.0 && p.y > 5.0);
        sheet.part_of_vertices(&sheet.points().iter().map(is_kept).collect::<Vec<_>>()).unwrap()
    }

    #[test]
    fn a_path_is_bent_where_it_is_longer_than_the_straight_line() {
        let surface = notched();
        let graph = GeodesicGraph::new(&surface, &Control::default()).unwrap();
        let sources: Vec<u32> = (0..surface.len() as u32).step_by(7).collect();
        let rows = DistanceRows::compute(&Marking::new(&graph), &sources, &Control::default()).unwrap();
        let plain = DistanceRows::compute(&graph, &sources, &Control::default()).unwrap();
        let (mut bent, mut along_boundary) = (0, 0);
        for (n, &source) in sources.iter().enumerate() {
            for (vertex, (&distance, plain)) in rows.row(n).iter().zip(plain.row(n)).enumerate() {
                let straight = (surface.points()[source as usize] - surface.points()[vertex]).norm();
                let excess = f64::from(*plain) / straight - 1.0;
                assert!(is_bent(distance) || straight == 0.0 || excess < 5e-3, "{source} {vertex} {excess}");
                assert!((distance - plain).abs() <= f32::EPSILON * plain);
                bent += u32::from(excess > 1e-3);
                along_boundary += u32::from(is_bent(distance) && excess <= 1e-3);
            }
        }
        assert!(bent > 5000 && along_boundary < bent / 5, "{bent} {along_boundary}");
    }

    #[test]
    fn a_closed_surface_has_no_bent_path() {
        let surface = shapes::surface(shapes::sphere(3));
        let graph = GeodesicGraph::new(&surface, &Control::default()).unwrap();
        let rows = DistanceRows::compute(&Marking::new(&graph), &[0, 17], &Control::default()).unwrap();
        assert!(rows.into_data().into_iter().all(|distance| !is_bent(distance)));
    }

    #[test]
    fn marks_do_not_depend_on_bundles_threads_or_how_rows_are_kept() {
        let surface = notched();
        let control = Control::default();
        let graph = GeodesicGraph::new(&surface, &control).unwrap();
        let sources: Vec<u32> = (0..surface.len() as u32).step_by(4).collect();
        let targets: Vec<u32> = (0..surface.len() as u32).rev().step_by(3).collect();
        let marking = Marking::new(&graph);
        assert!(marking.bundles(&sources, 1, &control).unwrap().len() < sources.len());
        let mut scratch = marking.scratch();
        let mut expected = vec![0.0; sources.len() * targets.len()];
        for (&source, row) in sources.iter().zip(expected.chunks_exact_mut(targets.len())) {
            marking.rows(&[source], Some(&targets), &mut [row], &mut scratch, &control).unwrap();
        }
        for threads in [1, 2, 7] {
            let rows = with_threads(threads, || DistanceRows::compute_to(&marking, &sources, &targets, &control));
            assert!(rows.unwrap().into_data() == expected);
        }
        let complete = DistanceRows::compute(&graph, &sources, &control).unwrap();
        assert!(MarkedRows::take(&complete, &marking, &targets, &control).unwrap().0.into_data() == expected);
    }

    #[test]
    fn distances_of_another_solver_have_the_same_marks() {
        let surface = notched();
        let control = Control::default();
        let (graph, exact) = (GeodesicGraph::new(&surface, &control).unwrap(), Exact::new(&surface));
        let (sources, targets) = ([3, 40, 300], [1, 5, 77, 200, 350]);
        let along_links = DistanceRows::compute_to(&Marking::new(&graph), &sources, &targets, &control).unwrap();
        let marking = Marking::of(&exact, &graph);
        let found = MarkedRows::compute_to(&marking, &sources, &targets, &control).unwrap().into_rows();
        let expected = DistanceRows::compute_to(&exact, &sources, &targets, &control).unwrap();
        let kept = DistanceRows::compute(&exact, &sources, &control).unwrap();
        assert_eq!(MarkedRows::take(&kept, &marking, &targets, &control).unwrap().into_rows(), found);
        let of_found = found.into_data().into_iter().zip(expected.into_data()).zip(along_links.into_data());
        for ((found, exact), along_link) in of_found {
            assert_eq!(found, marked(exact, is_bent(along_link)));
        }
    }
}
