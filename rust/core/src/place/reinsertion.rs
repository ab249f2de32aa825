//! Re-insertion of the vertices that [decimation](crate::surface::decimate) removed, in reverse order. Each position
//! follows from the positions of the neighbours and from weights.
//!
//! Where the neighbours' positions are not convex, a vertex placed by weights may flip a triangle. It is then moved
//! into the kernel of its ring, from which the complete ring is visible. The kernel is not empty if no triangle of the
//! coarse map was flipped, because the ring is visible from the vertex onto which the removed one moved.

use nalgebra::Vector2;

use crate::error::check_points;
use crate::surface::decimate::Removals;
use crate::{Control, Result};

/// The number of steps between two checks for cancellation.
const BATCH: usize = 1 << 12;

/// How far a vertex moves from the edge of its kernel towards the middle.
const INWARDS: f64 = 0.5;

/// How far beyond its neighbours a vertex of the boundary may be moved, as a share of their extent.
const MARGIN: f64 = 0.25;

type Place = Vector2<f64>;

/// Options of the placement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placing {
    /// Whether the triangles of the map are clockwise.
    pub is_mirrored: bool,
    /// How far a vertex of the boundary may lie outside the map without it, as a share of the distance between its
    /// neighbours on the boundary. Only a vertex without other neighbours must lie outside at all. With a small
    /// overhang, no two parts of a map overlap that did not overlap before.
    pub overhang: f64,
}

impl Default for Placing {
    fn default() -> Self {
        Self { is_mirrored: false, overhang: f64::INFINITY }
    }
}

/// Writes the position (mm) of every removed vertex to `uv`, which holds the positions of the remaining vertices.
/// Returns the number of vertices for which no position preserves the orientation of their triangles.
///
/// # Errors
/// [`Error::NoSuchPoint`](crate::Error::NoSuchPoint) if `uv` is shorter than the number of vertices, and
/// [`Error::Cancelled`](crate::Error::Cancelled).
pub fn place(removals: &Removals, uv: &mut [[f64; 2]], placing: &Placing, control: &Control) -> Result<usize> {
    let vertices = removals.iter().flat_map(|removal| removal.neighbours.iter().copied().chain([removal.vertex]));
    check_points(vertices, uv.len())?;
    control.begin("placing the remaining points", removals.len() as u64);
    let hand = if placing.is_mirrored { -1.0 } else { 1.0 }; // the weights refer to an unmirrored map
    let mut ring: Vec<Place> = Vec::new();
    let mut turned = 0;
    for (step, removal) in removals.iter().rev().enumerate() {
        if step.is_multiple_of(BATCH) {
            control.check()?;
        }
        ring.clear();
        ring.extend(removal.neighbours.iter().map(|&v| Place::new(uv[v as usize][0], hand * uv[v as usize][1])));
        let origin = ring[0]; // far from 0, differences would lose digits
        ring.iter_mut().for_each(|place| *place -= origin);
        let mut at = weighted(&ring, removal.weights);
        let is_within = removal.is_closed || (placing.overhang.is_finite() && ring.len() > 2);
        if !sees(&ring, is_within, at) {
            match kernel(&ring, is_within) {
                Some(kernel) => at = inside(&kernel, at),
                None => turned += 1,
            }
        }
        if let [a, b] = ring[..]
            && placing.overhang.is_finite()
        {
            at = nearer([a, b], at, placing.overhang);
        }
        at += origin;
        uv[removal.vertex as usize] = [at.x, hand * at.y];
        control.advance();
    }
    Ok(turned)
}

/// Returns Σ weight · position, as complex numbers.
fn weighted(ring: &[Place], weights: &[[f64; 2]]) -> Place {
    let terms = ring.iter().zip(weights);
    terms.map(|(p, [re, im])| Place::new(re * p.x - im * p.y, re * p.y + im * p.x)).sum()
}

/// Iterates over the sides of a ring opposite its vertex, counterclockwise.
fn sides(ring: &[Place], is_closed: bool) -> impl Iterator<Item = [Place; 2]> + '_ {
    let count = if is_closed { ring.len() } else { ring.len() - 1 };
    (0..count).map(|k| [ring[k], ring[(k + 1) % ring.len()]])
}

fn area(at: Place, [a, b]: [Place; 2]) -> f64 {
    // twice the area, positive if the side is seen counterclockwise
    (a - at).perp(&(b - at))
}

fn sees(ring: &[Place], is_closed: bool, at: Place) -> bool {
    sides(ring, is_closed).all(|side| area(at, side) > 0.0)
}

/// Returns the polygon of positions from which the ring is visible, within a box around it; none if it is empty.
fn kernel(ring: &[Place], is_closed: bool) -> Option<Vec<Place>> {
    kernel_of(&sides(ring, is_closed).collect::<Vec<_>>(), is_closed)
}

/// Returns the same polygon for the sides of a ring in any order.
fn kernel_of(sides: &[[Place; 2]], is_closed: bool) -> Option<Vec<Place>> {
    let corners = || sides.iter().flatten();
    let start = *corners().next()?;
    let low = corners().fold(start, |low, p| low.inf(p));
    let high = corners().fold(start, |high, p| high.sup(p));
    let margin = if is_closed { 0.0 } else { MARGIN * (high - low).norm() };
    let (low, high) = (low.add_scalar(-margin), high.add_scalar(margin));
    let mut polygon = vec![low, Place::new(high.x, low.y), high, Place::new(low.x, high.y)];
    for &side in sides {
        polygon = clip(&polygon, side);
        if polygon.len() < 3 {
            return None;
        }
    }
    let middle = middle(&polygon);
    sides.iter().all(|&side| area(middle, side) > 0.0).then_some(polygon)
}

/// Returns a position near that of a vertex from which all opposite sides are visible, if any. A closed ring surrounds
/// the vertex.
pub(crate) fn seeing(sides: &[[Place; 2]], is_closed: bool, at: Place) -> Option<Place> {
    kernel_of(sides, is_closed).map(|kernel| inside(&kernel, at))
}

/// Returns the part of a convex polygon from which a side is visible.
fn clip(polygon: &[Place], side: [Place; 2]) -> Vec<Place> {
    let mut part = Vec::with_capacity(polygon.len() + 1);
    for (k, &from) in polygon.iter().enumerate() {
        let to = polygon[(k + 1) % polygon.len()];
        let (here, there) = (area(from, side), area(to, side));
        if here >= 0.0 {
            part.push(from);
        }
        if (here > 0.0 && there < 0.0) || (here < 0.0 && there > 0.0) {
            part.push(from + (to - from) * (here / (here - there)));
        }
    }
    part
}

/// Returns a position whose distance from a segment's line is at most a multiple of its length.
fn nearer([a, b]: [Place; 2], at: Place, most: f64) -> Place {
    let along = (at - a).dot(&(b - a)) / (b - a).norm_squared();
    let foot = a + (b - a) * along;
    let (height, most) = ((at - foot).norm(), most * (b - a).norm());
    if height <= most { at } else { a + (b - a) * along.clamp(0.1, 0.9) + (at - foot) * (most / height) }
}

fn middle(polygon: &[Place]) -> Place {
    polygon.iter().sum::<Place>() / polygon.len() as f64
}

/// Returns a position in a convex polygon on the way from its middle to a position outside.
fn inside(polygon: &[Place], outside: Place) -> Place {
    let middle = middle(polygon);
    let mut share = 1.0f64;
    for side in sides(polygon, true) {
        let (here, there) = (area(middle, side), area(outside, side));
        if there < 0.0 {
            // where the way out crosses the side, by linear interpolation of areas
            share = share.min(here / (here - there));
        }
    }
    middle + (outside - middle) * (share * (1.0 - INWARDS))
}

#[cfg(test)]
mod tests;
