//! Landmark placement: where a point lies, from its distances to the sources.
//!
//! de Silva and Tenenbaum (2004): with X (m × 2, centred) the places of the sources, δᵢ(p) the distance of p from source i
//! and μᵢ the mean over all sources j of δᵢⱼ², p lies at x(p) = −½ X⁺ (δ²(p) − μ). For points of the plane that is exact, and
//! for the sources themselves it gives their places again. Unlike functions of the position in space it knows nothing of
//! what is near through the air: banks of a fold do not leak into each other.

use nalgebra::{Matrix2, Vector2};
use rayon::prelude::*;

use crate::control::Control;
use crate::error::{Error, Result};
use crate::rows::{DistanceRows, Rows};

/// Points that are placed between two looks at the clock.
const BATCH: usize = 1024;

/// The places of all points (mm), from rows of distances to all of them, the sources' distances among themselves, and the
/// places of the sources. Rows are visited once, in their order.
///
/// # Errors
/// [`Error::NotPlanar`] if the sources lie on a line, [`Error::Cancelled`], and those of reading rows.
///
/// # Panics
/// If there is not one place a source.
pub fn place(rows: &impl Rows, among: &DistanceRows, places: &[[f64; 2]], control: &Control) -> Result<Vec<[f64; 2]>> {
    let terms = Terms::new(among, places)?;
    let (columns, count) = (rows.columns(), rows.sources().len());
    control.begin("placing the rest", (count.div_ceil(rows.block_rows()) * columns.div_ceil(BATCH)) as u64);
    let mut uv = vec![terms.centre; columns];
    rows.visit(control, &mut |first, block| {
        uv.par_chunks_mut(BATCH).enumerate().try_for_each(|(batch, sums)| {
            control.check()?;
            for (row, (weight, mean)) in block.chunks(columns).zip(&terms.of_source[first..]) {
                for (sum, &distance) in sums.iter_mut().zip(&row[batch * BATCH..]) {
                    *sum += weight * (f64::from(distance).powi(2) - mean);
                }
            }
            control.advance();
            Ok(())
        })
    })?;
    Ok(uv.into_iter().map(Into::into).collect())
}

/// x(p) = centre + Σᵢ weightᵢ (δᵢ²(p) − μᵢ).
struct Terms {
    centre: Vector2<f64>,
    of_source: Vec<(Vector2<f64>, f64)>,
}

impl Terms {
    fn new(among: &DistanceRows, places: &[[f64; 2]]) -> Result<Self> {
        assert_eq!(places.len(), among.sources().len(), "one place a source");
        let count = places.len() as f64;
        let centre = places.iter().map(|&p| Vector2::from(p)).sum::<Vector2<f64>>() / count;
        let centred: Vec<Vector2<f64>> = places.iter().map(|&p| Vector2::from(p) - centre).collect();
        let gram: Matrix2<f64> = centred.iter().map(|p| p * p.transpose()).sum();
        let inverse = gram.try_inverse().ok_or(Error::NotPlanar { positive: 1 })?;
        let mean = |i: usize| among.row(i).iter().map(|&distance| f64::from(distance).powi(2)).sum::<f64>() / count;
        let of_source = centred.iter().enumerate().map(|(i, p)| (inverse * p * -0.5, mean(i))).collect();
        Ok(Self { centre, of_source })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn rows_of(points: &[[f64; 2]], sources: &[u32]) -> DistanceRows {
        let row = |&source: &u32| {
            let [x, y] = points[source as usize];
            points.iter().map(move |&[u, v]| (x - u).hypot(y - v) as f32)
        };
        DistanceRows::new(sources.to_vec(), points.len(), sources.iter().flat_map(row).collect())
    }

    proptest! {
        #[test]
        fn points_of_the_plane_are_placed_exactly(points in prop::collection::vec(prop::array::uniform2(-50.0..50.0f64), 20..3000)) {
            let sources = [0, 3, 5, 11, 19];
            let places = sources.map(|s: u32| points[s as usize]);
            let rows = rows_of(&points, &sources);
            let control = Control::default();
            let placed = place(&rows, &rows.among(&control).unwrap(), &places, &control);
            let spread: f64 = places.iter().flat_map(|p| places.map(|q| ((p[0] - places[0][0]) * (q[1] - places[0][1]) - (p[1] - places[0][1]) * (q[0] - places[0][0])).abs())).fold(0.0, f64::max);
            prop_assume!(spread > 500.0); // sources nearly on a line say little across it
            for (a, b) in placed.unwrap().iter().zip(&points) {
                prop_assert!((a[0] - b[0]).hypot(a[1] - b[1]) < 0.02, "{a:?} {b:?}");
            }
        }
    }

    #[test]
    fn sources_on_a_line_are_refused() {
        let points = [[0.0, 0.0], [1.0, 0.0], [3.0, 0.0]];
        let rows = rows_of(&points, &[0, 1, 2]);
        let refused = place(&rows, &rows, &points, &Control::default());
        assert_eq!(refused.unwrap_err(), Error::NotPlanar { positive: 1 });
    }
}
