//! Paths over a surface, as the solvers trace them: points at vertices and on edges, straight within triangles in between.

use nalgebra::Vector3;

use crate::surface::mesh::Surface;

/// A point of a path on a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PathPoint {
    /// Where in space it lies, mm.
    pub point: Vector3<f64>,
    /// Where on the surface it lies.
    pub site: Site,
}

/// Where on a surface a point of a path lies.
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
    /// The point at a site.
    pub fn at(surface: &Surface, site: Site) -> Self {
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

/// The length of a path, mm: of its straight segments together.
pub fn length(path: &[PathPoint]) -> f64 {
    path.windows(2).map(|two| (two[0].point - two[1].point).norm()).sum()
}
