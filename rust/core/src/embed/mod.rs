//! Embeddings: from distances between sources to positions in the plane.

pub mod classical;
pub mod sammon;
pub mod stress;

/// A position in the plane in mm.
pub(crate) type Place = nalgebra::Vector2<f64>;
