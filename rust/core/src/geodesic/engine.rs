//! The way to the rows of many sources: one search after the other, or sweeps over a prepared graph.

use super::solver::Solver;
use super::sweep::{self, Sweep, SweepScratch, SweepTargets};
use crate::control::Control;
use crate::error::Result;

/// A solver with what was prepared for the number of its sources.
///
/// A row is the same, bit by bit, in whatever block it is asked for. Which way is taken depends on the solver, on the number
/// of sources and on the memory for which the engine was made; the two ways differ by rounding only.
#[derive(Debug)]
pub struct Engine<'a, S> {
    solver: &'a S,
    sweep: Option<Sweep>,
}

/// What a worker keeps from one block to the next.
#[derive(Debug)]
pub struct EngineScratch<T> {
    solver: T,
    sweep: SweepScratch,
    row: Vec<f32>,
}

/// Vertices to which distances are wanted.
#[derive(Debug)]
pub struct Targets<'a> {
    vertices: &'a [u32],
    sweep: Option<SweepTargets>,
}

impl<'a, S: Solver> Engine<'a, S> {
    /// The faster way to the rows of so many sources, prepared in as much memory as these rows take.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    pub fn new(solver: &'a S, sources: usize, control: &Control) -> Result<Self> {
        Self::within(4 * sources as u64 * solver.columns() as u64, solver, sources, control)
    }

    /// The faster way to the rows of so many sources, prepared in so many bytes of memory.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    pub fn within(bytes: u64, solver: &'a S, sources: usize, control: &Control) -> Result<Self> {
        Ok(Self { solver, sweep: solver.sweep(sources, bytes, control)? })
    }

    /// The solver.
    pub fn solver(&self) -> &'a S {
        self.solver
    }

    /// Would an engine for so many sources, no more than this one was made for, go the same way? Then its rows are the same, bit
    /// by bit.
    pub fn goes_as_for(&self, sources: usize) -> bool {
        let bytes = 4 * sources as u64 * self.columns() as u64;
        self.sweep.as_ref().is_none_or(|sweep| sweep.pays(sources, bytes))
    }

    /// Number of vertices, the length of a row.
    pub fn columns(&self) -> usize {
        self.solver.columns()
    }

    /// How many rows are best asked for at once.
    pub fn block(&self) -> usize {
        if self.sweep.is_some() { sweep::LANES } else { 1 }
    }

    /// Scratch for one worker.
    pub fn scratch(&self) -> EngineScratch<S::Scratch> {
        EngineScratch { solver: self.solver.scratch(), sweep: SweepScratch::default(), row: Vec::new() }
    }

    /// Writes the distances in mm from each source to every vertex, one row after the other; infinity where a vertex cannot
    /// be reached.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    ///
    /// # Panics
    /// If `rows` has not one row a source.
    pub fn fill(
        &self,
        sources: &[u32],
        rows: &mut [f32],
        scratch: &mut EngineScratch<S::Scratch>,
        control: &Control,
    ) -> Result<()> {
        assert_eq!(rows.len(), sources.len() * self.columns(), "one row a source");
        if let Some(sweep) = &self.sweep {
            return sweep.rows(sources, None, rows, &mut scratch.sweep, control);
        }
        for (&source, row) in sources.iter().zip(rows.chunks_exact_mut(self.columns().max(1))) {
            self.solver.row(source, row, &mut scratch.solver, control)?;
        }
        Ok(())
    }

    /// What [`fill_targets`](Self::fill_targets) needs to know of the vertices to which distances are wanted.
    pub fn targets<'t>(&self, vertices: &'t [u32]) -> Targets<'t> {
        Targets { vertices, sweep: self.sweep.as_ref().map(|sweep| sweep.targets(vertices)) }
    }

    /// As [`fill`](Self::fill), with the columns of the targets only; where the graph was prepared, whole rows never exist.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    ///
    /// # Panics
    /// If `rows` has not one row a source.
    pub fn fill_targets(
        &self,
        sources: &[u32],
        targets: &Targets<'_>,
        rows: &mut [f32],
        scratch: &mut EngineScratch<S::Scratch>,
        control: &Control,
    ) -> Result<()> {
        assert_eq!(rows.len(), sources.len() * targets.vertices.len(), "one row a source");
        if let (Some(sweep), Some(targets)) = (&self.sweep, &targets.sweep) {
            return sweep.rows(sources, Some(targets), rows, &mut scratch.sweep, control);
        }
        scratch.row.resize(self.columns(), 0.0);
        for (&source, row) in sources.iter().zip(rows.chunks_exact_mut(targets.vertices.len().max(1))) {
            self.solver.row(source, &mut scratch.row, &mut scratch.solver, control)?;
            row.iter_mut().zip(targets.vertices).for_each(|(to, &vertex)| *to = scratch.row[vertex as usize]);
        }
        Ok(())
    }
}
