//! Minimisation of Sammon's stress by Newton steps along each coordinate.
//!
//! Schwartz, Shaw and Wolfson (1989), equation 1: over pairs at geodesic distance δ and flat distance d,
//!
//!   L = (1/Σδ) Σ (d − δ)²/δ.
//!
//! All points move at once against their gradients. Each coordinate is divided by the magnitude of its second
//! derivative (the diagonal of the Hessian) and multiplied by a factor μ (the "magic factor" of Sammon 1969). A
//! coordinate with hardly any curvature takes a leap. Leaps sometimes increase the stress, but lead out of folds.

use rayon::prelude::*;

use crate::geodesic::neighbourhood::{Near, Neighbourhoods};
use crate::{Control, Result};

/// Sammon's magic factor: "about 0.3 or 0.4".
const FACTOR: f64 = 0.35;

/// The smallest curvature, as a share of that of a point far from all others; it limits the leaps.
const LEAST_CURVATURE: f64 = 1e-3;

/// The maximum number of steps from one start.
pub(crate) const MOST_STEPS: usize = 1500;

/// The number of steps over which convergence is tested, and the maximum relative change of the stress at convergence.
const EVALUATED: usize = 20;
const SETTLED: f64 = 1e-5;

/// The number of vertices that are visited together.
const BATCH: usize = 32;

/// The minimum distance of two points, as a share of their geodesic distance, for which their direction is defined.
const NEAREST: f64 = 1e-9;

/// The stress of one point's pairs, Σ (d − δ)²/δ, and its derivatives with respect to the point's position.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Pull {
    /// Σ (d − δ)²/δ in mm.
    pub stress: f64,
    /// Half its gradient.
    pub gradient: [f64; 2],
    /// Half its second derivatives, in 1/mm.
    pub curvature: [f64; 2],
    /// Σ 1/δ in 1/mm: half the curvature of a point far from all others.
    pub stiffness: f64,
}

impl Pull {
    /// Computes it for a point's pairs, with all points at `uv`.
    pub(crate) fn of(vertex: usize, near: &[Near], uv: &[[f64; 2]]) -> Self {
        let [x, y] = uv[vertex];
        let mut pull = Self::default();
        for &Near { vertex, distance } in near {
            let delta = f64::from(distance);
            let (dx, dy) = (x - uv[vertex as usize][0], y - uv[vertex as usize][1]);
            let square = dx * dx + dy * dy;
            let flat = square.sqrt().max(NEAREST * delta);
            let (weight, error) = (delta.recip(), flat - delta);
            pull.stress += weight * error * error;
            // ½ ∂/∂x (d − δ)²/δ = (d − δ)/(δ d) Δx
            let along = weight * error / flat;
            pull.gradient[0] += along * dx;
            pull.gradient[1] += along * dy;
            // ½ ∂²/∂x² (d − δ)²/δ = 1/δ − Δy²/d³, which is negative for pairs that are too close, mostly across them
            let across = (flat * flat * flat).recip();
            pull.curvature[0] += weight - dy * dy * across;
            pull.curvature[1] += weight - dx * dx * across;
            pull.stiffness += weight;
        }
        pull
    }

    fn step(&self, place: [f64; 2]) -> [f64; 2] {
        let least = LEAST_CURVATURE * self.stiffness;
        std::array::from_fn(|axis| {
            // the magnitude, so that a step leads downhill where the curvature is negative
            let curvature = self.curvature[axis].abs().max(least);
            let moved = place[axis] - FACTOR * self.gradient[axis] / curvature;
            if moved.is_finite() { moved } else { place[axis] } // a point without pairs does not move
        })
    }
}

/// Returns Sammon's stress of a map, which is 0 if it preserves the distances of all pairs, and the new positions.
fn step(pairs: &Neighbourhoods, uv: &[[f64; 2]], control: &Control) -> Result<(f64, Vec<[f64; 2]>)> {
    let mut moved = vec![[0.0; 2]; uv.len()];
    let of_batch = |(batch, moved): (usize, &mut [[f64; 2]])| {
        control.check()?;
        let mut sum = 0.0;
        for (vertex, moved) in (batch * BATCH..).zip(moved) {
            let pull = Pull::of(vertex, pairs.of_vertex(vertex), uv);
            sum += pull.stress;
            *moved = pull.step(uv[vertex]);
        }
        Ok(sum)
    };
    let sums: Vec<f64> = moved.par_chunks_mut(BATCH).enumerate().map(of_batch).collect::<Result<_>>()?;
    // every pair counts from both of its ends, in the stress as in Σ δ (Schwartz, Shaw & Wolfson 1989, eq. 1.0)
    Ok((sums.iter().sum::<f64>() / pairs.total(), moved))
}

/// The result of the optimisation from one start.
#[derive(Debug, Clone, PartialEq)]
pub struct Descended {
    /// The map with the smallest stress on the way, in mm.
    pub uv: Vec<[f64; 2]>,
    /// Its stress.
    pub least: f64,
    /// The stress at the start and after every step.
    pub stresses: Vec<f64>,
    /// Whether it ended because the stress hardly changed.
    pub converged: bool,
}

/// Optimises a map until its stress hardly changes.
///
/// # Errors
/// [`Error::Cancelled`](crate::Error::Cancelled).
pub fn descend(pairs: &Neighbourhoods, start: Vec<[f64; 2]>, control: &Control) -> Result<Descended> {
    let mut found = Descended { uv: Vec::new(), least: f64::INFINITY, stresses: Vec::new(), converged: false };
    let mut uv = start;
    while found.stresses.len() <= MOST_STEPS && !found.converged {
        let (stress, moved) = step(pairs, &uv, control)?;
        // steps can increase the stress, so the best map on the way is kept
        found.stresses.push(stress);
        if stress < found.least || found.uv.is_empty() {
            found.least = stress;
            found.uv.clone_from(&uv);
        }
        found.converged = is_settled(&found.stresses);
        uv = moved;
        control.advance();
    }
    Ok(found)
}

fn is_settled(stresses: &[f64]) -> bool {
    let Some(first) = stresses.len().checked_sub(EVALUATED) else { return false };
    let least = stresses[first..].iter().copied().fold(f64::INFINITY, f64::min);
    let most = stresses[first..].iter().copied().fold(0.0, f64::max);
    most - least <= SETTLED * most || most < f64::from(f32::EPSILON).powi(2) // distances are f32
}

#[cfg(test)]
mod tests;
