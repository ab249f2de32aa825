//! The flat geometry of a surface's faces, prepared once for all sources.

use crate::surface::mesh::{BORDER, Surface, previous};

/// How much the angle around a vertex must exceed a full turn for shortest paths to bend there, in radians. Below, a
/// bend shortens no path by more than the square of the excess.
const LEAST_EXCESS: f64 = 1e-8;

/// The opposite corner (y > 0) in the plane of a half-edge's face, with the half-edge as the x-axis, in mm.
#[derive(Debug, Clone, Copy)]
pub(super) struct Frame {
    pub length: f64,
    pub x: f64,
    pub y: f64,
    /// The number of the half-edge's edge.
    pub edge: u32,
}

/// The frames of all half-edges and the angles around all vertices.
#[derive(Debug)]
pub(super) struct Frames {
    frames: Vec<Frame>,
    /// The direction of each half-edge around its origin, counterclockwise from the vertex's first half-edge.
    directions: Vec<f64>,
    vertices: Vec<Fan>,
    /// The lower half-edge of each edge.
    edges: Vec<u32>,
    /// The mean and largest length of an edge in mm.
    pub mean: f64,
    pub longest: f64,
}

/// The faces around a vertex.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fan {
    /// The half-edge from which faces are counted counterclockwise; on a boundary, no face lies clockwise of it.
    pub first: u32,
    /// The total angle of the faces in radians.
    pub angle: f64,
    pub is_open: bool,
}

impl Fan {
    pub fn bends(&self) -> bool {
        let straight = if self.is_open { std::f64::consts::PI } else { std::f64::consts::TAU };
        // shortest paths bend at no other vertices (Mitchell, Mount & Papadimitriou 1987)
        self.angle > straight + LEAST_EXCESS
    }
}

impl Frames {
    pub fn new(surface: &Surface) -> Self {
        let mut frames: Vec<Frame> = (0..surface.twins().len() as u32).map(|h| frame(surface, h)).collect();
        let mut edges = Vec::new();
        for half_edge in surface.edges() {
            for side in [half_edge, surface.twins()[half_edge as usize]].into_iter().filter(|&side| side != BORDER) {
                frames[side as usize].edge = edges.len() as u32;
            }
            edges.push(half_edge);
        }
        let mut first = vec![BORDER; surface.len()];
        for half_edge in 0..frames.len() as u32 {
            let known = &mut first[surface.origin(half_edge) as usize];
            // at a boundary, counting begins at the half-edge without a face on its right
            if *known == BORDER || surface.twins()[half_edge as usize] == BORDER {
                *known = half_edge;
            }
        }
        let mut directions = vec![0.0; frames.len()];
        let fan = |first| {
            let mut angle = 0.0;
            for half_edge in around(surface, first) {
                directions[half_edge as usize] = angle;
                angle += frames[half_edge as usize].angle();
            }
            Fan { first, angle, is_open: surface.twins()[first as usize] == BORDER }
        };
        let vertices = first.into_iter().map(fan).collect();
        let lengths = || frames.iter().map(|frame| frame.length);
        let mean = lengths().sum::<f64>() / frames.len().max(1) as f64;
        let longest = lengths().fold(0.0, f64::max);
        Self { frames, directions, vertices, edges, mean, longest }
    }

    #[inline]
    pub fn of(&self, half_edge: u32) -> Frame {
        self.frames[half_edge as usize]
    }

    #[inline]
    pub fn fan(&self, vertex: u32) -> Fan {
        self.vertices[vertex as usize]
    }

    pub fn direction(&self, half_edge: u32) -> f64 {
        self.directions[half_edge as usize]
    }

    /// Returns the lower half-edge of each edge.
    #[inline]
    pub fn edges(&self) -> &[u32] {
        &self.edges
    }
}

impl Frame {
    pub fn angle(&self) -> f64 {
        self.y.atan2(self.x)
    }
}

/// Iterates over the half-edges from the origin of `first`, counterclockwise, until the boundary or all around.
pub(super) fn around(surface: &Surface, first: u32) -> impl Iterator<Item = u32> + '_ {
    std::iter::successors(Some(first), move |&half_edge| {
        let next = surface.twins()[previous(half_edge) as usize];
        (next != BORDER && next != first).then_some(next)
    })
}

fn frame(surface: &Surface, half_edge: u32) -> Frame {
    let place = |v: u32| surface.points()[v as usize];
    let origin = place(surface.origin(half_edge));
    let edge = place(surface.target(half_edge)) - origin;
    let side = place(surface.origin(previous(half_edge))) - origin;
    let length = edge.norm();
    Frame { length, x: edge.dot(&side) / length, y: edge.cross(&side).norm() / length, edge: 0 }
}
