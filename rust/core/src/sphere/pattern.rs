//! The pattern of folds at several scales, comparable between meshes of any density.
//!
//! The surface is smoothed by repeated averaging over triangles, more often for larger scales. The depth of a point at
//! a scale is how far it lies inwards of its smoothed position, along the smoothed surface's normal. It is positive in
//! sulci, like FreeSurfer's `sulc`, which is computed by inflation. The depth is then smoothed itself, by half the
//! scale. Lengths are in units in which the root mean square distance of the surface from its centre is [`RADIUS`],
//! which is about mm for an adult's hemisphere. Depths have mean 0 and standard deviation 1; outliers are limited.

use nalgebra::Vector3;

use crate::surface::{Surface, mesh::vertex_normals};
use crate::{Control, Result};

/// The root mean square distance from the centre, in the units of the scales.
pub const RADIUS: f64 = 50.0;

/// The standard deviations of the smoothing for the depths.
pub const SCALES: [f64; 3] = [24.0, 12.0, 6.0];

/// The standard deviation of the smoothing of positions.
const PLACES: f64 = 8.0;

/// The pattern at each vertex.
#[derive(Debug, Clone, PartialEq)]
pub struct Pattern {
    /// Depths for each scale.
    pub depths: Vec<Vec<f64>>,
    /// The position on the smoothed surface relative to the centre, in units of [`RADIUS`] · root mean square distance.
    pub places: Vec<Vector3<f64>>,
    /// The area around it, a third of that of its triangles; the total is 1.
    pub areas: Vec<f64>,
}

/// Computes the pattern of a closed surface.
pub fn pattern(surface: &Surface, control: &Control) -> Result<Pattern> {
    let smoothing = Smoothing::new(surface.points(), surface.faces());
    let areas = smoothing.areas.clone();
    let centre: Vector3<f64> = surface.points().iter().zip(&areas).map(|(p, area)| p * *area).sum();
    let spread: f64 = surface.points().iter().zip(&areas).map(|(p, area)| (p - centre).norm_squared() * area).sum();
    let unit = RADIUS / spread.sqrt();
    let points: Vec<Vector3<f64>> = surface.points().iter().map(|p| (p - centre) * unit).collect();
    let step = smoothing.step * unit * unit; // variance of one average
    let mut depths = Vec::new();
    for scale in SCALES {
        let smooth = smoothing.smoothed(&points, scale, step, control)?;
        let normals = vertex_normals(&smooth, surface.faces());
        let depth: Vec<f64> = (0..points.len()).map(|v| (smooth[v] - points[v]).dot(&normals[v])).collect();
        let depth: Vec<Vector3<f64>> = depth.into_iter().map(|d| Vector3::new(d, 0.0, 0.0)).collect();
        let depth = smoothing.smoothed(&depth, scale / 2.0, step, control)?;
        depths.push(standard(&depth.iter().map(|d| d.x).collect::<Vec<_>>(), &areas));
    }
    Ok(Pattern { depths, places: smoothing.smoothed(&points, PLACES, step, control)?, areas })
}

/// Standardises values to mean 0 and standard deviation 1, and limits those beyond two.
pub(crate) fn standard(values: &[f64], areas: &[f64]) -> Vec<f64> {
    let total: f64 = areas.iter().sum();
    let mut values = values.to_vec();
    for draw_in in [true, false] {
        let mean: f64 = values.iter().zip(areas).map(|(x, area)| x * area).sum::<f64>() / total;
        let variance: f64 = values.iter().zip(areas).map(|(x, area)| (x - mean).powi(2) * area).sum::<f64>() / total;
        let deviation = variance.sqrt().max(f64::MIN_POSITIVE);
        for x in &mut values {
            let z = (*x - mean) / deviation;
            *x = if draw_in { 2.0 * (z / 2.0).tanh() } else { z };
        }
    }
    values
}

/// Averages over the triangles around each vertex, weighted by their areas.
#[derive(Debug, Clone)]
pub(crate) struct Smoothing {
    starts: Vec<u32>,
    neighbours: Vec<(u32, f64)>,
    pub(crate) areas: Vec<f64>,
    /// The variance along each axis of the surface that one average adds.
    pub(crate) step: f64,
}

impl Smoothing {
    pub(crate) fn new(points: &[Vector3<f64>], faces: &[[u32; 3]]) -> Self {
        let area = |face: &[u32; 3]| {
            let [a, b, c] = face.map(|v| points[v as usize]);
            0.5 * (b - a).cross(&(c - a)).norm()
        };
        let sizes: Vec<f64> = faces.iter().map(area).collect();
        let total: f64 = sizes.iter().sum();
        let mut around: Vec<Vec<(u32, f64)>> = vec![Vec::new(); points.len()];
        for (face, size) in faces.iter().zip(&sizes) {
            for &v in face {
                for &w in face {
                    match around[v as usize].iter_mut().find(|entry| entry.0 == w) {
                        Some(entry) => entry.1 += size,
                        None => around[v as usize].push((w, *size)),
                    }
                }
            }
        }
        let (mut starts, mut neighbours, mut areas, mut step) = (vec![0], Vec::new(), Vec::new(), 0.0);
        for (v, entries) in around.into_iter().enumerate() {
            let sum: f64 = entries.iter().map(|entry| entry.1).sum::<f64>().max(f64::MIN_POSITIVE);
            for (w, weight) in entries {
                neighbours.push((w, weight / sum));
                step += (points[w as usize] - points[v]).norm_squared() * weight / total / 9.0;
            }
            areas.push(sum / total / 9.0);
            starts.push(neighbours.len() as u32);
        }
        let whole: f64 = areas.iter().sum::<f64>().max(f64::MIN_POSITIVE);
        areas.iter_mut().for_each(|area| *area /= whole);
        Self { starts, neighbours, areas, step: step / whole / 2.0 }
    }

    fn averaged(&self, values: &[Vector3<f64>], into: &mut Vec<Vector3<f64>>) {
        into.clear();
        into.extend(self.starts.windows(2).map(|ends| {
            let entries = &self.neighbours[ends[0] as usize..ends[1] as usize];
            entries.iter().map(|&(w, weight)| values[w as usize] * weight).sum::<Vector3<f64>>()
        }));
    }

    /// Averages as often as a scale requires, where each average adds a variance of `step`.
    pub(crate) fn smoothed(
        &self, values: &[Vector3<f64>], scale: f64, step: f64, control: &Control,
    ) -> Result<Vec<Vector3<f64>>> {
        let averages = (scale * scale / step.max(1e-9)).round().clamp(1.0, 4000.0) as usize;
        self.times(values, averages, control)
    }

    pub(crate) fn times(
        &self, values: &[Vector3<f64>], averages: usize, control: &Control,
    ) -> Result<Vec<Vector3<f64>>> {
        let (mut now, mut then) = (values.to_vec(), Vec::with_capacity(values.len()));
        for _ in 0..averages {
            control.check()?;
            self.averaged(&now, &mut then);
            std::mem::swap(&mut now, &mut then);
        }
        Ok(now)
    }
}
