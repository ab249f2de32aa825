//! The flat map as a raster: the position on the surface that each pixel shows.
//!
//! The positions in the plane are joined by a Delaunay triangulation. Its triangles within the map become faces, and
//! each pixel's centre is described by its face and barycentric coordinates. They determine its position on the surface
//! (linear), its surface voxel (the nearest corner) and any value of the points. A face is torn if its corners are
//! neighbours in the plane but not on the surface; its pixels show the nearest corner.

use nalgebra::Vector2;
use spade::{DelaunayTriangulation, HasPosition, Point2, Triangulation};

use crate::adjacency::Links;
use crate::error::{check_length, check_points};
use crate::lookup::is_inside;
use crate::surface::voxels::graph::VoxelGraph;
use crate::{Control, Error, Result};

/// The maximum number of pixels of an image: 10,000 by 10,000 take 2.4 GB.
const MOST_PIXELS: f64 = 1e8;

/// The longest side of a face of the map, as a multiple of the usual flat distance of neighbours.
const LONGEST_SIDE: f64 = 3.0;

/// Pixels of a flat map. Row 0 is at the top (largest v), and column 0 is on the left (smallest u).
#[derive(Debug, Clone, PartialEq)]
pub struct Raster {
    /// The number of columns.
    pub width: usize,
    /// The number of rows.
    pub height: usize,
    /// The side of a pixel in mm.
    pub pixel_size: f64,
    /// (u, v) of the centre of the pixel in row 0, column 0, in mm.
    pub origin: [f64; 2],
    /// For each pixel, row by row, the three vertices of its face; three times [`Raster::OUTSIDE`] outside the map.
    pub corners: Vec<[u32; 3]>,
    /// For each pixel, its barycentric coordinates in the face; NaN outside the map.
    pub weights: Vec<[f32; 3]>,
}

impl Raster {
    /// The vertex number of pixels outside the map.
    pub const OUTSIDE: u32 = u32::MAX;

    /// Draws faces in the plane. Pixels of a `torn` face show its nearest corner. The first of overlapping faces
    /// counts.
    ///
    /// # Errors
    /// [`Error::PixelSizeNotPositive`], [`Error::RasterTooLarge`], [`Error::NoSuchPoint`] or [`Error::WrongLength`] of
    /// the faces, and [`Error::Cancelled`].
    pub fn draw(uv: &[[f64; 2]], faces: &Faces, pixel_size: f64, control: &Control) -> Result<Self> {
        if !(pixel_size > 0.0 && pixel_size.is_finite()) {
            return Err(Error::PixelSizeNotPositive { pixel_size });
        }
        check_points(faces.corners.iter().flatten().copied(), uv.len())?;
        check_length("marks of torn faces", faces.torn.len(), "faces", faces.corners.len())?;
        let mut raster = Self::blank(uv, pixel_size)?;
        control.begin("drawing the map", faces.corners.len() as u64);
        for (&face, &torn) in faces.corners.iter().zip(&faces.torn) {
            control.check()?;
            raster.paint(uv, face, torn);
            control.advance();
        }
        Ok(raster)
    }

    /// Covers all positions. Pixel centres lie at multiples of the pixel size, so that rasters align.
    fn blank(uv: &[[f64; 2]], pixel_size: f64) -> Result<Self> {
        let extreme = |axis: usize, least: bool| {
            let values = uv.iter().map(|place| place[axis] / pixel_size);
            if least {
                values.fold(f64::INFINITY, f64::min).floor()
            } else {
                values.fold(f64::NEG_INFINITY, f64::max).ceil()
            }
        };
        let (left, right) = (extreme(0, true), extreme(0, false));
        let (bottom, top) = (extreme(1, true), extreme(1, false));
        let (width, height) = (right - left + 1.0, top - bottom + 1.0);
        if !(width * height).is_finite() || width * height > MOST_PIXELS {
            return Err(Error::RasterTooLarge { width, height, pixel_size });
        }
        let (width, height) = (width as usize, height as usize);
        Ok(Self {
            width,
            height,
            pixel_size,
            origin: [left * pixel_size, top * pixel_size],
            corners: vec![[Self::OUTSIDE; 3]; width * height],
            weights: vec![[f32::NAN; 3]; width * height],
        })
    }

    fn paint(&mut self, uv: &[[f64; 2]], face: [u32; 3], torn: bool) {
        // in pixels: x to the right, y down, pixel centres at integers
        let corners = face.map(|vertex| {
            let [u, v] = uv[vertex as usize];
            Vector2::new((u - self.origin[0]) / self.pixel_size, (self.origin[1] - v) / self.pixel_size)
        });
        let [a, b, c] = corners;
        let area = (b - a).perp(&(c - a));
        if area == 0.0 {
            return;
        }
        let bounds = |axis: usize, size: usize| {
            let low = corners.iter().fold(f64::INFINITY, |low, p| low.min(p[axis])).ceil().max(0.0);
            let high = corners.iter().fold(f64::NEG_INFINITY, |high, p| high.max(p[axis])).floor();
            low as usize..(high as usize + 1).min(size)
        };
        for row in bounds(1, self.height) {
            for column in bounds(0, self.width) {
                let p = Vector2::new(column as f64, row as f64);
                let weights =
                    [(c - b).perp(&(p - b)), (a - c).perp(&(p - c)), (b - a).perp(&(p - a))].map(|w| w / area);
                let pixel = row * self.width + column;
                if is_inside(&weights) && self.corners[pixel][0] == Self::OUTSIDE {
                    self.corners[pixel] = face;
                    let apart = corners.map(|corner| (corner - p).norm_squared());
                    let nearest = (0..3).min_by(|&k, &l| apart[k].total_cmp(&apart[l])).unwrap_or(0);
                    let only = |k| if k == nearest { 1.0 } else { 0.0 };
                    self.weights[pixel] = if torn { [0, 1, 2].map(only) } else { weights.map(|w| w as f32) };
                }
            }
        }
    }
}

#[derive(Clone, Copy)]
struct Place {
    position: Point2<f64>,
    vertex: u32,
}

impl HasPosition for Place {
    type Scalar = f64;
    fn position(&self) -> Point2<f64> {
        self.position
    }
}

/// Triangles that cover a flat map.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Faces {
    /// The three vertices of each face, the lowest first, counterclockwise in the plane.
    pub corners: Vec<[u32; 3]>,
    /// Whether two corners are more than two links apart on the surface: the map is compressed or folded there.
    pub torn: Vec<bool>,
}

/// Joins the positions of a map into faces: the Delaunay triangles whose sides are about as short in the plane as those
/// between neighbours on the surface. Of coincident positions, only one becomes a corner.
///
/// # Errors
/// [`Error::WrongLength`] if there is not one position per vertex of the graph, [`Error::TooFewPoints`] if the
/// positions do not span a triangle, and [`Error::Cancelled`].
pub fn map_faces(uv: &[[f64; 2]], graph: &VoxelGraph, control: &Control) -> Result<Faces> {
    control.check()?;
    check_length("positions", uv.len(), "vertices", graph.vertices())?;
    let places =
        uv.iter().enumerate().map(|(vertex, &[u, v])| Place { position: Point2::new(u, v), vertex: vertex as u32 });
    let too_few = |_| Error::TooFewPoints { points: uv.len(), needed: 3 };
    let triangulation = DelaunayTriangulation::<Place>::bulk_load_stable(places.collect()).map_err(too_few)?;
    control.check()?;
    let longest = LONGEST_SIDE * usual_step(uv, graph);
    let sides = |[a, b, c]: [u32; 3]| [(a, b), (b, c), (c, a)];
    let short = |(a, b): (u32, u32)| {
        let ([u, v], [x, y]) = (uv[a as usize], uv[b as usize]);
        (u - x).hypot(v - y) <= longest
    };
    let mut corners: Vec<[u32; 3]> = triangulation
        .inner_faces()
        .map(|face| face.vertices().map(|vertex| vertex.data().vertex))
        .filter(|&face| sides(face).into_iter().all(short))
        .collect();
    corners.iter_mut().for_each(rotate_lowest_first);
    corners.sort_unstable();
    if corners.is_empty() {
        return Err(Error::TooFewPoints { points: uv.len(), needed: 3 });
    }
    let torn =
        corners.iter().map(|&face| !sides(face).into_iter().all(|(a, b)| within_two_links(graph, a, b))).collect();
    Ok(Faces { corners, torn })
}

/// Returns the median flat distance between neighbours in mm.
pub(crate) fn usual_step(uv: &[[f64; 2]], graph: &VoxelGraph) -> f64 {
    let steps = |v: usize| {
        let [x, y] = uv[v];
        graph.arcs(v as u32).map(move |arc| (uv[arc.to as usize][0] - x).hypot(uv[arc.to as usize][1] - y))
    };
    let mut steps: Vec<f64> = (0..uv.len()).flat_map(steps).collect();
    if steps.is_empty() {
        return f64::NAN;
    }
    let middle = steps.len() / 2;
    *steps.select_nth_unstable_by(middle, f64::total_cmp).1
}

fn within_two_links(graph: &VoxelGraph, a: u32, b: u32) -> bool {
    let joined = |x: u32| graph.arcs(x).any(|arc| arc.to == b);
    joined(a) || graph.arcs(a).any(|arc| joined(arc.to))
}

fn rotate_lowest_first(face: &mut [u32; 3]) {
    let lowest = (0..3).min_by_key(|&k| face[k]).unwrap_or(0);
    face.rotate_left(lowest);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::chained;
    use crate::volume::Mask;
    use proptest::prelude::*;

    fn draw(uv: &[[f64; 2]], corners: &[[u32; 3]], torn: bool, pixel_size: f64) -> Raster {
        let faces = Faces { corners: corners.to_vec(), torn: vec![torn; corners.len()] };
        Raster::draw(uv, &faces, pixel_size, &Control::default()).unwrap()
    }

    fn centre(raster: &Raster, pixel: usize) -> [f64; 2] {
        let (row, column) = (pixel / raster.width, pixel % raster.width);
        [raster.origin[0] + column as f64 * raster.pixel_size, raster.origin[1] - row as f64 * raster.pixel_size]
    }

    proptest! {
        #[test]
        fn weights_give_back_the_pixels_place(corners in prop::array::uniform3(prop::array::uniform2(-9.0..9.0f64)), size in 0.1..1.0f64) {
            let raster = draw(&corners, &[[0, 1, 2]], false, size);
            let [[ax, ay], [bx, by], [cx, cy]] = corners;
            let area = 0.5 * ((bx - ax) * (cy - ay) - (cx - ax) * (by - ay)).abs();
            let mut inside = 0;
            for (pixel, weights) in raster.weights.iter().enumerate().filter(|(_, w)| !w[0].is_nan()) {
                let place: [f64; 2] = std::array::from_fn(|k| (0..3).map(|c| f64::from(weights[c]) * corners[c][k]).sum());
                let [u, v] = centre(&raster, pixel);
                prop_assert!((place[0] - u).hypot(place[1] - v) < 1e-4);
                inside += 1;
            }
            let perimeter = (ax - bx).hypot(ay - by) + (bx - cx).hypot(by - cy) + (cx - ax).hypot(cy - ay);
            prop_assert!((f64::from(inside) * size * size - area).abs() <= 2.0 * size * perimeter + 4.0 * size * size);
        }
    }

    #[test]
    fn faces_that_share_a_side_leave_no_gap() {
        let uv = [[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]];
        let raster = draw(&uv, &[[0, 1, 2], [0, 2, 3]], false, 0.5);
        assert_eq!((raster.width, raster.height, raster.origin), (21, 21, [0.0, 10.0]));
        assert!(raster.weights.iter().all(|w| !w[0].is_nan()));
        for (pixel, vertex) in [(0, 3), (20, 2), (20 * 21, 0), (21 * 21 - 1, 1)] {
            let corner = raster.corners[pixel].iter().position(|&corner| corner == vertex).unwrap();
            assert_eq!(raster.weights[pixel][corner], 1.0);
        }
    }

    #[test]
    fn a_torn_face_shows_its_nearest_corner() {
        let uv = [[0.0, 0.0], [10.0, 0.0], [0.0, 10.0]];
        let raster = draw(&uv, &[[0, 1, 2]], true, 0.5);
        for (pixel, weights) in raster.weights.iter().enumerate().filter(|(_, w)| !w[0].is_nan()) {
            let [u, v] = centre(&raster, pixel);
            let apart = uv.map(|[x, y]| (x - u).hypot(y - v));
            let shown = weights.iter().position(|&w| w == 1.0).unwrap();
            assert_eq!(weights.iter().sum::<f32>(), 1.0);
            assert!(apart.iter().all(|&other| apart[shown] <= other + 1e-9));
        }
    }

    #[test]
    fn bad_pixel_sizes_are_refused() {
        let uv = [[0.0, 0.0], [10.0, 0.0], [0.0, 10.0]];
        let faces = Faces { corners: vec![[0, 1, 2]], torn: vec![false] };
        let draw = |size| Raster::draw(&uv, &faces, size, &Control::default()).unwrap_err();
        for pixel_size in [0.0, -1.0, f64::INFINITY] {
            assert_eq!(draw(pixel_size), Error::PixelSizeNotPositive { pixel_size });
        }
        assert!(matches!(draw(f64::NAN), Error::PixelSizeNotPositive { .. }));
        assert!(matches!(draw(1e-7), Error::RasterTooLarge { .. }));
    }

    #[test]
    fn a_flat_sheet_is_covered_by_its_faces_and_a_hole_is_not() {
        let hole = |i: usize, j: usize| (8..14).contains(&i) && (8..14).contains(&j);
        let mask = Mask::from_fn([20, 20, 1], |[i, j, _]| !hole(i, j)).unwrap();
        let control = Control::default();
        let (surface, graph) = chained(&mask, [1.0; 3]);
        let uv: Vec<[f64; 2]> = surface.voxels().iter().map(|v| [f64::from(v[0]), f64::from(v[1])]).collect();
        let faces = map_faces(&uv, &graph, &control).unwrap();
        let whole = faces.torn.iter().filter(|&&torn| !torn).count();
        let sheet = 2 * (19 * 19 - 7 * 7);
        assert!((sheet..=sheet + 8).contains(&whole), "{whole}: each corner of the hole may be rounded by two faces");
        // the hole is open except for its corners
        let raster = Raster::draw(&uv, &faces, 0.5, &control).unwrap();
        let open = raster.weights.iter().filter(|w| w[0].is_nan()).count();
        assert!(open > 100 && open <= 13 * 13, "{open}");
        for face in &faces.corners {
            let [a, b, c] = face.map(|v| uv[v as usize]);
            assert!((b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]) > 0.0, "counterclockwise");
        }
    }

    #[test]
    fn the_usual_step_is_the_median() {
        let (_, graph) = chained(&Mask::from_fn([6, 1, 1], |_| true).unwrap(), [1.0; 3]);
        let uv = [0.0, 1.0, 3.0, 6.0, 10.0, 20.0].map(|u| [u, 0.0]);
        assert_eq!(usual_step(&uv, &graph), 3.0);
    }

    #[test]
    fn faces_bridge_gaps_up_to_three_usual_steps() {
        let (surface, graph) = chained(&Mask::from_fn([20, 3, 1], |_| true).unwrap(), [1.0; 3]);
        for gap in [1.0, 2.8, 2.9, 5.0] {
            let moved = |x: f64| if x < 10.0 { x } else { x + gap - 1.0 };
            let uv: Vec<[f64; 2]> = surface.voxels().iter().map(|v| [moved(v[0].into()), v[1].into()]).collect();
            assert_eq!(usual_step(&uv, &graph), 1.0);
            let faces = map_faces(&uv, &graph, &Control::default()).unwrap();
            let is_left = |&vertex: &u32| uv[vertex as usize][0] < 10.0;
            let across =
                faces.corners.iter().filter(|face| face.iter().any(is_left) && !face.iter().all(is_left)).count();
            assert_eq!(across, if gap.hypot(1.0) <= 3.0 { 4 } else { 0 }, "{gap}"); // the diagonal is the longest side
        }
    }

    #[test]
    fn faces_are_torn_if_two_corners_are_more_than_two_links_apart() {
        for (hole, is_torn) in [(1, false), (2, true)] {
            let is_hole = |i: usize, j: usize| (5..5 + hole).contains(&i) && j == 4;
            let mask = Mask::from_fn([12, 9, 1], |[i, j, _]| !is_hole(i, j));
            let (surface, graph) = chained(&mask.unwrap(), [1.0; 3]);
            let uv: Vec<[f64; 2]> = surface.voxels().iter().map(|v| [v[0].into(), v[1].into()]).collect();
            let faces = map_faces(&uv, &graph, &Control::default()).unwrap();
            let apart = |a: u32, b: u32| {
                let near = |x: u32| graph.arcs(x).map(|arc| arc.to).collect::<Vec<_>>();
                near(a).contains(&b) || near(a).into_iter().any(|c| near(c).contains(&b))
            };
            for (face, &torn) in faces.corners.iter().zip(&faces.torn) {
                let [a, b, c] = *face;
                assert_eq!(torn, !(apart(a, b) && apart(b, c) && apart(c, a)));
            }
            let spans_two = |&[a, b, c]: &[u32; 3]| {
                [(a, b), (b, c), (c, a)].iter().any(|&(a, b)| {
                    let ([u, v], [x, y]) = (uv[a as usize], uv[b as usize]);
                    (u - x).abs().max((v - y).abs()) >= 2.0
                })
            };
            assert!(faces.corners.iter().any(spans_two), "{hole}");
            assert_eq!(faces.torn.contains(&true), is_torn, "{hole}"); // along the diagonal of two squares
        }
    }
}
