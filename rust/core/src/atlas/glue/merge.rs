//! Pieces are united along their common boundaries, first those that share the largest part of the boundary of one of
//! them. (If only the length counted, large pieces would keep growing, with long boundaries that do not fit later.)

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use super::layout::Chain;
use super::seams::Gluing;
use crate::Result;
use crate::adjacency::distinct;
use crate::surface::mesh::next;

/// Sides are closed together if their gap is smaller than this share of their length.
const NEAR: f64 = 0.35;

/// Two pieces with a common boundary, and the first side of the longest chain between them. The key is the length of
/// this chain as a share of the shorter one of their boundaries, as sortable bits, largest first.
type Candidate = (u64, Reverse<u32>, [u32; 2]);

impl Gluing<'_> {
    fn between(&self, [a, b]: [u32; 2]) -> Vec<Chain> {
        let (few, other) = if self.size(a) < self.size(b) { (a, b) } else { (b, a) };
        let mut chains = self.layout.chains(&self.layout.members[few as usize], other);
        self.longest_first(&mut chains);
        chains
    }

    fn candidate(&self, pieces: [u32; 2]) -> Option<Candidate> {
        let chains = self.between(pieces);
        let first = chains.first()?;
        let boundary = pieces.map(|piece| self.boundaries[piece as usize]);
        let share = self.layout.length(first) / boundary[0].min(boundary[1]);
        Some((share.to_bits(), Reverse(first[0]), pieces))
    }

    /// Returns the adjacent pieces of a piece, each once, in their order.
    fn neighbours(&self, piece: u32) -> Vec<u32> {
        let sides = self.layout.members[piece as usize].iter().flat_map(|&facet| 3 * facet..3 * facet + 3);
        let cuts = sides.filter(|&side| self.layout.is_cut(side));
        let beside = cuts.map(|side| self.layout.piece[self.layout.twins[side as usize] as usize / 3]);
        distinct(beside.filter(|&other| other != piece))
    }

    pub fn merge(&mut self) -> Result<()> {
        let count = self.layout.members.len();
        self.control.begin("gluing patches", count as u64);
        let mut queue = BinaryHeap::new();
        for piece in 0..count as u32 {
            self.control.check()?;
            let larger = self.neighbours(piece).into_iter().filter(|&other| other > piece);
            queue.extend(larger.filter_map(|other| self.candidate([piece, other])));
        }
        while let Some(best) = queue.pop() {
            let [a, b] = best.2;
            if self.size(a) == 0 || self.size(b) == 0 {
                continue;
            }
            let Some(now) = self.candidate(best.2) else { continue };
            if now != best {
                queue.push(now);
                continue;
            }
            let (larger, smaller) = if self.size(a) < self.size(b) { (b, a) } else { (a, b) };
            let beside = self.neighbours(smaller);
            if self.unite(larger, smaller)? {
                self.control.advance();
                self.boundaries[larger as usize] = self.layout.boundary(larger);
                self.relax_if_grown(larger)?;
                let others = beside.into_iter().filter(|&other| other != larger);
                queue.extend(others.filter_map(|other| self.candidate([larger, other])));
            }
        }
        Ok(())
    }

    /// Closes the longest chain between two pieces, and those that then fit.
    fn unite(&mut self, larger: u32, smaller: u32) -> Result<bool> {
        let chains: Vec<Chain> =
            self.between([larger, smaller]).into_iter().map(|chain| self.seen_from(larger, chain)).collect();
        let mut fitting = self.fitting(&chains);
        if self.close(&fitting)? {
            return Ok(true);
        }
        let alone = chains.into_iter().next().unwrap_or_default();
        if fitting.len() == alone.len() {
            return Ok(false);
        }
        fitting.clone_from(&alone);
        self.close(&fitting)
    }

    /// Returns the longest chain, and the chains that fit with it.
    fn fitting(&self, chains: &[Chain]) -> Vec<u32> {
        let (turn, shift) = self.layout.fit(&chains[0]);
        let fits = |&side: &u32| {
            let twin = self.layout.twins[side as usize];
            let near = |at: u32, from: u32| {
                (turn * self.layout.at(from) + shift - self.layout.at(at)).norm()
                    < NEAR * self.layout.lengths[side as usize]
            };
            near(side, next(twin)) && near(next(side), twin)
        };
        let others = chains[1..].iter().flatten().copied().filter(fits);
        chains[0].iter().copied().chain(others).collect()
    }
}
