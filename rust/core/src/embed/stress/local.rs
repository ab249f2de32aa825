//! Local moves: vertex after vertex goes to where its own triangles are distorted least.
//!
//! Re-insertion puts vertices where nothing folds, but some of the triangles there have hardly any area. One such triangle would
//! hold back every step of a [descent](super::descent), which moves all vertices at once; here it holds back its corners only.

use crate::embed::Place;
use nalgebra::Matrix2;

use super::triangles::{Rest, Shape, TriangleEnergy, cofactors};
use crate::control::Control;
use crate::error::Result;

/// Times that a step is made shorter at most.
const MOST_SHORTER: usize = 12;

/// Sweeps end when one gains less than this part of the energy, or after so many.
const GAIN: f64 = 0.05;
const MOST_SWEEPS: usize = 40;

/// Where the energy bends less than this part of how it bends at most, it counts as bent so much.
const FLATTEST: f64 = 1e-6;

/// Vertices between two looks at the control.
const BATCH: usize = 1 << 12;

/// Moves the vertices that may move, one after the other, until little is gained. The triangles' energy falls, and none is
/// turned over.
pub fn ease(
    triangles: &TriangleEnergy,
    shape: Shape,
    may_move: &[bool],
    uv: &mut [Place],
    control: &Control,
) -> Result<()> {
    let mut energy = triangles.energy(uv, shape);
    for _ in 0..MOST_SWEEPS {
        for vertices in (0..uv.len()).collect::<Vec<_>>().chunks(BATCH) {
            control.check()?;
            vertices.iter().filter(|&&vertex| may_move[vertex]).for_each(|&vertex| step(triangles, shape, vertex, uv));
        }
        let before = energy;
        energy = triangles.energy(uv, shape);
        if before - energy <= GAIN * before {
            break;
        }
    }
    Ok(())
}

/// One step of Newton's method for a vertex, shorter where it would not go downhill.
fn step(triangles: &TriangleEnergy, shape: Shape, vertex: usize, uv: &mut [Place]) {
    let from = uv[vertex];
    let mut here = Local::default();
    triangles.around(vertex).for_each(|(rest, corner)| here.add(rest, corner, uv, shape));
    let mut along = here.newton();
    for _ in 0..MOST_SHORTER {
        uv[vertex] = from + along;
        let there: f64 = triangles.around(vertex).map(|(rest, _)| rest.energy(uv, shape)).sum();
        if there < here.energy {
            return;
        }
        along *= 0.5;
    }
    uv[vertex] = from;
}

/// What a vertex' triangles say about its place.
#[derive(Debug, Clone, Copy, Default)]
struct Local {
    energy: f64,
    slope: Place,
    bend: Matrix2<f64>,
}

impl Local {
    /// With r the gradient of the corner's hat function on the surface's triangle, J = … + x rᵀ. So ½ ‖J‖² has the slope J r and
    /// the bend ‖r‖² 1; the determinant, which is linear in x, has the slope C r, C its matrix of cofactors.
    fn add(&mut self, rest: &Rest, corner: usize, uv: &[Place], shape: Shape) {
        let jacobian = rest.jacobian(uv);
        let price = shape.price(&jacobian);
        let hat = rest.hat(corner);
        let [by_half, by_area] = [jacobian * hat, cofactors(&jacobian) * hat];
        let [half, area] = price.slopes;
        let [half_half, half_area, area_area] = price.bends;
        let cross = by_half * by_area.transpose();
        self.energy += rest.area * price.value;
        self.slope += rest.area * (half * by_half + area * by_area);
        self.bend += rest.area
            * (Matrix2::identity() * (half * hat.norm_squared())
                + half_half * by_half * by_half.transpose()
                + half_area * (cross + cross.transpose())
                + area_area * by_area * by_area.transpose());
    }

    /// The way to where the parabola is lowest; where it bends downwards, as if it bent upwards as much.
    fn newton(&self) -> Place {
        let parts = self.bend.symmetric_eigen();
        let least = FLATTEST * parts.eigenvalues.amax();
        let along = |n: usize| {
            let axis: Place = parts.eigenvectors.column(n).into();
            axis * (-axis.dot(&self.slope) / parts.eigenvalues[n].abs().max(least))
        };
        along(0) + along(1)
    }
}

#[cfg(test)]
mod tests;
