//! The range of lengths that is supported. Squares, volumes and inverses of lengths within it remain finite, also in 32
//! bits, and size alone never reaches a tolerance.

/// The largest absolute coordinate of a point along an axis, in mm: a hundred thousand km.
pub const FARTHEST: f64 = 1e11;

/// The smallest size of a voxel, and of the longest side of a surface's box, in mm: a thousandth of a nanometre.
pub const SMALLEST: f64 = 1e-9;

/// The shortest edge of a mesh whose bounding box is scaled to 1. Fans with edges down to 1e-10 were mapped without
/// flipped triangles; below, rounding decides the orientation of the smallest triangles.
pub(crate) const SHORTEST_EDGE: f64 = 1e-10;

/// Returns whether a coordinate is finite and no farther away than [`FARTHEST`].
pub(crate) fn is_near(coordinate: f64) -> bool {
    coordinate.abs() <= FARTHEST
}
