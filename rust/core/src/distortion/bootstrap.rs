//! Standard errors by the bootstrap over sources (Efron 1979).
//!
//! The figures are computed from all pairs of random sources, so another choice of sources would change them. The
//! sources are resampled with replacement a thousand times. The standard deviation of the figures over these draws is
//! their standard error. The best scale is held fixed.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::figures::Figures;
use super::sums::Sums;
use crate::{Control, Result};

/// The number of draws. The standard errors themselves then have a relative error of about 2 %.
const DRAWS: usize = 1000;

/// The number of figures at each scale, without the scale itself.
const FIGURES: usize = 9;

/// Standard errors of figures. NaN if there is a single source, or if a figure is undefined in a draw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StandardErrors {
    /// Standard errors of the figures at scale 1.
    pub raw: Figures,
    /// Standard errors of the figures at the best scale. That of the scale is NaN, because the scale is fixed.
    pub best_scale: Figures,
    /// Standard error of the correlation.
    pub pearson_r: f64,
    /// Standard error of the mean geodesic distance, in mm.
    pub mean_geodesic: f64,
}

/// Returns the standard errors of the figures, given the sums of each source at scale 1 and at the best scale. `points`
/// is the number of points from which the sources were drawn without replacement; if all were drawn, the error is 0.
pub(super) fn standard_errors(
    raw: &[Sums], best: &[Sums], points: usize, seed: u64, control: &Control,
) -> Result<StandardErrors> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed.wrapping_add(2));
    let sources = raw.len();
    let mut drawn = Vec::with_capacity(DRAWS);
    for _ in 0..DRAWS {
        control.check()?;
        let chosen: Vec<usize> = (0..sources).map(|_| rng.random_range(0..sources)).collect();
        let [raw, best] = [raw, best].map(|parts| chosen.iter().map(|&n| &parts[n]).sum::<Sums>());
        drawn.push(values(&raw, &best));
    }
    let n = sources as f64;
    // the variance of a draw is too small by (n − 1)/n; sampling without replacement from few points reduces the error
    let correction = if sources > 1 { (n / (n - 1.0) * (1.0 - n / points as f64)).sqrt() } else { f64::NAN };
    let errors: [f64; 2 * FIGURES + 2] = std::array::from_fn(|figure| {
        let mean = drawn.iter().map(|values| values[figure]).sum::<f64>() / DRAWS as f64;
        let squares = drawn.iter().map(|values| (values[figure] - mean).powi(2)).sum::<f64>();
        (squares / (DRAWS - 1) as f64).sqrt() * correction
    });
    Ok(StandardErrors {
        raw: figures(&errors[..FIGURES]),
        best_scale: figures(&errors[FIGURES..]),
        pearson_r: errors[2 * FIGURES],
        mean_geodesic: errors[2 * FIGURES + 1],
    })
}

fn values(raw: &Sums, best: &Sums) -> [f64; 2 * FIGURES + 2] {
    let mut values = [0.0; 2 * FIGURES + 2];
    for (part, sums) in values.chunks_mut(FIGURES).zip([raw, best]) {
        let of = sums.figures(1.0);
        for (value, (_, figure)) in part.iter_mut().zip(of.named().into_iter().skip(1)) {
            *value = figure; // all but the scale
        }
    }
    values[2 * FIGURES] = raw.correlation();
    values[2 * FIGURES + 1] = raw.mean_geodesic();
    values
}

fn figures(errors: &[f64]) -> Figures {
    Figures {
        scale: f64::NAN,
        relative_error: errors[0],
        relative_error_0_5mm: errors[1],
        relative_error_5_15mm: errors[2],
        relative_error_15_30mm: errors[3],
        relative_error_10mm: errors[4],
        relative_error_30mm: errors[5],
        absolute_error: errors[6],
        stress_1: errors[7],
        sammon_stress: errors[8],
    }
}
