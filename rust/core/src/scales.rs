//! Which sizes are taken. What is computed of lengths between these, their squares, volumes and inverses, stays a number, in 32 bits
//! too, and no tolerance is reached by size alone.

/// No point lies farther from the origin along an axis, mm: a hundred thousand km.
pub const FARTHEST: f64 = 1e11;

/// Nothing is smaller, mm: neither the longest side of a surface's box nor a voxel. It is a thousandth of a nanometre.
pub const SMALLEST: f64 = 1e-9;

/// The shortest edge of a mesh whose box is scaled to 1. Fans of edges down to 1e-10 were mapped with no triangle turned over; below,
/// rounding decides which way the smallest ones face.
pub const SHORTEST_EDGE: f64 = 1e-10;

/// Is a coordinate no farther than [`FARTHEST`]? What is not finite is not.
pub(crate) fn is_near(coordinate: f64) -> bool {
    coordinate.abs() <= FARTHEST
}
