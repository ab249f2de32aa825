//! The error of a solver's distances, compared with exact distances.

use rayon::prelude::*;

use super::evaluate::reference_sources;
use crate::geodesic::Solver;
use crate::geodesic::exact::{Exact, Reach};
use crate::rows::DistanceRows;
use crate::surface::Surface;
use crate::{Control, Result};

/// On surfaces with up to this many vertices, all vertices are compared from a few sources. On larger surfaces, the
/// vertices nearest to each of more sources are compared, because the cost of exact distances grows faster than the
/// surface, and much faster on smooth surfaces (docs/decisions/0034).
const ALL_COMPARED: usize = 20_000;
const FEW_SOURCES: usize = 2;
const MORE_SOURCES: usize = 8;
const COMPARED: usize = 10_000;

/// Returns the relative error of a solver's distances: the mean of |δ/δ_exact − 1| over the vertices other than the
/// source, from two random sources. On surfaces with more than 20,000 vertices, from eight sources over about 10,000
/// nearest vertices each. NaN if there are none.
///
/// # Errors
/// [`Error::Unreachable`](crate::Error::Unreachable) if the surface is not connected, and the errors of the solver.
pub fn error_of_distances<S: Solver>(surface: &Surface, solver: &S, seed: u64, control: &Control) -> Result<f64> {
    let count = if is_large(surface.len()) { MORE_SOURCES } else { FEW_SOURCES };
    error_from(&reference_sources(surface.len(), count, seed), surface, solver, control)
}

fn is_large(vertices: usize) -> bool {
    vertices > ALL_COMPARED
}

fn error_from<S: Solver>(sources: &[u32], surface: &Surface, solver: &S, control: &Control) -> Result<f64> {
    let found = DistanceRows::compute(solver, sources, control)?;
    let farthest = |n: usize| {
        let mut row = found.row(n).to_vec();
        is_large(row.len()).then(|| f64::from(*row.select_nth_unstable_by(COMPARED, f32::total_cmp).1))
    };
    // a solver's distances are rarely shorter than exact ones, so the radius holds at least as many vertices
    let mm = (0..sources.len()).filter_map(farthest).reduce(f64::max).unwrap_or(f64::INFINITY);
    let exact = Exact::new(surface).within(Reach { mm, rings: None });
    let of_source = |(n, &source): (usize, &u32)| {
        let mut row = vec![0.0; surface.len()];
        exact.row(source, &mut row, &mut exact.scratch(), control)?;
        let pairs = found.row(n).iter().zip(row).filter(|&(_, exact)| exact > 0.0 && exact.is_finite());
        Ok(pairs.map(|(&found, exact)| (f64::from(found) / f64::from(exact) - 1.0).abs()).collect())
    };
    let errors: Vec<Vec<f64>> = sources.par_iter().enumerate().map(of_source).collect::<Result<_>>()?;
    let errors = errors.concat();
    Ok(pairwise_sum(&errors) / errors.len() as f64)
}

/// Sums by halves, in the order of NumPy. The rounding error grows with the logarithm of the number of values.
fn pairwise_sum(values: &[f64]) -> f64 {
    if values.len() > 128 {
        let half = values.len() / 2 / 8 * 8;
        return pairwise_sum(&values[..half]) + pairwise_sum(&values[half..]);
    }
    let (eights, rest) = values.as_chunks::<8>();
    let lanes = eights.iter().copied().reduce(|sums, eight| std::array::from_fn(|k| sums[k] + eight[k]));
    let [a, b, c, d, e, f, g, h] = lanes.unwrap_or_default();
    rest.iter().fold(((a + b) + (c + d)) + ((e + f) + (g + h)), |sum, value| sum + value)
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;
    use crate::adjacency::Links;
    use crate::geodesic::graph::GeodesicGraph;
    use crate::geodesic::marching::{Marching, Wave};
    use crate::surface::mesh::shapes;
    use crate::tests::Altered;

    #[test]
    fn links_are_exact_on_a_plane_and_a_little_too_long_on_a_sphere() {
        let control = Control::default();
        let error = |shape| {
            let surface = shapes::surface(shape);
            let graph = GeodesicGraph::new(&surface, &control).unwrap();
            assert_eq!(graph.vertices(), surface.len());
            error_from(&[0, 7], &surface, &graph, &control).unwrap()
        };
        assert!(error(shapes::sheet(12, 9)) < 2e-3);
        let sphere = error(shapes::sphere(3));
        assert!((1e-5..0.02).contains(&sphere), "{sphere}");
    }

    #[test]
    fn exact_distances_are_not_off_and_marched_ones_are() {
        let (control, surface) = (Control::default(), shapes::surface(shapes::sphere(3)));
        assert_eq!(error_from(&[0, 7], &surface, &Exact::new(&surface), &control), Ok(0.0));
        let marching = Marching::new(&surface, Wave::Circle, &control).unwrap();
        let error = error_from(&[0, 7], &surface, &marching, &control).unwrap();
        assert!((1e-4..0.03).contains(&error), "{error}");
    }

    #[test]
    fn on_large_surfaces_the_nearest_are_compared() {
        let control = Control::default();
        let error = |side: usize, beyond: f32| {
            let surface = shapes::surface(shapes::sheet(side, side));
            let corner = [0]; // the 10,000 nearest vertices reach 113 mm
            let exact = Exact::new(&surface);
            let stretched = Altered(&exact, |row: &mut [f32]| {
                row.iter_mut().filter(|distance| **distance > beyond).for_each(|distance| *distance *= 2.0);
                Ok(())
            });
            error_from(&corner, &surface, &stretched, &control).unwrap()
        };
        assert_eq!(error(144, 120.0), 0.0);
        assert!((error(144, 56.0) - 0.88).abs() < 0.02); // with twice their distance, it reaches all
        assert!(error(139, 120.0) > 0.2); // 19,600 vertices: all of them are compared
    }

    #[test]
    fn a_large_surface_is_compared_from_eight_sources_and_others_from_two() {
        let control = Control::default();
        for (side, sources) in [(139, 2), (144, 8)] {
            let surface = shapes::surface(shapes::sheet(side, side));
            let marching = Marching::new(&surface, Wave::Circle, &control).unwrap();
            let rows = AtomicUsize::new(0);
            let counted = Altered(&marching, |_: &mut [f32]| {
                rows.fetch_add(1, Ordering::Relaxed);
                Ok(())
            });
            assert!(error_of_distances(&surface, &counted, 0, &control).unwrap() < 1e-2);
            assert_eq!(rows.into_inner(), sources, "{side}");
        }
    }

    #[test]
    fn sums_are_right_whatever_their_number() {
        for count in [0, 1, 7, 8, 9, 127, 128, 129, 1000, 12_345] {
            let values: Vec<f64> = (0..count).map(|n| f64::from(n) * 0.1).collect();
            let expected = 0.05 * f64::from(count) * (f64::from(count) - 1.0);
            assert!((pairwise_sum(&values) - expected).abs() <= 1e-12 * expected.abs(), "{count}");
        }
    }
}
