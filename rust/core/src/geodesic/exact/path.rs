//! Shortest paths, unfolded backwards from a vertex to the source.

use std::collections::HashSet;

use super::Exact;
use super::wave::{Wave, Way};
use super::window::length;
use crate::error::check_points;
use crate::geodesic::path::{PathPoint, Site};
use crate::surface::mesh::paths::shortest_path;
use crate::surface::mesh::{BORDER, next, previous};
use crate::{Control, Error, Result};

/// A crossing this close to an end of its edge, as a share of the edge, can be replaced by the end itself.
const AT_VERTEX: f64 = 1e-6;

/// The share of its distance by which a path may then be longer.
const SLACK: f64 = 1e-11;

/// A straight line on its way back: it crosses a half-edge at a position along it, and comes from `x`, `y` beyond it.
#[derive(Debug, Clone, Copy)]
struct Line {
    half_edge: u32,
    at: f64,
    x: f64,
    y: f64,
}

/// A path to a vertex from one that is closer to the source, and the crossings in between, from the far end.
struct Leg {
    vertex: u32,
    crossings: Vec<(u32, f64)>,
}

impl Exact<'_> {
    /// Returns the shortest path from `target` back to the source of the last run of `wave`.
    ///
    /// It always ends, because each of its legs leads to another vertex. Where edges are so short that rounding does
    /// not distinguish distances, and a leg leads back or nowhere, it continues along edges.
    ///
    /// # Errors
    /// [`Error::NoSuchPoint`], [`Error::Unreachable`] if that run did not reach the target, and [`Error::Cancelled`].
    pub fn path(&self, wave: &Wave, target: u32, control: &Control) -> Result<Vec<PathPoint>> {
        check_points([target], wave.distance.len())?;
        if wave.distance[target as usize] == f64::INFINITY {
            return Err(Error::Unreachable { source_vertex: wave.source as usize, vertex: target as usize });
        }
        let mut path = vec![self.at_vertex(target)];
        let mut vertex = target;
        let mut passed = HashSet::from([target]);
        while vertex != wave.source {
            control.check()?;
            let Some(leg) = self.leg(wave, vertex).filter(|leg| passed.insert(leg.vertex)) else {
                let rest = shortest_path(self.surface, &[vertex, wave.source], None, control)?;
                path.extend(rest[1..].iter().map(|&vertex| self.at_vertex(vertex)));
                break;
            };
            path.extend(leg.crossings.into_iter().map(|(half_edge, at)| self.on_edge(half_edge, at)));
            path.push(self.at_vertex(leg.vertex));
            vertex = leg.vertex;
        }
        Ok(path)
    }

    fn at_vertex(&self, vertex: u32) -> PathPoint {
        PathPoint::at(self.surface, Site::Vertex(vertex))
    }

    fn on_edge(&self, half_edge: u32, at: f64) -> PathPoint {
        let along = (at / self.frames.of(half_edge).length).clamp(0.0, 1.0);
        PathPoint::at(self.surface, Site::Edge { half_edge, along })
    }

    fn leg(&self, wave: &Wave, vertex: u32) -> Option<Leg> {
        match wave.ways[vertex as usize] {
            Way::Source => None,
            Way::Along { half_edge } => {
                let [origin, target] = [self.surface.origin(half_edge), self.surface.target(half_edge)];
                Some(Leg { vertex: if origin == vertex { target } else { origin }, crossings: Vec::new() })
            }
            Way::Across { half_edge, at, x, y, root } => self.unfold(wave, vertex, Line { half_edge, at, x, y }, root),
        }
    }

    /// Follows a line back from `vertex` to `root`, face by face, or to a vertex that it touches on the way.
    fn unfold(&self, wave: &Wave, vertex: u32, mut line: Line, root: u32) -> Option<Leg> {
        let reached = wave.distance[vertex as usize];
        let corner = self.frames.of(line.half_edge);
        let walked = length(corner.x - line.at, corner.y); // to the first crossing
        // the length of the leg up to its root, from which the way back to each crossing follows
        let whole = walked + length(line.at - line.x, line.y);
        let mut crossings = Vec::new();
        let mut nearest: Option<(f64, u32, usize)> = None; // vertex to bend around, should rounding mislead the line
        let most = self.surface.faces().len();
        while crossings.len() <= most {
            let edge = self.frames.of(line.half_edge);
            let walked = whole - length(line.at - line.x, line.y);
            let ends = [
                (self.surface.origin(line.half_edge), line.at),
                (self.surface.target(line.half_edge), edge.length - line.at),
            ];
            for (end, off) in ends {
                let through = walked + off + wave.distance[end as usize];
                if off <= AT_VERTEX * edge.length
                    && through <= reached * (1.0 + SLACK)
                    && wave.distance[end as usize] < reached
                {
                    return Some(Leg { vertex: end, crossings });
                }
                if nearest.is_none_or(|(least, ..)| through < least) && wave.distance[end as usize] < reached {
                    nearest = Some((through, end, crossings.len()));
                }
            }
            crossings.push((line.half_edge, line.at));
            match self.enter(line, root) {
                Onward::Root => return Some(Leg { vertex: root, crossings }),
                Onward::Line(next) => line = next,
                Onward::Lost => break,
            }
        }
        let (_, vertex, kept) = nearest?;
        crossings.truncate(kept + 1);
        Some(Leg { vertex, crossings })
    }

    fn enter(&self, line: Line, root: u32) -> Onward {
        let entered = self.surface.twins()[line.half_edge as usize];
        if entered == BORDER {
            return Onward::Lost;
        }
        let frame = self.frames.of(entered);
        let (at, x, y) = (frame.length - line.at, frame.length - line.x, line.y);
        let (apart, up) = (frame.x - x, frame.y - y);
        let size = frame.length + length(frame.x, frame.y);
        if self.surface.origin(previous(entered)) == root && length(apart, up) <= 1e-7 * size {
            return Onward::Root;
        }
        // on which side of the line the opposite corner lies decides through which edge the line leaves
        let is_corner_left = (x - at) * frame.y - y * (frame.x - at) > 0.0;
        let line = if is_corner_left {
            // the line leaves on the right: lengths from the entered half-edge's target
            let (half_edge, back) = (next(entered), frame.length - frame.x);
            let length = self.frames.of(half_edge).length;
            let (at, x) = (frame.length - at, frame.length - x);
            let hit = length * at * y / (y * back + (at - x) * frame.y);
            Line { half_edge, at: hit, x: (x * back + y * frame.y) / length, y: (back * y - frame.y * x) / length }
        } else {
            let half_edge = previous(entered);
            let length = self.frames.of(half_edge).length;
            let hit = length * at * y / (y * frame.x + (at - x) * frame.y);
            let along = (apart * frame.x + up * frame.y) / length;
            Line { half_edge, at: length - hit, x: along, y: (frame.x * y - frame.y * x) / length }
        };
        let length = self.frames.of(line.half_edge).length;
        let is_on = line.at >= -1e-6 * length && line.at <= (1.0 + 1e-6) * length;
        if is_on && line.y > 0.0 { Onward::Line(Line { at: line.at.clamp(0.0, length), ..line }) } else { Onward::Lost }
    }
}

enum Onward {
    /// To its root, a corner of this face.
    Root,
    /// Through another edge of this face.
    Line(Line),
    /// Rounding misled it.
    Lost,
}
