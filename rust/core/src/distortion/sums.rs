//! Sums over pairs, from which all figures of distances are computed.

use std::iter::Sum;

use super::figures::Figures;

/// The upper ends of the distance bands of the figures, ascending, in the unit of the surface; each belongs to its band.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bands(pub [f64; 4]);

impl Default for Bands {
    /// Those of human hemispheres in mm.
    fn default() -> Self {
        Self([5.0, 10.0, 15.0, 30.0])
    }
}

/// Sums over pairs (δ, d) at some scale.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Sums {
    delta: f64,
    delta_squared: f64,
    d: f64,
    d_squared: f64,
    product: f64,
    error: f64,
    squared_error: f64,
    sammon: f64,
    /// The sum of relative errors and the number of pairs of each band, and above.
    bands: [(f64, f64); 5],
}

impl Sums {
    /// Adds a pair.
    pub(crate) fn add(&mut self, &Bands(ends): &Bands, delta: f64, d: f64) {
        let error = (d - delta).abs();
        let relative = error / delta;
        self.delta += delta;
        self.delta_squared += delta * delta;
        self.d += d;
        self.d_squared += d * d;
        self.product += d * delta;
        self.error += error;
        self.squared_error += error * error;
        // (d − δ)²/δ (Schwartz, Shaw & Wolfson 1989, eq. 1.0)
        self.sammon += error * relative;
        let band = &mut self.bands[ends.iter().filter(|&&end| delta > end).count()];
        *band = (band.0 + relative, band.1 + 1.0);
    }

    fn plus(mut self, other: &Self) -> Self {
        self.delta += other.delta;
        self.delta_squared += other.delta_squared;
        self.d += other.d;
        self.d_squared += other.d_squared;
        self.product += other.product;
        self.error += other.error;
        self.squared_error += other.squared_error;
        self.sammon += other.sammon;
        for (band, more) in self.bands.iter_mut().zip(other.bands) {
            *band = (band.0 + more.0, band.1 + more.1);
        }
        self
    }

    /// Returns the sum of relative errors and the number of pairs of several bands.
    fn over(&self, bands: std::ops::Range<usize>) -> (f64, f64) {
        self.bands[bands].iter().fold((0.0, 0.0), |sum, band| (sum.0 + band.0, sum.1 + band.1))
    }

    /// Returns the number of pairs.
    pub(crate) fn pairs(&self) -> usize {
        self.over(0..self.bands.len()).1 as usize
    }

    /// Returns the figures of these pairs, whose d were multiplied by `scale`. Figures without pairs are NaN.
    pub(crate) fn figures(&self, scale: f64) -> Figures {
        let relative = |bands| {
            let (sum, count) = self.over(bands);
            sum / count // 0/0 is NaN: undefined
        };
        let all = self.bands.len();
        Figures {
            scale,
            relative_error: relative(0..all),
            relative_error_0_5mm: relative(0..1),
            relative_error_5_15mm: relative(1..3),
            relative_error_15_30mm: relative(3..4),
            relative_error_10mm: relative(0..2),
            relative_error_30mm: relative(0..4),
            absolute_error: self.error / self.over(0..all).1,
            // Kruskal's stress-1, but relative to Σ δ² instead of Σ d²
            stress_1: (self.squared_error / self.delta_squared).sqrt(),
            sammon_stress: self.sammon / self.delta,
        }
    }

    /// Returns the mean of δ in mm.
    pub(crate) fn mean_geodesic(&self) -> f64 {
        self.delta / self.over(0..self.bands.len()).1
    }

    /// Returns Pearson's correlation of d and δ.
    pub(crate) fn correlation(&self) -> f64 {
        let n = self.over(0..self.bands.len()).1;
        let covariance = self.product / n - self.d / n * (self.delta / n);
        let variance = |squares: f64, sum: f64| squares / n - (sum / n).powi(2);
        covariance / (variance(self.d_squared, self.d) * variance(self.delta_squared, self.delta)).sqrt()
    }
}

impl<'a> Sum<&'a Self> for Sums {
    fn sum<I: Iterator<Item = &'a Self>>(parts: I) -> Self {
        parts.fold(Self::default(), Self::plus)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_upper_end_of_a_band_belongs_to_it() {
        let mut sums = Sums::default();
        for (delta, d) in [(5.0, 6.0), (10.0, 14.0), (15.0, 24.0), (30.0, 54.0), (30.5, 30.5)] {
            sums.add(&Bands::default(), delta, d); // relative errors 0.2, 0.4, 0.6, 0.8 and 0
        }
        let figures = sums.figures(1.0);
        let near = |value: f64, expected: f64| assert!((value - expected).abs() < 1e-12, "{value} is not {expected}");
        near(figures.relative_error_0_5mm, 0.2);
        near(figures.relative_error_10mm, 0.3);
        near(figures.relative_error_5_15mm, 0.5);
        near(figures.relative_error_15_30mm, 0.8);
        near(figures.relative_error_30mm, 0.5);
        near(figures.relative_error, 0.4);
    }
}
