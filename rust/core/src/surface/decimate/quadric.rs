//! Quadric errors (Garland, Heckbert 1997): the squared distances of a position from the planes of faces.

use nalgebra::{Matrix3, Vector3};

use crate::surface::mesh::{BORDER, Surface};

/// The weight of planes perpendicular to the faces along the boundary, per squared length of an edge.
const STANDING: f64 = 2.0;

/// Σ weight · (distance from a plane)², in mm⁴ for weights that are areas.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Quadric {
    a: Matrix3<f64>,
    b: Vector3<f64>,
    c: f64,
}

impl Quadric {
    /// Creates the quadric of a plane from its unit normal and a point on it.
    fn plane(normal: Vector3<f64>, point: Vector3<f64>, weight: f64) -> Self {
        let offset = -normal.dot(&point);
        // (n·p + offset)² = pᵀ n nᵀ p + 2 offset n·p + offset²
        Self { a: normal * normal.transpose() * weight, b: normal * (offset * weight), c: offset * offset * weight }
    }

    pub(super) fn add(&mut self, other: &Self) {
        self.a += other.a;
        self.b += other.b;
        self.c += other.c;
    }

    /// Returns the error of a position; rounding never makes it negative.
    pub(super) fn at(&self, p: Vector3<f64>) -> f64 {
        ((self.a * p).dot(&p) + 2.0 * self.b.dot(&p) + self.c).max(0.0)
    }
}

/// Returns the quadric of each vertex: a third of each face around it. Along the boundary, planes perpendicular to the
/// faces are added, which keep the boundary in place.
pub(super) fn of_vertices(surface: &Surface, points: &[Vector3<f64>]) -> Vec<Quadric> {
    let mut quadrics = vec![Quadric::default(); points.len()];
    for (f, face) in (0u32..).zip(surface.faces()) {
        let [a, b, c] = face.map(|v| points[v as usize]);
        let double = (b - a).cross(&(c - a));
        let Some(normal) = double.try_normalize(0.0) else { continue };
        let plane = Quadric::plane(normal, a, double.norm() / 6.0);
        face.iter().for_each(|&v| quadrics[v as usize].add(&plane));
        for half_edge in (3 * f..3 * f + 3).filter(|&h| surface.twins()[h as usize] == BORDER) {
            let [from, to] = [surface.origin(half_edge), surface.target(half_edge)];
            let side = points[to as usize] - points[from as usize];
            let Some(away) = side.cross(&normal).try_normalize(0.0) else { continue };
            let standing = Quadric::plane(away, points[from as usize], STANDING * side.norm_squared());
            [from, to].iter().for_each(|&v| quadrics[v as usize].add(&standing));
        }
    }
    quadrics
}
