//! Iso-level: the surface between voxels at which an image has a given value.

use nalgebra::Vector3;

use crate::{Error, Result};

/// An image, and its value at the surface, such as a probability of 0.5.
#[derive(Debug, Clone)]
pub struct Level {
    shape: [usize; 3],
    values: Vec<f32>,
    level: f32,
}

/// How far from its node the level is searched, in voxels, and the number of steps.
const REACH: f64 = 1.0;
const STEPS: i32 = 8;

impl Level {
    /// Creates a level from an image (C order) and a value.
    ///
    /// # Errors
    /// [`Error::ShapeMismatch`] if there is not one value per voxel.
    pub fn new(shape: [usize; 3], values: Vec<f32>, level: f64) -> Result<Self> {
        let needed = shape.iter().product();
        if values.len() != needed {
            return Err(Error::ShapeMismatch { shape, given: values.len(), needed });
        }
        Ok(Self { shape, values, level: level as f32 })
    }

    /// Returns the shape of the volume.
    pub(crate) fn shape(&self) -> [usize; 3] {
        self.shape
    }

    /// Returns the value minus the level at a voxel; NaN outside the image.
    fn at(&self, voxel: [i64; 3]) -> f64 {
        let fits = (0..3).all(|axis| voxel[axis] >= 0 && (voxel[axis] as usize) < self.shape[axis]);
        if !fits {
            return f64::NAN;
        }
        let [i, j, k] = voxel.map(|x| x as usize);
        f64::from(self.values[(i * self.shape[1] + j) * self.shape[2] + k] - self.level)
    }

    /// Returns the position of the level between a voxel (0) and its neighbour (1), if it lies there.
    pub(crate) fn between(&self, voxel: [i64; 3], neighbour: [i64; 3]) -> Option<f64> {
        let (a, b) = (self.at(voxel), self.at(neighbour));
        // linear interpolation: the zero of a + t (b − a)
        (a * b < 0.0).then(|| a / (a - b))
    }

    /// Returns the trilinear value between voxels minus the level.
    fn trilinear(&self, place: Vector3<f64>) -> f64 {
        let low = place.map(f64::floor);
        let part = place - low;
        let mut sum = 0.0;
        for corner in 0..8 {
            let step = [corner & 1, corner >> 1 & 1, corner >> 2];
            let weight: f64 = (0..3).map(|a| if step[a] == 1 { part[a] } else { 1.0 - part[a] }).product();
            // corners without weight may lie outside the image, where values are NaN
            if weight > 0.0 {
                sum += weight * self.at(std::array::from_fn(|a| low[a] as i64 + step[a]));
            }
        }
        sum
    }

    /// Returns the distance along `direction` (voxels) from `place` (voxel indices) at which the image has the level,
    /// in units of its length: the nearest one within one length, if there is one.
    pub(crate) fn along(&self, place: Vector3<f64>, direction: Vector3<f64>) -> Option<f64> {
        let value = |step: i32| self.trilinear(place + direction * (REACH * f64::from(step) / f64::from(STEPS)));
        let values: Vec<f64> = (-STEPS..=STEPS).map(value).collect();
        let crossing = |n: usize| {
            let (a, b) = (values[n], values[n + 1]);
            let start = f64::from(n as i32 - STEPS);
            // one step of regula falsi between two samples
            (a * b <= 0.0 && a != b).then(|| REACH * (start + a / (a - b)) / f64::from(STEPS))
        };
        (0..values.len() - 1).filter_map(crossing).min_by(|a, b| a.abs().total_cmp(&b.abs()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_level_of_a_linear_image_is_where_the_function_has_it() {
        let function = |p: Vector3<f64>| 2.0 * p.x - 1.0 * p.y + 0.5 * p.z;
        let value = |n: usize| function(Vector3::new((n / 20) as f64, (n / 5 % 4) as f64, (n % 5) as f64)) as f32;
        let image = Level::new([3, 4, 5], (0..60).map(value).collect(), 0.6).unwrap();
        let near = |found: Option<f64>, expected: f64| assert!((found.unwrap() - expected).abs() < 1e-6, "{found:?}");
        near(image.between([0, 0, 0], [1, 0, 0]), 0.3);
        near(image.between([1, 0, 0], [0, 0, 0]), 0.7);
        near(image.between([1, 2, 1], [1, 1, 1]), 0.1);
        assert_eq!(image.between([1, 0, 0], [2, 0, 0]), None);
        assert_eq!(image.between([0, 0, 0], [-1, 0, 0]), None);
        let (place, direction) = (Vector3::new(0.9, 1.2, 2.3), Vector3::new(-0.4, 0.7, 0.2));
        near(image.along(place, direction), (0.6 - function(place)) / function(direction));
        assert_eq!(image.along(place, direction * 0.1), None);
    }

    #[test]
    fn the_nearest_of_several_crossings_counts() {
        // the image has the level at x = 1.5 and at x = 2.5
        let image = Level::new([5, 1, 1], vec![1.0, 1.0, -1.0, 1.0, 1.0], 0.0).unwrap();
        for (x, expected) in [(1.8, -0.3), (2.1, 0.4), (2.4, 0.1), (1.6, -0.1), (1.2, 0.3), (2.7, -0.2)] {
            let found = image.along(Vector3::new(x, 0.0, 0.0), Vector3::x()).unwrap();
            assert!((found - expected).abs() < 1e-6, "{x} {found}");
        }
    }
}
