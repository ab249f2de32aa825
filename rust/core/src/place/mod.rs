//! From the places of the sources to the places of all points.

pub mod bilinear;
pub mod radial;
pub mod reinsertion;
