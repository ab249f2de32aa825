//! Nested dissection: a graph is cut in two by few vertices, each half again, and so on.
//!
//! The vertices of a cut (a separator) come before both of its sides in the order; no link joins the sides. A path between
//! two vertices of different sides therefore passes a separator that holds both apart (George 1973; Lipton, Rose, Tarjan
//! 1979). Cuts follow lines of equal difference of the geodesic distances from two landmarks: over a folded surface these
//! are short, where planes in space would cut through every fold.

use std::sync::atomic::{AtomicU8, Ordering};

use crate::adjacency::Links;
use crate::control::Control;
use crate::error::Result;
use crate::geodesic::shortest::Search;

/// Pieces of so few vertices are not cut further.
const LEAF: usize = 24;

/// Landmarks of each component.
const LANDMARKS: usize = 6;

/// How many directions are tried for each cut, of all that look good on a sample.
const TRIED: usize = 4;

/// Vertices of the sample by which directions are compared.
const SAMPLE: usize = 128;

/// The number of a part that has no parent.
pub(super) const NONE: u32 = u32::MAX;

/// A separator, or a piece that is not cut further: consecutive vertices of the order.
#[derive(Debug, Clone, Copy)]
pub(super) struct Part {
    /// Its first vertex in the order.
    pub first: u32,
    /// Number of its vertices.
    pub len: u32,
    /// The separator that cut it off; [`NONE`] for the first of a component.
    pub parent: u32,
    /// Number of vertices of all separators above it.
    pub slot: u32,
    /// The part behind it and all below it.
    pub until: u32,
}

/// An order of a graph's vertices in which every separator comes before what it separates.
#[derive(Debug)]
pub(super) struct Dissection {
    /// The vertices.
    pub order: Vec<u32>,
    /// Where each vertex is in the order.
    pub ranks: Vec<u32>,
    /// The parts; each comes directly before all that lies below it.
    pub parts: Vec<Part>,
    /// No finite distance is longer, mm.
    pub reach: f32,
}

impl Dissection {
    /// Dissects a graph.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    pub fn new<G: Links>(graph: &G, control: &Control) -> Result<Self> {
        let components = graph.components();
        control.check()?;
        let (places, reach) = landmarks(graph, &components.labels, components.sizes.len(), control)?;
        let mut order: Vec<u32> = (0..graph.vertices() as u32).collect();
        order.sort_by_key(|&vertex| components.labels[vertex as usize]);
        let sides: Vec<AtomicU8> = (0..order.len()).map(|_| AtomicU8::new(PLACED)).collect();
        let cutter = Cutter { graph, places: &places, sides: &sides, control };
        let (mut parts, mut first, mut rest) = (Vec::new(), 0, order.as_mut_slice());
        for size in components.sizes {
            let (component, behind) = rest.split_at_mut(size);
            append(&mut parts, cutter.dissect(component, first, 0)?, NONE);
            (first, rest) = (first + size as u32, behind);
        }
        let mut ranks = vec![0; order.len()];
        (0..).zip(&order).for_each(|(rank, &vertex)| ranks[vertex as usize] = rank);
        Ok(Self { order, ranks, parts, reach })
    }
}

/// Appends parts whose numbers count from their own first.
fn append(parts: &mut Vec<Part>, more: Vec<Part>, parent: u32) {
    let shift = parts.len() as u32;
    parts.extend(more.into_iter().map(|part| Part {
        parent: if part.parent == NONE { parent } else { part.parent + shift },
        until: part.until + shift,
        ..part
    }));
}

/// The distances of each vertex from the landmarks of its component, each of which is farthest from those before; and a
/// bound of all distances.
fn landmarks(
    graph: &impl Links,
    labels: &[u32],
    components: usize,
    control: &Control,
) -> Result<(Vec<[f32; LANDMARKS]>, f32)> {
    let mut places = vec![[0.0; LANDMARKS]; labels.len()];
    let mut search = Search::new(graph);
    let mut seeds = vec![NONE; components];
    (0..labels.len()).rev().for_each(|vertex| seeds[labels[vertex] as usize] = vertex as u32);
    let mut nearest = vec![f32::INFINITY; labels.len()];
    let mut row = nearest.clone();
    let mut reach = f32::INFINITY;
    for round in 0..=LANDMARKS {
        row.fill(f32::INFINITY);
        seeds.iter().for_each(|&seed| row[seed as usize] = 0.0);
        search.lower(graph, &seeds, &mut row, control)?;
        reach = reach.min(2.0 * row.iter().copied().fold(0.0, f32::max));
        if round <= 1 {
            nearest.copy_from_slice(&row); // the first row only finds the first landmarks
        } else {
            nearest.iter_mut().zip(&row).for_each(|(near, &distance)| *near = near.min(distance));
        }
        if round > 0 {
            places.iter_mut().zip(&row).for_each(|(place, &distance)| place[round - 1] = distance);
        }
        for (vertex, &label) in labels.iter().enumerate() {
            let seed = &mut seeds[label as usize];
            if nearest[vertex] > nearest[*seed as usize] {
                *seed = vertex as u32;
            }
        }
    }
    Ok((places, reach))
}

/// Marks of vertices: those of separators, of other components and of finished pieces; one side of a cut; the other.
const PLACED: u8 = 0;
const LOW: u8 = 1;
const HIGH: u8 = 2;

/// A direction over the surface: the difference of the distances from two landmarks, or the distance from one.
type Direction = (usize, Option<usize>);

struct Cutter<'a, G> {
    graph: &'a G,
    places: &'a [[f32; LANDMARKS]],
    sides: &'a [AtomicU8],
    control: &'a Control,
}

/// A piece cut in two.
struct Cut {
    /// The vertices, the lower side first.
    vertices: Vec<u32>,
    low: usize,
    /// Which side's border is the separator.
    side: u8,
    separator: usize,
}

impl<G: Links> Cutter<'_, G> {
    /// Orders the vertices of a piece and lists its parts, of which the first is at `first` and `slot`.
    fn dissect(&self, piece: &mut [u32], first: u32, slot: u32) -> Result<Vec<Part>> {
        self.control.check()?;
        let whole = Part { first, len: piece.len() as u32, parent: NONE, slot, until: 1 };
        if piece.len() <= LEAF {
            return Ok(vec![whole]);
        }
        let (separator, low) = self.cut(piece)?;
        let (above, rest) = piece.split_at_mut(separator);
        let (lower, higher) = rest.split_at_mut(low);
        let slot = slot + separator as u32;
        let starts = [first + separator as u32, first + (separator + lower.len()) as u32];
        let (lower, higher) = if lower.len() + higher.len() > 8192 {
            rayon::join(|| self.dissect(lower, starts[0], slot), || self.dissect(higher, starts[1], slot))
        } else {
            (self.dissect(lower, starts[0], slot), self.dissect(higher, starts[1], slot))
        };
        let mut parts = vec![Part { len: above.len() as u32, ..whole }];
        append(&mut parts, lower?, 0);
        append(&mut parts, higher?, 0);
        parts[0].until = parts.len() as u32;
        Ok(parts)
    }

    /// Orders a piece by separator, lower side, higher side; the lengths of the first two.
    fn cut(&self, piece: &mut [u32]) -> Result<(usize, usize)> {
        let mut best: Option<Cut> = None;
        for direction in self.promising(piece) {
            self.control.check()?;
            let cut = self.along(piece, direction);
            if best.as_ref().is_none_or(|best| cut.separator < best.separator) {
                best = Some(cut);
            }
        }
        let Some(cut) = best else { return Ok((piece.len(), 0)) };
        self.mark(&cut.vertices, cut.low);
        let (mut separator, mut rest) = (Vec::new(), Vec::with_capacity(piece.len()));
        let mut low = 0;
        for (at, &vertex) in cut.vertices.iter().enumerate() {
            let side = if at < cut.low { LOW } else { HIGH };
            if side == cut.side && self.touches(vertex, LOW + HIGH - side) {
                separator.push(vertex);
            } else {
                rest.push(vertex);
                low += usize::from(side == LOW);
            }
        }
        piece[..separator.len()].copy_from_slice(&separator);
        piece[separator.len()..].copy_from_slice(&rest);
        separator.iter().for_each(|&vertex| self.sides[vertex as usize].store(PLACED, Ordering::Relaxed));
        Ok((separator.len(), low))
    }

    /// The directions that change most from link to link in the middle of the piece, by a sample.
    fn promising(&self, piece: &[u32]) -> Vec<Direction> {
        let step = piece.len().div_ceil(SAMPLE.min(piece.len() / 4));
        let sample: Vec<u32> = piece.iter().copied().step_by(step).collect();
        let pairs = (0..LANDMARKS).flat_map(|a| (0..a).map(move |b| (a, Some(b))));
        let mut directions: Vec<(f32, Direction)> =
            (0..LANDMARKS).map(|a| (a, None)).chain(pairs).map(|d| (self.spread(&sample, d), d)).collect();
        directions.sort_by(|(p, _), (q, _)| q.total_cmp(p));
        directions.truncate(TRIED);
        directions.into_iter().map(|(_, direction)| direction).collect()
    }

    /// How many links wide the middle third of a sample is along a direction.
    fn spread(&self, sample: &[u32], direction: Direction) -> f32 {
        let mut steepness = 0.0;
        let mut values: Vec<f32> = Vec::with_capacity(sample.len());
        for &vertex in sample {
            let value = self.at(vertex, direction);
            let steps = self.graph.arcs(vertex).map(|arc| (self.at(arc.to, direction) - value).abs());
            steepness += steps.fold(0.0, f32::max);
            values.push(value);
        }
        values.sort_unstable_by(f32::total_cmp);
        let middle = values[values.len() * 2 / 3] - values[values.len() / 3];
        middle / (steepness / sample.len() as f32).max(f32::MIN_POSITIVE)
    }

    fn at(&self, vertex: u32, (a, b): Direction) -> f32 {
        let place = &self.places[vertex as usize];
        place[a] - b.map_or(0.0, |b| place[b])
    }

    /// Cuts a piece into halves across a direction.
    fn along(&self, piece: &[u32], direction: Direction) -> Cut {
        let mut values: Vec<(f32, u32)> = piece.iter().map(|&vertex| (self.at(vertex, direction), vertex)).collect();
        let low = piece.len() / 2;
        values.select_nth_unstable_by(low, |(p, v), (q, w)| p.total_cmp(q).then(v.cmp(w)));
        let mut vertices: Vec<u32> = values.into_iter().map(|(_, vertex)| vertex).collect();
        let (lower, higher) = vertices.split_at_mut(low);
        lower.sort_unstable();
        higher.sort_unstable();
        self.mark(&vertices, low);
        let border = |side: &[u32], other| side.iter().filter(|&&vertex| self.touches(vertex, other)).count();
        let borders = [border(&vertices[..low], HIGH), border(&vertices[low..], LOW)];
        let side = if borders[0] < borders[1] { LOW } else { HIGH };
        Cut { vertices, low, side, separator: borders[0].min(borders[1]) }
    }

    fn mark(&self, vertices: &[u32], low: usize) {
        for (at, &vertex) in vertices.iter().enumerate() {
            self.sides[vertex as usize].store(if at < low { LOW } else { HIGH }, Ordering::Relaxed);
        }
    }

    /// Has a vertex a neighbour on that side? Whatever lies outside of the piece is marked as placed: it is a separator.
    fn touches(&self, vertex: u32, side: u8) -> bool {
        self.graph.arcs(vertex).any(|arc| self.sides[arc.to as usize].load(Ordering::Relaxed) == side)
    }
}
