//! **voxflat** flattens curved surfaces, such as the cerebral cortex, while preserving geodesic distances.
//!
//! The modules are listed in processing order. Each one is a stage, and imports only modules listed above it:
//!
//! | module | stage | contents |
//! |---|---|---|
//! | [`scales`] | | the range of lengths that is supported |
//! | [`error`], [`control`] | | errors; progress and cancellation of long computations |
//! | [`dense`] | | dense linear systems |
//! | `parallel`, `boxes` | | parallel work in a fixed order; overlapping boxes in the plane |
//! | [`volume`] | label volume | [`Mask`](volume::Mask), [`Affine`](volume::Affine) |
//! | [`adjacency`] | | [`Links`](adjacency::Links): neighbours and the distances to them; connected components |
//! | [`surface`] | volume or mesh → surface | surfels, nodes and their positions; triangles; topology, repair, cuts, holes; decimation |
//! | [`sphere`] | closed surface → unit sphere | spherical maps, and their registration to a template |
//! | [`geodesic`] | | chain-code links over voxels, straight links over triangles; shortest paths |
//! | [`patch`] | surface → surface | the part that is flattened |
//! | [`sources`] | surface → sources | farthest-point and random sampling |
//! | [`rows`] | sources → distance rows | many sources in parallel |
//! | [`groups`] | | distances between groups of vertices, such as parcels |
//! | [`store`] | | distance rows on disk |
//! | [`distortion`] | flat map → figures | errors of distances, and distortion of triangles |
//! | [`place`] | positions of some points → of all points | radial functions, re-insertion, bilinear placement |
//! | [`embed`] | distance rows → positions | classical scaling, stress, Sammon's stress |
//! | [`orient`] | | the map's up direction and its handedness |
//! | [`lookup`] | flat map → surface | the triangle at a position of the map |
//! | [`nearest`] | space → surface | the nearest point on the surface |
//! | [`ribbon`] | space → surface | the voxels between two surfaces, and the triangle below each of them |
//! | [`columns`] | | columns of voxels, each of which is connected |
//! | [`ways`] | | straight ways through a label volume |
//! | [`raster`] | flat map → image | pixels of the map, and their positions on the surface |
//! | [`atlas`] | surface → flat patches | certified patches, and how they are glued |
//! | [`flatten`] | | complete methods, composed of the stages |
//!
//! # Examples
//! From voxels to a map (`examples/voxels_to_map.rs`):
//! ```
#![doc = include_str!("../examples/voxels_to_map.rs")]
//! ```
//! From a mesh to distances (`examples/mesh_to_distances.rs`):
//! ```
#![doc = include_str!("../examples/mesh_to_distances.rs")]
//! ```
//! Patches with a bound on their distortion (`examples/patches.rs`):
//! ```
#![doc = include_str!("../examples/patches.rs")]
//! ```
//!
//! # Conventions
//! The centre of a voxel has integer index coordinates `(i, j, k)`. The affine maps them to millimetres (RAS+).
//! Distance rows are `f32` millimetres; arithmetic is `f64`. `NaN` means undefined. Results depend only on the input
//! and the seed. They are bit-identical for any number of threads, because sums over sources are taken in the order of
//! the sources. Every function that takes a [`Control`] returns [`Error::Cancelled`] after it is
//! cancelled (`tests/jobs.rs`). The messages of [`Error`] explain the other errors.

pub mod adjacency;
pub mod atlas;
mod boxes;
pub mod columns;
pub mod control;
pub mod dense;
pub mod distortion;
pub mod embed;
pub mod error;
pub mod flatten;
pub mod geodesic;
pub mod groups;
pub mod lookup;
pub mod nearest;
pub mod orient;
mod parallel;
pub mod patch;
pub mod place;
pub mod raster;
pub mod ribbon;
pub mod rows;
pub mod scales;
pub mod sources;
pub mod sphere;
pub mod store;
pub mod surface;
#[cfg(test)]
mod tests;
pub mod volume;
pub mod ways;

/// Points, normals and directions are vectors of this version of nalgebra.
pub use nalgebra;

pub use control::Control;
pub use error::{Error, Result};
