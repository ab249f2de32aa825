//! Homology: finds which loops on a surface go around a handle.
//!
//! Every boundary loop is contracted to a point, so that the surface is closed, and paths between boundaries become
//! ordinary paths. A spanning tree of the nodes (shortest paths from one of them) and a spanning tree of the faces
//! across other edges leave 2 g edges. Each of them closes a loop in the first tree, and these loops generate all
//! others (Eppstein 2003; Erickson, Whittlesey 2005, whose greedy choice is used: the tree of faces prefers edges that
//! would close long loops). Each of these edges also closes a loop across edges in the second tree. For a loop of
//! edges, the crossings with each of these are counted modulo 2. If one count is odd, the loop is not separating.
//!
//! The 2 g counts are not stored. Each loop across edges gets a random number of 64 bits, and the mark of an edge is
//! the exclusive or of the numbers of the loops that cross it. The mark of a loop is the exclusive or of the marks of
//! its edges. A nonzero mark proves an odd count; a zero mark means even counts, with an error probability of 2⁻⁶⁴
//! (Erickson, Nayyeri 2011 keep bits).

use crate::adjacency::Sets;
use crate::surface::mesh::paths::{Edge, EdgeSearch, Network, Step, length};
use crate::surface::{mesh::Surface, topology::shrunk};
use crate::{Control, Result};

/// A surface whose boundary loops are contracted to points.
#[derive(Debug)]
pub(crate) struct Shrunk<'a> {
    pub surface: &'a Surface,
    /// The node of each vertex: itself, or the first vertex of its boundary loop.
    pub node: Vec<u32>,
    /// Inner edges with lengths in mm. Passing through a boundary costs `toll` times its length.
    pub network: Network,
}

impl<'a> Shrunk<'a> {
    pub fn new(surface: &'a Surface, toll: f64) -> Self {
        Self::weighted(surface, toll, |_| 1.0)
    }

    /// Creates it such that the cost of an edge is its length times the mean of the factors of its ends.
    pub fn weighted(surface: &'a Surface, toll: f64, factor: impl Fn(u32) -> f64) -> Self {
        let node = shrunk(surface);
        let mut tolls = vec![0.0; surface.len()];
        for h in (0..surface.twins().len() as u32).filter(|&h| !surface.is_inner(h)) {
            tolls[node[surface.origin(h) as usize] as usize] += toll * length(surface, h);
        }
        let edge = |half_edge: u32| {
            let vertices = [surface.origin(half_edge), surface.target(half_edge)];
            let ends = vertices.map(|v| node[v as usize]);
            let mean = |values: [f64; 2]| (values[0] + values[1]) / 2.0;
            let cost = length(surface, half_edge) * mean(vertices.map(&factor));
            Edge { ends, half_edge, cost: cost + mean(ends.map(|node| tolls[node as usize])) }
        };
        let edges: Vec<Edge> = surface.edges().filter(|&h| surface.is_inner(h)).map(edge).collect();
        Self { surface, network: Network::new(surface.len(), &edges), node }
    }

    pub fn nodes(&self) -> impl Iterator<Item = u32> + '_ {
        (0..self.node.len() as u32).filter(|&v| self.node[v as usize] == v)
    }

    pub fn ends(&self, half_edge: u32) -> [u32; 2] {
        [self.surface.origin(half_edge), self.surface.target(half_edge)].map(|v| self.node[v as usize])
    }

    /// Returns the simple loop that an edge closes in a tree of paths, as ordered half-edges.
    pub fn closed_by(&self, tree: &EdgeSearch, edge: u32) -> Vec<u32> {
        let [mut left, mut right] = self.ends(edge).map(|node| tree.back(node).collect::<Vec<_>>());
        while left.last().is_some_and(|step| right.last() == Some(step)) {
            left.pop(); // the common stem
            right.pop();
        }
        self.through(&left, edge, &right)
    }

    /// Returns the half-edges along the reversed steps from an edge's one end, the edge, and the steps from the other.
    pub fn through(&self, left: &[Step], edge: u32, right: &[Step]) -> Vec<u32> {
        let start = left.last().map_or(self.ends(edge)[0], |step| step.from);
        let before = left.iter().rev().map(|step| step.half_edge);
        self.directed(start, before.chain([edge]).chain(right.iter().map(|step| step.half_edge)))
    }

    /// Returns the half-edges along a path of edges that begins at `node`.
    pub fn directed(&self, mut node: u32, edges: impl Iterator<Item = u32>) -> Vec<u32> {
        let onwards = |edge| {
            let ends = self.ends(edge);
            let leads_on = ends[0] == node;
            node = ends[usize::from(leads_on)];
            if leads_on { edge } else { self.surface.twins()[edge as usize] }
        };
        edges.map(onwards).collect()
    }
}

/// The loops that generate all others, and the marks that identify separating loops.
#[derive(Debug)]
pub(crate) struct Homology {
    /// 2 g simple loops, as half-edges.
    pub generators: Vec<Vec<u32>>,
    /// The marks of the edges, by their lower half-edges.
    marks: Vec<u64>,
}

impl Homology {
    /// Takes O(n log n) time for n edges, plus the lengths of the generators.
    pub fn new(shrunk: &Shrunk, control: &Control) -> Result<Self> {
        let tree = spanning_tree(shrunk, control)?;
        let (cotree, left_over) = spanning_cotree(shrunk, &tree, control)?;
        control.check()?;
        let marks = marks(shrunk.surface, &cotree, &left_over);
        let generators = left_over.iter().map(|&h| shrunk.closed_by(&tree, h)).collect();
        Ok(Self { generators, marks })
    }

    /// Returns the mark of an edge, given its lower half-edge.
    pub fn mark(&self, edge: u32) -> u64 {
        self.marks[edge as usize]
    }

    /// Adds a loop across edges to the marks of the edges `crossed`; `mark` is its number.
    pub fn count(&mut self, crossed: impl Iterator<Item = u32>, mark: u64) {
        crossed.for_each(|edge| self.marks[edge as usize] ^= mark);
    }
}

/// Returns shortest paths from the first node of each component to all its nodes.
fn spanning_tree(shrunk: &Shrunk, control: &Control) -> Result<EdgeSearch> {
    let mut search = EdgeSearch::new(shrunk.node.len());
    for root in shrunk.nodes() {
        if search.is_settled(root) {
            continue;
        }
        search.seed(root);
        search.explore(&shrunk.network, control)?;
    }
    Ok(search)
}

/// Returns the edges of the spanning tree of the faces, which prefers edges that would close the longest loops in the
/// tree; and the edges in neither tree.
fn spanning_cotree(shrunk: &Shrunk, tree: &EdgeSearch, control: &Control) -> Result<(Vec<bool>, Vec<u32>)> {
    let surface = shrunk.surface;
    let mut is_in_tree = vec![false; surface.twins().len()];
    shrunk.nodes().filter_map(|v| tree.step(v)).for_each(|step| is_in_tree[step.half_edge as usize] = true);
    let mut others: Vec<(f64, u32)> = surface
        .edges()
        .filter(|&h| surface.is_inner(h) && !is_in_tree[h as usize])
        .map(|h| (shrunk.ends(h).map(|v| tree.distance(v)).iter().sum::<f64>() + length(surface, h), h))
        .collect();
    others.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    control.check()?;
    let mut pieces = Sets::new(surface.faces().len());
    let mut cotree = vec![false; surface.twins().len()];
    let mut left_over = Vec::new();
    for (_, h) in others {
        let twin = surface.twins()[h as usize];
        if pieces.join(h / 3, twin / 3) {
            cotree[h as usize] = true;
            cotree[twin as usize] = true;
        } else {
            left_over.push(h);
        }
    }
    Ok((cotree, left_over))
}

/// Returns the marks of all edges. The loop of a left-over edge in the cotree crosses the edges that separate its two
/// faces. With its number put at both faces, the mark of an edge is the exclusive or of all numbers beyond it.
fn marks(surface: &Surface, cotree: &[bool], left_over: &[u32]) -> Vec<u64> {
    let mut marks = vec![0; surface.twins().len()];
    let mut behind = vec![0; surface.faces().len()];
    for (number, &h) in (1..).map(random).zip(left_over) {
        marks[h as usize] = number;
        [h, surface.twins()[h as usize]].iter().for_each(|&side| behind[side as usize / 3] ^= number);
    }
    for &h in outwards(surface, cotree).iter().rev() {
        let twin = surface.twins()[h as usize];
        let number = behind[twin as usize / 3];
        marks[h.min(twin) as usize] = number;
        behind[h as usize / 3] ^= number;
    }
    marks
}

/// Returns the half-edges of the cotree that lead away from the first face of each component, in order.
fn outwards(surface: &Surface, cotree: &[bool]) -> Vec<u32> {
    let mut seen = vec![false; surface.faces().len()];
    let mut steps = Vec::with_capacity(seen.len());
    let mut at = 0;
    for root in 0..seen.len() as u32 {
        if std::mem::replace(&mut seen[root as usize], true) {
            continue;
        }
        let mut face = root;
        loop {
            for h in 3 * face..3 * face + 3 {
                if cotree[h as usize] && !std::mem::replace(&mut seen[surface.twins()[h as usize] as usize / 3], true) {
                    steps.push(h);
                }
            }
            let Some(&h) = steps.get(at) else { break };
            at += 1;
            face = surface.twins()[h as usize] / 3;
        }
    }
    steps
}

/// Returns well-mixed, nonzero bits (Steele, Lea, Flood 2014).
fn random(n: u64) -> u64 {
    let mut z = n.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::{mesh::shapes, topology::Topology};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn generators_count_and_triangles_do_not(keep in prop::collection::vec(prop::bool::weighted(0.85), 168)) {
            let part = shapes::surface(shapes::torus(12, 7)).part(&keep);
            let shrunk = Shrunk::new(&part, 0.5);
            let homology = Homology::new(&shrunk, &Control::default()).unwrap();
            prop_assert_eq!(homology.generators.len(), 2 * Topology::of(&part).genus);
            let name = |h: u32| if part.is_inner(h) { h.min(part.twins()[h as usize]) } else { h };
            let mark = |half_edges: &[u32]| half_edges.iter().fold(0, |mark, &h| mark ^ homology.mark(name(h)));
            for face in 0..part.faces().len() as u32 {
                prop_assert_eq!(mark(&[3 * face, 3 * face + 1, 3 * face + 2]), 0);
            }
            for generator in &homology.generators {
                prop_assert_ne!(mark(generator), 0);
                for (n, &h) in generator.iter().enumerate() {
                    let next = generator[(n + 1) % generator.len()];
                    prop_assert_eq!(shrunk.ends(h)[1], shrunk.ends(next)[0]);
                }
            }
        }
    }
}
