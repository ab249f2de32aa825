//! The deviation of triangles from their shape on the surface, as an energy.
//!
//! With σ1 ≥ σ2 the singular values of a triangle's Jacobian, the second one negative if it is flipped, the energy is
//! the mean of p(σ1) + p(σ2) over the area. There are two penalties p:
//!
//! - for values outside the bound C: ½ d², where d is the distance of σ from the range 1/C to C. It is also defined for
//!   flipped triangles, and zero for a map within the bound;
//! - for any change: ½ (σ − 1/σ)², the symmetric Dirichlet energy (Smith, Schaefer 2015), and a barrier that grows
//!   without bound as σ approaches C or 1/C. It leads from one map within the bound to better ones within it.

use nalgebra::{Matrix2, Vector2};

use crate::embed::stress::descent::{Objective, SAFE};
use crate::embed::stress::springs::{Factor, Springs};
use crate::embed::stress::triangles::Rest;
use crate::{Control, Result};

pub(super) type Place = Vector2<f64>;

/// The share of the range (by its logarithm) at which the barrier begins.
const FREE: f64 = 0.6;

/// The weight of the barrier.
const BARRIER: f64 = 0.05;

/// The maximum stiffness of triangles near the barrier.
const STIFFEST: f64 = 1e3;

/// The stiffness that fixes a freely floating region, as a share of its mean stiffness.
const AFLOAT: f64 = 1e-7;

/// The number of halvings in the search for the largest step.
const HALVINGS: usize = 12;

/// The number of triangles between two checks for cancellation.
const CHUNK: usize = 8192;

/// The penalty on singular values.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Price {
    /// Penalises values outside a bound.
    Excess(f64),
    /// Penalises any change, within a bound.
    Change(f64),
}

impl Price {
    /// Returns the penalty, its slope, and its stiffness.
    fn of(self, sigma: f64) -> [f64; 3] {
        match self {
            Self::Excess(bound) => {
                let beyond = sigma - sigma.clamp(bound.recip(), bound);
                [0.5 * beyond * beyond, beyond, 1.0]
            }
            Self::Change(bound) => {
                let (log, most) = (sigma.ln(), bound.ln());
                if sigma <= 0.0 || log.abs() >= most {
                    return [f64::INFINITY, 0.0, 1.0];
                }
                let inverse = sigma.recip();
                // ½ (σ − 1/σ)² has slope (σ − 1/σ)(1 + 1/σ²) and curvature 1 + 3/σ⁴
                let change = sigma - inverse;
                let mut price =
                    [0.5 * change * change, change * (1.0 + inverse * inverse), 1.0 + 3.0 * inverse.powi(4)];
                let into = log.abs() - FREE * most;
                if into > 0.0 {
                    let left = most - log.abs();
                    // rise = (|log σ| − f m)/(m − |log σ|), whose derivative by log σ is ±(1 − f) m/(m − |log σ|)²
                    let (rise, slope) = (into / left, (1.0 - FREE) * most / (left * left) * log.signum() * inverse);
                    price[0] += BARRIER * rise * rise;
                    price[1] += 2.0 * BARRIER * rise * slope;
                    // Gauss–Newton: without the term of the second derivative, so that it stays positive
                    price[2] += 2.0 * BARRIER * slope * slope;
                }
                price
            }
        }
    }
}

/// A matrix as a scaled rotation (e, h) and a scaled reflection (f, g): σ = |(e, h)| ± |(f, g)|.
struct Parts {
    turn: Vector2<f64>,
    mirrored: Vector2<f64>,
}

impl Parts {
    fn of(j: &Matrix2<f64>) -> Self {
        Self {
            turn: 0.5 * Vector2::new(j.m11 + j.m22, j.m21 - j.m12),
            mirrored: 0.5 * Vector2::new(j.m11 - j.m22, j.m21 + j.m12),
        }
    }

    fn stretch(&self) -> [f64; 2] {
        let (a, b) = (self.turn.norm(), self.mirrored.norm());
        [a + b, a - b]
    }

    /// Returns the gradient with respect to the matrix, given the slopes with respect to σ1 and σ2.
    fn gradient(&self, slopes: [f64; 2]) -> Matrix2<f64> {
        let along = |part: Vector2<f64>, slope: f64| part.try_normalize(0.0).unwrap_or_default() * slope;
        // σ = a ± b, so the slope by a is p'(σ₁) + p'(σ₂), and by b their difference; halves from the definition
        let turn = along(self.turn, 0.5 * (slopes[0] + slopes[1]));
        let mirrored = along(self.mirrored, 0.5 * (slopes[0] - slopes[1]));
        Matrix2::new(turn.x + mirrored.x, mirrored.y - turn.y, turn.y + mirrored.y, turn.x - mirrored.x)
    }
}

/// Triangles with some free corners; the others are fixed.
pub(super) struct Region {
    /// Corners whose number is at least the number of free places are fixed.
    pub rests: Vec<Rest>,
    pub held: Vec<Place>,
    pub springs: Springs,
    area: f64,
}

impl Region {
    pub fn new(rests: Vec<Rest>, free: usize, held: Vec<Place>, control: &Control) -> Result<Self> {
        let springs = Springs::new(rests.iter().map(|rest| rest.corners).collect(), free, control)?;
        let area = rests.iter().map(|rest| rest.area).sum();
        Ok(Self { rests, held, springs, area })
    }

    /// Returns the Jacobian of a triangle with the free places at `uv`.
    fn jacobian(&self, rest: &Rest, uv: &[Place]) -> Matrix2<f64> {
        let place = |n: u32| uv.get(n as usize).copied().unwrap_or_else(|| self.held[n as usize - uv.len()]);
        let [a, b, c] = rest.corners.map(place);
        Matrix2::from_columns(&[b - a, c - a]) * rest.inverse
    }
}

pub(super) struct Strain<'a> {
    pub region: &'a Region,
    pub price: Price,
}

impl Objective for Strain<'_> {
    fn evaluate(&self, uv: &[Place], control: &Control) -> Result<(f64, Vec<Place>)> {
        let mut gradient = vec![Vector2::zeros(); uv.len()];
        let mut energy = 0.0;
        for rests in self.region.rests.chunks(CHUNK) {
            control.check()?;
            for rest in rests {
                let parts = Parts::of(&self.region.jacobian(rest, uv));
                let [most, least] = parts.stretch().map(|sigma| self.price.of(sigma));
                energy += rest.area * (most[0] + least[0]);
                if energy.is_infinite() {
                    return Ok((energy, gradient));
                }
                let scale = rest.area / self.region.area;
                let by_sides = parts.gradient([most[1], least[1]]) * rest.inverse.transpose() * scale;
                let (second, third) = (by_sides.column(0), by_sides.column(1));
                for (corner, force) in rest.corners.into_iter().zip([-second - third, second.into(), third.into()]) {
                    if let Some(gradient) = gradient.get_mut(corner as usize) {
                        *gradient += force;
                    }
                }
            }
        }
        Ok((energy / self.region.area, gradient))
    }

    fn factor(&self, uv: &[Place]) -> Result<Factor> {
        let of_triangle = |rest: &Rest| {
            let stiff = Parts::of(&self.region.jacobian(rest, uv)).stretch().map(|sigma| self.price.of(sigma)[2]);
            rest.springs(stiff[0].max(stiff[1]).clamp(1.0, STIFFEST) * rest.area / self.region.area)
        };
        let entries: Vec<[f64; 3]> = self.region.rests.iter().map(of_triangle).collect();
        let total: f64 = entries.iter().flatten().map(|entry| entry.abs()).sum();
        // without it, a region with nothing fixed could move freely, and the matrix would be singular
        self.region.springs.factor(&entries, &vec![AFLOAT * total / uv.len() as f64; uv.len()])
    }

    /// Returns nearly the largest step after which all triangles are within the bound, found by halving.
    fn farthest_step(&self, uv: &[Place], direction: &[Place]) -> f64 {
        let mut farthest = SAFE.recip();
        if matches!(self.price, Price::Excess(_)) {
            return farthest;
        }
        for rest in &self.region.rests {
            if self.is_within(rest, uv, direction, farthest) {
                continue;
            }
            let (mut good, mut bad) = (0.0, farthest);
            for _ in 0..HALVINGS {
                let middle = 0.5 * (good + bad);
                if self.is_within(rest, uv, direction, middle) { good = middle } else { bad = middle }
            }
            farthest = good;
        }
        farthest
    }
}

impl Strain<'_> {
    fn is_within(&self, rest: &Rest, uv: &[Place], direction: &[Place], step: f64) -> bool {
        let place = |n: u32| match uv.get(n as usize) {
            Some(place) => place + direction[n as usize] * step,
            None => self.region.held[n as usize - uv.len()],
        };
        let [a, b, c] = rest.corners.map(place);
        let jacobian = Matrix2::from_columns(&[b - a, c - a]) * rest.inverse;
        Parts::of(&jacobian).stretch().iter().all(|&sigma| self.price.of(sigma)[0].is_finite())
    }
}
