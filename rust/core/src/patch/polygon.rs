//! Polygons on a surface.

use crate::surface::Surface;
use crate::surface::mesh::paths::{along_path, shortest_path};
use crate::{Control, Error, Result};

/// Returns the part with the smaller area of a surface that the closed shortest path through `corners` divides, and the
/// path, whose last vertex is its first. If the path touches itself and cuts off several pieces, the part contains all
/// but the largest.
///
/// # Errors
/// [`Error::FewCorners`], [`Error::NoSuchPoint`], [`Error::Unreachable`], [`Error::NotEnclosing`] if the path does not
/// divide the surface, and [`Error::Cancelled`].
pub fn polygon(surface: &Surface, corners: &[u32], control: &Control) -> Result<(Surface, Vec<u32>)> {
    if corners.len() < 3 {
        return Err(Error::FewCorners { corners: corners.len() });
    }
    let closed: Vec<u32> = corners.iter().chain(&corners[..1]).copied().collect();
    let path = shortest_path(surface, &closed, None, control)?;
    let half_edges = along_path(surface, &path)?;
    let before = surface.components().labels;
    let own = half_edges.first().map(|&h| before[h as usize / 3]);
    let sides = surface.cut_open(half_edges).components();
    let (side, count) = (&sides.labels, sides.count());
    let mut area = vec![0.0; count];
    let is_own = |face: usize| Some(before[face]) == own;
    let areas = surface.areas();
    (0..side.len()).filter(|&face| is_own(face)).for_each(|face| area[side[face] as usize] += areas[face]);
    let largest = (0..count).rev().max_by(|&a, &b| area[a].total_cmp(&area[b])).map(|piece| piece as u32);
    let inside: Vec<bool> = (0..side.len()).map(|face| is_own(face) && Some(side[face]) != largest).collect();
    if !inside.contains(&true) {
        return Err(Error::NotEnclosing { corners: corners.len() });
    }
    Ok((surface.part(&inside), path))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::{mesh::shapes, topology::Topology};

    #[test]
    fn a_square_on_a_sheet_holds_what_it_encloses() {
        let sheet = shapes::surface(shapes::sheet(9, 9));
        let at = |x: f64, y: f64| {
            let near = |p: &nalgebra::Vector3<f64>| (p.x - x).abs() + (p.y - y).abs() < 1e-9;
            sheet.points().iter().position(near).unwrap() as u32
        };
        let corners = [at(2.0, 2.0), at(6.0, 2.0), at(6.0, 7.0), at(2.0, 7.0)];
        let (inside, path) = polygon(&sheet, &corners, &Control::default()).unwrap();
        assert!(Topology::of(&inside).is_disk());
        assert!((inside.areas().iter().sum::<f64>() - 20.0).abs() < 1e-9);
        assert_eq!((path.first(), path.len()), (path.last(), 19));
        let turned: Vec<u32> = corners.iter().rev().copied().collect();
        assert_eq!(polygon(&sheet, &turned, &Control::default()).unwrap().0, inside);
    }

    #[test]
    fn the_smaller_side_of_a_sphere_is_taken() {
        let sphere = shapes::surface(shapes::sphere(4));
        let towards = |x: f64, y: f64, z: f64| {
            let along = |v: &u32| sphere.points()[*v as usize].dot(&nalgebra::Vector3::new(x, y, z));
            (0..sphere.len() as u32).max_by(|a, b| along(a).total_cmp(&along(b))).unwrap()
        };
        let corners = [towards(1.0, 0.0, 2.0), towards(-0.5, 0.8, 2.0), towards(-0.5, -0.8, 2.0)];
        let (inside, _) = polygon(&sphere, &corners, &Control::default()).unwrap();
        let share = inside.areas().iter().sum::<f64>() / sphere.areas().iter().sum::<f64>();
        assert!(Topology::of(&inside).is_disk() && share < 0.2, "{share}");
        assert!(inside.points().iter().all(|p| p.z > 0.5));
    }

    #[test]
    fn paths_that_enclose_nothing_are_refused() {
        let torus = shapes::surface(shapes::torus(24, 12));
        let around: Vec<u32> = (0..3).map(|third| third * 8 * 12).collect(); // the long way around, along the outside
        let refused = polygon(&torus, &around, &Control::default());
        assert!(matches!(refused, Err(Error::NotEnclosing { corners: 3 })));
        let few = polygon(&torus, &[0, 1], &Control::default());
        assert!(matches!(few, Err(Error::FewCorners { corners: 2 })));
        let line = polygon(&torus, &[0, 0, 0], &Control::default());
        assert!(matches!(line, Err(Error::NotEnclosing { .. })));
    }
}
