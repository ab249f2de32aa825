//! Decimation to a subset of the vertices, and the information to restore the others.
//!
//! Vertices are removed one after the other by moving each onto a neighbour (half-edge collapse). The cheapest one is
//! removed first. Its cost is the resulting quadric error in mm⁴ (Garland, Heckbert 1997) plus the fourth power of the
//! longest new edge, which keeps edges even on flat parts. The topology is preserved, faces do not flip or become
//! slivers, and the boundary moves only along itself.
//!
//! For each removed vertex, its neighbours at that moment and their weights are recorded ([`Removals`]). In reverse
//! order, they extend values at the remaining vertices to every vertex. [`reinsertion`](crate::place::reinsertion) does
//! so for positions in the plane.

mod connectivity;
mod quadric;
mod weights;

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::adjacency::marked;
use crate::error::check_points;
use crate::surface::mesh::Surface;
use crate::{Control, Error, Result};
use connectivity::{Connectivity, Ring};
use quadric::Quadric;

/// The maximum number of neighbours that a vertex may get or that a removed vertex may have.
const MOST_NEIGHBOURS: usize = 40;

/// The minimum cosine of the angle by which a face rotates when one of its corners moves.
const LEAST_COSINE: f64 = 0.2;

/// The minimum shape of a new face, unless the old one was worse: 1 for an equilateral face, 0 for a degenerate one.
const LEAST_SHAPE: f64 = 0.15;

/// The number of steps between two checks for cancellation.
const BATCH: usize = 1 << 9;

/// Limits of the decimation.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// The desired number of vertices; more remain if no others can be removed.
    pub vertices: usize,
    /// The maximum length of a new edge in mm.
    pub longest_edge: f64,
    /// The weight of the fourth power of a length relative to the quadric error.
    pub evenness: f64,
    /// Whether only the topology is preserved: faces may flip and become slivers. A closed surface without handles can
    /// then be reduced to four vertices.
    pub any_shape: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self { vertices: 15_000, longest_edge: f64::INFINITY, evenness: 0.01, any_shape: false }
    }
}

impl Options {
    fn validate(&self) -> Result<()> {
        let refuse = |name, value| Err(Error::DecimationOption { name, value });
        if self.longest_edge.is_nan() || self.longest_edge <= 0.0 {
            return refuse("longest_edge", self.longest_edge);
        }
        if !self.evenness.is_finite() || self.evenness < 0.0 {
            return refuse("evenness", self.evenness);
        }
        Ok(())
    }
}

/// A surface with fewer vertices.
#[derive(Debug, Clone)]
pub struct Decimation {
    /// The remaining vertices, ascending.
    pub survivors: Vec<u32>,
    /// Their surface, with unchanged positions and ids: its n-th vertex is the n-th survivor.
    pub surface: Surface,
    /// The removed vertices.
    pub removals: Removals,
}

/// The removed vertices in their order, each with its neighbours at that moment, counterclockwise, and their weights.
#[derive(Debug, Clone, PartialEq)]
pub struct Removals {
    vertices: Vec<u32>,
    is_closed: Vec<bool>,
    starts: Vec<usize>,
    neighbours: Vec<u32>,
    weights: Vec<[f64; 2]>,
}

/// A removed vertex.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Removal<'a> {
    /// Its number.
    pub vertex: u32,
    /// Whether its neighbours surround it. Otherwise, it was on the boundary, between the first and the last of them.
    pub is_closed: bool,
    /// Its neighbours, counterclockwise.
    pub neighbours: &'a [u32],
    /// Complex numbers (re, im) whose sum is one: if z are the neighbours' positions in an unfolded plane, as complex
    /// numbers, the vertex lies at Σ weight · z. They are real and positive if the neighbours surround it.
    pub weights: &'a [[f64; 2]],
}

impl Removals {
    /// Returns the number of removed vertices.
    pub(crate) fn len(&self) -> usize {
        self.vertices.len()
    }

    /// Iterates in the order of removal; in reverse, all neighbours of each vertex are known.
    pub(crate) fn iter(&self) -> impl DoubleEndedIterator<Item = Removal<'_>> + ExactSizeIterator {
        (0..self.len()).map(|n| {
            let ring = self.starts[n]..self.starts[n + 1];
            Removal {
                vertex: self.vertices[n],
                is_closed: self.is_closed[n],
                neighbours: &self.neighbours[ring.clone()],
                weights: &self.weights[ring],
            }
        })
    }

    fn push(&mut self, vertex: u32, ring: &Ring, weights: Vec<[f64; 2]>) {
        self.vertices.push(vertex);
        self.is_closed.push(ring.is_closed());
        self.neighbours.extend(&ring.vertices);
        self.weights.extend(weights);
        self.starts.push(self.neighbours.len());
    }
}

/// Removes vertices, except those to `keep`, until the desired number is left or no more can go. Deterministic.
///
/// # Errors
/// [`Error::DecimationOption`], [`Error::NoSuchPoint`] among the vertices to keep, and [`Error::Cancelled`].
pub fn decimate(surface: &Surface, keep: &[u32], options: &Options, control: &Control) -> Result<Decimation> {
    options.validate()?;
    let points = surface.len();
    check_points(keep.iter().copied(), points)?;
    let excess = points.saturating_sub(options.vertices);
    control.begin("decimating", excess as u64);
    let mut work = Work::new(surface, keep, options);
    work.queue_all(control)?;
    let mut looked_at = 0usize;
    while work.removals.len() < excess
        && let Some(Reverse((_, vertex))) = work.queue.pop()
    {
        looked_at += 1;
        if looked_at.is_multiple_of(BATCH) {
            control.check()?;
        }
        if work.take(vertex) {
            control.advance();
        }
    }
    let survivors: Vec<u32> = (0..points as u32).filter(|&v| !work.left.is_gone(v)).collect();
    let (faces, twins) = work.left.faces();
    let coarse = Surface::assemble(surface.points(), surface.ids(), &faces, twins);
    Ok(Decimation { survivors, surface: coarse, removals: work.removals })
}

/// A vertex that can be removed, with its cost.
type Candidate = Reverse<(u64, u32)>;

struct Work<'a> {
    points: Vec<Vector3<f64>>,
    options: &'a Options,
    left: Connectivity,
    quadrics: Vec<Quadric>,
    stays: Vec<bool>,
    /// Whether there is a candidate with an up-to-date cost.
    is_queued: Vec<bool>,
    is_stale: Vec<bool>,
    /// The position in its ring onto which a candidate moves.
    onto: Vec<u8>,
    queue: BinaryHeap<Candidate>,
    removals: Removals,
    scratch: Scratch,
}

/// Buffers that are reused for all vertices.
#[derive(Debug, Default)]
struct Scratch {
    ring: Ring,
    beyond: Ring,
    costs: Vec<(f64, usize)>,
}

impl<'a> Work<'a> {
    fn new(surface: &Surface, keep: &[u32], options: &'a Options) -> Self {
        let count = surface.len();
        let centre = surface.points().iter().sum::<Vector3<f64>>() / count.max(1) as f64; // preserves digits
        let points: Vec<Vector3<f64>> = surface.points().iter().map(|p| p - centre).collect();
        let stays = marked(count, keep);
        Self {
            quadrics: quadric::of_vertices(surface, &points),
            left: Connectivity::of(surface),
            points,
            options,
            stays,
            is_queued: vec![false; count],
            is_stale: vec![false; count],
            onto: vec![0; count],
            queue: BinaryHeap::new(),
            removals: Removals {
                vertices: Vec::new(),
                is_closed: Vec::new(),
                starts: vec![0],
                neighbours: Vec::new(),
                weights: Vec::new(),
            },
            scratch: Scratch::default(),
        }
    }

    fn queue_all(&mut self, control: &Control) -> Result<()> {
        let of_batch = |scratch: &mut Scratch, batch: usize| {
            control.check()?;
            let vertices = batch * BATCH..self.points.len().min((batch + 1) * BATCH);
            Ok(vertices.map(|vertex| self.cheapest(vertex as u32, scratch)).collect())
        };
        let batches = (0..self.points.len().div_ceil(BATCH)).into_par_iter();
        let found: Vec<Vec<Option<(f64, usize)>>> =
            batches.map_init(Scratch::default, of_batch).collect::<Result<_>>()?;
        let mut queue = Vec::with_capacity(self.points.len());
        for (vertex, found) in (0u32..).zip(found.into_iter().flatten()) {
            queue.extend(self.candidate(vertex, found));
        }
        self.queue = queue.into(); // no two candidates are equal, so the order of insertion does not matter
        Ok(())
    }

    /// Queues a vertex with its current cost, if it can be removed.
    fn queue(&mut self, vertex: u32) {
        let mut scratch = std::mem::take(&mut self.scratch);
        let found = self.cheapest(vertex, &mut scratch);
        self.scratch = scratch;
        let candidate = self.candidate(vertex, found);
        self.queue.extend(candidate);
    }

    /// Records the cheapest way to remove a vertex.
    fn candidate(&mut self, vertex: u32, found: Option<(f64, usize)>) -> Option<Candidate> {
        self.is_stale[vertex as usize] = false;
        self.is_queued[vertex as usize] = found.is_some();
        let (cost, k) = found?;
        self.onto[vertex as usize] = k as u8;
        Some(Reverse((cost.to_bits(), vertex))) // positive floats sort as their bits
    }

    /// Removes the vertex that is next; returns false if it cannot be removed as planned, and is queued again.
    ///
    /// Costs hardly decrease while vertices are removed, so that they are only updated when a vertex is next.
    fn take(&mut self, vertex: u32) -> bool {
        if self.is_stale[vertex as usize] {
            self.queue(vertex);
            return false;
        }
        let k = self.onto[vertex as usize] as usize;
        let mut scratch = std::mem::take(&mut self.scratch);
        self.left.ring(vertex, &mut scratch.ring);
        let can_go = self.can_go(vertex, k, &scratch.ring, &mut scratch.beyond);
        self.scratch = scratch;
        if !can_go {
            self.queue(vertex); // its ring is unchanged, but something beyond it is not
            return false;
        }
        self.is_queued[vertex as usize] = false;
        self.remove(vertex, k);
        true
    }

    /// Moves a vertex, whose ring is in the scratch, onto its `k`-th neighbour.
    fn remove(&mut self, vertex: u32, k: usize) {
        let ring = std::mem::take(&mut self.scratch.ring);
        let around: Vec<Vector3<f64>> = ring.vertices.iter().map(|&v| self.points[v as usize]).collect();
        let weights = weights::weights(self.points[vertex as usize], &around, ring.is_closed());
        self.removals.push(vertex, &ring, weights);
        let quadric = self.quadrics[vertex as usize];
        self.quadrics[ring.vertices[k] as usize].add(&quadric);
        self.left.collapse(vertex, &ring, k);
        ring.vertices.iter().for_each(|&neighbour| self.is_stale[neighbour as usize] = true);
        for &neighbour in &ring.vertices {
            if !self.is_queued[neighbour as usize] {
                self.queue(neighbour); // it may be removable now
            }
        }
        self.scratch.ring = ring;
    }

    /// Returns the cheapest way to remove a vertex: its cost and the position in its ring onto which it moves.
    fn cheapest(&self, vertex: u32, Scratch { ring, beyond, costs }: &mut Scratch) -> Option<(f64, usize)> {
        if self.stays[vertex as usize] || self.left.valence(vertex) > MOST_NEIGHBOURS {
            return None;
        }
        self.left.ring(vertex, ring);
        costs.clear();
        costs.extend((0..ring.vertices.len()).filter_map(|k| Some((self.cost(vertex, k, ring)?, k))));
        costs.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        costs.iter().copied().find(|&(_, k)| self.can_go(vertex, k, ring, beyond))
    }

    /// Returns the cost of moving a vertex onto the `k`-th of its ring, if no edge becomes too long.
    fn cost(&self, vertex: u32, k: usize, ring: &Ring) -> Option<f64> {
        let place = self.points[ring.vertices[k] as usize];
        let lengths = ring.vertices.iter().map(|&v| (self.points[v as usize] - place).norm_squared());
        let longest = lengths.fold(0.0, f64::max);
        let fits = longest <= self.options.longest_edge * self.options.longest_edge;
        fits.then(|| self.quadrics[vertex as usize].at(place) + self.options.evenness * longest * longest)
    }

    fn can_go(&self, vertex: u32, k: usize, ring: &Ring, beyond: &mut Ring) -> bool {
        let neighbours = self.left.valence(ring.vertices[k]) + ring.vertices.len();
        neighbours <= MOST_NEIGHBOURS + 4
            && self.left.is_allowed(ring, k, beyond)
            && (self.options.any_shape
                || ring.sides().all(|side| side.contains(&k) || self.stays_sound(vertex, side, k, ring)))
    }

    /// Returns whether a face neither flips nor becomes a sliver when its apex moves onto the ring's `k`-th vertex.
    fn stays_sound(&self, vertex: u32, side: [usize; 2], k: usize, ring: &Ring) -> bool {
        let [a, b, to] = [side[0], side[1], k].map(|n| self.points[ring.vertices[n] as usize]);
        let from = self.points[vertex as usize];
        let (before, after) = ((a - from).cross(&(b - from)), (a - to).cross(&(b - to)));
        let turns = before.dot(&after) < LEAST_COSINE * before.norm() * after.norm();
        !turns && shape(a, b, to, after.norm()) >= shape(a, b, from, before.norm()).min(LEAST_SHAPE)
    }
}

/// Returns 4√3 · area / Σ length², given twice the area.
fn shape(a: Vector3<f64>, b: Vector3<f64>, c: Vector3<f64>, double: f64) -> f64 {
    let lengths = (a - b).norm_squared() + (b - c).norm_squared() + (c - a).norm_squared();
    2.0 * 3f64.sqrt() * double / lengths
}

#[cfg(test)]
mod tests;
