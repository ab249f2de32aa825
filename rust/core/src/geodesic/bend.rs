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

use super::graph::GeodesicGraph;
use super::solver::Solver;
use crate::adjacency::Links;
use crate::geodesic::bundle::BundleScratch;
use crate::rows::{DistanceRows, Rows};
use crate::{Control, Result};

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
        let sources = rows.sources();
        let mut data = vec![0.0; sources.len() * targets.len()];
        let mut taken = data.chunks_exact_mut(targets.len().max(1)).zip(sources);
        let mut scratch = marking.scratch();
        rows.visit(control, &mut |_, some| {
            for (row, (to, &source)) in some.chunks(rows.columns().max(1)).zip(&mut taken) {
                marking.mark(source, row, Some(targets), to, &mut scratch, control)?;
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

    /// Writes the marked distances to the targets, or to all vertices, given the solver's complete row of a source.
    fn mark(
        &self, source: u32, row: &[f32], targets: Option<&[u32]>, to: &mut [f32], scratch: &mut Scratch<S>,
        control: &Control,
    ) -> Result<()> {
        control.check()?;
        let Scratch { bundle, along_links, tracing, .. } = scratch;
        let along_links = if self.solver.is_along_straight_links() {
            row
        } else {
            along_links.resize(row.len(), 0.0);
            bundle.row(self.graph, source, along_links, control)?;
            along_links
        };
        tracing.begin(source, row.len());
        for (column, to) in to.iter_mut().enumerate() {
            let target = targets.map_or(column as u32, |targets| targets[column]);
            *to = marked(row[target as usize], tracing.bends(self.graph, along_links, source, target));
        }
        Ok(())
    }
}

/// What is known of the shortest path to a vertex.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Path {
    Unknown,
    Interior,
    Bent,
}

/// Buffers for tracing paths back.
#[derive(Debug, Default)]
struct Tracing {
    known: Vec<Path>,
    /// The vertices of a path back to one whose path is known.
    back: Vec<u32>,
}

impl Tracing {
    fn begin(&mut self, source: u32, vertices: usize) {
        self.known.clear();
        self.known.resize(vertices, Path::Unknown);
        self.known[source as usize] = Path::Interior;
    }

    /// Returns whether the shortest path to a target passes the boundary before its end.
    fn bends(&mut self, graph: &GeodesicGraph, row: &[f32], source: u32, target: u32) -> bool {
        let Self { known, back } = self;
        let mut vertex = target;
        while known[vertex as usize] == Path::Unknown {
            back.push(vertex);
            match before(graph, vertex, row) {
                Some(before) => vertex = before,
                None => known[vertex as usize] = Path::Interior, // at the place of the source, or out of reach
            }
        }
        for next in back.drain(..).rev() {
            let passes_boundary = graph.is_on_boundary(vertex) && vertex != source && vertex != next;
            let is_bent = passes_boundary || known[vertex as usize] == Path::Bent;
            known[next as usize] = if is_bent { Path::Bent } else { Path::Interior };
            vertex = next;
        }
        known[target as usize] == Path::Bent
    }
}

/// Returns the vertex before the last one on a shortest path, the first of several.
fn before(graph: &GeodesicGraph, vertex: u32, row: &[f32]) -> Option<u32> {
    let reached = row[vertex as usize];
    // the row was made by the same sum of the same numbers, so equality is exact
    let leads_here = |from: f32, length: f32| from < reached && from + length == reached;
    graph.arcs(vertex).find(|arc| leads_here(row[arc.to as usize], arc.length)).map(|arc| arc.to)
}

/// Buffers of a worker that are reused for all rows.
#[derive(Debug)]
pub struct Scratch<S: Solver> {
    solver: S::Scratch,
    bundle: BundleScratch,
    along_links: Vec<f32>,
    complete: Vec<f32>,
    tracing: Tracing,
}

impl<S: Solver> Solver for Marking<'_, S> {
    type Scratch = Scratch<S>;

    fn scratch(&self) -> Scratch<S> {
        Scratch {
            solver: self.solver.scratch(),
            bundle: BundleScratch::new(self.graph),
            along_links: Vec::new(),
            complete: Vec::new(),
            tracing: Tracing::default(),
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
        for ((&source, row), to) in bundle.iter().zip(each).zip(rows) {
            self.mark(source, row, targets, to, scratch, control)?;
        }
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
