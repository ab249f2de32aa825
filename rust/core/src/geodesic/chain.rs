//! Lengths of the links of a 26-directional chain code, such that the length of a digitised line is right on average.
//!
//! # The estimator
//! Grossmann et al. (2002), equations 1 and 2, after Kiryati and Kübler (1995): a digital path with N₁ direct, N₂ minor
//! diagonal and N₃ major diagonal links has length 0.9016 N₁ + 1.289 N₂ + 1.615 N₃ voxels. Of all linear estimators
//! that are unbiased for straight lines of uniformly random direction, it has the least mean square error (RMS 2.88 %).
//!
//! # Any spacing
//! The same principle gives the weights of an anisotropic grid. A line of unit length (mm) in direction u advances a =
//! |u₁|/h₁, b = |u₂|/h₂, c = |u₃|/h₃ voxels along the three axes. Let the axes be numbered so that a ≥ b ≥ c. Its chain
//! code has one link for each step along the first axis; a share b/a of them also steps along the second axis, and c/a
//! along the third. For almost every direction, the two rounding phases are independent and uniform, so that both steps
//! coincide in a share (b/a)(c/a). The expected numbers of links per mm are therefore
//!
//! ```text
//! N(first axis)            = a (1 − b/a)(1 − c/a)
//! N(first and second axis) = b (1 − c/a)
//! N(first and third axis)  = c (1 − b/a)
//! N(all three)             = b c / a
//! ```
//!
//! There are seven kinds of links (three direct, three minor diagonal, one major diagonal). With n(u) their expected
//! numbers, the weights ψ minimise the mean of (ψ·n(u) − 1)² under the condition that the mean of ψ·n(u) is 1, over u
//! uniform on the sphere: with G the mean of n nᵀ and g that of n, ψ = G⁻¹g / (gᵀG⁻¹g). On a cubic grid, this gives the
//! published constants (to 0.001), which are then used as published.

use nalgebra::{SMatrix, SVector};

use crate::surface::{VoxelSurface, voxels::graph::VoxelGraph};
use crate::{Control, Error, Result};

/// The weights of Kiryati and Kübler in voxels: direct, minor diagonal, major diagonal link.
// Grossmann, Kiryati & Kimmel 2002, eq. 2
pub(crate) const KIRYATI_KUBLER: [f64; 3] = [0.9016, 1.289, 1.615];

/// The largest ratio of spacings for which links are measured. Far above, most steps along the long axis coincide with
/// steps along the short ones, and weights that are right on average are meaningless for a single line.
const MOST_ANISOTROPIC: f64 = 20.0;

/// How the links of a digital path are measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LinkLengths {
    /// The unbiased estimator of Grossmann et al. (2002).
    #[default]
    ChainCode,
    /// The Euclidean distance between voxel centres (1, √2, √3 times the spacing), which overestimates; for comparison.
    Euclidean,
}

/// The lengths in mm of the seven kinds of links. A kind is the set of axes along which the link steps: bit 0 for the
/// first axis, bit 1 for the second, bit 2 for the third.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChainWeights([f64; 8]);

impl ChainWeights {
    /// Computes the weights for voxels of this spacing (mm).
    ///
    /// # Errors
    /// [`Error::TooAnisotropic`] if the longest spacing exceeds the shortest one by more than a factor of 20.
    pub fn new(spacing: [f64; 3], lengths: LinkLengths) -> Result<Self> {
        let longest = spacing.iter().fold(0.0, |a: f64, &b| a.max(b));
        let shortest = spacing.iter().fold(f64::INFINITY, |a: f64, &b| a.min(b));
        if longest > MOST_ANISOTROPIC * shortest {
            return Err(Error::TooAnisotropic { longest, shortest, most: MOST_ANISOTROPIC });
        }
        Ok(match lengths {
            LinkLengths::Euclidean => Self(std::array::from_fn(|kind| {
                (0..3).filter(|axis| kind >> axis & 1 == 1).map(|axis| spacing[axis].powi(2)).sum::<f64>().sqrt()
            })),
            LinkLengths::ChainCode if is_cubic(spacing) => {
                let mean = spacing.iter().sum::<f64>() / 3.0;
                Self(std::array::from_fn(|kind| match kind.count_ones() {
                    0 => 0.0,
                    links => KIRYATI_KUBLER[links as usize - 1] * mean,
                }))
            }
            LinkLengths::ChainCode => unbiased(spacing),
        })
    }

    /// Returns the length in mm of each kind of link; that of kind 0, which makes no step, is 0.
    pub fn lengths(&self) -> [f64; 8] {
        self.0
    }
}

/// Returns whether the spacings differ by no more than the rounding of a header.
fn is_cubic(spacing: [f64; 3]) -> bool {
    let largest = spacing.iter().fold(0.0, |a: f64, &b| a.max(b));
    spacing.iter().all(|&h| (largest - h).abs() < 1e-3 * largest)
}

/// Returns the least-squares unbiased weights for a grid, as derived above.
fn unbiased(spacing: [f64; 3]) -> ChainWeights {
    // |u| alone enters the counts, so one octant has the means of the whole sphere
    let mut gram = SMatrix::<f64, 7, 7>::zeros();
    let mut mean = SVector::<f64, 7>::zeros();
    for direction in octant_directions() {
        let counts = expected_links(direction, spacing);
        gram += counts * counts.transpose();
        mean += counts;
    }
    let count = OCTANT_POINTS as f64;
    let (gram, mean) = (gram / count, mean / count);
    // G is positive definite for any spacing: no kind of link depends linearly on the others over the sphere
    // Lagrange: G ψ = (1 + μ) g, so ψ is G⁻¹g, scaled such that ψ·g = 1
    let solution = gram.cholesky().map_or(mean, |factor| factor.solve(&mean));
    let weights = solution / mean.dot(&solution);
    ChainWeights(std::array::from_fn(|kind| if kind == 0 { 0.0 } else { weights[kind - 1] }))
}

/// Returns the expected numbers of the seven kinds of links per mm of a line in direction `u`.
fn expected_links(u: [f64; 3], spacing: [f64; 3]) -> SVector<f64, 7> {
    let steps: [f64; 3] = std::array::from_fn(|axis| u[axis].abs() / spacing[axis]);
    let mut order = [0, 1, 2];
    order.sort_by(|&p, &q| steps[q].total_cmp(&steps[p]));
    let [first, second, third] = order.map(|axis| 1usize << axis);
    let [a, b, c] = order.map(|axis| steps[axis]);
    let mut counts = SVector::zeros();
    counts[first - 1] = a * (1.0 - b / a) * (1.0 - c / a);
    counts[(first | second) - 1] = b * (1.0 - c / a);
    counts[(first | third) - 1] = c * (1.0 - b / a);
    counts[(first | second | third) - 1] = b * c / a;
    counts
}

const OCTANT_POINTS: usize = 100_000;

/// Returns directions that are evenly spread over the first octant of the sphere (a Fibonacci lattice).
fn octant_directions() -> impl Iterator<Item = [f64; 3]> {
    let golden = (5f64.sqrt() - 1.0) / 2.0;
    (0..OCTANT_POINTS).map(move |n| {
        // zones of equal height have equal areas (Archimedes), and golden angles spread evenly within them
        let z = (n as f64 + 0.5) / OCTANT_POINTS as f64;
        let angle = std::f64::consts::FRAC_PI_2 * (n as f64 * golden).fract();
        let radius = (1.0 - z * z).sqrt();
        [radius * angle.cos(), radius * angle.sin(), z]
    })
}

/// Creates the 26-neighbour graph of a surface.
///
/// # Errors
/// [`Error::TooAnisotropic`], [`Error::GraphTooLarge`], and [`Error::Cancelled`].
pub fn chain_graph(surface: &VoxelSurface, lengths: LinkLengths, control: &Control) -> Result<VoxelGraph> {
    let weights = ChainWeights::new(surface.affine().spacing(), lengths)?;
    VoxelGraph::of(surface, weights.lengths(), control)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn random_direction(rng: &mut ChaCha8Rng) -> Vector3<f64> {
        let z = rng.random_range(-1.0..1.0f64);
        let angle = rng.random_range(0.0..std::f64::consts::TAU);
        let radius = (1.0 - z * z).sqrt();
        Vector3::new(radius * angle.cos(), radius * angle.sin(), z)
    }

    /// Returns the length of a chain of voxels by the weights; its links must join 26-neighbours.
    fn chain_length(chain: &[[i64; 3]], weights: &ChainWeights) -> f64 {
        let link = |pair: &[[i64; 3]]| {
            let kind = (0..3).map(|axis| ((pair[1][axis] - pair[0][axis]).unsigned_abs() as usize) << axis);
            assert!((0..3).all(|axis| (pair[1][axis] - pair[0][axis]).abs() <= 1));
            weights.lengths()[kind.sum::<usize>()]
        };
        chain.windows(2).map(link).sum()
    }

    /// Returns the relative errors for random directions, each the mean over `shifts` lines of 500 links at random
    /// places in the grid. A line is cut by the planes of voxel centres across the axis along which it advances
    /// fastest, and the other two coordinates are rounded.
    fn line_errors(spacing: [f64; 3], weights: &ChainWeights, directions: usize, shifts: usize) -> Vec<f64> {
        const LINKS: i64 = 500;
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let error = |_| {
            let u = random_direction(&mut rng);
            let advance: [f64; 3] = std::array::from_fn(|axis| u[axis] / spacing[axis]); // voxels a mm
            let first = (0..3).max_by(|&p, &q| advance[p].abs().total_cmp(&advance[q].abs())).unwrap();
            let step = advance[first].abs().recip(); // mm a link
            let mut line = |_| {
                let phase: [f64; 3] = std::array::from_fn(|_| rng.random_range(-0.5..0.5));
                let at = |n: i64, axis: usize| (phase[axis] + n as f64 * step * advance[axis]).round() as i64;
                let chain: Vec<[i64; 3]> = (0..=LINKS).map(|n| std::array::from_fn(|axis| at(n, axis))).collect();
                chain_length(&chain, weights) / (LINKS as f64 * step) - 1.0
            };
            (0..shifts).map(&mut line).sum::<f64>() / shifts as f64
        };
        (0..directions).map(error).collect()
    }

    fn mean_and_rms(errors: &[f64]) -> (f64, f64) {
        let n = errors.len() as f64;
        (errors.iter().sum::<f64>() / n, (errors.iter().map(|e| e * e).sum::<f64>() / n).sqrt())
    }

    fn expected_rms(spacing: [f64; 3], weights: &ChainWeights) -> f64 {
        let weights = SVector::<f64, 7>::from_column_slice(&weights.lengths()[1..]);
        let squared = |u| (expected_links(u, spacing).dot(&weights) - 1.0).powi(2);
        (octant_directions().map(squared).sum::<f64>() / OCTANT_POINTS as f64).sqrt()
    }

    #[test]
    fn the_derivation_gives_the_published_weights() {
        let derived = unbiased([1.0; 3]);
        for kind in 1..8usize {
            let published = KIRYATI_KUBLER[kind.count_ones() as usize - 1];
            assert!((derived.lengths()[kind] - published).abs() < 1e-3, "{derived:?}");
        }
    }

    #[test]
    fn the_error_of_infinite_lines_is_bounded_as_published() {
        let lengths = ChainWeights::new([1.0; 3], LinkLengths::ChainCode).unwrap().lengths();
        let weights = SVector::<f64, 7>::from_column_slice(&lengths[1..]);
        let error = |u| expected_links(u, [1.0; 3]).dot(&weights) - 1.0;
        let errors = || octant_directions().map(error);
        let (least, most) = (errors().fold(0.0, f64::min), errors().fold(0.0, f64::max));
        assert!((error([1.0, 0.0, 0.0]) + 0.0984).abs() < 1e-6, "along an axis it is least");
        assert!((-0.0984..-0.097).contains(&least) && (0.0455..=0.046).contains(&most), "{least} to {most}");
    }

    #[test]
    fn random_lines_are_measured_as_published() {
        let weights = ChainWeights::new([1.0; 3], LinkLengths::ChainCode).unwrap();
        let errors = line_errors([1.0; 3], &weights, 2000, 40);
        let (mean, rms) = mean_and_rms(&errors);
        assert!(mean.abs() < 0.002, "mean {mean}");
        assert!((rms - 0.029).abs() < 0.001, "RMS {rms}");
        let (low, high) = errors.iter().fold((0.0f64, 0.0f64), |(low, high), &e| (low.min(e), high.max(e)));
        assert!(low > -0.0995 && high < 0.0465, "from {low} to {high}");
    }

    #[test]
    fn weights_of_any_spacing_are_unbiased() {
        for spacing in [[2.0; 3], [1.0, 1.0, 1.2], [0.7, 0.7, 2.0], [1.0, 2.0, 5.0], [0.2, 1.0, 0.2]] {
            let weights = ChainWeights::new(spacing, LinkLengths::ChainCode).unwrap();
            let (mean, rms) = mean_and_rms(&line_errors(spacing, &weights, 5000, 4));
            assert!(mean.abs() < 0.002, "{spacing:?}: mean {mean}");
            let expected = expected_rms(spacing, &weights);
            assert!((rms - expected).abs() < 0.001, "{spacing:?}: RMS {rms}, expected {expected}");
            let plain = ChainWeights::new(spacing, LinkLengths::Euclidean).unwrap();
            let (euclidean, _) = mean_and_rms(&line_errors(spacing, &plain, 1000, 4));
            assert!(euclidean > 0.03, "{spacing:?}: Euclidean lengths overestimate, {euclidean}");
        }
    }

    #[test]
    fn extreme_voxels_are_refused() {
        for lengths in [LinkLengths::ChainCode, LinkLengths::Euclidean] {
            assert!(ChainWeights::new([1.0, 1.0, 20.0], lengths).is_ok());
            let refused = ChainWeights::new([1.0, 1.0, 20.1], lengths);
            assert_eq!(refused, Err(Error::TooAnisotropic { longest: 20.1, shortest: 1.0, most: 20.0 }));
        }
    }

    #[test]
    fn no_link_is_longer_than_a_detour() {
        for spacing in [[1.0; 3], [1.0, 1.0, 1.2], [0.7, 0.7, 2.0], [1.0, 2.0, 5.0], [0.2, 1.0, 0.2], [1.0, 1.0, 5.0]] {
            let lengths = ChainWeights::new(spacing, LinkLengths::ChainCode).unwrap().lengths();
            assert!(lengths[1..].iter().all(|&length| length > 0.0), "{spacing:?}: {lengths:?}");
            for kind in 1..8 {
                for part in (1..kind).filter(|part| part & kind == *part) {
                    let detour = lengths[part] + lengths[kind ^ part];
                    assert!(lengths[kind] <= detour, "{spacing:?} {kind} {part}: {lengths:?}");
                }
            }
        }
    }
}
