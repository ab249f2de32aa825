//! Boxes in the plane, and a tree that finds overlapping boxes.

use std::ops::Range;

use nalgebra::Vector2;
use rayon::prelude::*;
use robust::Coord;

/// The number of boxes in each node of the tree.
const FAN: usize = 8;

/// A bounding-volume hierarchy, packed along a space-filling curve. Unlike the cells of a grid, its boxes follow the
/// size of the triangles, which varies by many orders of magnitude in a conformal or a Tutte map.
pub(crate) struct Tree {
    /// The items in the order of the curve.
    pub(crate) order: Vec<u32>,
    /// The levels of the tree, from the boxes of the items to the one around all of them.
    levels: Vec<Vec<Bounds>>,
}

impl Tree {
    pub(crate) fn over(bounds: Vec<Bounds>) -> Self {
        let all = bounds.iter().fold(Bounds::NOTHING, |a, b| a.with(b));
        let mut keyed: Vec<(u64, u32)> = bounds.iter().map(|b| all.curve_position(b)).zip(0..).collect();
        keyed.par_sort_unstable();
        let order: Vec<u32> = keyed.into_iter().map(|(_, n)| n).collect();
        let mut levels = vec![order.iter().map(|&n| bounds[n as usize]).collect::<Vec<_>>()];
        while let Some(below) = levels.last().filter(|below| below.len() > 1) {
            let above = below.chunks(FAN).map(|few| few.iter().fold(Bounds::NOTHING, |a, b| a.with(b))).collect();
            levels.push(above);
        }
        Self { order, levels }
    }

    /// Returns whether `hit` holds for any other item whose box meets the one at a position of the order. The search
    /// begins with the nearest items along the curve, which are likely hits in a fold, and ends at the first hit.
    pub(crate) fn any_other(&self, position: usize, hit: &mut impl FnMut(u32) -> bool) -> bool {
        let window = &self.levels[0][position];
        let mut own = position;
        (0..self.levels.len()).any(|level| {
            let mut beside = siblings(own / FAN, &self.levels[level]).filter(move |&node| node != own);
            own /= FAN;
            beside.any(|node| self.any_in(level, node, window, hit))
        })
    }

    fn any_in(&self, level: usize, node: usize, window: &Bounds, hit: &mut impl FnMut(u32) -> bool) -> bool {
        self.levels[level][node].meets(window)
            && match level {
                0 => hit(self.order[node]),
                _ => siblings(node, &self.levels[level - 1]).any(|child| self.any_in(level - 1, child, window, hit)),
            }
    }
}

fn siblings(parent: usize, level: &[Bounds]) -> Range<usize> {
    parent * FAN..((parent + 1) * FAN).min(level.len())
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct Bounds {
    low: [f64; 2],
    high: [f64; 2],
}

impl Bounds {
    const NOTHING: Self = Self { low: [f64::INFINITY; 2], high: [f64::NEG_INFINITY; 2] };

    pub(crate) fn around(corners: &[Coord<f64>]) -> Self {
        corners.iter().fold(Self::NOTHING, |bounds, p| bounds.with(&Self { low: [p.x, p.y], high: [p.x, p.y] }))
    }

    pub(crate) fn of(points: &[Vector2<f64>], margin: f64) -> Self {
        let low = points.iter().fold(Vector2::repeat(f64::INFINITY), |low, p| low.inf(p)).add_scalar(-margin);
        let high = points.iter().fold(Vector2::repeat(f64::NEG_INFINITY), |high, p| high.sup(p)).add_scalar(margin);
        Self { low: low.into(), high: high.into() }
    }

    fn with(self, other: &Self) -> Self {
        let low = [self.low[0].min(other.low[0]), self.low[1].min(other.low[1])];
        let high = [self.high[0].max(other.high[0]), self.high[1].max(other.high[1])];
        Self { low, high }
    }

    /// Returns whether the interiors of the contents can meet. Boxes that only touch do not meet.
    #[inline]
    fn meets(&self, other: &Self) -> bool {
        (0..2).all(|axis| self.low[axis] < other.high[axis] && other.low[axis] < self.high[axis])
    }

    /// Returns the position of another box's centre along the Z-order curve through this box.
    fn curve_position(&self, other: &Self) -> u64 {
        let size = (self.high[0] - self.low[0]).max(self.high[1] - self.low[1]);
        let along = |axis: usize| {
            let middle = 0.5 * (other.low[axis] + other.high[axis]);
            spread(((middle - self.low[axis]) / size * f64::from(u32::MAX)) as u32)
        };
        along(0) | along(1) << 1
    }
}

/// Spreads the bits of a number to every second position.
fn spread(bits: u32) -> u64 {
    [
        (16, 0x0000_ffff_0000_ffff),
        (8, 0x00ff_00ff_00ff_00ff),
        (4, 0x0f0f_0f0f_0f0f_0f0f),
        (2, 0x3333_3333_3333_3333),
        (1, 0x5555_5555_5555_5555),
    ]
    .iter()
    .fold(u64::from(bits), |bits, &(shift, mask)| (bits | bits << shift) & mask)
}
