//! Decimation: fewer vertices, each of them one of the surface's own, and how to get the others back.
//!
//! Vertices are taken away one after the other, each by moving it onto a neighbour (a half-edge collapse). The cheapest goes
//! first: the quadric error that it leaves (Garland, Heckbert 1997), in mm⁴, and the fourth power of the longest edge that it
//! makes, which keeps edges even where the surface is flat. The surface stays one, of the same topology; faces do not turn over
//! and do not become slivers; the boundary moves along itself only.
//!
//! Each vertex that goes leaves a record: its neighbours at that moment and how it is made of them ([`Removals`]). Taken in
//! reverse order they carry anything that is known at the survivors to every vertex:
//! [`reinsertion`](crate::place::reinsertion) does so with places in the plane.

mod connectivity;
mod quadric;
mod weights;

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::adjacency::marked;
use crate::control::Control;
use crate::error::{Error, Result, check_points};
use crate::surface::mesh::Surface;
use connectivity::{Connectivity, Ring};
use quadric::Quadric;

/// Most neighbours that a vertex gets, and that a vertex has that goes.
const MOST_NEIGHBOURS: usize = 40;

/// Least cosine of the angle by which a face turns when one of its corners moves.
const LEAST_COSINE: f64 = 0.2;

/// Least shape of a face that is made, unless it was worse: 1 for an equilateral one, 0 for none.
const LEAST_SHAPE: f64 = 0.15;

/// Steps between two looks at the control.
const BATCH: usize = 1 << 9;

/// How far a surface is decimated.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Vertices that are wanted; more stay where none can go.
    pub vertices: usize,
    /// No longer edge is made, mm.
    pub longest_edge: f64,
    /// What the fourth power of a length counts against the quadric error.
    pub evenness: f64,
    /// Only the topology is kept: faces may turn over and become slivers. A closed surface without handles comes down to four
    /// vertices then.
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

/// A surface of fewer vertices.
#[derive(Debug, Clone)]
pub struct Decimation {
    /// The vertices that stayed, ascending.
    pub survivors: Vec<u32>,
    /// Their surface, with the places and ids that they had: its n-th vertex is the n-th survivor.
    pub surface: Surface,
    /// The vertices that went.
    pub removals: Removals,
}

/// The vertices that went, in that order: each with its neighbours then, counterclockwise, and their weights.
#[derive(Debug, Clone, PartialEq)]
pub struct Removals {
    vertices: Vec<u32>,
    is_closed: Vec<bool>,
    starts: Vec<usize>,
    neighbours: Vec<u32>,
    weights: Vec<[f64; 2]>,
}

/// A vertex that went.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Removal<'a> {
    /// Which.
    pub vertex: u32,
    /// Do its neighbours lie all around it? Otherwise it lay on the boundary, between the first and the last.
    pub is_closed: bool,
    /// Its neighbours, counterclockwise.
    pub neighbours: &'a [u32],
    /// Complex numbers (re, im) that sum to one: with z the neighbours' places in an unfolded plane, as complex numbers, the
    /// vertex lies at Σ weight · z. Real and positive where the neighbours lie all around.
    pub weights: &'a [[f64; 2]],
}

impl Removals {
    /// How many.
    pub fn len(&self) -> usize {
        self.vertices.len()
    }

    /// Did every vertex stay?
    pub fn is_empty(&self) -> bool {
        self.vertices.is_empty()
    }

    /// In the order in which they went; in reverse, all neighbours of each are known.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = Removal<'_>> + ExactSizeIterator {
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

/// Takes vertices away, but not those to `keep`, until so many are left or none can go. The same result for the same surface,
/// bit by bit.
/// Errors: [`Error::DecimationOption`], [`Error::NoSuchPoint`] among those to keep, [`Error::Cancelled`].
///
/// # Examples
/// ```
/// use voxflat::control::Control;
/// use voxflat::surface::decimate::{Options, decimate};
/// use voxflat::surface::mesh::shapes;
///
/// let sheet = shapes::surface(shapes::sheet(8, 8)); // 8 by 8 squares of 1 mm, in the plane z = 0
/// let found = decimate(&sheet, &[40], &Options { vertices: 30, ..Options::default() }, &Control::default())?;
/// assert_eq!(found.survivors.len(), 30);
/// assert!(found.survivors.contains(&40));
/// assert!((found.surface.areas().iter().sum::<f64>() - 64.0).abs() < 1e-9); // it is still the same square
/// # Ok::<(), voxflat::Error>(())
/// ```
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

/// A vertex that may go, by its cost.
type Candidate = Reverse<(u64, u32)>;

struct Work<'a> {
    points: Vec<Vector3<f64>>,
    options: &'a Options,
    left: Connectivity,
    quadrics: Vec<Quadric>,
    stays: Vec<bool>,
    /// Is there a candidate, and is its cost still right?
    is_queued: Vec<bool>,
    is_stale: Vec<bool>,
    /// The place in its ring that a candidate moves to.
    onto: Vec<u8>,
    queue: BinaryHeap<Candidate>,
    removals: Removals,
    scratch: Scratch,
}

/// What is kept from one vertex to the next.
#[derive(Debug, Default)]
struct Scratch {
    ring: Ring,
    beyond: Ring,
    costs: Vec<(f64, usize)>,
}

impl<'a> Work<'a> {
    fn new(surface: &Surface, keep: &[u32], options: &'a Options) -> Self {
        let count = surface.len();
        let centre = surface.points().iter().sum::<Vector3<f64>>() / count.max(1) as f64; // far from 0 quadrics lose digits
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
        self.queue = queue.into(); // what is taken from it does not depend on how it was filled: no two candidates are equal
        Ok(())
    }

    /// Queues a vertex by what it costs now, if it can go.
    fn queue(&mut self, vertex: u32) {
        let mut scratch = std::mem::take(&mut self.scratch);
        let found = self.cheapest(vertex, &mut scratch);
        self.scratch = scratch;
        let candidate = self.candidate(vertex, found);
        self.queue.extend(candidate);
    }

    /// Notes the cheapest way for a vertex to go.
    fn candidate(&mut self, vertex: u32, found: Option<(f64, usize)>) -> Option<Candidate> {
        self.is_stale[vertex as usize] = false;
        self.is_queued[vertex as usize] = found.is_some();
        let (cost, k) = found?;
        self.onto[vertex as usize] = k as u8;
        Some(Reverse((cost.to_bits(), vertex))) // positive floats sort as their bits
    }

    /// Takes a vertex away whose turn it is; false if it cannot go as it was meant to, and is queued anew.
    ///
    /// Costs hardly fall while vertices go, so it is enough to look at them when their turn comes.
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
            self.queue(vertex); // its ring is as it was, but something beyond is not
            return false;
        }
        self.is_queued[vertex as usize] = false;
        self.remove(vertex, k);
        true
    }

    /// Moves a vertex, whose ring is in the scratch, onto the `k`-th of it.
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
                self.queue(neighbour); // what could not go may be able to now
            }
        }
        self.scratch.ring = ring;
    }

    /// The cheapest way for a vertex to go: its cost and the place in its ring that it moves to.
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

    /// What it costs to move a vertex onto the `k`-th of its ring, if no edge becomes too long.
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

    /// Does a face around a vertex neither turn over nor become a sliver when its apex moves onto the `k`-th of the ring?
    fn stays_sound(&self, vertex: u32, side: [usize; 2], k: usize, ring: &Ring) -> bool {
        let [a, b, to] = [side[0], side[1], k].map(|n| self.points[ring.vertices[n] as usize]);
        let from = self.points[vertex as usize];
        let (before, after) = ((a - from).cross(&(b - from)), (a - to).cross(&(b - to)));
        let turns = before.dot(&after) < LEAST_COSINE * before.norm() * after.norm();
        !turns && shape(a, b, to, after.norm()) >= shape(a, b, from, before.norm()).min(LEAST_SHAPE)
    }
}

/// 4√3 · area / Σ length², from twice the area.
fn shape(a: Vector3<f64>, b: Vector3<f64>, c: Vector3<f64>, double: f64) -> f64 {
    let lengths = (a - b).norm_squared() + (b - c).norm_squared() + (c - a).norm_squared();
    2.0 * 3f64.sqrt() * double / lengths
}

#[cfg(test)]
mod tests;
