//! The surface where an image has a given value, between the voxels.

use nalgebra::Vector3;

use crate::error::{Error, Result};

/// An image and the value that it has on the surface: a probability of 0.5, say.
#[derive(Debug, Clone)]
pub struct Level {
    shape: [usize; 3],
    values: Vec<f32>,
    level: f32,
}

/// How far from its node the level is looked for, in voxels, and in how many steps.
const REACH: f64 = 1.0;
const STEPS: i32 = 8;

impl Level {
    /// An image (C order) and a value.
    pub fn new(shape: [usize; 3], values: Vec<f32>, level: f64) -> Result<Self> {
        let needed = shape.iter().product();
        if values.len() != needed {
            return Err(Error::ShapeMismatch { shape, given: values.len(), needed });
        }
        Ok(Self { shape, values, level: level as f32 })
    }

    /// The volume's shape.
    pub fn shape(&self) -> [usize; 3] {
        self.shape
    }

    /// Value minus level at a voxel; NaN outside the image.
    fn at(&self, voxel: [i64; 3]) -> f64 {
        let fits = (0..3).all(|axis| voxel[axis] >= 0 && (voxel[axis] as usize) < self.shape[axis]);
        if !fits {
            return f64::NAN;
        }
        let [i, j, k] = voxel.map(|x| x as usize);
        f64::from(self.values[(i * self.shape[1] + j) * self.shape[2] + k] - self.level)
    }

    /// Where between a voxel (0) and its neighbour (1) the level lies, if it does.
    pub fn between(&self, voxel: [i64; 3], neighbour: [i64; 3]) -> Option<f64> {
        let (a, b) = (self.at(voxel), self.at(neighbour));
        (a * b < 0.0).then(|| a / (a - b))
    }

    /// Value minus level between voxels, trilinear.
    fn trilinear(&self, place: Vector3<f64>) -> f64 {
        let low = place.map(f64::floor);
        let part = place - low;
        let mut sum = 0.0;
        for corner in 0..8 {
            let step = [corner & 1, corner >> 1 & 1, corner >> 2];
            let weight: f64 = (0..3).map(|a| if step[a] == 1 { part[a] } else { 1.0 - part[a] }).product();
            if weight > 0.0 {
                sum += weight * self.at(std::array::from_fn(|a| low[a] as i64 + step[a]));
            }
        }
        sum
    }

    /// How far along `direction` (voxels) from `place` (voxel indices) the image has the level: the nearest such place within
    /// one length of `direction`, if there is one.
    pub fn along(&self, place: Vector3<f64>, direction: Vector3<f64>) -> Option<f64> {
        let value = |step: i32| self.trilinear(place + direction * (REACH * f64::from(step) / f64::from(STEPS)));
        let values: Vec<f64> = (-STEPS..=STEPS).map(value).collect();
        let crossing = |n: usize| {
            let (a, b) = (values[n], values[n + 1]);
            let start = f64::from(n as i32 - STEPS);
            (a * b <= 0.0 && a != b).then(|| REACH * (start + a / (a - b)) / f64::from(STEPS))
        };
        (0..values.len() - 1).filter_map(crossing).min_by(|a, b| a.abs().total_cmp(&b.abs()))
    }
}
