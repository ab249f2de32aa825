//! A contraction hierarchy by nested dissection: shortcuts that lead from each vertex to separators above it.
//!
//! Vertices are taken out of the graph from the last of the dissection's order to the first; those that are left keep their
//! distances by shortcuts between the neighbours of each vertex taken out. Then, from the first to the last, each shortcut
//! gets the true distance between its ends, and those that two others replace are dropped (Dibbelt, Strasser, Wagner 2016,
//! "Customizable contraction hierarchies"). A part's vertices have the same vertices above them in common, so both passes
//! work on small dense tables (Duff, Reid 1983, the multifrontal method).
//!
//! Lengths are whole numbers of a quantum, half a millionth of a millimetre for distances of half a metre: sums of them
//! do not depend on their order, so equal paths are equal, which drops more shortcuts, and no result depends on how the
//! work is divided.

use rayon::prelude::*;

use super::dissection::{Dissection, NONE, Part};
use super::lengths::{self, FAR, LengthTable};
use crate::adjacency::Links;
use crate::control::Control;
use crate::error::Result;

/// No distance is more quanta than this; what rounding adds to paths fits between it and [`FAR`].
const REACH: f64 = (FAR / 2) as f64;

/// Tables of more vertices are worth a thread of their own.
const LARGE: usize = 256;

/// A link to a vertex above.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Shortcut {
    /// How many vertices of separators are above that vertex: its place among all that are above this one.
    pub slot: u32,
    /// Length in quanta.
    pub length: i32,
}

/// A graph's shortcuts.
#[derive(Debug)]
pub(super) struct Contraction {
    /// The order of the vertices, and its parts.
    pub dissection: Dissection,
    /// Where each vertex's shortcuts begin, in order; and the end of the last one's.
    pub starts: Vec<usize>,
    /// The shortcuts, by ascending slot for each vertex.
    pub shortcuts: Vec<Shortcut>,
    /// Most vertices above one another.
    pub depth: usize,
    /// Length of a quantum, mm.
    pub quantum: f32,
}

impl Contraction {
    /// Contracts a dissected graph.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    pub fn new<G: Links>(graph: &G, plan: Plan, control: &Control) -> Result<Self> {
        let Plan { dissection, above } = plan;
        control.begin("preparing distances", 2 * dissection.parts.len() as u64);
        let quantum = quantum(dissection.reach);
        let worker = Worker { graph, dissection: &dissection, above: &above, quantum, control };
        let mut kept: Vec<Kept> = Vec::with_capacity(dissection.parts.len());
        let mut root = 0;
        while root < dissection.parts.len() {
            let (eliminated, _) = worker.eliminate(root)?;
            kept.append(&mut worker.settle(eliminated, &[], &LengthTable::new(0))?);
            root = dissection.parts[root].until as usize;
        }
        let mut starts = Vec::with_capacity(dissection.order.len() + 1);
        let mut shortcuts = Vec::with_capacity(kept.iter().map(|part| part.shortcuts.len()).sum());
        starts.push(0);
        for part in kept {
            let before = shortcuts.len();
            starts.extend(part.ends.iter().map(|&end| before + end as usize));
            shortcuts.extend(part.shortcuts);
        }
        let depth = dissection.parts.iter().map(|part| part.slot + part.len).max().unwrap_or(0) as usize;
        Ok(Self { dissection, starts, shortcuts, depth, quantum })
    }
}

/// The least power of two, in mm, of which [`REACH`] are no shorter than `reach`: lengths are then multiplied and divided
/// by it without rounding.
fn quantum(reach: f32) -> f32 {
    let mut quantum = 1.0f32;
    while f64::from(quantum) * REACH < f64::from(reach) {
        quantum *= 2.0;
    }
    while f64::from(quantum) * REACH >= 2.0 * f64::from(reach) && quantum > 2.0 * f32::MIN_POSITIVE {
        quantum /= 2.0;
    }
    quantum
}

/// A dissection with the size of each part's table: what a contraction will cost.
#[derive(Debug)]
pub(super) struct Plan {
    pub dissection: Dissection,
    /// For each part the ranks of the vertices above it that it or what lies below it is linked to, ascending.
    above: Vec<Vec<u32>>,
}

impl Plan {
    /// Dissects a graph.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    pub fn new<G: Links>(graph: &G, control: &Control) -> Result<Self> {
        let dissection = Dissection::new(graph, control)?;
        let mut above: Vec<Vec<u32>> = vec![Vec::new(); dissection.parts.len()];
        for number in (0..dissection.parts.len()).rev() {
            if number % 256 == 0 {
                control.check()?;
            }
            let part = &dissection.parts[number];
            let mut found = std::mem::take(&mut above[number]); // what the parts below it brought
            for rank in part.first..part.first + part.len {
                let neighbours = graph.arcs(dissection.order[rank as usize]);
                found.extend(neighbours.map(|arc| dissection.ranks[arc.to as usize]));
            }
            found.retain(|&rank| rank < part.first);
            found.sort_unstable();
            found.dedup();
            if part.parent != NONE {
                above[part.parent as usize].extend(&found);
            }
            above[number] = found;
        }
        Ok(Self { dissection, above })
    }

    /// Sums of three that the contraction compares, roughly.
    pub fn work(&self) -> f64 {
        self.sizes().map(|(len, table)| 1.5 * len * table * table).sum()
    }

    /// Memory in bytes that the contraction needs for a while.
    pub fn bytes(&self) -> f64 {
        self.sizes().map(|(len, table)| 4.0 * len * (table - len / 2.0)).sum()
    }

    /// Each part's number of vertices, and with those above it.
    fn sizes(&self) -> impl Iterator<Item = (f64, f64)> {
        let size = |(part, above): (&Part, &Vec<u32>)| (f64::from(part.len), f64::from(part.len) + above.len() as f64);
        self.dissection.parts.iter().zip(&self.above).map(size)
    }
}

/// A part and all below it, taken out of the graph.
struct Eliminated {
    part: usize,
    /// Rows of the part's vertices: the lengths of all shortcuts upward.
    rows: LengthTable,
    below: Vec<Eliminated>,
}

/// The shortcuts of a part that are left.
struct Kept {
    /// Where each vertex's shortcuts end.
    ends: Vec<u32>,
    shortcuts: Vec<Shortcut>,
}

struct Worker<'a, G> {
    graph: &'a G,
    dissection: &'a Dissection,
    above: &'a [Vec<u32>],
    quantum: f32,
    control: &'a Control,
}

impl<G: Links> Worker<'_, G> {
    /// The parts directly below a part.
    fn below(&self, part: usize) -> Vec<usize> {
        let parts = &self.dissection.parts;
        let mut below = Vec::new();
        let mut child = part + 1;
        while child < parts[part].until as usize {
            below.push(child);
            child = parts[child].until as usize;
        }
        below
    }

    /// Takes a part and all below it out of the graph. With it the lengths of the shortcuts between what is above it.
    fn eliminate(&self, number: usize) -> Result<(Eliminated, LengthTable)> {
        let part = self.dissection.parts[number];
        let children = self.below(number);
        let parallel = self.above[number].len() + part.len as usize > LARGE;
        let below: Vec<(Eliminated, LengthTable)> = if parallel {
            children.into_par_iter().map(|child| self.eliminate(child)).collect::<Result<_>>()?
        } else {
            children.into_iter().map(|child| self.eliminate(child)).collect::<Result<_>>()?
        };
        let above = &self.above[number];
        let mut lengths = LengthTable::new(above.len() + part.len as usize);
        for (child, passed) in &below {
            let at = self.places(number, &self.above[child.part]);
            lengths.lower_by(passed, &at);
        }
        for rank in part.first..part.first + part.len {
            let row = above.len() + (rank - part.first) as usize;
            for arc in self.graph.arcs(self.dissection.order[rank as usize]) {
                let to = self.dissection.ranks[arc.to as usize];
                if to < rank {
                    let column = self.place(number, to);
                    let length = (f64::from(arc.length) / f64::from(self.quantum)).round().clamp(1.0, REACH) as i32;
                    lengths.lower(row, column, length);
                }
            }
        }
        lengths.eliminate(above.len(), self.control)?;
        self.control.advance();
        let rows = lengths.split_off(above.len());
        let below = below.into_iter().map(|(child, _)| child).collect();
        Ok((Eliminated { part: number, rows, below }, lengths))
    }

    /// Gives the shortcuts of a part and of all below it their true lengths and drops those that are not needed. `outer` are
    /// the ranks of the table of the part above, `distances` their distances.
    fn settle(&self, eliminated: Eliminated, outer: &[u32], distances: &LengthTable) -> Result<Vec<Kept>> {
        let Eliminated { part: number, rows, below } = eliminated;
        let part = self.dissection.parts[number];
        let above = &self.above[number];
        let at = lengths::merge(above, outer);
        let mut settled = LengthTable::selected(distances, &at, above.len() + part.len as usize);
        let mut kept = Kept { ends: Vec::with_capacity(part.len as usize), shortcuts: Vec::new() };
        let slots: Vec<u32> = self.slots(number);
        settled.settle(above.len(), &rows, self.control, |_, needed| {
            kept.shortcuts.extend(needed.map(|(column, length)| Shortcut { slot: slots[column], length }));
            kept.ends.push(kept.shortcuts.len() as u32);
        })?;
        drop(rows);
        self.control.advance();
        let ranks: Vec<u32> = above.iter().copied().chain(part.first..part.first + part.len).collect();
        let parallel = ranks.len() > LARGE;
        let mut all = vec![kept];
        let below: Vec<Vec<Kept>> = if parallel {
            below.into_par_iter().map(|child| self.settle(child, &ranks, &settled)).collect::<Result<_>>()?
        } else {
            below.into_iter().map(|child| self.settle(child, &ranks, &settled)).collect::<Result<_>>()?
        };
        below.into_iter().for_each(|mut more| all.append(&mut more));
        Ok(all)
    }

    /// Where a vertex is in a part's table.
    fn place(&self, number: usize, rank: u32) -> usize {
        let (part, above) = (&self.dissection.parts[number], &self.above[number]);
        match rank.checked_sub(part.first) {
            Some(own) => above.len() + own as usize,
            None => above.partition_point(|&other| other < rank),
        }
    }

    /// Where ascending ranks are in a part's table.
    fn places(&self, number: usize, ranks: &[u32]) -> Vec<usize> {
        ranks.iter().map(|&rank| self.place(number, rank)).collect()
    }

    /// The slots of a part's table.
    fn slots(&self, number: usize) -> Vec<u32> {
        let parts = &self.dissection.parts;
        let own = parts[number];
        let mut slots: Vec<u32> = (own.slot..own.slot + own.len).rev().collect();
        let mut part = own;
        for &rank in self.above[number].iter().rev() {
            while rank < part.first {
                part = parts[part.parent as usize];
            }
            slots.push(part.slot + rank - part.first);
        }
        slots.reverse();
        slots
    }
}
