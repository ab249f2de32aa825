//! Distortion: what flattening did to the distances.
//!
//! A measure is a pure function of distance rows δ (mm, from reference sources to all points) and the flat map's distances
//! d. It never looks at how the map was made. Figures are given raw (a flat map is in mm) and at the map's best scale
//! s* = argmin mean |s·d − δ|/δ. Pairs of a point with itself are left out. Undefined figures are NaN.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::control::Control;
use crate::error::Result;
use crate::rows::DistanceRows;

/// Pairs up to these distances (mm) have figures of their own.
pub const NEAR_MM: [f64; 2] = [10.0, 30.0];

/// Pairs kept to be drawn as a scatter of flat against geodesic distance.
const SCATTER: usize = 20_000;

/// Figures of a map at one scale.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Figures {
    /// The factor by which flat distances were multiplied.
    pub scale: f64,
    /// Mean of |d − δ|/δ (Grossmann et al.: ε̄_r).
    pub relative_error: f64,
    /// The same over pairs with δ ≤ 10 mm.
    pub relative_error_10mm: f64,
    /// The same over pairs with δ ≤ 30 mm.
    pub relative_error_30mm: f64,
    /// Mean of |d − δ|, mm (Grossmann et al.: ε̄).
    pub absolute_error: f64,
    /// √(Σ(d − δ)² / Σδ²) (Kruskal).
    pub stress_1: f64,
    /// (1/Σδ) Σ (d − δ)²/δ (Schwartz et al., equation 1.0).
    pub sammon_stress: f64,
}

/// What flattening did to the distances.
#[derive(Debug, Clone, PartialEq)]
pub struct Distortion {
    /// At scale 1.
    pub raw: Figures,
    /// At the scale with the least mean relative error.
    pub best_scale: Figures,
    /// Correlation of d and δ.
    pub pearson_r: f64,
    /// Mean of δ, mm (Grossmann et al.: δ̄).
    pub mean_geodesic: f64,
    /// Number of pairs.
    pub pairs: usize,
    /// For each point the mean of |d − δ|/δ over the reference sources, at scale 1.
    pub per_point: Vec<f64>,
    /// Some of the pairs, as [δ, d] in mm.
    pub scatter: Vec<[f64; 2]>,
}

/// Measures a flat map (`uv`, mm) against distance rows to all of its points.
///
/// # Errors
/// [`crate::Error::Cancelled`].
pub fn measure(uv: &[[f64; 2]], rows: &DistanceRows, seed: u64, control: &Control) -> Result<Distortion> {
    control.begin("measuring distortion", 5);
    let pairs = Pairs { uv, rows, control };
    let raw = pairs.sums(1.0)?;
    control.advance();
    let scale = pairs.best_scale()?;
    let best = pairs.sums(scale)?;
    control.advance();
    Ok(Distortion {
        raw: raw.figures(1.0),
        best_scale: best.figures(scale),
        pearson_r: raw.correlation(),
        mean_geodesic: raw.delta / raw.count,
        pairs: raw.count as usize,
        per_point: pairs.per_point()?,
        scatter: pairs.scatter(seed),
    })
}

#[derive(Clone, Copy)]
struct Pairs<'a> {
    uv: &'a [[f64; 2]],
    rows: &'a DistanceRows,
    control: &'a Control,
}

impl Pairs<'_> {
    /// The (δ, d) of one source, without the pair of the source with itself.
    fn of_source(&self, n: usize) -> impl Iterator<Item = (f64, f64)> + '_ {
        let source = self.rows.sources()[n] as usize;
        let [x, y] = self.uv[source];
        let apart = move |[u, v]: [f64; 2]| ((u - x) * (u - x) + (v - y) * (v - y)).sqrt();
        let pairs = self.rows.row(n).iter().zip(self.uv).enumerate();
        pairs
            .filter(move |&(point, _)| point != source)
            .map(move |(_, (&delta, &place))| (f64::from(delta), apart(place)))
    }

    /// One value a source, in parallel, in the order of the sources.
    fn each_source<T: Send>(&self, value: impl Fn(usize) -> T + Sync) -> Result<Vec<T>> {
        let checked = |n| self.control.check().map(|()| value(n));
        (0..self.rows.sources().len()).into_par_iter().map(checked).collect()
    }

    fn sums(&self, scale: f64) -> Result<Sums> {
        let of_source = |n| {
            let mut sums = Sums::default();
            self.of_source(n).for_each(|(delta, d)| sums.add(delta, scale * d));
            sums
        };
        let parts = self.each_source(of_source)?;
        Ok(parts.iter().fold(Sums::default(), |a, b| a.plus(b)))
    }

    /// argmin over s of Σ |s·d − δ|/δ: the median of δ/d weighted by d/δ, narrowed down by three histograms.
    fn best_scale(&self) -> Result<f64> {
        const BINS: usize = 2048;
        let extremes = |n| {
            let ratios = self.of_source(n).filter(|&(_, d)| d > 0.0).map(|(delta, d)| delta / d);
            ratios.fold((f64::INFINITY, 0.0f64), |(low, high), ratio| (low.min(ratio), high.max(ratio)))
        };
        let parts = self.each_source(extremes)?;
        let (mut low, mut high) = parts.iter().fold((f64::INFINITY, 0.0f64), |a, b| (a.0.min(b.0), a.1.max(b.1)));
        if low > high {
            return Ok(f64::NAN);
        }
        for _ in 0..3 {
            self.control.advance();
            let per_bin = BINS as f64 / (high - low).max(f64::MIN_POSITIVE);
            let histogram = |n| {
                // below, in, and above the bins
                let mut weights = vec![0.0; BINS + 2];
                for (delta, d) in self.of_source(n).filter(|&(_, d)| d > 0.0) {
                    let ratio = delta / d;
                    let bin = if ratio < low { 0 } else { (((ratio - low) * per_bin) as usize + 1).min(BINS + 1) };
                    weights[bin] += ratio.recip();
                }
                weights
            };
            let mut weights = vec![0.0; BINS + 2];
            for part in self.each_source(histogram)? {
                weights.iter_mut().zip(part).for_each(|(sum, weight)| *sum += weight);
            }
            let half = 0.5 * weights.iter().sum::<f64>();
            let mut below = 0.0;
            let middle = weights.iter().position(|weight| {
                below += weight;
                below >= half
            });
            let bin = middle.unwrap_or(1).clamp(1, BINS + 1) as f64; // the last one holds the upper edge itself
            (low, high) = (low + (bin - 1.0) / per_bin, low + bin / per_bin);
        }
        Ok(0.5 * (low + high))
    }

    fn per_point(&self) -> Result<Vec<f64>> {
        let rows = self.rows;
        let of_point = |point: usize| {
            let [x, y] = self.uv[point];
            let mut sum = 0.0;
            let mut count = 0.0;
            for (n, &source) in rows.sources().iter().enumerate() {
                if source as usize != point {
                    let [u, v] = self.uv[source as usize];
                    let delta = f64::from(rows.row(n)[point]);
                    sum += (((u - x) * (u - x) + (v - y) * (v - y)).sqrt() - delta).abs() / delta;
                    count += 1.0;
                }
            }
            sum / count // NaN where there is no other source
        };
        self.control.check()?;
        Ok((0..self.uv.len()).into_par_iter().map(of_point).collect())
    }

    fn scatter(&self, seed: u64) -> Vec<[f64; 2]> {
        let (sources, points) = (self.rows.sources().len(), self.uv.len());
        if points < 2 {
            return Vec::new();
        }
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let pair = |_| {
            let n = rng.random_range(0..sources);
            let source = self.rows.sources()[n] as usize;
            let point = (source + rng.random_range(1..points)) % points; // any but the source
            let ([x, y], [u, v]) = (self.uv[source], self.uv[point]);
            [f64::from(self.rows.row(n)[point]), (x - u).hypot(y - v)]
        };
        (0..SCATTER.min(sources * (points - 1))).map(pair).collect()
    }
}

/// Sums over pairs, from which all figures follow.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    count: f64,
    delta: f64,
    delta_squared: f64,
    d: f64,
    d_squared: f64,
    product: f64,
    error: f64,
    squared_error: f64,
    sammon: f64,
    relative: f64,
    near: [(f64, f64); 2],
}

impl Sums {
    fn add(&mut self, delta: f64, d: f64) {
        let error = (d - delta).abs();
        let relative = error / delta;
        self.count += 1.0;
        self.delta += delta;
        self.delta_squared += delta * delta;
        self.d += d;
        self.d_squared += d * d;
        self.product += d * delta;
        self.error += error;
        self.squared_error += error * error;
        self.sammon += error * relative;
        self.relative += relative;
        for (near, limit) in self.near.iter_mut().zip(NEAR_MM) {
            if delta <= limit {
                *near = (near.0 + relative, near.1 + 1.0);
            }
        }
    }

    fn plus(mut self, other: &Self) -> Self {
        self.count += other.count;
        self.delta += other.delta;
        self.delta_squared += other.delta_squared;
        self.d += other.d;
        self.d_squared += other.d_squared;
        self.product += other.product;
        self.error += other.error;
        self.squared_error += other.squared_error;
        self.sammon += other.sammon;
        self.relative += other.relative;
        for (near, more) in self.near.iter_mut().zip(other.near) {
            *near = (near.0 + more.0, near.1 + more.1);
        }
        self
    }

    fn figures(&self, scale: f64) -> Figures {
        let near = self.near.map(|(sum, count)| sum / count); // 0/0 is NaN: undefined
        Figures {
            scale,
            relative_error: self.relative / self.count,
            relative_error_10mm: near[0],
            relative_error_30mm: near[1],
            absolute_error: self.error / self.count,
            stress_1: (self.squared_error / self.delta_squared).sqrt(),
            sammon_stress: self.sammon / self.delta,
        }
    }

    fn correlation(&self) -> f64 {
        let n = self.count;
        let covariance = self.product / n - self.d / n * (self.delta / n);
        let variance = |squares: f64, sum: f64| squares / n - (sum / n).powi(2);
        covariance / (variance(self.d_squared, self.d) * variance(self.delta_squared, self.delta)).sqrt()
    }
}
