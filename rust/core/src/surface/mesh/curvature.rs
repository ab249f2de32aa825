//! Curvature: positive on the crown of a gyrus, negative in the depth of a sulcus.

use nalgebra::Vector3;

use crate::surface::mesh::Surface;
use crate::surface::mesh::diffusion::{Stiffness, masses};
use crate::{Control, Result};

/// The number of diffusion steps; with three, the kernel is close to a Gaussian.
const STEPS: usize = 3;

/// Returns the mean curvature at each vertex in 1/mm: positive where the surface is convex (1/r on a ball of radius r),
/// negative in the depth of a fold.
///
/// An edge with exterior angle β carries the integral ½ β · length (Cohen-Steiner, Morvan 2003); each end gets half of
/// it. A face gives a third of its area to each corner. Both are summed over a neighbourhood of `rings` rings before
/// they are divided, which smooths the steps of surfaces from voxels. The boundary has no angle. Takes O(n) per ring.
pub fn mean_curvature(surface: &Surface, rings: usize) -> Vec<f64> {
    let mut bend = bends(surface);
    let mut area = masses(surface.points(), surface.faces());
    for _ in 0..rings {
        (bend, area) = (gathered(surface, &bend), gathered(surface, &area));
    }
    bend.iter().zip(&area).map(|(bend, area)| if *area > 0.0 { bend / area } else { 0.0 }).collect()
}

/// Returns the mean curvature at each vertex in 1/mm, averaged along the surface by a Gaussian of standard deviation
/// `smoothing` in mm. Unlike [`mean_curvature`], which smooths over rings, it depends little on triangle sizes.
///
/// With the integrals b of the edges, (M + t L)ⁿ h = b, where M are the vertices' areas, L is the stiffness matrix of
/// linear finite elements, and n t = smoothing² / 2. Nothing flows through a boundary.
///
/// # Errors
/// [`Error::Cancelled`](crate::Error::Cancelled).
pub fn smooth_mean_curvature(surface: &Surface, smoothing: f64, control: &Control) -> Result<Vec<f64>> {
    control.begin("computing mean curvature", STEPS as u64);
    let (bend, area) = (bends(surface), masses(surface.points(), surface.faces()));
    let mean = |(&bend, &area): (&f64, &f64)| Vector3::new(if area > 0.0 { bend / area } else { 0.0 }, 0.0, 0.0);
    let mut curvature: Vec<Vector3<f64>> = bend.iter().zip(&area).map(mean).collect();
    if smoothing > 0.0 {
        let stiffness = Stiffness::new(surface);
        for _ in 0..STEPS {
            let b: Vec<Vector3<f64>> = curvature.iter().zip(&area).map(|(h, area)| h * *area).collect();
            stiffness.solve(&area, smoothing * smoothing / (2 * STEPS) as f64, &b, &mut curvature, control)?;
            control.advance();
        }
    }
    Ok(curvature.into_iter().map(|h| h.x).collect())
}

/// Returns each vertex's part of the integral of the mean curvature in mm: ½ β · length / 2 of each of its edges.
fn bends(surface: &Surface) -> Vec<f64> {
    let normals = surface.face_normals();
    let mut bend = vec![0.0; surface.len()];
    for h in surface.edges().filter(|&h| surface.is_inner(h)) {
        let [a, b] = [surface.origin(h), surface.target(h)];
        let along = surface.points()[b as usize] - surface.points()[a as usize];
        let [left, right] = [h, surface.twins()[h as usize]].map(|side| normals[side as usize / 3]);
        let length = along.norm();
        let turn = right.cross(&left).dot(&along); // sine of the angle · length
        // the signed exterior angle from its sine and cosine, accurate for flat and for sharp edges
        let angle = if length > 0.0 { (turn / length).atan2(left.dot(&right)) } else { 0.0 };
        [a, b].iter().for_each(|&v| bend[v as usize] -= angle * length / 4.0);
    }
    bend
}

/// Returns the sum of the values of each vertex and of its neighbours.
fn gathered(surface: &Surface, values: &[f64]) -> Vec<f64> {
    let mut sums = values.to_vec();
    for h in surface.edges() {
        let [a, b] = [surface.origin(h), surface.target(h)].map(|v| v as usize);
        sums[a] += values[b];
        sums[b] += values[a];
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::mesh::shapes;

    #[test]
    fn a_sphere_has_its_curvature_everywhere() {
        let sphere = shapes::surface(shapes::sphere(4));
        let off = |surface: &Surface, rings: usize, expected: f64| {
            mean_curvature(surface, rings).iter().map(|h| (h / expected - 1.0).abs()).fold(0.0, f64::max)
        };
        // a single ring is as good as its triangles are even
        assert!(off(&sphere, 0, 1.0) < 0.6 && off(&sphere, 1, 1.0) < 0.08 && off(&sphere, 4, 1.0) < 0.03);
        let twice = sphere.moved(sphere.points().iter().map(|p| p * 2.0).collect()).unwrap();
        assert!(off(&twice, 4, 0.5) < 0.03);
    }

    #[test]
    fn smoothing_by_a_length_does_not_ask_for_triangles() {
        let control = Control::default();
        for times in [4, 5] {
            let sphere = shapes::surface(shapes::sphere(times));
            let smooth = smooth_mean_curvature(&sphere, 0.3, &control).unwrap();
            assert!(smooth.iter().all(|h| (h - 1.0).abs() < 0.03));
        }
        // on shallow waves z = a cos(k x) the curvature is a k² / 2 cos(k x), and smoothing takes exp(−k² σ² / 2) of it
        let (a, k, sigma) = (0.1, std::f64::consts::PI / 10.0, 2.0);
        for fine in [1usize, 2] {
            let sheet = shapes::surface(shapes::sheet(40 * fine, 20 * fine));
            let scaled = |x: f64| x / fine as f64;
            let waves = |p: &Vector3<f64>| [scaled(p.x), scaled(p.y), a * (k * scaled(p.x)).cos()].into();
            let surface = sheet.moved(sheet.points().iter().map(waves).collect()).unwrap();
            let smooth = smooth_mean_curvature(&surface, sigma, &control).unwrap();
            let most = a * k * k / 2.0;
            for (p, h) in surface.points().iter().zip(smooth) {
                let expected = most * (k * p.x).cos() * (-k * k * sigma * sigma / 2.0).exp();
                assert!(p.x < 10.0 || p.x > 30.0 || (h - expected).abs() < 0.05 * most, "{p} {h} {expected}");
            }
        }
    }

    #[test]
    fn a_torus_bends_less_where_it_faces_itself() {
        let torus = shapes::surface(shapes::torus(90, 30));
        let exact = |v: usize| {
            let r = torus.points()[v].xy().norm();
            (1.0 + (r - 3.0) / r) / 2.0 // a circle of radius 1, and one around the axis
        };
        assert!(mean_curvature(&torus, 0).iter().enumerate().all(|(v, h)| (h - exact(v)).abs() < 0.02));
    }

    #[test]
    fn a_furrow_is_negative_and_a_plane_is_zero() {
        let sheet = shapes::surface(shapes::sheet(8, 8));
        assert!(mean_curvature(&sheet, 1).iter().all(|&h| h == 0.0));
        let furrow = sheet.points().iter().map(|p| [p.x, p.y, (p.x - 4.0).abs()].into()).collect();
        let furrow = sheet.moved(furrow).unwrap();
        for (p, h) in furrow.points().iter().zip(mean_curvature(&furrow, 0)) {
            let expected = p.x == 4.0 && p.y > 0.0 && p.y < 8.0;
            assert_eq!(h < -0.1, expected || (p.x == 4.0 && h < 0.0), "{p} {h}");
            assert!(h <= 0.0);
        }
        // eight edges of length 1 turn by a right angle, and the integral is ½ β · length of each
        let areas = masses(furrow.points(), furrow.faces());
        let total: f64 = mean_curvature(&furrow, 0).iter().zip(areas).map(|(h, area)| h * area).sum();
        assert!((total + 2.0 * std::f64::consts::PI).abs() < 1e-9, "{total}");
    }
}
