//! Exact geodesic distances on a polyhedral surface.
//!
//! Mitchell, Mount and Papadimitriou (1987): all shortest paths that run straight through the same faces make a window on the
//! edge where they arrive, and windows go on from face to face like light, the nearest first. Each edge keeps only windows that
//! are nearest somewhere on it. A vertex with more than a full turn of faces around it, or on the boundary, hides what lies
//! behind it: paths bend there, and windows start anew.
//!
//! What keeps the windows few: what is no nearer than by way of an edge's ends is left out before it gets there (Xin and Wang
//! 2009, here for parts of a window, too), and windows wait in buckets, so that most are trimmed before it is their turn (Xu et
//! al. 2015). Every distance is the length of a real path; rounding can only add to it.

mod envelope;
mod frame;
mod path;
mod rings;
mod solver;
#[cfg(test)]
mod tests;
mod wave;
mod window;

use crate::surface::mesh::Surface;
use frame::Frames;

/// How far distances are wanted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reach {
    /// No farther than this, mm.
    pub mm: f64,
    /// Only over the faces within so many rings around the source, of which the first are those that touch it.
    pub rings: Option<u32>,
}

impl Default for Reach {
    /// Everywhere.
    fn default() -> Self {
        Self { mm: f64::INFINITY, rings: None }
    }
}

/// Exact distances and shortest paths on a surface.
#[derive(Debug)]
pub struct Exact<'a> {
    surface: &'a Surface,
    frames: Frames,
    reach: Reach,
}

impl<'a> Exact<'a> {
    /// A solver for a surface.
    pub fn new(surface: &'a Surface) -> Self {
        Self { surface, frames: Frames::new(surface), reach: Reach::default() }
    }

    /// The same for distances within reach only; everything else is infinitely far.
    #[must_use]
    pub fn within(self, reach: Reach) -> Self {
        Self { reach, ..self }
    }
}
