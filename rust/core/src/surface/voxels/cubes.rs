//! The topology of a set of surface voxels, as a union of closed cubes (the topology of 26-connectivity).
//!
//! A sheet that can be flattened has Euler characteristic χ = 1 (a disk). The surface of a solid has χ = 2 and encloses
//! an interior. Every handle, hole, or contact of two banks reduces χ by one.

use crate::surface::voxels::{DIRECT, VertexGrid, VoxelSurface, neighbours};
use crate::{Control, Result};

/// The smallest share of the surface that must line one cavity for the surface to count as closed. A smaller cavity is
/// a pocket inside a thick sheet, which still has an edge and can be flattened.
const CLOSED_SHARE: f64 = 0.1;

/// The topology of a set of voxels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CubeTopology {
    /// The Euler characteristic χ of the union of closed cubes: components − tunnels + cavities.
    pub euler: i64,
    /// The number of enclosed cavities (6-connected components of the complement that do not reach the outside).
    pub cavities: usize,
    /// The number of surface voxels around the cavity with the largest lining.
    pub lining: usize,
    /// The number of surface voxels.
    pub points: usize,
}

impl CubeTopology {
    /// Computes the topology of a surface's voxels.
    ///
    /// # Errors
    /// [`Error::Cancelled`](crate::Error::Cancelled).
    pub fn of(surface: &VoxelSurface, control: &Control) -> Result<Self> {
        let grid = VertexGrid::new(surface);
        let euler = euler_characteristic(surface, &grid);
        control.check()?;
        let cavity = label_cavities(&grid, control)?;
        let mut lining = vec![0; cavity.count];
        let steps: Vec<isize> = neighbours().map(|offset| grid.step(offset)).collect();
        let mut seen = Vec::new();
        for voxel in surface.voxels() {
            let cell = grid.cell(voxel.map(i64::from));
            seen.clear();
            seen.extend(
                steps.iter().map(|&step| cavity.labels[cell.wrapping_add_signed(step)]).filter(|&c| c >= FIRST),
            );
            seen.sort_unstable();
            seen.dedup();
            seen.iter().for_each(|&label| lining[(label - FIRST) as usize] += 1);
        }
        let lining = lining.into_iter().max().unwrap_or(0);
        Ok(Self { euler, cavities: cavity.count, lining, points: surface.len() })
    }

    /// Returns whether the surface is closed, without an edge.
    pub fn is_closed(&self) -> bool {
        self.lining as f64 >= CLOSED_SHARE * self.points as f64 && self.lining > 0
    }
}

/// Returns χ of the union of closed cubes. Each cube has 27 cells (8 corners, 12 edges, 6 faces, itself), identified by
/// s ∈ {−1, 0, 1}³; the dimension of a cell is the number of zeros in s. Cell s is shared with the neighbours at {0,
/// s₁}×{0, s₂}×{0, s₃}, and counted by the first of these voxels.
fn euler_characteristic(surface: &VoxelSurface, grid: &VertexGrid) -> i64 {
    let offsets: Vec<[i64; 3]> = neighbours().collect();
    let steps: Vec<isize> = offsets.iter().map(|&offset| grid.step(offset)).collect();
    let shares = |s: [i64; 3], e: [i64; 3]| (0..3).all(|axis| e[axis] == 0 || e[axis] == s[axis]);
    let earlier = |s: [i64; 3]| {
        let bits = offsets.iter().enumerate().filter(|&(_, &e)| e < [0, 0, 0] && shares(s, e));
        bits.fold(0u32, |mask, (bit, _)| mask | 1 << bit)
    };
    let sign = |s: [i64; 3]| if s.iter().filter(|&&x| x == 0).count() % 2 == 0 { 1 } else { -1 };
    let cells: Vec<(u32, i64)> = offsets.iter().chain(&[[0, 0, 0]]).map(|&s| (earlier(s), sign(s))).collect();
    let present = |cell: usize| {
        let found = |&step: &isize| grid.cells()[cell.wrapping_add_signed(step)] != VertexGrid::NONE;
        steps.iter().enumerate().fold(0u32, |mask, (bit, step)| mask | u32::from(found(step)) << bit)
    };
    let count = |voxel: &[u32; 3]| {
        let present = present(grid.cell(voxel.map(i64::from)));
        cells.iter().filter(|&&(earlier, _)| present & earlier == 0).map(|&(_, sign)| sign).sum::<i64>()
    };
    surface.voxels().iter().map(count).sum()
}

const UNSEEN: u32 = 0;
const SURFACE: u32 = 1;
const OUTSIDE: u32 = 2;
const FIRST: u32 = 3; // the first cavity

struct Cavities {
    labels: Vec<u32>,
    count: usize,
}

/// Labels the 6-connected components of the complement of the surface.
fn label_cavities(grid: &VertexGrid, control: &Control) -> Result<Cavities> {
    let mut labels: Vec<u32> =
        grid.cells().iter().map(|&cell| if cell == VertexGrid::NONE { UNSEEN } else { SURFACE }).collect();
    let mut next = OUTSIDE; // cell 0 lies outside, because the box is padded
    let mut stack = Vec::new();
    let steps = DIRECT.map(|direction| grid.step(direction));
    let shape = grid.shape();
    for start in 0..labels.len() {
        if labels[start] != UNSEEN {
            continue;
        }
        labels[start] = next;
        stack.push(start);
        while let Some(cell) = stack.pop() {
            if stack.len() % (1 << 12) == 0 {
                control.check()?;
            }
            let place = grid.position(cell);
            for (direction, step) in DIRECT.iter().zip(steps) {
                let inside = (0..3).all(|axis| (0..shape[axis]).contains(&(place[axis] + direction[axis])));
                if inside {
                    let other = cell.wrapping_add_signed(step);
                    if labels[other] == UNSEEN {
                        labels[other] = next;
                        stack.push(other);
                    }
                }
            }
        }
        next += 1;
    }
    Ok(Cavities { labels, count: (next - FIRST) as usize })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::{masks, voxels};
    use crate::volume::Mask;
    use proptest::prelude::*;
    use std::collections::HashSet;

    fn surface_of(shape: [usize; 3], rule: impl Fn([usize; 3]) -> bool) -> VoxelSurface {
        voxels(&Mask::from_fn(shape, rule).unwrap(), [1.0; 3])
    }

    fn topology_of(shape: [usize; 3], rule: impl Fn([usize; 3]) -> bool) -> CubeTopology {
        CubeTopology::of(&surface_of(shape, rule), &Control::default()).unwrap()
    }

    #[test]
    fn known_shapes() {
        let ball = |[i, j, k]: [usize; 3]| [i, j, k].iter().map(|&x| (x as f64 - 10.0).powi(2)).sum::<f64>() < 64.0;
        let sphere = topology_of([21; 3], ball);
        assert_eq!((sphere.euler, sphere.cavities, sphere.is_closed()), (2, 1, true));

        let sheet = topology_of([12, 12, 5], |v| v[2] == 2);
        assert_eq!((sheet.euler, sheet.cavities, sheet.is_closed()), (1, 0, false));

        let annulus = topology_of([12, 12, 5], |v| v[2] == 2 && !((4..7).contains(&v[0]) && (4..7).contains(&v[1])));
        assert_eq!((annulus.euler, annulus.is_closed()), (0, false));

        let torus = topology_of([30, 30, 15], |v| {
            let [x, y, z] = [v[0] as f64 - 15.0, v[1] as f64 - 15.0, v[2] as f64 - 7.0];
            (x.hypot(y) - 9.0).hypot(z) < 4.0
        });
        assert_eq!((torus.euler, torus.cavities, torus.is_closed()), (0, 1, true));
    }

    #[test]
    fn a_pocket_in_a_sheet_does_not_close_it() {
        // a sheet with one bump three voxels thick, whose middle layer is enclosed: 34 of n² + 9 voxels line it
        for (n, is_closed) in [(40, false), (19, false), (18, true), (7, true)] {
            let is_bump = |v: [usize; 3]| (2..5).contains(&v[0]) && (2..5).contains(&v[1]) && (2..5).contains(&v[2]);
            let topology = topology_of([n, n, 7], |v| v[2] == 3 || is_bump(v));
            assert_eq!((topology.lining, topology.points, topology.cavities), (34, n * n + 9, 1));
            assert_eq!(topology.is_closed(), is_closed, "{n}");
        }
    }

    /// Returns χ by listing every cell of every cube.
    fn euler_by_listing(surface: &VoxelSurface) -> i64 {
        let mut cells = HashSet::new();
        for voxel in surface.voxels() {
            for n in 0..27 {
                let s = [n / 9 - 1, n / 3 % 3 - 1, n % 3 - 1];
                cells.insert(std::array::from_fn::<i64, 3, _>(|axis| 2 * i64::from(voxel[axis]) + s[axis]));
            }
        }
        let sign = |cell: &[i64; 3]| {
            if cell.iter().filter(|&&x| x % 2 == 0).count() % 2 == 0 { 1 } else { -1 }
        };
        cells.iter().map(sign).sum()
    }

    proptest! {
        #[test]
        fn euler_equals_the_count_of_all_cells(mask in masks([5; 3], 0.2..0.8)) {
            let surface = voxels(&mask, [1.0; 3]);
            let topology = CubeTopology::of(&surface, &Control::default()).unwrap();
            prop_assert_eq!(topology.euler, euler_by_listing(&surface));
        }
    }
}
