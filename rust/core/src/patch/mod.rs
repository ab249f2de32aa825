//! The part of a surface that is flattened: a real surface is rarely a disk.

mod disk;
mod polygon;
mod voxels;

pub use disk::disk;
pub use polygon::polygon;
pub use voxels::{Disk, Patch, cut_out, geodesic_disk, keep, largest_component};

use crate::surface::Surface;
use crate::surface::mesh::BORDER;
use crate::surface::topology::Topology;

/// The component with the largest area, the first of [`Topology::components`]; the whole surface if it has but one.
pub fn largest_piece(surface: &Surface) -> Surface {
    let (labels, _) = surface.components();
    let largest = Topology::of(surface).components.first().map_or(0, |component| component.label);
    surface.part(&labels.iter().map(|&label| label == largest).collect::<Vec<_>>())
}

/// Stands for the piece of a face that belongs to none.
const NONE: u32 = u32::MAX;

struct Pieces {
    labels: Vec<u32>,
    count: usize,
}

/// The connected pieces of the faces that a rule allows.
fn pieces(surface: &Surface, allowed: impl Fn(usize) -> bool) -> Pieces {
    let mut labels = vec![NONE; surface.faces().len()];
    let mut count = 0;
    let mut stack = Vec::new();
    for start in 0..labels.len() {
        if labels[start] != NONE || !allowed(start) {
            continue;
        }
        labels[start] = count;
        stack.push(start);
        while let Some(face) = stack.pop() {
            for &twin in &surface.twins()[3 * face..3 * face + 3] {
                let next = twin as usize / 3;
                if twin != BORDER && labels[next] == NONE && allowed(next) {
                    labels[next] = count;
                    stack.push(next);
                }
            }
        }
        count += 1;
    }
    Pieces { labels, count: count as usize }
}
