//! Which links a graph needs: a link is dropped where two others that stay together are hardly longer.
//!
//! Links come in rounds of increasing length. What two links of earlier rounds replace is dropped at once, so that only few
//! of all straight lines are ever held. The rest of a round is judged one after the other, shorter ones first.

use rayon::prelude::*;

use super::GeodesicGraph;
use super::view::View;
use crate::adjacency::{Arc, Links};
use crate::control::Control;
use crate::error::Result;

/// A link is dropped if two others are together no longer than so many times its length (docs/decisions/0007).
pub(super) const DETOUR: f32 = 1.0005;

impl GeodesicGraph {
    /// Straight lines of some lengths (mm) that neither are links here nor are replaced by two of them; for each vertex those
    /// to higher ones.
    pub(super) fn lacks(&self, view: &View, lengths: [f32; 2], control: &Control) -> Result<Vec<Box<[Arc]>>> {
        let of_vertex = |(known, seen): &mut (Vec<f32>, Vec<Arc>), vertex: u32| {
            control.advance();
            control.check()?;
            view.from(vertex, lengths, seen);
            self.beside(vertex, known, |known| {
                seen.retain(|link| known[link.to as usize].is_infinite() && !self.replaces(*link, known));
            });
            Ok(seen.as_slice().into())
        };
        (0..self.vertices() as u32).into_par_iter().map_init(Default::default, of_vertex).collect()
    }

    /// Calls `work` with the length of a vertex's link to each other vertex, infinite where there is none. `lengths` is kept
    /// from one vertex to the next.
    fn beside<T>(&self, vertex: u32, lengths: &mut Vec<f32>, work: impl FnOnce(&[f32]) -> T) -> T {
        lengths.resize(self.vertices(), f32::INFINITY);
        self.links_of(vertex).iter().for_each(|arc| lengths[arc.to as usize] = arc.length);
        let result = work(lengths);
        self.links_of(vertex).iter().for_each(|arc| lengths[arc.to as usize] = f32::INFINITY);
        result
    }

    /// Do two links replace another, that comes from a vertex whose links have these lengths?
    fn replaces(&self, link: Arc, lengths: &[f32]) -> bool {
        let most = link.length * DETOUR;
        self.links_of(link.to).iter().any(|second| lengths[second.to as usize] + second.length <= most)
    }

    /// These links, and of those that were found the ones that are needed beside them.
    pub(super) fn with_needed(self, found: Vec<Box<[Arc]>>, control: &Control) -> Result<Self> {
        let found = Self::from_both_ends(found);
        let (all, mut stays) = self.with(&found);
        drop(found);
        all.judge(&mut stays, control)?;
        Ok(all.only(&stays))
    }

    /// The links that are listed for their lower vertex each.
    fn from_both_ends(upward: Vec<Box<[Arc]>>) -> Self {
        let mut starts = vec![0u32; upward.len() + 1];
        for (a, arcs) in upward.iter().enumerate() {
            starts[a + 1] += arcs.len() as u32;
            arcs.iter().for_each(|arc| starts[arc.to as usize + 1] += 1);
        }
        for vertex in 0..upward.len() {
            starts[vertex + 1] += starts[vertex];
        }
        // links are sorted, so each vertex meets its lower neighbours first, then its higher ones, both in their order
        let mut arcs = vec![Arc { to: 0, length: 0.0 }; starts[upward.len()] as usize];
        let mut free = starts.clone();
        for (a, links) in (0..).zip(upward) {
            for arc in links {
                for (from, to) in [(a, arc.to), (arc.to, a)] {
                    arcs[free[from as usize] as usize] = Arc { to, ..arc };
                    free[from as usize] += 1;
                }
            }
        }
        Self::from_rows(starts, arcs)
    }

    /// These links and others, none of which joins the same vertices; and which are these. They are merged in place, from the
    /// last to the first.
    fn with(self, others: &Self) -> (Self, Vec<bool>) {
        let Self { starts: before, mut arcs, .. } = self;
        let starts: Vec<u32> = before.iter().zip(&others.starts).map(|(a, b)| a + b).collect();
        let mut is_old = vec![false; arcs.len() + others.arcs.len()];
        arcs.reserve_exact(others.arcs.len());
        arcs.resize(is_old.len(), Arc { to: 0, length: 0.0 });
        for vertex in (0..others.vertices()).rev() {
            let [first, mut old] = [before[vertex] as usize, before[vertex + 1] as usize];
            let mut new = others.links_of(vertex as u32);
            for place in (starts[vertex] as usize..starts[vertex + 1] as usize).rev() {
                if old > first && new.last().is_none_or(|arc| arc.to < arcs[old - 1].to) {
                    old -= 1;
                    (arcs[place], is_old[place]) = (arcs[old], true);
                } else if let Some((&last, rest)) = new.split_last() {
                    (arcs[place], new) = (last, rest);
                }
            }
        }
        (Self::from_rows(starts, arcs), is_old)
    }

    /// Finds out which links stay besides those that do already, so that every other is replaced by two that stay.
    fn judge(&self, stays: &mut [bool], control: &Control) -> Result<()> {
        let keep = |stays: &mut [bool], a: u32, b: u32| {
            for (from, to) in [(a, b), (b, a)] {
                let place = self.links_of(from).partition_point(|arc| arc.to < to);
                stays[self.starts[from as usize] as usize + place] = true;
            }
        };
        let of_vertex = |lengths: &mut Vec<f32>, vertex: u32| {
            control.check()?;
            let first = self.starts[vertex as usize] as usize;
            let new =
                self.links_of(vertex).iter().zip(&stays[first..]).filter(|&(arc, &stays)| arc.to > vertex && !stays);
            let judged = self.beside(vertex, lengths, |lengths| {
                new.map(|(&arc, _)| (vertex, arc, self.replaces(arc, lengths))).collect::<Vec<_>>()
            });
            Ok(judged)
        };
        let vertices = (0..self.vertices() as u32).into_par_iter();
        let judged: Vec<Vec<(u32, Arc, bool)>> = vertices.map_init(Vec::new, of_vertex).collect::<Result<_>>()?;
        let mut open: Vec<(u32, Arc)> = Vec::new();
        for (a, arc, is_open) in judged.into_iter().flatten() {
            if is_open {
                open.push((a, arc));
            } else {
                keep(stays, a, arc.to);
            }
        }
        open.par_sort_unstable_by_key(|&(a, arc)| (arc.length.to_bits(), a, arc.to));
        for (count, (a, arc)) in open.into_iter().enumerate() {
            if count.is_multiple_of(1024) {
                control.check()?;
            }
            if !self.is_replaced(a, arc, stays) {
                keep(stays, a, arc.to);
            }
        }
        Ok(())
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

    /// Those that are marked.
    fn only(self, marked: &[bool]) -> Self {
        let Self { mut starts, mut arcs, .. } = self;
        let mut kept = 0;
        for vertex in 0..starts.len() - 1 {
            let links = starts[vertex] as usize..starts[vertex + 1] as usize;
            starts[vertex] = kept as u32;
            for link in links.filter(|&link| marked[link]) {
                arcs[kept] = arcs[link];
                kept += 1;
            }
        }
        *starts.last_mut().expect("one start more than vertices") = kept as u32;
        arcs.truncate(kept);
        arcs.shrink_to_fit();
        Self::from_rows(starts, arcs)
    }
}
