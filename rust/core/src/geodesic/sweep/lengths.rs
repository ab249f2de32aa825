//! Symmetric tables of lengths in whole numbers, and the two passes of a contraction over them.
//!
//! A table holds its lower triangle, row by row. The inner loops are plain loops over slices, compiled for the widest
//! instructions that the machine has; whole numbers make the result the same with all of them.

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use crate::control::Control;
use crate::error::Result;

/// The length of what is not linked. Twice as much is still a number.
pub(super) const FAR: i32 = i32::MAX / 2;

/// Rows that are worked on together, so that each other row is read once for all of them.
const TOGETHER: usize = 8;

/// Rows that one task lowers.
const ROWS: usize = 32;

/// The rows of a lower triangle without the diagonal, from some row on.
#[derive(Debug)]
pub(super) struct LengthTable {
    /// The first row, which has as many columns.
    first: usize,
    /// Number of the row behind the last.
    size: usize,
    lengths: Vec<i32>,
}

/// Lengths in the rows before this one.
fn before(row: usize) -> usize {
    row * row.saturating_sub(1) / 2
}

impl LengthTable {
    /// Of so many vertices, none linked.
    pub fn new(size: usize) -> Self {
        Self { first: 0, size, lengths: vec![FAR; before(size)] }
    }

    /// The table of so many vertices, the first of which have the lengths of the chosen vertices of another table.
    pub fn selected(from: &Self, chosen: &[usize], size: usize) -> Self {
        let mut table = Self { first: 0, size, lengths: Vec::with_capacity(before(size)) };
        for (row, &chosen_row) in chosen.iter().enumerate() {
            let source = from.row(chosen_row);
            table.lengths.extend(chosen[..row].iter().map(|&column| source[column]));
        }
        table.lengths.resize(before(size), FAR);
        table
    }

    /// The lengths of a row to all vertices before it.
    fn row(&self, row: usize) -> &[i32] {
        let start = before(row) - before(self.first);
        &self.lengths[start..start + row]
    }

    /// Lowers one length.
    pub fn lower(&mut self, row: usize, column: usize, length: i32) {
        let start = before(row) - before(self.first);
        let known = &mut self.lengths[start + column];
        *known = length.min(*known);
    }

    /// Lowers the lengths of the vertices `at` to those of another table.
    pub fn lower_by(&mut self, other: &Self, at: &[usize]) {
        for (from, &row) in at.iter().enumerate() {
            let start = before(row);
            let known = &mut self.lengths[start..start + row];
            for (&length, &column) in other.row(from).iter().zip(at) {
                known[column] = known[column].min(length);
            }
        }
    }

    /// Takes the rows from `row` on out.
    pub fn split_off(&mut self, row: usize) -> Self {
        let lengths = self.lengths.split_off(before(row));
        self.lengths.shrink_to_fit();
        let rows = Self { first: row, size: self.size, lengths };
        self.size = row;
        rows
    }

    /// Takes vertices out from the last down to `keep`: what is left before each is lowered to the ways through it.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    pub fn eliminate(&mut self, keep: usize, control: &Control) -> Result<()> {
        let mut end = self.size;
        while end > keep {
            control.check()?;
            let start = end.saturating_sub(TOGETHER).max(keep);
            let (rest, pivots) = self.lengths.split_at_mut(before(start));
            let pivots = &mut pivots[..before(end) - before(start)];
            let at = |row: usize| before(row) - before(start);
            for pivot in (start..end).rev() {
                let (others, through) = pivots.split_at_mut(at(pivot));
                for row in start..pivot {
                    lower_row(&mut others[at(row)..at(row) + row], through[row], &through[..row]);
                }
            }
            let through: [&[i32]; TOGETHER] = std::array::from_fn(|n| {
                let row = (start + n).min(end - 1);
                &pivots[at(row)..at(row) + row]
            });
            let tasks: Vec<LowerRows> =
                chunks(rest, start).map(|(first, rows)| LowerRows { first, rows, through }).collect();
            if tasks.len() > 4 {
                tasks.into_par_iter().for_each(|task| Arch::new().dispatch(task));
            } else {
                tasks.into_iter().for_each(|task| Arch::new().dispatch(task));
            }
            end = start;
        }
        Ok(())
    }

    /// Fills the rows from `known` on with distances, one after the other. `rows` holds the lengths of the ways from each
    /// vertex to those before it that pass none of them; all distances among the rows before are known. Calls `needed` with
    /// the columns and lengths of each row that no two other ones replace.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`].
    pub fn settle(
        &mut self,
        known: usize,
        rows: &Self,
        control: &Control,
        mut needed: impl FnMut(usize, &mut dyn Iterator<Item = (usize, i32)>),
    ) -> Result<()> {
        let mut start = known;
        while start < self.size {
            control.check()?;
            let end = (start + TOGETHER).min(self.size);
            let ways: [&[i32]; TOGETHER] = std::array::from_fn(|n| rows.row((start + n).min(end - 1)));
            let (settled, open) = self.lengths.split_at_mut(before(start));
            let mut best: Vec<Vec<i32>> = ways.iter().map(|way| vec![FAR; way.len()]).collect();
            Arch::new().dispatch(PassThrough { settled, end: start, best: &mut best, ways });
            let mut open = &mut open[..before(end) - before(start)];
            let mut done: Vec<&[i32]> = Vec::with_capacity(TOGETHER);
            for row in start..end {
                let (best, way) = (&mut best[row - start], ways[row - start]);
                for (middle, distances) in (start..).zip(&done) {
                    through(best, way, middle, distances);
                }
                let is_needed =
                    |(column, (&length, &other)): (usize, (&i32, &i32))| (length < other).then_some((column, length));
                needed(row, &mut way.iter().zip(&*best).enumerate().filter_map(is_needed));
                let (this, behind) = open.split_at_mut(row);
                for ((distance, &length), &other) in this.iter_mut().zip(way).zip(&*best) {
                    *distance = length.min(other);
                }
                done.push(this);
                open = behind;
            }
            start = end;
        }
        Ok(())
    }
}

/// Splits the rows before `end` of a lower triangle into pieces of whole rows, each with the number of its first row.
fn chunks(mut lengths: &mut [i32], end: usize) -> impl Iterator<Item = (usize, &mut [i32])> {
    (0..end).step_by(ROWS).map(move |first| {
        let behind = (first + ROWS).min(end);
        let (rows, rest) = std::mem::take(&mut lengths).split_at_mut(before(behind) - before(first));
        lengths = rest;
        (first, rows)
    })
}

/// Lowers rows to the ways through some vertices behind them.
struct LowerRows<'a> {
    first: usize,
    rows: &'a mut [i32],
    through: [&'a [i32]; TOGETHER],
}

impl WithSimd for LowerRows<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { first: mut row, rows: mut rest, through } = self;
        while !rest.is_empty() || row == 0 {
            let (this, behind) = rest.split_at_mut(row);
            lower_row_by_all(this, through, row);
            (rest, row) = (behind, row + 1);
        }
    }
}

/// Lowers the lengths `best` of several vertices' ways over a table's vertices.
struct PassThrough<'a> {
    settled: &'a [i32],
    end: usize,
    best: &'a mut [Vec<i32>],
    ways: [&'a [i32]; TOGETHER],
}

impl WithSimd for PassThrough<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let mut rest = self.settled;
        for middle in 0..self.end {
            let (distances, behind) = rest.split_at(middle);
            for (best, way) in self.best.iter_mut().zip(self.ways) {
                through(best, way, middle, distances);
            }
            rest = behind;
        }
    }
}

#[inline(always)]
fn lower_row(row: &mut [i32], first: i32, through: &[i32]) {
    for (length, &second) in row.iter_mut().zip(through) {
        *length = (*length).min(first + second);
    }
}

#[inline(always)]
fn lower_row_by_all(this: &mut [i32], through: [&[i32]; TOGETHER], row: usize) {
    let [a, b, c, d, e, f, g, h] = through;
    let first = [a[row], b[row], c[row], d[row], e[row], f[row], g[row], h[row]];
    let [a, b, c, d, e, f, g, h] =
        [&a[..row], &b[..row], &c[..row], &d[..row], &e[..row], &f[..row], &g[..row], &h[..row]];
    let this = &mut this[..row];
    for n in 0..row {
        let low = (first[0] + a[n]).min(first[1] + b[n]).min((first[2] + c[n]).min(first[3] + d[n]));
        let high = (first[4] + e[n]).min(first[5] + f[n]).min((first[6] + g[n]).min(first[7] + h[n]));
        this[n] = this[n].min(low.min(high));
    }
}

/// Lowers `best` to the ways over one vertex in the middle, whose distances to those before it are given, in both
/// directions: from the middle to those, and from those to the middle.
#[inline(always)]
fn through(best: &mut [i32], way: &[i32], middle: usize, distances: &[i32]) {
    let first = way[middle];
    let mut least = best[middle];
    for ((best, &length), &distance) in best[..middle].iter_mut().zip(&way[..middle]).zip(&distances[..middle]) {
        *best = (*best).min(first + distance);
        least = least.min(length + distance);
    }
    best[middle] = least;
}

/// Where the members of one ascending list are in another that holds them.
pub(super) fn merge(members: &[u32], list: &[u32]) -> Vec<usize> {
    let mut at = 0;
    let find = |&member: &u32| {
        while list[at] != member {
            at += 1;
        }
        at
    };
    members.iter().map(find).collect()
}
