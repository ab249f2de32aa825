//! A lower bound for the mean relative error of distances: no map can be better.
//!
//! **Four points.** Let ψ = (d² − δ²)/δ² be the changes of the six squared distances. The squared distances between
//! points in space form a convex cone, whose boundary contains those in the plane.
//! - If the δ² are inside the cone, each ψ can go up or down until the boundary when the others are 0. The convex hull of
//!   these twelve ends lies in the cone, so a map is not in its interior. With r = d/δ − 1, the ends give weights for
//!   which Σ up·r⁺ + down·r⁻ ≥ 1 for every map, because ψ is convex in r above 0, and |ψ| ≤ 2|r| below.
//! - If the δ² are outside, a plane separates them from the cone: Σ aᵢaⱼ d² = −|Σ aᵢxᵢ|² ≤ 0 for all a with Σ a = 0.
//!   With s = aᵢaⱼδ² and g = Σ s > 0, maps have −Σ s ψ ≥ g. That gives weights again: ψ = 2r + r² is needed only
//!   where one distance alone does not reach g. Here a is the affine dependency of the plane points for which five
//!   distances are correct.
//!
//! **Many points.** These inequalities are added with factors y ≥ 0 such that the sum of the weights of each distance
//! is at most 1 in both directions (a fractional packing). The sum of the y is then at most the sum of the |r|. Every such
//! y gives a valid bound; an approximate optimum is computed.
//!
//! **Many samples.** The mean error of all pairs is the expectation of the mean error in a random sample, and so at least
//! the expectation E of its bound b ≥ 0. By Markov's inequality, the product of n independent b/E is greater than 1/α with
//! a probability of at most α. Therefore E is at least the geometric mean of the b, times α^(1/n), with confidence 1 − α.
//!
//! **Rounding.** Weights are increased by `ROUNDING`, which is more than their error. Let u = 2⁻⁵³, σ = `SHORTEST`,
//! φ = `FLATTEST` and w = `LARGEST`. In units of the longest distance, x is wrong by at most 5u/σ, y by 5u/(σφ), and
//! an end by 10u/(σ²φ). Weights up to w are wrong by at most the w-th part of that relative to themselves, 4 · 10⁻⁷, and
//! by 6 · 10⁻⁸ as float32. The a are multiples of 2⁻⁴⁰, so that their sum is exactly 0; the inequality then holds for
//! these a, however inaccurate they are, and the terms s are at most w g, so g is accurate. Distances are float32; those
//! of a map may be rounded in another way, which changes an error by at most `ROUNDED_DISTANCES`.

use rand::{SeedableRng, seq::index};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::geodesic::Solver;
use crate::rows::DistanceRows;
use crate::{Control, Result};

/// The random samples of a surface. If it has no more points than one sample, all of its points are the only sample.
#[derive(Debug, Clone, Copy)]
pub struct Samples {
    /// The number of points of a sample.
    pub points: usize,
    /// The number of samples.
    pub count: usize,
}

impl Default for Samples {
    fn default() -> Self {
        Self { points: 50, count: 100 }
    }
}

/// The probability that the bound of a surface with more points than a sample is too high.
pub const DOUBT: f64 = 0.01;

const ROUNDING: f64 = 1e-6;
const ROUNDED_DISTANCES: f64 = 1e-6;
const FLATTEST: f64 = 1e-2; // height of a triangle, relative to its sides
const SHORTEST: f64 = 1e-2; // distance, relative to the longest of a quadruple
const LARGEST: f32 = 300.0; // weight

const GRID: f64 = (1_u64 << 40) as f64; // steps of the weights of a separating plane

const SWEEPS: usize = 120;
const SHARPNESS: [f64; 2] = [8.0, 200.0]; // of the penalty for overloaded pairs, in the first and the last sweep
const SIFTED: [usize; 2] = [15, 40]; // sweeps after which expensive inequalities are dropped
const EXPENSIVE: f64 = 1.5;
const POLLED: usize = 4096; // inequalities of a sweep between two checks for cancellation

/// The pairs of four points; the points of `PAIRS[5 - e]` are those that are not in `PAIRS[e]`.
const PAIRS: [(usize, usize); 6] = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)];

/// Returns a mean relative error of distances that no map of a surface has, at any scale. It is certain if the surface
/// has at most as many points as a sample; otherwise, it is too high with a probability of at most [`DOUBT`].
///
/// # Errors
/// [`Error::Unreachable`](crate::Error::Unreachable) if the surface is not connected, and the errors of the solver.
pub fn lower_bound<S: Solver>(solver: &S, samples: Samples, seed: u64, control: &Control) -> Result<f64> {
    let points = solver.columns();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let is_sampled = points > samples.points;
    let number = if is_sampled { samples.count } else { 1 };
    let mut sample = || index::sample(&mut rng, points, points.min(samples.points)).iter().map(|v| v as u32).collect();
    let samples: Vec<Vec<u32>> = (0..number).map(|_| sample()).collect();
    control.begin("measuring distances", number as u64);
    let mut tables = Vec::with_capacity(number);
    for sample in &samples {
        tables.push(Table::new(&DistanceRows::compute_to(solver, sample, sample, &control.part())?));
        control.advance();
    }
    control.begin("bounding the error", number as u64);
    let bounds: Vec<f64> = tables
        .par_iter()
        .map(|table| {
            let bound = table.lower_bound(control);
            control.advance();
            bound
        })
        .collect::<Result<_>>()?;
    let bound = if is_sampled { expectation(&bounds) } else { bounds[0] };
    Ok((bound - ROUNDED_DISTANCES).max(0.0))
}

/// Returns the maximum memory in bytes of the inequalities of a surface of `points` points, with the usual samples.
pub fn memory_need(points: usize, threads: usize) -> u64 {
    let Samples { points: most, count } = Samples::default();
    let (samples, points) = if points > most { (count, most) } else { (1, points) };
    (samples.min(threads) * most_inequalities(points) * size_of::<Inequality>()) as u64
}

/// Each four points have at most one inequality per pair.
fn most_inequalities(points: usize) -> usize {
    if points < 4 { 0 } else { 6 * (points * (points - 1) * (points - 2) * (points - 3) / 24) }
}

/// Returns a lower bound for the expectation of independent values ≥ 0.
fn expectation(values: &[f64]) -> f64 {
    let sum: f64 = values.iter().map(|value| value.ln()).sum();
    ((sum + DOUBT.ln()) / values.len() as f64).exp()
}

/// The distances δ between some points.
struct Table {
    count: usize,
    distances: Vec<f64>,
}

/// An inequality Σ up·r⁺ + down·r⁻ ≥ 1 for the relative errors of six pairs.
struct Inequality {
    pairs: [u16; 6],
    up: [f32; 6],
    down: [f32; 6],
    factor: f64, // in the packing
}

impl Table {
    /// The harmonic mean of both directions: the mean of |d/δ − 1| over both is then at least the error of the mean.
    fn new(rows: &DistanceRows) -> Self {
        let count = rows.sources().len();
        let at = |i: usize, j: usize| f64::from(rows.row(i)[j]);
        let mean = |i, j| if i == j { 0.0 } else { 2.0 / (1.0 / at(i, j) + 1.0 / at(j, i)) };
        Self { count, distances: (0..count * count).map(|n| mean(n / count, n % count)).collect() }
    }

    fn at(&self, i: usize, j: usize) -> f64 {
        self.distances[i * self.count + j]
    }

    fn pair(&self, i: usize, j: usize) -> usize {
        let (i, j) = (i.min(j), i.max(j));
        i * (2 * self.count - i - 1) / 2 + j - i - 1
    }

    /// Returns a bound for the mean of |d/δ − 1| over all pairs of the points, for any d in the plane.
    fn lower_bound(&self, control: &Control) -> Result<f64> {
        let (count, mut found) = (self.count, Vec::with_capacity(most_inequalities(self.count)));
        for a in 0..count {
            for b in a + 1..count {
                control.check()?;
                for c in b + 1..count {
                    (c + 1..count).for_each(|d| self.inequalities([a, b, c, d], &mut found));
                }
            }
        }
        let pairs = count * count.saturating_sub(1) / 2;
        Ok(packing(found, pairs, control)? / pairs.max(1) as f64)
    }

    /// Adds the inequalities of four points.
    fn inequalities(&self, points: [usize; 4], found: &mut Vec<Inequality>) {
        let lengths = PAIRS.map(|(i, j)| self.at(points[i], points[j]));
        let longest = lengths.iter().copied().fold(0.0, f64::max);
        if lengths.iter().any(|&length| length <= SHORTEST * longest) {
            return;
        }
        let pairs = PAIRS.map(|(i, j)| self.pair(points[i], points[j]) as u16);
        let mut add = |up: [f64; 6], down: [f64; 6]| {
            let [up, down] = [up, down].map(|weights| weights.map(|weight| (weight * (1.0 + ROUNDING)) as f32));
            if up.iter().chain(&down).all(|&weight| weight <= LARGEST) {
                found.push(Inequality { pairs, up, down, factor: 0.0 });
            }
        };
        let length = |i: usize, j: usize| self.at(points[i], points[j]);
        let (mut up, mut down, mut inside) = ([0.0; 6], [0.0; 6], 0);
        for (e, &(c, d)) in PAIRS.iter().enumerate() {
            let (a, b) = PAIRS[5 - e]; // a at the origin, b on the x axis; the distance from c to d is free
            let base = length(a, b);
            let place = |p| {
                let (near, far) = (length(a, p), length(b, p));
                let x = (base * base + near * near - far * far) / (2.0 * base);
                (x, (near * near - x * x).max(0.0).sqrt())
            };
            let ((x, y), (u, v)) = (place(c), place(d));
            if y < FLATTEST * base.max(length(a, c)) || v < FLATTEST * base.max(length(a, d)) {
                continue;
            }
            let [least, most] = [y - v, y + v].map(|across| (x - u).hypot(across) / lengths[e]);
            if least < 1.0 && 1.0 < most {
                (up[e], down[e]) = (1.0 / (most - 1.0), 2.0 / (1.0 - least * least));
                inside += 1;
                continue;
            }
            let v = if most <= 1.0 { -v } else { v };
            let of_others = [y * u - x * v, base * v, -base * y];
            let largest = of_others.iter().fold(0.0_f64, |most, weight| most.max(weight.abs()));
            let exact = of_others.map(|weight| (weight / largest * GRID).round() / GRID);
            let mut weights = [0.0; 4];
            (weights[a], [weights[b], weights[c], weights[d]]) = (-exact.iter().sum::<f64>(), exact);
            let terms: [f64; 6] =
                std::array::from_fn(|f| weights[PAIRS[f].0] * weights[PAIRS[f].1] * lengths[f].powi(2));
            let gap: f64 = terms.iter().sum();
            if gap > 0.0 {
                let larger = |s: f64| if s < 0.0 { (-s + (s * s - s * gap).sqrt()) / gap } else { 0.0 };
                add(terms.map(larger), terms.map(|s| 2.0 * s.max(0.0) / gap));
            }
        }
        if inside == 6 {
            add(up, down);
        }
    }
}

/// Returns the sum of the factors of an approximate fractional packing: no pair has a sum of weights above 1.
///
/// Each sweep changes one factor after the other to the maximum of Σ y − Σ exp(t (load − 1)) / t, for increasing t.
fn packing(mut inequalities: Vec<Inequality>, pairs: usize, control: &Control) -> Result<f64> {
    let mut best = 0.0_f64;
    for sweep in 0..=SWEEPS {
        let loads = loads(&inequalities, pairs);
        let most = loads.iter().copied().fold(f64::MIN_POSITIVE, f64::max) * (1.0 + ROUNDING);
        best = best.max(inequalities.iter().map(|one| one.factor).sum::<f64>() / most);
        let sharpness = SHARPNESS[0] * (SHARPNESS[1] / SHARPNESS[0]).powf(sweep as f64 / SWEEPS as f64);
        let mut prices: Vec<f64> = loads.iter().map(|load| (sharpness * (load - 1.0)).exp()).collect();
        if SIFTED.contains(&sweep) {
            inequalities.retain(|one| one.factor > 0.0 || one.price(&prices, 1) < EXPENSIVE);
        }
        for several in inequalities.chunks_mut(POLLED) {
            control.check()?;
            for one in several {
                let price = one.price(&prices, 1);
                if price >= 1.0 && one.factor == 0.0 {
                    continue;
                }
                let step = (-price.ln() * price / (sharpness * one.price(&prices, 2))).max(-one.factor);
                one.factor += step;
                for (pair, weight) in one.weights() {
                    prices[pair] *= (sharpness * weight * step).exp();
                }
            }
        }
    }
    Ok(best)
}

/// Returns the sum of the weights of each pair, up and down.
fn loads(inequalities: &[Inequality], pairs: usize) -> Vec<f64> {
    let mut loads = vec![0.0; 2 * pairs];
    for one in inequalities.iter().filter(|one| one.factor > 0.0) {
        one.weights().for_each(|(pair, weight)| loads[pair] += weight * one.factor);
    }
    loads
}

impl Inequality {
    /// Returns the weights, of pair n up as number 2n and down as number 2n + 1.
    fn weights(&self) -> impl Iterator<Item = (usize, f64)> + '_ {
        (0..6).flat_map(|e| {
            let pair = 2 * usize::from(self.pairs[e]);
            [(pair, f64::from(self.up[e])), (pair + 1, f64::from(self.down[e]))]
        })
    }

    /// Returns the sum of powers of the weights times the prices.
    fn price(&self, prices: &[f64], power: i32) -> f64 {
        self.weights().map(|(pair, weight)| weight.powi(power) * prices[pair]).sum()
    }
}

#[cfg(test)]
mod tests;
