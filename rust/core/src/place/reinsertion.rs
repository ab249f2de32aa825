//! Re-insertion: the vertices that [decimation](crate::surface::decimate) took away come back in reverse order, each where
//! its neighbours' places and its weights say.
//!
//! Where the neighbours' places are not convex, a vertex placed by weights may turn a triangle over. It is then moved into the
//! kernel of its ring, from where all of the ring is seen. That kernel is never empty if no triangle of the coarse map was
//! turned over: the vertex that the removed one moved onto saw all of the ring. So a map without flips stays one.

use nalgebra::Vector2;

use crate::control::Control;
use crate::error::Result;
use crate::surface::decimate::Removals;

/// Steps between two looks at the control.
const BATCH: usize = 1 << 12;

/// How far a vertex moves from the edge of its kernel towards the middle.
const INWARDS: f64 = 0.5;

/// How far beyond its neighbours a vertex of the boundary may be moved, as a share of their extent.
const MARGIN: f64 = 0.25;

type Place = Vector2<f64>;

/// How vertices are placed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placing {
    /// The map's triangles run clockwise.
    pub is_mirrored: bool,
    /// How far a vertex of the boundary may lie outside the map as it was without it, as a part of the distance of its
    /// neighbours on the boundary. Only one that has no other neighbours needs to lie outside at all: with little overhang no
    /// two parts of a map run into each other that did not before.
    pub overhang: f64,
}

impl Default for Placing {
    fn default() -> Self {
        Self { is_mirrored: false, overhang: f64::INFINITY }
    }
}

/// Gives every removed vertex its place (mm) in `uv`, where all survivors have theirs. Returns how many vertices had no place
/// from which their triangles keep their orientation.
/// Panics if `uv` is shorter than the surface has vertices.
pub fn place(removals: &Removals, uv: &mut [[f64; 2]], placing: &Placing, control: &Control) -> Result<usize> {
    control.begin("placing the rest", removals.len() as u64);
    let hand = if placing.is_mirrored { -1.0 } else { 1.0 }; // the weights are those of a map that is not mirrored
    let mut ring: Vec<Place> = Vec::new();
    let mut turned = 0;
    for (step, removal) in removals.iter().rev().enumerate() {
        if step.is_multiple_of(BATCH) {
            control.check()?;
        }
        ring.clear();
        ring.extend(removal.neighbours.iter().map(|&v| Place::new(uv[v as usize][0], hand * uv[v as usize][1])));
        let origin = ring[0]; // far from 0 differences would lose digits
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

/// Σ weight · place, as complex numbers.
fn weighted(ring: &[Place], weights: &[[f64; 2]]) -> Place {
    let terms = ring.iter().zip(weights);
    terms.map(|(p, [re, im])| Place::new(re * p.x - im * p.y, re * p.y + im * p.x)).sum()
}

/// The sides of a ring opposite to its vertex, counterclockwise around it.
fn sides(ring: &[Place], is_closed: bool) -> impl Iterator<Item = [Place; 2]> + '_ {
    let count = if is_closed { ring.len() } else { ring.len() - 1 };
    (0..count).map(|k| [ring[k], ring[(k + 1) % ring.len()]])
}

fn area(at: Place, [a, b]: [Place; 2]) -> f64 {
    (a - at).perp(&(b - at))
}

fn sees(ring: &[Place], is_closed: bool, at: Place) -> bool {
    sides(ring, is_closed).all(|side| area(at, side) > 0.0)
}

/// The polygon of all places that see the ring, within a box around it; none if it has no inside.
fn kernel(ring: &[Place], is_closed: bool) -> Option<Vec<Place>> {
    kernel_of(&sides(ring, is_closed).collect::<Vec<_>>(), is_closed)
}

/// The same of the sides of a ring in any order.
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

/// The place nearest to a vertex' own, about, from which all sides opposite to it are seen; none if there is none. The sides of a ring
/// that is closed go all around the vertex.
pub(crate) fn seeing(sides: &[[Place; 2]], is_closed: bool, at: Place) -> Option<Place> {
    kernel_of(sides, is_closed).map(|kernel| inside(&kernel, at))
}

/// The part of a convex polygon from which a side is seen.
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

/// A place that is no farther from a segment's line than some times its length.
fn nearer([a, b]: [Place; 2], at: Place, most: f64) -> Place {
    let along = (at - a).dot(&(b - a)) / (b - a).norm_squared();
    let foot = a + (b - a) * along;
    let (height, most) = ((at - foot).norm(), most * (b - a).norm());
    if height <= most { at } else { a + (b - a) * along.clamp(0.1, 0.9) + (at - foot) * (most / height) }
}

fn middle(polygon: &[Place]) -> Place {
    polygon.iter().sum::<Place>() / polygon.len() as f64
}

/// A place within a convex polygon on the way from its middle to a place outside.
fn inside(polygon: &[Place], outside: Place) -> Place {
    let middle = middle(polygon);
    let mut share = 1.0f64;
    for side in sides(polygon, true) {
        let (here, there) = (area(middle, side), area(outside, side));
        if there < 0.0 {
            share = share.min(here / (here - there));
        }
    }
    middle + (outside - middle) * (share * (1.0 - INWARDS))
}

#[cfg(test)]
mod tests;
