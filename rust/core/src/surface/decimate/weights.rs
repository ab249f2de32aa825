//! Weights of a vertex: its position as a combination of the ring of neighbours, unfolded into the plane.
//!
//! Weights are complex numbers with sum one, so that rotating, moving and scaling the ring does the same to the vertex.
//!
//! Inside a ring, they are real and positive. The ring is unfolded as by Floater (1997): lengths are kept, and angles
//! are scaled to a full turn. Mean value coordinates (Floater 2003) of the vertex in this polygon are positive because
//! all of it is visible. For a plane ring, they are exact under every affine map. A vertex on the boundary lies outside
//! its neighbours, where no positive weights exist; its weights are those of the best-fitting similarity.

use std::f64::consts::{PI, TAU};

use nalgebra::{Complex, Vector3};

/// The widest angle between two neighbours, slightly less than a straight angle.
const WIDEST: f64 = PI - 1e-6;

/// The widest fan of a vertex on the boundary after unfolding.
const WIDEST_FAN: f64 = 0.95 * TAU;

pub(super) fn weights(apex: Vector3<f64>, ring: &[Vector3<f64>], is_closed: bool) -> Vec<[f64; 2]> {
    let spokes: Vec<Vector3<f64>> = ring.iter().map(|p| p - apex).collect();
    let found = if is_closed { within(&spokes) } else { beside(&spokes) };
    if found.iter().flatten().all(|w| w.is_finite()) {
        return found;
    }
    vec![[1.0 / ring.len() as f64, 0.0]; ring.len()] // coincident neighbours do not determine angles
}

fn angle(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    a.cross(b).norm().atan2(a.dot(b))
}

/// Returns mean value coordinates in the unfolded ring.
fn within(spokes: &[Vector3<f64>]) -> Vec<[f64; 2]> {
    let count = spokes.len();
    let angles: Vec<f64> = (0..count).map(|k| angle(&spokes[k], &spokes[(k + 1) % count])).collect();
    let scale = TAU / angles.iter().sum::<f64>();
    let tangents: Vec<f64> = angles.iter().map(|a| (0.5 * (scale * a).min(WIDEST)).tan()).collect();
    // (tan α_(k−1)/2 + tan α_k/2)/|spoke| (Floater 2003)
    let raw = |k: usize| (tangents[(k + count - 1) % count] + tangents[k]) / spokes[k].norm();
    let sum: f64 = (0..count).map(raw).sum();
    (0..count).map(|k| [raw(k) / sum, 0.0]).collect()
}

/// Returns the weights of the least-squares similarity of the unfolded fan at its apex; near neighbours weigh more.
fn beside(spokes: &[Vector3<f64>]) -> Vec<[f64; 2]> {
    let angles: Vec<f64> = spokes.windows(2).map(|pair| angle(&pair[0], &pair[1])).collect();
    let scale = (WIDEST_FAN / angles.iter().sum::<f64>()).min(1.0);
    let mut direction = 0.0;
    let mut places = vec![Complex::new(spokes[0].norm(), 0.0)];
    for (spoke, angle) in spokes[1..].iter().zip(&angles) {
        direction += scale * angle;
        places.push(Complex::from_polar(spoke.norm(), direction));
    }
    let near: Vec<f64> = places.iter().map(|place| 1.0 / place.norm_sqr()).collect();
    let total: f64 = near.iter().sum();
    let mean = places.iter().zip(&near).map(|(place, n)| place * (n / total)).sum::<Complex<f64>>();
    let spread: f64 = places.iter().zip(&near).map(|(place, n)| n * (place - mean).norm_sqr()).sum();
    let weight = |(place, n): (&Complex<f64>, &f64)| {
        // least squares of z ↦ a + b z: at the apex, z = 0, it is the mean of the targets minus b times that of z
        let weight = Complex::new(n / total, 0.0) - mean * (place - mean).conj() * (n / spread);
        [weight.re, weight.im]
    };
    places.iter().zip(&near).map(weight).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};
    use proptest::prelude::*;

    fn made(weights: &[[f64; 2]], places: &[Complex<f64>]) -> Complex<f64> {
        weights.iter().zip(places).map(|(&[re, im], place)| Complex::new(re, im) * place).sum()
    }

    /// Returns a ring in the plane that is visible from its vertex, given its angular steps and lengths.
    fn ring(steps: &[f64], lengths: &[f64], turn: f64) -> Vec<Complex<f64>> {
        let mut direction = 0.0;
        let at = |(step, &length): (&f64, &f64)| {
            direction += step;
            Complex::from_polar(length, direction * turn)
        };
        steps.iter().zip(lengths).map(at).collect()
    }

    fn in_space(places: &[Complex<f64>]) -> Vec<Vector3<f64>> {
        places.iter().map(|p| Vector3::new(p.re, 0.6 * p.im, 0.8 * p.im)).collect()
    }

    proptest! {
        #[test]
        fn rings_of_the_plane_give_every_affine_map(
            steps in prop::collection::vec(0.8f64..1.2, 4..9),
            lengths in prop::collection::vec(0.2f64..5.0, 9),
            by in prop::array::uniform4(-3.0f64..3.0),
        ) {
            let turn = TAU / steps.iter().sum::<f64>();
            let places = ring(&steps, &lengths, turn);
            let found = weights(Vector3::zeros(), &in_space(&places), true);
            prop_assert!(found.iter().all(|&[re, im]| re > 0.0 && im == 0.0));
            let affine = |p: &Complex<f64>| Complex::new(7.0 + by[0] * p.re + by[1] * p.im, by[2] * p.re + by[3] * p.im);
            let mapped: Vec<_> = places.iter().map(affine).collect();
            prop_assert!((made(&found, &mapped) - affine(&Complex::default())).norm() < 1e-9);
        }

        #[test]
        fn fans_of_the_plane_give_every_similarity(
            steps in prop::collection::vec(0.5f64..1.2, 2..6),
            lengths in prop::collection::vec(0.2f64..5.0, 6),
            (re, im) in (-3.0f64..3.0, -3.0f64..3.0),
        ) {
            let places = ring(&steps, &lengths, 1.0);
            let found = weights(Vector3::zeros(), &in_space(&places), false);
            let similar = |p: &Complex<f64>| Complex::new(re, im) * p + Complex::new(5.0, -2.0);
            let mapped: Vec<_> = places.iter().map(similar).collect();
            prop_assert!((made(&found, &mapped) - similar(&Complex::default())).norm() < 1e-9);
        }
    }

    #[test]
    fn coinciding_neighbours_count_alike() {
        let one = Vector3::new(1.0, 2.0, 3.0);
        for is_closed in [true, false] {
            assert_eq!(weights(one, &[one; 4], is_closed), [[0.25, 0.0]; 4]);
        }
    }

    #[test]
    fn a_fan_gives_the_similarity_that_fits_best_by_squared_nearness() {
        let places = ring(&[0.4, 0.9, 0.6, 0.7], &[0.5, 3.0, 1.0, 2.0], 1.0);
        let found = weights(Vector3::zeros(), &in_space(&places), false);
        let images = [(1.0, 0.3), (-2.0, 1.5), (0.2, -0.7), (4.0, 2.0)].map(|(re, im)| Complex::new(re, im));
        // a p + b, of which b is the image of the apex, with errors relative to the distance from the apex
        let design = DMatrix::from_fn(8, 4, |row, column| {
            let place = places[row / 2];
            let terms = [[place.re, -place.im, 1.0, 0.0], [place.im, place.re, 0.0, 1.0]];
            terms[row % 2][column] / place.norm()
        });
        let target = |row: usize| [images[row / 2].re, images[row / 2].im][row % 2] / places[row / 2].norm();
        let fit = design.svd(true, true).solve(&DVector::from_fn(8, |row, _| target(row)), 1e-12).unwrap();
        assert!((made(&found, &images) - Complex::new(fit[2], fit[3])).norm() < 1e-9, "{fit}");
    }
}
