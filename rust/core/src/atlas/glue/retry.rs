//! Cuts that remain after uniting pieces are tried again, in parts.

use super::layout::Chain;
use super::seams::{BRIEFLY, Gluing};
use crate::Result;

/// The maximum number of rounds over all cuts.
const ROUNDS: usize = 16;

/// A round that closes less than this share of the seams is the last.
const LITTLE: f64 = 5e-4;

impl Gluing<'_> {
    /// Tries to close the remaining cuts, in parts if they cannot be closed completely.
    pub fn retry(&mut self) -> Result<()> {
        let seams: f64 =
            self.layout.seams.iter().zip(&self.layout.lengths).filter(|(seam, _)| **seam).map(|(_, l)| l).sum();
        for _ in 0..ROUNDS {
            let before = self.cut_length();
            let mut chains = self.all_chains();
            self.longest_first(&mut chains);
            self.control.begin("closing seams", chains.len() as u64);
            for chain in chains {
                self.retry_chain(chain)?;
                self.control.advance();
            }
            self.finish(BRIEFLY, 1)?;
            if before - self.cut_length() < LITTLE * seams {
                break;
            }
        }
        Ok(())
    }

    fn all_chains(&self) -> Vec<Chain> {
        let cuts = (0..self.layout.twins.len() as u32).filter(|&side| self.layout.is_cut(side));
        let owner = |side: u32| self.layout.piece[side as usize / 3];
        let mut keyed: Vec<([u32; 2], u32)> =
            cuts.map(|side| ([owner(side), owner(self.layout.twins[side as usize])], side)).collect();
        keyed.retain(|([a, b], _)| a <= b);
        keyed.sort_unstable();
        let between = keyed.chunk_by(|p, q| p.0 == q.0).map(|few| few.iter().map(|&(_, side)| side).collect());
        between.flat_map(|sides| self.layout.chained(sides)).collect()
    }

    /// Returns the length of all cuts, counted from both sides, in mm.
    pub fn cut_length(&self) -> f64 {
        let cuts = (0..self.layout.twins.len() as u32).filter(|&side| self.layout.is_cut(side));
        cuts.map(|side| self.layout.lengths[side as usize]).sum()
    }

    fn retry_chain(&mut self, chain: Chain) -> Result<()> {
        let open: Vec<u32> = chain.into_iter().filter(|&side| self.layout.is_cut(side)).collect();
        if open.is_empty() {
            return Ok(());
        }
        let owner = |side: u32| self.layout.piece[side as usize / 3];
        let pieces = [owner(open[0]), owner(self.layout.twins[open[0] as usize])];
        let closed = if pieces[0] == pieces[1] {
            self.close(&open)?
        } else {
            let larger = if self.size(pieces[0]) < self.size(pieces[1]) { pieces[1] } else { pieces[0] };
            let open = self.seen_from(larger, open.clone());
            self.close(&open)?
        };
        if !closed && open.len() > 1 {
            let (one, other) = open.split_at(open.len() / 2);
            self.retry_chain(one.to_vec())?;
            self.retry_chain(other.to_vec())?;
        }
        Ok(())
    }
}
