//! Connected components by runs of cells, of which there are a hundred times fewer than cells.

use super::grid::look;
use crate::adjacency::Sets;
use crate::{Control, Error, Result};

/// The previous rows to which a row connects, and the gap in cells at which two runs there still touch.
pub(super) type Touch = &'static [([i64; 2], usize)];

/// Connectivity through faces.
pub(super) const FACES: Touch = &[([-1, 0], 0), ([0, -1], 0)];

/// Connectivity through faces and edges.
pub(super) const EDGES: Touch = &[([-1, -1], 0), ([-1, 0], 1), ([-1, 1], 0), ([0, -1], 1)];

/// The runs of a set of cells along the last axis, in order, with their connected components.
#[derive(Debug)]
pub(super) struct Runs {
    /// The first cell of each run, and the one after its last.
    runs: Vec<[usize; 2]>,
    /// For each run, the first run of its component.
    component: Vec<u32>,
}

impl Runs {
    pub(super) fn of(
        [ni, nj, nk]: [usize; 3], is_in: impl Fn(usize) -> bool, touch: Touch, control: &Control,
    ) -> Result<Self> {
        let mut runs: Vec<[usize; 2]> = Vec::new();
        let mut rows = vec![0];
        for row in 0..ni * nj {
            look(row, control)?;
            let mut inside = false;
            for cell in row * nk..(row + 1) * nk {
                if is_in(cell) != inside {
                    inside = !inside;
                    match runs.last_mut() {
                        Some(run) if !inside => run[1] = cell,
                        _ => runs.push([cell, (row + 1) * nk]),
                    }
                }
            }
            rows.push(runs.len());
        }
        if u32::try_from(runs.len()).is_err() {
            return Err(Error::VolumeTooLarge { shape: [ni, nj, nk] });
        }
        let mut sets = Sets::new(runs.len());
        for row in 0..ni * nj {
            look(row, control)?;
            for &([di, dj], reach) in touch {
                let (i, j) = ((row / nj) as i64 + di, (row % nj) as i64 + dj);
                if i < 0 || !(0..nj as i64).contains(&j) {
                    continue;
                }
                let before = i as usize * nj + j as usize;
                let apart = (row - before) * nk;
                let (mut one, mut other) = (rows[before], rows[row]);
                while one < rows[before + 1] && other < rows[row + 1] {
                    let ([a, b], [c, d]) = (runs[one].map(|cell| cell + apart), runs[other]);
                    if a < d + reach && c < b + reach {
                        sets.join(one as u32, other as u32);
                    }
                    if b <= d {
                        one += 1;
                    } else {
                        other += 1;
                    }
                }
            }
        }
        let component = (0..runs.len() as u32).map(|run| sets.find(run)).collect();
        Ok(Self { runs, component })
    }

    /// Returns the runs of the component whose first run is `first`.
    pub(super) fn component(&self, first: u32) -> impl Iterator<Item = std::ops::Range<usize>> {
        let own = self.runs.iter().zip(&self.component).filter(move |&(_, &component)| component == first);
        own.map(|(&[from, to], _)| from..to)
    }

    /// Returns the number of cells of the component that begins with each run; 0 for runs within a component.
    pub(super) fn sizes(&self) -> Vec<usize> {
        let mut cells = vec![0; self.runs.len()];
        for ([from, to], &component) in self.runs.iter().zip(&self.component) {
            cells[component as usize] += to - from;
        }
        cells
    }

    /// Returns the first run of the component with the most cells, the first of equal ones.
    pub(super) fn largest(&self) -> Option<u32> {
        let sizes = self.sizes();
        (0..sizes.len() as u32).rev().max_by_key(|&run| sizes[run as usize])
    }
}
