//! Surface voxels of a label volume.
//!
//! Grossmann, Kiryati, Kimmel (2002), section 2.2: a foreground voxel belongs to the digital surface if at least one of
//! its six direct neighbours is background. Voxels outside the volume are background.

pub mod cubes;
pub mod graph;
pub mod level;
pub mod nodes;
mod positions;
pub mod repair;
pub mod sheets;
pub mod surfels;
pub mod voxelmesh;

use nalgebra::Vector3;

use crate::volume::{Affine, Mask};
use crate::{Control, Error, Result};

/// The offsets to the six direct neighbours.
pub(crate) const DIRECT: [[i64; 3]; 6] = [[-1, 0, 0], [0, -1, 0], [0, 0, -1], [0, 0, 1], [0, 1, 0], [1, 0, 0]];

/// Iterates over the 26 neighbours in lexicographic order, without the centre.
pub(crate) fn neighbours() -> impl Iterator<Item = [i64; 3]> {
    (0..27).filter(|&n| n != 13).map(|n| [n / 9 - 1, n / 3 % 3 - 1, n % 3 - 1])
}

/// The surface voxels of a volume in Morton order, in which neighbours in space are mostly neighbours in memory.
#[derive(Debug, Clone)]
pub struct VoxelSurface {
    shape: [usize; 3],
    affine: Affine,
    voxels: Vec<[u32; 3]>,
    outward: Vec<[i8; 3]>,
}

impl VoxelSurface {
    /// Extracts the surface of the mask's foreground, including all components.
    ///
    /// # Errors
    /// [`Error::VoxelTooFar`] and [`Error::Cancelled`].
    pub fn from_mask(mask: &Mask, affine: Affine, control: &Control) -> Result<Self> {
        affine.check_reach(mask.shape())?;
        let on_surface = |v: [i64; 3]| DIRECT.iter().any(|&d| !mask.is_inside(plus(v, d)));
        let mut coded = Vec::new();
        for (count, voxel) in mask.foreground().enumerate() {
            if count % (1 << 16) == 0 {
                control.check()?;
            }
            if on_surface(voxel) {
                coded.push((morton_code(voxel.map(|x| x as u32)), voxel));
            }
        }
        coded.sort_unstable_by_key(|&(code, _)| code);
        let voxels = coded.iter().map(|&(_, voxel)| voxel.map(|x| x as u32)).collect();
        let outward = coded.iter().map(|&(_, voxel)| background_direction(mask, voxel)).collect();
        Ok(Self { shape: mask.shape(), affine, voxels, outward })
    }

    /// Returns the voxels for which `keep` is true. Panics if the number of values differs from the number of voxels.
    pub(crate) fn subset(&self, keep: &[bool]) -> Self {
        assert_eq!(keep.len(), self.voxels.len(), "one value per voxel");
        let kept = || (0..keep.len()).filter(|&v| keep[v]);
        Self {
            shape: self.shape,
            affine: self.affine,
            voxels: kept().map(|v| self.voxels[v]).collect(),
            outward: kept().map(|v| self.outward[v]).collect(),
        }
    }

    /// Returns the memory of surface voxels in bytes: three indices and an outward direction of three bytes.
    pub(crate) const fn memory_need(voxels: usize) -> u64 {
        (12 + 3) * voxels as u64
    }

    /// Returns the number of surface voxels.
    pub fn len(&self) -> usize {
        self.voxels.len()
    }

    /// Returns whether there are no voxels.
    pub fn is_empty(&self) -> bool {
        self.voxels.is_empty()
    }

    /// Returns the shape of the volume.
    pub fn shape(&self) -> [usize; 3] {
        self.shape
    }

    /// Returns the transform from voxel indices to mm.
    pub(crate) fn affine(&self) -> &Affine {
        &self.affine
    }

    /// Returns the indices (i, j, k) of the voxels.
    pub fn voxels(&self) -> &[[u32; 3]] {
        &self.voxels
    }

    /// Returns the centres of the voxels in mm (RAS+).
    pub fn points(&self) -> Vec<Vector3<f64>> {
        self.voxels.iter().map(|voxel| self.affine.to_mm(voxel.map(f64::from))).collect()
    }

    /// Returns the direction from a voxel to the background around it in mm, not normalised: the sum of the offsets to
    /// its background 26-neighbours. Zero where opposite sides are background (a sheet one voxel thick).
    pub(crate) fn outward(&self, vertex: usize) -> Vector3<f64> {
        let spacing = self.affine.spacing();
        let offset = Vector3::from_fn(|axis, _| f64::from(self.outward[vertex][axis]) / spacing[axis].powi(2));
        self.affine.linear() * offset // normals transform by the inverse transpose of the affine's linear part
    }

    /// Returns the number of the vertex at a voxel.
    ///
    /// # Errors
    /// [`Error::NotOnSurface`], which names the nearest surface voxel.
    pub fn find(&self, voxel: [i64; 3]) -> Result<usize> {
        let fits = (0..3).all(|axis| voxel[axis] >= 0 && (voxel[axis] as usize) < self.shape[axis]);
        if fits {
            let code = morton_code(voxel.map(|x| x as u32));
            if let Ok(vertex) = self.voxels.binary_search_by_key(&code, |&v| morton_code(v)) {
                return Ok(vertex);
            }
        }
        Err(Error::NotOnSurface { voxel, nearest: self.voxels[self.nearest(voxel).0] })
    }

    /// Returns the nearest surface voxel to a voxel, and its distance in mm; the first of several.
    pub fn nearest(&self, voxel: [i64; 3]) -> (usize, f64) {
        let place = self.affine.to_mm(voxel.map(|x| x as f64));
        let distances = self.points().into_iter().map(|point| (point - place).norm());
        distances.enumerate().fold((0, f64::INFINITY), |best, next| if next.1 < best.1 { next } else { best })
    }
}

fn plus(a: [i64; 3], b: [i64; 3]) -> [i64; 3] {
    std::array::from_fn(|axis| a[axis] + b[axis])
}

fn background_direction(mask: &Mask, voxel: [i64; 3]) -> [i8; 3] {
    let open = DIRECT.map(|direction| !mask.is_inside(plus(voxel, direction)));
    let mut sum = [0i8; 3];
    if (0..3).any(|axis| open[axis] && open[5 - axis]) {
        return sum; // opposite sides
    }
    for offset in neighbours().filter(|&offset| !mask.is_inside(plus(voxel, offset))) {
        for axis in 0..3 {
            sum[axis] += offset[axis] as i8;
        }
    }
    sum
}

/// Interleaves the bits of three 21-bit indices.
fn morton_code(voxel: [u32; 3]) -> u64 {
    let spread = |x: u32| {
        let mut x = u64::from(x) & 0x1f_ffff;
        x = (x | x << 32) & 0x001f_0000_0000_ffff;
        x = (x | x << 16) & 0x001f_0000_ff00_00ff;
        x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
        x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
        (x | x << 2) & 0x1249_2492_4924_9249
    };
    spread(voxel[0]) << 2 | spread(voxel[1]) << 1 | spread(voxel[2])
}

/// The vertex at each voxel of the surface's bounding box, which is padded by one empty voxel.
#[derive(Debug)]
pub(crate) struct VertexGrid {
    origin: [i64; 3],
    shape: [i64; 3],
    cells: Vec<u32>,
}

impl VertexGrid {
    pub(crate) const NONE: u32 = u32::MAX;

    pub(crate) fn new(surface: &VoxelSurface) -> Self {
        let mut low = [i64::MAX; 3];
        let mut high = [i64::MIN; 3];
        for voxel in surface.voxels() {
            for axis in 0..3 {
                low[axis] = low[axis].min(i64::from(voxel[axis]));
                high[axis] = high[axis].max(i64::from(voxel[axis]));
            }
        }
        let origin = low.map(|x| x - 1);
        let shape: [i64; 3] = std::array::from_fn(|axis| high[axis] - low[axis] + 3);
        let mut grid = Self { origin, shape, cells: vec![Self::NONE; shape.iter().product::<i64>() as usize] };
        for (vertex, voxel) in surface.voxels().iter().enumerate() {
            let cell = grid.cell(voxel.map(i64::from));
            grid.cells[cell] = vertex as u32;
        }
        grid
    }

    pub(crate) fn cells(&self) -> &[u32] {
        &self.cells
    }

    /// Returns the cell of a voxel of the padded box.
    pub(crate) fn cell(&self, voxel: [i64; 3]) -> usize {
        let [i, j, k]: [i64; 3] = std::array::from_fn(|axis| voxel[axis] - self.origin[axis]);
        ((i * self.shape[1] + j) * self.shape[2] + k) as usize
    }

    /// Returns the difference between the cells of two neighbours.
    pub(crate) fn step(&self, offset: [i64; 3]) -> isize {
        ((offset[0] * self.shape[1] + offset[1]) * self.shape[2] + offset[2]) as isize
    }

    pub(crate) fn position(&self, cell: usize) -> [i64; 3] {
        let cell = cell as i64;
        [cell / (self.shape[1] * self.shape[2]), cell / self.shape[2] % self.shape[1], cell % self.shape[2]]
    }

    pub(crate) fn shape(&self) -> [i64; 3] {
        self.shape
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::{masks, voxels};
    use proptest::prelude::*;

    fn surface_of(shape: [usize; 3], rule: impl Fn([usize; 3]) -> bool) -> VoxelSurface {
        voxels(&Mask::from_fn(shape, rule).unwrap(), [1.0, 2.0, 3.0])
    }

    #[test]
    fn outward_points_to_the_background() {
        let surface = surface_of([7, 7, 7], |v| v.iter().all(|&x| (1..6).contains(&x)));
        let top = surface.find([3, 3, 5]).unwrap();
        let normal = surface.outward(top);
        assert_eq!((normal.x, normal.y), (0.0, 0.0));
        assert!(normal.z > 0.0);
        let sheet = surface_of([7, 7, 7], |v| v[2] == 3);
        assert_eq!(sheet.outward(sheet.find([3, 3, 3]).unwrap()), Vector3::zeros());
    }

    #[test]
    fn a_missing_voxel_is_answered_with_the_nearest() {
        let surface = surface_of([7, 7, 7], |v| v[2] == 3);
        let nearest = [3, 3, 3];
        assert_eq!(surface.find([3, 3, 5]), Err(Error::NotOnSurface { voxel: [3, 3, 5], nearest }));
        assert!(matches!(surface.find([-1, 3, 3]), Err(Error::NotOnSurface { .. })));
        assert_eq!(surface.nearest([3, 3, 5]).1, 6.0);
    }

    proptest! {
        #[test]
        fn surface_voxels_are_those_with_a_background_neighbour(mask in masks([3, 4, 5], 0.2..0.8)) {
            let surface = voxels(&mask, [1.0; 3]);
            for voxel in mask.foreground() {
                let expected = DIRECT.iter().any(|&d| !mask.is_inside(plus(voxel, d)));
                prop_assert_eq!(surface.find(voxel).is_ok(), expected);
            }
            prop_assert!(surface.voxels().iter().all(|v| mask.is_inside(v.map(i64::from))));
            for (vertex, voxel) in surface.voxels().iter().enumerate() {
                prop_assert_eq!(surface.find(voxel.map(i64::from)).unwrap(), vertex);
            }
        }
    }
}
