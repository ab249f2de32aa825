//! Small holes of a surface, and how to fill them without new vertices.

use std::ops::Range;

use nalgebra::Vector3;

use crate::surface::mesh::paths::Network;
use crate::surface::mesh::{BORDER, Surface};
use crate::surface::topology::{Loop, Topology};
use crate::{Control, Result};

/// The maximum number of edges of a hole to fill; the time grows with its cube.
pub const MOST_EDGES: usize = 500;

/// A triangle counts as degenerate if its area, divided by the square of its longest side, is below this.
const FLAT: f64 = 1e-9;

/// The weight of long edges relative to the area, to choose among coverings of a plane hole, whose areas are equal.
const SLENDER: f64 = 0.01;

/// A surface with filled holes.
#[derive(Debug, Clone, PartialEq)]
pub struct Filled {
    /// The surface: the same vertices and faces, followed by the added faces.
    pub surface: Surface,
    /// The added faces, which should be excluded from display and measurements.
    pub added: Range<usize>,
    /// The given holes that could not be filled.
    pub left: Vec<usize>,
}

/// Returns the boundary loops up to a length (mm), without the longest loop of each component (its rim), longest first.
pub fn small_holes(surface: &Surface, longest: f64) -> Vec<Loop> {
    let mut has_rim = vec![false; surface.components().count()];
    let mut loops = Topology::of(surface).loops;
    loops.retain(|hole| std::mem::replace(&mut has_rim[hole.component as usize], true) && hole.length <= longest);
    loops
}

/// Fills holes with triangles between the vertices around each, of minimal area (Barequet, Sharir 1995); raises χ by
/// one each.
///
/// A hole remains open if it has more than [`MOST_EDGES`] edges, if it is not a boundary loop of this surface, or if
/// every triangulation needs a triangle without area or an existing edge. A slit between two vertices is closed without
/// a face. Takes O(k³) time for a hole of k edges.
///
/// # Errors
/// [`Error::Cancelled`](crate::Error::Cancelled).
pub fn fill_holes(surface: &Surface, holes: &[Loop], control: &Control) -> Result<Filled> {
    let mut patch = Cover { faces: surface.faces().to_vec(), twins: surface.twins().to_vec() };
    let network = Network::of(surface);
    let mut left = Vec::new();
    for (n, hole) in holes.iter().enumerate() {
        let half_edges = &hole.half_edges;
        if !is_open_loop(surface, &patch.twins, half_edges) {
            left.push(n);
        } else if let [g, h] = half_edges[..] {
            patch.join(g, h);
        } else if let Some(apexes) = covering(surface, &network, half_edges, control)? {
            patch.cover(&hole.vertices(surface), half_edges, &apexes);
        } else {
            left.push(n);
        }
    }
    let added = surface.faces().len()..patch.faces.len();
    let surface = Surface::assemble(surface.points(), surface.ids(), &patch.faces, patch.twins);
    Ok(Filled { surface, added, left })
}

/// Returns whether it is a closed loop along the boundary that is not filled yet.
fn is_open_loop(surface: &Surface, twins: &[u32], half_edges: &[u32]) -> bool {
    let onwards = half_edges.iter().cycle().skip(1);
    (2..=MOST_EDGES).contains(&half_edges.len())
        && half_edges.iter().all(|&h| twins.get(h as usize) == Some(&BORDER))
        && half_edges.iter().zip(onwards).all(|(&h, &next)| surface.target(h) == surface.origin(next))
}

/// Returns the triangulation of a polygon with the smallest area: for vertices a < b, the vertex between them that
/// forms a triangle with both, in row a, column b.
fn covering(surface: &Surface, network: &Network, half_edges: &[u32], control: &Control) -> Result<Option<Vec<usize>>> {
    let count = half_edges.len();
    let vertices: Vec<u32> = half_edges.iter().map(|&h| surface.origin(h)).collect();
    let points: Vec<Vector3<f64>> = vertices.iter().map(|&v| surface.points()[v as usize]).collect();
    let exists = |a: usize, b: usize| network.incident(vertices[a]).iter().any(|arc| arc.to == vertices[b]);
    let mut cost = vec![0.0; count * count];
    let mut apexes = vec![0; count * count];
    for span in 2..count {
        for a in 0..count - span {
            control.check()?;
            let b = a + span;
            let is_side = a == 0 && b == count - 1;
            let mut best = (f64::INFINITY, 0);
            if is_side || !exists(a, b) {
                for apex in a + 1..b {
                    let around = cost[a * count + apex] + cost[apex * count + b];
                    if around < best.0 {
                        let whole = around + triangle_cost([a, apex, b].map(|n| points[n]));
                        best = if whole < best.0 { (whole, apex) } else { best };
                    }
                }
            }
            (cost[a * count + b], apexes[a * count + b]) = best;
        }
    }
    let is_covered = cost[count - 1].is_finite();
    let is_a_face = count == 3 && surface.twins()[3 * (half_edges[0] as usize / 3)..][..3].iter().all(|&t| t == BORDER);
    Ok((is_covered && !is_a_face).then_some(apexes))
}

/// Returns the area of a triangle in mm², plus a small cost of long sides; infinite if it is degenerate.
fn triangle_cost([a, b, c]: [Vector3<f64>; 3]) -> f64 {
    let sides = [b - a, c - b, a - c].map(|side| side.norm_squared());
    let area = 0.5 * (b - a).cross(&(c - a)).norm();
    if area > FLAT * sides.into_iter().fold(0.0, f64::max) {
        area + SLENDER * sides.iter().sum::<f64>()
    } else {
        f64::INFINITY
    }
}

/// Growing lists of faces and their twins.
struct Cover {
    faces: Vec<[u32; 3]>,
    twins: Vec<u32>,
}

impl Cover {
    fn join(&mut self, g: u32, h: u32) {
        self.twins[g as usize] = h;
        self.twins[h as usize] = g;
    }

    /// Adds the triangles of a polygon, whose half-edges run in the opposite direction.
    fn cover(&mut self, vertices: &[u32], half_edges: &[u32], apexes: &[usize]) {
        let count = vertices.len();
        let mut open = vec![(0, count - 1, half_edges[count - 1])];
        while let Some((a, b, beyond)) = open.pop() {
            if b == a + 1 {
                self.join(half_edges[a], beyond);
                continue;
            }
            let apex = apexes[a * count + b];
            let first = 3 * self.faces.len() as u32;
            self.faces.push([b, apex, a].map(|n| vertices[n]));
            self.twins.extend([BORDER; 3]);
            self.join(first + 2, beyond);
            open.extend([(apex, b, first), (a, apex, first + 1)]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::mesh::shapes;
    use proptest::prelude::*;

    fn assert_filled(surface: &Surface, filled: &Filled, holes: usize) {
        let (before, after) = (Topology::of(surface), Topology::of(&filled.surface));
        assert_eq!(after.euler - before.euler, (holes - filled.left.len()) as i64);
        assert_eq!(after.loops.len(), before.loops.len() - (holes - filled.left.len()));
        assert_eq!((filled.surface.points(), filled.surface.ids()), (surface.points(), surface.ids()));
        assert_eq!(&filled.surface.faces()[..filled.added.start], surface.faces());
        assert_eq!(filled.added, surface.faces().len()..filled.surface.faces().len());
        // it passes as a mesh from a file, so it is a manifold
        let points: Vec<[f64; 3]> = surface.points().iter().map(|&p| p.into()).collect();
        let faces: Vec<[i64; 3]> = filled.surface.faces().iter().map(|face| face.map(i64::from)).collect();
        let (same, _) = Surface::from_triangles(&points, &faces).unwrap();
        assert_eq!(same.twins(), filled.surface.twins());
    }

    fn sheet_without(holes: &[[usize; 4]]) -> Surface {
        let sheet = shapes::surface(shapes::sheet(12, 12));
        let keep = |f: usize| {
            let (i, j) = (f / 2 / 12, f / 2 % 12);
            !holes.iter().any(|&[a, b, c, d]| (a..b).contains(&i) && (c..d).contains(&j))
        };
        sheet.part(&(0..288).map(keep).collect::<Vec<_>>())
    }

    #[test]
    fn holes_in_a_sheet_are_filled_with_their_area() {
        let sheet = sheet_without(&[[2, 3, 2, 3], [5, 9, 5, 8], [2, 4, 7, 9]]);
        let holes = small_holes(&sheet, 100.0);
        assert_eq!(holes.iter().map(|hole| hole.length).collect::<Vec<_>>(), [14.0, 8.0, 4.0]);
        assert_eq!(small_holes(&sheet, 8.0).len(), 2);
        let filled = fill_holes(&sheet, &holes, &Control::default()).unwrap();
        assert_filled(&sheet, &filled, 3);
        assert_eq!((filled.added.len(), &filled.left), (12 + 6 + 2, &vec![]));
        assert!((filled.surface.areas().iter().sum::<f64>() - 144.0).abs() < 1e-9);
        assert!(filled.surface.face_normals().iter().all(|n| n.z > 0.99));
        assert!(Topology::of(&filled.surface).is_disk());
    }

    #[test]
    fn what_cannot_be_filled_is_left() {
        let triangle = shapes::surface(shapes::sheet(1, 1)).part(&[true, false]);
        let rim = Topology::of(&triangle).loops;
        let filled = fill_holes(&triangle, &rim, &Control::default()).unwrap();
        assert_eq!((filled.left, filled.surface), (vec![0], triangle.clone()));
        // both triangles of the square exist: its other diagonal makes two more
        let square = shapes::surface(shapes::sheet(1, 1));
        let closed = fill_holes(&square, &Topology::of(&square).loops, &Control::default()).unwrap();
        assert!(closed.left.is_empty() && Topology::of(&closed.surface).loops.is_empty());
        // not of this surface, given twice, or torn
        let sheet = sheet_without(&[[2, 4, 2, 4]]);
        let hole = small_holes(&sheet, 100.0).remove(0);
        let mut torn = hole.clone();
        torn.half_edges.pop();
        let filled = fill_holes(&sheet, &[torn, hole.clone(), hole], &Control::default()).unwrap();
        assert_eq!(filled.left, [0, 2]);
        assert_eq!(fill_holes(&triangle, &small_holes(&sheet, 100.0), &Control::default()).unwrap().left, [0]);
    }

    #[test]
    fn a_slit_is_closed_again() {
        let sphere = shapes::surface(shapes::sphere(2));
        let open = sphere.cut_open([0]);
        let filled = fill_holes(&open, &Topology::of(&open).loops, &Control::default()).unwrap();
        assert_eq!(filled.surface, sphere);
        assert!(filled.added.is_empty());
    }

    proptest! {
        #[test]
        fn any_hole_is_filled_or_left(drop in prop::collection::vec(0..512usize, 1..60)) {
            let sphere = shapes::surface(shapes::sphere(3));
            let part = sphere.part(&(0..512).map(|f| !drop.contains(&f)).collect::<Vec<_>>());
            let holes = small_holes(&part, f64::INFINITY);
            let filled = fill_holes(&part, &holes, &Control::default()).unwrap();
            assert_filled(&part, &filled, holes.len());
            prop_assert!(filled.left.is_empty() || Topology::of(&part).components.len() > 1);
        }
    }

    #[test]
    fn a_triangle_costs_its_area_and_a_hundredth_of_its_squared_sides() {
        let cost = |x: f64| triangle_cost([[0.0; 3], [3.0, 0.0, 0.0], [x, 4.0, 0.0]].map(Vector3::from));
        assert!((cost(0.0) - (6.0 + 0.01 * (9.0 + 16.0 + 25.0))).abs() < 1e-12);
        assert!((cost(9.0) - (6.0 + 0.01 * (9.0 + 81.0 + 16.0 + 36.0 + 16.0))).abs() < 1e-12);
        assert_eq!(triangle_cost([0.0, 1.0, 2.0].map(Vector3::repeat)), f64::INFINITY);
    }
}
