//! Parts of a voxel surface, on the 26-neighbour graph of Grossmann et al. (2002).

use crate::adjacency::Links;
use crate::geodesic::chain::{LinkLengths, chain_graph};
use crate::geodesic::shortest::Search;
use crate::surface::{VoxelSurface, voxels::graph::VoxelGraph};
use crate::volume::Mask;
use crate::{Control, Error, Result};

/// The part of a surface to select.
#[derive(Debug, Clone, Default)]
pub struct Selection<'a> {
    /// Keep the surface voxels that are foreground in this mask, which has the volume's shape.
    pub keep: Option<&'a Mask>,
    /// Keep the geodesic disk around a point.
    pub disk: Option<Disk>,
}

/// A geodesic disk: all points within `radius` mm, along the surface, of the surface voxel nearest to `seed_point`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Disk {
    /// The voxel indices of the centre.
    pub seed_point: [i64; 3],
    /// The radius in mm.
    pub radius: f64,
}

fn keep(surface: &VoxelSurface, mask: &Mask) -> Result<VoxelSurface> {
    if mask.shape() != surface.shape() {
        let [given, needed] = [mask.shape(), surface.shape()].map(|shape| shape.iter().product());
        return Err(Error::ShapeMismatch { shape: surface.shape(), given, needed });
    }
    let kept: Vec<bool> = surface.voxels().iter().map(|v| mask.is_inside(v.map(i64::from))).collect();
    if !kept.contains(&true) {
        return Err(Error::EmptyPatch { points: surface.len() });
    }
    Ok(surface.subset(&kept))
}

/// Returns a geodesic disk of a surface with its graph. The seed point is moved to the nearest surface voxel.
fn geodesic_disk(surface: &VoxelSurface, graph: &VoxelGraph, disk: Disk, control: &Control) -> Result<VoxelSurface> {
    let Disk { seed_point, radius } = disk;
    if !(radius > 0.0 && radius.is_finite()) {
        return Err(Error::RadiusNotPositive { radius });
    }
    let (seed, distance) = surface.nearest(seed_point);
    if distance > radius {
        return Err(Error::SeedOffSurface { voxel: seed_point, nearest: surface.voxels()[seed], distance, radius });
    }
    let beyond = (radius as f32).next_up();
    let mut reached = vec![beyond; surface.len()];
    reached[seed] = 0.0;
    Search::new(graph).lower(graph, &[seed as u32], &mut reached, control)?;
    let inside: Vec<bool> = reached.iter().map(|&distance| distance < beyond).collect();
    Ok(surface.subset(&inside))
}

fn largest_component(surface: &VoxelSurface, graph: &VoxelGraph) -> VoxelSurface {
    let components = graph.components();
    let largest = components.largest();
    let inside: Vec<bool> = components.labels.iter().map(|&label| Some(label) == largest).collect();
    surface.subset(&inside)
}

/// Returns the part of a surface to flatten, with its graph: the selected patch, or else the largest component.
///
/// # Errors
/// [`Error::ShapeMismatch`] and [`Error::EmptyPatch`] for the mask, [`Error::RadiusNotPositive`] and
/// [`Error::SeedOffSurface`] for the disk; [`Error::Disconnected`] if a selected patch is not connected.
pub fn cut_out(
    surface: &VoxelSurface, selection: &Selection<'_>, lengths: LinkLengths, control: &Control,
) -> Result<(VoxelSurface, VoxelGraph)> {
    control.begin("extracting the patch", 1);
    let mut part = match selection.keep {
        Some(mask) => keep(surface, mask)?,
        None => surface.clone(),
    };
    let mut graph = chain_graph(&part, lengths, control)?;
    if let Some(disk) = selection.disk {
        part = geodesic_disk(&part, &graph, disk, control)?;
        graph = chain_graph(&part, lengths, control)?;
    }
    let components = graph.components();
    if components.sizes.len() > 1 {
        if selection.keep.is_some() {
            return Err(Error::Disconnected { count: components.sizes.len(), sizes: components.describe() });
        }
        part = largest_component(&part, &graph);
        graph = chain_graph(&part, lengths, control)?;
    }
    Ok((part, graph))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::{row, voxels};

    #[test]
    fn the_radius_itself_is_within_the_disk() {
        let plate = voxels(&Mask::from_fn([15, 15, 1], |_| true).unwrap(), [1.0; 3]);
        let control = Control::default();
        let whole = chain_graph(&plate, LinkLengths::ChainCode, &control).unwrap();
        let (seed, _) = plate.nearest([7, 7, 0]);
        let distances = row(&whole, seed as u32);
        for radius in distances.iter().copied().filter(|d| (1.0..4.0).contains(d)) {
            let disk = Some(Disk { seed_point: [7, 7, 0], radius: f64::from(radius) });
            let (part, _) = cut_out(&plate, &Selection { disk, keep: None }, LinkLengths::ChainCode, &control).unwrap();
            assert_eq!(part.len(), distances.iter().filter(|&&d| d <= radius).count(), "{radius}");
        }
    }
}
