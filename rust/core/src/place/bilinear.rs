//! Bilinear placement on a range image (Zigelman, Kimmel, Kiryati 2002, sections IV and VI).
//!
//! The sources are the pixels on a lattice of rows and columns. The position of a pixel in the map is interpolated
//! between the four sources of its cell in the image. A cell beside a hole or the outline can lack a source. There, the
//! nearest complete cell is extrapolated. The paper's images are full rectangles, in which this does not occur.

use std::collections::VecDeque;

use crate::{Control, Error, Result};

/// The number of pixels between two checks for cancellation.
const BATCH: usize = 1 << 14;

/// A lattice of rows and columns of an image, and the vertices of its pixels.
#[derive(Debug, Clone)]
pub(crate) struct Lattice<'a> {
    pixels: &'a [[u32; 2]],
    rows: Vec<u32>,
    columns: Vec<u32>,
    sources: Vec<u32>,
    /// For each node, its index among the sources.
    nodes: Vec<Option<u32>>,
}

impl<'a> Lattice<'a> {
    /// Creates a lattice of about `count` nodes over the pixels (row, column) of the vertices, with cells that are as
    /// square as possible; `spacing` is the distance between rows and between columns.
    /// Errors: [`Error::NoCell`] if no cell has a vertex at all four nodes.
    pub(crate) fn new(pixels: &'a [[u32; 2]], spacing: [f64; 2], count: usize) -> Result<Self> {
        let [rows, columns] = [0, 1].map(|axis| extent(pixels, axis));
        let sides = [(rows, spacing[0]), (columns, spacing[1])].map(|((low, high), step)| f64::from(high - low) * step);
        // rows · columns = count, and rows/columns = height/width
        let along = (count as f64 * sides[0] / sides[1]).sqrt().round().clamp(2.0, (count as f64 / 2.0).max(2.0));
        let rows = lines(rows, along as usize);
        let columns = lines(columns, (count as f64 / along).round() as usize);
        let mut found =
            Self { pixels, nodes: vec![None; rows.len() * columns.len()], rows, columns, sources: Vec::new() };
        for (vertex, &[row, column]) in (0u32..).zip(pixels) {
            if let (Ok(r), Ok(c)) = (found.rows.binary_search(&row), found.columns.binary_search(&column)) {
                let node = &mut found.nodes[r * found.columns.len() + c];
                *node = Some(found.sources.len() as u32);
                found.sources.push(vertex);
            }
        }
        let complete = found.cells().filter(|&cell| found.corners(cell).is_some()).count();
        if complete == 0 { Err(Error::NoCell { sources: found.sources.len() }) } else { Ok(found) }
    }

    /// Returns the vertices on the lattice.
    pub(crate) fn sources(&self) -> &[u32] {
        &self.sources
    }

    /// Returns the positions of all vertices, given those of the sources.
    /// Panics if the number of positions differs from the number of sources.
    pub(crate) fn place(&self, places: &[[f64; 2]], control: &Control) -> Result<Vec<[f64; 2]>> {
        assert_eq!(places.len(), self.sources.len(), "one position per source");
        let nearest = self.nearest_complete();
        let mut uv = Vec::with_capacity(self.pixels.len());
        for (vertex, &[row, column]) in self.pixels.iter().enumerate() {
            if vertex.is_multiple_of(BATCH) {
                control.check()?;
            }
            let cell = nearest[self.cell_of(row, column)];
            uv.push(self.between(cell, f64::from(row), f64::from(column), places));
        }
        Ok(uv)
    }

    fn cells(&self) -> impl Iterator<Item = [usize; 2]> + use<> {
        let (rows, columns) = (self.rows.len() - 1, self.columns.len() - 1);
        (0..rows).flat_map(move |r| (0..columns).map(move |c| [r, c]))
    }

    fn number(&self, [r, c]: [usize; 2]) -> usize {
        r * (self.columns.len() - 1) + c
    }

    fn cell_of(&self, row: u32, column: u32) -> usize {
        let within = |lines: &[u32], at: u32| lines.partition_point(|&line| line <= at).clamp(1, lines.len() - 1) - 1;
        self.number([within(&self.rows, row), within(&self.columns, column)])
    }

    /// Returns the four sources of a cell: those in its first row, then those in its second row.
    fn corners(&self, [r, c]: [usize; 2]) -> Option<[u32; 4]> {
        let node = |r: usize, c: usize| self.nodes[r * self.columns.len() + c];
        Some([node(r, c)?, node(r, c + 1)?, node(r + 1, c)?, node(r + 1, c + 1)?])
    }

    /// Returns, for each cell, the nearest complete cell, counted in steps across sides.
    fn nearest_complete(&self) -> Vec<[usize; 2]> {
        let mut nearest = vec![None; (self.rows.len() - 1) * (self.columns.len() - 1)];
        let mut front: VecDeque<[usize; 2]> = self.cells().filter(|&cell| self.corners(cell).is_some()).collect();
        front.iter().for_each(|&cell| nearest[self.number(cell)] = Some(cell));
        while let Some([r, c]) = front.pop_front() {
            let from = nearest[self.number([r, c])];
            for beside in [[r.wrapping_sub(1), c], [r + 1, c], [r, c.wrapping_sub(1)], [r, c + 1]] {
                if beside[0] < self.rows.len() - 1 && beside[1] < self.columns.len() - 1 {
                    let known = &mut nearest[self.number(beside)];
                    if known.is_none() {
                        *known = from;
                        front.push_back(beside);
                    }
                }
            }
        }
        nearest.into_iter().flatten().collect() // every cell is reached from a complete one
    }

    fn between(&self, [r, c]: [usize; 2], row: f64, column: f64, places: &[[f64; 2]]) -> [f64; 2] {
        let Some(corners) = self.corners([r, c]) else { return [f64::NAN; 2] };
        let share = |lines: &[u32], n: usize, at: f64| {
            (at - f64::from(lines[n])) / (f64::from(lines[n + 1]) - f64::from(lines[n]))
        };
        let (s, t) = (share(&self.rows, r, row), share(&self.columns, c, column));
        let weights = [(1.0 - s) * (1.0 - t), (1.0 - s) * t, s * (1.0 - t), s * t];
        let sum = |axis: usize| corners.iter().zip(weights).map(|(&n, w)| w * places[n as usize][axis]).sum();
        [sum(0), sum(1)]
    }
}

fn extent(pixels: &[[u32; 2]], axis: usize) -> (u32, u32) {
    let low = pixels.iter().map(|pixel| pixel[axis]).min().unwrap_or(0);
    (low, pixels.iter().map(|pixel| pixel[axis]).max().unwrap_or(0).max(low + 1))
}

/// Returns `count` evenly spaced integers from the lowest to the highest.
fn lines((low, high): (u32, u32), count: usize) -> Vec<u32> {
    let steps = count.clamp(2, (high - low) as usize + 1) - 1;
    let at = |n: usize| low + (f64::from(high - low) * n as f64 / steps as f64).round() as u32;
    (0..=steps).map(at).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pixels(is_there: impl Fn(u32, u32) -> bool) -> Vec<[u32; 2]> {
        let all = (5..46).flat_map(|row| (3..64).map(move |column| [row, column]));
        all.filter(|&[row, column]| is_there(row, column)).collect()
    }

    fn linear([row, column]: [u32; 2]) -> [f64; 2] {
        [3.0 * f64::from(row) - f64::from(column), 0.5 * f64::from(column) + 7.0]
    }

    fn assert_linear(pixels: &[[u32; 2]], lattice: &Lattice<'_>) {
        let places: Vec<[f64; 2]> = lattice.sources().iter().map(|&v| linear(pixels[v as usize])).collect();
        let uv = lattice.place(&places, &Control::default()).unwrap();
        for (at, &pixel) in uv.iter().zip(pixels) {
            let expected = linear(pixel);
            assert!((at[0] - expected[0]).abs() < 1e-9 && (at[1] - expected[1]).abs() < 1e-9, "{pixel:?}");
        }
    }

    #[test]
    fn linear_maps_are_exact_beside_holes_and_outlines_too() {
        for (is_full, there) in
            [(true, pixels(|_, _| true)), (false, pixels(|r, c| r.abs_diff(25).pow(2) + c.abs_diff(33).pow(2) < 400))]
        {
            let lattice = Lattice::new(&there, [1.0, 1.0], 60).unwrap();
            assert_eq!(lattice.rows.len() * lattice.columns.len() == lattice.sources().len(), is_full);
            assert_linear(&there, &lattice);
        }
    }

    #[test]
    fn a_lattice_has_about_as_many_nodes_as_wanted_in_square_cells() {
        let there = pixels(|_, _| true); // 40 by 60 steps
        let shape = |spacing, count| {
            let lattice = Lattice::new(&there, spacing, count).unwrap();
            [lattice.rows.len(), lattice.columns.len()]
        };
        assert_eq!(shape([1.0, 1.0], 600), [20, 30]);
        assert_eq!(shape([3.0, 2.0], 625), [25, 25]);
        assert_eq!(shape([1.0, 1.0], 4), [2, 2]);
        assert_eq!(shape([1.0, 1.0], 1_000_000), [41, 61]);
    }

    #[test]
    fn within_a_cell_places_are_bilinear() {
        let there: Vec<[u32; 2]> = (0..3).flat_map(|r| (0..5).map(move |c| [r, c])).collect();
        let lattice = Lattice::new(&there, [1.0, 1.0], 4).unwrap();
        assert_eq!(lattice.sources(), [0, 4, 10, 14]);
        let uv = lattice.place(&[[0.0, 0.0], [8.0, 1.0], [0.0, 4.0], [8.0, 9.0]], &Control::default()).unwrap();
        assert_eq!(uv[7], [4.0, 3.5]);
        assert_eq!(uv[6], [2.0, 0.5 * (0.25 + 5.25)]);
    }

    #[test]
    fn a_lattice_without_a_cell_is_refused() {
        let diagonal: Vec<[u32; 2]> = (0..50).map(|n| [n, n]).collect();
        assert_eq!(Lattice::new(&diagonal, [1.0, 1.0], 25).unwrap_err(), Error::NoCell { sources: 5 });
    }
}
