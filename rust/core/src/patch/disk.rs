//! Geodesic disks of a surface.

use crate::adjacency::{Components, Links};
use crate::error::check_points;
use crate::geodesic::shortest::Search;
use crate::surface::{Surface, mesh::BORDER};
use crate::{Control, Error, Result};

/// The maximum size of an enclosed piece that a geodesic disk includes, as a share of the disk's area: a bump that is
/// higher than the radius. Larger pieces are gyri that do not belong to the disk.
const MOST_FILLED: f64 = 0.1;

/// Returns the geodesic disk of a surface, and the number of faces that were filled in. The disk contains the faces
/// within `radius` mm of a vertex, and the small pieces that they enclose.
///
/// # Errors
/// [`Error::RadiusNotPositive`], [`Error::NoSuchPoint`], [`Error::EmptyDisk`] if no face lies within the radius,
/// [`Error::DiskEncloses`] if a large piece is enclosed, and [`Error::Cancelled`].
pub fn disk(
    surface: &Surface, graph: &impl Links, seed: u32, radius: f64, control: &Control,
) -> Result<(Surface, usize)> {
    if !(radius > 0.0 && radius.is_finite()) {
        return Err(Error::RadiusNotPositive { radius });
    }
    check_points([seed], surface.len())?;
    let beyond = (radius as f32).next_up();
    let mut reached = vec![beyond; surface.len()];
    reached[seed as usize] = 0.0;
    Search::new(graph).lower(graph, &[seed], &mut reached, control)?;
    let is_near = |face: &[u32; 3]| face.iter().all(|&v| reached[v as usize] < beyond);
    let near: Vec<bool> = surface.faces().iter().map(is_near).collect();
    let of_seed = (0..near.len()).find(|&f| near[f] && surface.faces()[f].contains(&seed));
    let Some(start) = of_seed else { return Err(Error::EmptyDisk { vertex: seed as usize, radius }) };
    let inside = surface.pieces(|face| near[face as usize]);
    let mut keep: Vec<bool> = inside.labels.iter().map(|&label| label == inside.labels[start]).collect();
    control.check()?;

    let areas = surface.areas();
    let own: f64 = (0..keep.len()).filter(|&f| keep[f]).map(|f| areas[f]).sum();
    let component = surface.components().labels;
    let outside = surface.pieces(|face| !keep[face as usize] && component[face as usize] == component[start]);
    let mut size = vec![0.0; outside.count()];
    let mut is_open = vec![false; outside.count()];
    for (face, &label) in outside.labels.iter().enumerate().filter(|&(_, &label)| label != Components::NONE) {
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
    for (face, &label) in outside.labels.iter().enumerate().filter(|&(_, &label)| label != Components::NONE) {
        if enclosed(label as usize) {
            keep[face] = true;
            filled += 1;
        }
    }
    Ok((surface.part(&keep), filled))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geodesic::graph::GeodesicGraph;
    use crate::surface::{mesh::shapes, topology::Topology};
    use crate::tests::{both, moved, row};
    use nalgebra::Vector3;

    fn disk_of(surface: &Surface, seed: u32, radius: f64) -> Result<(Surface, usize)> {
        let graph = GeodesicGraph::new(surface, &Control::default()).unwrap();
        disk(surface, &graph, seed, radius, &Control::default())
    }

    fn euler(surface: &Surface) -> i64 {
        Topology::of(surface).euler
    }

    #[test]
    fn a_disk_holds_what_is_near() {
        let sheet = shapes::surface(shapes::sheet(20, 20));
        let (part, filled) = disk_of(&sheet, 220, 6.0).unwrap();
        assert_eq!((filled, euler(&part), part.boundary().len()), (0, 1, 1));
        assert!(part.points().iter().all(|p| (p - sheet.points()[220]).norm() <= 6.0));
        assert!(part.areas().iter().sum::<f64>() > 0.75 * std::f64::consts::PI * 36.0);
    }

    /// Returns a sphere with a bump. A disk at the foot of the bump surrounds it before it reaches its top.
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
        let sphere = shapes::sphere(3);
        let two = shapes::surface(both(&sphere, &moved(&sphere, |&[x, y, z]| [x + 5.0, y, z])));
        let (part, filled) = disk_of(&two, 0, 1.0).unwrap();
        assert_eq!((filled, euler(&part)), (0, 1));
        assert_eq!(crate::patch::largest_piece(&two).len(), sphere.0.len());
    }

    #[test]
    fn bad_disks_are_refused() {
        let sheet = shapes::surface(shapes::sheet(4, 4));
        assert!(matches!(disk_of(&sheet, 7, f64::NAN), Err(Error::RadiusNotPositive { .. })));
        assert!(matches!(disk_of(&sheet, 7, 0.1), Err(Error::EmptyDisk { vertex: 7, .. })));
        assert!(matches!(disk_of(&sheet, 25, 1.0), Err(Error::NoSuchPoint { vertex: 25, points: 25 })));
    }

    #[test]
    fn up_to_a_tenth_of_a_disk_is_taken_in() {
        let [mut taken, mut refused] = [0; 2];
        for height in 6..12 {
            let surface = bumpy(f64::from(height));
            let foot = Vector3::new(2.0, 0.0, 9.8);
            let far = |v: &u32| (surface.points()[*v as usize] - foot).norm();
            let seed = (0..surface.len() as u32).min_by(|a, b| far(a).total_cmp(&far(b))).unwrap();
            let reached = row(&GeodesicGraph::new(&surface, &Control::default()).unwrap(), seed);
            match disk_of(&surface, seed, 7.0) {
                Ok((part, filled)) => {
                    let is_own =
                        |face: &[u32; 3]| face.iter().all(|&v| reached[part.ids()[v as usize] as usize] <= 7.0);
                    let sizes = part.faces().iter().zip(part.areas());
                    let (own, other) =
                        sizes.fold(
                            (0.0, 0.0),
                            |(own, other), (face, area)| {
                                if is_own(face) { (own + area, other) } else { (own, other + area) }
                            },
                        );
                    assert!(other <= 0.1 * own && (filled > 0) == (other > 0.0), "{height} {other} {own}");
                    taken += usize::from(filled > 0);
                }
                Err(Error::DiskEncloses { area, own, .. }) => {
                    assert!(area > 0.1 * own, "{height} {area} {own}");
                    refused += usize::from(area < 0.5 * own);
                }
                Err(other) => panic!("{other}"),
            }
        }
        assert!(taken > 0 && refused > 0, "{taken} {refused}");
    }

    #[test]
    fn the_radius_itself_is_within_the_disk() {
        let sheet = shapes::surface(shapes::sheet(20, 20));
        let distances = row(&GeodesicGraph::new(&sheet, &Control::default()).unwrap(), 220);
        let expected = |radius: f32| distances.iter().filter(|&&d| d <= radius).count();
        for radius in [3.0, 5.0] {
            // no vertex is left over that belongs to no face within
            assert_eq!(disk_of(&sheet, 220, f64::from(radius)).unwrap().0.len(), expected(radius), "{radius}");
        }
    }
}
