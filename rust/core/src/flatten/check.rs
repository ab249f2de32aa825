//! Checks whether a surface can be flattened as it is.

use crate::sources::FEWEST_SOURCES;
use crate::surface::{Surface, VoxelSurface, voxels::cubes::CubeTopology};
use crate::{Control, Error, Result};

/// Checks that a surface is a disk.
///
/// # Errors
/// [`Error::NotADisk`] with the counts that differ from those of a disk.
pub fn check_disk(surface: &Surface) -> Result<()> {
    check(surface, |_, euler| euler == 1)
}

/// Checks that a surface can be a planar domain: a disk, possibly with holes.
///
/// # Errors
/// [`Error::NotADisk`] with the counts that differ from those of a disk.
pub fn check_domain(surface: &Surface) -> Result<()> {
    check(surface, |loops, euler| loops > 0 && euler == 2 - loops as i64)
}

fn check(surface: &Surface, is_allowed: impl Fn(usize, i64) -> bool) -> Result<()> {
    if surface.len() < FEWEST_SOURCES {
        return Err(Error::TooFewPoints { points: surface.len(), needed: FEWEST_SOURCES });
    }
    let components = surface.components().count();
    let loops = surface.boundary().len();
    let euler = (surface.len() + surface.faces().len()) as i64 - surface.edges().count() as i64;
    if components != 1 || !is_allowed(loops, euler) {
        let handles = (2 * components as i64 - euler - loops as i64) / 2;
        return Err(Error::NotADisk { components, loops, handles: handles.max(0) as usize, euler });
    }
    Ok(())
}

/// Checks that a connected voxel surface can be flattened.
///
/// # Errors
/// [`Error::TooFewPoints`], [`Error::Closed`] if the voxels enclose an interior, and [`Error::Cancelled`].
pub fn check_flattenable(surface: &VoxelSurface, control: &Control) -> Result<CubeTopology> {
    let points = surface.len();
    if points < FEWEST_SOURCES {
        return Err(Error::TooFewPoints { points, needed: FEWEST_SOURCES });
    }
    let topology = CubeTopology::of(surface, control)?;
    if topology.is_closed() {
        return Err(Error::Closed { points, touching: topology.lining, euler: topology.euler });
    }
    Ok(topology)
}
