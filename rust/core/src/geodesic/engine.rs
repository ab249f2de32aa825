//! The way to the rows of many sources: by the solver, bundle by bundle, or by sweeps over a prepared graph.

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

    /// Which sources are best asked for at once, by their numbers: those of a sweep in their order, others as they lie together;
    /// no more at once than leave work for so many threads.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    pub fn bundles(&self, sources: &[u32], threads: usize, control: &Control) -> Result<Vec<Vec<u32>>> {
        if self.sweep.is_none() {
            return self.solver.bundles(sources, threads, control);
        }
        let size = sweep::LANES.min(sources.len().div_ceil(threads)).max(1);
        let numbers: Vec<u32> = (0..sources.len() as u32).collect();
        Ok(numbers.chunks(size).map(<[u32]>::to_vec).collect())
    }

    /// Scratch for one worker.
    pub fn scratch(&self) -> EngineScratch<S::Scratch> {
        EngineScratch { solver: self.solver.scratch(), sweep: SweepScratch::default() }
    }

    /// What [`fill`](Self::fill) needs to know of the vertices to which distances are wanted.
    pub fn targets<'t>(&self, vertices: &'t [u32]) -> Targets<'t> {
        Targets { vertices, sweep: self.sweep.as_ref().map(|sweep| sweep.targets(vertices)) }
    }

    /// Writes the distances in mm from each source of a bundle to every vertex, or to the targets: a row a source; infinity where
    /// a vertex cannot be reached.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    ///
    /// # Panics
    /// If there is not one row a source.
    pub fn fill(
        &self,
        bundle: &[u32],
        targets: Option<&Targets<'_>>,
        rows: &mut [&mut [f32]],
        scratch: &mut EngineScratch<S::Scratch>,
        control: &Control,
    ) -> Result<()> {
        assert_eq!(rows.len(), bundle.len(), "one row a source");
        match &self.sweep {
            Some(sweep) => {
                let targets = targets.and_then(|targets| targets.sweep.as_ref());
                sweep.rows(bundle, targets, rows, &mut scratch.sweep, control)
            }
            None => {
                let targets = targets.map(|targets| targets.vertices);
                self.solver.rows(bundle, targets, rows, &mut scratch.solver, control)
            }
        }
    }
}
