//! Standard errors by the bootstrap over sources (Efron 1979).
//!
//! Figures are of all pairs from some random sources: another choice would give others. Sources are drawn anew from those that
//! there are, with replacement, a thousand times; the figures' standard deviation over the draws is their standard error. The
//! scale of the best figures is held.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::figures::Figures;
use super::sums::Sums;
use crate::control::Control;
use crate::error::Result;

/// Draws; the standard errors themselves are then known to about 2 %.
const DRAWS: usize = 1000;

/// How many figures there are of each scale, and beside.
const FIGURES: usize = 9;

/// The standard errors of figures; NaN where a draw leaves a figure undefined, and for a single source.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StandardErrors {
    /// Of the figures at scale 1.
    pub raw: Figures,
    /// Of the figures at the best scale. That of the scale is NaN, for it is held.
    pub best_scale: Figures,
    /// Of the correlation.
    pub pearson_r: f64,
    /// Of the mean geodesic distance, mm.
    pub mean_geodesic: f64,
}

/// The standard errors of the figures of all sources together, given each one's sums at scale 1 and at the best scale, and of
/// how many points the sources were drawn without replacement: from all of them, nothing is left to chance.
pub(super) fn standard_errors(
    raw: &[Sums],
    best: &[Sums],
    points: usize,
    seed: u64,
    control: &Control,
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
    // a draw's variance is short by (n − 1)/n; and what is drawn from few points is better known
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
