//! Neighbourhoods of a number of rings of faces.

use super::frame::{Frames, around};
use crate::surface::mesh::{BORDER, Surface};

/// The faces of an n-ring neighbourhood.
#[derive(Debug, Default)]
pub(super) struct Rings {
    is_limited: bool,
    faces: Vec<bool>,
    listed: Vec<u32>,
}

impl Rings {
    #[inline]
    /// Returns whether the face of a half-edge belongs to it.
    pub fn has(&self, half_edge: u32) -> bool {
        half_edge != BORDER && (!self.is_limited || self.faces[half_edge as usize / 3])
    }

    /// Takes the faces within a number of rings around a source: the first ring touches it, the next one touches the
    /// first, and so on. All faces, if there is no limit.
    pub fn limit(&mut self, surface: &Surface, frames: &Frames, source: u32, rings: Option<u32>) {
        self.listed.drain(..).for_each(|face| self.faces[face as usize] = false);
        self.is_limited = rings.is_some();
        let Some(rings) = rings else { return };
        self.faces.resize(surface.faces().len(), false);
        let mut front = vec![source];
        for _ in 0..rings {
            let mut beyond = Vec::new();
            for vertex in front {
                for half_edge in around(surface, frames.fan(vertex).first) {
                    if !std::mem::replace(&mut self.faces[half_edge as usize / 3], true) {
                        self.listed.push(half_edge / 3);
                        beyond.extend(surface.faces()[half_edge as usize / 3]);
                    }
                }
            }
            front = beyond;
        }
    }
}
