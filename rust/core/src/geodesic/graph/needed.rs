//! Which links a graph needs: a link is dropped where two others that stay together are hardly longer.
//!
//! Links come in layers of increasing length. What two links of earlier layers replace is dropped at once, so that only few
//! of all straight lines are ever held. The rest of a layer is judged one after the other, shorter ones first.

use std::ops::Range;
use std::sync::atomic::{AtomicU8, Ordering::Relaxed};

use rayon::prelude::*;

use super::view::{Seen, View};
use crate::adjacency::Arc;
use crate::control::Control;
use crate::error::{Error, Result};

/// A link is dropped if two others are together no longer than so many times its length (docs/decisions/0007).
pub(super) const DETOUR: f32 = 1.0005;

/// Links that are judged beside each other.
const AT_ONCE: usize = 1 << 15;

/// Vertices that one task looks at.
const BATCH: usize = 1 << 10;

/// What is known of a link: it is not judged yet, stays, or goes.
const OPEN: u8 = 0;
const STAYS: u8 = 1;
const GOES: u8 = 2;

/// Stands for the place of a link of an earlier layer: it stays.
const EARLIER: u32 = u32::MAX;

/// Straight lines from the vertices of a batch to higher ones.
#[derive(Debug, Default)]
struct Lines {
    /// Where each vertex's lines end.
    ends: Vec<usize>,
    /// Ordered by neighbour.
    arcs: Vec<Arc>,
}

impl Lines {
    fn of(&self, number: usize) -> &[Arc] {
        &self.arcs[number.checked_sub(1).map_or(0, |before| self.ends[before])..self.ends[number]]
    }

    fn push(&mut self, arcs: impl Iterator<Item = Arc>) {
        self.arcs.extend(arcs);
        self.ends.push(self.arcs.len());
    }
}

/// Links of some lengths, each from both of its ends, in compressed rows; a vertex's arcs are ordered by neighbour.
#[derive(Debug)]
struct Layer {
    starts: Vec<u32>,
    arcs: Vec<Arc>,
}

impl Layer {
    /// The lines of all batches, from both ends.
    fn of(lines: &[Lines], vertices: usize) -> Result<Self> {
        check_count(2 * lines.iter().map(|lines| lines.arcs.len()).sum::<usize>(), vertices)?;
        let all = || (0u32..).zip(lines.iter().flat_map(|lines| (0..lines.ends.len()).map(|number| lines.of(number))));
        let mut starts = vec![0u32; vertices + 1];
        for (from, arcs) in all() {
            starts[from as usize + 1] += arcs.len() as u32;
            arcs.iter().for_each(|arc| starts[arc.to as usize + 1] += 1);
        }
        for vertex in 0..vertices {
            starts[vertex + 1] += starts[vertex];
        }
        // lines are sorted, so each vertex meets its lower neighbours first, then its higher ones, both in their order
        let mut both = vec![Arc { to: 0, length: 0.0 }; starts[vertices] as usize];
        let mut free = starts.clone();
        for (from, arcs) in all() {
            for &arc in arcs {
                for (a, b) in [(from, arc.to), (arc.to, from)] {
                    both[free[a as usize] as usize] = Arc { to: b, ..arc };
                    free[a as usize] += 1;
                }
            }
        }
        Ok(Self { starts, arcs: both })
    }

    fn places(&self, vertex: u32) -> Range<usize> {
        self.starts[vertex as usize] as usize..self.starts[vertex as usize + 1] as usize
    }

    fn links_of(&self, vertex: u32) -> &[Arc] {
        &self.arcs[self.places(vertex)]
    }

    /// The place of a vertex's link to another one, or [`EARLIER`].
    fn place(&self, from: u32, to: u32) -> u32 {
        let found = self.links_of(from).binary_search_by_key(&to, |arc| arc.to);
        found.map_or(EARLIER, |place| self.starts[from as usize] + place as u32)
    }

    /// Those that are marked.
    fn only(self, marked: &[bool]) -> Self {
        let Self { mut starts, mut arcs } = self;
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
        Self { starts, arcs }
    }
}

/// A link that stays unless two others that stay replace it.
#[derive(Debug, Clone, Copy)]
struct Open {
    length: f32,
    /// Its places in its layer, that of its lower end first.
    places: [u32; 2],
    /// Which pairs of links are together hardly longer: the first, and how many.
    first: usize,
    count: u32,
}

/// The links that are needed, as far as they are known.
#[derive(Debug)]
pub(super) struct Needed {
    vertices: usize,
    layers: Vec<Layer>,
}

impl Needed {
    pub fn new(vertices: usize) -> Self {
        Self { vertices, layers: Vec::new() }
    }

    /// Adds the needed ones among all straight lines of some lengths (mm), from the first to the last, in layers that end at those
    /// between. None known before may be longer.
    pub fn add(&mut self, view: &View, lengths: &[f32], control: &Control) -> Result<()> {
        let seen = self.lacks(view, [lengths[0], lengths[lengths.len() - 1]], control)?;
        for (part, ends) in lengths.windows(2).enumerate() {
            let lines = self.still_lacks(&seen, [ends[0], ends[1]], part > 0, control)?;
            let layer = Layer::of(&lines, self.vertices)?;
            drop(lines);
            let stays = self.judge(&layer, control)?;
            self.layers.push(layer.only(&stays));
        }
        Ok(())
    }

    /// All of them in compressed rows: where each vertex's begin, and its links, ordered by neighbour.
    pub fn joined(self) -> Result<(Vec<u32>, Vec<Arc>)> {
        check_count(self.layers.iter().map(|layer| layer.arcs.len()).sum(), self.vertices)?;
        let mut starts = vec![0u32; self.vertices + 1];
        for layer in &self.layers {
            starts.par_iter_mut().zip(&layer.starts).with_min_len(BATCH).for_each(|(sum, start)| *sum += start);
        }
        let mut arcs = vec![Arc { to: 0, length: 0.0 }; starts[self.vertices] as usize];
        let mut rest = arcs.as_mut_slice();
        let mut batches = Vec::new();
        for batch in self.batches() {
            let count = starts[batch.end] - starts[batch.start];
            let (own, others) = rest.split_at_mut(count as usize);
            batches.push((batch, own));
            rest = others;
        }
        batches.into_par_iter().for_each(|(batch, mut arcs)| {
            for vertex in batch {
                let count = (starts[vertex + 1] - starts[vertex]) as usize;
                let (own, others) = arcs.split_at_mut(count);
                let links = self.layers.iter().flat_map(|layer| layer.links_of(vertex as u32));
                own.iter_mut().zip(links).for_each(|(to, link)| *to = *link);
                own.sort_unstable_by_key(|arc| arc.to);
                arcs = others;
            }
        });
        Ok((starts, arcs))
    }

    fn batches(&self) -> impl ExactSizeIterator<Item = Range<usize>> {
        let vertices = self.vertices;
        (0..vertices.div_ceil(BATCH)).map(move |batch| batch * BATCH..vertices.min((batch + 1) * BATCH))
    }

    /// Straight lines of some lengths (mm) that neither are links already nor are replaced by two of them.
    fn lacks(&self, view: &View, lengths: [f32; 2], control: &Control) -> Result<Vec<Lines>> {
        let of_batch = |(known, seen): &mut (Vec<f32>, Seen), batch: Range<usize>| {
            let mut lines = Lines::default();
            for vertex in batch {
                control.advance();
                control.check()?;
                view.from(vertex as u32, lengths, seen);
                self.beside(vertex as u32, None, known, |known| {
                    let is_lacking = |link: &Arc| known[link.to as usize].is_infinite() && !self.replaces(*link, known);
                    seen.lines.retain(is_lacking);
                });
                seen.lines.sort_unstable_by_key(|line| line.to);
                lines.push(seen.lines.iter().copied());
            }
            lines.arcs.shrink_to_fit();
            Ok(lines)
        };
        self.batches().collect::<Vec<_>>().into_par_iter().map_init(Default::default, of_batch).collect()
    }

    /// Those lines among some that have lengths between two, but for those that links replace; all links are looked at if any may.
    fn still_lacks(
        &self,
        seen: &[Lines],
        [shortest, longest]: [f32; 2],
        may_replace: bool,
        control: &Control,
    ) -> Result<Vec<Lines>> {
        let of_batch = |known: &mut Vec<f32>, (batch, seen): (Range<usize>, &Lines)| {
            control.check()?;
            let mut lines = Lines::default();
            for (number, vertex) in batch.enumerate() {
                let own =
                    || seen.of(number).iter().filter(|arc| arc.length >= shortest && arc.length < longest).copied();
                if may_replace {
                    self.beside(vertex as u32, None, known, |known| {
                        lines.push(own().filter(|link| !self.replaces(*link, known)));
                    });
                } else {
                    lines.push(own());
                }
            }
            Ok(lines)
        };
        let batches: Vec<_> = self.batches().zip(seen).collect();
        batches.into_par_iter().map_init(Vec::new, of_batch).collect()
    }

    /// Calls `work` with the length of a vertex's link to each other vertex, infinite where there is none: of a new layer, too.
    /// `lengths` is kept from one vertex to the next.
    fn beside<T>(&self, vertex: u32, new: Option<&Layer>, lengths: &mut Vec<f32>, work: impl FnOnce(&[f32]) -> T) -> T {
        lengths.resize(self.vertices, f32::INFINITY);
        let links = || self.layers.iter().chain(new).flat_map(|layer| layer.links_of(vertex));
        links().for_each(|arc| lengths[arc.to as usize] = arc.length);
        let result = work(lengths);
        links().for_each(|arc| lengths[arc.to as usize] = f32::INFINITY);
        result
    }

    /// Do two links replace another, that comes from a vertex whose links have these lengths?
    fn replaces(&self, link: Arc, lengths: &[f32]) -> bool {
        let most = link.length * DETOUR;
        let is_short = |second: &Arc| lengths[second.to as usize] + second.length <= most;
        self.layers.iter().any(|layer| layer.links_of(link.to).iter().any(is_short))
    }

    /// Finds out which links of a new layer stay besides those of earlier ones, so that every other is replaced by two that stay: one
    /// after the other, shorter ones first. Most verdicts do not depend on links of nearly the same length, and are found by all
    /// threads.
    fn judge(&self, layer: &Layer, control: &Control) -> Result<Vec<bool>> {
        let known: Vec<AtomicU8> = layer.arcs.iter().map(|_| AtomicU8::new(OPEN)).collect();
        let of_batch = |lengths: &mut Vec<f32>, batch: Range<usize>| {
            control.check()?;
            let (mut open, mut pairs) = (Vec::new(), Vec::new());
            for from in batch {
                self.beside(from as u32, Some(layer), lengths, |lengths| {
                    self.pairs_instead(layer, from as u32, lengths, &known, &mut open, &mut pairs);
                });
            }
            Ok((open, pairs))
        };
        let batches = self.batches().collect::<Vec<_>>().into_par_iter();
        let found: Vec<(Vec<Open>, Vec<[u32; 2]>)> = batches.map_init(Vec::new, of_batch).collect::<Result<_>>()?;
        let (mut open, mut pairs) = (Vec::new(), Vec::new());
        for (some, of_some) in found {
            open.extend(some.into_iter().map(|link: Open| Open { first: link.first + pairs.len(), ..link }));
            pairs.extend(of_some);
        }
        // in the order of their lower ends, where they are equally long
        open.par_sort_unstable_by_key(|link| (link.length.to_bits(), link.places));
        let instead = |link: &Open| &pairs[link.first..link.first + link.count as usize];
        for next in open.chunks(AT_ONCE) {
            control.check()?;
            let verdicts: Vec<u8> = next.par_iter().map(|link| verdict(instead(link), &known)).collect();
            for (link, verdict) in next.iter().zip(verdicts) {
                let verdict = if verdict == OPEN { verdict_now(instead(link), &known) } else { verdict };
                link.places.iter().for_each(|&place| known[place as usize].store(verdict, Relaxed));
            }
        }
        Ok(known.into_iter().map(|known| known.into_inner() == STAYS).collect())
    }

    /// Lists the new links from a vertex to higher ones that pairs of others may replace, and these pairs by their places; all other
    /// new links stay. `lengths` are those of the vertex's links.
    fn pairs_instead(
        &self,
        new: &Layer,
        from: u32,
        lengths: &[f32],
        known: &[AtomicU8],
        open: &mut Vec<Open>,
        pairs: &mut Vec<[u32; 2]>,
    ) {
        for (place, &arc) in (new.starts[from as usize]..).zip(new.links_of(from)).filter(|(_, arc)| arc.to > from) {
            let first = pairs.len();
            let most = arc.length * DETOUR;
            let is_short = |second: &Arc| lengths[second.to as usize] + second.length <= most;
            for layer in &self.layers {
                for second in layer.links_of(arc.to).iter().filter(|second| is_short(second)) {
                    pairs.push([new.place(from, second.to), EARLIER]);
                }
            }
            for (at, second) in (new.starts[arc.to as usize]..).zip(new.links_of(arc.to)) {
                if is_short(second) {
                    pairs.push([new.place(from, second.to), at]);
                }
            }
            let places = [place, new.place(arc.to, from)];
            if pairs.len() == first {
                places.iter().for_each(|&place| known[place as usize].store(STAYS, Relaxed));
            } else {
                open.push(Open { length: arc.length, places, first, count: (pairs.len() - first) as u32 });
            }
        }
    }
}

/// What is known of the links at a pair of places.
fn known_of(pair: &[u32; 2], known: &[AtomicU8]) -> [u8; 2] {
    pair.map(|place| if place == EARLIER { STAYS } else { known[place as usize].load(Relaxed) })
}

/// Whether a link stays beside pairs of others, as far as it is known without those that are open.
fn verdict(instead: &[[u32; 2]], known: &[AtomicU8]) -> u8 {
    let mut verdict = STAYS;
    for pair in instead {
        match known_of(pair, known) {
            [STAYS, STAYS] => return GOES,
            [GOES, _] | [_, GOES] => {}
            _ => verdict = OPEN,
        }
    }
    verdict
}

/// Whether it stays if those that are open do not count.
fn verdict_now(instead: &[[u32; 2]], known: &[AtomicU8]) -> u8 {
    if instead.iter().any(|pair| known_of(pair, known) == [STAYS; 2]) { GOES } else { STAYS }
}

/// Where a vertex's links begin is a number of 32 bits.
fn check_count(links: usize, vertices: usize) -> Result<()> {
    if links < u32::MAX as usize { Ok(()) } else { Err(Error::TooManyLinks { links, vertices }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_that_cannot_be_counted_are_refused() {
        let most = u32::MAX as usize;
        assert_eq!(check_count(most - 1, 40_000_000), Ok(()));
        let refused = Error::TooManyLinks { links: most, vertices: 45_000_000 };
        assert_eq!(check_count(most, 45_000_000), Err(refused));
    }
}
