//! **voxflat** flattens curved surfaces, above all the cortex, into the plane while keeping geodesic distances.
//!
//! The way through, one direction; each module is one stage and imports only what stands above it:
//!
//! | module | stage | concept |
//! |---|---|---|
//! | [`scales`] | | which sizes are taken |
//! | [`error`], [`control`] | | what can go wrong; progress and cancelling of long work |
//! | `turns`, `boxes` | | parallel work whose order is kept; boxes in the plane that meet |
//! | [`volume`] | label volume | [`Mask`](volume::Mask), [`Affine`](volume::Affine) |
//! | [`adjacency`] | | [`Links`](adjacency::Links): who is next to whom, and how far; what hangs together |
//! | [`surface`] | volume or mesh → surface | surfels, nodes and their places; triangles; topology, repair, cuts, holes; decimation |
//! | [`sphere`] | closed surface → unit sphere | laid out one to one, and registered to a template |
//! | [`geodesic`] | | chain-code links over voxels, straight links over triangles; shortest paths |
//! | [`patch`] | surface → surface | the part that is flattened |
//! | [`sources`] | surface → sources | farthest-point and random sampling |
//! | [`rows`] | sources → distance rows | many sources in parallel |
//! | [`store`] | | distance rows on disk |
//! | [`distortion`] | flat map → figures | what flattening did to distances and triangles |
//! | [`place`] | places of some → of every point | radial functions, re-insertion, bilinear placement |
//! | [`embed`] | distance rows → places | classical scaling, stress, Sammon's stress |
//! | [`orient`] | | the map's up and its handedness |
//! | [`look_up`] | flat map → surface | the triangle that holds a place, and where in it |
//! | [`nearest`] | space → surface | the nearest place of the surface |
//! | [`ribbon`] | space → surface | the voxels between two surfaces, and whose column each lies in |
//! | [`raster`] | flat map → image | pixels of the map and where they come from |
//! | [`atlas`] | surface → flat patches | certified patches, and how they are glued |
//! | [`flatten`] | | whole methods, composed from the stages |
//!
//! # Examples
//! A label of a half pipe, one voxel thick, to its flat map:
//! ```
//! use voxflat::control::Control;
//! use voxflat::embed::stress::levels::Levels;
//! use voxflat::flatten::voxflat::Options;
//! use voxflat::geodesic::graph::GeodesicGraph;
//! use voxflat::sources::Sources;
//! use voxflat::surface::voxels::voxelmesh::VoxelMesh;
//! use voxflat::volume::{Affine, Mask};
//! use voxflat::{flatten, patch};
//!
//! let control = Control::default();
//! let radius = |j: usize, k: usize| (j as f64 - 11.5).hypot(k as f64);
//! let mask = Mask::from_fn([20, 24, 13], |[_, j, k]| (radius(j, k) - 10.0).abs() < 0.6)?;
//! let mesh = VoxelMesh::of(&mask, &Affine::from_spacing([1.0; 3])?, None, None, &control)?;
//! let surface = patch::largest_piece(&mesh.surface);
//! let graph = GeodesicGraph::new(&surface, &control)?;
//! let sources = Sources::Farthest { count: 50, seed: 0 }.choose(&graph, &control)?;
//! let levels = Levels::new(&surface, &sources, &control)?;
//! let rows = levels.measure(&graph, &control)?;
//! let map = flatten::voxflat(levels, rows, &Options::default(), &graph, 0, &control)?;
//! assert_eq!(map.uv.len(), surface.len());
//! assert!(map.distortion.raw.relative_error < 0.05); // a pipe can be unrolled
//! # Ok::<(), voxflat::Error>(())
//! ```
//!
//! # Conventions
//! A voxel's centre has integer index coordinates `(i, j, k)`; millimetres (RAS+) come from the affine. Distance rows
//! are `f32` millimetres, arithmetic is `f64`. `NaN` means undefined. Results depend on the input and the seed alone,
//! bit by bit, whatever the number of threads: sums over sources are taken in the order of the sources. Whatever takes a
//! [`Control`](control::Control) ends with [`Error::Cancelled`] when that is cancelled (`tests/jobs.rs`); what else can go wrong, the
//! messages of [`Error`] say.

pub mod adjacency;
pub mod atlas;
mod boxes;
pub mod control;
pub mod distortion;
pub mod embed;
pub mod error;
pub mod flatten;
pub mod geodesic;
pub mod look_up;
pub mod nearest;
pub mod orient;
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
mod turns;
pub mod volume;

pub use error::{Error, Result};
