//! How far distances along straight links are from exact ones.

use crate::control::Control;
use crate::error::Result;
use crate::geodesic::exact::Exact;
use crate::geodesic::graph::GeodesicGraph;
use crate::rows::DistanceRows;
use crate::surface::Surface;

/// By which part of themselves distances along the graph's links from some sources are longer than exact ones: the mean over
/// all vertices apart from their source; NaN where there are none.
///
/// # Errors
/// [`crate::Error::Unreachable`], [`crate::Error::Cancelled`].
///
/// # Examples
/// ```
/// use voxflat::control::Control;
/// use voxflat::distortion::links::error_of_links;
/// use voxflat::geodesic::graph::GeodesicGraph;
/// use voxflat::surface::mesh::shapes;
///
/// let control = Control::default();
/// let sheet = shapes::surface(shapes::sheet(8, 8)); // 8 by 8 squares of 1 mm, in the plane z = 0
/// let graph = GeodesicGraph::new(&sheet, &control)?;
/// assert!(error_of_links(&sheet, &graph, &[0, 40], &control)?.abs() < 0.002);
/// # Ok::<(), voxflat::Error>(())
/// ```
pub fn error_of_links(surface: &Surface, graph: &GeodesicGraph, sources: &[u32], control: &Control) -> Result<f64> {
    let found = DistanceRows::compute(graph, sources, control)?.into_data();
    let exact = DistanceRows::compute(&Exact::new(surface), sources, control)?.into_data();
    let pairs = found.into_iter().zip(exact).filter(|&(_, exact)| exact > 0.0);
    let errors: Vec<f64> = pairs.map(|(found, exact)| f64::from(found) / f64::from(exact) - 1.0).collect();
    Ok(pairwise_sum(&errors) / errors.len() as f64)
}

/// A sum in halves, whose rounding grows with the logarithm of the number of values; in the order in which NumPy adds.
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
    use super::*;
    use crate::adjacency::Links;
    use crate::surface::mesh::shapes;

    #[test]
    fn links_are_exact_on_a_plane_and_a_little_too_long_on_a_sphere() {
        let control = Control::default();
        let error = |shape| {
            let surface = shapes::surface(shape);
            let graph = GeodesicGraph::new(&surface, &control).unwrap();
            assert_eq!(graph.vertices(), surface.len());
            error_of_links(&surface, &graph, &[0, 7], &control).unwrap()
        };
        assert!(error(shapes::sheet(12, 9)).abs() < 2e-3);
        let sphere = error(shapes::sphere(3));
        assert!((1e-5..0.02).contains(&sphere), "{sphere}");
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
