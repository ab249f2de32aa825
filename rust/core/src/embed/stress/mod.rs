//! Stress: positions in the plane with distances close to geodesic ones, and triangles that never fold.

pub mod area_bound;
pub(crate) mod descent;
pub(crate) mod exact;
pub mod group;
mod lbfgs;
pub mod levels;
pub(crate) mod local;
pub(crate) mod outline;
pub(crate) mod pairs;
pub mod periodic;
mod repair;
pub(crate) mod springs;
pub mod start;
pub(crate) mod triangles;
pub(crate) mod tutte;

use crate::embed::Place;
use nalgebra::Vector2;

use crate::{Control, Result};
use descent::{Objective, SAFE};
use outline::Outline;
use pairs::{Bands, Pairs};
use springs::{Factor, Springs};
use triangles::{Shape, TriangleEnergy};

/// The energy of a map: the stress of its distances and the distortion of its triangles.
#[derive(Debug)]
pub(crate) struct MapEnergy<'a> {
    /// The distances to preserve.
    pub pairs: &'a Pairs,
    /// Their weights.
    pub bands: Bands,
    /// The triangles to preserve.
    pub triangles: &'a TriangleEnergy,
    /// The penalty on their changes.
    pub shape: Shape,
    /// β, the weight of the triangles' mean energy relative to the stress.
    pub stiffness: f64,
    /// Springs along the triangles' edges.
    pub springs: &'a Springs,
    /// The boundary and the weight of its gaps, where it is kept apart.
    pub outline: Option<(&'a Outline, f64)>,
}

impl Objective for MapEnergy<'_> {
    fn evaluate(&self, uv: &[Place], control: &Control) -> Result<(f64, Vec<Place>)> {
        let mut gradient = vec![Vector2::zeros(); uv.len()];
        let of_triangles = self.triangles.add(uv, self.shape, self.stiffness, &mut gradient);
        if of_triangles.is_infinite() {
            return Ok((of_triangles, gradient));
        }
        let of_outline = self.outline.map_or(0.0, |(outline, weight)| outline.add(uv, weight, &mut gradient));
        Ok((of_triangles + of_outline + self.pairs.add(uv, &self.bands, &mut gradient, control)?, gradient))
    }

    fn factor(&self, uv: &[Place]) -> Result<Factor> {
        let mut ground = vec![0.0; uv.len()];
        self.pairs.add_curvature(uv, &self.bands, &mut ground);
        if let Some((outline, weight)) = self.outline {
            outline.add_curvature(uv, weight, &mut ground);
        }
        self.springs.factor(&self.triangles.stiffness(uv, self.shape, self.stiffness), &ground)
    }

    fn farthest_step(&self, uv: &[Place], direction: &[Place]) -> f64 {
        let unfolded = self.triangles.farthest_step(uv, direction);
        self.outline.map_or(unfolded, |(outline, _)| outline.farthest_step(uv, direction, unfolded.min(1.0 / SAFE)))
    }
}

#[cfg(test)]
mod tests;
