//! Paths by descent on the distances of a march (Kimmel, Sethian 1998, section 4).
//!
//! A point on a path asks what a vertex asks in the march: which front gets here first, and across which side of a triangle?
//! The path leads straight to where that front crosses the side, then on through the triangle beyond; or to a corner, if it
//! is reached from there. So the line is as straight as the fronts are right, and near the source as straight as the lines
//! with which the march begins. The march is over, and every distance known, so obtuse corners need no care.
//!
//! A path ends: it is made of legs from one vertex to another whose distance was final earlier, and a leg crosses no
//! half-edge twice. Where distances contradict each other so much that a leg finds no such way, it goes on along edges.

use std::collections::HashSet;

use nalgebra::Vector3;

use super::{Marching, Wave};
use crate::control::Control;
use crate::error::{Error, Result};
use crate::geodesic::Solver;
use crate::geodesic::graph::{Outgoing, outgoing};
use crate::geodesic::path::{PathPoint, Site};
use crate::surface::cuts::shortest_path;
use crate::surface::mesh::{BORDER, Surface, next, previous};

/// A crossing this near to an end of its side, as a part of the side, is taken for the end itself.
const AT_VERTEX: f64 = 1e-6;

/// The distances from one source, and what it takes to trace paths on them.
#[derive(Debug)]
pub struct Marched<'a> {
    surface: &'a Surface,
    wave: Wave,
    source: u32,
    distance: Vec<f64>,
    /// The order in which distances became final; the source's is the first.
    order: Vec<u32>,
    outgoing: Outgoing,
}

impl Marching<'_> {
    /// The distances from `source`, kept for paths.
    ///
    /// # Errors
    /// [`Error::Cancelled`].
    pub fn march(&self, source: u32, control: &Control) -> Result<Marched<'_>> {
        let mut scratch = self.scratch();
        let mut order = vec![u32::MAX; self.columns()];
        let mut count = 0;
        let settled = |vertex: u32| {
            order[vertex as usize] = count;
            count += 1;
        };
        self.run(source, &mut scratch, settled, control)?;
        let outgoing = outgoing(self.surface);
        Ok(Marched { surface: self.surface, wave: self.wave, source, distance: scratch.distance, order, outgoing })
    }
}

impl Marched<'_> {
    /// The distances to all vertices, mm; infinity where no front came.
    pub fn distances(&self) -> &[f64] {
        &self.distance
    }

    /// A path from `target` back to the source. The distance of a march is an estimate, but the path is a line over the
    /// surface: [its length](crate::geodesic::path::length) may be more or less than the distance here, and is never less
    /// than the exact one.
    ///
    /// # Errors
    /// [`Error::Unreachable`] if no front came to the target, [`Error::Cancelled`].
    pub fn path(&self, target: u32, control: &Control) -> Result<Vec<PathPoint>> {
        if self.distance[target as usize] == f64::INFINITY {
            return Err(self.unreachable(target));
        }
        let mut path = vec![PathPoint::at(self.surface, Site::Vertex(target))];
        let mut vertex = target;
        while vertex != self.source {
            vertex = self.leg(vertex, &mut path, control)?;
        }
        Ok(path)
    }

    /// Adds a leg to a path, from its last vertex to one that was final earlier.
    fn leg(&self, start: u32, path: &mut Vec<PathPoint>, control: &Control) -> Result<u32> {
        let before = self.order[start as usize];
        let mut site = Site::Vertex(start);
        let mut crossed = HashSet::new();
        while let Some(onward) = self.onward(site, before) {
            control.check()?;
            if let Site::Edge { half_edge, .. } = onward
                && !crossed.insert(half_edge)
            {
                break;
            }
            path.push(PathPoint::at(self.surface, onward));
            match onward {
                Site::Vertex(vertex) => return Ok(vertex),
                Site::Edge { .. } => site = onward,
            }
        }
        self.along_edges(site, before, path, control)
    }

    /// From where a site is reached: of the corners at hand that were final before, and the points on sides that fronts
    /// cross, the one of least distance together with the way from there.
    fn onward(&self, site: Site, before: u32) -> Option<Site> {
        let here = PathPoint::at(self.surface, site).point;
        let (corners, sides) = self.at_hand(site);
        let by_corner = corners.into_iter().filter(|&corner| self.order[corner as usize] < before).map(|corner| {
            let way = (self.surface.points()[corner as usize] - here).norm();
            (self.distance[corner as usize] + way, Site::Vertex(corner))
        });
        let by_side = sides.into_iter().filter_map(|side| self.across(here, side, before));
        by_corner.chain(by_side).min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, site)| site)
    }

    /// The corners and the sides to which straight lines lead from a site, forwards if it lies on an edge.
    fn at_hand(&self, site: Site) -> (Vec<u32>, Vec<u32>) {
        let surface = self.surface;
        match site {
            Site::Vertex(vertex) => {
                let outgoing = self.outgoing.of(vertex);
                let corners = outgoing.iter().flat_map(|&h| [surface.target(h), surface.origin(previous(h))]);
                (corners.collect(), outgoing.iter().map(|&h| next(h)).collect())
            }
            Site::Edge { half_edge, .. } => {
                let ends = [surface.origin(half_edge), surface.target(half_edge)];
                match surface.twins()[half_edge as usize] {
                    BORDER => (ends.to_vec(), Vec::new()),
                    twin => ([&ends[..], &[surface.origin(previous(twin))]].concat(), vec![next(twin), previous(twin)]),
                }
            }
        }
    }

    /// How a point on the left of a half-edge is reached by a front that crosses it from the face beyond: the distance, and
    /// where it crosses.
    fn across(&self, here: Vector3<f64>, half_edge: u32, before: u32) -> Option<(f64, Site)> {
        if self.surface.twins()[half_edge as usize] == BORDER {
            return None;
        }
        let [a, b] = [self.surface.origin(half_edge), self.surface.target(half_edge)];
        let [distance_a, distance_b] = [a, b].map(|v| self.distance[v as usize]);
        let origin = self.surface.points()[a as usize];
        let (edge, away) = (self.surface.points()[b as usize] - origin, here - origin);
        let side = edge.norm();
        let (x, y) = (away.dot(&edge) / side, edge.cross(&away).norm() / side);
        let crossing = self.wave.across(distance_a, distance_b, side, x, y)?;
        let along = crossing.at / side;
        let end = [(a, along), (b, 1.0 - along)].into_iter().find(|&(_, off)| off <= AT_VERTEX);
        let site = match end {
            Some((vertex, _)) if self.order[vertex as usize] < before => Site::Vertex(vertex),
            _ => Site::Edge { half_edge, along },
        };
        Some((crossing.reached, site))
    }

    /// Adds a way along edges to a path, from its last site to the first vertex that was final before.
    fn along_edges(&self, site: Site, before: u32, path: &mut Vec<PathPoint>, control: &Control) -> Result<u32> {
        let start = match site {
            Site::Vertex(vertex) => vertex,
            Site::Edge { half_edge, .. } => {
                let [a, b] = [self.surface.origin(half_edge), self.surface.target(half_edge)];
                if self.order[a as usize] < self.order[b as usize] { a } else { b }
            }
        };
        for vertex in shortest_path(self.surface, &[start, self.source], None, control)? {
            if site != Site::Vertex(vertex) {
                path.push(PathPoint::at(self.surface, Site::Vertex(vertex)));
            }
            if self.order[vertex as usize] < before {
                return Ok(vertex);
            }
        }
        Err(self.unreachable(start))
    }

    fn unreachable(&self, vertex: u32) -> Error {
        Error::Unreachable { source_vertex: self.source as usize, vertex: vertex as usize }
    }
}
