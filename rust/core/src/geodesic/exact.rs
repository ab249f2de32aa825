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
#[cfg(test)]
mod tests;
mod wave;
mod window;

use super::{Fingerprint, Solver};
use crate::control::Control;
use crate::error::Result;
use crate::surface::mesh::Surface;
use frame::Frames;

pub use wave::Wave;

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

    /// Writes the distances in mm from `source` to every vertex; infinity where it cannot be reached. `wave` then knows the
    /// [paths](Self::path), too.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    ///
    /// # Panics
    /// If `row` has not one value a vertex.
    pub fn distances(&self, source: u32, row: &mut [f64], wave: &mut Wave, control: &Control) -> Result<()> {
        wave.run(self, source, control)?;
        row.copy_from_slice(&wave.distance);
        Ok(())
    }
}

impl Solver for Exact<'_> {
    type Scratch = Wave;

    fn scratch(&self) -> Wave {
        Wave::new(self)
    }

    fn columns(&self) -> usize {
        self.surface.len()
    }

    fn row(&self, source: u32, row: &mut [f32], wave: &mut Wave, control: &Control) -> Result<()> {
        wave.run(self, source, control)?;
        row.iter_mut().zip(&wave.distance).for_each(|(value, &distance)| *value = distance as f32);
        Ok(())
    }

    fn fingerprint(&self, control: &Control) -> Result<u64> {
        control.check()?;
        let mut hash = Fingerprint::default();
        let coordinates = self.surface.points().iter().flat_map(|point| point.iter());
        coordinates.for_each(|coordinate| hash.mix(coordinate.to_bits()));
        self.surface.faces().iter().flatten().for_each(|&vertex| hash.mix(u64::from(vertex)));
        hash.mix(self.reach.mm.to_bits());
        hash.mix(self.reach.rings.map_or(0, |rings| 1 + u64::from(rings)));
        Ok(hash.finish())
    }
}
