//! Minimisation of a map's energy: L-BFGS over a factored matrix of springs, with steps that do not create folds.

use super::lbfgs::History;
use super::springs::Factor;
use crate::embed::Place;
use crate::{Control, Result};

/// The maximum share of the largest step without a fold that is taken (Smith, Schaefer 2015).
pub(crate) const SAFE: f64 = 0.8;

/// The minimum share of the decrease predicted by the slope that a step must achieve (Armijo).
const KEPT: f64 = 1e-4;

/// The maximum number of times that a step is shortened.
const MOST_SHORTER: usize = 14;

/// If steps are shorter than this share of their direction, the springs no longer fit the map. They are then computed
/// again after so many of them, or when the optimisation would otherwise end.
const SHORT: f64 = 0.02;
const MOST_SHORT: usize = 4;

/// The number of steps over which progress is measured.
const EVALUATED: usize = 5;

/// A function to be minimised.
pub trait Objective {
    /// Returns the energy of a map, which is infinite where not permitted, and its gradient.
    fn evaluate(&self, uv: &[Place], control: &Control) -> Result<(f64, Vec<Place>)>;

    /// Returns the factor of springs that are about as stiff as the energy around a map.
    fn factor(&self, uv: &[Place]) -> Result<Factor>;

    /// Returns the largest permitted step along a direction.
    fn farthest_step(&self, uv: &[Place], direction: &[Place]) -> f64;
}

/// The conditions under which the optimisation ends.
#[derive(Debug, Clone, Copy)]
pub struct Until {
    /// The maximum number of steps.
    pub steps: usize,
    /// The relative decrease in energy over five steps below which it ends.
    pub gain: f64,
    /// The energy at or below which it ends.
    pub enough: f64,
}

/// The result of the optimisation.
#[derive(Debug, Clone)]
pub struct Descended {
    /// The initial energy and the energy after every step.
    pub energies: Vec<f64>,
    /// Whether it ended because the energy hardly decreased.
    pub converged: bool,
}

fn dot(a: &[Place], b: &[Place]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.dot(b)).sum()
}

fn add(to: &mut [Place], by: &[Place], times: f64) {
    to.iter_mut().zip(by).for_each(|(to, by)| *to += times * by);
}

/// Minimises the energy of a map. Every step decreases it.
pub fn descend(objective: &impl Objective, uv: &mut Vec<Place>, until: Until, control: &Control) -> Result<Descended> {
    let (mut energy, mut gradient) = objective.evaluate(uv, control)?;
    let mut factor = objective.factor(uv)?;
    let (mut since, mut short) = (0, 0);
    let mut history = History::default();
    let mut energies = vec![energy];
    while energies.len() <= until.steps && energy > until.enough {
        control.check()?;
        let mut along = history.direction(&gradient, &factor);
        let mut slope = dot(&gradient, &along);
        // rounding can spoil the history; the factored springs alone are positive definite and lead downhill
        if slope >= 0.0 {
            history.clear();
            along = history.direction(&gradient, &factor);
            slope = dot(&gradient, &along);
        }
        let mut length = (SAFE * objective.farthest_step(uv, &along)).min(1.0);
        let mut found = None;
        for _ in 0..MOST_SHORTER {
            let mut tried = uv.clone();
            add(&mut tried, &along, length);
            let (reached, bent) = objective.evaluate(&tried, control)?;
            if reached <= energy + KEPT * length * slope {
                found = Some((tried, reached, bent));
                break;
            }
            // the parabola through the energy, its slope, and the energy that was reached
            let lowest = -slope * length * length / (2.0 * (reached - energy - slope * length));
            length = if lowest.is_finite() { lowest.clamp(0.1 * length, 0.5 * length) } else { 0.5 * length };
        }
        let Some((next, reached, next_gradient)) = found else {
            if history.is_empty() {
                return Ok(Descended { energies, converged: true }); // only rounding is left
            }
            history.clear();
            continue;
        };
        let moved: Vec<_> = next.iter().zip(uv.iter()).map(|(to, from)| to - from).collect();
        let bent: Vec<_> = next_gradient.iter().zip(&gradient).map(|(to, from)| to - from).collect();
        let curvature = dot(&moved, &bent);
        // yᵀs > 0, or the inverse Hessian would not be positive definite (Nocedal 1980)
        if curvature > 1e-12 * (dot(&moved, &moved) * dot(&bent, &bent)).sqrt() {
            history.push(&moved, &bent);
        }
        (*uv, energy, gradient) = (next, reached, next_gradient);
        energies.push(energy);
        control.advance();
        short += usize::from(length < SHORT);
        let is_little = |before: usize| energies[before] - energy < until.gain * energy.abs();
        let ends = energies.len().checked_sub(1 + EVALUATED).is_some_and(|before| before >= since && is_little(before));
        if (short >= MOST_SHORT || ends && short > 0) && !is_little(since) {
            factor = objective.factor(uv)?;
            history.clear();
            (since, short) = (energies.len() - 1, 0);
        } else if ends {
            return Ok(Descended { energies, converged: true });
        }
    }
    Ok(Descended { converged: energy <= until.enough, energies })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::embed::stress::springs::Springs;

    /// Half the sum of the squared distances from the origin, and springs that are too soft by a factor.
    struct Bowl(f64);

    impl Objective for Bowl {
        fn evaluate(&self, uv: &[Place], _: &Control) -> Result<(f64, Vec<Place>)> {
            Ok((0.5 * dot(uv, uv), uv.to_vec()))
        }

        fn factor(&self, uv: &[Place]) -> Result<Factor> {
            let springs = Springs::new(vec![[0, 1, 2]], uv.len(), &Control::default())?;
            springs.factor(&[[0.0; 3]], &vec![self.0.recip(); uv.len()])
        }

        fn farthest_step(&self, _: &[Place], _: &[Place]) -> f64 {
            f64::INFINITY
        }
    }

    #[test]
    fn every_step_decreases_the_energy_however_soft_the_springs() {
        for soft in [1.0, 2.5, 3.0, 50.0] {
            let mut uv = vec![Place::new(1.0, 0.0), Place::new(0.0, -2.0), Place::new(3.0, 1.0)];
            let until = Until { steps: 100, gain: 1e-9, enough: 1e-12 };
            let found = descend(&Bowl(soft), &mut uv, until, &Control::default()).unwrap();
            assert!(found.energies.windows(2).all(|pair| pair[1] < pair[0]), "{soft} {:?}", found.energies);
            assert!(found.converged && found.energies[found.energies.len() - 1] < 1e-9, "{soft}");
        }
    }
}
