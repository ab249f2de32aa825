//! Shortest paths from the boundary of a surface to its interior.

use crate::surface::mesh::Surface;
use crate::surface::mesh::paths::{EdgeSearch, Network};
use crate::{Control, Result};

/// The shortest paths along edges from the boundary to every vertex.
#[derive(Debug)]
pub(crate) struct Inward<'a> {
    surface: &'a Surface,
    network: Network,
    search: EdgeSearch,
}

impl<'a> Inward<'a> {
    /// Takes O(n log n) time.
    pub fn of(surface: &'a Surface, control: &Control) -> Result<Self> {
        let borders = (0..surface.twins().len() as u32).filter(|&h| !surface.is_inner(h));
        Self::from(surface, borders.map(|h| surface.origin(h)), control)
    }

    fn from(surface: &'a Surface, vertices: impl Iterator<Item = u32>, control: &Control) -> Result<Self> {
        let mut inward = Self { surface, network: Network::of(surface), search: EdgeSearch::new(surface.len()) };
        vertices.for_each(|v| inward.search.seed(v));
        inward.search.explore(&inward.network, control)?;
        Ok(inward)
    }

    /// Returns the half-edges of the path from the boundary to the vertex with an id; none if it is on the boundary.
    pub fn to(&self, id: u32) -> Option<Vec<u32>> {
        let mut vertex = self.surface.ids().iter().position(|&other| other == id)? as u32;
        let mut path = Vec::new();
        for step in self.search.back(vertex) {
            let leads_here = self.surface.target(step.half_edge) == vertex;
            path.push(if leads_here { step.half_edge } else { self.surface.twins()[step.half_edge as usize] });
            vertex = step.from;
        }
        path.reverse();
        (!path.is_empty()).then_some(path)
    }
}

/// Returns the distance along edges in mm of every vertex from the sides of cuts, where vertices share their ids.
pub(crate) fn from_sides(surface: &Surface, control: &Control) -> Result<Vec<f64>> {
    let mut by_id: Vec<u32> = (0..surface.len() as u32).collect();
    by_id.sort_by_key(|&v| surface.ids()[v as usize]);
    let same = by_id.chunk_by(|&a, &b| surface.ids()[a as usize] == surface.ids()[b as usize]);
    let sides = same.filter(|vertices| vertices.len() > 1).flatten().copied();
    let inward = Inward::from(surface, sides, control)?;
    Ok((0..surface.len() as u32).map(|v| inward.search.distance(v)).collect())
}

/// Returns allowed vertices inside a surface, each the farthest one from the boundary and from the previous ones.
pub(crate) fn spread(
    surface: &Surface, count: usize, is_allowed: impl Fn(u32) -> bool, control: &Control,
) -> Result<Vec<u32>> {
    let mut from = Inward::of(surface, control)?;
    let mut nearest = vec![f64::INFINITY; surface.len()];
    let mut chosen = Vec::new();
    while chosen.len() < count {
        (0..).zip(&mut nearest).for_each(|(v, nearest)| *nearest = nearest.min(from.search.distance(v)));
        let is_farther = |&a: &usize, &b: &usize| nearest[a].total_cmp(&nearest[b]).then(b.cmp(&a));
        let allowed = (0..surface.len()).filter(|&v| is_allowed(v as u32));
        let Some(vertex) = allowed.max_by(is_farther).filter(|&v| nearest[v] > 0.0) else { break };
        chosen.push(vertex as u32);
        from.search.clear();
        from.search.seed(vertex as u32);
        from.search.explore(&from.network, control)?;
    }
    Ok(chosen)
}
