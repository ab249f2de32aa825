//! Classical scaling.
//!
//! Grossmann et al. (2002), section 3: with distances Δ and J = I − 11ᵀ/m, B = −½ J (Δ∘Δ) J. With (λ₁, v₁), (λ₂, v₂)
//! the two largest positive eigenpairs of B, the positions are X = [√λ₁ v₁ | √λ₂ v₂]. They minimise strain.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::matrix_free::eigen::{PartialEigenParams, partial_self_adjoint_eigen, partial_self_adjoint_eigen_scratch};
use faer::{Col, Mat, Par, Side, linalg::solvers::SelfAdjointEigen};

use crate::rows::DistanceRows;
use crate::sources::check_enough;
use crate::{Error, Result};

/// Up to this size, all eigenpairs are computed; above, only the leading ones (the iterative solver needs some room).
const DENSE: usize = 256;

/// The number of eigenvalues with the largest magnitude that are kept.
const SPECTRUM: usize = 12;

/// Eigenvalues below this share of ‖B‖ are attributed to rounding, because rows are f32.
const ROUNDING: f64 = 1e-6;

/// The positions of the sources in the plane, and the planarity of their distances.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Scaling {
    /// Positions in mm, centred at the origin, along the principal axes.
    pub places: Vec<[f64; 2]>,
    /// The eigenvalues of B with the largest magnitude (mm²), in decreasing order of magnitude. Two dominant ones mean
    /// a planar surface; negative ones cannot be embedded in any dimension.
    pub eigenvalues: Vec<f64>,
    /// The share of Σ λ² of all eigenvalues in the two used ones: 1 for a surface that is isometric to the plane.
    pub planarity: f64,
}

/// Computes classical scaling of the distances among sources. The distances in the two directions are averaged.
pub(crate) fn classical_scaling(distances: &DistanceRows) -> Result<Scaling> {
    let m = distances.sources().len();
    check_enough(m)?;
    let b = double_centred(distances);
    let (values, vectors) = if m <= DENSE { all_eigenpairs(&b)? } else { leading_eigenpairs(&b)? };
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&p, &q| values[q].abs().total_cmp(&values[p].abs()));
    order.truncate(SPECTRUM);

    // ‖B‖² = Σ λ² over all eigenvalues, of which only some are known
    let total = (0..m).map(|j| b.col(j).squared_norm_l2()).sum::<f64>();
    let noise = total.sqrt() * ROUNDING;
    let mut positive: Vec<usize> = order.iter().copied().filter(|&k| values[k] > noise).collect();
    positive.sort_by(|&p, &q| values[q].total_cmp(&values[p]));
    let [first, second, ..] = positive[..] else { return Err(Error::NotPlanar { positive: positive.len() }) };
    let axis = |k: usize| {
        let column = vectors.col(k);
        // the sign of an eigenvector is arbitrary: the entry with the largest magnitude becomes positive
        let largest = (0..m).rev().max_by(|&p, &q| column[p].abs().total_cmp(&column[q].abs())).unwrap_or(0);
        (column, values[k].sqrt().copysign(column[largest]))
    };
    let ((x, sx), (y, sy)) = (axis(first), axis(second));
    Ok(Scaling {
        // X = Q Λ^½ (Zigelman, Kimmel & Kiryati 2002, eq. 6)
        places: (0..m).map(|i| [sx * x[i], sy * y[i]]).collect(),
        eigenvalues: order.iter().map(|&k| values[k]).collect(),
        planarity: (values[first].powi(2) + values[second].powi(2)) / total,
    })
}

/// Returns B = −½ J (Δ∘Δ) J.
fn double_centred(distances: &DistanceRows) -> Mat<f64> {
    let m = distances.sources().len();
    let squared = |i: usize, j: usize| {
        let mean = 0.5 * (f64::from(distances.row(i)[j]) + f64::from(distances.row(j)[i]));
        mean * mean
    };
    let mut b = Mat::from_fn(m, m, squared);
    // J A J subtracts row and column means and adds the total mean (Zigelman, Kimmel & Kiryati 2002, eq. 3 and 5)
    let means: Vec<f64> = (0..m).map(|j| b.col(j).iter().sum::<f64>() / m as f64).collect();
    let mean = means.iter().sum::<f64>() / m as f64;
    for j in 0..m {
        for i in 0..m {
            b[(i, j)] = -0.5 * (b[(i, j)] - means[i] - means[j] + mean);
        }
    }
    b
}

fn all_eigenpairs(b: &Mat<f64>) -> Result<(Vec<f64>, Mat<f64>)> {
    let eigen =
        SelfAdjointEigen::new(b.as_ref(), Side::Lower).map_err(|_| Error::EigenNotConverged { sources: b.nrows() })?;
    Ok((eigen.S().column_vector().iter().copied().collect(), eigen.U().to_owned()))
}

/// Returns the eigenpairs with the largest magnitude, by a restarted Krylov method from a fixed start.
fn leading_eigenpairs(b: &Mat<f64>) -> Result<(Vec<f64>, Mat<f64>)> {
    let m = b.nrows();
    let scale = b.norm_l2();
    // an irregular start on every machine alike, which is unlikely to be orthogonal to an eigenvector
    let start = Col::from_fn(m, |i| 1.0 + (i as f64 * 0.618_033_988_749_895).fract());
    let start = &start * faer::Scale(1.0 / start.norm_l2());
    let mut values = vec![0.0; SPECTRUM];
    let mut vectors = Mat::zeros(m, SPECTRUM);
    let params = PartialEigenParams::default();
    let scratch = partial_self_adjoint_eigen_scratch(b, SPECTRUM, Par::Seq, params);
    let found = partial_self_adjoint_eigen(
        vectors.as_mut(),
        &mut values,
        b,
        start.as_ref(),
        1e-10 * scale, // the solver's tolerance is absolute
        Par::Seq,
        MemStack::new(&mut MemBuffer::new(scratch)),
        params,
    );
    // the leading two determine the map; a tail of equal small values may remain unconverged
    if found.n_converged_eigen < 2 {
        return Err(Error::EigenNotConverged { sources: m });
    }
    let kept = found.n_converged_eigen.min(SPECTRUM);
    values.truncate(kept);
    Ok((values, vectors.get(.., ..kept).to_owned()))
}

/// Returns the maximum memory in bytes of [`classical_scaling`], or of a system of as many radial functions: distances
/// of four bytes between any two sources, a matrix of f64, and its factor.
pub(crate) const fn memory_need(sources: usize) -> u64 {
    (4 + 8 + 8) * (sources as u64).pow(2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn points(count: usize, spread: [f64; 3]) -> Vec<[f64; 3]> {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        (0..count).map(|_| spread.map(|s| rng.random_range(-1.0..1.0) * s)).collect()
    }

    fn distance(p: &[f64], q: &[f64]) -> f64 {
        p.iter().zip(q).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
    }

    fn distances(points: &[[f64; 3]]) -> DistanceRows {
        let data = points.iter().flat_map(|p| points.iter().map(|q| distance(p, q) as f32)).collect();
        DistanceRows::new((0..points.len() as u32).collect(), points.len(), data)
    }

    #[test]
    fn planar_distances_are_recovered_by_both_solvers() {
        for count in [3, 40, DENSE, DENSE + 1, 600] {
            let points = points(count, [30.0, 20.0, 0.0]);
            let scaling = classical_scaling(&distances(&points)).unwrap();
            for (p, x) in points.iter().zip(&scaling.places) {
                for (q, y) in points.iter().zip(&scaling.places) {
                    assert!((distance(p, q) - distance(x, y)).abs() < 1e-4);
                }
            }
            assert!(scaling.planarity > 1.0 - 1e-9);
        }
    }

    #[test]
    fn both_solvers_find_the_leading_eigenpairs() {
        let b = double_centred(&distances(&points(400, [30.0, 20.0, 6.0])));
        let (all, dense) = all_eigenpairs(&b).unwrap();
        let (leading, sparse) = leading_eigenpairs(&b).unwrap();
        let mut expected: Vec<usize> = (0..all.len()).collect();
        expected.sort_by(|&p, &q| all[q].abs().total_cmp(&all[p].abs()));
        for k in 0..3 {
            let found = (0..leading.len()).min_by(|&p, &q| {
                (leading[p] - all[expected[k]]).abs().total_cmp(&(leading[q] - all[expected[k]]).abs())
            });
            let found = found.unwrap();
            assert!((leading[found] - all[expected[k]]).abs() < 1e-6 * all[expected[0]]);
            let cosine: f64 = (0..400).map(|i| dense[(i, expected[k])] * sparse[(i, found)]).sum();
            assert!(cosine.abs() > 1.0 - 1e-6);
        }
    }

    #[test]
    fn planarity_is_the_planes_share_of_the_spectrum() {
        let points = points(100, [30.0, 20.0, 6.0]);
        let b = double_centred(&distances(&points));
        let (mut all, _) = all_eigenpairs(&b).unwrap();
        all.sort_by(|p, q| q.total_cmp(p));
        let squares: Vec<f64> = all.iter().map(|value| value * value).collect();
        let share = (squares[0] + squares[1]) / squares.iter().sum::<f64>();
        let scaling = classical_scaling(&distances(&points)).unwrap();
        assert!((scaling.planarity - share).abs() < 1e-9);
        assert_eq!(scaling.eigenvalues.len(), 12);
        all.sort_by(|p, q| q.abs().total_cmp(&p.abs()));
        for (found, value) in scaling.eigenvalues.iter().zip(&all) {
            assert!((found.abs() - value.abs()).abs() < 1e-6 * all[0], "{found} {value}");
        }
    }

    #[test]
    fn lines_and_too_few_sources_are_refused() {
        let line = distances(&points(50, [30.0, 0.0, 0.0]));
        assert_eq!(classical_scaling(&line), Err(Error::NotPlanar { positive: 1 }));
        let two = distances(&points(2, [1.0; 3]));
        assert_eq!(classical_scaling(&two), Err(Error::TooFewSources { sources: 2, needed: 3 }));
    }
}
