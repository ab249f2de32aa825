//! Exact distances within neighbourhoods of a number of rings, and from a few vertices to all others.
//!
//! Wolfson and Schwartz (1989) measure the distances from every node to those that are reached across a number of
//! edges, over the faces in between, and combine them with a sample of very long ones.

use rayon::prelude::*;

use super::exact::{Exact, Reach};
use super::solver::Solver;
use crate::adjacency::marked;
use crate::error::check_points;
use crate::surface::{Surface, mesh::paths::Network};
use crate::{Control, Error, Result};

/// The maximum number of vertices around which neighbourhoods are counted.
const COUNTED: usize = 1024;

/// A nearby vertex and its distance in mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Near {
    /// The vertex.
    pub vertex: u32,
    /// Its distance along the surface.
    pub distance: f32,
}

/// For each vertex, the vertices at known distances, in ascending order. The relation and the distances are symmetric.
#[derive(Debug, Clone, PartialEq)]
pub struct Neighbourhoods {
    starts: Vec<usize>,
    near: Vec<Near>,
    total: f64,
}

impl Neighbourhoods {
    /// Measures exact distances from every vertex within `rings` (everywhere if None), and from `sources` to all.
    ///
    /// A path within the rings can be longer than the shortest one; the shorter one of both directions is used. With
    /// `keep_rows`, also returns the rows from the sources to all vertices, as measured.
    ///
    /// # Errors
    /// [`Error::NoSuchPoint`] for a source, [`Error::Unreachable`] if a vertex has no neighbour or cannot be reached
    /// from a source, and [`Error::Cancelled`].
    pub fn measure(
        surface: &Surface, rings: Option<u32>, sources: &[u32], keep_rows: bool, control: &Control,
    ) -> Result<(Self, Option<Vec<f32>>)> {
        check_points(sources.iter().copied(), surface.len())?;
        control.begin("measuring neighbourhoods", surface.len() as u64);
        let everywhere = Exact::new(surface);
        let within = Exact::new(surface).within(Reach { rings, ..Reach::default() });
        let is_source = marked(surface.len(), sources);
        let row_of = |(row, wave): &mut (Vec<f64>, _), vertex: u32| {
            let solver = if is_source[vertex as usize] { &everywhere } else { &within };
            solver.distances(vertex, row, wave, control)?;
            control.advance();
            let reached = (0u32..).zip(&*row).map(|(vertex, &distance)| Near { vertex, distance: distance as f32 });
            let near = reached.filter(|near| near.distance.is_finite() && near.distance > 0.0);
            Ok(near.collect::<Vec<_>>().into_boxed_slice())
        };
        let scratch = || (vec![0.0; surface.len()], Solver::scratch(&everywhere));
        let rows: Vec<Box<[Near]>> =
            (0..surface.len() as u32).into_par_iter().map_init(scratch, row_of).collect::<Result<_>>()?;
        let kept = keep_rows.then(|| {
            let mut kept = vec![0.0; sources.len() * surface.len()];
            for (row, &source) in kept.chunks_exact_mut(surface.len().max(1)).zip(sources) {
                rows[source as usize].iter().for_each(|near| row[near.vertex as usize] = near.distance);
            }
            kept
        });
        Ok((Self::of(rows, &is_source, control)?, kept))
    }

    /// Creates neighbourhoods from rows in ascending order; those of sources contain all vertices.
    fn of(rows: Vec<Box<[Near]>>, is_source: &[bool], control: &Control) -> Result<Self> {
        let sources: Vec<u32> = (0u32..).zip(is_source).filter_map(|(v, &is_source)| is_source.then_some(v)).collect();
        let mut starts = vec![0];
        let mut near = Vec::with_capacity(rows.iter().map(|row| row.len() + sources.len()).sum());
        for (vertex, row) in (0u32..).zip(&rows) {
            control.check()?;
            if is_source[vertex as usize] {
                near.extend_from_slice(row);
            } else {
                merge(row, &sources, &mut near);
            }
            starts.push(near.len());
        }
        drop(rows);
        let mut merged = Self { starts, near, total: 0.0 };
        merged.near = merged.with_the_shorter_way(control)?;
        merged.check_reached()?;
        merged.total = merged.near.iter().map(|near| f64::from(near.distance)).sum();
        Ok(merged)
    }

    fn with_the_shorter_way(&self, control: &Control) -> Result<Vec<Near>> {
        let mut near = self.near.clone();
        let mut rest = near.as_mut_slice();
        let mut rows = Vec::with_capacity(self.len());
        for bounds in self.starts.windows(2) {
            let (row, after) = rest.split_at_mut(bounds[1] - bounds[0]);
            rows.push(row);
            rest = after;
        }
        rows.into_par_iter().enumerate().try_for_each(|(vertex, row)| {
            control.check()?;
            for near in row {
                let back = self.of_vertex(near.vertex as usize);
                if let Ok(at) = back.binary_search_by_key(&(vertex as u32), |near| near.vertex) {
                    // both are lengths of paths, so the smaller one is closer to the shortest path
                    near.distance = near.distance.min(back[at].distance);
                }
            }
            Ok(())
        })?;
        Ok(near)
    }

    /// Checks that every vertex has a neighbour, and that every source reaches all vertices.
    fn check_reached(&self) -> Result<()> {
        for vertex in 0..self.len() {
            let row = self.of_vertex(vertex);
            let missed = row.iter().find(|near| near.distance.is_infinite()).map(|near| near.vertex as usize);
            if let Some(source_vertex) = missed.or_else(|| row.is_empty().then_some(vertex)) {
                return Err(Error::Unreachable { source_vertex, vertex });
            }
        }
        Ok(())
    }

    fn len(&self) -> usize {
        self.starts.len() - 1
    }

    /// Returns the number of pairs of vertices.
    pub(crate) fn pairs(&self) -> usize {
        self.near.len() / 2
    }

    /// Returns the sum of the distances of all pairs, counted from both ends, in mm.
    pub(crate) fn total(&self) -> f64 {
        self.total
    }

    /// Returns the vertices near a vertex.
    pub(crate) fn of_vertex(&self, vertex: usize) -> &[Near] {
        &self.near[self.starts[vertex]..self.starts[vertex + 1]]
    }
}

/// Returns a row including missing sources; their distances are in their own rows.
fn merge(row: &[Near], sources: &[u32], to: &mut Vec<Near>) {
    let mut row = row.iter().peekable();
    for &vertex in sources {
        while let Some(&near) = row.next_if(|near| near.vertex <= vertex) {
            to.push(near);
        }
        if to.last().is_none_or(|last| last.vertex != vertex) {
            to.push(Near { vertex, distance: f32::INFINITY });
        }
    }
    to.extend(row);
}

/// Returns the number of vertices within 1, 2, 3 … rings around a vertex, including it, up to all vertices; the mean
/// over a sample of vertices, or over all if they are few.
///
/// # Errors
/// [`Error::Cancelled`].
pub fn sizes_of_rings(surface: &Surface, most: Option<u32>, control: &Control) -> Result<Vec<f64>> {
    let edges = Network::of(surface);
    let counted = surface.len().min(COUNTED);
    let sizes_around = |n: usize| {
        control.check()?;
        let mut is_reached = vec![false; surface.len()];
        // evenly spread over the numbers of the vertices
        let mut front = vec![(n * surface.len() / counted) as u32];
        is_reached[front[0] as usize] = true;
        let (mut size, mut sizes) = (1, Vec::new());
        while !front.is_empty() && most.is_none_or(|most| sizes.len() < most as usize) {
            let beyond = front.iter().flat_map(|&vertex| edges.incident(vertex)).map(|arc| arc.to);
            front = beyond.filter(|&vertex| !std::mem::replace(&mut is_reached[vertex as usize], true)).collect();
            size += front.len();
            sizes.push(size);
        }
        Ok(sizes)
    };
    let all: Vec<Vec<usize>> = (0..counted).into_par_iter().map(sizes_around).collect::<Result<_>>()?;
    let rings = all.iter().map(Vec::len).max().unwrap_or(0);
    let size = |sizes: &Vec<usize>, ring: usize| *sizes.get(ring).or(sizes.last()).unwrap_or(&1);
    let sum = |ring| all.iter().map(|sizes| size(sizes, ring)).sum::<usize>();
    Ok((0..rings).map(|ring| sum(ring) as f64 / counted as f64).collect())
}

#[cfg(test)]
mod tests;
