//! The exact nearest point on the triangles of a surface.

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::error::check_length;
use crate::{Control, Result};

/// The number of boxes in each node of the tree.
const FAN: usize = 8;

/// The number of points that one worker looks up between two checks for cancellation.
const CHUNK: usize = 1024;

/// A point on a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Nearest {
    /// The triangle that contains it; the first of several.
    pub triangle: u32,
    /// Its barycentric coordinates.
    pub weights: [f64; 3],
    /// Its distance from the query point in mm.
    pub distance: f64,
}

/// Finds the nearest point on a surface, by a tree of bounding boxes of its triangles.
#[derive(Debug, Clone)]
pub struct NearestFinder {
    /// The triangles along a space-filling curve, so that those of a node lie next to each other in memory.
    corners: Vec<[Vector3<f64>; 3]>,
    /// The number of each of them.
    order: Vec<u32>,
    /// The origin of the boxes, in the middle of the surface.
    origin: Vector3<f64>,
    /// The levels of the tree. The boxes of the first contain one triangle each, in that order; the last level is one
    /// node.
    levels: Vec<Vec<Node>>,
}

/// The bounding boxes of up to [`FAN`] children, one list per axis, so that their distances are computed together.
/// They are relative to the origin, in single precision, and widened by more than the errors of rounding. The distances
/// to them are therefore lower bounds, and results are the same as with exact boxes.
#[derive(Debug, Clone, Copy)]
struct Node {
    low: [[f32; FAN]; 3],
    high: [[f32; FAN]; 3],
    children: usize,
}

/// The width by which boxes are widened, relative to the size of the surface. Single precision rounds to 2⁻²⁴.
const WIDENED: f64 = 1.0 / (1 << 20) as f64;

/// A factor that lowers the squares of distances by more than the errors of rounding of a distant point.
const LOWERED: f32 = 1.0 - 1e-5;

/// The farthest position of a box or a point; its square does not overflow.
const FARTHEST: f64 = 1e18;

#[derive(Debug, Clone, Copy)]
struct Bounds {
    low: Vector3<f64>,
    high: Vector3<f64>,
}

/// The nearest triangle so far.
#[derive(Debug, Clone, Copy)]
struct Best {
    /// The square of its distance, or of the limit.
    square: f64,
    triangle: u32,
    weights: [f64; 3],
    /// Its position along the curve.
    position: usize,
}

/// No triangle.
const NONE: u32 = u32::MAX;

impl NearestFinder {
    /// Creates a finder from the corners of triangles in mm.
    pub fn new(corners: &[[[f64; 3]; 3]]) -> Self {
        let corners: Vec<[Vector3<f64>; 3]> = corners.iter().map(|triangle| triangle.map(Vector3::from)).collect();
        let bounds: Vec<Bounds> = corners.iter().map(Bounds::of).collect();
        let all = bounds.iter().copied().reduce(Bounds::with);
        let mut keyed: Vec<(u64, u32)> =
            bounds.iter().map(|b| all.map_or(0, |all| all.curve_position(b))).zip(0..).collect();
        keyed.par_sort_unstable();
        let order: Vec<u32> = keyed.into_iter().map(|(_, n)| n).collect();
        let corners = order.iter().map(|&n| corners[n as usize]).collect();
        let mut below: Vec<Bounds> = order.iter().map(|&n| bounds[n as usize]).collect();
        let origin = all.map_or(Vector3::zeros(), |all| 0.5 * (all.low + all.high));
        let margin = all.map_or(0.0, |all| WIDENED * (all.high - all.low).max());
        let mut levels = Vec::new();
        while levels.is_empty() || below.len() > 1 {
            levels.push(below.chunks(FAN).map(|few| Node::of(few, &origin, margin)).collect());
            below = below.chunks(FAN).filter_map(|few| few.iter().copied().reduce(Bounds::with)).collect();
        }
        Self { corners, order, origin, levels }
    }

    /// Returns the nearest point on the surface within `limit` mm. None for points that are not finite.
    pub fn find(&self, point: [f64; 3], limit: f64) -> Option<Nearest> {
        self.find_from(point, limit, None).map(|(near, _)| near)
    }

    /// Calls [`find`](Self::find), and also returns the position of the triangle along the curve. A triangle that is
    /// probably near, given by such a position, shortens the search and does not change the result.
    fn find_from(&self, point: [f64; 3], limit: f64, near: Option<usize>) -> Option<(Nearest, usize)> {
        let point = Vector3::from(point);
        if !point.iter().all(|x| x.is_finite()) || self.corners.is_empty() || limit.is_nan() || limit < 0.0 {
            return None;
        }
        let mut best = Best { square: limit * limit, triangle: NONE, weights: [f64::NAN; 3], position: 0 };
        if let Some(position) = near {
            self.compare(position, &point, &mut best);
        }
        let place = (point - self.origin).map(|x| x.clamp(-FARTHEST, FARTHEST) as f32);
        self.search(self.levels.len() - 1, 0, &point, &place, &mut best);
        let Best { square, triangle, weights, position } = best;
        (triangle != NONE).then(|| (Nearest { triangle, weights, distance: square.sqrt() }, position))
    }

    /// Searches below one node, the nearest child first. `place` is the point relative to the origin.
    fn search(&self, level: usize, node: usize, point: &Vector3<f64>, place: &Vector3<f32>, best: &mut Best) {
        let boxes = &self.levels[level][node];
        let squares = boxes.squares_to(place);
        let mut near = [(0.0f32, 0usize); FAN]; // in ascending order
        let mut count = 0;
        for (child, &square) in squares.iter().enumerate().take(boxes.children) {
            if f64::from(square) <= best.square {
                let mut at = count;
                while at > 0 && near[at - 1].0 > square {
                    near[at] = near[at - 1];
                    at -= 1;
                }
                near[at] = (square, child);
                count += 1;
            }
        }
        for &(square, child) in &near[..count] {
            if f64::from(square) > best.square {
                return;
            }
            let child = node * FAN + child;
            match level {
                0 => self.compare(child, point, best),
                _ => self.search(level - 1, child, point, place, best),
            }
        }
    }

    /// Takes a triangle if it is nearer, or as near and the first.
    fn compare(&self, position: usize, point: &Vector3<f64>, best: &mut Best) {
        let corners = &self.corners[position];
        let weights = nearest_weights(corners, point);
        let square = (place(corners, &weights) - point).norm_squared();
        let triangle = self.order[position];
        if square < best.square || (square == best.square && triangle < best.triangle) {
            *best = Best { square, triangle, weights, position };
        }
    }

    /// Calls [`find`](Self::find) for many points in parallel. It is fastest if successive points are near each other.
    ///
    /// # Errors
    /// [`Error::Cancelled`](crate::Error::Cancelled).
    pub fn find_all(&self, points: &[[f64; 3]], limit: f64, control: &Control) -> Result<Vec<Option<Nearest>>> {
        control.begin("finding the nearest points", points.len().div_ceil(CHUNK) as u64);
        let of_chunk = |few: &[[f64; 3]]| {
            control.check()?;
            let mut last = None;
            let found = few.iter().map(|&point| {
                let found = self.find_from(point, limit, last);
                last = found.map(|(_, position)| position).or(last);
                found.map(|(near, _)| near)
            });
            let found = found.collect();
            control.advance();
            Ok(found)
        };
        Ok(points.par_chunks(CHUNK).map(of_chunk).collect::<Result<Vec<Vec<_>>>>()?.concat())
    }
}

impl NearestFinder {
    /// Returns the nearest points on the surface, and the distances to them in mm, which are negative where the vector
    /// from there is opposed to the normal. `normals` are those of the corners of each triangle, which may be zero.
    ///
    /// # Errors
    /// [`Error::WrongLength`](crate::Error::WrongLength) if there are not three normals per triangle, and
    /// [`Error::Cancelled`](crate::Error::Cancelled).
    pub fn sides(
        &self, points: &[[f64; 3]], normals: &[[[f64; 3]; 3]], control: &Control,
    ) -> Result<(Vec<[f64; 3]>, Vec<f64>)> {
        check_length("normals", normals.len(), "triangles", self.corners.len())?;
        control.begin("measuring depth", points.len().div_ceil(CHUNK) as u64);
        let mut feet = vec![[f64::NAN; 3]; points.len()];
        let mut distances = vec![f64::NAN; points.len()];
        let chunks = points.par_chunks(CHUNK).zip(feet.par_chunks_mut(CHUNK)).zip(distances.par_chunks_mut(CHUNK));
        chunks.try_for_each(|((points, feet), distances)| {
            control.check()?;
            let mut last = None;
            for ((&point, foot), distance) in points.iter().zip(feet).zip(distances) {
                let Some((near, position)) = self.find_from(point, f64::INFINITY, last) else { continue };
                last = Some(position);
                let nearest = place(&self.corners[position], &near.weights);
                let normal = place(&normals[near.triangle as usize].map(Vector3::from), &near.weights);
                let is_inside = (Vector3::from(point) - nearest).dot(&normal) < 0.0;
                *foot = nearest.into();
                *distance = if is_inside { -near.distance } else { near.distance };
            }
            control.advance();
            Ok(())
        })?;
        Ok((feet, distances))
    }
}

impl Node {
    fn of(children: &[Bounds], origin: &Vector3<f64>, margin: f64) -> Self {
        let mut node = Self { low: [[0.0; FAN]; 3], high: [[0.0; FAN]; 3], children: children.len() };
        let rounded = |x: f64| x.clamp(-FARTHEST, FARTHEST) as f32;
        for (n, child) in children.iter().enumerate() {
            for axis in 0..3 {
                node.low[axis][n] = rounded(child.low[axis] - origin[axis] - margin);
                node.high[axis][n] = rounded(child.high[axis] - origin[axis] + margin);
            }
        }
        node
    }

    /// Returns lower bounds of the squared distances of a point to the boxes; 0 inside.
    fn squares_to(&self, place: &Vector3<f32>) -> [f32; FAN] {
        let mut squares = [0.0; FAN];
        for axis in 0..3 {
            for n in 0..FAN {
                let (below, above) = (self.low[axis][n] - place[axis], place[axis] - self.high[axis][n]);
                let beyond = if below > above { below } else { above };
                let beyond = if beyond > 0.0 { beyond } else { 0.0 };
                squares[n] += beyond * beyond;
            }
        }
        squares.map(|square| LOWERED * square)
    }
}

impl Bounds {
    fn of(corners: &[Vector3<f64>; 3]) -> Self {
        let [a, b, c] = corners;
        Self { low: a.inf(b).inf(c), high: a.sup(b).sup(c) }
    }

    fn with(self, other: Self) -> Self {
        Self { low: self.low.inf(&other.low), high: self.high.sup(&other.high) }
    }

    /// Returns the position of another box's centre along the Z-order curve through this box.
    fn curve_position(&self, other: &Self) -> u64 {
        const STEPS: f64 = ((1 << 20) - 1) as f64;
        let size = (self.high - self.low).max();
        let at = 0.5 * (other.low + other.high) - self.low;
        (0..3).fold(0, |key, axis| key | spread((at[axis] / size * STEPS) as u64) << axis)
    }
}

/// Spreads twenty bits of a number to every third position.
fn spread(bits: u64) -> u64 {
    (0..20).fold(0, |spread, n| spread | (bits >> n & 1) << (3 * n))
}

fn place(corners: &[Vector3<f64>; 3], weights: &[f64; 3]) -> Vector3<f64> {
    corners[0] * weights[0] + corners[1] * weights[1] + corners[2] * weights[2]
}

/// Returns the barycentric coordinates of the nearest point of a triangle: the projection, or the nearest point of a
/// side. Triangles without area have only sides.
fn nearest_weights(corners: &[Vector3<f64>; 3], point: &Vector3<f64>) -> [f64; 3] {
    let [a, b, c] = corners.map(|corner| corner - point);
    let normal = (b - a).cross(&(c - a));
    let square = normal.norm_squared();
    // barycentric coordinates of the projection: signed areas of the parts over the area, along the normal
    let inside = [b.cross(&c), c.cross(&a), a.cross(&b)].map(|part| part.dot(&normal) / square);
    if inside.iter().all(|&weight| weight >= 0.0) {
        return inside; // not taken if NaN, in a triangle without area
    }
    let sides = [0, 1, 2].map(|k| {
        let (from, to) = (k, (k + 1) % 3);
        let (start, way) = (corners[from] - point, corners[to] - corners[from]);
        let along = -start.dot(&way) / way.norm_squared();
        let along = if along.is_nan() { 0.0 } else { along.clamp(0.0, 1.0) };
        let mut weights = [0.0; 3];
        weights[from] = 1.0 - along;
        weights[to] = along;
        ((start + way * along).norm_squared(), weights)
    });
    let [mut best, second, third] = sides;
    for side in [second, third] {
        if side.0 < best.0 {
            best = side;
        }
    }
    best.1
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn to_place(triangle: &[[f64; 3]; 3], weights: [f64; 3], point: [f64; 3]) -> f64 {
        (place(&triangle.map(Vector3::from), &weights) - Vector3::from(point)).norm()
    }

    proptest! {
        #[test]
        fn no_place_of_any_triangle_is_nearer(
            triangles in prop::collection::vec(
                prop::array::uniform3(prop::array::uniform3((-9..9i32).prop_map(f64::from))), 1..40),
            points in prop::collection::vec(prop::array::uniform3(-12.0..12.0f64), 20),
            weights in prop::collection::vec(prop::array::uniform3(0.0..1.0f64), 40),
        ) {
            let finder = NearestFinder::new(&triangles);
            for point in points {
                let found = finder.find(point, f64::INFINITY).unwrap();
                let own = to_place(&triangles[found.triangle as usize], found.weights, point);
                prop_assert!((own - found.distance).abs() < 1e-9);
                prop_assert!((found.weights.iter().sum::<f64>() - 1.0).abs() < 1e-9);
                prop_assert!(found.weights.iter().all(|&weight| weight >= 0.0));
                for triangle in &triangles { // at random places, sides and corners of all triangles
                    for &[x, y, z] in &weights {
                        for [x, y, z] in [[x, y, z + 1e-9], [x, y + 1e-9, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]] {
                            let sum = x + y + z;
                            prop_assert!(to_place(triangle, [x / sum, y / sum, z / sum], point) >= found.distance - 1e-9);
                        }
                    }
                }
                prop_assert_eq!(finder.find(point, found.distance * 1.001).map(|near| near.triangle), Some(found.triangle));
                prop_assert_eq!(finder.find(point, found.distance * 0.999), None);
            }
        }
    }

    proptest! {
        #[test]
        fn neither_the_origin_nor_the_distance_changes_the_nearest_triangle(
            triangles in prop::collection::vec(
                prop::array::uniform3(prop::array::uniform3((-9..9i32).prop_map(f64::from))), 1..60),
            points in prop::collection::vec(prop::array::uniform3((-80..80i32).prop_map(f64::from)), 20),
            shift in (-1..2i32).prop_map(|n| f64::from(n) * 65536.0),
            farther in 0..3u32,
        ) {
            let moved: Vec<_> =
                triangles.iter().map(|triangle| triangle.map(|corner| corner.map(|x| x + shift))).collect();
            let finder = NearestFinder::new(&moved);
            for point in points {
                let point = point.map(|x| x / 8.0 * 100f64.powi(farther as i32) + shift);
                let best = |triangle: &[[f64; 3]; 3]| {
                    let corners = triangle.map(Vector3::from);
                    (place(&corners, &nearest_weights(&corners, &point.into())) - Vector3::from(point)).norm_squared()
                };
                let squares: Vec<f64> = moved.iter().map(best).collect();
                let least = squares.iter().copied().fold(f64::INFINITY, f64::min);
                let found = finder.find(point, f64::INFINITY).unwrap();
                prop_assert_eq!(found.distance, least.sqrt());
                prop_assert_eq!(found.triangle as usize, squares.iter().position(|&square| square == least).unwrap());
            }
        }
    }

    #[test]
    fn sides_are_signed_by_the_normals() {
        let finder = NearestFinder::new(&[[[0.0; 3], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]]]);
        let control = Control::default();
        let points = [[1.0, 1.0, 2.0], [1.0, 1.0, -3.0], [-2.0, 1.0, 0.0], [f64::NAN; 3]];
        let (feet, distances) = finder.sides(&points, &[[[0.0, 0.0, 1.0]; 3]], &control).unwrap();
        assert_eq!(feet[..3], [[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]);
        assert_eq!(distances[..3], [2.0, -3.0, 2.0]);
        assert!(distances[3].is_nan() && feet[3][0].is_nan());
        assert_eq!(finder.sides(&points[..2], &[[[0.0; 3]; 3]], &control).unwrap().1, [2.0, 3.0]);
        assert!(finder.sides(&points, &[], &control).is_err());
        control.cancel();
        assert_eq!(finder.sides(&points, &[[[0.0; 3]; 3]], &control), Err(crate::Error::Cancelled));
    }

    #[test]
    fn points_far_beyond_single_precision_have_a_nearest_triangle() {
        let finder = NearestFinder::new(&[[[0.0; 3]; 3], [[1e30, 0.0, 0.0]; 3], [[-1e30, 0.0, 0.0]; 3]]);
        for (x, expected) in [(4e29, 0), (6e29, 1), (1e31, 1), (-6e29, 2), (1.0, 0)] {
            assert_eq!(finder.find([x, 0.0, 0.0], f64::INFINITY).map(|near| near.triangle), Some(expected), "{x}");
        }
    }

    #[test]
    fn the_first_of_equal_ones_is_taken_and_nonsense_has_none() {
        let square = [[[0.0; 3], [4.0, 0.0, 0.0], [4.0, 4.0, 0.0]], [[0.0; 3], [4.0, 4.0, 0.0], [0.0, 4.0, 0.0]]];
        let finder = NearestFinder::new(&square);
        assert_eq!(finder.find([2.0, 2.0, 1.0], 9.0).map(|near| (near.triangle, near.distance)), Some((0, 1.0)));
        for point in [[f64::NAN, 0.0, 0.0], [0.0, f64::INFINITY, 0.0]] {
            assert_eq!(finder.find(point, f64::INFINITY), None);
        }
        assert_eq!(finder.find([0.0; 3], f64::NAN), None);
        assert_eq!(finder.find([0.0; 3], 0.0).map(|near| near.distance), Some(0.0));
        assert_eq!(NearestFinder::new(&[]).find([0.0; 3], 1.0), None);
        let dot = NearestFinder::new(&[[[1.0, 0.0, 0.0]; 3]]);
        assert_eq!(dot.find([0.0; 3], 2.0).map(|near| near.distance), Some(1.0));
        let control = Control::default();
        let points = vec![[1.0, 3.0, 2.0]; 3 * CHUNK];
        assert_eq!(
            finder.find_all(&points, 9.0, &control).unwrap(),
            vec![finder.find([1.0, 3.0, 2.0], 9.0); 3 * CHUNK]
        );
        control.cancel();
        assert_eq!(finder.find_all(&points, 9.0, &control), Err(crate::Error::Cancelled));
    }
}
