//! Local moves: each vertex in turn moves to where its own triangles are distorted least.
//!
//! Re-insertion places vertices without folds, but some triangles then have hardly any area. A single one would block
//! every step of a [descent](super::descent), which moves all vertices at once; here, it only blocks its own corners.

use crate::embed::Place;
use nalgebra::Matrix2;

use super::triangles::{Rest, Shape, TriangleEnergy, cofactors};
use crate::{Control, Result};

/// The maximum number of times that a step is shortened.
const MOST_SHORTER: usize = 12;

/// Sweeps end when one decreases the energy by less than this share, or after the maximum number.
const GAIN: f64 = 0.05;
const MOST_SWEEPS: usize = 40;

/// The smallest curvature of the energy, as a share of the largest one.
const FLATTEST: f64 = 1e-6;

/// The number of vertices between two checks for cancellation.
const BATCH: usize = 1 << 12;

/// Moves the free vertices one after the other until the energy hardly decreases. No triangle is flipped.
pub fn ease(
    triangles: &TriangleEnergy, shape: Shape, may_move: &[bool], uv: &mut [Place], control: &Control,
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

/// Takes a Newton step for a vertex, shortened if it would increase the energy.
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

/// The energy of a vertex's triangles as a function of its position.
#[derive(Debug, Clone, Copy, Default)]
struct Local {
    energy: f64,
    slope: Place,
    bend: Matrix2<f64>,
}

impl Local {
    /// With r the gradient of the corner's hat function on the surface's triangle, J = … + x rᵀ. So ½ ‖J‖² has slope J
    /// r and curvature ‖r‖² 1. The determinant, linear in x, has slope C r, with C its matrix of cofactors.
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
        // chain rule for ψ(h, D): h is quadratic and D linear in x, so only h adds a curvature of its own
        self.bend += rest.area
            * (Matrix2::identity() * (half * hat.norm_squared())
                + half_half * by_half * by_half.transpose()
                + half_area * (cross + cross.transpose())
                + area_area * by_area * by_area.transpose());
    }

    /// Returns the step to the minimum of the parabola; negative curvatures are replaced by their magnitudes.
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
