//! Surfaces: the triangles that everything works on, and the surface voxels of the paper's own graph.

pub mod cubes;
pub mod curvature;
pub mod cuts;
pub mod decimate;
pub mod holes;
mod homology;
pub(crate) mod inward;
pub mod level;
pub mod loops;
pub mod mesh;
pub mod nodes;
pub(crate) mod paths;
pub mod positions;
pub mod repair;
pub mod sheets;
pub mod surfels;
pub mod thin;
pub mod topology;
pub mod triangles;
pub mod voxelmesh;
pub mod voxels;

pub use mesh::Surface;
pub use voxels::VoxelSurface;
