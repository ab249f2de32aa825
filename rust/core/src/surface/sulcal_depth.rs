//! Sulcal depth: how far the surface moves outwards while it unfolds.

use nalgebra::Vector3;

use crate::surface::decimate::{Options, decimate};
use crate::surface::mesh::diffusion::{Stiffness, masses};
use crate::surface::mesh::{Surface, normals};
use crate::{Control, Result};

/// The most vertices without decimation: with triangles below 1 mm, the solver's steps grow faster than vertices.
pub const FINEST: usize = 200_000;

/// The number of steps of the flow; with more, depths change by half a mm on average on a hemisphere.
const STEPS: usize = 8;
/// The smallest area of a vertex, as a share of its initial area. Parts that shrink to a point (a stub, the temporal
/// pole) would otherwise continue to move. With a third, depths agree best with FreeSurfer's
/// (docs/decisions/0024-anatomy.md).
const LEAST_AREA: f64 = 1.0 / 3.0;

/// Returns the sulcal depth of each vertex in mm: positive in sulci, negative on gyri, with area mean 0 per component.
///
/// As FreeSurfer's `sulc` (Fischl, Sereno, Dale 1999), it is the displacement of a vertex along the outer normal while
/// the surface unfolds, Σ n · (y − x). Here, the surface unfolds by mean curvature flow within the metric's conformal
/// class (Kazhdan, Solomon, Ben-Chen 2012), M(x) ẋ = −L x, in backward Euler steps, for `flow` mm²: folds of wavelength
/// λ shrink by exp(−(2π/λ)² flow). L is computed once, from the initial surface, so that nothing pinches off. M are the
/// current areas of the vertices, but at least a third of the initial ones. The flow depends on lengths, not on
/// triangles. A boundary is free.
///
/// A surface with more than [`FINEST`] vertices is decimated to a third; others get the weighted depth of their
/// neighbours.
///
/// # Errors
/// [`Error::Cancelled`](crate::Error::Cancelled).
pub fn sulcal_depth(surface: &Surface, flow: f64, control: &Control) -> Result<Vec<f64>> {
    if surface.len() > FINEST { by_fewer(surface, FINEST / 3, flow, control) } else { by_all(surface, flow, control) }
}

/// Computes the depths on a decimated surface.
fn by_fewer(surface: &Surface, vertices: usize, flow: f64, control: &Control) -> Result<Vec<f64>> {
    let coarse = decimate(surface, &[], &Options { vertices, ..Options::default() }, control)?;
    let mut depth = vec![0.0; surface.len()];
    for (&vertex, of_coarse) in coarse.survivors.iter().zip(by_all(&coarse.surface, flow, control)?) {
        depth[vertex as usize] = of_coarse;
    }
    for removal in coarse.removals.iter().rev() {
        let parts = removal.neighbours.iter().zip(removal.weights);
        depth[removal.vertex as usize] = parts.map(|(&v, [weight, _])| depth[v as usize] * weight).sum();
    }
    Ok(depth)
}

fn by_all(surface: &Surface, flow: f64, control: &Control) -> Result<Vec<f64>> {
    control.begin("computing sulcal depth", STEPS as u64);
    let stiffness = Stiffness::new(surface);
    let components = surface.components(); // of the faces
    let mut of = vec![0; surface.len()];
    for (face, &component) in surface.faces().iter().zip(&components.labels) {
        face.iter().for_each(|&v| of[v as usize] = component);
    }
    let first_mass = masses(surface.points(), surface.faces());
    let centres = means(surface.points(), &first_mass, &of, components.count());
    // relative to the centre of each component, towards which it shrinks; this keeps numbers small
    let mut x: Vec<Vector3<f64>> = surface.points().iter().zip(&of).map(|(p, &c)| p - centres[c as usize]).collect();
    let mut depth = vec![0.0; x.len()];
    for _ in 0..STEPS {
        let areas = masses(&x, surface.faces());
        let mass: Vec<f64> = areas.iter().zip(&first_mass).map(|(area, first)| area.max(LEAST_AREA * first)).collect();
        let normals = normals(&x, surface.faces());
        let b: Vec<Vector3<f64>> = x.iter().zip(&mass).map(|(x, m)| x * *m).collect();
        let mut y = x.clone();
        // backward Euler: (M + t L) y = M x is stable for steps of any size
        stiffness.solve(&mass, flow / STEPS as f64, &b, &mut y, control)?;
        for (v, normal) in normals.iter().enumerate() {
            depth[v] += normal.dot(&(y[v] - x[v]));
        }
        x = y;
        control.advance();
    }
    let level: Vec<Vector3<f64>> = depth.iter().map(|&d| [d, 0.0, 0.0].into()).collect();
    let level = means(&level, &first_mass, &of, components.count());
    Ok(depth.iter().zip(&of).map(|(d, &c)| d - level[c as usize].x).collect())
}

/// Returns the mean over each component, with vertices weighted by their areas.
fn means(values: &[Vector3<f64>], mass: &[f64], of: &[u32], count: usize) -> Vec<Vector3<f64>> {
    let mut sums = vec![(Vector3::zeros(), 0.0); count];
    for ((value, mass), &c) in values.iter().zip(mass).zip(of) {
        sums[c as usize].0 += value * *mass;
        sums[c as usize].1 += mass;
    }
    sums.into_iter().map(|(sum, area)| if area > 0.0 { sum / area } else { sum }).collect()
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};

    use super::*;
    use crate::surface::mesh::shapes;
    use crate::tests::{both, moved};

    fn depth(surface: &Surface) -> Vec<f64> {
        sulcal_depth(surface, 70.0, &Control::default()).unwrap()
    }

    /// Returns a sphere with waves around the axis: r = 50 + a cos(16 φ) sin⁴ θ, in mm.
    fn waved(times: usize, a: f64) -> Surface {
        let sphere = shapes::surface(shapes::sphere(times));
        let wave = |p: &Vector3<f64>| {
            let (phi, sine) = (p.y.atan2(p.x), p.xy().norm());
            p * (50.0 + a * (16.0 * phi).cos() * sine.powi(4))
        };
        sphere.moved(sphere.points().iter().map(wave).collect()).unwrap()
    }

    #[test]
    fn a_sphere_has_no_depth() {
        assert!(depth(&waved(5, 0.0)).iter().all(|d| d.abs() < 0.05));
        let unit = shapes::surface(shapes::sphere(3)); // collapses in the flow
        assert!(depth(&unit).iter().all(|d| d.abs() < 0.05));
    }

    #[test]
    fn a_plane_has_no_depth() {
        assert!(depth(&shapes::surface(shapes::sheet(30, 30))).iter().all(|d| d.abs() < 1e-9));
    }

    #[test]
    fn shallow_waves_have_their_height_whatever_the_triangles() {
        // their wavenumber on the equator is 16 / 50 per mm: exp(−(16 / 50)² · 70) = 0.001 of them is left
        for times in [5, 6] {
            let surface = waved(times, 1.0);
            for (p, d) in surface.points().iter().zip(depth(&surface)) {
                if p.z.abs() < 3.0 {
                    let height = p.norm() - 50.0;
                    assert!((d + height).abs() < 0.15, "{p} {d} {height}");
                }
            }
        }
    }

    #[test]
    fn a_short_flow_leaves_the_share_of_waves_that_the_equation_says() {
        let surface = waved(6, 1.0);
        for flow in [3.0, 10.0] {
            let depth = sulcal_depth(&surface, flow, &Control::default()).unwrap();
            let at_equator = surface.points().iter().zip(depth).filter(|(p, _)| p.z.abs() < 3.0);
            let sums = at_equator
                .map(|(p, d)| (p.norm() - 50.0, d))
                .fold((0.0, 0.0), |(squares, products), (h, d)| (squares + h * h, products - h * d));
            let share = 1.0 - (1.0 + (16.0f64 / 50.0).powi(2) * flow / 8.0).powi(-8); // eight backward Euler steps
            assert!((sums.1 / sums.0 - share).abs() < 0.03, "{flow} {} {share}", sums.1 / sums.0);
        }
    }

    /// Returns the depths by dense matrices, with cotangents from the angles of triangles.
    fn dense_depth(surface: &Surface, flow: f64) -> Vec<f64> {
        let (n, faces) = (surface.len(), surface.faces());
        let mut weights = DMatrix::zeros(n, n);
        for face in faces {
            for k in 0..3 {
                let [tip, a, b] = [0, 1, 2].map(|side| face[(k + side) % 3] as usize);
                let angle =
                    (surface.points()[a] - surface.points()[tip]).angle(&(surface.points()[b] - surface.points()[tip]));
                weights[(a, b)] += 0.5 / angle.tan();
                weights[(b, a)] += 0.5 / angle.tan();
            }
        }
        let weights = weights.map(|weight: f64| weight.max(0.0));
        let stiffness = DMatrix::from_diagonal(&weights.column_sum()) - weights;
        let first = masses(surface.points(), faces);
        let mut x = surface.points().to_vec();
        let mut depth = vec![0.0; n];
        for _ in 0..8 {
            let mass =
                masses(&x, faces).iter().zip(&first).map(|(now, first)| now.max(first / 3.0)).collect::<Vec<_>>();
            let mass = DMatrix::from_diagonal(&DVector::from_vec(mass));
            let before = DMatrix::from_fn(n, 3, |v, axis| x[v][axis]);
            let after = (&mass + &stiffness * (flow / 8.0)).lu().solve(&(&mass * before)).unwrap();
            let normals = normals(&x, faces);
            for v in 0..n {
                let y = Vector3::new(after[(v, 0)], after[(v, 1)], after[(v, 2)]);
                depth[v] += normals[v].dot(&(y - x[v]));
                x[v] = y;
            }
        }
        let mean = depth.iter().zip(&first).map(|(d, area)| d * area).sum::<f64>() / first.iter().sum::<f64>();
        depth.iter().map(|d| d - mean).collect()
    }

    #[test]
    fn parts_that_shrink_flow_as_if_they_kept_a_third_of_their_area() {
        let sphere = shapes::surface(shapes::sphere(3));
        let stretched = |p: &Vector3<f64>| Vector3::new(10.0 * p.x, 8.0 * p.y, 25.0 * p.z);
        let surface = sphere.moved(sphere.points().iter().map(stretched).collect()).unwrap();
        for (found, expected) in depth(&surface).iter().zip(dense_depth(&surface, 70.0)) {
            assert!((found - expected).abs() < 0.02, "{found} {expected}");
        }
    }

    #[test]
    fn fewer_vertices_know_the_depth_of_all() {
        let surface = waved(6, 1.0); // 40,962 vertices
        let fewer = by_fewer(&surface, surface.len() / 3, 70.0, &Control::default()).unwrap();
        let apart = depth(&surface).iter().zip(fewer).map(|(all, few)| (all - few).abs()).collect::<Vec<_>>();
        assert!(apart.iter().sum::<f64>() < 0.05 * apart.len() as f64);
        assert!(apart.iter().all(|apart| *apart < 0.2));
    }

    #[test]
    fn components_do_not_know_of_each_other() {
        let sphere = shapes::sphere(4);
        let large = moved(&sphere, |p| p.map(|x| 60.0 * x));
        let small = moved(&sphere, |[x, y, z]| [40.0 * x + 200.0, 40.0 * y, 40.0 * z]);
        let together = depth(&shapes::surface(both(&large, &small)));
        assert!(together.iter().all(|d| d.abs() < 0.3)); // nearly round
    }
}
