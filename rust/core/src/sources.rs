//! Sources: the points from which distances are measured.

use rand::SeedableRng;
use rand::seq::index;
use rand_chacha::ChaCha8Rng;

use crate::adjacency::Links;
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
    pub fn choose(&self, graph: &impl Links, control: &Control) -> Result<Vec<u32>> {
        let points = graph.vertices();
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

fn farthest(graph: &impl Links, count: usize, seed: u64, control: &Control) -> Result<Vec<u32>> {
    control.begin("choosing sources", count as u64);
    let mut search = Search::new(graph);
    let mut nearest = vec![f32::INFINITY; graph.vertices()]; // distance to the sources so far
    let mut chosen = Vec::with_capacity(count);
    let mut next = random(graph.vertices(), count.min(1), seed).first().copied();
    while let (Some(source), true) = (next, chosen.len() < count) {
        nearest[source as usize] = 0.0;
        search.lower(graph, &[source], &mut nearest, control)?;
        chosen.push(source);
        control.advance();
        next = first_of_greatest(&nearest);
    }
    Ok(chosen)
}

/// The first of the greatest of some distances. Distances are not negative: their bits are ordered as they are, and the
/// greatest of whole numbers is found many at a time.
fn first_of_greatest(distances: &[f32]) -> Option<u32> {
    let greatest = distances.iter().map(|distance| distance.to_bits()).fold(0, u32::max);
    distances.iter().position(|distance| distance.to_bits() == greatest).map(|vertex| vertex as u32)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::adjacency::Graph;
    use crate::flatten::chain_graph;
    use crate::geodesic::Solver;
    use crate::geodesic::chain::LinkLengths;
    use crate::surface::VoxelSurface;
    use crate::volume::{Affine, Mask};

    fn bent_sheet() -> Graph {
        let mask = Mask::from_fn([12, 15, 8], |[i, j, k]| k == j / 3 + usize::from(i > 6)).unwrap();
        let control = Control::default();
        let surface = VoxelSurface::from_mask(&mask, Affine::from_spacing([1.0; 3]).unwrap(), &control).unwrap();
        chain_graph(&surface, LinkLengths::ChainCode, &control).unwrap()
    }

    #[test]
    fn each_farthest_source_is_farthest_from_those_before() {
        let graph = bent_sheet();
        let control = Control::default();
        let chosen = Sources::Farthest { count: 12, seed: 5 }.choose(&graph, &control).unwrap();
        let mut nearest = vec![f32::INFINITY; graph.vertices()];
        let mut row = nearest.clone();
        for (n, &source) in chosen.iter().enumerate() {
            if n > 0 {
                let farthest = nearest.iter().copied().fold(0.0, f32::max);
                assert_eq!(nearest[source as usize], farthest);
            }
            graph.row(source, &mut row, &mut graph.scratch(), &control).unwrap();
            nearest.iter_mut().zip(&row).for_each(|(near, &distance)| *near = near.min(distance));
        }
    }

    #[test]
    fn choices_depend_on_the_seed_alone() {
        let graph = bent_sheet();
        let control = Control::default();
        let choose = |sources: Sources| sources.choose(&graph, &control).unwrap();
        for count in [3, 10, graph.len()] {
            for seed in [0, 1] {
                let random = choose(Sources::Random { count, seed });
                assert_eq!(random, choose(Sources::Random { count, seed }));
                assert!(random.is_sorted_by(|a, b| a < b) && random.len() == count);
                let mut farthest = choose(Sources::Farthest { count, seed });
                assert_eq!(farthest, choose(Sources::Farthest { count, seed }));
                farthest.sort_unstable();
                farthest.dedup();
                assert_eq!(farthest.len(), count);
            }
        }
        assert_ne!(choose(Sources::Random { count: 10, seed: 0 }), choose(Sources::Random { count: 10, seed: 1 }));
    }

    #[test]
    fn impossible_choices_are_refused() {
        let graph = bent_sheet();
        let points = graph.vertices();
        let control = Control::default();
        let choose = |sources: Sources| sources.choose(&graph, &control).unwrap_err();
        let sources = points + 1;
        assert_eq!(choose(Sources::Random { count: sources, seed: 0 }), Error::TooManySources { sources, points });
        assert_eq!(choose(Sources::Given(vec![points])), Error::NoSuchPoint { vertex: points, points });
        assert_eq!(choose(Sources::Given(vec![4, 2, 4])), Error::DuplicateSource { vertex: 4 });
    }
}
