//! The input: a binary volume and its position in space.

use nalgebra::{Matrix3, Vector3};

use crate::scales::{SMALLEST, is_near};
use crate::{Error, Result};

/// Indices along an axis fit into 21 bits, so that three of them fit into one 64-bit Morton code.
const LONGEST_AXIS: usize = 1 << 21;

/// A binary volume of foreground and background voxels. The first index varies slowest (C order).
#[derive(Debug, Clone)]
pub struct Mask {
    shape: [usize; 3],
    inside: Vec<bool>,
}

impl Mask {
    /// Creates a mask from its values in C order.
    ///
    /// # Errors
    /// [`Error::VolumeTooLarge`], [`Error::ShapeMismatch`] if there is not one value per voxel, and
    /// [`Error::EmptyForeground`].
    pub fn new(shape: [usize; 3], inside: Vec<bool>) -> Result<Self> {
        if shape.iter().any(|&n| n > LONGEST_AXIS) {
            return Err(Error::VolumeTooLarge { shape });
        }
        let needed = shape.iter().try_fold(1usize, |product, &n| product.checked_mul(n));
        let needed = needed.ok_or(Error::VolumeTooLarge { shape })?;
        if needed != inside.len() {
            return Err(Error::ShapeMismatch { shape, given: inside.len(), needed });
        }
        if !inside.contains(&true) {
            return Err(Error::EmptyForeground { shape });
        }
        Ok(Self { shape, inside })
    }

    /// Creates a mask from a rule over voxel indices.
    ///
    /// # Errors
    /// [`Error::VolumeTooLarge`] and [`Error::EmptyForeground`].
    pub fn from_fn(shape: [usize; 3], rule: impl Fn([usize; 3]) -> bool) -> Result<Self> {
        let mut inside = Vec::with_capacity(shape.iter().product());
        for i in 0..shape[0] {
            for j in 0..shape[1] {
                for k in 0..shape[2] {
                    inside.push(rule([i, j, k]));
                }
            }
        }
        Self::new(shape, inside)
    }

    /// Returns the number of voxels along each axis.
    pub fn shape(&self) -> [usize; 3] {
        self.shape
    }

    /// Returns whether each voxel is foreground, in C order.
    pub fn values(&self) -> &[bool] {
        &self.inside
    }

    /// Returns whether a voxel is foreground. Voxels outside the volume are background.
    #[inline]
    pub(crate) fn is_inside(&self, [i, j, k]: [i64; 3]) -> bool {
        let [ni, nj, nk] = self.shape;
        let fits = |x: i64, n: usize| x >= 0 && (x as usize) < n;
        fits(i, ni) && fits(j, nj) && fits(k, nk) && self.inside[(i as usize * nj + j as usize) * nk + k as usize]
    }

    /// Iterates over the indices of the foreground voxels in C order.
    pub(crate) fn foreground(&self) -> impl Iterator<Item = [i64; 3]> + '_ {
        let [_, nj, nk] = self.shape.map(|n| n as i64);
        let index = move |flat: usize| {
            let flat = flat as i64;
            [flat / (nj * nk), flat / nk % nj, flat % nk]
        };
        self.inside.iter().enumerate().filter(|&(_, &inside)| inside).map(move |(flat, _)| index(flat))
    }
}

/// A transform from voxel indices to millimetres (RAS+): x = linear · (i, j, k) + translation, with orthogonal axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Affine {
    linear: Matrix3<f64>,
    translation: Vector3<f64>,
    spacing: [f64; 3],
}

impl Affine {
    /// The largest cosine between two axes that is attributed to rounding.
    const SHEAR: f64 = 1e-3;

    /// Creates the transform from a homogeneous 4 × 4 matrix.
    ///
    /// # Errors
    /// [`Error::AffineNotFinite`], [`Error::AffineTooFar`], [`Error::AffineNotAffine`], [`Error::SpacingNotPositive`],
    /// [`Error::SpacingTooSmall`], and [`Error::AffineSheared`].
    pub fn new(matrix: [[f64; 4]; 4]) -> Result<Self> {
        let entries = || (0..16).map(|n| (n / 4, n % 4, matrix[n / 4][n % 4]));
        if let Some((row, column, value)) = entries().find(|(.., value)| !value.is_finite()) {
            return Err(Error::AffineNotFinite { row, column, value });
        }
        if let Some((row, column, value)) = entries().find(|&(.., value)| !is_near(value)) {
            return Err(Error::AffineTooFar { row, column, value });
        }
        if matrix[3] != [0.0, 0.0, 0.0, 1.0] {
            return Err(Error::AffineNotAffine { row: matrix[3] });
        }
        let linear = Matrix3::from_fn(|r, c| matrix[r][c]);
        let translation = Vector3::from_fn(|r, _| matrix[r][3]);
        let spacing: [f64; 3] = std::array::from_fn(|axis| linear.column(axis).norm());
        for axis in 0..3 {
            if !(spacing[axis] > 0.0 && spacing[axis].is_finite()) {
                return Err(Error::SpacingNotPositive { axis, spacing: spacing[axis] });
            }
            if spacing[axis] < SMALLEST {
                return Err(Error::SpacingTooSmall { axis, spacing: spacing[axis] });
            }
        }
        for (first, second) in [(0, 1), (0, 2), (1, 2)] {
            let cosine = linear.column(first).dot(&linear.column(second)) / (spacing[first] * spacing[second]);
            if cosine.abs() > Self::SHEAR {
                return Err(Error::AffineSheared { first, second, cosine });
            }
        }
        Ok(Self { linear, translation, spacing })
    }

    /// Creates an axis-aligned transform with the origin at voxel 0.
    ///
    /// # Errors
    /// [`Error::SpacingNotPositive`], and the errors of [`Affine::new`].
    pub fn from_spacing(spacing: [f64; 3]) -> Result<Self> {
        if let Some(axis) = (0..3).find(|&axis| spacing[axis] <= 0.0) {
            return Err(Error::SpacingNotPositive { axis, spacing: spacing[axis] });
        }
        let [x, y, z] = spacing;
        Self::new([[x, 0.0, 0.0, 0.0], [0.0, y, 0.0, 0.0], [0.0, 0.0, z, 0.0], [0.0, 0.0, 0.0, 1.0]])
    }

    /// Returns the distance between neighbouring voxel centres along each axis, in mm.
    pub fn spacing(&self) -> [f64; 3] {
        self.spacing
    }

    /// Returns the 3 × 3 linear part.
    pub(crate) fn linear(&self) -> &Matrix3<f64> {
        &self.linear
    }

    /// Checks that all voxels of a volume lie within the supported range of coordinates.
    pub(crate) fn check_reach(&self, shape: [usize; 3]) -> Result<()> {
        for corner in 0..8 {
            let voxel = [0, 1, 2].map(|axis| if corner >> axis & 1 == 0 { 0 } else { shape[axis].saturating_sub(1) });
            let at: [f64; 3] = self.to_mm(voxel.map(|index| index as f64)).into();
            if !at.into_iter().all(is_near) {
                return Err(Error::VoxelTooFar { voxel, at });
            }
        }
        Ok(())
    }

    /// Returns the position of a voxel's centre in mm.
    pub(crate) fn to_mm(self, voxel: [f64; 3]) -> Vector3<f64> {
        self.linear * Vector3::from(voxel) + self.translation
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn foreground_comes_in_c_order() {
        let mask = Mask::from_fn([2, 3, 4], |[i, j, k]| (i + j + k) % 2 == 1).unwrap();
        let listed: Vec<_> = mask.foreground().collect();
        assert!(listed.is_sorted());
        assert!(listed.iter().all(|&voxel| mask.is_inside(voxel) && voxel.iter().sum::<i64>() % 2 == 1));
        assert_eq!(listed.len(), 12);
    }

    #[test]
    fn outside_the_volume_is_background() {
        let mask = Mask::new([1, 1, 1], vec![true]).unwrap();
        assert!(mask.is_inside([0, 0, 0]));
        for voxel in [[-1, 0, 0], [0, -1, 0], [0, 0, 1], [1, 0, 0]] {
            assert!(!mask.is_inside(voxel));
        }
    }

    #[test]
    fn bad_volumes_are_refused() {
        assert!(matches!(Mask::new([2, 2, 2], vec![true; 7]), Err(Error::ShapeMismatch { given: 7, needed: 8, .. })));
        assert!(matches!(Mask::new([2, 2, 2], vec![false; 8]), Err(Error::EmptyForeground { .. })));
        assert!(matches!(Mask::new([1 << 22, 1, 1], vec![]), Err(Error::VolumeTooLarge { .. })));
        assert!(matches!(Mask::new([0, 2, 2], vec![]), Err(Error::EmptyForeground { .. })));
    }

    #[test]
    fn voxels_beyond_reach_are_refused() {
        let affine = Affine::from_spacing([1e10, 1.0, 1.0]).unwrap();
        assert!(affine.check_reach([11, 5, 5]).is_ok());
        assert_eq!(
            affine.check_reach([12, 1, 1]),
            Err(Error::VoxelTooFar { voxel: [11, 0, 0], at: [1.1e11, 0.0, 0.0] })
        );
    }

    #[test]
    fn bad_affines_are_refused() {
        assert!(matches!(Affine::from_spacing([1.0, -2.0, 1.0]), Err(Error::SpacingNotPositive { axis: 1, .. })));
        assert!(matches!(Affine::from_spacing([1.0, 1.0, 0.0]), Err(Error::SpacingNotPositive { axis: 2, .. })));
        assert!(matches!(Affine::from_spacing([f64::NAN, 1.0, 1.0]), Err(Error::AffineNotFinite { .. })));
        assert!(matches!(Affine::from_spacing([1.0, 1e19, 1.0]), Err(Error::AffineTooFar { row: 1, column: 1, .. })));
        assert!(matches!(Affine::from_spacing([1.0, 1.0, 1e-10]), Err(Error::SpacingTooSmall { axis: 2, .. })));
        let mut sheared = [[1.0, 0.1, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
        assert!(matches!(Affine::new(sheared), Err(Error::AffineSheared { first: 0, second: 1, .. })));
        sheared[3][3] = 2.0;
        assert!(matches!(Affine::new(sheared), Err(Error::AffineNotAffine { .. })));
    }
}
