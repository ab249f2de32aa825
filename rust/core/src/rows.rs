//! Distance rows: the distances from many sources, computed in parallel. In memory here, on disk in [`crate::store`].

use rayon::prelude::*;

use crate::control::Control;
use crate::error::{Error, Result};
use crate::geodesic::Solver;

/// Distance rows, wherever they are kept.
pub trait Rows {
    /// The vertices from which distances were measured.
    fn sources(&self) -> &[u32];

    /// Length of a row.
    fn columns(&self) -> usize;

    /// How many rows are visited at a time.
    fn block_rows(&self) -> usize;

    /// Passes all rows on, in the order of the sources: `visit(n, rows)` gets whole rows from the n-th on, one after the
    /// other.
    ///
    /// # Errors
    /// Those of `visit`, and of reading.
    fn visit(&self, control: &Control, visit: &mut dyn FnMut(usize, &[f32]) -> Result<()>) -> Result<()>;

    /// The columns of the sources only.
    ///
    /// # Errors
    /// Those of reading.
    ///
    /// # Panics
    /// If the rows do not reach to every source.
    fn among(&self, control: &Control) -> Result<DistanceRows> {
        let sources = self.sources();
        let mut data = Vec::with_capacity(sources.len() * sources.len());
        self.visit(control, &mut |_, rows| {
            for row in rows.chunks(self.columns().max(1)) {
                data.extend(sources.iter().map(|&column| row[column as usize]));
            }
            Ok(())
        })?;
        Ok(DistanceRows::new(sources.to_vec(), sources.len(), data))
    }
}

/// Distances from sources to columns, in mm.
#[derive(Debug, Clone, PartialEq)]
pub struct DistanceRows {
    sources: Vec<u32>,
    columns: usize,
    data: Vec<f32>,
}

impl DistanceRows {
    /// Rows from every source to every vertex.
    ///
    /// # Errors
    /// [`Error::Unreachable`] if a vertex lies in another component, [`Error::Cancelled`].
    pub fn compute<S: Solver>(solver: &S, sources: &[u32], control: &Control) -> Result<Self> {
        let columns = solver.columns();
        let mut data = vec![0.0; sources.len() * columns];
        control.begin("measuring distances", sources.len() as u64);
        data.par_chunks_mut(columns.max(1)).zip(sources).try_for_each_init(
            || solver.scratch(),
            |scratch, (row, &source)| {
                solver.row(source, row, scratch, control)?;
                reachable(row, source)?;
                control.advance();
                Ok(())
            },
        )?;
        Ok(Self::new(sources.to_vec(), columns, data))
    }

    /// The distances among the sources only; whole rows exist one a thread at a time.
    ///
    /// # Errors
    /// As [`DistanceRows::compute`].
    pub fn among_sources<S: Solver>(solver: &S, sources: &[u32], control: &Control) -> Result<Self> {
        let columns = sources.len();
        let mut data = vec![0.0; columns * columns];
        control.begin("measuring distances", columns as u64);
        data.par_chunks_mut(columns.max(1)).zip(sources).try_for_each_init(
            || (solver.scratch(), vec![0.0; solver.columns()]),
            |(scratch, whole), (row, &source)| {
                solver.row(source, whole, scratch, control)?;
                reachable(whole, source)?;
                row.iter_mut().zip(sources).for_each(|(to, &column)| *to = whole[column as usize]);
                control.advance();
                Ok(())
            },
        )?;
        Ok(Self::new(sources.to_vec(), columns, data))
    }

    /// Rows that are known already, of `columns` distances each, one after the other.
    ///
    /// # Panics
    /// If there is not one row a source.
    pub fn new(sources: Vec<u32>, columns: usize, data: Vec<f32>) -> Self {
        assert_eq!(data.len(), sources.len() * columns, "one row a source");
        Self { sources, columns, data }
    }

    /// The vertices from which distances were measured.
    pub fn sources(&self) -> &[u32] {
        &self.sources
    }

    /// Length of a row.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// The distances from the n-th source.
    pub fn row(&self, n: usize) -> &[f32] {
        &self.data[n * self.columns..(n + 1) * self.columns]
    }

    /// All rows, one after the other.
    pub fn into_data(self) -> Vec<f32> {
        self.data
    }
}

impl Rows for DistanceRows {
    fn sources(&self) -> &[u32] {
        &self.sources
    }

    fn columns(&self) -> usize {
        self.columns
    }

    fn block_rows(&self) -> usize {
        self.sources.len()
    }

    fn visit(&self, _: &Control, visit: &mut dyn FnMut(usize, &[f32]) -> Result<()>) -> Result<()> {
        visit(0, &self.data)
    }
}

/// Fails where a distance is infinite.
pub(crate) fn reachable(row: &[f32], source: u32) -> Result<()> {
    match row.iter().position(|distance| distance.is_infinite()) {
        Some(vertex) => Err(Error::Unreachable { source_vertex: source as usize, vertex }),
        None => Ok(()),
    }
}
