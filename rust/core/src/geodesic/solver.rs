//! The common trait of all solvers. Every graph with [`Links`] implements it with single searches, or with
//! bundles for many sources.

use super::bundle::{self, BundleScratch};
use crate::adjacency::Links;
use crate::{Control, Result};

/// A geodesic solver computes rows: the distances from a source to every vertex.
pub trait Solver: Sync {
    /// Buffers of a worker that are reused for all rows.
    type Scratch: Send;

    /// Creates the buffers of a worker.
    fn scratch(&self) -> Self::Scratch;

    /// Returns the number of vertices, the length of a row.
    fn columns(&self) -> usize;

    /// Writes the distances in mm from `source` to every vertex; infinity where it cannot be reached.
    ///
    /// # Errors
    /// [`Error::Cancelled`](crate::Error::Cancelled), and others that a solver has.
    fn row(&self, source: u32, row: &mut [f32], scratch: &mut Self::Scratch, control: &Control) -> Result<()>;

    /// Writes the distances in mm from the nearest of several sources to every vertex; infinity where none can be reached.
    ///
    /// # Errors
    /// Those of [`row`](Self::row).
    fn nearest(&self, sources: &[u32], row: &mut [f32], scratch: &mut Self::Scratch, control: &Control) -> Result<()> {
        let mut one = vec![0.0; row.len()];
        row.fill(f32::INFINITY);
        for &source in sources {
            self.row(source, &mut one, scratch, control)?;
            row.iter_mut().zip(&one).for_each(|(least, &distance)| *least = least.min(distance));
        }
        Ok(())
    }

    /// Groups sources that are best computed together, by number, in enough groups for all threads; rows do not depend
    /// on it.
    ///
    /// # Errors
    /// [`Error::Cancelled`](crate::Error::Cancelled).
    fn bundles(&self, sources: &[u32], threads: usize, control: &Control) -> Result<Vec<Vec<u32>>> {
        let _ = (threads, control);
        Ok((0..sources.len() as u32).map(|number| vec![number]).collect())
    }

    /// Writes the distances in mm from the sources of a bundle to every vertex or the targets; infinity if unreachable.
    ///
    /// # Errors
    /// Those of [`row`](Self::row).
    fn rows(
        &self, bundle: &[u32], targets: Option<&[u32]>, rows: &mut [&mut [f32]], scratch: &mut Self::Scratch,
        control: &Control,
    ) -> Result<()> {
        let mut whole = Vec::new();
        for (&source, row) in bundle.iter().zip(rows) {
            let Some(targets) = targets else {
                self.row(source, row, scratch, control)?;
                continue;
            };
            whole.resize(self.columns(), 0.0);
            self.row(source, &mut whole, scratch, control)?;
            row.iter_mut().zip(targets).for_each(|(to, &target)| *to = whole[target as usize]);
        }
        Ok(())
    }

    /// Returns a hash of everything that distances depend on, the same on every machine.
    ///
    /// # Errors
    /// [`Error::Cancelled`](crate::Error::Cancelled).
    fn fingerprint(&self, control: &Control) -> Result<u64>;

    /// Returns whether distances are along the links of a [`GeodesicGraph`](super::graph::GeodesicGraph).
    fn is_along_straight_links(&self) -> bool {
        false
    }

    /// Returns whether distances are [marked](super::bend).
    fn tells_bends(&self) -> bool {
        false
    }
}

/// A hash of words: the same on every machine, and different for another order.
#[derive(Debug, Default)]
pub(crate) struct Fingerprint(u64);

impl Fingerprint {
    pub(crate) fn mix(&mut self, word: u64) {
        // multiplication by 2⁶⁴ over the golden ratio spreads every bit upwards (Knuth), and the shift brings it back
        self.0 = (self.0 ^ word).wrapping_mul(0x9e37_79b9_7f4a_7c15); // odd, so nothing is lost
        self.0 ^= self.0 >> 32;
    }

    pub(crate) fn finish(&self) -> u64 {
        self.0
    }
}

impl<G: Links> Solver for G {
    type Scratch = BundleScratch;

    fn scratch(&self) -> BundleScratch {
        BundleScratch::new(self)
    }

    fn columns(&self) -> usize {
        self.vertices()
    }

    fn row(&self, source: u32, row: &mut [f32], scratch: &mut BundleScratch, control: &Control) -> Result<()> {
        scratch.row(self, source, row, control)
    }

    fn nearest(&self, sources: &[u32], row: &mut [f32], scratch: &mut BundleScratch, control: &Control) -> Result<()> {
        scratch.nearest(self, sources, row, control)
    }

    fn bundles(&self, sources: &[u32], threads: usize, control: &Control) -> Result<Vec<Vec<u32>>> {
        bundle::bundles(self, sources, threads, control)
    }

    fn rows(
        &self, bundle: &[u32], targets: Option<&[u32]>, rows: &mut [&mut [f32]], scratch: &mut BundleScratch,
        control: &Control,
    ) -> Result<()> {
        scratch.rows(self, bundle, targets, rows, control)
    }

    fn is_along_straight_links(&self) -> bool {
        self.are_straight()
    }

    fn fingerprint(&self, control: &Control) -> Result<u64> {
        let mut hash = Fingerprint::default();
        hash.mix(self.vertices() as u64);
        for vertex in 0..self.vertices() as u32 {
            if vertex.is_multiple_of(4096) {
                control.check()?;
            }
            hash.mix(u64::from(vertex));
            self.arcs(vertex).for_each(|arc| hash.mix(u64::from(arc.to) << 32 | u64::from(arc.length.to_bits())));
        }
        Ok(hash.finish())
    }
}
