//! Location of positions on the sphere in a triangulation of it.

use nalgebra::Vector3;

use super::map::{check_closed, determinant};
use crate::Result;
use crate::surface::Surface;

/// The maximum number of cells along the side of a cube's face.
const MOST_CELLS: usize = 256;

/// A triangulation of the sphere, prepared for finding the triangle at a position.
///
/// A search starts at a nearby triangle, given by a cell of the cube around the sphere, and walks across the sides that
/// the position lies beyond. Takes O(1) time per position if triangles are even.
#[derive(Debug, Clone)]
pub struct Locator<'a> {
    points: &'a [Vector3<f64>],
    faces: &'a [[u32; 3]],
    twins: &'a [u32],
    cells: Vec<u32>,
    side: usize,
}

/// A position: a triangle, and the weights of its corners, whose sum is one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Located {
    /// The triangle.
    pub face: u32,
    /// The weights of its corners.
    pub weights: [f64; 3],
}

impl Located {
    /// Returns values at the vertices, interpolated at the position.
    pub(crate) fn value(&self, faces: &[[u32; 3]], values: &[f64]) -> f64 {
        let face = faces[self.face as usize];
        (0..3).map(|k| self.weights[k] * values[face[k] as usize]).sum()
    }

    /// Returns vectors at the vertices, interpolated at the position.
    pub(crate) fn vector(&self, faces: &[[u32; 3]], vectors: &[Vector3<f64>]) -> Vector3<f64> {
        let face = faces[self.face as usize];
        (0..3).map(|k| vectors[face[k] as usize] * self.weights[k]).sum()
    }
}

impl<'a> Locator<'a> {
    /// Creates a locator from a triangulation whose triangles run counterclockwise as seen from outside and cover the
    /// sphere once.
    ///
    /// # Errors
    /// [`Error::NotASphere`](crate::Error::NotASphere) if it is not closed, not connected, or has handles.
    pub fn new(sphere: &'a Surface) -> Result<Self> {
        check_closed(sphere)?;
        Ok(Self::over(sphere))
    }

    pub(crate) fn over(sphere: &'a Surface) -> Self {
        let (points, faces, twins) = (sphere.points(), sphere.faces(), sphere.twins());
        // about half as many cells on the six sides of the cube as triangles
        let side = ((faces.len() as f64 / 12.0).sqrt().ceil() as usize).clamp(1, MOST_CELLS);
        let mut found = Self { points, faces, twins, cells: Vec::new(), side };
        let mut from = 0;
        let mut cells = Vec::with_capacity(6 * side * side);
        for n in 0..6 * side * side {
            let (face, row, column) = (n / (side * side), n / side % side, n % side);
            let column = if row % 2 == 0 { column } else { side - 1 - column }; // short walks
            from = found.walk(&centre_of_cell(face, row, column, side), from).face;
            cells.push((face * side * side + row * side + column, from));
        }
        found.cells = vec![0; cells.len()];
        cells.into_iter().for_each(|(cell, face)| found.cells[cell] = face);
        found
    }

    /// Returns the triangle that contains a position.
    pub fn locate(&self, place: &Vector3<f64>) -> Located {
        self.walk(place, self.cells[cell_of(place, self.side)])
    }

    /// Returns the triangle that contains a position, starting from a known triangle near it.
    pub(crate) fn walk(&self, place: &Vector3<f64>, from: u32) -> Located {
        let mut face = from;
        for step in 0..4 * self.faces.len() {
            let [a, b, c] = self.faces[face as usize].map(|v| self.points[v as usize]);
            let sides = [(a, b), (b, c), (c, a)].map(|(p, q)| determinant([*place, p, q]));
            // the side that it lies farthest beyond; sides alternate, so that a walk cannot cycle forever
            let beyond = (0..3)
                .map(|k| (k + step) % 3)
                .filter(|&k| sides[k] < 0.0)
                .min_by(|&k, &l| if step < 64 { sides[k].total_cmp(&sides[l]) } else { std::cmp::Ordering::Equal });
            let Some(k) = beyond else {
                return Located { face, weights: weights(sides) };
            };
            face = self.twins[3 * face as usize + k] / 3;
        }
        self.nearest(place)
    }

    /// Returns the triangle that a position is closest to, among all: for walks that rounding prevents from ending.
    fn nearest(&self, place: &Vector3<f64>) -> Located {
        let sides_of = |face: usize| {
            let [a, b, c] = self.faces[face].map(|v| self.points[v as usize]);
            [(a, b), (b, c), (c, a)].map(|(p, q)| determinant([*place, p, q]))
        };
        let is_near = |&f: &usize| self.points[self.faces[f][0] as usize].dot(place) > 0.0;
        let least = |face: usize| sides_of(face).into_iter().fold(f64::INFINITY, f64::min);
        let face = (0..self.faces.len()).filter(is_near).max_by(|&f, &g| least(f).total_cmp(&least(g))).unwrap_or(0);
        Located { face: face as u32, weights: weights(sides_of(face).map(|side| side.max(0.0))) }
    }
}

/// Returns the weights of the corners, given the determinants across the sides that begin at them.
fn weights(sides: [f64; 3]) -> [f64; 3] {
    let total: f64 = sides.iter().sum();
    if total > 0.0 { [1, 2, 0].map(|k| sides[k] / total) } else { [1.0 / 3.0; 3] }
}

/// Returns the cell of a cube's face, by its axis and the sign along it.
fn cell_of(place: &Vector3<f64>, side: usize) -> usize {
    let axis = place.iamax();
    let (major, u, v) = (place[axis].abs().max(f64::MIN_POSITIVE), place[(axis + 1) % 3], place[(axis + 2) % 3]);
    let face = 2 * axis + usize::from(place[axis] < 0.0);
    // gnomonic coordinates from −1 to 1 on the cube's face
    let index = |x: f64| (((x / major + 1.0) / 2.0 * side as f64) as usize).min(side - 1);
    face * side * side + index(u) * side + index(v)
}

fn centre_of_cell(face: usize, row: usize, column: usize, side: usize) -> Vector3<f64> {
    let of = |n: usize| (2.0 * n as f64 + 1.0) / side as f64 - 1.0;
    let mut place = Vector3::zeros();
    place[face / 2] = if face.is_multiple_of(2) { 1.0 } else { -1.0 };
    place[(face / 2 + 1) % 3] = of(row);
    place[(face / 2 + 2) % 3] = of(column);
    place.normalize()
}
