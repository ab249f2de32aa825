//! Placement of all points, given the positions of the sources.

pub mod bilinear;
pub mod radial;
pub mod reinsertion;
