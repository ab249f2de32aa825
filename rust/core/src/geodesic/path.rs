//! Paths over a surface, as traced by the solvers: points at vertices and on edges, joined by lines within triangles.

use nalgebra::Vector3;

use crate::surface::mesh::Surface;

/// A point of a path on a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PathPoint {
    /// Its position in space in mm.
    pub point: Vector3<f64>,
    /// Its location on the surface.
    pub site: Site,
}

/// The location of a point of a path on a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Site {
    /// At a vertex.
    Vertex(u32),
    /// On an edge between its ends.
    Edge {
        /// One of the edge's half-edges.
        half_edge: u32,
        /// From 0 at the half-edge's origin to 1 at its target.
        along: f64,
    },
}

impl PathPoint {
    /// Returns the point at a site.
    pub(crate) fn at(surface: &Surface, site: Site) -> Self {
        let place = |v: u32| surface.points()[v as usize];
        let point = match site {
            Site::Vertex(vertex) => place(vertex),
            Site::Edge { half_edge, along } => {
                let [a, b] = [surface.origin(half_edge), surface.target(half_edge)].map(place);
                a + (b - a) * along
            }
        };
        Self { point, site }
    }
}

/// Returns the length of a path in mm, the sum over its straight segments.
pub fn length(path: &[PathPoint]) -> f64 {
    path.windows(2).map(|two| (two[0].point - two[1].point).norm()).sum()
}

#[cfg(test)]
pub(super) mod checks {
    use super::*;
    use crate::surface::mesh::{BORDER, shapes};

    /// Returns a grid with reproducibly random hills.
    pub(crate) fn bumpy(m: usize, n: usize, seed: u64) -> Surface {
        use rand::{Rng, SeedableRng};
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let (points, faces) = shapes::sheet(m, n);
        let mut shake = |p: [f64; 3]| {
            [
                p[0] + random.random_range(-0.3..0.3),
                p[1] + random.random_range(-0.3..0.3),
                random.random_range(-0.8..0.8),
            ]
        };
        shapes::surface((points.into_iter().map(&mut shake).collect(), faces))
    }

    fn faces_of(surface: &Surface, site: Site) -> Vec<u32> {
        match site {
            Site::Vertex(v) => {
                (0..surface.faces().len() as u32).filter(|&f| surface.faces()[f as usize].contains(&v)).collect()
            }
            Site::Edge { half_edge, .. } => {
                let sides = [half_edge, surface.twins()[half_edge as usize]].into_iter();
                sides.filter(|&h| h != BORDER).map(|h| h / 3).collect()
            }
        }
    }

    /// Asserts that each point is at its site, and that each segment lies within a face.
    pub(crate) fn assert_on_surface(surface: &Surface, path: &[PathPoint]) {
        for passed in path {
            assert_eq!(*passed, PathPoint::at(surface, passed.site));
            assert!(!matches!(passed.site, Site::Edge { along, .. } if !(0.0..=1.0).contains(&along)), "{passed:?}");
        }
        for two in path.windows(2) {
            let [here, there] = [two[0].site, two[1].site].map(|site| faces_of(surface, site));
            assert!(here.iter().any(|face| there.contains(face)), "{two:?}");
        }
    }
}
