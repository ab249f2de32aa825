//! The part of a surface that is flattened: a real surface is rarely a disk.

mod disk;
mod polygon;
mod voxels;

pub use disk::disk;
pub use polygon::polygon;
pub use voxels::{Disk, Selection, cut_out, geodesic_disk, keep, largest_component};

use crate::surface::Surface;
use crate::surface::topology::Topology;

/// The component with the largest area, the first of [`Topology::components`]; the whole surface if it has but one.
///
/// # Examples
/// ```
/// use voxflat::patch::largest_piece;
/// use voxflat::surface::mesh::shapes;
///
/// let sheet = shapes::surface(shapes::sheet(8, 8)); // 8 by 8 squares of 1 mm, in the plane z = 0
/// let is_kept: Vec<bool> = sheet.faces().iter().map(|face| !face.iter().any(|&v| v / 9 == 3)).collect();
/// let two = sheet.part(&is_kept); // without the squares along a line
/// assert_eq!(two.components().count(), 2);
/// assert_eq!(largest_piece(&two).faces().len(), 2 * 4 * 8);
/// ```
pub fn largest_piece(surface: &Surface) -> Surface {
    let largest = Topology::of(surface).components.first().map_or(0, |component| component.label);
    let is_in_largest = surface.components().labels.iter().map(|&label| label == largest).collect::<Vec<_>>();
    surface.part(&is_in_largest)
}
