//! Sources: the points from which distances are measured.

use rand::SeedableRng;
use rand::seq::index;
use rand_chacha::ChaCha8Rng;

use crate::adjacency::Graph;
use crate::control::Control;
use crate::error::{Error, Result};
use crate::geodesic::shortest::Search;

/// Fewest sources that span a plane.
pub const FEWEST_SOURCES: usize = 3;

/// How sources are chosen. Every choice is the same for the same seed, on every machine.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Sources {
    /// Each source is the point farthest, along the surface, from those before it; the first is random. Covers evenly.
    Farthest {
        /// How many.
        count: usize,
        /// Seed of the first.
        seed: u64,
    },
    /// Uniformly at random, without repetition.
    Random {
        /// How many.
        count: usize,
        /// Seed of the choice.
        seed: u64,
    },
    /// These vertices.
    Given(Vec<usize>),
}

impl Sources {
    /// The chosen vertices of a connected graph.
    ///
    /// # Errors
    /// [`Error::TooManySources`], [`Error::NoSuchPoint`], [`Error::DuplicateSource`], [`Error::Cancelled`].
    pub fn choose(&self, graph: &Graph, control: &Control) -> Result<Vec<u32>> {
        let points = graph.len();
        let checked = |count: usize| {
            if count > points { Err(Error::TooManySources { sources: count, points }) } else { Ok(count) }
        };
        match *self {
            Self::Farthest { count, seed } => farthest(graph, checked(count)?, seed, control),
            Self::Random { count, seed } => Ok(random(points, checked(count)?, seed)),
            Self::Given(ref vertices) => given(vertices, points),
        }
    }
}

/// `count` different vertices of `points`, in ascending order.
pub fn random(points: usize, count: usize, seed: u64) -> Vec<u32> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut chosen: Vec<u32> = index::sample(&mut rng, points, count).iter().map(|v| v as u32).collect();
    chosen.sort_unstable(); // neighbours' rows touch the same memory
    chosen
}

fn farthest(graph: &Graph, count: usize, seed: u64, control: &Control) -> Result<Vec<u32>> {
    control.begin("choosing sources", count as u64);
    let mut search = Search::new(graph);
    let mut nearest = vec![f32::INFINITY; graph.len()]; // distance to the sources so far
    let mut chosen = Vec::with_capacity(count);
    let mut next = random(graph.len(), count.min(1), seed).first().copied();
    while let (Some(source), true) = (next, chosen.len() < count) {
        nearest[source as usize] = 0.0;
        search.lower(graph, &[source], &mut nearest, control)?;
        chosen.push(source);
        control.advance();
        next = (0..graph.len() as u32).rev().max_by(|&a, &b| nearest[a as usize].total_cmp(&nearest[b as usize]));
    }
    Ok(chosen)
}

fn given(vertices: &[usize], points: usize) -> Result<Vec<u32>> {
    let mut seen = vec![false; points];
    for &vertex in vertices {
        match seen.get_mut(vertex) {
            None => return Err(Error::NoSuchPoint { vertex, points }),
            Some(true) => return Err(Error::DuplicateSource { vertex }),
            Some(new) => *new = true,
        }
    }
    Ok(vertices.iter().map(|&vertex| vertex as u32).collect())
}
