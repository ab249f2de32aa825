//! What every method returns.

use nalgebra::Vector3;

use crate::distortion::Distortion;
use crate::embed::stress::levels::Convergence;
use crate::rows::DistanceRows;

/// A flat map of the points of a surface.
#[derive(Debug, Clone)]
pub struct FlatMap {
    /// The place of each point in the plane, mm.
    pub uv: Vec<[f64; 2]>,
    /// Unit normals (RAS+ mm) that point outside; NaN where there is no outside.
    pub normals: Vec<Vector3<f64>>,
    /// The sources, as vertices of the surface.
    pub sources: Vec<u32>,
    /// The eigenvalues of the scaling, mm², by falling magnitude.
    pub eigenvalues: Vec<f64>,
    /// The share of Σ λ² that the plane carries.
    pub planarity: f64,
    /// What flattening did to the distances.
    pub distortion: Distortion,
    /// How descent went, where the method descends.
    pub convergence: Option<Convergence>,
    /// The distances from the sources to all points, where they are to be kept.
    pub rows: Option<DistanceRows>,
}

impl FlatMap {
    /// The memory in bytes of a map: a vertex has a place, a normal, and the mean error of its distances.
    pub(super) const fn memory_need(points: usize) -> u64 {
        (16 + 24 + 8) * points as u64
    }
}

/// What is needed whatever the size, bytes: threads, buffers, the allocator's reserve.
pub(super) const BASE_BYTES: u64 = 24 << 20;

/// What Python makes of a vertex, bytes: its arrays of the surface, whole and as it is cut, and of the map (docs/decisions/0034).
pub(super) const PYTHON_BYTES: u64 = 450;
