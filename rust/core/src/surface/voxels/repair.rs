//! Repair of a volume's topology: a few voxels are removed or added, so that the foreground's boundary is a sphere.
//!
//! A voxel is *simple* if flipping it between foreground and background creates, breaks or joins no component, tunnel
//! or cavity of either. Its 26 neighbours determine this (Bertrand, Malandain 1994, A new characterization of
//! three-dimensional simple points). A set that starts as one voxel or as a box, and changes only by simple voxels,
//! keeps a sphere as its boundary.
//!
//! 1. Keep the largest component, and fill its cavities.
//! 2. *Cut:* within the foreground, grow from its deepest voxel. Voxels that never become simple would close a handle.
//!    *Fill:* within the background, likewise grow from the outside of the bounding box. Both take the deepest voxels
//!    first, as in ordered homotopic thickening, so that fronts meet where a handle is thin or a tunnel narrow.
//! 3. *Exchange:* a handle that is expensive to cut may be cheap to fill, and vice versa. Add each filled piece to the
//!    cut shape, revert the changes that become unnecessary, and keep the result if fewer voxels are changed than
//!    before. Do the same to the filled shape with the cut pieces. The shape that is closer to the input is taken.
//!
//! # Connectivity
//! Foreground voxels are connected through faces, background voxels through faces and edges. For this pair, called (6⁺,
//! 18), digital topology counts exactly the handles that [surfels](crate::surface::voxels::surfels) have when voxels
//! that touch along an edge stay apart. For the more usual pair (6, 26), background voxels are also connected through
//! corners, and most such corners create a handle that surfels do not have.
//!
//! On the white matter of MNI152 (one hemisphere, 314 327 voxels, 62 handles), cutting alone changes 162 voxels,
//! filling alone 1082, and exchanging 141. For (6, 26) there are 162 handles, and these are 301, 1220 and 237 voxels.

mod distances;
mod grid;
mod runs;
mod simple;

use std::collections::BinaryHeap;

use self::distances::distances;
use self::grid::{BATCH, Grid, look};
use self::runs::{EDGES, FACES, Runs};
use self::simple::{AROUND, is_simple, neighbourhood};
use crate::surface::voxels::neighbours;
use crate::volume::Mask;
use crate::{Control, Error, Result};

/// The depth in voxels that equals the certainty of being on one side, or of having only neighbours on it.
const LIKELY: f32 = 2.0;

/// A volume whose foreground is bounded by a single sphere, and all changes to it. Lists are in C order.
#[derive(Debug, Clone)]
pub struct Repaired {
    /// The repaired volume: one 6-connected component without handles, whose complement is 18-connected.
    pub mask: Mask,
    /// The number of handles that were opened or closed.
    pub handles: usize,
    /// Voxels removed to open handles.
    pub cut: Vec<[u32; 3]>,
    /// Voxels added to close handles.
    pub filled: Vec<[u32; 3]>,
    /// Voxels removed because they belong to smaller components.
    pub dropped: Vec<[u32; 3]>,
    /// Voxels added because they lie in cavities.
    pub cavities: Vec<[u32; 3]>,
    /// The numbers of voxels that cutting every handle, or filling every handle, would change.
    pub considered: [usize; 2],
}

/// Returns the number of voxels of each 6-connected component of the foreground, in the order of their first voxels.
///
/// # Errors
/// [`Error::VolumeTooLarge`] if the foreground has more than 2³² runs of voxels, and [`Error::Cancelled`].
pub fn component_sizes(mask: &Mask, control: &Control) -> Result<Vec<usize>> {
    let runs = Runs::of(mask.shape(), |cell| mask.values()[cell], FACES, control)?;
    Ok(runs.sizes().into_iter().filter(|&size| size > 0).collect())
}

/// Removes and adds voxels until the boundary of the foreground is a single sphere.
///
/// `spacing` is the distance between neighbouring voxels along each axis in mm. With a foreground `probability`, one
/// value per voxel in C order, voxels are preferably removed where it is low and added where it is high. Values are
/// clamped to 0 to 1; NaN counts as 0. Voxels outside the volume are background and remain so.
///
/// # Errors
/// [`Error::SpacingNotPositive`]; [`Error::ShapeMismatch`] of the probability; [`Error::VolumeTooLarge`] if the
/// foreground's bounding box has more than 2³² voxels; [`Error::Cancelled`].
pub fn to_genus_zero(
    mask: &Mask, spacing: [f64; 3], probability: Option<&[f32]>, control: &Control,
) -> Result<Repaired> {
    validate(mask, spacing, probability)?;
    let solid = Solid::of(mask, control)?;
    let handles = solid.handles(control)?;
    if handles == 0 {
        return Repaired::compare(mask, &solid, &solid.cells, handles, [0, 0], control);
    }
    control.begin("repairing the topology", (solid.cells.len() / BATCH) as u64);
    let scale = in_voxels(spacing);
    let likely = |cell| match probability.map(|values| values[solid.grid.index_in(mask, cell)]) {
        Some(value) if !value.is_nan() => value.clamp(0.0, 1.0),
        _ => 0.0,
    };
    let grown = |side| Shape::grown(&solid, side, &order(&solid, side, scale, likely, control)?, control);
    let (cut, filled) = both(|| grown(true), || grown(false))?;
    let considered = [cut.changes, filled.changes];
    let (cut, filled) = both(|| cut.exchanged(&filled, control), || filled.exchanged(&cut, control))?;
    let best = if cut.changes <= filled.changes { cut } else { filled };
    Repaired::compare(mask, &solid, &best.cells, handles, considered, control)
}

fn validate(mask: &Mask, spacing: [f64; 3], probability: Option<&[f32]>) -> Result<()> {
    if let Some(axis) = (0..3).find(|&axis| !(spacing[axis] > 0.0 && spacing[axis].is_finite())) {
        return Err(Error::SpacingNotPositive { axis, spacing: spacing[axis] });
    }
    let (shape, needed) = (mask.shape(), mask.shape().iter().product());
    match probability {
        Some(values) if values.len() != needed => Err(Error::ShapeMismatch { shape, given: values.len(), needed }),
        _ => Ok(()),
    }
}

/// Returns the spacing in edges of a cube with the volume of a voxel, so that depth and probability can be added.
fn in_voxels(spacing: [f64; 3]) -> [f64; 3] {
    let edge = spacing.iter().product::<f64>().cbrt();
    spacing.map(|length| length / edge)
}

/// Runs both at once if there are two threads.
fn both<T: Send>(
    first: impl FnOnce() -> Result<T> + Send, second: impl FnOnce() -> Result<T> + Send,
) -> Result<(T, T)> {
    let (first, second) = rayon::join(first, second);
    Ok((first?, second?))
}

impl Repaired {
    /// Lists the changes from the input to the result `cells`.
    fn compare(
        mask: &Mask, solid: &Solid, cells: &[bool], handles: usize, considered: [usize; 2], control: &Control,
    ) -> Result<Self> {
        let Solid { grid, cells: solid } = solid;
        let [mut cut, mut filled, mut dropped, mut cavities] = [const { Vec::new() }; 4];
        for (count, voxel) in mask.foreground().enumerate() {
            look(count, control)?;
            match grid.cell(voxel) {
                Some(cell) if cells[cell] => {}
                Some(cell) if solid[cell] => cut.push(voxel.map(|x| x as u32)),
                _ => dropped.push(voxel.map(|x| x as u32)),
            }
        }
        let mut inside = vec![false; mask.shape().iter().product()];
        for (count, cell) in grid.interior().filter(|&cell| cells[cell]).enumerate() {
            look(count, control)?;
            inside[grid.index_in(mask, cell)] = true;
            let voxel = grid.voxel(cell);
            if !mask.is_inside(voxel) {
                let list = if solid[cell] { &mut cavities } else { &mut filled };
                list.push(voxel.map(|x| x as u32));
            }
        }
        let mask = Mask::new(mask.shape(), inside)?;
        Ok(Self { mask, handles, cut, filled, dropped, cavities, considered })
    }
}

/// One component without cavities, to be repaired.
#[derive(Debug)]
struct Solid {
    grid: Grid,
    cells: Vec<bool>,
}

impl Solid {
    /// Returns the largest component of a mask (the first of equal ones) with filled cavities.
    fn of(mask: &Mask, control: &Control) -> Result<Self> {
        let whole = Grid::around(mask.foreground(), control)?;
        let mut inside = vec![false; whole.len()];
        for (count, voxel) in mask.foreground().enumerate() {
            look(count, control)?;
            inside[whole.cell(voxel).expect("the box was drawn around the foreground")] = true;
        }
        let runs = Runs::of(whole.shape, |cell| inside[cell], FACES, control)?;
        let largest = runs.largest().expect("a mask has foreground");
        let ends = runs.component(largest).flat_map(|run| [run.start, run.end - 1]);
        let grid = Grid::around(ends.map(|cell| whole.voxel(cell)), control)?;
        let mut cells = vec![false; grid.len()];
        for run in runs.component(largest) {
            let start = grid.cell(whole.voxel(run.start)).expect("the box was drawn around the component");
            cells[start..start + run.len()].fill(true);
        }
        let background = Runs::of(grid.shape, |cell| !cells[cell], EDGES, control)?;
        let mut filled = vec![true; cells.len()];
        background.component(0).for_each(|run| filled[run].fill(false)); // those of the rim
        Ok(Self { grid, cells: filled })
    }

    /// Returns the number of handles, from the difference of the Euler characteristic to that of a ball.
    fn handles(&self, control: &Control) -> Result<usize> {
        let steps: [isize; 8] =
            std::array::from_fn(|corner| self.grid.step([4, 2, 1].map(|axis| i64::from(corner & axis != 0))));
        let shares: Vec<i64> = (0..256).map(euler_of_block).collect();
        let mut euler = 0;
        for (count, cell) in self.grid.interior().enumerate() {
            look(count, control)?;
            let bit = |corner: usize| usize::from(self.cells[cell.wrapping_add_signed(steps[corner])]) << corner;
            euler += shares[(0..8).map(bit).sum::<usize>()];
        }
        Ok(usize::try_from(1 - euler).expect("one component without cavities has handles or none"))
    }
}

/// Returns the contribution of a block of 2 × 2 × 2 voxels to the Euler characteristic of the foreground. Bit 4 i + 2 j
/// + k is its voxel (i, j, k).
///
/// Voxels, pairs that share a face, groups of four around an edge and of eight around a corner are the vertices, edges,
/// squares and cubes of a complex; those that begin with the block's first voxel count here. Six voxels around a corner
/// where two background voxels only touch close the corner like a membrane.
fn euler_of_block(block: u32) -> i64 {
    let span = |axes: u32| (0..8).filter(|corner| corner & !axes == 0).fold(0, |bits, corner| bits | 1 << corner);
    let full = (0..8).filter(|&axes| block & span(axes) == span(axes));
    let membrane = (0..4).any(|corner| block == 255 ^ (1 << corner | 1 << (7 - corner)));
    full.map(|axes: u32| 1 - 2 * i64::from(axes.count_ones() % 2)).sum::<i64>() + i64::from(membrane)
}

/// Returns the priorities in which one side of the solid takes its cells, highest first: by depth, by the probability
/// of being on this side, and by the number of neighbours on it. No value is negative.
fn order(
    solid: &Solid, side: bool, scale: [f64; 3], likely: impl Fn(usize) -> f32, control: &Control,
) -> Result<Vec<f32>> {
    let Solid { grid, cells } = solid;
    let mut order = distances(grid, scale, |cell| cells[cell] != side, control)?;
    for (count, cell) in grid.interior().filter(|&cell| cells[cell] == side).enumerate() {
        look(count, control)?;
        let foreground = likely(cell) + neighbourhood(cells, grid, cell).count_ones() as f32 / 27.0;
        order[cell] += LIKELY * if side { foreground } else { 2.0 - foreground };
    }
    Ok(order)
}

/// A shape made of simple voxels, and its distance from the solid.
#[derive(Debug, Clone)]
struct Shape<'a> {
    solid: &'a Solid,
    cells: Vec<bool>,
    /// The number of cells in which it differs from the solid.
    changes: usize,
    /// The cells to visit, each once: the bits of its priority above those of its number, inverted (the lower first).
    queue: BinaryHeap<u64>,
    is_queued: Vec<bool>,
}

impl<'a> Shape<'a> {
    /// Grows the foreground (`side` is true) from the first cell in order, or the background from the rim of the box.
    fn grown(solid: &'a Solid, side: bool, order: &[f32], control: &Control) -> Result<Self> {
        let Solid { grid, cells: goal } = solid;
        let mut cells = vec![false; goal.len()];
        if side {
            let first = (0..order.len()).rev().max_by(|&a, &b| order[a].total_cmp(&order[b]));
            cells[first.expect("the box has cells")] = true;
        } else {
            grid.interior().for_each(|cell| cells[cell] = true);
        }
        let changes = cells.iter().zip(goal).filter(|(is, ought)| is != ought).count();
        let mut shape = Self { solid, cells, changes, queue: BinaryHeap::new(), is_queued: vec![false; goal.len()] };
        for (count, cell) in grid.interior().filter(|&cell| goal[cell] == side).enumerate() {
            look(count, control)?;
            let around = neighbourhood(&shape.cells, grid, cell);
            if shape.cells[cell] != side && AROUND & (if side { around } else { !around }) != 0 {
                shape.enqueue(cell, order[cell]);
            }
        }
        shape.grow(side, |cell| goal[cell] == side, |cell| order[cell], control)?;
        Ok(shape)
    }

    /// Returns this shape with changed pieces of the other one instead of its own, where this leaves fewer changes.
    fn exchanged(&self, other: &Self, control: &Control) -> Result<Self> {
        let goal = &self.solid.cells;
        let offsets: Vec<_> = neighbours().collect();
        let mut pieces = self.solid.grid.pieces(&offsets, |cell| other.cells[cell] != goal[cell], control)?;
        pieces.iter_mut().for_each(|piece| piece.sort_unstable());
        pieces.sort_by_key(Vec::len);
        let mut shape = self.clone();
        loop {
            let before = shape.changes;
            for piece in &pieces {
                shape.try_piece(piece, control)?;
            }
            if shape.changes == before {
                return Ok(shape);
            }
        }
    }

    /// Changes a piece of cells as far as it is simple, reverts the changes that become unnecessary, and restores the
    /// previous state unless fewer changes are left.
    fn try_piece(&mut self, piece: &[usize], control: &Control) -> Result<()> {
        let goal = &self.solid.cells;
        let side = !goal[piece[0]];
        if piece.iter().any(|&cell| self.cells[cell] == side) {
            return Ok(()); // changed already
        }
        let before = self.changes;
        piece.iter().for_each(|&cell| self.enqueue(cell, 0.0));
        let allowed = |cell: usize| goal[cell] == side || piece.binary_search(&cell).is_ok();
        let mut moved = self.grow(side, allowed, |_| 0.0, control)?;
        moved.iter().filter(|&&cell| goal[cell] != side).for_each(|&cell| self.enqueue(cell, 0.0));
        moved.extend(self.grow(!side, |cell| goal[cell] != side, |_| 0.0, control)?);
        if self.changes >= before {
            moved.into_iter().for_each(|cell| self.flip(cell));
        }
        Ok(())
    }

    /// Moves every allowed cell that is simple when it is visited to a side. Begins with the queued cells, and visits
    /// cells again when a neighbour has moved. Returns the moved cells.
    fn grow(
        &mut self, side: bool, is_allowed: impl Fn(usize) -> bool, order: impl Fn(usize) -> f32, control: &Control,
    ) -> Result<Vec<usize>> {
        let steps: Vec<isize> = neighbours().map(|offset| self.solid.grid.step(offset)).collect();
        let mut moved = Vec::new();
        let mut turns = 0;
        while let Some(entry) = self.queue.pop() {
            look(turns, control)?;
            turns += 1;
            let cell = !(entry as u32) as usize;
            self.is_queued[cell] = false;
            if !is_simple(neighbourhood(&self.cells, &self.solid.grid, cell)) {
                continue;
            }
            self.flip(cell);
            moved.push(cell);
            if moved.len().is_multiple_of(BATCH) {
                control.advance();
            }
            for other in steps.iter().map(|&step| cell.wrapping_add_signed(step)) {
                if self.cells[other] != side && !self.is_queued[other] && is_allowed(other) {
                    self.enqueue(other, order(other));
                }
            }
        }
        Ok(moved)
    }

    fn enqueue(&mut self, cell: usize, order: f32) {
        self.is_queued[cell] = true;
        self.queue.push(u64::from(order.to_bits()) << 32 | u64::from(!(cell as u32))); // floats ≥ 0 sort as their bits
    }

    fn flip(&mut self, cell: usize) {
        self.cells[cell] ^= true;
        if self.cells[cell] == self.solid.cells[cell] {
            self.changes -= 1;
        } else {
            self.changes += 1;
        }
    }
}

#[cfg(test)]
mod tests;
