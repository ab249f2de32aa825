//! Springs along the edges of a surface: a sparse matrix about as stiff as a map's energy, and its factor.
//!
//! Solving with these springs adds global information to a step of the optimisation: a force at one point moves
//! everything around it, as far as the stiffness carries it.

use crate::embed::Place;
use faer::sparse::linalg::solvers::{Llt, SymbolicLlt};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMat};
use faer::{Conj, Mat, Side, linalg::solvers::SolveCore, sparse::linalg::LltError};
use nalgebra::Vector2;
use rayon::prelude::*;

use crate::adjacency::starts_of;
use crate::{Control, Error, Result};

/// The sparsity pattern of the matrix and its symbolic factor, which are the same for every map of a surface.
#[derive(Debug)]
pub struct Springs {
    pattern: SymbolicSparseColMat<u32>,
    order: SymbolicLlt<u32>,
    triangles: Vec<[u32; 3]>,
    /// The positions of each triangle's three edges among the entries.
    edges: Vec<[u32; 3]>,
    /// The position of each vertex's diagonal entry.
    diagonal: Vec<u32>,
}

/// No entry: one end of the edge is fixed.
const HELD: u32 = u32::MAX;

/// The factored matrix, and optionally one more unknown: the period of a map that repeats in the second direction.
#[derive(Debug)]
pub struct Factor {
    own: Llt<u32, f64>,
    period: Option<OfPeriod>,
}

/// The period's part of a factor.
#[derive(Debug)]
struct OfPeriod {
    /// The displacements that an increase of the period by 1 causes, with opposite signs.
    follow: Vec<f64>,
    /// Its stiffness when all vertices follow it.
    stiffness: f64,
}

impl Springs {
    /// Creates springs along the edges of triangles, given by their corners. Corners from `vertices` on are fixed.
    pub fn new(triangles: Vec<[u32; 3]>, vertices: usize, control: &Control) -> Result<Self> {
        let ends = |[a, b, c]: [u32; 3]| [(a, b), (a, c), (b, c)].map(|(a, b)| (a.min(b), a.max(b)));
        let is_free = |&(_, larger): &(u32, u32)| (larger as usize) < vertices;
        let mut entries: Vec<(u32, u32)> =
            triangles.iter().flat_map(|&corners| ends(corners)).filter(is_free).collect();
        entries.extend((0..vertices as u32).map(|vertex| (vertex, vertex)));
        entries.par_sort_unstable();
        entries.dedup();
        control.check()?;
        if entries.len() >= HELD as usize {
            return Err(Error::TooManySprings { vertices });
        }
        let starts = starts_of(vertices, entries.iter().map(|&(column, _)| column));
        let place = |(column, row): (u32, u32)| {
            if row as usize >= vertices {
                return HELD;
            }
            let [first, end] = [0, 1].map(|next| starts[column as usize + next]);
            first + entries[first as usize..end as usize].partition_point(|entry| entry.1 < row) as u32
        };
        let edges = triangles.iter().map(|&corners| ends(corners).map(place)).collect();
        let diagonal = starts[..vertices].to_vec();
        let rows = entries.iter().map(|&(_, row)| row).collect();
        let pattern = SymbolicSparseColMat::new_checked(vertices, vertices, starts, None, rows);
        let order =
            SymbolicLlt::try_new(pattern.as_ref(), Side::Lower).map_err(|_| Error::TooManySprings { vertices })?;
        Ok(Self { pattern, order, triangles, edges, diagonal })
    }

    /// Factors the matrix, given the off-diagonal entries of each triangle (minus the stiffness of its edges) and
    /// springs from each vertex to the ground. Some of these must be stiff, or the map could float away.
    pub fn factor(&self, stiffness: &[[f64; 3]], ground: &[f64]) -> Result<Factor> {
        let mut values = vec![0.0; self.pattern.compute_nnz()];
        for ((edges, stiffness), corners) in self.edges.iter().zip(stiffness).zip(&self.triangles) {
            for ((&edge, &entry), (a, b)) in edges.iter().zip(stiffness).zip([(0, 1), (0, 2), (1, 2)]) {
                if edge != HELD {
                    values[edge as usize] += entry;
                }
                for end in [corners[a], corners[b]] {
                    if let Some(&own) = self.diagonal.get(end as usize) {
                        values[own as usize] -= entry;
                    }
                }
            }
        }
        self.diagonal.iter().zip(ground).for_each(|(&at, ground)| values[at as usize] += ground);
        let matrix = SparseColMatRef::new(self.pattern.as_ref(), &values);
        let factor = Llt::try_new_with_symbolic(self.order.clone(), matrix, Side::Lower);
        let own = factor.map_err(|error| match error {
            LltError::Generic(_) => Error::TooManySprings { vertices: self.diagonal.len() },
            LltError::Numeric(_) => Error::Uneven,
        })?;
        Ok(Factor { own, period: None })
    }

    /// Returns the forces on the vertices, with opposite signs, and on the period, when the period of a map increases
    /// by 1. `turns` are the periods that are added to the positions of each triangle's corners.
    pub fn of_period(&self, stiffness: &[[f64; 3]], turns: &[[f64; 3]]) -> (Vec<f64>, f64) {
        let (mut forces, mut own) = (vec![0.0; self.diagonal.len()], 0.0);
        for ((corners, stiffness), turns) in self.triangles.iter().zip(stiffness).zip(turns) {
            for (&entry, (a, b)) in stiffness.iter().zip([(0, 1), (0, 2), (1, 2)]) {
                let force = -entry * (turns[a] - turns[b]);
                forces[corners[a] as usize] += force;
                forces[corners[b] as usize] -= force;
                own += force * (turns[a] - turns[b]);
            }
        }
        (forces, own)
    }

    /// Like [`factor`](Self::factor), with the period as one more unknown at the end; `turns` as in
    /// [`of_period`](Self::of_period).
    pub fn factor_with_period(&self, stiffness: &[[f64; 3]], ground: &[f64], turns: &[[f64; 3]]) -> Result<Factor> {
        let factor = self.factor(stiffness, ground)?;
        let (forces, own) = self.of_period(stiffness, turns);
        let pulls: Vec<Place> = forces.iter().map(|&force| Vector2::new(0.0, force)).collect();
        let follow: Vec<f64> = factor.solve(&pulls).iter().map(|place| place.y).collect();
        // the Schur complement of the vertices, own − fᵀA⁻¹f, is positive in exact arithmetic
        let stiffness = own - follow.iter().zip(&forces).map(|(follow, force)| follow * force).sum::<f64>();
        if stiffness > 0.0 {
            Ok(Factor { period: Some(OfPeriod { follow, stiffness }), ..factor })
        } else {
            Err(Error::Uneven)
        }
    }
}

impl Factor {
    /// Returns the displacements for which the springs balance the forces. With a period, the last force and
    /// displacement are its own, in the second direction.
    pub fn solve(&self, forces: &[Place]) -> Vec<Place> {
        let vertices = forces.len() - usize::from(self.period.is_some());
        let mut both = Mat::from_fn(vertices, 2, |row, column| forces[row][column]);
        self.own.solve_in_place_with_conj(Conj::No, both.as_mut());
        let mut moved: Vec<Place> = (0..vertices).map(|row| Vector2::new(both[(row, 0)], both[(row, 1)])).collect();
        if let Some(OfPeriod { follow, stiffness }) = &self.period {
            // block elimination: the period from its Schur complement, then the vertices that follow it
            let carried: f64 = follow.iter().zip(forces).map(|(follow, force)| follow * force.y).sum();
            let grown = (forces[vertices].y - carried) / stiffness;
            moved.iter_mut().zip(follow).for_each(|(moved, follow)| moved.y -= grown * follow);
            moved.push(Vector2::new(0.0, grown));
        }
        moved
    }
}
