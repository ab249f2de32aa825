//! A box of cells, and connected components in it.

use crate::volume::Mask;
use crate::{Control, Error, Result};

/// The number of steps between two checks for cancellation.
pub(super) const BATCH: usize = 1 << 12;

/// Checks for cancellation every [`BATCH`] steps.
#[inline]
pub(super) fn look(step: usize, control: &Control) -> Result<()> {
    if step.is_multiple_of(BATCH) { control.check() } else { Ok(()) }
}

/// A box of cells around the foreground, with a rim of background one cell wide.
#[derive(Debug)]
pub(super) struct Grid {
    pub(super) origin: [i64; 3],
    pub(super) shape: [usize; 3],
}

impl Grid {
    /// Creates the smallest box around voxels, with its rim.
    pub(super) fn around(voxels: impl Iterator<Item = [i64; 3]>, control: &Control) -> Result<Self> {
        let (mut low, mut high) = ([i64::MAX; 3], [i64::MIN; 3]);
        for (count, voxel) in voxels.enumerate() {
            look(count, control)?;
            low = std::array::from_fn(|axis| low[axis].min(voxel[axis]));
            high = std::array::from_fn(|axis| high[axis].max(voxel[axis]));
        }
        let shape = std::array::from_fn(|axis| (high[axis] - low[axis] + 3) as usize);
        let cells = shape.iter().try_fold(1usize, |product, &length| product.checked_mul(length));
        match cells {
            Some(cells) if u32::try_from(cells).is_ok() => Ok(Self { origin: low.map(|x| x - 1), shape }),
            _ => Err(Error::VolumeTooLarge { shape }),
        }
    }

    pub(super) fn len(&self) -> usize {
        self.shape.iter().product()
    }

    pub(super) fn strides(&self) -> [usize; 3] {
        [self.shape[1] * self.shape[2], self.shape[2], 1]
    }

    /// Returns the difference between the cells of two neighbours.
    pub(super) fn step(&self, offset: [i64; 3]) -> isize {
        (0..3).map(|axis| offset[axis] as isize * self.strides()[axis] as isize).sum()
    }

    /// Returns the cell of a voxel, if it lies in the box.
    pub(super) fn cell(&self, voxel: [i64; 3]) -> Option<usize> {
        let place: [i64; 3] = std::array::from_fn(|axis| voxel[axis] - self.origin[axis]);
        let fits = (0..3).all(|axis| (0..self.shape[axis] as i64).contains(&place[axis]));
        fits.then(|| (0..3).map(|axis| place[axis] as usize * self.strides()[axis]).sum())
    }

    pub(super) fn voxel(&self, cell: usize) -> [i64; 3] {
        std::array::from_fn(|axis| (cell / self.strides()[axis] % self.shape[axis]) as i64 + self.origin[axis])
    }

    /// Returns the index of an inner cell among the values of the volume.
    pub(super) fn index_in(&self, mask: &Mask, cell: usize) -> usize {
        let ([i, j, k], [_, nj, nk]) = (self.voxel(cell).map(|x| x as usize), mask.shape());
        (i * nj + j) * nk + k
    }

    /// Iterates over the cells outside the rim in order.
    pub(super) fn interior(&self) -> impl Iterator<Item = usize> {
        let [ni, nj, nk] = self.shape;
        let rows = (1..ni - 1).flat_map(move |i| (1..nj - 1).map(move |j| (i * nj + j) * nk));
        rows.flat_map(move |row| row + 1..row + nk - 1)
    }

    /// Returns the cells that are reached from a first one through cells to `enter` that are not yet `seen`.
    ///
    /// The rim needs no check: a step out of the box leads to the rim on its opposite side, or beyond all cells.
    pub(super) fn flood(
        &self, first: usize, offsets: &[[i64; 3]], enter: impl Fn(usize) -> bool, seen: &mut [bool], control: &Control,
    ) -> Result<Vec<usize>> {
        let steps: Vec<isize> = offsets.iter().map(|&offset| self.step(offset)).collect();
        let mut reached = vec![first];
        seen[first] = true;
        let mut next = 0;
        while let Some(&cell) = reached.get(next) {
            look(next, control)?;
            next += 1;
            for other in steps.iter().map(|&step| cell.wrapping_add_signed(step)) {
                if other < seen.len() && !seen[other] && enter(other) {
                    seen[other] = true;
                    reached.push(other);
                }
            }
        }
        Ok(reached)
    }

    /// Returns the connected components of a set of inner cells, in the order of their first cells.
    pub(super) fn pieces(
        &self, offsets: &[[i64; 3]], is_in: impl Fn(usize) -> bool, control: &Control,
    ) -> Result<Vec<Vec<usize>>> {
        let mut seen = vec![false; self.len()];
        let mut pieces = Vec::new();
        for (count, cell) in self.interior().enumerate() {
            look(count, control)?;
            if is_in(cell) && !seen[cell] {
                pieces.push(self.flood(cell, offsets, &is_in, &mut seen, control)?);
            }
        }
        Ok(pieces)
    }
}
