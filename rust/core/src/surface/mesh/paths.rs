//! Shortest paths along the edges of a surface (Dijkstra 1959).

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use crate::adjacency::starts_of;
use crate::error::{check_length, check_points};
use crate::surface::mesh::{BORDER, Surface};
use crate::{Control, Error, Result};

const NONE: u32 = u32::MAX;

/// The longest edge in mm for which sums remain finite.
const LONGEST: f64 = 1e200;

/// An edge between two nodes, which can be the same; `half_edge` identifies it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Edge {
    pub ends: [u32; 2],
    pub half_edge: u32,
    pub cost: f64,
}

/// An edge as seen from one of its ends.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Incident {
    pub to: u32,
    pub half_edge: u32,
    pub cost: f64,
}

/// Nodes and edges in compressed rows.
#[derive(Debug)]
pub(crate) struct Network {
    starts: Vec<u32>,
    incident: Vec<Incident>,
}

impl Network {
    /// Creates a network. The edges at each node are in the given order.
    pub(crate) fn new(nodes: usize, edges: &[Edge]) -> Self {
        let starts = starts_of(nodes, edges.iter().flat_map(|edge| edge.ends));
        let mut end: Vec<u32> = starts[..nodes].to_vec();
        let mut incident = vec![Incident { to: NONE, half_edge: 0, cost: 0.0 }; 2 * edges.len()];
        for &Edge { ends: [a, b], half_edge, cost } in edges {
            for (from, to) in [(a, b), (b, a)] {
                incident[end[from as usize] as usize] = Incident { to, half_edge, cost };
                end[from as usize] += 1;
            }
        }
        Self { starts, incident }
    }

    /// Creates the network of the vertices and edges of a surface. The cost of an edge is its length in mm.
    pub(crate) fn of(surface: &Surface) -> Self {
        Self::weighted(surface, |_| 1.0)
    }

    /// Creates the same network, but multiplies the length of an edge by the mean of the factors of its ends.
    fn weighted(surface: &Surface, factor: impl Fn(u32) -> f64) -> Self {
        let edge = |h: u32| {
            let ends = [surface.origin(h), surface.target(h)];
            Edge { ends, half_edge: h, cost: length(surface, h) * ends.map(&factor).iter().sum::<f64>() / 2.0 }
        };
        Self::new(surface.len(), &surface.edges().map(edge).collect::<Vec<_>>())
    }

    /// Returns the half-edges along a path of vertices of the surface of this network.
    pub(crate) fn along(&self, surface: &Surface, vertices: &[u32]) -> Result<Vec<u32>> {
        check_points(vertices.iter().copied(), surface.len())?;
        let half_edge = |pair: &[u32]| {
            let [a, b] = [pair[0], pair[1]];
            let arc = self.incident(a).iter().find(|arc| arc.to == b);
            let h = arc.ok_or(Error::NotAnEdge { a: a as usize, b: b as usize })?.half_edge;
            let twin = surface.twins()[h as usize];
            Ok(if surface.origin(h) == a || twin == BORDER { h } else { twin })
        };
        vertices.windows(2).map(half_edge).collect()
    }

    pub(crate) fn incident(&self, node: u32) -> &[Incident] {
        &self.incident[self.starts[node as usize] as usize..self.starts[node as usize + 1] as usize]
    }
}

/// Returns the length of a half-edge in mm, limited so that sums are finite.
pub(crate) fn length(surface: &Surface, half_edge: u32) -> f64 {
    surface.length(half_edge).min(LONGEST)
}

/// The last step of a search to a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Step {
    pub from: u32,
    pub half_edge: u32,
}

/// A reusable search from seeds outwards. Of equally distant nodes, the one with the lower number is settled first.
#[derive(Debug)]
pub(crate) struct EdgeSearch {
    distance: Vec<f64>,
    step: Vec<Step>,
    is_settled: Vec<bool>,
    touched: Vec<u32>,
    heap: BinaryHeap<Reverse<(u64, u32)>>,
}

impl EdgeSearch {
    pub(crate) fn new(nodes: usize) -> Self {
        Self {
            distance: vec![f64::INFINITY; nodes],
            step: vec![Step { from: NONE, half_edge: NONE }; nodes],
            is_settled: vec![false; nodes],
            touched: Vec::new(),
            heap: BinaryHeap::new(),
        }
    }

    /// Clears the search, in time proportional to the number of reached nodes.
    pub(crate) fn clear(&mut self) {
        for node in self.touched.drain(..) {
            self.distance[node as usize] = f64::INFINITY;
            self.is_settled[node as usize] = false;
        }
        self.heap.clear();
    }

    pub(crate) fn seed(&mut self, node: u32) {
        self.reach(node, 0.0, Step { from: NONE, half_edge: NONE });
    }

    fn reach(&mut self, node: u32, distance: f64, step: Step) {
        let known = &mut self.distance[node as usize];
        if distance < *known {
            if known.is_infinite() {
                self.touched.push(node);
            }
            *known = distance;
            self.step[node as usize] = step;
            self.heap.push(Reverse((distance.to_bits(), node))); // the bits of positive numbers have the same order
        }
    }

    /// Settles and returns the next node, whose distance is final, and continues to neighbours that `may_enter`.
    pub(crate) fn settle(&mut self, network: &Network, may_enter: impl Fn(u32) -> bool) -> Option<u32> {
        loop {
            let Reverse((_, node)) = self.heap.pop()?;
            if std::mem::replace(&mut self.is_settled[node as usize], true) {
                continue; // outdated: a shorter path was found later
            }
            let here = self.distance[node as usize];
            for arc in network.incident(node) {
                if here + arc.cost < self.distance[arc.to as usize] && may_enter(arc.to) {
                    self.reach(arc.to, here + arc.cost, Step { from: node, half_edge: arc.half_edge });
                }
            }
            return Some(node);
        }
    }

    /// Continues the search to all reachable nodes, and returns the farthest one.
    pub(crate) fn explore(&mut self, network: &Network, control: &Control) -> Result<Option<u32>> {
        let mut last = None;
        while let Some(node) = self.settle(network, |_| true) {
            control.check()?;
            last = Some(node);
        }
        Ok(last)
    }

    /// Returns the distance from the nearest seed, which is final for settled nodes and an upper bound for others.
    pub(crate) fn distance(&self, node: u32) -> f64 {
        self.distance[node as usize]
    }

    pub(crate) fn is_settled(&self, node: u32) -> bool {
        self.is_settled[node as usize]
    }

    /// Returns the last step to a reached node; none for a seed.
    pub(crate) fn step(&self, node: u32) -> Option<Step> {
        Some(self.step[node as usize]).filter(|step| step.from != NONE)
    }

    /// Iterates over the steps from a node back to its seed.
    pub(crate) fn back(&self, node: u32) -> impl Iterator<Item = Step> + '_ {
        std::iter::successors(self.step(node), |step| self.step(step.from))
    }

    /// Returns the nodes from its seed to a node.
    fn path(&self, node: u32) -> Vec<u32> {
        let mut path: Vec<u32> = std::iter::once(node).chain(self.back(node).map(|step| step.from)).collect();
        path.reverse();
        path
    }
}

/// Returns the half-edges along a path of vertices. An edge with a single half-edge is represented by it, which can
/// lead back. Errors: [`Error::NoSuchPoint`]; [`Error::NotAnEdge`] names the first two vertices without a common edge.
/// [`shortest_path`] finds the vertices between them.
pub(crate) fn along_path(surface: &Surface, vertices: &[u32]) -> Result<Vec<u32>> {
    Network::of(surface).along(surface, vertices)
}

/// Returns the vertices of the shortest path along edges through `stops` in their order, including the stops. With
/// `factors` per vertex, the cost of an edge is its length times the mean of the factors of its ends.
///
/// Takes O(n log n) time for each stop.
///
/// # Errors
/// [`Error::NoSuchPoint`], [`Error::WrongLength`] or [`Error::FactorNotPositive`] of the factors,
/// [`Error::Unreachable`] if no path leads to a stop, and [`Error::Cancelled`].
pub fn shortest_path(surface: &Surface, stops: &[u32], factors: Option<&[f64]>, control: &Control) -> Result<Vec<u32>> {
    check_points(stops.iter().copied(), surface.len())?;
    let network = match factors {
        None => Network::of(surface),
        Some(factors) => factored(surface, factors)?,
    };
    let mut search = EdgeSearch::new(surface.len());
    let mut path: Vec<u32> = stops.first().copied().into_iter().collect();
    for leg in stops.windows(2) {
        let (from, to) = (leg[0], leg[1]);
        search.clear();
        search.seed(from);
        while !search.is_settled(to) {
            control.check()?;
            let unreachable = Error::Unreachable { source_vertex: from as usize, vertex: to as usize };
            search.settle(&network, |_| true).ok_or(unreachable)?;
        }
        path.extend(&search.path(to)[1..]); // `from` ends the previous leg
    }
    Ok(path)
}

/// Returns the vertices of the cheapest path along edges from a vertex to any vertex of `to`, including both, through
/// vertices that `may_pass`: a simple path that meets `to` only at its end. The cost of an edge is its length times the
/// mean of its ends' factors.
///
/// # Errors
/// [`Error::NoSuchPoint`], [`Error::WrongLength`] of the flags or factors, [`Error::FactorNotPositive`],
/// [`Error::Unreachable`] if no path leads to `to`, and [`Error::Cancelled`].
pub fn path_to_any(
    surface: &Surface, from: u32, to: &[bool], may_pass: &[bool], factors: &[f64], control: &Control,
) -> Result<Vec<u32>> {
    check_points([from], surface.len())?;
    check_length("flags of targets", to.len(), "vertices", surface.len())?;
    check_length("flags of passages", may_pass.len(), "vertices", surface.len())?;
    let network = factored(surface, factors)?;
    let mut search = EdgeSearch::new(surface.len());
    search.seed(from);
    let target = to.iter().position(|&is| is).unwrap_or(from as usize);
    let unreachable = Error::Unreachable { source_vertex: from as usize, vertex: target };
    loop {
        control.check()?;
        let may_enter = |v: u32| to[v as usize] || may_pass[v as usize];
        let node = search.settle(&network, may_enter).ok_or(unreachable.clone())?;
        if to[node as usize] {
            return Ok(search.path(node));
        }
    }
}

/// Returns the network of a surface, where the cost of an edge is its length times the mean of the factors of its ends.
fn factored(surface: &Surface, factors: &[f64]) -> Result<Network> {
    check_length("factors", factors.len(), "vertices", surface.len())?;
    if let Some(vertex) = factors.iter().position(|&f| !(f > 0.0 && f <= LONGEST.sqrt())) {
        return Err(Error::FactorNotPositive { vertex, factor: factors[vertex] });
    }
    Ok(Network::weighted(surface, |v| factors[v as usize]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::mesh::shapes;
    use proptest::prelude::*;

    fn length_of(surface: &Surface, path: &[u32]) -> f64 {
        let half_edges = along_path(surface, path).unwrap();
        half_edges.iter().map(|&h| surface.length(h)).sum()
    }

    #[test]
    fn a_path_goes_through_its_stops() {
        let sheet = shapes::surface(shapes::sheet(6, 6));
        let control = Control::default();
        let path = shortest_path(&sheet, &[0, 48, 48, 6], None, &control).unwrap();
        assert_eq!((path[0], path[path.len() - 1], path.contains(&48)), (0, 6, true));
        assert!((length_of(&sheet, &path) - (6.0 * 2f64.sqrt() + 6.0)).abs() < 1e-9);
        assert_eq!(shortest_path(&sheet, &[7], None, &control).unwrap(), [7]);
        assert_eq!(shortest_path(&sheet, &[], None, &control).unwrap(), [0; 0]);
    }

    #[test]
    fn factors_draw_a_path_aside() {
        let sheet = shapes::surface(shapes::sheet(10, 10));
        let factors: Vec<f64> = sheet.points().iter().map(|p| if p[1] == 3.0 { 0.1 } else { 1.0 }).collect();
        let path = shortest_path(&sheet, &[0, 110], Some(&factors), &Control::default()).unwrap();
        assert!(path.iter().filter(|&&v| sheet.points()[v as usize][1] == 3.0).count() > 3);
        let refused = shortest_path(&sheet, &[0, 110], Some(&[0.0; 121]), &Control::default());
        assert_eq!(refused, Err(Error::FactorNotPositive { vertex: 0, factor: 0.0 }));
    }

    #[test]
    fn a_path_to_any_ends_at_the_cheapest_and_passes_only_where_it_may() {
        let sheet = shapes::surface(shapes::sheet(6, 6));
        let control = Control::default();
        let centre = sheet.points().iter().position(|p| [p[0], p[1]] == [3.0, 3.0]).unwrap() as u32;
        let border = |p: &nalgebra::Vector3<f64>| [0.0, 6.0].contains(&p[0]) || [0.0, 6.0].contains(&p[1]);
        let to: Vec<bool> = sheet.points().iter().map(border).collect();
        let line: Vec<f64> = sheet.points().iter().map(|p| 1.0 + 100.0 * (p[0] - p[1]).powi(2)).collect();
        let path = path_to_any(&sheet, centre, &to, &[true; 49], &line, &control).unwrap();
        assert!(path.iter().all(|&v| sheet.points()[v as usize][0] == sheet.points()[v as usize][1]));
        assert_eq!(path.iter().filter(|&&v| to[v as usize]).count(), 1);
        let right: Vec<bool> = sheet.points().iter().map(|p| p[0] >= 3.0).collect();
        let path = path_to_any(&sheet, centre, &to, &right, &[1.0; 49], &control).unwrap();
        assert!(path[..path.len() - 1].iter().all(|&v| right[v as usize]));
        let nowhere = path_to_any(&sheet, centre, &to, &[false; 49], &[1.0; 49], &control);
        assert!(matches!(nowhere, Err(Error::Unreachable { .. })));
        assert_eq!(path_to_any(&sheet, centre, &[true; 49], &[true; 49], &[1.0; 49], &control), Ok(vec![centre]));
    }

    #[test]
    fn a_path_that_is_none_is_refused() {
        let sheet = shapes::surface(shapes::sheet(3, 3));
        assert_eq!(along_path(&sheet, &[0, 1, 7]), Err(Error::NotAnEdge { a: 1, b: 7 }));
        assert_eq!(along_path(&sheet, &[0, 0]), Err(Error::NotAnEdge { a: 0, b: 0 }));
        assert_eq!(along_path(&sheet, &[16]), Err(Error::NoSuchPoint { vertex: 16, points: 16 }));
        let apart = sheet.part(&(0..18).map(|f| !(2..16).contains(&f)).collect::<Vec<_>>());
        let refused = shortest_path(&apart, &[0, 7], None, &Control::default());
        assert_eq!(refused, Err(Error::Unreachable { source_vertex: 0, vertex: 7 }));
        let control = Control::default();
        control.cancel();
        assert_eq!(shortest_path(&sheet, &[0, 7], None, &control), Err(Error::Cancelled));
    }

    proptest! {
        #[test]
        fn paths_are_shortest(picks in prop::array::uniform3(0..66u32)) {
            let sphere = shapes::surface(shapes::sphere(2));
            let control = Control::default();
            let [ab, bc, ac] = [[0, 1], [1, 2], [0, 2]]
                .map(|ends| length_of(&sphere, &shortest_path(&sphere, &ends.map(|e| picks[e]), None, &control).unwrap()));
            prop_assert!(ac <= ab + bc + 1e-9);
            let [a, c] = [picks[0], picks[2]].map(|v| sphere.points()[v as usize]);
            prop_assert!(ac >= (a - c).norm() - 1e-9);
        }
    }

    #[test]
    fn costs_are_lengths_times_the_mean_of_the_factors() {
        let sheet = shapes::surface(shapes::sheet(4, 4));
        let (first, last) = (0, sheet.len() as u32 - 1);
        let cost = |network: &Network| {
            let mut search = EdgeSearch::new(sheet.len());
            search.seed(first);
            search.explore(network, &Control::default()).unwrap();
            search.distance(last)
        };
        assert!((cost(&Network::of(&sheet)) - 4.0 * 2f64.sqrt()).abs() < 1e-12);
        // the cheapest way is the diagonal, whose edges have the factors 1.5, 2.5, 3.5 and 4.5
        let factors: Vec<f64> = sheet.points().iter().map(|p| 1.0 + p.x + 9.0 * (p.x - p.y).abs()).collect();
        assert!((cost(&factored(&sheet, &factors).unwrap()) - 12.0 * 2f64.sqrt()).abs() < 1e-12);
    }
}
