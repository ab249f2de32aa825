//! Rows of many sources at once by sweeps over a contraction hierarchy.
//!
//! The distances of a batch of sources lie side by side. They are first carried upward, along the shortcuts from the
//! sources to all separators above them; then one pass over all vertices, in the order of the dissection, takes for each
//! the nearest way through what is above it (Delling, Goldberg, Nowatzyk, Werneck 2011, "PHAST"). Only what is above the
//! present vertex has to be remembered: some thousand vertices, which fit into the processor's cache.

use pulp::{Arch, Simd, WithSimd};

use super::contraction::{Contraction, Plan};
use super::dissection::{Dissection, NONE, Part};
use super::table::FAR;
use crate::adjacency::Links;
use crate::control::Control;
use crate::error::Result;

/// Sources of one sweep.
pub(crate) const LANES: usize = 64;

/// Sources of one sweep where there are so few.
const FEW_LANES: usize = 16;

/// Fewer sources are not worth a plan.
const FEWEST_SOURCES: usize = 150;

/// Smaller graphs have their rows at once either way.
const FEWEST_VERTICES: usize = 1000;

/// What a link costs in a search, ns a row.
const LINK_NS: f64 = 3.0;

/// What a length of the tables costs in a sweep, ns a row: the time of a shortcut by the share of shortcuts that are kept.
const FILL_NS: f64 = 0.06;

/// What a comparison of the contraction costs, ns.
const WORK_NS: f64 = 0.15;

/// The tables may take as much memory as the rows, bytes a distance.
const ROW_BYTES: f64 = 4.0;

/// Lanes that are lowered together, in the processor's registers.
const BLOCK: usize = 16;

/// Distances from a batch of sources, side by side.
type Lanes<const L: usize> = [i32; L];

/// A graph that was prepared for sweeps.
#[derive(Debug)]
pub struct Sweep {
    contraction: Contraction,
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
pub struct Targets {
    /// The rank of each, ascending, and its column.
    columns: Vec<(u32, u32)>,
    /// Which parts are above a target or hold one.
    parts: Vec<bool>,
}

impl Sweep {
    /// Prepares a graph, whatever it costs.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    pub fn new<G: Links>(graph: &G, control: &Control) -> Result<Self> {
        control.begin("preparing distances", 1);
        Ok(Self { contraction: Contraction::new(graph, Plan::new(graph, control)?, control)? })
    }

    /// Prepares a graph if that is the faster way to the rows of so many sources. This depends on the graph and the number
    /// only (docs/decisions/0010).
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    pub fn where_it_pays<G: Links>(graph: &G, sources: usize, control: &Control) -> Result<Option<Self>> {
        if sources < FEWEST_SOURCES || graph.vertices() < FEWEST_VERTICES {
            return Ok(None);
        }
        control.begin("preparing distances", 1);
        let plan = Plan::new(graph, control)?;
        let vertices = graph.vertices() as f64;
        let sample: Vec<u32> = (0..graph.vertices() as u32).step_by(graph.vertices() / 1000 + 1).collect();
        let links = sample.iter().map(|&vertex| graph.arcs(vertex).count()).sum::<usize>() as f64 / sample.len() as f64;
        let fill = plan.bytes() / 4.0 / vertices;
        let gain = (LINK_NS * links - FILL_NS * fill) * vertices * sources as f64;
        let fits = plan.bytes() <= ROW_BYTES * vertices * sources as f64;
        if !fits || gain < WORK_NS * plan.work() {
            return Ok(None);
        }
        Ok(Some(Self { contraction: Contraction::new(graph, plan, control)? }))
    }

    /// Number of vertices.
    pub fn columns(&self) -> usize {
        self.contraction.dissection.order.len()
    }

    /// Number of shortcuts.
    pub fn shortcuts(&self) -> usize {
        self.contraction.shortcuts.len()
    }

    /// Most vertices above one another.
    pub fn depth(&self) -> usize {
        self.contraction.depth
    }

    /// What has to be swept to reach some vertices only.
    pub fn targets(&self, vertices: &[u32]) -> Targets {
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
        Targets { columns, parts: above }
    }

    /// Writes the distances in mm from each source to every vertex, or to the targets, one row after the other; infinity
    /// where a vertex cannot be reached.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    ///
    /// # Panics
    /// If `rows` has not one row a source.
    pub fn rows(
        &self,
        sources: &[u32],
        targets: Option<&Targets>,
        rows: &mut [f32],
        scratch: &mut SweepScratch,
        control: &Control,
    ) -> Result<()> {
        let columns = targets.map_or(self.columns(), |targets| targets.columns.len());
        assert_eq!(rows.len(), sources.len() * columns, "one row a source");
        for (sources, rows) in sources.chunks(LANES).zip(rows.chunks_mut((LANES * columns).max(1))) {
            let rows = rows.chunks_exact_mut(columns.max(1)).collect();
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
struct Batch<'a, const L: usize> {
    sweep: &'a Sweep,
    sources: &'a [u32],
    targets: Option<&'a Targets>,
    rows: Vec<&'a mut [f32]>,
    scratch: &'a mut SweepScratch,
    control: &'a Control,
}

impl<const L: usize> WithSimd for Batch<'_, L> {
    type Output = Result<()>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Result<()> {
        let Self { sweep, sources, targets, mut rows, scratch, control } = self;
        let Contraction { dissection, depth, quantum, .. } = &sweep.contraction;
        sweep.upward::<L>(sources, scratch, control)?;
        let SweepScratch { above, upward, places, .. } = scratch;
        above.resize(depth * L, FAR);
        let (above, _) = above.as_chunks_mut::<L>();
        let (upward, _) = upward.as_chunks::<L>();
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
            let found = &above[part.slot as usize..(part.slot + part.len) as usize];
            if targets.is_some() {
                let (here, behind) = wanted.split_at(wanted.partition_point(|&(rank, _)| rank < part.first + part.len));
                let columns = here.iter().map(|&(rank, column)| (column, &found[(rank - part.first) as usize]));
                write(&mut rows, columns, *quantum);
                wanted = behind;
            } else {
                let vertices = &dissection.order[part.first as usize..(part.first + part.len) as usize];
                write(&mut rows, vertices.iter().copied().zip(found), *quantum);
            }
        }
        Ok(())
    }
}

/// Writes columns of distances into the rows, one row a lane.
#[inline(always)]
fn write<'a, const L: usize>(
    rows: &mut [&mut [f32]],
    columns: impl Iterator<Item = (u32, &'a Lanes<L>)> + Clone,
    quantum: f32,
) {
    for (lane, row) in rows.iter_mut().enumerate() {
        for (column, lanes) in columns.clone() {
            let reached = lanes[lane] != FAR;
            row[column as usize] = if reached { lanes[lane] as f32 * quantum } else { f32::INFINITY };
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
