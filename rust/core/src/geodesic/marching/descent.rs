//! Paths by descent on the distances of a march (Kimmel, Sethian 1998, section 4).
//!
//! A point on a path is treated like a vertex in the march: which front arrives first, and across which side of a
//! triangle? The path leads straight to where that front crosses the side, and continues from there. Fronts at the
//! sides of the current triangle are not more accurate than those farther away, but a line would bend at every side
//! where it stops. So it looks as far as the march does from its source, across several sides that are unfolded into
//! the plane (`visibility`). A visible vertex is taken if the path through it is shorter than by any front: at saddles,
//! on borders, at the source. The march is finished and every distance is known, so obtuse corners need no care.
//!
//! A path ends, because its legs lead from one vertex to another whose distance was final earlier, and a leg crosses no
//! half-edge twice. Where contradictory distances permit no such path, a leg continues along edges.

use std::collections::HashSet;

use nalgebra::Vector2;

use super::visibility::{First, Side, View};
use super::{Marching, SEEN, Wave};
use crate::adjacency::Groups;
use crate::error::check_points;
use crate::geodesic::path::{PathPoint, Site};
use crate::geodesic::{graph::outgoing, solver::Solver};
use crate::surface::mesh::paths::shortest_path;
use crate::surface::mesh::{BORDER, Surface, next, previous};
use crate::{Control, Error, Result};

/// A crossing this close to an end of its side, as a share of the side, is replaced by the end itself.
const AT_VERTEX: f64 = 1e-6;

/// The distances from one source, with the data for tracing paths.
#[derive(Debug)]
pub struct Marched<'a> {
    surface: &'a Surface,
    wave: Wave,
    source: u32,
    distance: Vec<f64>,
    /// The order in which distances became final; the source is the first.
    order: Vec<u32>,
    outgoing: Groups,
}

impl Marching<'_> {
    /// Computes the distances from `source`, and keeps them for paths.
    ///
    /// # Errors
    /// [`Error::NoSuchPoint`] and [`Error::Cancelled`].
    pub fn march(&self, source: u32, control: &Control) -> Result<Marched<'_>> {
        check_points([source], self.columns())?;
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
    /// Returns a path from `target` back to the source. The distance of a march is an estimate, but the path is a line
    /// over the surface. [Its length](crate::geodesic::path::length) can be more or less than this distance, but never
    /// less than the exact one. Across a triangle that is folded back onto another one, it can be some per cent more (9
    /// were observed).
    ///
    /// # Errors
    /// [`Error::NoSuchPoint`], [`Error::Unreachable`] if no front reached the target, and [`Error::Cancelled`].
    pub fn path(&self, target: u32, control: &Control) -> Result<Vec<PathPoint>> {
        check_points([target], self.distance.len())?;
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
        let mut is_new = |site: &Site| match *site {
            Site::Vertex(_) => true,
            Site::Edge { half_edge, .. } => crossed.insert(half_edge),
        };
        while let Some(line) = self.line(site, before) {
            control.check()?;
            for onward in line {
                if !is_new(&onward) {
                    return self.along_edges(site, before, path, control);
                }
                path.push(PathPoint::at(self.surface, onward));
                site = onward;
            }
            if let Site::Vertex(vertex) = site {
                return Ok(vertex);
            }
        }
        self.along_edges(site, before, path, control)
    }

    /// Returns the straight line by which a site is reached first, and what it crosses on the way back: from a visible
    /// vertex that was final before, or from where a front crosses a visible side.
    fn line(&self, site: Site, before: u32) -> Option<Vec<Site>> {
        let here = PathPoint::at(self.surface, site).point;
        let mut first = First::new();
        let (corners, sides) = self.at_hand(site);
        for corner in corners.into_iter().filter(|&corner| self.order[corner as usize] < before) {
            let way = (self.surface.points()[corner as usize] - here).norm();
            first.offer(self.distance[corner as usize] + way, (Site::Vertex(corner), Vector2::zeros()), &[]);
        }
        let mut views: Vec<View> = sides.into_iter().map(|side| View::of(self.surface, here, side)).collect();
        let mut crossed = Vec::new();
        while let Some(view) = views.pop() {
            crossed.truncate(view.crossed);
            self.offer_front(&view, &crossed, before, &mut first);
            crossed.push(view.side);
            if crossed.len() == SEEN as usize {
                continue;
            }
            let (corner, beyond) = view.beyond(self.surface);
            if let Some((vertex, place)) = corner.filter(|&(vertex, _)| self.order[vertex as usize] < before) {
                let reached = self.distance[vertex as usize] + place.norm();
                first.offer(reached, (Site::Vertex(vertex), place), &crossed);
            }
            views.extend(beyond);
        }
        first.line
    }

    /// Offers the line from where a front crosses a visible side, if anything lies beyond.
    fn offer_front(&self, view: &View, crossed: &[Side], before: u32, first: &mut First) {
        let Side { half_edge, right, left } = view.side;
        if self.surface.twins()[half_edge as usize] == BORDER {
            return;
        }
        let [here, there] = [right.0, left.0].map(|v| self.distance[v as usize]);
        let side = (left.1 - right.1).norm();
        let direction = (left.1 - right.1) / side;
        // the viewer, which is the origin, in the frame of the side: along it from its right end, and away from it
        let (x, y) = (-right.1.dot(&direction), right.1.perp(&direction).abs());
        let Some(crossing) = self.wave.across(here, there, side, x, y) else { return };
        let place = right.1 + direction * crossing.at;
        if view.shows(place) {
            let along = crossing.at / side;
            let end = [(right.0, along), (left.0, 1.0 - along)].into_iter().find(|&(_, off)| off <= AT_VERTEX);
            let site = match end {
                Some((vertex, _)) if self.order[vertex as usize] < before => Site::Vertex(vertex),
                _ => Site::Edge { half_edge, along },
            };
            first.offer(crossing.reached, (site, place), crossed);
        }
    }

    /// Returns the corners and the sides to which straight lines lead from a site, forwards if it lies on an edge.
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

    /// Adds a path along edges, from the last site to the first vertex that was final before.
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

#[cfg(test)]
mod tests;
