//! Closing of seams within the bound and without overlap.

use std::collections::HashSet;

use super::border::meets_itself;
use super::layout::{Chain, Layout};
use super::settle::Around;
use crate::embed::stress::descent::Until;
use crate::{Control, Result};

/// The numbers of rings of places around a seam that are moved to close it: first few, then more.
const RINGS: [usize; 3] = [2, 6, 15];

/// The number of steps that reduce distortion after a seam is closed.
const STEPS: usize = 6;

/// Wider gaps, in lengths of a side, are not closed.
const WIDE: f64 = 10.0;

/// A piece is relaxed as a whole when it has grown by this factor since the last time.
const GROWN: f64 = 1.3;

/// The intermediate optimisation of a complete piece.
pub(super) const BRIEFLY: Until = Until { steps: 20, gain: 1e-3, enough: 1e-16 };

/// The reason for a cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Obstacle {
    /// Triangles would exceed the bound.
    Bound,
    /// The piece would overlap itself.
    Overlap,
}

/// Patches during gluing.
pub(super) struct Gluing<'a> {
    pub layout: Layout<'a>,
    /// Why each side was not closed in the last attempt.
    pub reasons: Vec<Option<Obstacle>>,
    /// The length of each piece's boundary in mm.
    pub(super) boundaries: Vec<f64>,
    bound: f64,
    /// The number of facets of each piece when it was last relaxed.
    relaxed: Vec<usize>,
    pub(super) control: &'a Control,
}

impl<'a> Gluing<'a> {
    /// Starts gluing from pieces that are within the bound.
    pub fn new(layout: Layout<'a>, bound: f64, control: &'a Control) -> Self {
        let relaxed = layout.members.iter().map(Vec::len).collect();
        let boundaries = (0..layout.members.len() as u32).map(|piece| layout.boundary(piece)).collect();
        Self { reasons: vec![None; layout.twins.len()], layout, boundaries, bound, relaxed, control }
    }

    pub(super) fn size(&self, piece: u32) -> usize {
        self.layout.members[piece as usize].len()
    }

    pub(super) fn longest_first(&self, chains: &mut [Chain]) {
        chains.sort_by(|p, q| self.layout.length(q).total_cmp(&self.layout.length(p)).then(p[0].cmp(&q[0])));
    }

    /// Returns the chain as sides of a piece.
    pub(super) fn seen_from(&self, piece: u32, chain: Chain) -> Chain {
        if self.layout.piece[chain[0] as usize / 3] == piece {
            return chain;
        }
        chain.iter().rev().map(|&side| self.layout.twins[side as usize]).collect()
    }

    /// Closes all of the given cuts, if this is possible within the bound and without overlap. The cuts of two pieces
    /// are sides of the larger one; the smaller one is placed beside it.
    pub(super) fn close(&mut self, cuts: &[u32]) -> Result<bool> {
        self.control.check()?;
        let owner = |side: u32| self.layout.piece[side as usize / 3];
        let pieces = [owner(cuts[0]), owner(self.layout.twins[cuts[0] as usize])];
        let is_one = pieces[0] == pieces[1];
        if !is_one {
            let (turn, shift) = self.layout.fit(cuts);
            self.layout.place_rigidly(pieces[1], turn, shift);
        }
        let too_wide = cuts.iter().any(|&side| self.layout.gap(side) > WIDE * self.layout.lengths[side as usize]);
        let reason = if too_wide { Some(Obstacle::Bound) } else { self.closed(cuts, pieces)? };
        for &side in cuts {
            self.reasons[side as usize] = reason;
            self.reasons[self.layout.twins[side as usize] as usize] = reason;
        }
        if reason.is_none() && !is_one {
            self.layout.unite(pieces[0], pieces[1]);
        }
        Ok(reason.is_none())
    }

    /// Joins cuts and optimises their surroundings; returns the obstacle if this fails.
    fn closed(&mut self, cuts: &[u32], pieces: [u32; 2]) -> Result<Option<Obstacle>> {
        let joined = self.layout.join(cuts);
        let mut reason = Obstacle::Bound;
        for rings in RINGS {
            let around = Around::new(&self.layout, &joined.at, rings, self.control)?;
            if let Some(before) = around.settle(&mut self.layout, self.bound, STEPS, self.control)? {
                let free: HashSet<u32> = around.free.iter().copied().collect();
                let layout = &self.layout;
                let is_beyond = |place: u32| pieces[0] != pieces[1] && layout.piece[place as usize / 3] == pieces[1];
                let moved = |place: u32| free.contains(&place) || is_beyond(place);
                let all = if pieces[0] == pieces[1] { &pieces[..1] } else { &pieces[..] };
                if !meets_itself(layout, all, &moved, self.control)? {
                    return Ok(None);
                }
                around.write(&mut self.layout, &before);
                reason = Obstacle::Overlap;
                break;
            }
            if around.is_all {
                break;
            }
        }
        self.layout.part(joined);
        Ok(Some(reason))
    }

    /// Relaxes a piece that is much larger than when it was last relaxed.
    pub(super) fn relax_if_grown(&mut self, piece: u32) -> Result<()> {
        if (self.size(piece) as f64) < GROWN * self.relaxed[piece as usize] as f64 {
            return Ok(());
        }
        self.relax(piece, BRIEFLY, 1)
    }

    /// Reduces the distortion of a complete piece, as long as it does not overlap itself.
    pub fn relax(&mut self, piece: u32, until: Until, times: usize) -> Result<()> {
        self.relaxed[piece as usize] = self.size(piece);
        let corners = self.layout.members[piece as usize].iter().flat_map(|&facet| 3 * facet..3 * facet + 3);
        let mut places: Vec<u32> = corners.filter(|&corner| self.layout.place[corner as usize] == corner).collect();
        places.sort_unstable();
        let around = Around::new(&self.layout, &places, 0, self.control)?;
        for _ in 0..times {
            let before: Vec<_> = places.iter().map(|&place| self.layout.uv[place as usize]).collect();
            let converged = around.relax(&mut self.layout, self.bound, until, self.control)?;
            if !around.is_sound(&self.layout, self.bound)
                || meets_itself(&self.layout, &[piece], &|_| true, self.control)?
            {
                around.write(&mut self.layout, &before);
                break;
            }
            if converged {
                break;
            }
        }
        Ok(())
    }

    /// Minimises the distortion of every piece.
    pub fn finish(&mut self, until: Until, times: usize) -> Result<()> {
        self.control.begin("relaxing pieces", self.layout.members.len() as u64);
        for piece in 0..self.layout.members.len() as u32 {
            if self.size(piece) > 0 {
                self.relax(piece, until, times)?;
            }
            self.control.advance();
        }
        Ok(())
    }
}
