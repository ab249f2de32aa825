//! What all methods need of memory.

use crate::distortion::WORK_BYTES;
use crate::distortion::judge::{KEPT_BYTES, REFERENCE_SOURCES};

/// What is needed whatever the size: threads, buffers, the allocator's reserve.
pub(super) const BASE_BYTES: u64 = 16 << 20;

/// What a vertex of a surface of triangles takes: its place, its number in the input, its two faces and their twins, its normal, its
/// place in the map, its distortion; and what Python makes of them.
pub(super) const SURFACE_BYTES: u64 = 24 + 4 + 2 * (12 + 12) + 24 + 16 + 8 + 100;

/// Usual number of shortcuts of a vertex of a surface, where many sources are prepared for.
pub(super) const SURFACE_SHORTCUTS: u64 = 220;

/// What judging a map needs at most: rows, no fewer than one, and what is made of them.
pub(super) fn reference_memory_need(points: u64) -> u64 {
    let rows = 4 * points * points.min(REFERENCE_SOURCES as u64);
    rows.min(KEPT_BYTES.max(4 * points)) + WORK_BYTES
}
