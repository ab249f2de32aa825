//! Which seams are closed, and in what order.

use std::cmp::{Ordering, Reverse};
use std::collections::BinaryHeap;

use super::border::meets_itself;
use super::settle::Around;
use super::sheet::{Chain, Sheet};
use crate::control::Control;
use crate::embed::stress::descent::Until;
use crate::error::Result;

/// Rings of places around a seam that are moved to close it: first few, then more.
const RINGS: [usize; 2] = [2, 6];

/// Steps towards a better place after a seam is closed.
const STEPS: usize = 6;

/// Sides that lie apart by less than this part of their length are closed together.
const NEAR: f64 = 0.35;

/// Wider gaps, in lengths of a side, are not tried to be closed.
const WIDE: f64 = 4.0;

/// Times that all cuts are tried again at most.
const ROUNDS: usize = 4;

/// A round that closes less than this part of the seams is the last.
const LITTLE: f64 = 2e-3;

/// A piece is relaxed as a whole when it is so many times as large as it was when that was done before.
const GROWN: f64 = 2.0;

/// The descent of a whole piece between.
const BRIEFLY: Until = Until { steps: 20, gain: 1e-3, enough: 1e-16 };

/// Why a cut is there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Reason {
    /// Triangles would change beyond the bound.
    Bound,
    /// The piece would lie on itself.
    Overlap,
}

pub(super) struct Gluing<'a> {
    pub sheet: Sheet<'a>,
    /// Why each side was not closed when that was tried last.
    pub reasons: Vec<Option<Reason>>,
    bound: f64,
    /// The facets of each piece when it was relaxed last.
    relaxed: Vec<usize>,
    control: &'a Control,
}

/// Two pieces whose common boundary may be closed: the longest first, then by the order of the sides.
#[derive(PartialEq)]
struct Candidate {
    length: f64,
    first: Reverse<u32>,
    pieces: [u32; 2],
}

impl Eq for Candidate {}

impl Ord for Candidate {
    fn cmp(&self, other: &Self) -> Ordering {
        self.length.total_cmp(&other.length).then(self.first.cmp(&other.first)).then(self.pieces.cmp(&other.pieces))
    }
}

impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl<'a> Gluing<'a> {
    pub fn new(sheet: Sheet<'a>, bound: f64, control: &'a Control) -> Self {
        let relaxed = sheet.members.iter().map(Vec::len).collect();
        Self { reasons: vec![None; sheet.twins.len()], sheet, bound, relaxed, control }
    }

    fn size(&self, piece: u32) -> usize {
        self.sheet.members[piece as usize].len()
    }

    /// The chains between two pieces, the longest first.
    fn between(&self, [a, b]: [u32; 2]) -> Vec<Chain> {
        let (few, other) = if self.size(a) < self.size(b) { (a, b) } else { (b, a) };
        let mut chains = self.sheet.chains(&self.sheet.members[few as usize], other);
        self.longest_first(&mut chains);
        chains
    }

    fn longest_first(&self, chains: &mut [Chain]) {
        chains.sort_by(|p, q| self.sheet.length(q).total_cmp(&self.sheet.length(p)).then(p[0].cmp(&q[0])));
    }

    fn candidate(&self, pieces: [u32; 2]) -> Option<Candidate> {
        let chains = self.between(pieces);
        let first = chains.first()?;
        Some(Candidate { length: self.sheet.length(first), first: Reverse(first[0]), pieces })
    }

    /// The pieces beside one, each once, in their order.
    fn neighbours(&self, piece: u32) -> Vec<u32> {
        let sides = self.sheet.members[piece as usize].iter().flat_map(|&facet| 3 * facet..3 * facet + 3);
        let cuts = sides.filter(|&side| self.sheet.is_cut(side));
        let mut beside: Vec<u32> =
            cuts.map(|side| self.sheet.piece[self.sheet.twins[side as usize] as usize / 3]).collect();
        beside.sort_unstable();
        beside.dedup();
        beside.retain(|&other| other != piece);
        beside
    }

    /// Unites pieces along their longest common boundaries.
    pub fn merge(&mut self) -> Result<()> {
        let count = self.sheet.members.len();
        self.control.begin("gluing patches", count as u64);
        let mut queue = BinaryHeap::new();
        for piece in 0..count as u32 {
            self.control.check()?;
            let larger = self.neighbours(piece).into_iter().filter(|&other| other > piece);
            queue.extend(larger.filter_map(|other| self.candidate([piece, other])));
        }
        while let Some(next) = queue.pop() {
            if next.pieces.iter().any(|&piece| self.size(piece) == 0) {
                continue;
            }
            let Some(now) = self.candidate(next.pieces) else { continue };
            if now != next {
                queue.push(now);
                continue;
            }
            let [a, b] = next.pieces;
            let (larger, smaller) = if self.size(a) < self.size(b) { (b, a) } else { (a, b) };
            let beside = self.neighbours(smaller);
            if self.unite(larger, smaller)? {
                self.control.advance();
                self.relax_if_grown(larger)?;
                let others = beside.into_iter().filter(|&other| other != larger);
                queue.extend(others.filter_map(|other| self.candidate([larger, other])));
            }
        }
        Ok(())
    }

    /// Closes the longest chain between two pieces, and those that fit when it is closed.
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

    /// The longest chain, and what else fits when it does.
    fn fitting(&self, chains: &[Chain]) -> Vec<u32> {
        let (turn, shift, _) = self.sheet.fit(&chains[0]);
        let fits = |&side: &u32| {
            let twin = self.sheet.twins[side as usize];
            let near = |at: u32, from: u32| {
                (turn * self.sheet.at(from) + shift - self.sheet.at(at)).norm()
                    < NEAR * self.sheet.lengths[side as usize]
            };
            near(side, crate::surface::mesh::next(twin)) && near(crate::surface::mesh::next(side), twin)
        };
        let others = chains[1..].iter().flatten().copied().filter(fits);
        chains[0].iter().copied().chain(others).collect()
    }

    /// The chain by its sides in a piece.
    fn seen_from(&self, piece: u32, chain: Chain) -> Chain {
        if self.sheet.piece[chain[0] as usize / 3] == piece {
            return chain;
        }
        chain.iter().rev().map(|&side| self.sheet.twins[side as usize]).collect()
    }

    /// Closes cuts, all of them, if that is possible within the bound and without overlap. The cuts of two pieces are given
    /// from the larger one's side; the smaller is placed beside it.
    fn close(&mut self, cuts: &[u32]) -> Result<bool> {
        self.control.check()?;
        let owner = |side: u32| self.sheet.piece[side as usize / 3];
        let pieces = [owner(cuts[0]), owner(self.sheet.twins[cuts[0] as usize])];
        let is_one = pieces[0] == pieces[1];
        if !is_one {
            let (turn, shift, _) = self.sheet.fit(cuts);
            self.sheet.place_rigidly(pieces[1], turn, shift);
        }
        let too_wide = cuts.iter().any(|&side| self.sheet.gap(side) > WIDE * self.sheet.lengths[side as usize]);
        let reason = if too_wide { Some(Reason::Bound) } else { self.closed(cuts, pieces)? };
        for &side in cuts {
            self.reasons[side as usize] = reason;
            self.reasons[self.sheet.twins[side as usize] as usize] = reason;
        }
        if reason.is_none() && !is_one {
            self.sheet.unite(pieces[0], pieces[1]);
        }
        Ok(reason.is_none())
    }

    /// Joins cuts and settles what is around; says why not, if that is so.
    fn closed(&mut self, cuts: &[u32], pieces: [u32; 2]) -> Result<Option<Reason>> {
        let joined = self.sheet.join(cuts);
        let mut reason = Reason::Bound;
        for rings in RINGS {
            let around = Around::new(&self.sheet, &joined.at, rings, self.control)?;
            if let Some(before) = around.settle(&mut self.sheet, self.bound, STEPS, self.control)? {
                let free: std::collections::HashSet<u32> = around.free.iter().copied().collect();
                let sheet = &self.sheet;
                let is_beyond = |place: u32| pieces[0] != pieces[1] && sheet.piece[place as usize / 3] == pieces[1];
                let moved = |place: u32| free.contains(&place) || is_beyond(place);
                let all = if pieces[0] == pieces[1] { &pieces[..1] } else { &pieces[..] };
                if !meets_itself(sheet, all, &moved, self.control)? {
                    return Ok(None);
                }
                around.write(&mut self.sheet, &before);
                reason = Reason::Overlap;
                break;
            }
            if around.is_all {
                break;
            }
        }
        self.sheet.part(joined);
        Ok(Some(reason))
    }

    fn relax_if_grown(&mut self, piece: u32) -> Result<()> {
        if (self.size(piece) as f64) < GROWN * self.relaxed[piece as usize] as f64 {
            return Ok(());
        }
        self.relax(piece, BRIEFLY, 1)
    }

    /// Moves a whole piece to where its triangles change less, as long as it does not come to lie on itself.
    pub fn relax(&mut self, piece: u32, until: Until, times: usize) -> Result<()> {
        self.relaxed[piece as usize] = self.size(piece);
        let corners = self.sheet.members[piece as usize].iter().flat_map(|&facet| 3 * facet..3 * facet + 3);
        let mut places: Vec<u32> = corners.filter(|&corner| self.sheet.place[corner as usize] == corner).collect();
        places.sort_unstable();
        let around = Around::new(&self.sheet, &places, 0, self.control)?;
        for _ in 0..times {
            let before: Vec<_> = places.iter().map(|&place| self.sheet.uv[place as usize]).collect();
            let converged = around.relax(&mut self.sheet, self.bound, until, self.control)?;
            if !around.is_sound(&self.sheet, self.bound)
                || meets_itself(&self.sheet, &[piece], &|_| true, self.control)?
            {
                around.write(&mut self.sheet, &before);
                break;
            }
            if converged {
                break;
            }
        }
        Ok(())
    }

    /// Tries to close what is left, in parts where it cannot be closed as a whole.
    pub fn zip(&mut self) -> Result<()> {
        let seams: f64 =
            self.sheet.seams.iter().zip(&self.sheet.lengths).filter(|(seam, _)| **seam).map(|(_, l)| l).sum();
        for _ in 0..ROUNDS {
            let before = self.cut_length();
            let mut chains = self.all_chains();
            self.longest_first(&mut chains);
            self.control.begin("closing seams", chains.len() as u64);
            for chain in chains {
                self.zip_chain(chain)?;
                self.control.advance();
            }
            self.finish(BRIEFLY, 1)?;
            if before - self.cut_length() < LITTLE * seams {
                break;
            }
        }
        Ok(())
    }

    /// Moves every piece to where its triangles change least.
    pub fn finish(&mut self, until: Until, times: usize) -> Result<()> {
        self.control.begin("relaxing pieces", self.sheet.members.len() as u64);
        for piece in 0..self.sheet.members.len() as u32 {
            if self.size(piece) > 0 {
                self.relax(piece, until, times)?;
            }
            self.control.advance();
        }
        Ok(())
    }

    fn all_chains(&self) -> Vec<Chain> {
        let cuts = (0..self.sheet.twins.len() as u32).filter(|&side| self.sheet.is_cut(side));
        let owner = |side: u32| self.sheet.piece[side as usize / 3];
        let mut keyed: Vec<([u32; 2], u32)> =
            cuts.map(|side| ([owner(side), owner(self.sheet.twins[side as usize])], side)).collect();
        keyed.retain(|([a, b], _)| a <= b);
        keyed.sort_unstable();
        keyed
            .chunk_by(|p, q| p.0 == q.0)
            .flat_map(|few| self.sheet.chained(few.iter().map(|few| few.1).collect()))
            .collect()
    }

    /// The length of all cuts, each from both sides, mm.
    pub fn cut_length(&self) -> f64 {
        let cuts = (0..self.sheet.twins.len() as u32).filter(|&side| self.sheet.is_cut(side));
        cuts.map(|side| self.sheet.lengths[side as usize]).sum()
    }

    fn zip_chain(&mut self, chain: Chain) -> Result<()> {
        let open: Vec<u32> = chain.into_iter().filter(|&side| self.sheet.is_cut(side)).collect();
        if open.is_empty() {
            return Ok(());
        }
        let owner = |side: u32| self.sheet.piece[side as usize / 3];
        let pieces = [owner(open[0]), owner(self.sheet.twins[open[0] as usize])];
        let closed = if pieces[0] == pieces[1] {
            self.close(&open)?
        } else {
            let larger = if self.size(pieces[0]) < self.size(pieces[1]) { pieces[1] } else { pieces[0] };
            let open = self.seen_from(larger, open.clone());
            self.close(&open)?
        };
        if !closed && open.len() > 1 {
            let (one, other) = open.split_at(open.len() / 2);
            self.zip_chain(one.to_vec())?;
            self.zip_chain(other.to_vec())?;
        }
        Ok(())
    }
}
