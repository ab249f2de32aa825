//! Sources: the points from which distances are computed.

use rand::{SeedableRng, seq::index};
use rand_chacha::ChaCha8Rng;

use crate::adjacency::Links;
use crate::error::{check_length, check_points};
use crate::geodesic::shortest::Search;
use crate::surface::{Surface, mesh::curvature::mean_curvature};
use crate::{Control, Error, Result};

/// The smallest number of sources that span a plane.
pub(crate) const FEWEST_SOURCES: usize = 3;

/// Checks that there are enough sources to span a plane.
pub(crate) fn check_enough(sources: usize) -> Result<()> {
    if sources < FEWEST_SOURCES { Err(Error::TooFewSources { sources, needed: FEWEST_SOURCES }) } else { Ok(()) }
}

/// The largest weight of a point ([`by_curvature`]).
const DENSEST: f64 = 4.0;

/// Rings of neighbours over which curvature is averaged.
const BEND_RINGS: usize = 3;

/// Ways to choose sources. The same seed gives the same sources on every machine.
#[derive(Debug, Clone, PartialEq)]
pub enum Sources {
    /// Evenly spread: each is the point farthest along the surface from the previous ones; the first is random.
    Farthest {
        /// The number of sources.
        count: usize,
        /// The seed of the first source.
        seed: u64,
    },
    /// As `Farthest`, but each distance is multiplied by the weight of its point ([`by_curvature`]).
    Weighted {
        /// The number of sources.
        count: usize,
        /// The seed of the first source.
        seed: u64,
        /// The weight of each point, positive.
        weights: Vec<f32>,
    },
    /// Uniformly random, without repetition.
    Random {
        /// The number of sources.
        count: usize,
        /// The seed of the choice.
        seed: u64,
    },
    /// These vertices.
    Given(Vec<usize>),
}

impl Sources {
    /// Chooses vertices of a connected graph.
    ///
    /// # Errors
    /// [`Error::TooManySources`] if there are fewer vertices, [`Error::NoSuchPoint`] or [`Error::DuplicateSource`] of
    /// given vertices, [`Error::WrongLength`] if there is not one weight per vertex, and [`Error::Cancelled`].
    pub fn choose(&self, graph: &impl Links, control: &Control) -> Result<Vec<u32>> {
        let points = graph.vertices();
        let checked = |count: usize| {
            if count > points { Err(Error::TooManySources { sources: count, points }) } else { Ok(count) }
        };
        match *self {
            Self::Farthest { count, seed } => {
                let first = random(points, checked(count)?.min(1), seed).first().copied();
                Ok(farthest(graph, count, first, first_of_greatest, control)?.0)
            }
            Self::Weighted { count, seed, ref weights } => {
                check_length("weights", weights.len(), "points", points)?;
                let first = random(points, checked(count)?.min(1), seed).first().copied();
                let next = |nearest: &[f32]| {
                    let counted: Vec<f32> = nearest.iter().zip(weights).map(|(near, weight)| near * weight).collect();
                    first_of_greatest(&counted)
                };
                Ok(farthest(graph, count, first, next, control)?.0)
            }
            Self::Random { count, seed } => Ok(random(points, checked(count)?, seed)),
            Self::Given(ref vertices) => given(vertices, points),
        }
    }
}

/// Returns `count` different vertices out of `points`, in ascending order.
pub(crate) fn random(points: usize, count: usize, seed: u64) -> Vec<u32> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut chosen: Vec<u32> = index::sample(&mut rng, points, count).iter().map(|v| v as u32).collect();
    chosen.sort_unstable(); // rows of neighbours touch the same memory
    chosen
}

/// Returns weights that place `count` sources closer together where the surface is curved, as Grossmann et al. (2002)
/// and Zigelman et al. (2002) recommend: 1 + |H| a, at most 4. H is the mean curvature in 1/mm, and a = √(area / count)
/// in mm is about the spacing of evenly placed sources.
pub fn by_curvature(surface: &Surface, count: usize) -> Vec<f32> {
    let apart = (surface.areas().iter().sum::<f64>() / count.max(1) as f64).sqrt();
    let weight = |bend: f64| (1.0 + bend.abs() * apart).min(DENSEST) as f32;
    mean_curvature(surface, BEND_RINGS).into_iter().map(weight).collect()
}

/// Divides a graph into the geodesic Voronoi cells of evenly spread sources, as [`Sources::Farthest`], which are chosen
/// from some vertices. Returns the sources and, for each vertex, the number of the nearest source; the first of several,
/// and `u32::MAX` if no path leads to one. All vertices on the shortest path to the source are in the same cell.
///
/// # Errors
/// [`Error::NoSuchPoint`], [`Error::TooManySources`] if there are fewer vertices to choose from, and
/// [`Error::Cancelled`].
pub fn cells(
    graph: &impl Links, from: &[u32], count: usize, seed: u64, control: &Control,
) -> Result<(Vec<u32>, Vec<u32>)> {
    let points = graph.vertices();
    check_points(from.iter().copied(), points)?;
    if count > from.len() {
        return Err(Error::TooManySources { sources: count, points: from.len() });
    }
    let first = random(from.len(), count.min(1), seed).first().map(|&n| from[n as usize]);
    let farthest_of = |nearest: &[f32]| {
        let greatest = from.iter().map(|&vertex| nearest[vertex as usize].to_bits()).fold(0, u32::max);
        from.iter().copied().find(|&vertex| nearest[vertex as usize].to_bits() == greatest)
    };
    let (sources, nearest) = farthest(graph, count, first, farthest_of, control)?;
    let mut cells = vec![u32::MAX; points];
    let mut stack = Vec::new();
    for (cell, &source) in (0..).zip(&sources) {
        control.check()?;
        cells[source as usize] = cell;
        stack.push(source);
        while let Some(vertex) = stack.pop() {
            for arc in graph.arcs(vertex) {
                let is_through = nearest[vertex as usize] + arc.length == nearest[arc.to as usize];
                if is_through && cells[arc.to as usize] == u32::MAX {
                    cells[arc.to as usize] = cell;
                    stack.push(arc.to);
                }
            }
        }
    }
    Ok((sources, cells))
}

/// Returns the sources, and the distance of each vertex to the nearest of them. `next` returns the next source for the
/// distances to the previous ones.
fn farthest(
    graph: &impl Links, count: usize, first: Option<u32>, next: impl Fn(&[f32]) -> Option<u32>, control: &Control,
) -> Result<(Vec<u32>, Vec<f32>)> {
    control.begin("choosing sources", count as u64);
    let mut search = Search::new(graph);
    let mut nearest = vec![f32::INFINITY; graph.vertices()]; // distance to the sources so far
    let mut chosen = Vec::with_capacity(count);
    let mut source = first;
    while let (Some(vertex), true) = (source, chosen.len() < count) {
        nearest[vertex as usize] = 0.0;
        search.lower(graph, &[vertex], &mut nearest, control)?;
        chosen.push(vertex);
        control.advance();
        source = next(&nearest);
    }
    Ok((chosen, nearest))
}

/// Returns the index of the first of the largest distances. Distances are not negative, so their bits have the same
/// order, and the largest of several integers is found with vector instructions.
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
    use nalgebra::Vector3;

    use super::*;
    use crate::adjacency::distinct;
    use crate::geodesic::graph::GeodesicGraph;
    use crate::surface::{mesh::shapes, voxels::graph::VoxelGraph};
    use crate::tests::{chained, row};
    use crate::volume::Mask;

    fn bent_sheet() -> VoxelGraph {
        let mask = Mask::from_fn([12, 15, 8], |[i, j, k]| k == j / 3 + usize::from(i > 6)).unwrap();
        chained(&mask, [1.0; 3]).1
    }

    #[test]
    fn each_source_is_farthest_by_its_weight_from_those_before() {
        let (graph, control) = (bent_sheet(), Control::default());
        let weights: Vec<f32> = (0..graph.vertices()).map(|v| 1.0 + (v % 7) as f32).collect();
        let weighted = |weights: &[f32]| Sources::Weighted { count: 12, seed: 5, weights: weights.to_vec() };
        let equal = vec![2.0; weights.len()];
        for (sources, weights) in [
            (Sources::Farthest { count: 12, seed: 5 }, &equal),
            (weighted(&equal), &equal),
            (weighted(&weights), &weights),
        ] {
            let chosen = sources.choose(&graph, &control).unwrap();
            let mut nearest = vec![f32::INFINITY; graph.vertices()];
            for (n, &source) in chosen.iter().enumerate() {
                let counted = |v: usize| nearest[v] * weights[v];
                assert!(n == 0 || counted(source as usize) == (0..weights.len()).map(counted).fold(0.0, f32::max));
                nearest.iter_mut().zip(row(&graph, source)).for_each(|(near, distance)| *near = near.min(distance));
            }
        }
    }

    #[test]
    fn each_vertex_is_in_the_cell_of_its_nearest_source() {
        let (graph, control) = (bent_sheet(), Control::default());
        let all: Vec<u32> = (0..graph.vertices() as u32).collect();
        let some: Vec<u32> = all.iter().copied().filter(|vertex| vertex % 3 == 1).collect();
        for (from, count) in [0, 1, 2, 12, some.len()].into_iter().flat_map(|count| [(&all, count), (&some, count)]) {
            let (sources, cells) = super::cells(&graph, from, count, 5, &control).unwrap();
            assert!(sources.iter().all(|source| from.contains(source)));
            assert_eq!(distinct(sources.clone()).len(), count);
            if from.len() == all.len() {
                assert_eq!(sources, Sources::Farthest { count, seed: 5 }.choose(&graph, &control).unwrap());
            }
            let rows: Vec<Vec<f32>> = sources.iter().map(|&source| row(&graph, source)).collect();
            for vertex in 0..graph.vertices() {
                let least = rows.iter().map(|row| row[vertex]).fold(f32::INFINITY, f32::min);
                match cells[vertex] {
                    u32::MAX => assert_eq!(count, 0),
                    cell => assert_eq!(rows[cell as usize][vertex], least),
                }
            }
        }
        let too_many = super::cells(&graph, &some, some.len() + 1, 5, &control);
        assert!(matches!(too_many, Err(Error::TooManySources { .. })));
    }

    #[test]
    fn sources_are_denser_where_the_surface_bends() {
        // a gutter: half a cylinder of radius 2 between two plane grids
        let half = std::f64::consts::PI;
        let bent_place = |p: &Vector3<f64>| {
            let (u, v) = (0.4 * (p.x - 30.0), 0.4 * p.y);
            let (x, z) = match u.clamp(-half, half) / 2.0 {
                turn if u.abs() <= half => (2.0 * turn.sin(), -2.0 * turn.cos()),
                turn => (u - 2.0 * turn + 2.0 * turn.signum(), 0.0),
            };
            Vector3::new(x, v, z)
        };
        let flat = shapes::surface(shapes::sheet(60, 40));
        let surface = flat.moved(flat.points().iter().map(bent_place).collect()).unwrap();
        let control = Control::default();
        let graph = GeodesicGraph::new(&surface, &control).unwrap();
        let weights = by_curvature(&surface, 60);
        assert!(weights.iter().all(|&weight| (1.0..=DENSEST as f32).contains(&weight)));
        let bent = |chosen: &[u32]| chosen.iter().filter(|&&v| surface.points()[v as usize].z < -0.5).count();
        let even = Sources::Farthest { count: 60, seed: 1 }.choose(&graph, &control).unwrap();
        let denser = Sources::Weighted { count: 60, seed: 1, weights }.choose(&graph, &control).unwrap();
        assert!(2 * bent(&denser) > 3 * bent(&even), "{} of {}", bent(&denser), bent(&even));
    }

    #[test]
    fn choices_depend_on_the_seed_alone() {
        let graph = bent_sheet();
        let control = Control::default();
        let choose = |sources: Sources| sources.choose(&graph, &control).unwrap();
        for count in [3, 10, graph.vertices()] {
            for seed in [0, 1] {
                let random = choose(Sources::Random { count, seed });
                assert_eq!(random, choose(Sources::Random { count, seed }));
                assert!(random.is_sorted_by(|a, b| a < b) && random.len() == count);
                let farthest = choose(Sources::Farthest { count, seed });
                assert_eq!(farthest, choose(Sources::Farthest { count, seed }));
                assert_eq!(distinct(farthest).len(), count);
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

    #[test]
    fn weights_follow_the_curvature_of_a_sphere_up_to_four() {
        let sphere = shapes::surface(shapes::sphere(4));
        for count in [1, 4, 20, 1000] {
            let spacing = (4.0 * std::f64::consts::PI / count as f64).sqrt();
            let expected = (1.0 + spacing).min(4.0) as f32;
            assert!(by_curvature(&sphere, count).iter().all(|weight| (weight - expected).abs() < 0.1), "{count}");
        }
    }
}
