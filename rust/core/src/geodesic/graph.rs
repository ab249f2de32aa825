//! Geodesics over the triangles of a surface as paths in a graph.
//!
//! Faces around a vertex are unfolded into its plane, one across the next. Another vertex that is then seen from it, through
//! the edges in between, is joined to it by a straight line across these faces: a true path on the surface, and the
//! shortest through these faces. Such lines and the edges are the links. Distances are therefore those of real paths, never
//! too short, symmetric, and obey the triangle inequality; they are too long where no chain of links runs straight.

use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;

use crate::adjacency::{Arc, Links};
use crate::control::Control;
use crate::error::Result;
use crate::surface::mesh::{BORDER, Surface, next, previous};

/// How many edges a link may cross (docs/decisions/0007: what more would bring, and cost).
const CROSSED: u32 = 11;

/// On a surface of more vertices links cross fewer edges: while they are found they would need more memory than all the rest.
pub const LARGE: usize = 250_000;
const CROSSED_IF_LARGE: u32 = 5;

/// Vertices whose links are found together, before they are packed.
const TOGETHER: usize = 1 << 16;

/// A link is dropped if two others are together no longer than so many times its length (docs/decisions/0007).
const DETOUR: f32 = 1.001;

/// Straight links over a surface, in compressed rows; a vertex's arcs are ordered by neighbour.
#[derive(Debug, Clone)]
pub struct GeodesicGraph {
    starts: Vec<u32>,
    arcs: Vec<Arc>,
    most_links: usize,
    extremes: [f32; 2],
}

/// Links, each from its lower to its higher vertex, in compressed rows ordered by neighbour.
struct Upward {
    starts: Vec<u32>,
    arcs: Vec<Arc>,
}

impl Upward {
    fn of(&self, vertex: u32) -> &[Arc] {
        &self.arcs[self.starts[vertex as usize] as usize..self.starts[vertex as usize + 1] as usize]
    }

    fn iter(&self) -> impl Iterator<Item = (u32, Arc)> + '_ {
        (0..self.starts.len() as u32 - 1).flat_map(|vertex| self.of(vertex).iter().map(move |&arc| (vertex, arc)))
    }

    /// Those that are marked.
    fn only(mut self, marked: &[bool]) -> Self {
        let mut kept = 0;
        for vertex in 0..self.starts.len() - 1 {
            let links = self.starts[vertex] as usize..self.starts[vertex + 1] as usize;
            self.starts[vertex] = kept as u32;
            for link in links.filter(|&link| marked[link]) {
                self.arcs[kept] = self.arcs[link];
                kept += 1;
            }
        }
        let vertices = self.starts.len() - 1;
        self.starts[vertices] = kept as u32;
        self.arcs.truncate(kept);
        self
    }
}

impl GeodesicGraph {
    /// The graph of a surface.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    pub fn new(surface: &Surface, control: &Control) -> Result<Self> {
        let crossed = if surface.len() > LARGE { CROSSED_IF_LARGE } else { CROSSED };
        Self::crossing(surface, crossed, control)
    }

    /// The graph whose links cross up to so many edges.
    pub(crate) fn crossing(surface: &Surface, crossed: u32, control: &Control) -> Result<Self> {
        control.begin("joining neighbours", 2 * surface.len() as u64);
        let outgoing = outgoing(surface);
        let of_vertex = |vertex: u32| {
            control.advance();
            if vertex.is_multiple_of(1024) {
                control.check()?;
            }
            let mut seen = Vec::with_capacity(64);
            for &half_edge in outgoing.of(vertex) {
                unfold(surface, half_edge, crossed, &mut seen);
            }
            seen.retain(|arc| arc.to > vertex); // the others see this one
            seen.sort_unstable_by_key(|arc| (arc.to, arc.length.to_bits())); // lengths are not negative
            seen.dedup_by_key(|arc| arc.to); // of all lines between two vertices the shortest counts
            Ok(seen)
        };
        let mut links = Upward { starts: vec![0], arcs: Vec::new() };
        for first in (0..surface.len() as u32).step_by(TOGETHER) {
            let vertices = first..(first + TOGETHER as u32).min(surface.len() as u32);
            let seen: Vec<Vec<Arc>> = vertices.into_par_iter().map(of_vertex).collect::<Result<_>>()?;
            for arcs in seen {
                links.arcs.extend(arcs);
                links.starts.push(links.arcs.len() as u32);
            }
        }
        let all = Self::from_both_ends(&links);
        let needed = all.needed(&links, all.perhaps_needless(&links, control)?, control)?;
        drop(all);
        control.check()?;
        let kept = links.only(&needed);
        Ok(Self::from_both_ends(&kept))
    }

    fn from_both_ends(links: &Upward) -> Self {
        let vertices = links.starts.len() - 1;
        let mut starts = vec![0u32; vertices + 1];
        for (a, arc) in links.iter() {
            starts[a as usize + 1] += 1;
            starts[arc.to as usize + 1] += 1;
        }
        let most_links = starts.iter().copied().max().unwrap_or(0) as usize;
        for vertex in 0..vertices {
            starts[vertex + 1] += starts[vertex];
        }
        // links are sorted, so each vertex meets its lower neighbours first, then its higher ones, both in their order
        let mut arcs = vec![Arc { to: 0, length: 0.0 }; 2 * links.arcs.len()];
        let mut free = starts.clone();
        for (a, arc) in links.iter() {
            for (from, to) in [(a, arc.to), (arc.to, a)] {
                arcs[free[from as usize] as usize] = Arc { to, ..arc };
                free[from as usize] += 1;
            }
        }
        let lengths = || links.arcs.iter().map(|arc| arc.length);
        let longest = lengths().fold(0.0, f32::max);
        let extremes = [lengths().fold(longest, f32::min), longest];
        Self { starts, arcs, most_links, extremes }
    }

    /// Which links two others would replace, if these stayed.
    fn perhaps_needless(&self, links: &Upward, control: &Control) -> Result<Vec<bool>> {
        let of_vertex = |lengths: &mut Vec<f32>, vertex: u32| {
            control.check()?;
            control.advance();
            lengths.resize(self.vertices(), f32::INFINITY);
            self.arcs(vertex).for_each(|arc| lengths[arc.to as usize] = arc.length);
            let needless = |link: &Arc| {
                let most = link.length * DETOUR;
                self.links_of(link.to).iter().any(|second| lengths[second.to as usize] + second.length <= most)
            };
            let needless: Vec<bool> = links.of(vertex).iter().map(needless).collect();
            self.arcs(vertex).for_each(|arc| lengths[arc.to as usize] = f32::INFINITY);
            Ok(needless)
        };
        let vertices = (0..self.vertices() as u32).into_par_iter();
        let needless: Vec<Vec<bool>> = vertices.map_init(Vec::new, of_vertex).collect::<Result<_>>()?;
        Ok(needless.concat())
    }

    /// Which links stay, so that every other is replaced by two that do. Shorter ones are judged first.
    fn needed(&self, links: &Upward, needless: Vec<bool>, control: &Control) -> Result<Vec<bool>> {
        let mut needed: Vec<bool> = needless.iter().map(|needless| !needless).collect();
        let mut stays = vec![false; self.arcs.len()];
        let keep = |stays: &mut [bool], a: u32, b: u32| {
            for (from, to) in [(a, b), (b, a)] {
                let place = self.links_of(from).partition_point(|arc| arc.to < to);
                stays[self.starts[from as usize] as usize + place] = true;
            }
        };
        let sure = links.iter().zip(&needed).filter(|&(_, &needed)| needed);
        sure.for_each(|((a, arc), _)| keep(&mut stays, a, arc.to));
        let mut open: Vec<(u32, u32)> = (0..).zip(links.iter()).map(|(link, (a, _))| (link, a)).collect();
        open.retain(|&(link, _)| needless[link as usize]);
        open.par_sort_unstable_by_key(|&(link, _)| (links.arcs[link as usize].length.to_bits(), link));
        control.begin("dropping needless links", open.len().div_ceil(1024) as u64);
        for (count, (link, a)) in open.into_iter().enumerate() {
            if count.is_multiple_of(1024) {
                control.check()?;
                control.advance();
            }
            let arc = links.arcs[link as usize];
            if !self.is_replaced(a, arc, &stays) {
                keep(&mut stays, a, arc.to);
                needed[link as usize] = true;
            }
        }
        Ok(needed)
    }

    /// Are two links that stay together hardly longer than a link?
    fn is_replaced(&self, a: u32, link: Arc, stays: &[bool]) -> bool {
        let [mut of_a, mut of_b] =
            [a, link.to].map(|v| self.starts[v as usize] as usize..self.starts[v as usize + 1] as usize);
        while let (false, false) = (of_a.is_empty(), of_b.is_empty()) {
            let [first, second] = [self.arcs[of_a.start], self.arcs[of_b.start]];
            if first.to == second.to
                && stays[of_a.start]
                && stays[of_b.start]
                && first.length + second.length <= link.length * DETOUR
            {
                return true;
            }
            of_a.start += usize::from(first.to <= second.to);
            of_b.start += usize::from(second.to <= first.to);
        }
        false
    }

    fn links_of(&self, vertex: u32) -> &[Arc] {
        &self.arcs[self.starts[vertex as usize] as usize..self.starts[vertex as usize + 1] as usize]
    }

    /// Number of links, each counted from both of its ends.
    pub fn links(&self) -> usize {
        self.arcs.len()
    }

    /// Where each vertex's links begin, and the end of the last one's.
    pub fn starts(&self) -> &[u32] {
        &self.starts
    }
}

impl Links for GeodesicGraph {
    fn vertices(&self) -> usize {
        self.starts.len() - 1
    }

    #[inline]
    fn arcs(&self, vertex: u32) -> impl Iterator<Item = Arc> + '_ {
        self.links_of(vertex).iter().copied()
    }

    fn most_links(&self) -> usize {
        self.most_links
    }

    fn extremes(&self) -> [f32; 2] {
        self.extremes
    }
}

/// The half-edges that leave each vertex, in compressed rows.
#[derive(Debug)]
pub(super) struct Outgoing {
    starts: Vec<u32>,
    half_edges: Vec<u32>,
}

impl Outgoing {
    pub(super) fn of(&self, vertex: u32) -> &[u32] {
        &self.half_edges[self.starts[vertex as usize] as usize..self.starts[vertex as usize + 1] as usize]
    }
}

pub(super) fn outgoing(surface: &Surface) -> Outgoing {
    let mut half_edges: Vec<u32> = (0..surface.twins().len() as u32).collect();
    half_edges.sort_by_key(|&h| surface.origin(h));
    let mut starts = vec![0; surface.len() + 1];
    half_edges.iter().for_each(|&h| starts[surface.origin(h) as usize + 1] += 1);
    for vertex in 0..surface.len() {
        starts[vertex + 1] += starts[vertex];
    }
    Outgoing { starts, half_edges }
}

/// What is seen from a vertex at the origin through an edge: the edge's ends in the plane, `right` and `left`, and the
/// directions between which nothing hides it.
struct Window {
    half_edge: u32,
    right: Vector2<f64>,
    left: Vector2<f64>,
    from: Vector2<f64>,
    to: Vector2<f64>,
    crossed: u32,
}

/// Lists what the origin of a half-edge sees through the face on its left: the edge itself, the face's other edge where
/// nothing lies beyond, and vertices beyond up to `most` edges.
pub(super) fn unfold(surface: &Surface, half_edge: u32, most: u32, seen: &mut Vec<Arc>) {
    let point = |v: u32| surface.points()[v as usize];
    let vertex = surface.origin(half_edge);
    let (a, b) = (surface.target(half_edge), surface.origin(previous(half_edge)));
    let (to_a, to_b) = (point(a) - point(vertex), point(b) - point(vertex));
    seen.push(Arc { to: a, length: to_a.norm() as f32 });
    seen.push(Arc { to: b, length: to_b.norm() as f32 });
    let right = Vector2::new(to_a.norm(), 0.0);
    let left = Vector2::new(to_a.dot(&to_b), to_a.cross(&to_b).norm()) / to_a.norm();
    let mut windows = vec![Window { half_edge: next(half_edge), right, left, from: right, to: left, crossed: 0 }];
    while let Some(window) = windows.pop() {
        let twin = surface.twins()[window.half_edge as usize];
        if twin == BORDER || window.crossed == most {
            continue;
        }
        let beyond = surface.origin(previous(twin));
        let [p, q] = [window.half_edge, next(window.half_edge)].map(|h| point(surface.origin(h)));
        let place = beside(window.right, window.left, p, q, point(beyond));
        let crossed = window.crossed + 1;
        let is_right_of_left_end = window.to.perp(&place) < 0.0;
        let is_left_of_right_end = window.from.perp(&place) > 0.0;
        if is_right_of_left_end && is_left_of_right_end && beyond != vertex {
            seen.push(Arc { to: beyond, length: place.norm() as f32 });
        }
        if is_left_of_right_end {
            let to = if is_right_of_left_end { place } else { window.to };
            windows.push(Window { half_edge: next(twin), left: place, to, crossed, ..window });
        }
        if is_right_of_left_end {
            let from = if is_left_of_right_end { place } else { window.from };
            windows.push(Window { half_edge: previous(twin), right: place, from, crossed, ..window });
        }
    }
}

/// The place in the plane of a point of the face beyond the edge from `p` to `q`, which lie at `right` and `left`.
fn beside(
    right: Vector2<f64>,
    left: Vector2<f64>,
    p: Vector3<f64>,
    q: Vector3<f64>,
    point: Vector3<f64>,
) -> Vector2<f64> {
    let edge = q - p;
    let length = edge.norm();
    let along = (point - p).dot(&edge) / length;
    let away = edge.cross(&(point - p)).norm() / length;
    let direction = (left - right) / length;
    right + direction * along + Vector2::new(direction.y, -direction.x) * away
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geodesic::Solver;
    use crate::surface::mesh::shapes;

    fn row(graph: &GeodesicGraph, source: u32) -> Vec<f32> {
        let mut row = vec![0.0; graph.vertices()];
        graph.row(source, &mut row, &mut graph.scratch(), &Control::default()).unwrap();
        row
    }

    #[test]
    fn links_on_a_plane_are_straight() {
        let surface = shapes::surface(shapes::sheet(9, 7));
        for crossed in 0..6 {
            let graph = GeodesicGraph::crossing(&surface, crossed, &Control::default()).unwrap();
            for v in 0..surface.len() as u32 {
                for arc in graph.arcs(v) {
                    let apart = surface.points()[v as usize] - surface.points()[arc.to as usize];
                    assert!((f64::from(arc.length) - apart.norm()).abs() < 1e-5);
                    assert!(graph.arcs(arc.to).any(|back| back == Arc { to: v, ..arc }));
                }
            }
        }
    }

    #[test]
    fn a_link_over_the_edge_of_a_box_is_unfolded() {
        // two squares at a right angle: across the fold 2 x 1, unfolded
        let points =
            [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 1.0]];
        let faces = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [4, 3, 5]];
        let (surface, _) = Surface::from_triangles(&points, &faces).unwrap();
        let graph = GeodesicGraph::new(&surface, &Control::default()).unwrap();
        let found = graph.arcs(2).find(|arc| arc.to == 4).unwrap();
        assert!((f64::from(found.length) - 5f64.sqrt()).abs() < 1e-6);
    }

    #[test]
    fn distances_on_a_sphere_are_never_short_and_hardly_long() {
        let surface = shapes::surface(shapes::sphere(5));
        let graph = GeodesicGraph::new(&surface, &Control::default()).unwrap();
        let mut sum = 0.0;
        let row = row(&graph, 17);
        for (point, &distance) in surface.points().iter().zip(&row).filter(|&(_, &d)| d > 0.0) {
            let chord = (point - surface.points()[17]).norm();
            let arc = 2.0 * (chord / 2.0).asin();
            assert!(f64::from(distance) > chord - 1e-5 && f64::from(distance) > 0.998 * arc, "{distance} {arc}");
            sum += f64::from(distance) / arc - 1.0;
        }
        let mean = sum / (surface.len() - 1) as f64;
        assert!(mean < 0.006, "{mean}");
    }

    #[test]
    fn links_that_are_dropped_are_replaced_even_where_triangles_are_thin() {
        let (mut points, faces) = shapes::sheet(12, 40);
        points.iter_mut().for_each(|point| point[1] *= 1e-3); // edges of 1 and of 0.001 mm
        let surface = shapes::surface((points, faces));
        let graph = GeodesicGraph::new(&surface, &Control::default()).unwrap();
        assert_eq!(graph.components().sizes.len(), 1);
        let all = row(&graph, 5);
        for (point, &distance) in surface.points().iter().zip(&all) {
            let straight = (point - surface.points()[5]).norm();
            assert!(f64::from(distance) >= straight - 1e-5 && f64::from(distance) < 1.05 * straight + 1e-5);
        }
    }

    #[test]
    fn nothing_crosses_a_cut() {
        let surface = shapes::surface(shapes::sheet(4, 8));
        let along: Vec<u32> = (0..surface.twins().len() as u32)
            .filter(|&h| {
                let [a, b] = [surface.origin(h), surface.target(h)].map(|v| surface.points()[v as usize]);
                a.y == 4.0 && b.y == 4.0
            })
            .collect();
        let graph = GeodesicGraph::new(&surface.cut_open(along), &Control::default()).unwrap();
        assert_eq!(graph.components().sizes.len(), 2);
    }
}
