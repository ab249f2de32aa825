//! The result of every method.

use nalgebra::Vector3;

use crate::distortion::Distortion;
use crate::embed::stress::levels::Convergence;
use crate::rows::DistanceRows;

/// A flat map of the points of a surface.
#[derive(Debug, Clone)]
pub struct FlatMap {
    /// The position of each point in the plane, in mm.
    pub uv: Vec<[f64; 2]>,
    /// Outward unit normals (RAS+ mm); NaN where the outside is undefined.
    pub normals: Vec<Vector3<f64>>,
    /// The sources, as vertices of the surface.
    pub sources: Vec<u32>,
    /// The eigenvalues of the classical scaling in mm², by decreasing magnitude.
    pub eigenvalues: Vec<f64>,
    /// The share of Σ λ² in the two dimensions of the plane.
    pub planarity: f64,
    /// The distortion of distances.
    pub distortion: Distortion,
    /// The convergence of the optimisation, for methods that optimise iteratively.
    pub convergence: Option<Convergence>,
    /// The distances from the sources to all points, if they are kept.
    pub rows: Option<DistanceRows>,
}

impl FlatMap {
    /// Returns the memory of a map in bytes: each vertex has a position, a normal, and the mean error of its distances.
    pub(super) const fn memory_need(points: usize) -> u64 {
        (16 + 24 + 8) * points as u64
    }
}

/// The memory that is needed for any size in bytes: threads, buffers, the allocator's reserve.
pub(super) const BASE_BYTES: u64 = 24 << 20;

/// The memory per vertex of Python's arrays in bytes: complete and cut surface, and map (docs/decisions/0034).
pub(super) const PYTHON_BYTES: u64 = 450;
