//! What is visible from a point on a surface, across the sides of triangles that are unfolded in turn.

use nalgebra::{Vector2, Vector3};

use super::{Placed, unfolded};
use crate::geodesic::path::Site;
use crate::surface::mesh::{BORDER, Surface, next, previous};

/// A side of a triangle, as a half-edge from its right to its left end, in the plane with the viewer at the origin.
#[derive(Debug, Clone, Copy)]
pub(super) struct Side {
    pub half_edge: u32,
    pub right: Placed,
    pub left: Placed,
}

/// A side that is visible between two directions, across a number of others.
#[derive(Debug, Clone, Copy)]
pub(super) struct View {
    pub side: Side,
    pub from: Vector2<f64>,
    pub to: Vector2<f64>,
    pub crossed: usize,
}

impl View {
    /// Returns a side seen from a point in its own triangle.
    pub fn of(surface: &Surface, here: Vector3<f64>, half_edge: u32) -> Self {
        let [a, b] = [surface.origin(half_edge), surface.target(half_edge)];
        let origin = surface.points()[a as usize];
        let (edge, away) = (surface.points()[b as usize] - origin, here - origin);
        let length = edge.norm();
        let (x, y) = (away.dot(&edge) / length, edge.cross(&away).norm() / length);
        // turned by half a turn around the viewer, so that the right end of the side is on the right
        let (right, left) = (Vector2::new(x, y), Vector2::new(x - length, y));
        Self { side: Side { half_edge, right: (a, right), left: (b, left) }, from: right, to: left, crossed: 0 }
    }

    /// Returns whether a point on the side is within the visible part.
    pub fn shows(&self, place: Vector2<f64>) -> bool {
        self.from.perp(&place) >= 0.0 && self.to.perp(&place) <= 0.0
    }

    /// Returns what is visible across the side: the corner beyond, unless hidden, and the triangle's other sides.
    pub fn beyond(&self, surface: &Surface) -> (Option<Placed>, impl Iterator<Item = Self>) {
        let Side { half_edge, right, left } = self.side;
        let twin = surface.twins()[half_edge as usize];
        let corner = (twin != BORDER).then(|| {
            let vertex = surface.origin(previous(twin));
            (vertex, unfolded(surface, right, left, vertex))
        });
        let is_right_of_left_end = corner.is_some_and(|(_, place)| self.to.perp(&place) < 0.0);
        let is_left_of_right_end = corner.is_some_and(|(_, place)| self.from.perp(&place) > 0.0);
        let crossed = self.crossed + 1;
        let on_the_right = corner.filter(|_| is_left_of_right_end).map(|corner| {
            let side = Side { half_edge: next(twin), right, left: corner };
            Self { side, from: self.from, to: if is_right_of_left_end { corner.1 } else { self.to }, crossed }
        });
        let on_the_left = corner.filter(|_| is_right_of_left_end).map(|corner| {
            let side = Side { half_edge: previous(twin), right: corner, left };
            Self { side, from: if is_left_of_right_end { corner.1 } else { self.from }, to: self.to, crossed }
        });
        let is_seen = is_right_of_left_end && is_left_of_right_end;
        (corner.filter(|_| is_seen), on_the_right.into_iter().chain(on_the_left))
    }
}

/// The straight line that reaches the viewer first.
#[derive(Debug)]
pub(super) struct First {
    reached: f64,
    /// The sites that it passes, starting from the viewer.
    pub line: Option<Vec<Site>>,
}

impl First {
    pub fn new() -> Self {
        Self { reached: f64::INFINITY, line: None }
    }

    /// Considers a line that starts at `end` in the plane, arrives at a distance in mm, and crosses sides on its way.
    pub fn offer(&mut self, reached: f64, end: (Site, Vector2<f64>), crossed: &[Side]) {
        if reached < self.reached {
            let crossings = crossed.iter().map(|side| crossing(side, end.1));
            *self = Self { reached, line: Some(crossings.chain([end.0]).collect()) };
        }
    }
}

/// Returns where the line of sight to a point crosses a side.
fn crossing(side: &Side, place: Vector2<f64>) -> Site {
    // cross products with the line of sight are proportional to the distances of both ends from it
    let (right, left) = (side.right.1.perp(&place), place.perp(&side.left.1));
    let whole = right + left;
    let along = if whole > 0.0 { (right / whole).clamp(0.0, 1.0) } else { 0.5 };
    Site::Edge { half_edge: side.half_edge, along }
}
