//! Embeddings: from distances between sources to their places in the plane.

pub mod classical;
pub mod sammon;
pub mod stress;
