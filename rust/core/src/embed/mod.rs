//! Embeddings: from distances between sources to their places in the plane.

pub mod classical;
pub mod sammon;
pub mod stress;

/// A place in the plane, mm.
pub(crate) type Place = nalgebra::Vector2<f64>;
