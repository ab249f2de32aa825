//! The scale with the smallest mean relative error, Σ |s·d − δ|/δ: the median of δ/d, weighted by d/δ.
//!
//! Weights are counted in the bins of a histogram around the median of the first source. They are integers, so their
//! sums do not depend on the order in which threads add them.

use std::sync::atomic::{AtomicU64, Ordering};

/// The number of bins of the histogram. It resolves the scale to a relative precision of 10⁻⁶.
const BINS: usize = 1 << 21;

/// The weight of a pair whose ratio lies in the middle of the histogram.
const UNIT: f64 = (1u64 << 28) as f64;

/// The largest weight, so that sums do not overflow.
const MOST: f64 = (1u64 << 50) as f64;

/// The histogram reaches from its middle divided by this factor to its middle times this factor.
const REACH: f64 = 2.0;

/// A histogram of the weights of ratios δ/d.
#[derive(Debug, Default)]
pub struct Ratios {
    middle: f64,
    below: AtomicU64,
    above: AtomicU64,
    bins: Vec<AtomicU64>,
}

/// The position of the median.
#[derive(Debug)]
pub enum Answer {
    /// The median; NaN if there is no ratio.
    Found(f64),
    /// The median lies outside the histogram: count again with this one.
    Elsewhere(Ratios),
}

impl Ratios {
    fn around(middle: f64) -> Self {
        let bins = (0..BINS).map(|_| AtomicU64::new(0)).collect();
        Self { middle, bins, ..Self::default() }
    }

    /// Creates an empty histogram around the median of pairs (δ, d).
    pub fn around_median(pairs: impl Iterator<Item = (f64, f64)>) -> Self {
        let mut ratios: Vec<f64> = pairs.filter(|&(_, d)| d > 0.0).map(|(delta, d)| delta / d).collect();
        ratios.sort_unstable_by(f64::total_cmp);
        // |s d − δ|/δ = (d/δ) |s − δ/d|: minimal at the median of δ/d with weights d/δ
        let half = 0.5 * ratios.iter().map(|ratio| ratio.recip()).sum::<f64>();
        let mut below = 0.0;
        let median = ratios.iter().find(|ratio| {
            below += ratio.recip();
            below >= half
        });
        median.map_or_else(Self::default, |&ratio| Self::around(ratio))
    }

    fn low(&self) -> f64 {
        self.middle / REACH
    }

    fn width(&self) -> f64 {
        (self.middle * REACH - self.low()) / BINS as f64
    }

    /// Counts a pair. A pair at the same position in the map has no ratio; its error is the same at every scale.
    pub fn add(&self, delta: f64, d: f64) {
        if d > 0.0 && !self.bins.is_empty() {
            let ratio = delta / d;
            let bin = (ratio - self.low()) / self.width();
            let at = if bin < 0.0 { &self.below } else { self.bins.get(bin as usize).unwrap_or(&self.above) };
            // d/δ in fixed point: sums of integers do not depend on their order
            let weight = (UNIT * self.middle / ratio).round().min(MOST);
            at.fetch_add(weight as u64, Ordering::Relaxed);
        }
    }

    pub fn median(&self) -> Answer {
        let weight = |counter: &AtomicU64| u128::from(counter.load(Ordering::Relaxed));
        let total = weight(&self.below) + weight(&self.above) + self.bins.iter().map(weight).sum::<u128>();
        if total == 0 {
            return Answer::Found(f64::NAN);
        }
        let mut reached = weight(&self.below);
        if 2 * reached >= total {
            return Answer::Elsewhere(Self::around(self.middle / REACH));
        }
        let bin = self.bins.iter().position(|bin| {
            reached += weight(bin);
            2 * reached >= total
        });
        match bin {
            Some(bin) => Answer::Found(self.low() + (bin as f64 + 0.5) * self.width()),
            None => Answer::Elsewhere(Self::around(self.middle * REACH)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn median(pairs: &[(f64, f64)], first: usize) -> f64 {
        let mut ratios = Ratios::around_median(pairs[..first].iter().copied());
        for _ in 0..200 {
            pairs.iter().for_each(|&(delta, d)| ratios.add(delta, d));
            match ratios.median() {
                Answer::Found(scale) => return scale,
                Answer::Elsewhere(other) => ratios = other,
            }
        }
        panic!("no median was found")
    }

    proptest! {
        #[test]
        fn the_median_is_that_of_sorted_ratios(
            pairs in prop::collection::vec((0.1..100.0f64, 0.001..100.0f64), 1..60),
            first in 1..60usize,
        ) {
            let mut sorted: Vec<f64> = pairs.iter().map(|(delta, d)| delta / d).collect();
            sorted.sort_by(f64::total_cmp);
            let found = median(&pairs, first.min(pairs.len()));
            let half = 0.5 * sorted.iter().map(|ratio| ratio.recip()).sum::<f64>();
            // equal weights on both sides, up to the resolution of the histogram
            let below = |limit: f64| sorted.iter().filter(|&&r| r < limit).map(|r| r.recip()).sum::<f64>();
            let allowed = 1e-7 * half;
            prop_assert!(below(found * (1.0 - 1e-6)) <= half + allowed);
            prop_assert!(below(found * (1.0 + 1e-6)) >= half - allowed);
        }
    }

    #[test]
    fn a_median_far_from_that_of_the_first_source_is_found() {
        let mut pairs = vec![(1.0, 1.0); 3];
        for ratio in [1000.0, 0.001] {
            pairs.truncate(3);
            pairs.extend(vec![(ratio * 7.0, 7.0); 8000]);
            assert!((median(&pairs, 3) / ratio - 1.0).abs() < 1e-6);
        }
    }

    #[test]
    fn without_a_ratio_there_is_no_scale() {
        assert!(median(&[(1.0, 0.0), (2.0, 0.0)], 2).is_nan());
    }
}
