//! Ways from the boundary of a surface into its inside.

use super::mesh::Surface;
use super::paths::{Network, Search};
use super::topology::is_inner;
use crate::control::Control;
use crate::error::Result;

/// The shortest ways along edges from the boundary to every vertex inside.
#[derive(Debug)]
pub(crate) struct Inward(Search);

impl Inward {
    pub fn new(surface: &Surface, control: &Control) -> Result<Self> {
        let network = Network::of(surface);
        let mut search = Search::new(surface.len());
        for h in (0..surface.twins().len() as u32).filter(|&h| !is_inner(surface, h)) {
            search.seed(surface.origin(h));
        }
        while search.settle(&network, |_| true).is_some() {
            control.check()?;
        }
        Ok(Self(search))
    }

    /// The half-edges of the way from the boundary to the first vertex whose id is the one; none if it is on the boundary.
    pub fn to(&self, surface: &Surface, is_it: impl Fn(u32) -> bool) -> Option<Vec<u32>> {
        let tip = surface.ids().iter().position(|&id| is_it(id))? as u32;
        let mut at = tip;
        let mut path = Vec::new();
        for step in self.0.back(tip) {
            let h = step.half_edge;
            path.push(if surface.target(h) == at { h } else { surface.twins()[h as usize] });
            at = step.from;
        }
        path.reverse();
        (!path.is_empty()).then_some(path)
    }
}

/// Vertices inside, each the one farthest from the boundary and from those before it.
pub(crate) fn spread(surface: &Surface, count: usize, control: &Control) -> Result<Vec<u32>> {
    let network = Network::of(surface);
    let mut search = Search::new(surface.len());
    for h in (0..surface.twins().len() as u32).filter(|&h| !is_inner(surface, h)) {
        search.seed(surface.origin(h));
    }
    let mut nearest = vec![f64::INFINITY; surface.len()];
    let mut chosen = Vec::new();
    loop {
        while let Some(node) = search.settle(&network, |_| true) {
            control.check()?;
            nearest[node as usize] = nearest[node as usize].min(search.distance(node));
        }
        let farthest = (0..surface.len()).rev().max_by(|&a, &b| nearest[a].total_cmp(&nearest[b]));
        match farthest {
            Some(vertex) if nearest[vertex] > 0.0 && nearest[vertex].is_finite() && chosen.len() < count => {
                chosen.push(vertex as u32);
                search.clear();
                search.seed(vertex as u32);
            }
            _ => return Ok(chosen),
        }
    }
}
