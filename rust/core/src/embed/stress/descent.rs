//! Descent to a map of least energy: L-BFGS over a factored matrix of springs, in steps that fold nothing.

use super::lbfgs::History;
use super::springs::Factor;
use crate::control::Control;
use crate::embed::Place;
use crate::error::Result;

/// The part of the largest step without a fold that is taken at most (Smith, Schaefer 2015).
pub(crate) const SAFE: f64 = 0.8;

/// The part of what the slope promises that a step must keep (Armijo).
const KEPT: f64 = 1e-4;

/// Times that a step is made shorter at most.
const MOST_SHORTER: usize = 14;

/// Steps that are shorter than this part of their direction tell that springs no longer fit the map: they are made anew after so many,
/// or where descent would end otherwise.
const SHORT: f64 = 0.02;
const MOST_SHORT: usize = 4;

/// Steps over which progress is judged.
const EVALUATED: usize = 5;

/// What is made less.
pub trait Objective {
    /// The energy of a map, infinite where it is not allowed, and its gradient.
    fn evaluate(&self, uv: &[Place], control: &Control) -> Result<(f64, Vec<Place>)>;

    /// The factor of the springs that are about as stiff as the energy around a map.
    fn factor(&self, uv: &[Place]) -> Result<Factor>;

    /// The largest step along a direction that is allowed.
    fn farthest_step(&self, uv: &[Place], direction: &[Place]) -> f64;
}

/// When descent ends.
#[derive(Debug, Clone, Copy)]
pub struct Until {
    /// After so many steps.
    pub steps: usize,
    /// Or when five steps together gain less than this part of the energy.
    pub gain: f64,
    /// Or when the energy is no more than this.
    pub enough: f64,
}

/// What descent came to.
#[derive(Debug, Clone)]
pub struct Descended {
    /// The energy at first and after every step.
    pub energies: Vec<f64>,
    /// It ended because little was gained any more.
    pub converged: bool,
}

fn dot(a: &[Place], b: &[Place]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.dot(b)).sum()
}

fn add(to: &mut [Place], by: &[Place], times: f64) {
    to.iter_mut().zip(by).for_each(|(to, by)| *to += times * by);
}

/// Moves a map downhill. Every step makes the energy less.
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
                return Ok(Descended { energies, converged: true }); // nothing is downhill any more but for rounding
            }
            history.clear();
            continue;
        };
        let moved: Vec<_> = next.iter().zip(uv.iter()).map(|(to, from)| to - from).collect();
        let bent: Vec<_> = next_gradient.iter().zip(&gradient).map(|(to, from)| to - from).collect();
        let curvature = dot(&moved, &bent);
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
