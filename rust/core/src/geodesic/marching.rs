//! Fast marching over triangles (Kimmel, Sethian 1998; Zigelman, Kimmel, Kiryati 2002, section 2).
//!
//! Distances are computed in ascending order, as in Dijkstra's algorithm, but fronts also cross triangles: where two
//! corners of a triangle are final, the third is reached by the front that passed both. A front reaches an obtuse
//! corner before it passes both others, so such a corner is split: the triangles across the opposite side are unfolded
//! until a vertex is found that divides the corner into two acute ones ("unfolding" of Kimmel and Sethian).
//!
//! The paper approximates the front within a triangle by a straight line ([`Wave::Plane`]). This is wrong near the
//! source, and the error persists. [`Wave::Circle`] uses a circle around the point from which both distances come, as
//! if the surface were unfolded up to there, which is exact if no vertex lies between. Around the source, it starts
//! with straight lines over unfolded triangles, because a triangle's side there can be longer than the distance, so
//! that no front passes it in time.

pub mod descent;
mod visibility;

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use nalgebra::Vector2;

use super::graph::{Beyond, unfold};
use super::solver::{Fingerprint, Solver};
use crate::adjacency::{Arc, starts_of};
use crate::surface::mesh::{BORDER, Surface, next, previous};
use crate::{Control, Result};

/// The maximum number of triangles that are unfolded to split an obtuse corner.
const MOST_UNFOLDED: usize = 12;

/// The maximum number of edges that a straight line crosses, from the source or back along a path.
const SEEN: u32 = 8;

/// The number of vertices between two checks for cancellation.
const BATCH: usize = 1 << 10;

/// The shape of a front within a triangle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Wave {
    /// A straight line, as in the paper: first order.
    Plane,
    /// A circle around the point from which the distances of two corners come.
    #[default]
    Circle,
}

/// How the third corner of a triangle is reached from two others: with the first at the origin and the second at
/// (`side`, 0), it lies at `apex`, in mm.
#[derive(Debug, Clone, Copy)]
struct Front {
    to: u32,
    other: u32,
    side: f32,
    apex: [f32; 2],
}

/// Fast marching over a surface: for each vertex, the triangles, or parts of them, across which a front leaves it.
#[derive(Debug, Clone)]
pub struct Marching<'a> {
    surface: &'a Surface,
    starts: Vec<u32>,
    fronts: Vec<Front>,
    wave: Wave,
}

impl<'a> Marching<'a> {
    /// Creates the solver from the triangles of a surface, with obtuse corners split.
    ///
    /// # Errors
    /// [`Error::Cancelled`](crate::Error::Cancelled).
    pub fn new(surface: &'a Surface, wave: Wave, control: &Control) -> Result<Self> {
        let mut fronts: Vec<(u32, Front)> = Vec::with_capacity(2 * surface.twins().len());
        for corner in 0..surface.twins().len() as u32 {
            if (corner as usize).is_multiple_of(BATCH) {
                control.check()?;
            }
            let apex = surface.origin(corner);
            for [(a, at_a), (b, at_b)] in acute(surface, corner) {
                let side = (at_b - at_a).norm();
                for (from, at_from, other, at_other) in [(a, at_a, b, at_b), (b, at_b, a, at_a)] {
                    // the apex in the frame of the side: the projection on it, and twice the area over its length
                    let along = -at_from.dot(&(at_other - at_from)) / side;
                    let away = at_from.perp(&at_other).abs() / side;
                    let apex_at = [along as f32, away as f32];
                    fronts.push((from, Front { to: apex, other, side: side as f32, apex: apex_at }));
                }
            }
        }
        fronts.sort_by_key(|&(from, _)| from);
        let starts = starts_of(surface.len(), fronts.iter().map(|&(from, _)| from));
        Ok(Self { surface, starts, fronts: fronts.into_iter().map(|(_, front)| front).collect(), wave })
    }

    /// Returns where the march begins: at the source and, with circles, at vertices visible across a few triangles.
    fn starts_around(&self, source: u32) -> Vec<Arc> {
        let mut seen = vec![Arc { to: source, length: 0.0 }];
        if self.wave == Wave::Circle {
            let leaves = |h: &u32| self.surface.origin(*h) == source;
            let half_edges: Vec<u32> = (0..self.surface.twins().len() as u32).filter(leaves).collect();
            unfold(self.surface, &half_edges, SEEN, 0, |h| Beyond::of(self.surface, h), &mut seen);
        }
        seen
    }

    fn fronts(&self, vertex: u32) -> &[Front] {
        &self.fronts[self.starts[vertex as usize] as usize..self.starts[vertex as usize + 1] as usize]
    }

    /// Computes the distances from `source` in the scratch; calls `settled` for each vertex when its distance is final.
    fn run(&self, source: u32, scratch: &mut Scratch, mut settled: impl FnMut(u32), control: &Control) -> Result<()> {
        control.check()?;
        let vertices = self.starts.len() - 1;
        let Scratch { distance, is_final, heap } = scratch;
        distance.clear();
        distance.resize(vertices, f64::INFINITY);
        is_final.clear();
        is_final.resize(vertices, false);
        heap.clear();
        for start in self.starts_around(source) {
            let known = &mut distance[start.to as usize];
            *known = known.min(f64::from(start.length));
            heap.push(Reverse((known.to_bits(), start.to)));
        }
        let mut count = 0usize;
        while let Some(Reverse((_, vertex))) = heap.pop() {
            // the nearest vertex is final: fronts across acute corners only lead farther (Kimmel & Sethian 1998)
            if std::mem::replace(&mut is_final[vertex as usize], true) {
                continue;
            }
            settled(vertex);
            count += 1;
            if count.is_multiple_of(BATCH) {
                control.check()?;
            }
            let here = distance[vertex as usize];
            for front in self.fronts(vertex) {
                if is_final[front.to as usize] {
                    continue;
                }
                let [x, y] = front.apex.map(f64::from);
                // along the edge, as in Dijkstra's algorithm, unless a front across the triangle arrives earlier
                let mut reached = here + x.hypot(y);
                if is_final[front.other as usize] {
                    let there = distance[front.other as usize];
                    let across = self.wave.across(here, there, f64::from(front.side), x, y);
                    reached = across.map_or(reached, |crossing| reached.min(crossing.reached));
                }
                let known = &mut distance[front.to as usize];
                if reached < *known {
                    *known = reached;
                    heap.push(Reverse((reached.to_bits(), front.to))); // positive floats sort as their bits
                }
            }
        }
        Ok(())
    }
}

/// Buffers of a worker that are reused for all rows.
#[derive(Debug, Default)]
pub struct Scratch {
    distance: Vec<f64>,
    is_final: Vec<bool>,
    heap: BinaryHeap<Reverse<(u64, u32)>>,
}

impl Solver for Marching<'_> {
    type Scratch = Scratch;

    fn scratch(&self) -> Scratch {
        Scratch::default()
    }

    fn columns(&self) -> usize {
        self.starts.len() - 1
    }

    fn row(&self, source: u32, row: &mut [f32], scratch: &mut Scratch, control: &Control) -> Result<()> {
        self.run(source, scratch, |_| (), control)?;
        row.iter_mut().zip(&scratch.distance).for_each(|(to, &from)| *to = from as f32);
        Ok(())
    }

    fn fingerprint(&self, control: &Control) -> Result<u64> {
        control.check()?;
        let mut hash = Fingerprint::default();
        hash.mix(u64::from(self.wave == Wave::Plane));
        self.starts.iter().for_each(|&start| hash.mix(u64::from(start)));
        for front in &self.fronts {
            hash.mix(u64::from(front.to) << 32 | u64::from(front.other));
            hash.mix(u64::from(front.apex[0].to_bits()) << 32 | u64::from(front.apex[1].to_bits()));
            hash.mix(u64::from(front.side.to_bits()));
        }
        Ok(hash.finish())
    }
}

/// Where a front crosses the side between two corners on its way to a point beyond.
#[derive(Debug, Clone, Copy)]
struct Crossing {
    /// The distance of the point in mm.
    reached: f64,
    /// Where it crosses the side, in mm from the first corner.
    at: f64,
}

impl Wave {
    /// Returns how a front that passes (0, 0) and (`side`, 0) at two distances reaches (x, y) between them, if so.
    fn across(self, here: f64, there: f64, side: f64, x: f64, y: f64) -> Option<Crossing> {
        let crossing = match self {
            Self::Plane => plane(here, there, side, x, y),
            Self::Circle => circle(here, there, side, x, y),
        };
        // a front that crosses the line beyond the side comes through another triangle
        crossing.filter(|crossing| (0.0..=side).contains(&crossing.at))
    }
}

/// Solves the quadratic equation of Kimmel and Sethian for the direction of a straight front.
fn plane(here: f64, there: f64, side: f64, x: f64, y: f64) -> Option<Crossing> {
    // the gradient of a plane through the three values has length 1 (Zigelman, Kimmel & Kiryati 2002, fig. 2)
    let along = (there - here) / side;
    if along.abs() >= 1.0 {
        return None;
    }
    // the positive root is the larger of the two solutions (section II)
    let across = (1.0 - along * along).sqrt();
    Some(Crossing { reached: here + along * x + across * y, at: x - y * along / across })
}

/// Propagates a circular front around the point below the side that has the two distances.
fn circle(here: f64, there: f64, side: f64, x: f64, y: f64) -> Option<Crossing> {
    // here² = c² + depth² and there² = (side − c)² + depth²; their difference is linear in c
    let centre = (here * here - there * there + side * side) / (2.0 * side);
    let depth = here * here - centre * centre;
    if depth < 0.0 {
        return None; // except for rounding, one distance comes along the side from the other
    }
    let depth = depth.sqrt();
    // the line from the centre (c, −depth) to (x, y) meets the side where its height is 0
    Some(Crossing { reached: (x - centre).hypot(y + depth), at: (centre * y + x * depth) / (y + depth) })
}

type Placed = (u32, Vector2<f64>);

/// Returns the corner at the origin of a half-edge as one or two acute corners: the ends of the opposite sides, in the
/// plane of the face with the corner at the origin. An obtuse corner is kept if no vertex is found to split it.
fn acute(surface: &Surface, corner: u32) -> impl Iterator<Item = [Placed; 2]> {
    let point = |v: u32| surface.points()[v as usize];
    let (apex, a, b) = (surface.origin(corner), surface.target(corner), surface.origin(previous(corner)));
    let (to_a, to_b) = (point(a) - point(apex), point(b) - point(apex));
    let length = to_a.norm();
    let right = (a, Vector2::new(length, 0.0));
    let left = (b, Vector2::new(to_a.dot(&to_b), to_a.cross(&to_b).norm()) / length);
    // a front can reach an obtuse corner before both others (Kimmel & Sethian 1998, section 3)
    let split = if to_a.dot(&to_b) < 0.0 { splitting(surface, corner, right, left) } else { None };
    let [first, second] = match split {
        Some(middle) => [Some([right, middle]), Some([middle, left])],
        None => [Some([right, left]), None],
    };
    first.into_iter().chain(second)
}

/// Returns the first vertex beyond the opposite side of an obtuse corner at acute angles to both of its sides.
fn splitting(surface: &Surface, corner: u32, right: Placed, left: Placed) -> Option<Placed> {
    let (mut right, mut left) = (right, left);
    let (first, last) = (right.1, left.1);
    let mut side = next(corner);
    for _ in 0..MOST_UNFOLDED {
        let twin = surface.twins()[side as usize];
        if twin == BORDER {
            return None;
        }
        let beyond = surface.origin(previous(twin));
        let place = unfolded(surface, right, left, beyond);
        if beyond == surface.origin(corner) {
            return None;
        }
        // at acute angles to both sides of the corner, which is at the origin
        let (is_left_of_first, is_right_of_last) = (place.dot(&first) > 0.0, place.dot(&last) > 0.0);
        if is_left_of_first && is_right_of_last {
            return Some((beyond, place));
        }
        // through the side that is crossed by the directions at acute angles to both
        if is_left_of_first {
            (right, side) = ((beyond, place), previous(twin));
        } else {
            (left, side) = ((beyond, place), next(twin));
        }
    }
    None
}

/// Returns the position of a vertex beyond the side from `right` to `left`, unfolded into their plane.
fn unfolded(surface: &Surface, right: Placed, left: Placed, vertex: u32) -> Vector2<f64> {
    let point = |v: u32| surface.points()[v as usize];
    let (p, q) = (point(right.0), point(left.0));
    let length = (q - p).norm();
    let along = (point(vertex) - p).dot(&(q - p)) / length;
    let away = (q - p).cross(&(point(vertex) - p)).norm() / length;
    let direction = (left.1 - right.1) / length;
    right.1 + direction * along + Vector2::new(direction.y, -direction.x) * away
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::mesh::shapes;
    use proptest::prelude::*;

    fn row(surface: &Surface, wave: Wave, source: u32) -> Vec<f32> {
        crate::tests::row(&Marching::new(surface, wave, &Control::default()).unwrap(), source)
    }

    /// Returns the mean relative error over all vertices except the source.
    fn error(row: &[f32], truth: impl Fn(usize) -> f64) -> f64 {
        let of = |v: usize| (f64::from(row[v]) / truth(v) - 1.0).abs();
        let others: Vec<f64> = (0..row.len()).filter(|&v| row[v] > 0.0).map(of).collect();
        others.iter().sum::<f64>() / others.len() as f64
    }

    /// Returns a flat sheet, sheared so that a corner of each triangle is obtuse.
    fn sheared(by: f64) -> Surface {
        let (points, faces) = shapes::sheet(14, 14);
        shapes::surface((points.iter().map(|&[x, y, z]| [x + by * y, y, z]).collect(), faces))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        #[test]
        fn circles_are_exact_in_a_plane(by in -2.5f64..2.5, source in 0u32..225) {
            let surface = sheared(by);
            let truth = |v: usize| (surface.points()[v] - surface.points()[source as usize]).norm();
            let circle = error(&row(&surface, Wave::Circle, source), truth);
            let plane = error(&row(&surface, Wave::Plane, source), truth);
            prop_assert!(circle < 0.01, "{circle}");
            prop_assert!(circle < plane, "{circle} {plane}");
        }
    }

    #[test]
    fn circles_are_exact_on_a_square_grid() {
        let surface = sheared(0.0);
        let truth = |v: usize| (surface.points()[v] - surface.points()[112]).norm();
        assert!(error(&row(&surface, Wave::Circle, 112), truth) < 1e-7);
    }

    #[test]
    fn obtuse_corners_are_split() {
        for by in [-2.4, -1.2, 0.3, 1.1, 1.5, 2.3] {
            let surface = sheared(by);
            let corners = 0..surface.twins().len() as u32;
            assert!(corners.clone().any(|corner| acute(&surface, corner).count() == 2));
            for corner in corners {
                let parts: Vec<_> = acute(&surface, corner).collect();
                for [(_, a), (_, b)] in &parts {
                    assert!(a.perp(b) > 0.0);
                    assert!(parts.len() == 1 || a.dot(b) > 0.0);
                }
                for (vertex, place) in parts.iter().flatten() {
                    let apart = surface.points()[*vertex as usize] - surface.points()[surface.origin(corner) as usize];
                    assert!((place.norm() - apart.norm()).abs() < 1e-9, "unfolding a plane keeps distances");
                }
            }
        }
    }

    #[test]
    fn the_error_on_a_sphere_falls_with_the_resolution() {
        let of = |times: usize, wave: Wave| {
            let surface = shapes::surface(shapes::sphere(times));
            let arc = |v: usize| 2.0 * ((surface.points()[v] - surface.points()[0]).norm() / 2.0).asin();
            error(&row(&surface, wave, 0), arc)
        };
        // around a point source, the error of straight fronts decreases only as h log h
        for (wave, falls, finest) in [(Wave::Plane, 0.75, 0.012), (Wave::Circle, 0.6, 0.002)] {
            let errors = [4, 5, 6].map(|times| of(times, wave));
            assert!(errors[1] < falls * errors[0] && errors[2] < falls * errors[1], "{wave:?} {errors:?}");
            assert!(errors[2] < finest, "{wave:?} {errors:?}");
        }
    }

    #[test]
    fn nothing_crosses_a_cut_and_other_components_are_not_reached() {
        let row = row(&crate::tests::slit(4, 8, 4.0, 4.0), Wave::Circle, 0);
        assert_eq!(row.iter().filter(|d| d.is_finite()).count(), 25);
    }
}
