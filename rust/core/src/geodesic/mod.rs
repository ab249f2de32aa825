//! Geodesic distances: link lengths, shortest paths, and the common trait of all solvers.
//!
//! | module | contents |
//! |---|---|
//! | [`shortest`] | shortest paths in a graph, one source after the other |
//! | [`bundle`] | shortest paths from nearby sources, computed together |
//! | [`solver`] | the trait [`Solver`], which every graph implements |
//! | [`chain`] | lengths of the chain-code links of a graph of voxels |
//! | [`graph`] | straight links over unfolded triangles |
//! | [`bend`] | paths that bend around the boundary |
//! | [`path`] | paths across triangles |
//! | [`marching`] | fast marching over triangles |
//! | [`exact`] | exact distances over triangles |
//! | [`neighbourhood`] | exact distances within a number of rings |

pub mod bend;
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
