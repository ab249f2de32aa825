//! Exact geodesic distances on a polyhedral surface.
//!
//! Mitchell, Mount and Papadimitriou (1987): all shortest paths that run straight through the same faces form a window
//! on the edge where they arrive. Windows propagate from face to face like light, the nearest first. Each edge keeps
//! only windows that are nearest somewhere on it. A vertex with more than a full turn of faces around it, or on the
//! boundary, hides what lies behind it: paths bend there, and new windows start.
//!
//! Two measures keep windows few. Parts that are not shorter than a path through an edge's ends are dropped before they
//! get there (Xin and Wang 2009, applied here to parts of windows too), and windows wait in buckets, so that most are
//! trimmed before they are processed (Xu et al. 2015). Distances are lengths of real paths; rounding only adds to them.

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
pub use wave::Wave;

/// The range of distances to compute.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Reach {
    /// The maximum distance in mm.
    pub mm: f64,
    /// The number of rings of faces around the source that paths may use; faces that touch it are the first ring.
    pub rings: Option<u32>,
}

impl Default for Reach {
    fn default() -> Self {
        Self { mm: f64::INFINITY, rings: None }
    }
}

/// A solver of exact distances and shortest paths on a surface.
#[derive(Debug)]
pub struct Exact<'a> {
    surface: &'a Surface,
    frames: Frames,
    reach: Reach,
}

impl<'a> Exact<'a> {
    /// Creates a solver for a surface.
    pub fn new(surface: &'a Surface) -> Self {
        Self { surface, frames: Frames::new(surface), reach: Reach::default() }
    }

    /// Limits the solver to distances within reach; all others are infinite.
    #[must_use]
    pub(crate) fn within(self, reach: Reach) -> Self {
        Self { reach, ..self }
    }
}
