//! Pruning of links: a link is dropped if two other links that are kept are together hardly longer.
//!
//! Links come in layers of increasing length. Links that two links of earlier layers replace are dropped at once, so
//! that few links remain to be compared: the rest of a layer, one after the other, shorter ones first.

use std::ops::Range;
use std::sync::atomic::{AtomicU8, Ordering::Relaxed};

use rayon::prelude::*;

use super::view::{Seen, View};
use crate::adjacency::{Arc, starts_of};
use crate::{Control, Error, Result};

/// A link is dropped if two others are together at most this factor longer (docs/decisions/0007).
pub(super) const DETOUR: f32 = 1.0005;

/// The number of links that are evaluated together.
const AT_ONCE: usize = 1 << 15;

/// The number of vertices per task.
const BATCH: usize = 1 << 10;

/// The state of a link: it is not evaluated yet, kept, or dropped.
const OPEN: u8 = 0;
const STAYS: u8 = 1;
const GOES: u8 = 2;

/// Marks the position of a link of an earlier layer, which is kept.
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
}

/// Links within a range of lengths, stored at both ends in compressed rows; arcs are ordered by neighbour.
#[derive(Debug)]
struct Layer {
    /// No link is shorter, in mm.
    shortest: f32,
    starts: Vec<u32>,
    arcs: Vec<Arc>,
}

impl Layer {
    /// Creates a layer from the lines of all batches, from both ends, none shorter than `shortest`.
    fn of(lines: &[Lines], vertices: usize, shortest: f32) -> Result<Self> {
        check_count(2 * lines.iter().map(|lines| lines.arcs.len()).sum::<usize>(), vertices)?;
        let all = || (0u32..).zip(lines.iter().flat_map(|lines| (0..lines.ends.len()).map(|number| lines.of(number))));
        let starts =
            starts_of(vertices, all().flat_map(|(from, arcs)| arcs.iter().flat_map(move |arc| [from, arc.to])));
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
        Ok(Self { shortest, starts, arcs: both })
    }

    fn places(&self, vertex: u32) -> Range<usize> {
        self.starts[vertex as usize] as usize..self.starts[vertex as usize + 1] as usize
    }

    fn links_of(&self, vertex: u32) -> &[Arc] {
        &self.arcs[self.places(vertex)]
    }

    /// Returns whether one of its links, plus another that is at least as long as `other`, can be no longer than
    /// `most`. Rounding preserves the order of sums.
    fn is_short_beside(&self, other: f32, most: f32) -> bool {
        self.shortest + other <= most
    }

    fn only(self, marked: &[bool]) -> Self {
        let Self { shortest, mut starts, mut arcs } = self;
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
        Self { shortest, starts, arcs }
    }
}

/// A link that is kept unless two other kept links replace it.
#[derive(Debug, Clone, Copy)]
struct Open {
    length: f32,
    /// Its positions in its layer, that of its lower end first.
    places: [u32; 2],
    /// The pairs of links that are together hardly longer: the first one, and their number.
    first: usize,
    count: u32,
}

/// The links of a vertex in all layers and in a new one.
struct Beside {
    /// The length of its link to each other vertex; infinite where there is none.
    lengths: Vec<f32>,
    /// The position of that link in the new layer, or [`EARLIER`].
    places: Vec<u32>,
}

impl Beside {
    fn nothing(vertices: usize) -> Self {
        Self { lengths: vec![f32::INFINITY; vertices], places: vec![EARLIER; vertices] }
    }
}

/// The links that are kept so far.
#[derive(Debug)]
pub(super) struct Needed {
    vertices: usize,
    layers: Vec<Layer>,
}

impl Needed {
    /// Returns the links to keep among all straight lines of a view, evaluated in this number of layers.
    pub fn of(view: View, vertices: usize, layers: usize, control: &Control) -> Result<Self> {
        let mut needed = Self { vertices, layers: Vec::new() };
        let lengths = view.layers(layers);
        let mut lines = needed.lines(&view, control)?;
        drop(view);
        for ends in lengths.windows(2) {
            let lacking = needed.still_lacks(&mut lines, ends[1], control)?;
            let layer = Layer::of(&lacking, vertices, ends[0])?;
            drop(lacking);
            let stays = needed.evaluate(&layer, control)?;
            needed.layers.push(layer.only(&stays));
        }
        Ok(needed)
    }

    /// Returns all of them in compressed rows: where each vertex's links begin, and its links, ordered by neighbour.
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

    fn lines(&self, view: &View, control: &Control) -> Result<Vec<Lines>> {
        let of_batch = |(seen, arcs): &mut (Seen, Vec<Arc>), batch: Range<usize>| {
            let mut ends = Vec::with_capacity(batch.len());
            arcs.clear();
            for vertex in batch {
                control.advance();
                control.check()?;
                view.from(vertex as u32, seen);
                seen.lines.sort_unstable_by_key(|line| line.to);
                arcs.extend(&seen.lines);
                ends.push(arcs.len());
            }
            Ok(Lines { ends, arcs: arcs.clone() }) // exact capacity: growing vectors leave gaps in memory
        };
        self.batches().collect::<Vec<_>>().into_par_iter().map_init(Default::default, of_batch).collect()
    }

    /// Takes the lines that are shorter than `longest`; returns those that two links do not replace.
    fn still_lacks(&self, lines: &mut [Lines], longest: f32, control: &Control) -> Result<Vec<Lines>> {
        let of_batch = |known: &mut Vec<f32>, (batch, lines): (Range<usize>, &mut Lines)| {
            control.check()?;
            let mut lacking = Lines::default();
            let (mut first, mut kept) = (0, 0);
            for (vertex, end) in batch.zip(&mut lines.ends) {
                self.beside(vertex as u32, known, |known| {
                    for n in first..*end {
                        let line = lines.arcs[n];
                        if line.length >= longest {
                            lines.arcs[kept] = line;
                            kept += 1;
                        } else if !self.replaces(line, known) {
                            lacking.arcs.push(line);
                        }
                    }
                });
                lacking.ends.push(lacking.arcs.len());
                first = std::mem::replace(end, kept);
            }
            lines.arcs.truncate(kept);
            lines.arcs.shrink_to_fit();
            Ok(lacking)
        };
        let batches: Vec<_> = self.batches().zip(lines).collect();
        batches.into_par_iter().map_init(Vec::new, of_batch).collect()
    }

    /// Calls `work` with the lengths of a vertex's links to all vertices, infinite if missing. `lengths` is reused.
    fn beside<T>(&self, vertex: u32, lengths: &mut Vec<f32>, work: impl FnOnce(&[f32]) -> T) -> T {
        lengths.resize(self.vertices, f32::INFINITY);
        let links = || self.layers.iter().flat_map(|layer| layer.links_of(vertex));
        links().for_each(|arc| lengths[arc.to as usize] = arc.length);
        let result = work(lengths);
        links().for_each(|arc| lengths[arc.to as usize] = f32::INFINITY);
        result
    }

    /// Returns whether two links replace another one, from a vertex whose links have these lengths.
    fn replaces(&self, link: Arc, lengths: &[f32]) -> bool {
        let most = link.length * DETOUR;
        let is_short = |second: &Arc| lengths[second.to as usize] + second.length <= most;
        self.layers.iter().any(|layer| layer.links_of(link.to).iter().any(is_short))
    }

    /// Determines which links of a new layer are kept besides those of earlier layers, so that every other one is
    /// replaced by two that are kept: one after the other, shorter ones first. Most verdicts do not depend on links of
    /// nearly the same length, and are found by all threads.
    fn evaluate(&self, layer: &Layer, control: &Control) -> Result<Vec<bool>> {
        // a greedy spanner (Althöfer et al. 1993), except that only paths of two links are compared
        let known: Vec<AtomicU8> = layer.arcs.iter().map(|_| AtomicU8::new(OPEN)).collect();
        let of_batch = |beside: &mut Beside, batch: Range<usize>| {
            control.check()?;
            let (mut open, mut pairs) = (Vec::new(), Vec::new());
            for from in batch {
                self.pairs_instead(layer, from as u32, beside, &known, &mut open, &mut pairs);
            }
            Ok((open, pairs))
        };
        let batches = self.batches().collect::<Vec<_>>().into_par_iter();
        let beside = || Beside::nothing(self.vertices);
        let found: Vec<(Vec<Open>, Vec<[u32; 2]>)> = batches.map_init(beside, of_batch).collect::<Result<_>>()?;
        let (mut open, mut pairs) = (Vec::new(), Vec::new());
        for (some, of_some) in found {
            open.extend(some.into_iter().map(|link: Open| Open { first: link.first + pairs.len(), ..link }));
            pairs.extend(of_some);
        }
        // in the order of their lower ends, where they are equally long
        // positive floats sort as their bits
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

    /// Lists the new links from a vertex to higher ones that pairs of others may replace, and these pairs by their
    /// positions; all other new links are kept.
    fn pairs_instead(
        &self, new: &Layer, from: u32, beside: &mut Beside, known: &[AtomicU8], open: &mut Vec<Open>,
        pairs: &mut Vec<[u32; 2]>,
    ) {
        let new_links = || (new.starts[from as usize]..).zip(new.links_of(from));
        let links = || self.layers.iter().flat_map(|layer| layer.links_of(from)).chain(new.links_of(from));
        links().for_each(|link| beside.lengths[link.to as usize] = link.length);
        new_links().for_each(|(place, link)| beside.places[link.to as usize] = place);
        beside.lengths[from as usize] = f32::NEG_INFINITY; // so that the return is found among the short ones
        for (place, &arc) in new_links().filter(|(_, arc)| arc.to > from) {
            let (first, mut back) = (pairs.len(), EARLIER);
            let most = arc.length * DETOUR;
            let is_short = |second: &Arc| beside.lengths[second.to as usize] + second.length <= most;
            // two links of earlier layers do not replace it, or it would not be a new link
            for layer in self.layers.iter().filter(|layer| layer.is_short_beside(new.shortest, most)) {
                for second in layer.links_of(arc.to).iter().filter(|second| is_short(second)) {
                    pairs.push([beside.places[second.to as usize], EARLIER]);
                }
            }
            for (at, second) in (new.starts[arc.to as usize]..).zip(new.links_of(arc.to)) {
                if is_short(second) {
                    if second.to == from {
                        back = at;
                    } else {
                        pairs.push([beside.places[second.to as usize], at]);
                    }
                }
            }
            let places = [place, back];
            if pairs.len() == first {
                places.iter().for_each(|&place| known[place as usize].store(STAYS, Relaxed));
            } else {
                open.push(Open { length: arc.length, places, first, count: (pairs.len() - first) as u32 });
            }
        }
        links().for_each(|link| beside.lengths[link.to as usize] = f32::INFINITY);
        new_links().for_each(|(_, link)| beside.places[link.to as usize] = EARLIER);
        beside.lengths[from as usize] = f32::INFINITY;
    }
}

fn known_of(pair: &[u32; 2], known: &[AtomicU8]) -> [u8; 2] {
    pair.map(|place| if place == EARLIER { STAYS } else { known[place as usize].load(Relaxed) })
}

/// Returns whether a link is kept beside pairs of others, as far as known without those that are open.
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

/// Returns whether it is kept if open links do not count.
fn verdict_now(instead: &[[u32; 2]], known: &[AtomicU8]) -> u8 {
    if instead.iter().any(|pair| known_of(pair, known) == [STAYS; 2]) { GOES } else { STAYS }
}

/// Checks that the positions of links fit into 32 bits.
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
