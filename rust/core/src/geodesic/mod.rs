//! Geodesic distances: link lengths, shortest paths, and the one trait of all solvers.
//!
//! | module | concept |
//! |---|---|
//! | [`shortest`] | shortest paths in a graph, one source after the other |
//! | [`bundle`] | the same for sources that lie near each other, at once |
//! | [`solver`] | the trait [`Solver`], which every graph has |
//! | [`chain`] | lengths of the chain-code links of a graph of voxels |
//! | [`graph`] | straight links over unfolded triangles |
//! | [`path`] | paths across triangles |
//! | [`marching`] | fast marching over triangles |
//! | [`exact`] | exact distances over triangles |
//! | [`neighbourhood`] | exact distances within so many rings |

pub mod bundle;
pub mod chain;
pub mod exact;
pub mod graph;
pub mod marching;
pub mod neighbourhood;
pub mod path;
pub mod shortest;
pub mod solver;

pub use solver::Solver;
