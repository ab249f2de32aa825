//! Surfaces: the triangles that all stages use, and their extraction from a label volume.
//!
//! | module | contents |
//! |---|---|
//! | [`mesh`] | the [`Surface`] itself, its assembly from triangles, paths along its edges, curvature |
//! | [`topology`] | components, handles and the loops around them, boundary loops; thin parts |
//! | [`cuts`] | cuts along paths, or until a disk is left; filling of small holes |
//! | [`decimate`] | decimation to a subset of the vertices |
//! | [`sulcal_depth`](mod@sulcal_depth) | the depth of each vertex within a fold |
//! | [`voxels`] | surfaces of volumes: surface voxels and their graph; repair; surfels, nodes and their positions |

pub mod cuts;
pub mod decimate;
pub mod mesh;
pub mod sulcal_depth;
pub mod topology;
pub mod voxels;

pub use mesh::Surface;
pub use voxels::VoxelSurface;
