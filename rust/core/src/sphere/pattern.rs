//! The pattern of folds at several scales, comparable between meshes of any density.
//!
//! The surface is smoothed by repeated averaging over triangles, more often for larger scales. The depth of a point at
//! a scale is how far it lies inwards of its smoothed position, along the smoothed surface's normal. It is positive in
//! sulci, like FreeSurfer's `sulc`, which is computed by inflation. The depth is then smoothed itself, by half the
//! scale. Lengths are in units in which the root mean square distance of the surface from its centre is [`RADIUS`],
//! which is about mm for an adult's hemisphere. Depths have mean 0 and standard deviation 1; outliers are limited.

use nalgebra::Vector3;

use crate::surface::{Surface, mesh::normals};
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
///
/// # Errors
/// [`Error::Cancelled`](crate::Error::Cancelled).
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
        let normals = normals(&smooth, surface.faces());
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
            // tanh limits to ±2 and hardly changes small values; standardised again afterwards
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
                // mean square of a step weighted by area: a triangle's area counts for nine pairs of corners
                step += (points[w as usize] - points[v]).norm_squared() * weight / total / 9.0;
            }
            areas.push(sum / total / 9.0);
            starts.push(neighbours.len() as u32);
        }
        let whole: f64 = areas.iter().sum::<f64>().max(f64::MIN_POSITIVE);
        areas.iter_mut().for_each(|area| *area /= whole);
        // half of the mean square distance in the surface is along each of its two axes
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
        // variances of successive averages add up
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::mesh::shapes;

    /// Returns a Legendre polynomial.
    fn legendre(degree: usize, x: f64) -> f64 {
        let next = |[before, here]: [f64; 2], n: usize| {
            [here, ((2 * n + 1) as f64 * x * here - n as f64 * before) / (n + 1) as f64]
        };
        (0..degree).fold([0.0, 1.0], next)[1]
    }

    /// Returns how much of a Legendre polynomial of z is in values on the unit sphere.
    fn amplitude(sphere: &Surface, areas: &[f64], values: &[f64], degree: usize) -> f64 {
        let (mut product, mut square) = (0.0, 0.0);
        for ((p, area), value) in sphere.points().iter().zip(areas).zip(values) {
            product += area * value * legendre(degree, p.z);
            square += area * legendre(degree, p.z).powi(2);
        }
        product / square
    }

    /// Returns the share of a wave that diffusion to this variance leaves on the unit sphere.
    fn left(degree: f64, variance: f64) -> f64 {
        (-0.5 * degree * (degree + 1.0) * variance).exp()
    }

    #[test]
    fn smoothing_leaves_the_share_of_waves_that_diffusion_does() {
        let sphere = shapes::surface(shapes::sphere(5));
        let smoothing = Smoothing::new(sphere.points(), sphere.faces());
        for (degree, scale) in [(3, 0.4f64), (6, 0.2), (6, 0.3)] {
            let wave: Vec<Vector3<f64>> =
                sphere.points().iter().map(|p| Vector3::new(legendre(degree, p.z), 0.0, 0.0)).collect();
            let smooth = smoothing.smoothed(&wave, scale, smoothing.step, &Control::default()).unwrap();
            let smooth: Vec<f64> = smooth.iter().map(|value| value.x).collect();
            let found = amplitude(&sphere, &smoothing.areas, &smooth, degree);
            let expected = left(degree as f64, scale * scale);
            assert!((found.ln() / expected.ln() - 1.0).abs() < 0.3, "{degree} {scale} {found} {expected}");
        }
    }

    #[test]
    fn depths_hold_waves_between_the_scale_and_its_half() {
        // a wave of the radius has vectors of the degrees below and above it
        let depth = |degree: usize, scale: f64| {
            let (l, variance) = (degree as f64, (scale / RADIUS).powi(2));
            let smooth = ((l + 1.0) * left(l + 1.0, variance) + l * left(l - 1.0, variance)) / (2.0 * l + 1.0);
            (1.0 - smooth) * left(l, variance / 4.0)
        };
        let sphere = shapes::surface(shapes::sphere(5));
        for (n, [low, high]) in [[3, 5], [5, 9], [9, 17]].into_iter().enumerate() {
            let depths = |by: f64| {
                let wavy = |p: &Vector3<f64>| p * (1.0 + by * (legendre(low, p.z) + legendre(high, p.z)));
                let surface = sphere.moved(sphere.points().iter().map(wavy).collect()).unwrap();
                pattern(&surface, &Control::default()).unwrap().depths.swap_remove(n)
            };
            // without what comes from the sphere and its uneven triangles, which has even degrees only
            let found: Vec<f64> = depths(0.003).iter().zip(depths(-0.003)).map(|(a, b)| a - b).collect();
            let areas = Smoothing::new(sphere.points(), sphere.faces()).areas;
            let [a, b] = [low, high].map(|degree| amplitude(&sphere, &areas, &found, degree));
            let expected = depth(low, SCALES[n]) / depth(high, SCALES[n]);
            assert!((a / b / expected).ln().abs() < 0.5, "{n} {} {expected}", a / b);
        }
    }

    #[test]
    fn far_values_are_drawn_in() {
        let found = standard(&[-1.0, 1.0, 6.0], &[4.0, 4.0, 2.0]);
        let expected = [-0.899_554_567, -0.019_795_669, 1.838_700_472]; // by hand
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-8), "{found:?}");
    }
}
