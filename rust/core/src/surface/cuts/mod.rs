//! Cuts along given paths, or cuts that turn any surface into a disk.

pub mod cones;
pub mod holes;
pub(crate) mod inward;

use crate::adjacency::Sets;
use crate::surface::mesh::paths::{EdgeSearch, Network, Step, length};
use crate::surface::mesh::{Surface, curvature::mean_curvature};
use crate::surface::topology::loops::{TOLL, cut_handles};
use crate::surface::topology::{Topology, homology::Shrunk};
use crate::{Control, Error, Result};

/// A surface that was cut open to a disk.
#[derive(Debug, Clone, PartialEq)]
pub struct Opened {
    /// The disk: the faces of the input. Vertices on cuts are doubled and keep their ids.
    pub surface: Surface,
    /// The cuts that were made.
    pub cuts: Vec<Cut>,
}

/// A cut.
#[derive(Debug, Clone, PartialEq)]
pub struct Cut {
    /// The vertices of the input along it; a closed loop ends where it begins.
    pub vertices: Vec<u32>,
    /// Its length in mm.
    pub length: f64,
    /// The reason for it.
    pub reason: Reason,
}

/// The reason for a cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reason {
    /// It opens a handle.
    Handle,
    /// It joins two boundary loops, or an earlier cut and another loop.
    JoinBoundaries,
    /// It leads to a cone point ([`cones::cone_points`]).
    ConePoint,
    /// The surface was closed like a sphere, or nearly closed after the other cuts.
    Sphere,
    /// It reduces the distortion of the map ([`crate::flatten::relaxation`]).
    Relaxation,
}

/// The maximum factor on the length of an edge on a crown, relative to one in the depth of a fold.
const AVOIDS_CROWNS: f64 = 4.0;

/// A surface of area A is nearly closed if the squared length of its boundary is less than this times A. For a plane
/// disk, it is at least 4 π A; for a sphere cut from pole to pole, π A.
const SHORT: f64 = 1.0;

/// The number of rings of neighbours for distinguishing crowns from depths.
const RINGS: usize = 3;

/// Cuts the surface open along paths of vertices. Ids are preserved.
///
/// # Errors
/// [`Error::NoSuchPoint`], and [`Error::NotAnEdge`] if successive vertices of a path have no common edge.
pub fn cut(surface: &Surface, paths: &[Vec<u32>]) -> Result<Surface> {
    let network = Network::of(surface);
    let half_edges: Vec<_> = paths.iter().map(|path| network.along(surface, path)).collect::<Result<_>>()?;
    Ok(surface.cut_open(half_edges.into_iter().flatten()))
}

/// Cuts a connected surface open to a disk; see [`open_to_disk_through`].
///
/// # Errors
/// Those of [`open_to_disk_through`].
pub fn open_to_disk(surface: &Surface, control: &Control) -> Result<Opened> {
    open_to_disk_through(surface, &[], control)
}

/// Cuts a connected surface open to a disk with these vertices on its boundary.
///
/// Handles are cut along short loops ([`cut_handles`]). The boundary loops and the vertices are then joined by a tree of
/// shortest paths, at most twice as long as the shortest tree (Mehlhorn 1988). If the surface is then closed or nearly closed, it also
/// gets a cut between two distant points, preferably along the depths of folds. A disk is left unchanged without vertices. Takes O(n log
/// n) time beside the handles; the result is deterministic.
///
/// # Errors
/// [`Error::NoFaces`] or [`Error::SeveralComponents`] if there is not exactly one component, [`Error::NotADisk`] if
/// cuts do not open it, and [`Error::Cancelled`].
pub fn open_to_disk_through(surface: &Surface, points: &[u32], control: &Control) -> Result<Opened> {
    let topology = Topology::of(surface);
    require_connected(&topology)?;
    control.check()?;
    if topology.is_disk() && points.is_empty() {
        return Ok(Opened { surface: surface.clone(), cuts: Vec::new() });
    }
    let (mut open, handles) = cut_handles(surface, control)?;
    let of_handles = handles.iter().flat_map(|handle| pieces(surface, &handle.half_edges));
    let mut paths: Vec<(Reason, Vec<u32>)> = of_handles.map(|path| (Reason::Handle, path)).collect();
    control.begin("joining boundaries", 1);
    let mut joining = joins(&open, &after_cuts(surface, &open, points), control)?;
    if is_all_but_closed(&open, &joining) {
        let seam = seam(&open, control)?;
        paths.extend(pieces(surface, &seam).into_iter().map(|path| (Reason::Sphere, path)));
        open = open.cut_open(seam);
        joining = joins(&open, &after_cuts(surface, &open, points), control)?;
    }
    paths.extend(joining);
    control.advance();
    let cuts = paths.iter().map(|(reason, path)| described(surface, path, *reason)).collect();
    require_disk(surface.cut_open(paths.into_iter().flat_map(|(_, path)| path)), cuts)
}

fn require_disk(surface: Surface, cuts: Vec<Cut>) -> Result<Opened> {
    let topology = Topology::of(&surface);
    if !topology.is_disk() {
        let (components, loops) = (topology.components.len(), topology.loops.len());
        return Err(Error::NotADisk { components, loops, handles: topology.genus, euler: topology.euler });
    }
    Ok(Opened { surface, cuts })
}

fn require_connected(topology: &Topology) -> Result<()> {
    match &topology.components[..] {
        [] => Err(Error::NoFaces { points: 0 }),
        [_] => Ok(()),
        components => {
            let mut sizes: Vec<String> = components.iter().take(5).map(|c| c.faces.to_string()).collect();
            sizes.extend((components.len() > 5).then(|| "...".to_owned()));
            Err(Error::SeveralComponents { count: components.len(), sizes: sizes.join(", ") })
        }
    }
}

/// Describes a cut along consecutive half-edges of the surface.
pub(crate) fn described(surface: &Surface, path: &[u32], reason: Reason) -> Cut {
    let end = path.last().map(|&h| surface.target(h));
    Cut {
        vertices: path.iter().map(|&h| surface.origin(h)).chain(end).collect(),
        length: path.iter().map(|&h| surface.length(h)).sum(),
        reason,
    }
}

/// Returns the connected pieces of a loop of half-edges, some of which may be missing.
fn pieces(surface: &Surface, half_edges: &[u32]) -> Vec<Vec<u32>> {
    let count = half_edges.len();
    let is_end = |n: usize| surface.target(half_edges[n]) != surface.origin(half_edges[(n + 1) % count]);
    let first = (0..count).find(|&n| is_end(n)).map_or(0, |end| end + 1);
    let mut turned = half_edges.to_vec();
    turned.rotate_left(first % count.max(1));
    turned.chunk_by(|&a, &b| surface.target(a) == surface.origin(b)).map(<[u32]>::to_vec).collect()
}

/// Returns the numbers of vertices after the surface was cut open; of the copies of a vertex, any one.
fn after_cuts(surface: &Surface, open: &Surface, vertices: &[u32]) -> Vec<u32> {
    let mut number = vec![0; surface.len()];
    let corners = surface.faces().as_flattened().iter().zip(open.faces().as_flattened());
    corners.for_each(|(&before, &after)| number[before as usize] = after);
    vertices.iter().map(|&vertex| number[vertex as usize]).collect()
}

/// Returns paths that join all boundary loops of a surface without handles, and these vertices. Each of them has a
/// region of vertices nearest to it. Shortest paths between these regions are taken as long as they join unconnected ones. Where two paths meet,
/// the later one ends, so that no paths cross.
fn joins(surface: &Surface, points: &[u32], control: &Control) -> Result<Vec<(Reason, Vec<u32>)>> {
    let boundary = surface.boundary();
    if boundary.len() + points.len() < 2 {
        return Ok(Vec::new());
    }
    let shrunk = Shrunk::new(surface, 0.0);
    let mut search = EdgeSearch::new(surface.len());
    let mut is_reached = vec![false; surface.len()];
    for border in &boundary {
        let node = shrunk.node[surface.origin(border[0]) as usize];
        is_reached[node as usize] = true;
        search.seed(node);
    }
    let mut is_point = vec![false; surface.len()];
    for &node in points {
        if !std::mem::replace(&mut is_reached[shrunk.node[node as usize] as usize], true) {
            is_point[node as usize] = true;
            search.seed(node);
        }
    }
    let mut region: Vec<u32> = (0..surface.len() as u32).collect();
    while let Some(node) = search.settle(&shrunk.network, |_| true) {
        control.check()?;
        if let Some(step) = search.step(node) {
            region[node as usize] = region[step.from as usize];
        }
    }
    let regions = |h: u32| shrunk.ends(h).map(|v| region[v as usize]);
    let way = |h: u32| shrunk.ends(h).map(|v| search.distance(v)).iter().sum::<f64>() + length(surface, h);
    let is_between = |h: &u32| surface.is_inner(*h) && regions(*h)[0] != regions(*h)[1];
    let mut bridges: Vec<(f64, u32)> = surface.edges().filter(is_between).map(|h| (way(h), h)).collect();
    bridges.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut joined = Sets::new(surface.len());
    let mut paths = Vec::new();
    for (_, bridge) in bridges {
        control.check()?;
        let [a, b] = regions(bridge);
        if joined.join(a, b) {
            let [left, right] = shrunk.ends(bridge).map(|node| new_steps(&search, node, &mut is_reached));
            let leads_to_point = is_point[a as usize] || is_point[b as usize];
            let reason = if leads_to_point { Reason::ConePoint } else { Reason::JoinBoundaries };
            paths.push((reason, shrunk.through(&left, bridge, &right)));
        }
    }
    Ok(paths)
}

/// Returns the steps from a node back to the first reached node, and marks all of them as reached.
fn new_steps(search: &EdgeSearch, mut node: u32, is_reached: &mut [bool]) -> Vec<Step> {
    let mut steps = Vec::new();
    while !std::mem::replace(&mut is_reached[node as usize], true) {
        let Some(step) = search.step(node) else { break };
        steps.push(step);
        node = step.from;
    }
    steps
}

/// Returns whether the boundary is too short, with these cuts, to flatten the surface well.
fn is_all_but_closed(surface: &Surface, cuts: &[(Reason, Vec<u32>)]) -> bool {
    let border = (0..surface.twins().len() as u32).filter(|&h| !surface.is_inner(h)).map(|h| surface.length(h));
    let cuts = cuts.iter().flat_map(|(_, path)| path).map(|&h| 2.0 * surface.length(h));
    let boundary = border.chain(cuts).sum::<f64>();
    boundary * boundary <= SHORT * surface.areas().iter().sum::<f64>()
}

/// Returns a path between two distant points, along the depths of folds rather than over crowns. It may enter a
/// boundary loop and continue at another point of it. It has at least two edges if possible; one doubles no vertex.
fn seam(surface: &Surface, control: &Control) -> Result<Vec<u32>> {
    let shrunk = Shrunk::new(surface, TOLL);
    let mut search = EdgeSearch::new(surface.len());
    let first = shrunk.node[0];
    let start = explored(&mut search, &shrunk, first, control)?;
    let end = explored(&mut search, &shrunk, start, control)?;
    let factors = factors(surface);
    let weighted = Shrunk::weighted(surface, TOLL, |v| factors[v as usize]);
    explored(&mut search, &weighted, start, control)?;
    let mut edges: Vec<u32> = search.back(end).map(|step| step.half_edge).collect();
    edges.reverse();
    if edges.len() == 1 {
        let beyond = shrunk.network.incident(end).iter().find(|arc| arc.to != start && arc.to != end);
        edges.extend(beyond.map(|arc| arc.half_edge));
    }
    Ok(shrunk.directed(start, edges.into_iter()))
}

/// Searches all nodes from one node, and returns the farthest.
fn explored(search: &mut EdgeSearch, shrunk: &Shrunk, from: u32, control: &Control) -> Result<u32> {
    search.clear();
    search.seed(from);
    Ok(search.explore(&shrunk.network, control)?.unwrap_or(from))
}

/// Returns factors from 1 in the depth of folds to [`AVOIDS_CROWNS`] on crowns.
fn factors(surface: &Surface) -> Vec<f64> {
    let curvature = mean_curvature(surface, RINGS);
    let mean = curvature.iter().map(|h| h.abs()).sum::<f64>() / curvature.len().max(1) as f64;
    let share = |h: f64| if mean > 0.0 { (1.0 + (h / mean).tanh()) / 2.0 } else { 0.0 };
    let factor = |&h: &f64| 1.0 + (AVOIDS_CROWNS - 1.0) * share(h);
    curvature.iter().map(factor).map(|f| if f.is_finite() { f } else { 1.0 }).collect()
}

#[cfg(test)]
mod tests;
