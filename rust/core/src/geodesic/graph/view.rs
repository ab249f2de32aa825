//! The view from a vertex of a surface: faces unfolded into its plane, one across the next.

use nalgebra::Vector2;
use rayon::prelude::*;

use crate::adjacency::{Arc, Groups};
use crate::surface::mesh::{BORDER, Surface, next, previous};

/// The number of vertices whose lines are sampled to estimate lengths.
const SAMPLE: usize = 500;

/// Returns the half-edges that begin at each vertex.
pub(in crate::geodesic) fn outgoing(surface: &Surface) -> Groups {
    Groups::new(surface.len(), surface.faces().as_flattened().iter().copied())
}

/// The view from a vertex, with buffers that are reused for the next one.
#[derive(Debug, Default)]
pub(super) struct Seen {
    pub lines: Vec<Arc>,
    /// The length of the shortest line to each vertex; reset to infinity when all are found.
    least: Vec<f32>,
}

/// The view from the vertices of a surface across a limited number of edges.
pub(super) struct View<'a> {
    surface: &'a Surface,
    outgoing: Groups,
    beyond: Vec<Beyond>,
    crossed: u32,
}

impl<'a> View<'a> {
    pub fn new(surface: &'a Surface, crossed: u32) -> Self {
        let beyond = (0..surface.twins().len() as u32).into_par_iter().map(|h| Beyond::of(surface, h)).collect();
        Self { surface, outgoing: outgoing(surface), beyond, crossed }
    }

    /// Finds the shortest straight line from a vertex to each visible higher one, in no particular order.
    pub fn from(&self, vertex: u32, seen: &mut Seen) {
        let Seen { lines, least } = seen;
        lines.clear();
        let beyond = |h: u32| self.beyond[h as usize];
        // the others see this one
        unfold(self.surface, self.outgoing.of(vertex), self.crossed, vertex + 1, beyond, lines);
        least.resize(self.surface.len(), f32::INFINITY);
        for line in lines.iter() {
            let least = &mut least[line.to as usize];
            *least = least.min(line.length);
        }
        // after the shortest line to a vertex, its recorded length is infinite, so that no other line remains
        lines.retain(|line| {
            let least = &mut least[line.to as usize];
            let is_shortest = line.length == *least;
            if is_shortest {
                *least = f32::INFINITY;
            }
            is_shortest
        });
    }

    /// Returns lengths that divide the lines into layers of about equal size.
    pub fn layers(&self, layers: usize) -> Vec<f32> {
        if layers == 1 {
            return vec![0.0, f32::INFINITY];
        }
        let step = self.surface.len() / SAMPLE + 1;
        let sample = (0..self.surface.len() as u32).step_by(step);
        let (mut seen, mut lengths) = (Seen::default(), Vec::new());
        for vertex in sample {
            self.from(vertex, &mut seen);
            lengths.extend(seen.lines.iter().map(|line| line.length));
        }
        lengths.sort_unstable_by(f32::total_cmp);
        let limit = |layer: usize| lengths.get(layer * lengths.len() / layers).copied().unwrap_or(f32::INFINITY);
        let between = (1..layers).map(limit);
        [0.0].into_iter().chain(between).chain([f32::INFINITY]).collect()
    }
}

/// The view from a vertex at the origin through an edge: the ends of the edge in the plane, `right` and `left`, and the
/// directions between which it is not hidden.
#[derive(Debug, Clone, Copy)]
struct Window {
    half_edge: u32,
    right: Vector2<f64>,
    left: Vector2<f64>,
    from: Vector2<f64>,
    to: Vector2<f64>,
    crossed: u32,
}

/// Lists what a vertex sees through the faces on the left of half-edges that begin there: the edges themselves, the
/// faces' other edges at a boundary, and vertices across up to `most` edges. Vertices below `lowest` are excluded.
/// `beyond_of` returns the faces across half-edges.
pub(in crate::geodesic) fn unfold(
    surface: &Surface, half_edges: &[u32], most: u32, lowest: u32, beyond_of: impl Fn(u32) -> Beyond,
    seen: &mut Vec<Arc>,
) {
    let point = |v: u32| surface.points()[v as usize];
    let mut waiting = Vec::new();
    for &half_edge in half_edges {
        let vertex = surface.origin(half_edge);
        let (a, b) = (surface.target(half_edge), surface.origin(previous(half_edge)));
        let (to_a, to_b) = (point(a) - point(vertex), point(b) - point(vertex));
        for (to, way) in [(a, to_a), (b, to_b)] {
            if to >= lowest {
                seen.push(Arc { to, length: way.norm() as f32 });
            }
        }
        let right = Vector2::new(to_a.norm(), 0.0);
        // the face in the plane, with `a` on the first axis: b = (a·b, |a × b|) / |a|
        let left = Vector2::new(to_a.dot(&to_b), to_a.cross(&to_b).norm()) / to_a.norm();
        waiting.push(Window { half_edge: next(half_edge), right, left, from: right, to: left, crossed: 0 });
        while let Some(mut window) = waiting.pop() {
            // one window becomes the next; of two beyond a face, the left one waits
            while window.crossed < most {
                let beyond = beyond_of(window.half_edge);
                window.crossed += 1;
                if beyond.twin == BORDER || window.crossed == most && beyond.corner < lowest {
                    break;
                }
                let place = beyond.unfolded(window.right, window.left);
                // the cone of sight: a positive cross product is a turn to the left
                let is_right_of_left_end = window.to.perp(&place) < 0.0;
                let is_left_of_right_end = window.from.perp(&place) > 0.0;
                if is_right_of_left_end {
                    if is_left_of_right_end {
                        if beyond.corner >= lowest && beyond.corner != vertex {
                            seen.push(Arc { to: beyond.corner, length: place.norm() as f32 });
                        }
                        if window.crossed < most {
                            waiting.push(Window { half_edge: next(beyond.twin), left: place, to: place, ..window });
                        }
                        window.from = place;
                    }
                    window.half_edge = previous(beyond.twin);
                    window.right = place;
                } else if is_left_of_right_end {
                    window.half_edge = next(beyond.twin);
                    window.left = place;
                } else {
                    break;
                }
            }
        }
    }
}

/// The face across an edge: its half-edge there, and the corner that is not on the edge, with its position along the
/// edge and away from it, in lengths of the edge.
#[derive(Debug, Clone, Copy)]
pub(in crate::geodesic) struct Beyond {
    twin: u32,
    corner: u32,
    along: f64,
    away: f64,
}

impl Beyond {
    /// Returns the face across a half-edge; at a border, there is none.
    pub fn of(surface: &Surface, half_edge: u32) -> Self {
        let twin = surface.twins()[half_edge as usize];
        if twin == BORDER {
            return Self { twin, corner: 0, along: f64::NAN, away: f64::NAN };
        }
        let corner = surface.origin(previous(twin));
        let vertices = [surface.origin(half_edge), surface.target(half_edge), corner];
        let [p, q, r] = vertices.map(|v| surface.points()[v as usize]);
        let edge = q - p;
        let square = edge.norm_squared();
        // both as shares of the edge: the projection on it, and twice the area over its square
        Self { twin, corner, along: (r - p).dot(&edge) / square, away: edge.cross(&(r - p)).norm() / square }
    }

    /// Returns the position of the corner in the plane, if the ends of the edge lie at `right` and `left`.
    fn unfolded(self, right: Vector2<f64>, left: Vector2<f64>) -> Vector2<f64> {
        let edge = left - right;
        // (y, −x) is the edge turned clockwise, away from the viewer
        right + edge * self.along + Vector2::new(edge.y, -edge.x) * self.away
    }
}
