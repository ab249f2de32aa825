//! Straight ways through a label volume.

use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use crate::error::check_length;
use crate::volume::Mask;
use crate::{Control, Result};

/// The number of ways that one worker follows between two checks for cancellation.
const CHUNK: usize = 4096;

/// Ways from starts to ends, in mm.
#[derive(Debug, Clone, Copy)]
pub struct Ways<'a> {
    /// The first point of each way.
    pub starts: &'a [[f64; 3]],
    /// The last point of each way.
    pub ends: &'a [[f64; 3]],
    /// A distance from the start within which no voxel of the mask is expected.
    pub clear: &'a [f64],
    /// The distance from the start at which the mask is read first, and between later ones. Except for the first, they
    /// are at least that far from the end.
    pub step: f64,
}

impl Ways<'_> {
    /// Returns whether each way passes a voxel of a mask. `to_voxels` is the affine matrix from mm to voxels. Points
    /// outside the volume count as the nearest voxel.
    ///
    /// # Errors
    /// [`Error::WrongLength`](crate::Error::WrongLength) if the numbers of points differ, and
    /// [`Error::Cancelled`](crate::Error::Cancelled).
    pub fn pass(&self, mask: &Mask, to_voxels: &[[f64; 4]; 4], control: &Control) -> Result<Vec<bool>> {
        check_length("ends", self.ends.len(), "starts", self.starts.len())?;
        check_length("clear distances", self.clear.len(), "starts", self.starts.len())?;
        control.begin("following columns", self.starts.len().div_ceil(CHUNK) as u64);
        let linear = Matrix3::from_fn(|i, j| to_voxels[i][j]);
        let shift = Vector3::from_fn(|i, _| to_voxels[i][3]);
        let mut passed = vec![false; self.starts.len()];
        passed.par_chunks_mut(CHUNK).enumerate().try_for_each(|(chunk, passed)| {
            control.check()?;
            for (n, passed) in (chunk * CHUNK..).zip(passed) {
                let [start, end] = [self.starts[n], self.ends[n]].map(Vector3::from);
                let way = end - start;
                let length = way.norm();
                let direction = linear * (way / length.max(self.step));
                *passed = self.passes(mask, linear * start + shift, direction, length, self.clear[n]);
            }
            control.advance();
            Ok(())
        })?;
        Ok(passed)
    }

    /// Follows one way, which starts at `place` and moves by `direction` per mm, both in voxels.
    fn passes(&self, mask: &Mask, place: Vector3<f64>, direction: Vector3<f64>, length: f64, clear: f64) -> bool {
        let last = mask.shape().map(|n| n as f64 - 1.0);
        if length - self.step <= clear.max(0.0) {
            return false;
        }
        let mut distance = self.step;
        loop {
            if distance > clear {
                let voxel = (0..3).map(|a| (place[a] + distance * direction[a]).round_ties_even().clamp(0.0, last[a]));
                let [_, rows, columns] = mask.shape();
                let at = voxel.zip([rows * columns, columns, 1]).map(|(x, size)| x as usize * size).sum::<usize>();
                if mask.values()[at] {
                    return true;
                }
            }
            distance += self.step;
            if distance >= length - self.step {
                return false;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_way_passes_a_wall_between_its_ends() {
        let mask = Mask::from_fn([9, 4, 4], |[i, _, _]| i == 4).unwrap();
        let to_voxels = [[0.5, 0.0, 0.0, 1.0], [0.0, 0.5, 0.0, 0.0], [0.0, 0.0, 0.5, 0.0], [0.0, 0.0, 0.0, 1.0]];
        let starts = [[0.0; 3], [0.0; 3], [0.0; 3], [8.0, 0.0, 0.0], [0.0; 3], [2.0, 2.0, 2.0]];
        let ends = [[12.0, 2.0, 0.0], [4.0, 5.0, 5.0], [12.0, 0.0, 0.0], [14.0, 0.0, 0.0], [12.0, 0.0, 0.0], [2.0; 3]];
        let clear = [0.0, 0.0, 9.0, 0.0, 5.0, 0.0]; // the wall reaches from 5 to 7 mm
        let expected = [true, false, false, false, true, false];
        let ways = Ways { starts: &starts, ends: &ends, clear: &clear, step: 0.5 };
        let control = Control::default();
        assert_eq!(ways.pass(&mask, &to_voxels, &control).unwrap(), expected);
        assert!(Ways { clear: &[], ..ways }.pass(&mask, &to_voxels, &control).is_err());
        control.cancel();
        assert_eq!(ways.pass(&mask, &to_voxels, &control), Err(crate::Error::Cancelled));
    }
}
