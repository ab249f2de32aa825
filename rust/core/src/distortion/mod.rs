//! Distortion: what flattening did to the distances.
//!
//! A measure is a pure function of distance rows δ (mm, from reference sources to all points) and the flat map's distances
//! d. It never looks at how the map was made. Figures are given raw (a flat map is in mm) and at the map's best scale
//! s* = argmin mean |s·d − δ|/δ. Pairs of a point with itself are left out. Undefined figures are NaN.

pub mod faces;
pub mod overlap;

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

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn rows_of(sources: &[u32], points: &[[f64; 2]], wrong: impl Fn(usize, usize) -> f64) -> DistanceRows {
        let (points, wrong) = (&points, &wrong);
        let row = |&source: &u32| {
            let [x, y] = points[source as usize];
            let distance = move |(n, &[u, v]): (usize, &[f64; 2])| {
                (x - u).hypot(y - v) * if n == source as usize { 0.0 } else { wrong(source as usize, n) }
            };
            points.iter().enumerate().map(distance).map(|d| d as f32).collect::<Vec<f32>>()
        };
        DistanceRows::new(sources.to_vec(), points.len(), sources.iter().flat_map(row).collect())
    }

    /// All (δ, d) by the definition.
    fn pairs(uv: &[[f64; 2]], rows: &DistanceRows) -> Vec<(f64, f64)> {
        let mut pairs = Vec::new();
        for (n, &source) in rows.sources().iter().enumerate() {
            for (point, place) in uv.iter().enumerate().filter(|&(point, _)| point != source as usize) {
                let [x, y] = uv[source as usize];
                pairs.push((f64::from(rows.row(n)[point]), (place[0] - x).hypot(place[1] - y)));
            }
        }
        pairs
    }

    fn mean(values: impl Iterator<Item = f64>) -> f64 {
        let values: Vec<f64> = values.collect();
        values.iter().sum::<f64>() / values.len() as f64
    }

    fn places() -> impl Strategy<Value = Vec<[f64; 2]>> {
        prop::collection::vec(prop::array::uniform2(-40.0..40.0f64), 12..30)
    }

    proptest! {
        #[test]
        fn figures_follow_their_definitions(uv in places(), stretch in 0.5..2.0f64) {
            let rows = rows_of(&[0, 3, 7, 11], &uv, |a, b| stretch * (1.0 + 0.3 * ((a * 31 + b * 17) as f64).sin()));
            let distortion = measure(&uv, &rows, 0, &Control::default()).unwrap();
            let pairs = pairs(&uv, &rows);
            let close = |a: f64, b: f64| (a - b).abs() < 1e-9 || (a.is_nan() && b.is_nan());
            for figures in [distortion.raw, distortion.best_scale] {
                let s = figures.scale;
                let relative = |limit: f64| mean(pairs.iter().filter(|p| p.0 <= limit).map(|&(x, d)| (s * d - x).abs() / x));
                prop_assert!(close(figures.relative_error, relative(f64::INFINITY)));
                prop_assert!(close(figures.relative_error_10mm, relative(10.0)));
                prop_assert!(close(figures.relative_error_30mm, relative(30.0)));
                prop_assert!(close(figures.absolute_error, mean(pairs.iter().map(|&(x, d)| (s * d - x).abs()))));
                let squares: f64 = pairs.iter().map(|&(x, d)| (s * d - x).powi(2)).sum();
                let sammon: f64 = pairs.iter().map(|&(x, d)| (s * d - x).powi(2) / x).sum();
                let total: f64 = pairs.iter().map(|p| p.0).sum();
                prop_assert!(close(figures.stress_1, (squares / pairs.iter().map(|p| p.0 * p.0).sum::<f64>()).sqrt()));
                prop_assert!(close(figures.sammon_stress, sammon / total));
            }
            prop_assert_eq!((distortion.raw.scale, distortion.pairs), (1.0, pairs.len()));
            prop_assert!(close(distortion.mean_geodesic, mean(pairs.iter().map(|p| p.0))));
            let (md, mx) = (mean(pairs.iter().map(|p| p.1)), mean(pairs.iter().map(|p| p.0)));
            let product = |f: &dyn Fn(&(f64, f64)) -> f64| pairs.iter().map(f).sum::<f64>();
            let r = product(&|p| (p.0 - mx) * (p.1 - md))
                / (product(&|p| (p.0 - mx).powi(2)) * product(&|p| (p.1 - md).powi(2))).sqrt();
            prop_assert!((distortion.pearson_r - r).abs() < 1e-9);
        }

        #[test]
        fn no_scale_is_better_than_the_best(uv in places(), stretch in 0.2..5.0f64) {
            let rows = rows_of(&[0, 5, 9], &uv, |a, b| stretch * (1.0 + 0.4 * ((a * 7 + b * 13) as f64).sin()));
            let best = measure(&uv, &rows, 0, &Control::default()).unwrap().best_scale;
            let pairs = pairs(&uv, &rows);
            let error = |s: f64| mean(pairs.iter().map(|&(x, d)| (s * d - x).abs() / x));
            // the objective is convex and piecewise linear: its least value is at one of its kinks
            let least = pairs.iter().map(|&(x, d)| error(x / d)).fold(f64::INFINITY, f64::min);
            prop_assert!(best.relative_error <= least + 1e-6, "{} > {}", best.relative_error, least);
        }

        #[test]
        fn points_have_the_mean_of_their_pairs(uv in places()) {
            let sources = [0, 4, 8];
            let rows = rows_of(&sources, &uv, |a, b| 1.0 + 0.2 * ((a + 3 * b) as f64).cos());
            let distortion = measure(&uv, &rows, 0, &Control::default()).unwrap();
            for (point, &value) in distortion.per_point.iter().enumerate() {
                let errors = sources.iter().enumerate().filter(|&(_, &s)| s as usize != point).map(|(n, &s)| {
                    let delta = f64::from(rows.row(n)[point]);
                    let [x, y] = uv[s as usize];
                    ((uv[point][0] - x).hypot(uv[point][1] - y) - delta).abs() / delta
                });
                prop_assert!((value - mean(errors)).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn a_perfect_map_has_no_error_and_a_scaled_one_only_its_scale() {
        let uv: Vec<[f64; 2]> = (0..50).map(|n| [f64::from(n % 7) * 3.0, f64::from(n / 7) * 2.0]).collect();
        let rows = rows_of(&[0, 20, 40], &uv, |_, _| 1.0);
        let perfect = measure(&uv, &rows, 0, &Control::default()).unwrap();
        assert!(perfect.raw.relative_error < 1e-6 && (perfect.best_scale.scale - 1.0).abs() < 1e-6);
        assert!(perfect.scatter.iter().all(|[delta, d]| (delta - d).abs() < 1e-5 && *delta > 0.0));
        let doubled: Vec<[f64; 2]> = uv.iter().map(|p| p.map(|x| 2.0 * x)).collect();
        let scaled = measure(&doubled, &rows, 0, &Control::default()).unwrap();
        assert!((scaled.raw.relative_error - 1.0).abs() < 1e-6);
        assert!((scaled.best_scale.scale - 0.5).abs() < 1e-6 && scaled.best_scale.relative_error < 1e-6);
    }

    #[test]
    fn undefined_figures_are_nan() {
        let uv = [[0.0, 0.0], [50.0, 0.0], [0.0, 60.0]];
        let rows = rows_of(&[0], &uv, |_, _| 1.0);
        let distortion = measure(&uv, &rows, 0, &Control::default()).unwrap();
        assert!(distortion.raw.relative_error_10mm.is_nan() && distortion.raw.relative_error_30mm.is_nan());
        assert!(distortion.per_point[0].is_nan() && !distortion.per_point[1].is_nan());
    }
}
