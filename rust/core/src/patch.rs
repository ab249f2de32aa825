//! The part of a surface that is flattened: a real surface is rarely a disk.

use crate::adjacency::{Graph, Links};
use crate::control::Control;
use crate::error::{Error, Result};
use crate::geodesic::shortest::Search;
use crate::surface::mesh::BORDER;
use crate::surface::{Surface, VoxelSurface};
use crate::volume::Mask;

/// Which part of a surface to take.
#[derive(Debug, Clone, Default)]
pub struct Patch<'a> {
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
///
/// # Errors
/// [`Error::ShapeMismatch`], [`Error::EmptyPatch`].
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
///
/// # Errors
/// [`Error::RadiusNotPositive`], [`Error::SeedOffSurface`], [`Error::Cancelled`].
pub fn geodesic_disk(surface: &VoxelSurface, graph: &Graph, disk: Disk, control: &Control) -> Result<VoxelSurface> {
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
pub fn largest_component(surface: &VoxelSurface, graph: &Graph) -> VoxelSurface {
    let components = graph.components();
    let largest = components.largest();
    let inside: Vec<bool> = components.labels.iter().map(|&label| Some(label) == largest).collect();
    surface.subset(&inside)
}

/// The largest piece of the rest, as a share of the disk's area, that a geodesic disk takes in when it encloses it: a bump
/// higher than the radius reaches. What is larger is a gyrus that nobody asked for.
const MOST_FILLED: f64 = 0.1;

/// The geodesic disk of a surface: its faces within `radius` mm of a vertex, and small pieces that these enclose. Returns
/// the number of faces that were taken in, too.
///
/// # Errors
/// [`Error::RadiusNotPositive`], [`Error::NoSuchPoint`], [`Error::EmptyDisk`] where not even one face lies within the radius,
/// [`Error::DiskEncloses`] where a large piece is enclosed, [`Error::Cancelled`].
pub fn disk(
    surface: &Surface,
    graph: &impl Links,
    seed: u32,
    radius: f64,
    control: &Control,
) -> Result<(Surface, usize)> {
    if !(radius > 0.0 && radius.is_finite()) {
        return Err(Error::RadiusNotPositive { radius });
    }
    if seed as usize >= surface.len() {
        return Err(Error::NoSuchPoint { vertex: seed as usize, points: surface.len() });
    }
    let beyond = (radius as f32).next_up();
    let mut reached = vec![beyond; surface.len()];
    reached[seed as usize] = 0.0;
    Search::new(graph).lower(graph, &[seed], &mut reached, control)?;
    let is_near = |face: &[u32; 3]| face.iter().all(|&v| reached[v as usize] < beyond);
    let near: Vec<bool> = surface.faces().iter().map(is_near).collect();
    let of_seed = (0..near.len()).find(|&f| near[f] && surface.faces()[f].contains(&seed));
    let Some(start) = of_seed else { return Err(Error::EmptyDisk { vertex: seed as usize, radius }) };
    let inside = pieces(surface, |face| near[face]);
    let mut keep: Vec<bool> = inside.labels.iter().map(|&label| label == inside.labels[start]).collect();
    control.check()?;

    let areas = surface.areas();
    let own: f64 = (0..keep.len()).filter(|&f| keep[f]).map(|f| areas[f]).sum();
    let (component, _) = surface.components();
    let outside = pieces(surface, |face| !keep[face] && component[face] == component[start]);
    let mut size = vec![0.0; outside.count];
    let mut is_open = vec![false; outside.count];
    for (face, &label) in outside.labels.iter().enumerate().filter(|&(_, &label)| label != NONE) {
        size[label as usize] += areas[face];
        is_open[label as usize] |= surface.twins()[3 * face..3 * face + 3].contains(&BORDER);
    }
    let largest = (0..size.len()).rev().max_by(|&a, &b| size[a].total_cmp(&size[b]));
    let enclosed = |piece: usize| Some(piece) != largest && !is_open[piece];
    if let Some(piece) = (0..size.len()).find(|&piece| enclosed(piece) && size[piece] > MOST_FILLED * own) {
        let face = outside.labels.iter().position(|&label| label as usize == piece).unwrap_or_default();
        let at = surface.points()[surface.faces()[face][0] as usize].into();
        return Err(Error::DiskEncloses { radius, area: size[piece], own, at });
    }
    let mut filled = 0;
    for (face, &label) in outside.labels.iter().enumerate().filter(|&(_, &label)| label != NONE) {
        if enclosed(label as usize) {
            keep[face] = true;
            filled += 1;
        }
    }
    Ok((surface.part(&keep), filled))
}

/// The component with the largest area; the whole surface if it has but one.
pub fn largest_piece(surface: &Surface) -> Surface {
    let (labels, count) = surface.components();
    let mut area = vec![0.0; count];
    labels.iter().zip(surface.areas()).for_each(|(&label, face)| area[label as usize] += face);
    let largest = (0..count).rev().max_by(|&a, &b| area[a].total_cmp(&area[b])).unwrap_or(0) as u32;
    surface.part(&labels.iter().map(|&label| label == largest).collect::<Vec<_>>())
}

/// Stands for the piece of a face that belongs to none.
const NONE: u32 = u32::MAX;

struct Pieces {
    labels: Vec<u32>,
    count: usize,
}

/// The connected pieces of the faces that a rule allows.
fn pieces(surface: &Surface, allowed: impl Fn(usize) -> bool) -> Pieces {
    let mut labels = vec![NONE; surface.faces().len()];
    let mut count = 0;
    let mut stack = Vec::new();
    for start in 0..labels.len() {
        if labels[start] != NONE || !allowed(start) {
            continue;
        }
        labels[start] = count;
        stack.push(start);
        while let Some(face) = stack.pop() {
            for &twin in &surface.twins()[3 * face..3 * face + 3] {
                let next = twin as usize / 3;
                if twin != BORDER && labels[next] == NONE && allowed(next) {
                    labels[next] = count;
                    stack.push(next);
                }
            }
        }
        count += 1;
    }
    Pieces { labels, count: count as usize }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geodesic::graph::GeodesicGraph;
    use crate::surface::mesh::shapes;
    use nalgebra::Vector3;

    fn disk_of(surface: &Surface, seed: u32, radius: f64) -> Result<(Surface, usize)> {
        let graph = GeodesicGraph::new(surface, &Control::default()).unwrap();
        disk(surface, &graph, seed, radius, &Control::default())
    }

    fn euler(surface: &Surface) -> i64 {
        (surface.len() + surface.faces().len()) as i64 - surface.edges().count() as i64
    }

    #[test]
    fn a_disk_holds_what_is_near() {
        let sheet = shapes::surface(shapes::sheet(20, 20));
        let (part, filled) = disk_of(&sheet, 220, 6.0).unwrap();
        assert_eq!((filled, euler(&part), part.boundary().len()), (0, 1, 1));
        assert!(part.points().iter().all(|p| (p - sheet.points()[220]).norm() <= 6.0));
        assert!(part.areas().iter().sum::<f64>() > 0.75 * std::f64::consts::PI * 36.0);
    }

    /// A sphere with a bump: a disk around the bump's foot reaches around it before it reaches its top.
    fn bumpy(height: f64) -> Surface {
        let sphere = shapes::surface(shapes::sphere(5));
        let bump = |p: &Vector3<f64>| {
            let away = (p - Vector3::z()).norm();
            p * (10.0 + height * (-(away / 0.12).powi(4)).exp())
        };
        sphere.moved(sphere.points().iter().map(bump).collect()).unwrap()
    }

    #[test]
    fn small_bumps_are_taken_in_and_large_ones_refused() {
        let at = |surface: &Surface| {
            let foot = Vector3::new(2.0, 0.0, 9.8);
            (0..surface.len() as u32).min_by(|&a, &b| {
                let far = |v: u32| (surface.points()[v as usize] - foot).norm();
                far(a).total_cmp(&far(b))
            })
        };
        let small = bumpy(6.0);
        let (part, filled) = disk_of(&small, at(&small).unwrap(), 7.0).unwrap();
        assert!(filled > 0);
        assert_eq!((euler(&part), part.boundary().len()), (1, 1));
        let large = bumpy(60.0);
        assert!(matches!(disk_of(&large, at(&large).unwrap(), 7.0), Err(Error::DiskEncloses { .. })));
    }

    #[test]
    fn other_components_stay_outside() {
        let (mut points, mut faces) = shapes::sphere(3);
        let count = points.len();
        let far = |p: &[f64; 3]| [p[0] + 5.0, p[1], p[2]];
        points.extend(points.clone().iter().map(far));
        faces.extend(faces.clone().iter().map(|face| face.map(|v| v + count as i64)));
        let two = shapes::surface((points, faces));
        let (part, filled) = disk_of(&two, 0, 1.0).unwrap();
        assert_eq!((filled, euler(&part)), (0, 1));
        assert_eq!(largest_piece(&two).len(), count);
    }

    #[test]
    fn bad_disks_are_refused() {
        let sheet = shapes::surface(shapes::sheet(4, 4));
        assert!(matches!(disk_of(&sheet, 7, f64::NAN), Err(Error::RadiusNotPositive { .. })));
        assert!(matches!(disk_of(&sheet, 7, 0.1), Err(Error::EmptyDisk { vertex: 7, .. })));
        assert!(matches!(disk_of(&sheet, 25, 1.0), Err(Error::NoSuchPoint { vertex: 25, points: 25 })));
    }
}
