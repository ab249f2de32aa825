//! Cone points: single vertices that hold nearly all of the curvature, such as the apex of a cone or the corners of a cube.
//!
//! A surface that is cut open at its cone points can be flattened without distortion, if it has no other curvature.

use std::f64::consts::TAU;

use crate::surface::mesh::Surface;

/// The minimum curvature of a cone point: by how much the angles around it differ from a full turn.
const LEAST: f64 = 0.1;

/// The maximum number of cone points.
const MOST: usize = 32;

/// The minimum share of the total absolute curvature that cone points hold.
const SHARE: f64 = 0.95;

/// Returns the vertices inside a surface that hold nearly all of its curvature, in ascending order; none if they are many.
pub fn cone_points(surface: &Surface) -> Vec<u32> {
    let mut curvature = vec![TAU; surface.len()];
    for face in surface.faces() {
        let corners = face.map(|vertex| surface.points()[vertex as usize]);
        for (k, &vertex) in face.iter().enumerate() {
            let [onwards, back] = [1, 2].map(|step| corners[(k + step) % 3] - corners[k]);
            curvature[vertex as usize] -= onwards.angle(&back);
        }
    }
    for half_edge in (0..surface.twins().len() as u32).filter(|&h| !surface.is_inner(h)) {
        curvature[surface.origin(half_edge) as usize] = 0.0;
    }
    let total: f64 = curvature.iter().map(|k| k.abs()).sum();
    let points: Vec<u32> = (0..surface.len() as u32).filter(|&v| curvature[v as usize].abs() >= LEAST).collect();
    let of_points: f64 = points.iter().map(|&v| curvature[v as usize].abs()).sum();
    if points.len() <= MOST && of_points >= SHARE * total { points } else { Vec::new() }
}
