//! Simple voxels, determined by their 26 neighbours.
//!
//! The 27 cells of a neighbourhood are bits: 9 a + 3 b + c for the cell at (a − 1, b − 1, c − 1) from the centre.

use super::grid::Grid;

/// All cells but the centre.
pub(super) const AROUND: u32 = ((1 << 27) - 1) & !(1 << 13);
/// The cells that share a face with the centre.
const FACES: u32 = 1 << 4 | 1 << 10 | 1 << 12 | 1 << 14 | 1 << 16 | 1 << 22;
/// The cells that share only a corner with it.
const CORNERS: u32 = 1 | 1 << 2 | 1 << 6 | 1 << 8 | 1 << 18 | 1 << 20 | 1 << 24 | 1 << 26;

/// Returns the cells that are true in the neighbourhood of an inner cell.
#[inline]
pub(super) fn neighbourhood(cells: &[bool], grid: &Grid, cell: usize) -> u32 {
    let [plane, line, _] = grid.strides();
    let first = cell - plane - line - 1;
    let mut bits = 0;
    for row in 0..9 {
        let start = first + row / 3 * plane + row % 3 * line;
        for (column, &is_true) in cells[start..start + 3].iter().enumerate() {
            bits |= u32::from(is_true) << (3 * row + column);
        }
    }
    bits
}

/// Returns whether the centre is simple, if foreground connects through faces, background also through edges: (6⁺, 18).
///
/// It is simple if the surrounding foreground that is reached from its faces within three steps is connected, and so is
/// the background that is reached from its faces and edges. The centre's own side does not matter.
pub(super) fn is_simple(neighbourhood: u32) -> bool {
    let (foreground, background) = (neighbourhood & AROUND, !neighbourhood & AROUND);
    let faces = foreground & FACES;
    let near = (0..2).fold(faces, |near, _| through_faces(near) & foreground);
    is_one_piece(faces, near, through_faces) && is_one_piece(background & !CORNERS, background, through_edges)
}

/// Returns whether there are seeds that are connected within a set.
#[inline]
fn is_one_piece(seeds: u32, within: u32, spread: impl Fn(u32) -> u32) -> bool {
    let mut reached = seeds & seeds.wrapping_neg(); // one of them
    loop {
        let more = spread(reached) & within;
        if more == reached {
            return seeds != 0 && seeds & !reached == 0;
        }
        reached = more;
    }
}

/// Adds the cells that share a face with those of a set.
#[inline]
fn through_faces(bits: u32) -> u32 {
    bits | shifted(bits, 0) | shifted(bits, 1) | shifted(bits, 2)
}

/// Adds the cells that share a face or an edge with those of a set.
#[inline]
fn through_edges(bits: u32) -> u32 {
    let [a, b, c] = [0, 1, 2].map(|axis| bits | shifted(bits, axis));
    a | shifted(a, 1) | b | shifted(b, 2) | c | shifted(c, 0)
}

/// Returns the cells of a set, moved by one along an axis in both directions.
#[inline]
fn shifted(bits: u32, axis: usize) -> u32 {
    let (stride, front) = [(9, 0o777), (3, 0o7_007_007), (1, 0o111_111_111)][axis];
    let back = front << (2 * stride);
    (bits & !back) << stride | (bits & !front) >> stride
}
