//! Maps beside the distances of the surface, measured from reference sources.

use super::{Distortion, measure};
use crate::control::Control;
use crate::error::Result;
use crate::geodesic::Solver;
use crate::geodesic::engine::Engine;
use crate::rows::{DistanceRows, PassingRows};
use crate::sources;

/// Reference sources from which the distortion is measured.
pub const REFERENCE_SOURCES: usize = 200;

/// Memory in bytes that rows from the reference sources take at most.
pub const KEPT_BYTES: u64 = 256 << 20;

/// What a map does to the distances from `count` random reference sources.
///
/// # Errors
/// [`Error::Unreachable`], [`Error::Cancelled`].
pub fn judge<S: Solver>(
    engine: &Engine<S>,
    uv: &[[f64; 2]],
    count: usize,
    seed: u64,
    control: &Control,
) -> Result<Distortion> {
    let reference = reference_sources(uv.len(), count, seed);
    Ok(judge_all(engine, &[uv], &reference, KEPT_BYTES, seed, control)?.remove(0))
}

/// Random reference sources, other ones than a map of the same seed has.
pub fn reference_sources(points: usize, count: usize, seed: u64) -> Vec<u32> {
    sources::random(points, points.min(count), seed.wrapping_add(1))
}

/// What several maps of the same vertices do to the distances from the same sources. If their rows take more than `kept` bytes,
/// they are computed twice instead of being kept; the figures are the same.
///
/// # Errors
/// [`Error::Unreachable`], [`Error::Cancelled`].
pub fn judge_all<S: Solver>(
    engine: &Engine<S>,
    maps: &[&[[f64; 2]]],
    reference: &[u32],
    kept: u64,
    seed: u64,
    control: &Control,
) -> Result<Vec<Distortion>> {
    if 4 * reference.len() as u64 * engine.columns() as u64 <= kept {
        measure(maps, &DistanceRows::by(engine, reference, control)?, seed, control)
    } else {
        measure(maps, &PassingRows::new(engine, reference, kept), seed, control)
    }
}
