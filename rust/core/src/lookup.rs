//! The inverse lookup: the triangle at a position in the plane, and the barycentric coordinates in it.

use nalgebra::Vector2;

use crate::{Control, Result};

/// The tolerance in barycentric coordinates, so that positions on a common side lie in at least one triangle.
const SLACK: f64 = 1e-9;

/// The number of positions that one worker looks up between two checks for cancellation.
const CHUNK: usize = 4096;

/// A triangle, and barycentric coordinates in it.
pub type InTriangle = (u32, [f64; 3]);

/// Finds the triangles that contain positions in the plane, by a grid with about as many cells as triangles.
#[derive(Debug, Clone)]
pub struct TriangleFinder {
    corners: Vec<[Vector2<f64>; 3]>,
    /// The lower corner of the grid, in mm.
    low: Vector2<f64>,
    /// The side of a cell in mm.
    side: f64,
    /// The numbers of cells along u and v.
    shape: [usize; 2],
    /// Where the triangles of each cell begin, row by row.
    starts: Vec<usize>,
    /// The triangles whose bounding boxes meet each cell, ascending.
    inside: Vec<u32>,
}

impl TriangleFinder {
    /// Creates a finder from the corners of triangles in mm.
    pub fn new(corners: &[[[f64; 2]; 3]]) -> Self {
        let corners: Vec<[Vector2<f64>; 3]> = corners.iter().map(|triangle| triangle.map(Vector2::from)).collect();
        let (low, high) = bounds(corners.as_flattened());
        let (size, count) = (high - low, corners.len().max(1) as f64);
        let mut side = (size.x * size.y / count).sqrt();
        if side == 0.0 {
            side = if size.max() > 0.0 { size.max() } else { 1.0 };
        }
        let side = side.max(size.max() / (4.0 * count)); // also limits the number of cells of a long thin map
        let shape = [size.x, size.y].map(|size| (size / side).floor() as usize + 1);
        let mut finder = Self { corners, low, side, shape, starts: Vec::new(), inside: Vec::new() };
        finder.sort_into_cells();
        finder
    }

    fn sort_into_cells(&mut self) {
        let cells: Vec<[[usize; 2]; 2]> = self.corners.iter().map(|triangle| self.cells_of(triangle)).collect();
        let [columns, rows] = self.shape;
        let reached = |&[[u, v], [last_u, last_v]]: &[[usize; 2]; 2]| {
            (v..=last_v).flat_map(move |v| (u..=last_u).map(move |u| v * columns + u))
        };
        let mut starts = vec![0; columns * rows + 1];
        cells.iter().flat_map(reached).for_each(|cell| starts[cell + 1] += 1);
        (1..starts.len()).for_each(|cell| starts[cell] += starts[cell - 1]);
        let mut next = starts.clone();
        let mut inside = vec![0; starts[columns * rows]];
        for (triangle, cells) in (0..).zip(&cells) {
            for cell in reached(cells) {
                inside[next[cell]] = triangle;
                next[cell] += 1;
            }
        }
        (self.starts, self.inside) = (starts, inside);
    }

    /// Returns the first and the last cell, along u and v, that the bounding box of a triangle meets.
    fn cells_of(&self, triangle: &[Vector2<f64>; 3]) -> [[usize; 2]; 2] {
        let (low, high) = bounds(triangle);
        [low, high].map(|corner| {
            let cell = (corner - self.low) / self.side;
            [0, 1].map(|axis| (cell[axis].floor() as usize).min(self.shape[axis] - 1))
        })
    }

    /// Returns the first triangle that contains a position, and its barycentric coordinates there.
    pub fn find(&self, place: [f64; 2]) -> Option<InTriangle> {
        let place = Vector2::from(place);
        let mut cell = [0; 2];
        for axis in 0..2 {
            let number = ((place[axis] - self.low[axis]) / self.side).floor();
            let cells = self.shape[axis] as f64;
            if !(0.0..=cells).contains(&number) {
                return None; // also if not finite
            }
            cell[axis] = (number as usize).min(self.shape[axis] - 1); // the upper border
        }
        let cell = cell[1] * self.shape[0] + cell[0];
        self.inside[self.starts[cell]..self.starts[cell + 1]].iter().find_map(|&triangle| {
            let weights = barycentric(&self.corners[triangle as usize], place);
            is_inside(&weights).then_some((triangle, weights))
        })
    }

    /// Calls [`find`](Self::find) for many positions in parallel.
    ///
    /// # Errors
    /// [`Error::Cancelled`](crate::Error::Cancelled).
    pub fn find_all(&self, places: &[[f64; 2]], control: &Control) -> Result<Vec<Option<InTriangle>>> {
        control.each("looking up positions", places, CHUNK, |&place| self.find(place))
    }
}

/// Returns whether barycentric coordinates lie within their triangle, up to rounding.
pub(crate) fn is_inside(weights: &[f64; 3]) -> bool {
    weights.iter().all(|&weight| weight >= -SLACK)
}

/// Returns the barycentric coordinates of a position; NaN in a triangle without area.
fn barycentric(triangle: &[Vector2<f64>; 3], place: Vector2<f64>) -> [f64; 3] {
    let [a, b, c] = triangle.map(|corner| corner - place);
    let area = (b - a).perp(&(c - a));
    [b.perp(&c), c.perp(&a), a.perp(&b)].map(|part| part / area)
}

fn bounds(places: &[Vector2<f64>]) -> (Vector2<f64>, Vector2<f64>) {
    let first = places.first().copied().unwrap_or_default();
    places.iter().fold((first, first), |(low, high), place| (low.inf(place), high.sup(place)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn place_in(triangle: [[f64; 2]; 3], weights: [f64; 3]) -> [f64; 2] {
        [0, 1].map(|axis| (0..3).map(|k| weights[k] * triangle[k][axis]).sum())
    }

    proptest! {
        #[test]
        fn the_first_of_all_triangles_that_hold_a_place_is_found(
            triangles in prop::collection::vec(prop::array::uniform3(prop::array::uniform2(-9.0..9.0f64)), 1..60),
            places in prop::collection::vec(prop::array::uniform2(-12.0..12.0f64), 40),
        ) {
            let finder = TriangleFinder::new(&triangles);
            for place in places {
                let at = Vector2::from(place);
                let holds = |triangle: &[[f64; 2]; 3]| is_inside(&barycentric(&triangle.map(Vector2::from), at));
                let found = finder.find(place);
                prop_assert_eq!(found.map(|(triangle, _)| triangle as usize), triangles.iter().position(holds));
                if let Some((triangle, weights)) = found {
                    let [u, v] = place_in(triangles[triangle as usize], weights);
                    prop_assert!((u - place[0]).hypot(v - place[1]) < 1e-9);
                    prop_assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-9);
                }
            }
        }
    }

    #[test]
    fn borders_belong_to_the_map_and_nothing_else_does() {
        let square = [[[0.0, 0.0], [4.0, 0.0], [4.0, 4.0]], [[0.0, 0.0], [4.0, 4.0], [0.0, 4.0]]];
        let finder = TriangleFinder::new(&square);
        for (place, triangle) in [([0.0, 0.0], 0), ([4.0, 4.0], 0), ([4.0, 0.0], 0), ([0.0, 4.0], 1), ([2.0, 2.0], 0)] {
            assert_eq!(finder.find(place).map(|(triangle, _)| triangle), Some(triangle));
        }
        for place in [[-0.1, 2.0], [4.1, 2.0], [2.0, 9.0], [f64::NAN, 2.0], [2.0, f64::INFINITY]] {
            assert_eq!(finder.find(place), None);
        }
        let control = Control::default();
        let places = vec![[2.0, 1.0]; 3 * CHUNK];
        assert_eq!(finder.find_all(&places, &control).unwrap(), vec![finder.find([2.0, 1.0]); 3 * CHUNK]);
        control.cancel();
        assert_eq!(finder.find_all(&places, &control), Err(crate::Error::Cancelled));
    }

    #[test]
    fn triangles_without_area_hold_nothing() {
        let line = [[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]], [[1.0, 0.0]; 3]];
        assert_eq!(TriangleFinder::new(&line).find([1.0, 0.0]), None);
        assert_eq!(TriangleFinder::new(&[]).find([0.0, 0.0]), None);
    }
}
