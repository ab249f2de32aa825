//! One-to-one projection onto planes.

use std::collections::VecDeque;

use nalgebra::Vector3;
use robust::Coord;

use super::facets::Facets;
use super::growth::Region;
use crate::boxes::{Bounds, Tree};
use crate::distortion::overlap::{counterclockwise, interiors_meet};
use crate::{Control, Result};

/// A plane, seen from the side to which its normal points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plane {
    /// The point of the plane that is mapped to (0, 0), in mm.
    pub origin: Vector3<f64>,
    /// The unit normal.
    pub normal: Vector3<f64>,
    /// Orthogonal unit vectors: the directions of u and v.
    pub axes: [Vector3<f64>; 2],
}

impl Plane {
    /// Creates a plane with superior up (anterior if the plane is level).
    pub(super) fn new(origin: Vector3<f64>, normal: Vector3<f64>) -> Self {
        let up = if normal.z.abs() < 0.9 { Vector3::z() } else { Vector3::y() };
        let right = up.cross(&normal).normalize();
        Self { origin, normal, axes: [right, normal.cross(&right)] }
    }

    /// Returns the projection of a point in mm.
    pub fn project(&self, point: &Vector3<f64>) -> [f64; 2] {
        self.axes.map(|axis| axis.dot(&(point - self.origin)))
    }
}

/// Facets, and the plane onto which they are projected.
pub(super) type Projected = (Plane, Vec<u32>);

/// Projects a region. Facets that would overlap others become separate patches.
pub(super) fn project(facets: &Facets<'_>, region: Region, control: &Control) -> Result<Vec<Projected>> {
    let mut patches = Vec::new();
    let mut left = region.facets;
    while !left.is_empty() {
        let start = facets.facing(&left, &region.normal);
        let mut plane = Plane::new(facets.corners(start)[0], region.normal);
        let mut taken = injective(facets, &left, start, &plane, control)?;
        if taken.is_empty() {
            // so thin that rounding flipped it
            plane = Plane::new(plane.origin, facets.normals[start as usize]);
            taken.push(start);
        }
        if taken.len() == left.len() {
            left.clear();
        } else {
            taken.sort_unstable();
            left.retain(|facet| taken.binary_search(facet).is_err());
        }
        patches.push((plane, taken));
    }
    Ok(patches)
}

/// Returns the facets of a region, from a start outwards, whose projections do not overlap.
fn injective(facets: &Facets<'_>, region: &[u32], start: u32, plane: &Plane, control: &Control) -> Result<Vec<u32>> {
    let mut sorted = region.to_vec();
    sorted.sort_unstable();
    let local = |facet: u32| sorted.binary_search(&facet).ok();
    let projected = |p: Vector3<f64>| {
        let [x, y] = plane.project(&p);
        Coord { x, y }
    };
    let flat: Vec<[Coord<f64>; 3]> = sorted.iter().map(|&facet| facets.corners(facet).map(projected)).collect();
    let tree = Tree::over(flat.iter().map(|corners| Bounds::around(corners)).collect());
    let mut position = vec![0; flat.len()];
    tree.order.iter().enumerate().for_each(|(at, &n)| position[n as usize] = at);
    let mut accepted = vec![false; flat.len()];
    let mut seen = vec![false; flat.len()];
    let mut taken = Vec::new();
    let mut queue: VecDeque<usize> = local(start).into_iter().collect();
    queue.iter().for_each(|&n| seen[n] = true);
    while let Some(n) = queue.pop_front() {
        control.check()?;
        // rounding can flip a thin triangle
        let is_upright = counterclockwise(flat[n]).is_some_and(|turned| turned == flat[n]);
        let mut meets = |other: u32| accepted[other as usize] && interiors_meet(&flat[n], &flat[other as usize]);
        if !is_upright || tree.any_other(position[n], &mut meets) {
            continue;
        }
        accepted[n] = true;
        taken.push(sorted[n]);
        for next in facets.across[sorted[n] as usize].into_iter().filter_map(local) {
            if !std::mem::replace(&mut seen[next], true) {
                queue.push_back(next);
            }
        }
    }
    Ok(taken)
}
