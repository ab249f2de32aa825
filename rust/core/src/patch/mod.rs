//! The part of a surface that is flattened: a real surface is rarely a disk.

mod disk;
mod polygon;
mod voxels;

pub use disk::disk;
pub use polygon::polygon;
pub use voxels::{Disk, Selection, cut_out};

use crate::surface::{Surface, topology::Topology};

/// Returns the largest component, the first of [`Topology::components`].
pub fn largest_piece(surface: &Surface) -> Surface {
    let largest = Topology::of(surface).components.first().map_or(0, |component| component.label);
    let is_in_largest = surface.components().labels.iter().map(|&label| label == largest).collect::<Vec<_>>();
    surface.part(&is_in_largest)
}
