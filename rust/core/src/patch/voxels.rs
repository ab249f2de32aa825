//! The part of a voxel surface, on the paper's 26-neighbour graph.

use crate::adjacency::Links;
use crate::control::Control;
use crate::error::{Error, Result};
use crate::geodesic::chain::{LinkLengths, chain_graph};
use crate::geodesic::shortest::Search;
use crate::surface::VoxelSurface;
use crate::surface::voxels::graph::VoxelGraph;
use crate::volume::Mask;

/// Which part of a surface to take.
#[derive(Debug, Clone, Default)]
pub struct Selection<'a> {
    /// Keep the surface voxels that are foreground here; of the volume's shape.
    pub keep: Option<&'a Mask>,
    /// Keep the geodesic disk around a point.
    pub disk: Option<Disk>,
}

/// A geodesic disk: all points within `radius` mm, along the surface, of the surface voxel nearest to `seed_point`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Disk {
    /// Voxel indices.
    pub seed_point: [i64; 3],
    /// In mm.
    pub radius: f64,
}

/// The mask's part of a surface.
pub fn keep(surface: &VoxelSurface, mask: &Mask) -> Result<VoxelSurface> {
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

/// A geodesic disk of a surface with its graph. The seed point is the nearest surface voxel to the one that is asked for.
pub fn geodesic_disk(
    surface: &VoxelSurface,
    graph: &VoxelGraph,
    disk: Disk,
    control: &Control,
) -> Result<VoxelSurface> {
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

/// The largest connected component.
pub fn largest_component(surface: &VoxelSurface, graph: &VoxelGraph) -> VoxelSurface {
    let components = graph.components();
    let largest = components.largest();
    let inside: Vec<bool> = components.labels.iter().map(|&label| Some(label) == largest).collect();
    surface.subset(&inside)
}

/// What is to be flattened of a surface, with its graph: the patch, or the largest component where none is given.
/// Errors: Those of [`keep`] and [`geodesic_disk`]; [`Error::Disconnected`] if a given patch falls into pieces.
pub fn cut_out(
    surface: &VoxelSurface,
    selection: &Selection<'_>,
    lengths: LinkLengths,
    control: &Control,
) -> Result<(VoxelSurface, VoxelGraph)> {
    control.begin("cutting out the patch", 1);
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
