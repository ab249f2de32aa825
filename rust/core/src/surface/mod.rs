//! Surfaces: the triangles that everything works on, and how a label volume becomes such.
//!
//! | module | concept |
//! |---|---|
//! | [`mesh`] | the [`Surface`] itself, loose triangles joined to one, paths along its edges, curvature |
//! | [`topology`] | components, handles and the loops around them, boundary loops; thin places |
//! | [`cuts`] | along paths, or until a disk is left; small holes closed |
//! | [`decimate`] | fewer vertices, each of them one of the surface's own |
//! | [`sulcal_depth`](mod@sulcal_depth) | how deep a place lies in a fold |
//! | [`voxels`] | surface voxels and their graph; repair; surfels, nodes and their places: a volume's surface |

pub mod cuts;
pub mod decimate;
pub mod mesh;
pub mod sulcal_depth;
pub mod topology;
pub mod voxels;

pub use mesh::Surface;
pub use voxels::VoxelSurface;
