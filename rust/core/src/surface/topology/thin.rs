//! Thin parts: where the two sides of a solid are much closer through the solid than along its surface.
//!
//! There, a label is about one voxel thick. Distances through the solid take a short cut, and handles are likely.

use std::collections::HashMap;

use nalgebra::Vector3;

use crate::surface::mesh::Surface;
use crate::surface::mesh::paths::{EdgeSearch, Network};
use crate::{Control, Result};

/// The maximum cosine between the normals of opposite sides.
const AWAY: f64 = -0.5;

/// The minimum cosine between the line through the solid and the inward normal at either end.
const THROUGH: f64 = 0.7;

/// The minimum ratio of the distances along the surface and through the solid.
const LONGER: f64 = 3.0;

/// The thin parts of a solid.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ThinPlaces {
    /// The vertices on both sides of thin parts, ascending.
    pub vertices: Vec<u32>,
    /// The thinnest part.
    pub worst: Option<Thin>,
}

/// Two opposite vertices.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Thin {
    /// The vertices.
    pub vertices: [u32; 2],
    /// The distance between them through the solid in mm.
    pub thickness: f64,
}

/// Finds the vertices that have an opposite vertex within `thickness` mm. An opposite vertex lies inwards, its normal
/// points the other way, and it is more than three times as far along edges as through the solid. Finds none unless the
/// thickness is positive and finite.
///
/// Takes O(n) time, multiplied by the number of vertices within that distance of each.
///
/// # Errors
/// [`Error::Cancelled`](crate::Error::Cancelled).
pub fn thin_places(surface: &Surface, thickness: f64, control: &Control) -> Result<ThinPlaces> {
    let mut places = ThinPlaces::default();
    if !(thickness > 0.0 && thickness.is_finite()) {
        return Ok(places);
    }
    let (normals, cells) = (surface.normals(), Cells::new(surface.points(), thickness));
    let network = Network::of(surface);
    let mut search = EdgeSearch::new(surface.len());
    let mut opposite = Vec::new();
    for vertex in 0..surface.len() as u32 {
        control.check()?;
        let (here, normal) = (surface.points()[vertex as usize], normals[vertex as usize]);
        opposite.clear();
        for other in cells.around(&here) {
            let (way, beyond) = (surface.points()[other as usize] - here, normals[other as usize]);
            let distance = way.norm();
            let leads_through = -way.dot(&normal) >= THROUGH * distance && way.dot(&beyond) >= THROUGH * distance;
            if distance <= thickness && normal.dot(&beyond) < AWAY && leads_through {
                opposite.push((distance, other));
            }
        }
        opposite.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let Some(&(most, _)) = opposite.last() else { continue };
        search_around(&mut search, &network, vertex, LONGER * most, control)?;
        let is_far = |&&(distance, other): &&(f64, u32)| search.distance(other) > LONGER * distance;
        if let Some(&(thickness, other)) = opposite.iter().find(is_far) {
            places.vertices.push(vertex);
            if places.worst.is_none_or(|worst| thickness < worst.thickness) {
                places.worst = Some(Thin { vertices: [vertex, other], thickness });
            }
        }
    }
    Ok(places)
}

/// Computes distances along edges up to a radius.
fn search_around(
    search: &mut EdgeSearch, network: &Network, vertex: u32, radius: f64, control: &Control,
) -> Result<()> {
    search.clear();
    search.seed(vertex);
    while let Some(vertex) = search.settle(network, |_| true) {
        control.check()?;
        if search.distance(vertex) > radius {
            break;
        }
    }
    Ok(())
}

/// Points sorted into the cells of a grid.
struct Cells {
    size: f64,
    members: HashMap<[i64; 3], Vec<u32>>,
}

impl Cells {
    fn new(points: &[Vector3<f64>], size: f64) -> Self {
        let mut cells = Self { size, members: HashMap::new() };
        for (n, point) in (0..).zip(points) {
            cells.members.entry(cells.of(point)).or_default().push(n);
        }
        cells
    }

    fn of(&self, point: &Vector3<f64>) -> [i64; 3] {
        [0, 1, 2].map(|axis| (point[axis] / self.size).floor() as i64)
    }

    /// Iterates over the points in the cell of a position and in the adjacent cells.
    fn around(&self, place: &Vector3<f64>) -> impl Iterator<Item = u32> + '_ {
        let cell = self.of(place);
        let offsets = (0..27).map(|n| [n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1]);
        let cells = offsets.map(move |offset| [0, 1, 2].map(|axis| cell[axis].saturating_add(offset[axis])));
        cells.filter_map(|cell| self.members.get(&cell)).flatten().copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::mesh::shapes;
    use crate::tests::{both, moved};

    fn thin(surface: &Surface, thickness: f64) -> ThinPlaces {
        thin_places(surface, thickness, &Control::default()).unwrap()
    }

    /// Returns a flattened ball.
    fn disc(height: f64) -> Surface {
        let sphere = shapes::surface(shapes::sphere(5));
        sphere.moved(sphere.points().iter().map(|p| [5.0 * p.x, 5.0 * p.y, height * p.z].into()).collect()).unwrap()
    }

    #[test]
    fn a_flat_ball_is_thin_but_for_its_rim() {
        let disc = disc(0.5);
        let places = thin(&disc, 1.2);
        let expected = |&v: &u32| disc.points()[v as usize].xy().norm() < 3.5;
        let middle: Vec<u32> = (0..disc.len() as u32).filter(expected).collect();
        assert!(middle.iter().all(|v| places.vertices.binary_search(v).is_ok()));
        let worst = places.worst.unwrap();
        assert!(worst.thickness < 0.8, "{worst:?}");
        let [a, b] = worst.vertices.map(|v| disc.points()[v as usize]);
        assert!(((a - b).norm() - worst.thickness).abs() < 1e-12 && a.z * b.z < 0.0);
    }

    #[test]
    fn what_is_thick_or_hollow_is_not_thin() {
        assert_eq!(thin(&disc(3.0), 1.2), ThinPlaces::default());
        assert_eq!(thin(&shapes::surface(shapes::sheet(9, 9)), 2.0), ThinPlaces::default());
        // a narrow gap between two solids: the way between them leads outward
        let sheet = shapes::sheet(6, 6);
        let mut above = moved(&sheet, |&[x, y, _]| [x, y, 0.4]);
        above.1.iter_mut().for_each(|face| face.swap(1, 2));
        let mut two = both(&sheet, &above);
        assert_eq!(thin(&shapes::surface(two.clone()), 1.0), ThinPlaces::default());
        // turned inside out it is a blade
        two.1.iter_mut().for_each(|face| face.swap(1, 2));
        let blade = shapes::surface(two);
        assert_eq!(thin(&blade, 1.0).vertices.len(), 98);
        for nothing in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert_eq!(thin(&blade, nothing), ThinPlaces::default());
        }
    }

    #[test]
    fn opposite_vertices_are_thin_if_the_way_around_is_three_times_as_long() {
        // a plate of height 2 around whose rim at x = 12 the way is 2 (12 − x) + 2
        let strip = moved(&shapes::sheet(26, 4), |&[s, y, _]| match s {
            s if s <= 12.0 => [s, y, 2.0],
            s if s < 14.0 => [12.0, y, 14.0 - s],
            s => [26.0 - s, y, 0.0],
        });
        let strip = shapes::surface(strip);
        let expected: Vec<u32> = (0..strip.len() as u32).filter(|&v| strip.points()[v as usize].x < 10.0).collect();
        assert_eq!(thin(&strip, 2.001).vertices, expected);
    }

    #[test]
    fn opposite_normals_differ_by_more_than_120_degrees() {
        for (tilt, is_thin) in [(29f64, true), (31.0, false)] {
            let slope = tilt.to_radians().tan();
            let side =
                |sign: f64| moved(&shapes::sheet(1, 1), |&[x, y, _]| [x - 0.5, y, sign * (0.4 - slope * (x - 0.5))]);
            let (upper, mut lower) = (side(1.0), side(-1.0));
            lower.1.iter_mut().for_each(|face| face.swap(1, 2));
            assert_eq!(!thin(&shapes::surface(both(&upper, &lower)), 3.0).vertices.is_empty(), is_thin, "{tilt}");
        }
    }

    #[test]
    fn the_way_to_the_other_side_leads_nearly_along_both_normals() {
        // the cosine of the angle between the way and the normal of either side, or of the upper one only
        for (cosine, both_tilted, is_thin) in [(0.72f64, true, true), (0.68, true, false), (0.68, false, false)] {
            let aside = cosine.acos().tan();
            let slope = if both_tilted { 0.0 } else { aside };
            let tiny = |z: f64, x: f64, slope: f64| {
                moved(&shapes::sheet(1, 1), |p| [x + 1e-3 * p[0], 1e-3 * p[1], z + slope * 1e-3 * p[0]])
            };
            let (upper, mut lower) = (tiny(1.0, 0.0, 0.0), tiny(0.0, aside, slope));
            lower.1.iter_mut().for_each(|face| face.swap(1, 2));
            let found = thin(&shapes::surface(both(&upper, &lower)), 3.0);
            assert_eq!(!found.vertices.is_empty(), is_thin, "{cosine} {both_tilted}");
        }
    }
}
