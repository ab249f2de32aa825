//! Rows of many sources at once by sweeps over a contraction hierarchy.
//!
//! The distances of a batch of sources lie side by side. They are first carried upward, along the shortcuts from the
//! sources to all separators above them; then one pass over all vertices, in the order of the dissection, takes for each
//! the nearest way through what is above it (Delling, Goldberg, Nowatzyk, Werneck 2011, "PHAST"). Only what is above the
//! present vertex has to be remembered: some thousand vertices, which fit into the processor's cache.

mod contraction;
mod dissection;
mod lengths;

use pulp::{Arch, Simd, WithSimd};

use crate::adjacency::Links;
use crate::control::Control;
use crate::error::Result;
use crate::geodesic::shortest::is_sparse;
use contraction::{Contraction, Plan};
use dissection::{Dissection, NONE, Part};
use lengths::FAR;

/// Sources of one sweep: a multiple of [`BLOCK`].
pub(crate) const LANES: usize = 64;

/// Sources of one sweep where there are no more.
const FEW_LANES: usize = BLOCK;

/// Fewer sources are not worth a plan.
const FEWEST_SOURCES: usize = 150;

/// Smaller graphs have their rows at once either way.
const FEWEST_VERTICES: usize = 1000;

/// What a link costs in a search, ns a row, in sparse graphs and in others: more where they do not fit into the cache.
const LINK_NS: [f64; 2] = [4.0, 2.6];

/// What a length of the tables costs in a sweep, ns a row: the time of a shortcut by the share of shortcuts that are kept.
const FILL_NS: f64 = 0.06;

/// What a comparison of the contraction costs, ns.
const WORK_NS: f64 = 0.12;

/// Lanes that are lowered together, in the processor's registers.
const BLOCK: usize = 32;

// lanes beyond the last whole block would keep wrong distances
const _: () = assert!(LANES.is_multiple_of(BLOCK) && FEW_LANES.is_multiple_of(BLOCK));

/// Distances from a batch of sources, side by side.
type Lanes<const L: usize> = [i32; L];

/// A graph that was prepared for sweeps.
#[derive(Debug)]
pub struct Sweep {
    contraction: Contraction,
    cost: Cost,
}

/// What a prepared graph costs and gains.
#[derive(Debug, Clone, Copy)]
struct Cost {
    /// Its size.
    bytes: f64,
    /// Preparing it, ns.
    preparing: f64,
    /// The row of a source, ns less than by a search.
    gain: f64,
}

impl Cost {
    fn of<G: Links>(graph: &G, plan: &Plan) -> Self {
        let vertices = graph.vertices() as f64;
        let sample: Vec<u32> = (0..graph.vertices() as u32).step_by(graph.vertices() / 1000 + 1).collect();
        let links = sample.iter().map(|&vertex| graph.arcs(vertex).count()).sum::<usize>() as f64 / sample.len() as f64;
        let fill = plan.bytes() / 4.0 / vertices;
        let link = LINK_NS[usize::from(!is_sparse(graph))];
        let gain = (link * links - FILL_NS * fill) * vertices;
        Self { bytes: plan.bytes(), preparing: WORK_NS * plan.work(), gain }
    }

    /// Is it worth preparing for so many sources, in so many bytes?
    fn pays(&self, sources: usize, bytes: u64) -> bool {
        sources >= FEWEST_SOURCES && self.bytes <= bytes as f64 && self.gain * sources as f64 >= self.preparing
    }
}

/// What a worker keeps from one batch to the next.
#[derive(Debug, Default)]
pub struct SweepScratch {
    /// Distances of the vertices above the present one, by slot.
    above: Vec<i32>,
    /// Distances of the vertices of the marked parts, upward only.
    upward: Vec<i32>,
    /// The parts above a source, ascending.
    marked: Vec<u32>,
    /// Where a part's distances are in `upward`; [`NONE`] if it is not marked.
    places: Vec<u32>,
}

/// Vertices to which distances are wanted.
#[derive(Debug)]
pub struct SweepTargets {
    /// The rank of each, ascending, and its column.
    columns: Vec<(u32, u32)>,
    /// Which parts are above a target or hold one.
    parts: Vec<bool>,
}

impl Sweep {
    /// The memory in bytes that a prepared graph of a surface's vertices takes: some 220 shortcuts of eight bytes a vertex, as
    /// many as 300,000 vertices have (docs/decisions/0010). The tables they are found in are smaller than the rows, and
    /// gone before these.
    pub const fn memory_need_of_surface(vertices: usize) -> u64 {
        8 * 220 * vertices as u64
    }

    /// The same of voxels: 36 shortcuts of eight bytes, as many as a million voxels have, and 110 lengths of four bytes
    /// in the tables they are found in.
    pub const fn memory_need_of_voxels(voxels: usize) -> u64 {
        (8 * 36 + 4 * 110) * voxels as u64
    }

    /// Prepares a graph, whatever it costs.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    pub fn new<G: Links>(graph: &G, control: &Control) -> Result<Self> {
        control.begin("preparing distances", 1);
        let plan = Plan::new(graph, control)?;
        let cost = Cost::of(graph, &plan);
        Ok(Self { contraction: Contraction::new(graph, plan, control)?, cost })
    }

    /// Prepares a graph if that is the faster way to the rows of so many sources and needs no more than so many bytes. This
    /// depends on the graph and these numbers only (docs/decisions/0010).
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    pub fn where_it_pays<G: Links>(graph: &G, sources: usize, bytes: u64, control: &Control) -> Result<Option<Self>> {
        if sources < FEWEST_SOURCES || graph.vertices() < FEWEST_VERTICES {
            return Ok(None);
        }
        control.begin("preparing distances", 1);
        let plan = Plan::new(graph, control)?;
        let cost = Cost::of(graph, &plan);
        if !cost.pays(sources, bytes) {
            return Ok(None);
        }
        Ok(Some(Self { contraction: Contraction::new(graph, plan, control)?, cost }))
    }

    /// Is it worth preparing for so many sources, in so many bytes?
    pub fn pays(&self, sources: usize, bytes: u64) -> bool {
        self.cost.pays(sources, bytes)
    }

    /// Number of vertices.
    pub fn columns(&self) -> usize {
        self.contraction.dissection.order.len()
    }

    /// What has to be swept to reach some vertices only.
    pub fn targets(&self, vertices: &[u32]) -> SweepTargets {
        let Dissection { ranks, parts, .. } = &self.contraction.dissection;
        let mut columns: Vec<_> = vertices.iter().map(|&vertex| ranks[vertex as usize]).zip(0..).collect();
        columns.sort_unstable();
        let mut above = vec![false; parts.len()];
        for &(rank, _) in &columns {
            let mut part = self.part_of(rank);
            while part != NONE && !above[part as usize] {
                above[part as usize] = true;
                part = parts[part as usize].parent;
            }
        }
        SweepTargets { columns, parts: above }
    }

    /// Writes the distances in mm from each source to every vertex, or to the targets: a row a source; infinity where a vertex
    /// cannot be reached.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    ///
    /// # Panics
    /// If there is not one row a source.
    pub fn rows(
        &self,
        sources: &[u32],
        targets: Option<&SweepTargets>,
        rows: &mut [&mut [f32]],
        scratch: &mut SweepScratch,
        control: &Control,
    ) -> Result<()> {
        assert_eq!(rows.len(), sources.len(), "one row a source");
        for (sources, rows) in sources.chunks(LANES).zip(rows.chunks_mut(LANES)) {
            if sources.len() > FEW_LANES {
                Arch::new().dispatch(Batch::<LANES> { sweep: self, sources, targets, rows, scratch, control })?;
            } else {
                Arch::new().dispatch(Batch::<FEW_LANES> { sweep: self, sources, targets, rows, scratch, control })?;
            }
        }
        Ok(())
    }

    fn part_of(&self, rank: u32) -> u32 {
        self.contraction.dissection.parts.partition_point(|part| part.first + part.len <= rank) as u32
    }

    /// Gives the vertex at `slot` the least of `start` and of the ways through the vertices above it.
    #[inline(always)]
    fn lower_from_above<const L: usize>(&self, rank: u32, slot: usize, start: Lanes<L>, above: &mut [Lanes<L>]) {
        let Contraction { starts, shortcuts, .. } = &self.contraction;
        let shortcuts = &shortcuts[starts[rank as usize]..starts[rank as usize + 1]];
        let (found, _) = start.as_chunks::<BLOCK>();
        for (block, &start) in found.iter().enumerate() {
            let mut least = start;
            for shortcut in shortcuts {
                let through = &above[shortcut.slot as usize].as_chunks::<BLOCK>().0[block];
                for lane in 0..BLOCK {
                    least[lane] = least[lane].min(through[lane] + shortcut.length);
                }
            }
            above[slot].as_chunks_mut::<BLOCK>().0[block] = least;
        }
    }

    /// Carries the distances from the sources upward.
    #[inline(always)]
    fn upward<const L: usize>(&self, sources: &[u32], scratch: &mut SweepScratch, control: &Control) -> Result<()> {
        let Contraction { dissection, starts, shortcuts, .. } = &self.contraction;
        let parts = &dissection.parts;
        let SweepScratch { upward, marked, places, .. } = scratch;
        if places.len() != parts.len() {
            places.resize(parts.len(), NONE);
        }
        for part in marked.drain(..) {
            places[part as usize] = NONE; // what the batch before left
        }
        for &source in sources {
            let mut part = self.part_of(dissection.ranks[source as usize]);
            while part != NONE && places[part as usize] == NONE {
                places[part as usize] = 0;
                marked.push(part);
                part = parts[part as usize].parent;
            }
        }
        marked.sort_unstable();
        let mut size = 0;
        for &part in marked.iter() {
            places[part as usize] = size;
            size += parts[part as usize].len;
        }
        upward.clear();
        upward.resize(size as usize * L, FAR);
        let (upward, _) = upward.as_chunks_mut::<L>();
        for (lane, &source) in sources.iter().enumerate() {
            let rank = dissection.ranks[source as usize];
            let part = self.part_of(rank) as usize;
            upward[(places[part] + rank - parts[part].first) as usize][lane] = 0;
        }
        for &number in marked.iter().rev() {
            control.check()?;
            let chain = chain(parts, places, number);
            let part = parts[number as usize];
            for n in (0..part.len).rev() {
                let rank = (part.first + n) as usize;
                let lanes = upward[(places[number as usize] + n) as usize];
                let mut link = chain.iter();
                let [mut end, mut slot, mut place] = [0; 3];
                for shortcut in &shortcuts[starts[rank]..starts[rank + 1]] {
                    while shortcut.slot >= end {
                        [end, slot, place] = *link.next().expect("the slots of shortcuts lie above");
                    }
                    let target = &mut upward[(place + shortcut.slot - slot) as usize];
                    for lane in 0..L {
                        target[lane] = target[lane].min(lanes[lane] + shortcut.length);
                    }
                }
            }
        }
        Ok(())
    }
}

/// One sweep.
struct Batch<'a, 'b, const L: usize> {
    sweep: &'a Sweep,
    sources: &'a [u32],
    targets: Option<&'a SweepTargets>,
    rows: &'a mut [&'b mut [f32]],
    scratch: &'a mut SweepScratch,
    control: &'a Control,
}

impl<const L: usize> WithSimd for Batch<'_, '_, L> {
    type Output = Result<()>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Result<()> {
        let Self { sweep, sources, targets, rows, scratch, control } = self;
        let Contraction { dissection, depth, quantum, .. } = &sweep.contraction;
        sweep.upward::<L>(sources, scratch, control)?;
        let SweepScratch { above, upward, places, .. } = scratch;
        above.resize(depth * L, FAR);
        let (above, _) = above.as_chunks_mut::<L>();
        let (upward, _) = upward.as_chunks::<L>();
        let mut found: Vec<[f32; L]> = Vec::new();
        let mut wanted = targets.map_or(&[][..], |targets| &targets.columns);
        for (number, part) in dissection.parts.iter().enumerate() {
            if number % 64 == 0 {
                control.check()?;
            }
            if targets.is_some_and(|targets| !targets.parts[number]) {
                continue;
            }
            let first = places[number];
            for n in 0..part.len {
                let start = if first == NONE { [FAR; L] } else { upward[(first + n) as usize] };
                sweep.lower_from_above(part.first + n, (part.slot + n) as usize, start, above);
            }
            found.clear();
            for lanes in &above[part.slot as usize..][..part.len as usize] {
                found.push(in_mm(lanes, *quantum));
            }
            if targets.is_some() {
                let (here, behind) = wanted.split_at(wanted.partition_point(|&(rank, _)| rank < part.first + part.len));
                write(rows, here.iter().map(|&(rank, column)| (column, &found[(rank - part.first) as usize])));
                wanted = behind;
            } else {
                let vertices = &dissection.order[part.first as usize..][..part.len as usize];
                write(rows, vertices.iter().copied().zip(&found));
            }
        }
        Ok(())
    }
}

/// Distances in mm. Loops, for closures are not compiled for the widest instructions.
#[inline(always)]
fn in_mm<const L: usize>(lanes: &Lanes<L>, quantum: f32) -> [f32; L] {
    let mut found = [f32::INFINITY; L];
    for lane in 0..L {
        let length = lanes[lane] as f32 * quantum;
        found[lane] = if lanes[lane] == FAR { f32::INFINITY } else { length };
    }
    found
}

/// Writes columns of distances into the rows, one row a lane.
#[inline(always)]
fn write<'a, const L: usize>(rows: &mut [&mut [f32]], columns: impl Iterator<Item = (u32, &'a [f32; L])> + Clone) {
    for (lane, row) in rows.iter_mut().enumerate() {
        for (column, lanes) in columns.clone() {
            row[column as usize] = lanes[lane];
        }
    }
}

/// The parts from the first above a part to itself: the slot behind each, its first slot, and where its distances are.
fn chain(parts: &[Part], places: &[u32], part: u32) -> Vec<[u32; 3]> {
    let mut chain = Vec::new();
    let mut next = part;
    while next != NONE {
        let part = parts[next as usize];
        chain.push([part.slot + part.len, part.slot, places[next as usize]]);
        next = part.parent;
    }
    chain.reverse();
    chain
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::adjacency::Listed;
    use crate::error::Error;
    use crate::geodesic::Solver;
    use crate::geodesic::chain::LinkLengths;
    use crate::geodesic::chain::chain_graph;
    use crate::geodesic::graph::GeodesicGraph;
    use crate::surface::VoxelSurface;
    use crate::surface::mesh::shapes;
    use crate::surface::voxels::graph::VoxelGraph;
    use crate::volume::{Affine, Mask};
    use proptest::prelude::*;

    /// Dijkstra's algorithm without a queue, over the lengths as the sweep rounds them: every sum is exact.
    fn dijkstra(graph: &impl Links, quantum: f64, source: u32) -> Vec<f32> {
        let mut distance = vec![f64::INFINITY; graph.vertices()];
        let mut open: Vec<u32> = (0..graph.vertices() as u32).collect();
        distance[source as usize] = 0.0;
        while !open.is_empty() {
            let next =
                (0..open.len()).min_by(|&a, &b| distance[open[a] as usize].total_cmp(&distance[open[b] as usize]));
            let vertex = open.swap_remove(next.unwrap());
            for arc in graph.arcs(vertex) {
                let through = distance[vertex as usize] + (f64::from(arc.length) / quantum).round().max(1.0) * quantum;
                distance[arc.to as usize] = distance[arc.to as usize].min(through);
            }
        }
        distance.into_iter().map(|distance| distance as f32).collect()
    }

    fn voxel_graph(mask: &Mask, spacing: [f64; 3]) -> VoxelGraph {
        let control = Control::default();
        let surface = VoxelSurface::from_mask(mask, Affine::from_spacing(spacing).unwrap(), &control).unwrap();
        chain_graph(&surface, LinkLengths::ChainCode, &control).unwrap()
    }

    fn rows_of(sweep: &Sweep, sources: &[u32]) -> Vec<f32> {
        let mut rows = vec![f32::NAN; sources.len() * sweep.columns()];
        let mut each: Vec<_> = rows.chunks_mut(sweep.columns().max(1)).collect();
        sweep.rows(sources, None, &mut each, &mut SweepScratch::default(), &Control::default()).unwrap();
        rows
    }

    /// Every row of a sweep is that of Dijkstra's algorithm, bit by bit, and that of a search but for rounding.
    fn check_rows(graph: &impl Links, sources: &[u32]) {
        let control = Control::default();
        let sweep = Sweep::new(graph, &control).unwrap();
        let rows = rows_of(&sweep, sources);
        let mut searched = vec![0.0; graph.vertices()];
        for (row, &source) in rows.chunks(graph.vertices()).zip(sources) {
            assert_eq!(row, dijkstra(graph, f64::from(sweep.contraction.quantum), source));
            graph.row(source, &mut searched, &mut graph.scratch(), &control).unwrap();
            for (&swept, &searched) in row.iter().zip(&searched) {
                assert!(swept == searched || (swept - searched).abs() <= 1e-5 * searched, "{swept} {searched}");
            }
        }
    }

    fn every_third(graph: &impl Links) -> Vec<u32> {
        (0..graph.vertices() as u32).step_by(3).collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn rows_of_any_graph_are_those_of_dijkstra(
            vertices in 1usize..220,
            links in prop::collection::vec((any::<prop::sample::Index>(), any::<prop::sample::Index>(), 0.2f32..9.0), 0..600),
        ) {
            let ends = links.iter().map(|(a, b, length)| (a.index(vertices) as u32, b.index(vertices) as u32, *length));
            let graph = Listed::new(vertices, &ends.filter(|(a, b, _)| a != b).collect::<Vec<_>>());
            check_rows(&graph, &every_third(&graph));
        }

        #[test]
        fn rows_over_voxels_are_those_of_dijkstra(
            bits in prop::collection::vec(prop::bool::weighted(0.4), 7 * 8 * 9),
            z in 0.15f64..7.0,
        ) {
            prop_assume!(bits.contains(&true));
            let graph = voxel_graph(&Mask::new([7, 8, 9], bits).unwrap(), [1.0, 1.3, z]);
            check_rows(&graph, &every_third(&graph));
        }
    }

    #[test]
    fn rows_over_triangles_are_those_of_dijkstra() {
        for shape in [shapes::sphere(3), shapes::torus(24, 13), shapes::sheet(19, 31)] {
            let graph = GeodesicGraph::new(&shapes::surface(shape), &Control::default()).unwrap();
            check_rows(&graph, &[0, 7, 100, 250]);
        }
    }

    #[test]
    fn a_row_is_the_same_in_any_company() {
        let graph =
            voxel_graph(&Mask::from_fn([40, 40, 2], |[i, j, k]| k == usize::from(i + j > 37)).unwrap(), [1.0; 3]);
        let sweep = Sweep::new(&graph, &Control::default()).unwrap();
        let sources: Vec<u32> = (0..200).map(|n| n * 7919 % graph.len() as u32).collect();
        let together = rows_of(&sweep, &sources);
        let mut scratch = SweepScratch::default();
        let mut row = vec![0.0; graph.len()];
        for (n, &source) in sources.iter().enumerate() {
            sweep.rows(&[source], None, &mut [&mut row], &mut scratch, &Control::default()).unwrap();
            assert_eq!(row, together[n * graph.len()..(n + 1) * graph.len()]);
        }
    }

    #[test]
    fn targets_are_columns_of_the_rows() {
        let graph = voxel_graph(&Mask::from_fn([30, 50, 1], |[i, _, _]| i != 20).unwrap(), [1.0; 3]); // two pieces
        let sweep = Sweep::new(&graph, &Control::default()).unwrap();
        let sources: Vec<u32> = (0..70).map(|n| n * 19).collect();
        let targets: [u32; 6] = [900, 3, 3, 1200, 57, 1444]; // one of them twice
        let mut columns = vec![f32::NAN; sources.len() * targets.len()];
        let (mut scratch, control) = (SweepScratch::default(), Control::default());
        let mut each: Vec<_> = columns.chunks_mut(targets.len()).collect();
        sweep.rows(&sources, Some(&sweep.targets(&targets)), &mut each, &mut scratch, &control).unwrap();
        let rows = rows_of(&sweep, &sources);
        for (columns, row) in columns.chunks(targets.len()).zip(rows.chunks(graph.len())) {
            assert_eq!(columns, targets.map(|target| row[target as usize]));
        }
        assert!(columns.iter().any(|distance| distance.is_infinite()));
    }

    #[test]
    fn graphs_without_links_or_vertices_are_swept() {
        assert_eq!(rows_of(&Sweep::new(&Listed(vec![]), &Control::default()).unwrap(), &[]), []);
        let lonely = Sweep::new(&Listed(vec![vec![]; 2]), &Control::default()).unwrap();
        assert_eq!(rows_of(&lonely, &[1, 0]), [f32::INFINITY, 0.0, 0.0, f32::INFINITY]);
    }

    #[test]
    fn it_pays_for_many_sources_only() {
        let graph = voxel_graph(&Mask::from_fn([60, 60, 1], |_| true).unwrap(), [1.0; 3]);
        let control = Control::default();
        assert!(Sweep::where_it_pays(&graph, 10, u64::MAX, &control).unwrap().is_none());
        assert!(Sweep::where_it_pays(&graph, 3600, u64::MAX, &control).unwrap().is_some());
        assert!(Sweep::where_it_pays(&graph, 3600, 1 << 12, &control).unwrap().is_none());
    }

    #[test]
    fn a_sweep_is_cancelled_before_and_after_it_is_prepared() {
        let graph = voxel_graph(&Mask::from_fn([20, 20, 1], |_| true).unwrap(), [1.0; 3]);
        let control = Control::default();
        let sweep = Sweep::new(&graph, &control).unwrap();
        control.cancel();
        assert_eq!(Sweep::new(&graph, &control).unwrap_err(), Error::Cancelled);
        let mut rows = vec![0.0; graph.len()];
        let result = sweep.rows(&[0], None, &mut [&mut rows], &mut SweepScratch::default(), &control);
        assert_eq!(result, Err(Error::Cancelled));
    }
}
