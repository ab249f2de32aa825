//! Rows of exact distances.

use super::Exact;
use super::wave::Wave;
use crate::error::{check_length, check_points};
use crate::geodesic::solver::{Fingerprint, Solver};
use crate::{Control, Result};

impl Exact<'_> {
    /// Writes the distances in mm from `source` to every vertex; infinity where it cannot be reached. `wave` then also
    /// knows the [paths](Self::path).
    ///
    /// # Errors
    /// [`Error::NoSuchPoint`](crate::Error::NoSuchPoint) for the source, [`Error::WrongLength`](crate::Error::WrongLength)
    /// if `row` does not have one value per vertex, and [`Error::Cancelled`](crate::Error::Cancelled).
    pub fn distances(&self, source: u32, row: &mut [f64], wave: &mut Wave, control: &Control) -> Result<()> {
        check_points([source], self.surface.len())?;
        check_length("values of the row", row.len(), "vertices", self.surface.len())?;
        wave.run(self, source, control)?;
        row.copy_from_slice(&wave.distance);
        Ok(())
    }
}

impl Solver for Exact<'_> {
    type Scratch = Wave;

    fn scratch(&self) -> Wave {
        Wave::new(self)
    }

    fn columns(&self) -> usize {
        self.surface.len()
    }

    fn row(&self, source: u32, row: &mut [f32], wave: &mut Wave, control: &Control) -> Result<()> {
        wave.run(self, source, control)?;
        row.iter_mut().zip(&wave.distance).for_each(|(value, &distance)| *value = distance as f32);
        Ok(())
    }

    fn fingerprint(&self, control: &Control) -> Result<u64> {
        control.check()?;
        let mut hash = Fingerprint::default();
        let coordinates = self.surface.points().iter().flat_map(|point| point.iter());
        coordinates.for_each(|coordinate| hash.mix(coordinate.to_bits()));
        self.surface.faces().iter().flatten().for_each(|&vertex| hash.mix(u64::from(vertex)));
        hash.mix(self.reach.mm.to_bits());
        hash.mix(self.reach.rings.map_or(0, |rings| 1 + u64::from(rings)));
        Ok(hash.finish())
    }
}
