//! Repair of a given map, so that it can be optimised: no triangle is flipped, and the boundary does not meet itself.
//!
//! Most folds consist of a few vertices, for which there is a position from which all of their triangles have the right
//! orientation: the kernel of their ring. If a map was made before a cut, the two sides of the cut coincide. Each
//! boundary vertex that shares its position with another one moves slightly into its own triangles, along the bisector
//! of its angle, so that both of its edges do.

use crate::embed::Place;
use nalgebra::Vector2;

use super::descent::SAFE;
use super::outline::Outline;
use super::triangles::{TriangleEnergy, signed_area};
use crate::adjacency::distinct;
use crate::place::reinsertion::seeing;
use crate::{Control, Result};

/// The number of rounds in which vertices of folded triangles are moved.
const ROUNDS: usize = 40;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Fault {
    /// This number of triangles are flipped or have no area.
    Folded(usize),
    /// The boundary crosses or touches itself this number of times.
    Crossing(usize),
    /// Triangles have hardly any area, and the optimisation makes no progress.
    Stuck,
}

/// Repairs a map; if this fails, returns the defect of the given map.
pub(super) fn repair(
    triangles: &TriangleEnergy, outline: &Outline, uv: &mut [Place], control: &Control,
) -> Result<Option<Fault>> {
    let folded = triangles.folded(uv);
    if folded > 0 && !unfold(triangles, outline, uv, control)? {
        return Ok(Some(Fault::Folded(folded)));
    }
    let inwards = outline.inwards(uv);
    if inwards.iter().any(|by| *by != Vector2::zeros()) {
        let length = (SAFE * triangles.farthest_step(uv, &inwards)).min(1.0);
        uv.iter_mut().zip(&inwards).for_each(|(place, by)| *place += by * length);
    }
    let crossings = outline.crossings(uv, control)?;
    let touches = outline.touches(uv);
    Ok((crossings + touches > 0).then_some(Fault::Crossing(crossings + touches)))
}

/// Moves vertices of folded triangles, one after the other, to remove the folds; returns whether none is left.
fn unfold(triangles: &TriangleEnergy, outline: &Outline, uv: &mut [Place], control: &Control) -> Result<bool> {
    let is_inside = outline.inside(uv.len());
    for _ in 0..ROUNDS {
        control.check()?;
        let is_folded = |corners: &[u32; 3]| signed_area(*corners, uv) <= 0.0;
        let vertices = distinct(triangles.corners().filter(is_folded).flatten());
        if vertices.is_empty() {
            return Ok(true);
        }
        for vertex in vertices {
            let n = vertex as usize;
            let opposite = triangles.around(n).map(|(rest, corner)| {
                [1, 2].map(|next| uv[rest.corners[(corner + next) % 3] as usize] - uv[n]) // around 0, to keep digits
            });
            let sides: Vec<_> = opposite.collect();
            if let Some(to) = seeing(&sides, is_inside[n], Vector2::zeros()) {
                uv[n] += to;
            }
        }
    }
    Ok(triangles.folded(uv) == 0)
}
