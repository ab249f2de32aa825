//! Handles, found by short loops around them.
//!
//! A non-separating loop goes around or through a handle; a cut along it removes a handle. The shortest such loop
//! through a vertex consists of two shortest paths from it and an edge (Thomassen 1990). Every such loop meets one of
//! the 2 g generating loops, so that only their vertices must be searched from (Kutz 2006). Searches begin with a short
//! reach, which is then doubled repeatedly. The shortest loop is taken first, then the shortest one that does not touch
//! it and is still not separating, and so on. Finally, the surface is cut open along them. This is a greedy choice: no
//! loop is much longer than necessary, but the sum need not be minimal, for which no efficient algorithm is known.
//!
//! Loops of r edges among V vertices take O(V log V) per doubling of the reach, and O(r² log r) per searched vertex.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use nalgebra::Vector3;

use crate::adjacency::distinct;
use crate::surface::mesh::paths::{EdgeSearch, length};
use crate::surface::mesh::{BORDER, Surface};
use crate::surface::topology::Topology;
use crate::surface::topology::homology::{Homology, Shrunk};
use crate::{Control, Result};

/// The cost of a path through a boundary loop, as a share of the loop's length: that of its longest way around.
pub(crate) const TOLL: f64 = 0.5;

/// The distance between searched vertices along a generating loop, as a share of the reach.
const SPACING: f64 = 1.0 / 8.0;

/// The number of vertices of a loop from which a shorter loop is searched, and the number of repetitions.
const TIGHTENED: (usize, usize) = (12, 4);

/// A handle, described by a short loop around or through it.
#[derive(Debug, Clone, PartialEq)]
pub struct Handle {
    /// The vertices along the loop, each connected to the next one and the last to the first. The loop may run along
    /// the boundary or an earlier cut.
    pub vertices: Vec<u32>,
    /// The half-edges to cut: those of the loop that do not run along the boundary or an earlier cut.
    pub half_edges: Vec<u32>,
    /// The length of the loop in mm.
    pub length: f64,
    /// The mean position on the loop in RAS+ mm.
    pub centre: Vector3<f64>,
}

/// Returns a short loop for every handle of all components, in the order in which [`cut_handles`] cuts them: none
/// separates the surface after the cuts before it.
///
/// # Errors
/// [`Error::Cancelled`](crate::Error::Cancelled).
pub fn handles(surface: &Surface, control: &Control) -> Result<Vec<Handle>> {
    cut_handles(surface, control).map(|(_, handles)| handles)
}

/// Cuts the surface open along short loops around all its handles, which gives genus 0 without changing voxels. Each
/// loop adds one or two boundary loops, and no component. Half-edges keep their numbers.
///
/// # Errors
/// [`Error::Cancelled`](crate::Error::Cancelled).
pub fn cut_handles(surface: &Surface, control: &Control) -> Result<(Surface, Vec<Handle>)> {
    let mut open = surface.clone();
    let mut handles = Vec::new();
    if Topology::of(surface).genus == 0 {
        return Ok((open, handles));
    }
    let mut reach = mean_length(surface);
    loop {
        let shrunk = Shrunk::new(&open, TOLL);
        let homology = Homology::new(&shrunk, control)?;
        if homology.generators.is_empty() {
            break;
        }
        control.begin("finding handles", homology.generators.len() as u64 / 2);
        let mut seeker = Seeker::new(&shrunk, homology);
        while seeker.found.is_empty() && reach.is_finite() {
            reach *= 2.0;
            seeker.seek(reach, control)?;
        }
        let found = seeker.found;
        if found.is_empty() {
            break; // impossible: a generating loop is not separating
        }
        let rims = Rims::new(&open);
        handles.extend(found.iter().map(|half_edges| rims.handle(surface, &open, half_edges)));
        open = open.cut_open(found.into_iter().flatten());
    }
    let half_edges = handles.iter().flat_map(|handle: &Handle| &handle.half_edges);
    Ok((surface.cut_open(half_edges.copied()), handles)) // cut at once, so that numbers do not depend on the order
}

/// Returns the mean length of an edge in mm; never 0.
fn mean_length(surface: &Surface) -> f64 {
    let edges = surface.edges().count().max(1) as f64;
    let mean = surface.edges().map(|h| length(surface, h) / edges).sum::<f64>();
    if mean > 0.0 { mean } else { 1.0 }
}

#[derive(Debug)]
struct Found {
    half_edges: Vec<u32>,
    mark: u64,
    /// Its length in mm, including tolls.
    length: f64,
    /// The length of the path from the searched vertex to the loop, around it and back.
    through: f64,
}

/// The state of the search for loops.
struct Seeker<'a> {
    shrunk: &'a Shrunk<'a>,
    homology: Homology,
    search: EdgeSearch,
    /// The marks of the shortest paths to the nodes.
    marks: Vec<u64>,
    /// The nodes on loops that were taken.
    is_taken: Vec<bool>,
    /// The half-edges on these loops.
    is_cut: Vec<bool>,
    across: Across,
    found: Vec<Vec<u32>>,
}

impl<'a> Seeker<'a> {
    fn new(shrunk: &'a Shrunk<'a>, homology: Homology) -> Self {
        Self {
            shrunk,
            homology,
            search: EdgeSearch::new(shrunk.node.len()),
            marks: vec![0; shrunk.node.len()],
            is_taken: vec![false; shrunk.node.len()],
            is_cut: vec![false; shrunk.surface.twins().len()],
            across: Across::new(shrunk.surface.faces().len()),
            found: Vec::new(),
        }
    }

    /// Takes loops up to twice the reach, the shortest first, until no vertex has one. Each loop that is taken can only
    /// make other loops longer, so that only the vertex with the currently shortest loop must be searched again.
    fn seek(&mut self, reach: f64, control: &Control) -> Result<()> {
        let mut claims = BinaryHeap::new();
        for root in self.roots(SPACING * reach) {
            let found = self.shortest_through(root, 2.0 * reach, control)?;
            claims.extend(found.map(|found| Reverse((found.through.to_bits(), root))));
        }
        while let Some(Reverse((claim, root))) = claims.pop() {
            if 2 * self.found.len() == self.homology.generators.len() {
                break;
            }
            let Some(found) = self.shortest_through(root, 2.0 * reach, control)? else { continue };
            if found.through.to_bits() > claim {
                claims.push(Reverse((found.through.to_bits(), root)));
                continue;
            }
            let found = self.tightened(found, control)?;
            self.take(found, control)?;
        }
        Ok(())
    }

    /// Returns nodes along the generating loops, `spacing` mm apart.
    fn roots(&self, spacing: f64) -> Vec<u32> {
        let mut roots = Vec::new();
        for generator in &self.homology.generators {
            let mut since = f64::INFINITY;
            for &h in generator {
                if since >= spacing {
                    roots.push(self.shrunk.ends(h)[0]);
                    since = 0.0;
                }
                since += length(self.shrunk.surface, h);
            }
        }
        distinct(roots)
    }

    /// Returns the shortest non-separating loop through a node, off taken loops and shorter than `limit` (mm).
    fn shortest_through(&mut self, root: u32, limit: f64, control: &Control) -> Result<Option<Found>> {
        let Self { shrunk, homology, search, marks, is_taken, .. } = self;
        if is_taken[root as usize] {
            return Ok(None);
        }
        search.clear();
        search.seed(root);
        let mut best = (limit, None, 0);
        while let Some(node) = search.settle(&shrunk.network, |to| !is_taken[to as usize]) {
            control.check()?;
            let here = search.distance(node);
            if 2.0 * here >= best.0 {
                break; // any edge between nodes at this distance closes a longer loop
            }
            let step = search.step(node);
            let mark = step.map_or(0, |step| marks[step.from as usize] ^ homology.mark(step.half_edge));
            marks[node as usize] = mark;
            for arc in shrunk.network.incident(node).iter().filter(|arc| search.is_settled(arc.to)) {
                let through = here + search.distance(arc.to) + arc.cost;
                let mark = mark ^ marks[arc.to as usize] ^ homology.mark(arc.half_edge);
                if through < best.0 && mark != 0 {
                    best = (through, Some(arc.half_edge), mark);
                }
            }
        }
        let (through, edge, mark) = best;
        Ok(edge.map(|edge| {
            let half_edges = shrunk.closed_by(search, edge);
            let stem = search.distance(shrunk.ends(half_edges[0])[0]);
            Found { half_edges, mark, length: through - 2.0 * stem, through }
        }))
    }

    /// Shortens a loop by repeatedly taking the shortest loop through one of its vertices.
    fn tightened(&mut self, mut found: Found, control: &Control) -> Result<Found> {
        let (most, times) = TIGHTENED;
        for _ in 0..times {
            let before = found.length;
            let step = found.half_edges.len().div_ceil(most);
            let roots: Vec<u32> = found.half_edges.iter().step_by(step).map(|&h| self.shrunk.ends(h)[0]).collect();
            for root in roots {
                if let Some(shorter) = self.shortest_through(root, found.length, control)? {
                    found = shorter;
                }
            }
            if found.length >= before {
                break;
            }
        }
        Ok(found)
    }

    /// Takes a loop, unless it is separating. A loop across edges that crosses it once changes all marks such that its
    /// own mark is zero. The marks of all loops that form a separating set with it are then zero too.
    fn take(&mut self, found: Found, control: &Control) -> Result<()> {
        let surface = self.shrunk.surface;
        let twin = |h: u32| surface.twins()[h as usize];
        found.half_edges.iter().flat_map(|&h| [h, twin(h)]).for_each(|h| self.is_cut[h as usize] = true);
        let first = found.half_edges[0];
        let is_open = |h: u32| !self.is_cut[h as usize];
        let Some(crossed) = self.across.path(surface, first / 3, twin(first) / 3, is_open, control)? else {
            found.half_edges.iter().flat_map(|&h| [h, twin(h)]).for_each(|h| self.is_cut[h as usize] = false);
            return Ok(());
        };
        let edges = crossed.into_iter().chain([first]).map(|h| h.min(twin(h)));
        self.homology.count(edges, found.mark);
        found.half_edges.iter().for_each(|&h| self.is_taken[self.shrunk.ends(h)[0] as usize] = true);
        self.found.push(found.half_edges);
        control.advance();
        Ok(())
    }
}

/// A reusable breadth-first search from face to face.
#[derive(Debug)]
struct Across {
    /// The last round in which each face was visited, and the half-edge across which.
    seen: Vec<(u32, u32)>,
    round: u32,
}

impl Across {
    fn new(faces: usize) -> Self {
        Self { seen: vec![(0, 0); faces], round: 0 }
    }

    /// Returns the half-edges that are crossed on a path from one face to another.
    fn path(
        &mut self, surface: &Surface, from: u32, to: u32, is_open: impl Fn(u32) -> bool, control: &Control,
    ) -> Result<Option<Vec<u32>>> {
        self.round += 1;
        self.seen[from as usize] = (self.round, u32::MAX);
        let mut queue = vec![from];
        let mut at = 0;
        while self.seen[to as usize].0 != self.round {
            let Some(&face) = queue.get(at) else { return Ok(None) };
            at += 1;
            control.check()?;
            for h in 3 * face..3 * face + 3 {
                let twin = surface.twins()[h as usize];
                if twin != BORDER && is_open(h) && self.seen[twin as usize / 3].0 != self.round {
                    self.seen[twin as usize / 3] = (self.round, h);
                    queue.push(twin / 3);
                }
            }
        }
        let entered = |face: u32| Some(self.seen[face as usize].1).filter(|&h| h != u32::MAX);
        Ok(Some(std::iter::successors(entered(to), |&h| entered(h / 3)).collect()))
    }
}

/// The boundary loops of a surface that is being cut open.
struct Rims {
    loops: Vec<Vec<u32>>,
    /// The loop of each boundary vertex, and its position in the loop.
    place: Vec<(u32, u32)>,
    /// A half-edge that begins at each vertex.
    corner: Vec<u32>,
}

impl Rims {
    fn new(open: &Surface) -> Self {
        let loops = open.boundary();
        let mut place = vec![(0, 0); open.len()];
        for (n, rim) in (0..).zip(&loops) {
            (0..).zip(rim).for_each(|(at, &h)| place[open.origin(h) as usize] = (n, at));
        }
        let mut corner = vec![0; open.len()];
        (0..open.twins().len() as u32).for_each(|h| corner[open.origin(h) as usize] = h);
        Self { loops, place, corner }
    }

    /// Returns a loop of half-edges of `open`, closed along the boundary, as a handle of `surface`.
    fn handle(&self, surface: &Surface, open: &Surface, half_edges: &[u32]) -> Handle {
        let before = |v: u32| surface.origin(self.corner[v as usize]);
        let mut vertices = Vec::new();
        for (n, &h) in half_edges.iter().enumerate() {
            vertices.push(open.origin(h));
            let (here, onwards) = (open.target(h), open.origin(half_edges[(n + 1) % half_edges.len()]));
            if before(here) != before(onwards) {
                vertices.push(here);
                self.along(open, here, onwards, &mut vertices);
            } // the two sides of a cut are one vertex of the surface
        }
        vertices.iter_mut().for_each(|v| *v = before(*v));
        let (length, centre) = measured(surface, &vertices);
        Handle { vertices, half_edges: half_edges.to_vec(), length, centre }
    }

    /// Adds the vertices between two vertices of a boundary loop, along the shorter way.
    fn along(&self, open: &Surface, from: u32, to: u32, vertices: &mut Vec<u32>) {
        let (rim, start) = self.place[from as usize];
        let rim = &self.loops[rim as usize];
        let [start, end] = [start, self.place[to as usize].1].map(|at| at as usize);
        let turned = |from: usize, to: usize| rim.iter().cycle().skip(from).take((to + rim.len() - from) % rim.len());
        let length = |from, to| turned(from, to).map(|&h| open.length(h)).sum::<f64>();
        let begin = vertices.len();
        if length(start, end) <= length(end, start) {
            vertices.extend(turned(start, end).skip(1).map(|&h| open.origin(h)));
        } else {
            vertices.extend(turned(end, start).skip(1).map(|&h| open.origin(h)));
            vertices[begin..].reverse();
        }
    }
}

/// Returns the length of a closed loop of vertices in mm, and its mean position.
fn measured(surface: &Surface, vertices: &[u32]) -> (f64, Vector3<f64>) {
    let place = |n: usize| surface.points()[vertices[n % vertices.len()] as usize];
    let (mut length, mut sum) = (0.0, Vector3::zeros());
    for n in 0..vertices.len() {
        let edge = (place(n + 1) - place(n)).norm();
        length += edge;
        sum += (place(n) + place(n + 1)) * (edge / 2.0);
    }
    (length, if length > 0.0 { sum / length } else { place(0) })
}

#[cfg(test)]
mod tests;
