//! What unit tests of several modules begin with.

use crate::control::Control;
use crate::geodesic::chain::{LinkLengths, chain_graph};
use crate::surface::VoxelSurface;
use crate::surface::voxels::graph::VoxelGraph;
use crate::volume::{Affine, Mask};

/// The surface voxels of a mask whose voxels have some spacing, mm.
pub(crate) fn voxels(mask: &Mask, spacing: [f64; 3]) -> VoxelSurface {
    VoxelSurface::from_mask(mask, Affine::from_spacing(spacing).unwrap(), &Control::default()).unwrap()
}

/// The same with their chain code.
pub(crate) fn chained(mask: &Mask, spacing: [f64; 3]) -> (VoxelSurface, VoxelGraph) {
    let surface = voxels(mask, spacing);
    let graph = chain_graph(&surface, LinkLengths::ChainCode, &Control::default()).unwrap();
    (surface, graph)
}

pub(crate) fn with_threads<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(work)
}
