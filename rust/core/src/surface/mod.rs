//! Surfaces: today the surface voxels of a label volume.

pub mod topology;
pub mod voxels;

pub use voxels::VoxelSurface;
