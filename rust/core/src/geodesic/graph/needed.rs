//! Which links a graph needs: a link is dropped where two others that stay together are hardly longer.
//!
//! Links come in rounds of increasing length. What two links of earlier rounds replace is dropped at once, so that only few
//! of all straight lines are ever held. The rest of a round is judged one after the other, shorter ones first.

use std::sync::atomic::{AtomicU8, Ordering::Relaxed};

use rayon::prelude::*;

use super::GeodesicGraph;
use super::view::View;
use crate::adjacency::{Arc, Links};
use crate::control::Control;
use crate::error::{Error, Result};

/// A link is dropped if two others are together no longer than so many times its length (docs/decisions/0007).
pub(super) const DETOUR: f32 = 1.0005;

/// Links that are judged beside each other.
const AT_ONCE: usize = 1 << 15;

/// What is known of a link: it is not judged yet, stays, or goes.
const OPEN: u8 = 0;
const STAYS: u8 = 1;
const GOES: u8 = 2;

/// A link that stays unless two others that stay replace it: its length, its ends, the lower first, and its places among the arcs.
#[derive(Debug, Clone, Copy)]
struct Open {
    length: f32,
    ends: [u32; 2],
    places: [u32; 2],
}

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
        check_count(self.links() + 2 * found.iter().map(|arcs| arcs.len()).sum::<usize>(), self.vertices())?;
        let found = Self::from_both_ends(found);
        let (all, old) = self.with(&found);
        drop(found);
        let stays = all.judge(old, control)?;
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

    /// Finds out which links stay besides those that do already, so that every other is replaced by two that stay: one after the
    /// other, shorter ones first. Most verdicts do not depend on links of nearly the same length, and are found by all threads.
    fn judge(&self, stays: Vec<bool>, control: &Control) -> Result<Vec<bool>> {
        let known: Vec<AtomicU8> =
            stays.into_iter().map(|stays| AtomicU8::new(if stays { STAYS } else { OPEN })).collect();
        let of_vertex = |lengths: &mut Vec<f32>, from: u32| {
            control.check()?;
            let mut open = Vec::new();
            self.beside(from, lengths, |lengths| {
                let first = self.starts[from as usize];
                for (place, &arc) in (first..).zip(self.links_of(from)) {
                    if arc.to > from && known[place as usize].load(Relaxed) == OPEN {
                        let back = self.links_of(arc.to).partition_point(|back| back.to < from) as u32;
                        let places = [place, self.starts[arc.to as usize] + back];
                        if self.replaces(arc, lengths) {
                            open.push(Open { length: arc.length, ends: [from, arc.to], places });
                        } else {
                            places.iter().for_each(|&place| known[place as usize].store(STAYS, Relaxed));
                        }
                    }
                }
            });
            Ok(open)
        };
        let vertices = (0..self.vertices() as u32).into_par_iter();
        let open: Vec<Vec<Open>> = vertices.map_init(Vec::new, of_vertex).collect::<Result<_>>()?;
        let mut open: Vec<Open> = open.into_iter().flatten().collect();
        open.par_sort_unstable_by_key(|link| (link.length.to_bits(), link.ends));
        for next in open.chunks(AT_ONCE) {
            control.check()?;
            let verdicts: Vec<u8> = next.par_iter().map(|link| self.verdict(link, &known)).collect();
            for (link, verdict) in next.iter().zip(verdicts) {
                let verdict = if verdict == OPEN { self.verdict_now(link, &known) } else { verdict };
                link.places.iter().for_each(|&place| known[place as usize].store(verdict, Relaxed));
            }
        }
        Ok(known.into_iter().map(|known| known.into_inner() == STAYS).collect())
    }

    /// Whether a link stays, as far as it is known without those that are open.
    fn verdict(&self, link: &Open, known: &[AtomicU8]) -> u8 {
        let mut verdict = STAYS;
        for pair in self.pairs_instead(link) {
            match pair.map(|place| known[place].load(Relaxed)) {
                [STAYS, STAYS] => return GOES,
                [GOES, _] | [_, GOES] => {}
                _ => verdict = OPEN,
            }
        }
        verdict
    }

    /// Whether a link stays if those that are open do not count.
    fn verdict_now(&self, link: &Open, known: &[AtomicU8]) -> u8 {
        let stay = |pair: [usize; 2]| pair.iter().all(|&place| known[place].load(Relaxed) == STAYS);
        if self.pairs_instead(link).any(stay) { GOES } else { STAYS }
    }

    /// The places of two links each that are together hardly longer than a link.
    fn pairs_instead(&self, &Open { length, ends, .. }: &Open) -> impl Iterator<Item = [usize; 2]> {
        let most = length * DETOUR;
        let [mut of_a, mut of_b] = ends.map(|v| self.starts[v as usize] as usize..self.starts[v as usize + 1] as usize);
        std::iter::from_fn(move || {
            while let (false, false) = (of_a.is_empty(), of_b.is_empty()) {
                let places = [of_a.start, of_b.start];
                let [first, second] = places.map(|place| self.arcs[place]);
                of_a.start += usize::from(first.to <= second.to);
                of_b.start += usize::from(second.to <= first.to);
                if first.to == second.to && first.length + second.length <= most {
                    return Some(places);
                }
            }
            None
        })
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

/// Where a vertex's links begin is a number of 32 bits.
fn check_count(links: usize, vertices: usize) -> Result<()> {
    if u32::try_from(links).is_ok() { Ok(()) } else { Err(Error::TooManyLinks { links, vertices }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_that_cannot_be_counted_are_refused() {
        let most = u32::MAX as usize;
        assert_eq!(check_count(most, 40_000_000), Ok(()));
        let refused = Error::TooManyLinks { links: most + 1, vertices: 45_000_000 };
        assert_eq!(check_count(most + 1, 45_000_000), Err(refused));
    }
}
