//! A map without folds to start from (Tutte 1963): the boundary on a circle, everything inside held by springs.
//!
//! Whatever the springs, nothing folds. Springs of equal stiffness crowd what is far from the boundary; so they are made softer
//! there, and the map is made again, until its triangles are of comparable size.

use std::f64::consts::{PI, TAU};

use nalgebra::Vector2;

use super::springs::Springs;
use super::triangles::Triangles;
use crate::control::Control;
use crate::error::Result;
use crate::surface::Surface;

/// Triangles may shrink to this part of their area.
const SMALL: f64 = 0.02;

/// How often springs are made softer.
const ROUNDS: usize = 30;

/// How much softer at once, at most.
const SOFTER: f64 = 1e-2;

/// What holds the boundary, beside springs whose stiffness is about 1.
const FIRM: f64 = 1e9;

/// The map of a disk, as large as it is.
///
/// # Errors
/// [`crate::Error::OutOfMemory`], [`crate::Error::Cancelled`].
pub fn spread(
    surface: &Surface,
    triangles: &Triangles,
    springs: &Springs,
    control: &Control,
) -> Result<Vec<Vector2<f64>>> {
    let mut ground = vec![0.0; surface.len()];
    let mut forces = vec![Vector2::zeros(); surface.len()];
    let radius = (triangles.area() / PI).sqrt();
    for boundary in surface.boundary() {
        let round: f64 = boundary.iter().map(|&half_edge| surface.length(half_edge)).sum();
        let mut along = 0.0;
        for half_edge in boundary {
            let (sin, cos) = (along / round * TAU).sin_cos();
            let vertex = surface.origin(half_edge) as usize;
            ground[vertex] = FIRM;
            forces[vertex] = FIRM * radius * Vector2::new(cos, sin);
            along += surface.length(half_edge);
        }
    }
    let mut stiffness = vec![1.0f64; surface.faces().len()];
    let mut rounds = 0;
    loop {
        control.check()?;
        let entries: Vec<[f64; 3]> = stiffness.iter().map(|&stiffness| [-stiffness; 3]).collect();
        let uv = springs.factor(&entries, &ground)?.solve(&forces);
        let growths = triangles.growths(&uv);
        rounds += 1;
        if rounds == ROUNDS || growths.iter().all(|&growth| growth > SMALL) {
            return Ok(uv);
        }
        let softer = |growth: f64| growth.max(0.0).sqrt().clamp(SOFTER, SOFTER.recip());
        stiffness.iter_mut().zip(growths).for_each(|(stiffness, growth)| *stiffness *= softer(growth));
    }
}
