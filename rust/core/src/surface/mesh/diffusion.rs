//! Diffusion over a surface: values at vertices spread along it by a length in mm, whatever the triangles.

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::adjacency::starts_of;
use crate::surface::mesh::Surface;
use crate::{Control, Result};

/// The relative residual at which conjugate gradients end; they also end after the maximum number of steps.
const SMALL: f64 = 3e-3;
const STEPS: usize = 500;
/// The number of vertices that a thread visits at a time; fewer would not be worth the overhead.
const BATCH: usize = 4096;
/// The maximum weight of an edge, that opposite an angle of 0.6°: the cotangents of slivers grow without bound.
const STIFFEST: f64 = 100.0;

/// The stiffness matrix of linear finite elements, L: (L x)ᵢ = Σⱼ wᵢⱼ (xᵢ − xⱼ) with the cotangent weights wᵢⱼ = ½ (cot
/// α + cot β) (Pinkall, Polthier 1993), at least 0.
pub(crate) struct Stiffness {
    /// Where the neighbours of each vertex begin.
    first: Vec<u32>,
    neighbours: Vec<(u32, f64)>,
    total: Vec<f64>,
}

impl Stiffness {
    pub(crate) fn new(surface: &Surface) -> Self {
        let points = surface.points();
        let half_cotangent = |h: u32| {
            let tip = surface.target(crate::surface::mesh::next(h));
            let [a, b, tip] = [surface.origin(h), surface.target(h), tip].map(|v| points[v as usize]);
            let (u, v) = (a - tip, b - tip);
            let cotangent = u.dot(&v) / u.cross(&v).norm();
            if cotangent.is_finite() { 0.5 * cotangent } else { 0.0 }
        };
        let mut links = Vec::with_capacity(3 * surface.len());
        for h in surface.edges() {
            let beyond = if surface.is_inner(h) { half_cotangent(surface.twins()[h as usize]) } else { 0.0 };
            links.push((surface.origin(h), surface.target(h), (half_cotangent(h) + beyond).clamp(0.0, STIFFEST)));
        }
        let first = starts_of(surface.len(), links.iter().flat_map(|&(a, b, _)| [a, b]));
        let mut next = first.clone();
        let mut neighbours = vec![(0, 0.0); 2 * links.len()];
        let mut total = vec![0.0; surface.len()];
        for (a, b, weight) in links {
            for (from, to) in [(a, b), (b, a)] {
                neighbours[next[from as usize] as usize] = (to, weight);
                next[from as usize] += 1;
                total[from as usize] += weight;
            }
        }
        Self { first, neighbours, total }
    }

    /// Takes one backward Euler step: solves (M + t L) y = b, M = diag(`mass`), from an initial guess y.
    pub(crate) fn solve(
        &self, mass: &[f64], time: f64, b: &[Vector3<f64>], y: &mut [Vector3<f64>], control: &Control,
    ) -> Result<()> {
        // conjugate gradients with a diagonal preconditioner, for three columns at a time
        let diagonal: Vec<f64> =
            mass.iter().zip(&self.total).map(|(m, total)| (m + time * total).max(f64::MIN_POSITIVE)).collect();
        let applied = |x: &[Vector3<f64>]| -> Vec<Vector3<f64>> {
            let at = |v: usize| {
                let around = &self.neighbours[self.first[v] as usize..self.first[v + 1] as usize];
                let pull: Vector3<f64> = around.iter().map(|&(w, weight)| x[w as usize] * weight).sum();
                x[v] * diagonal[v] - pull * time
            };
            (0..x.len()).into_par_iter().with_min_len(BATCH).map(at).collect()
        };
        let over = |a: Vector3<f64>, b: Vector3<f64>| a.zip_map(&b, |a, b| if b > 0.0 { a / b } else { 0.0 });
        let mut r: Vec<Vector3<f64>> = b.iter().zip(applied(y)).map(|(b, ay)| b - ay).collect();
        let mut p: Vec<Vector3<f64>> = r.iter().zip(&diagonal).map(|(r, d)| r / *d).collect();
        let mut rz = dot(&r, &p);
        let end = rz * (SMALL * SMALL);
        for _ in 0..STEPS {
            if (0..3).all(|k| rz[k] <= end[k]) {
                break;
            }
            control.check()?;
            let ap = applied(&p);
            // α = rᵀz/pᵀAp, then β = r′ᵀz′/rᵀz (Hestenes & Stiefel 1952), column by column
            let alpha = over(rz, dot(&p, &ap));
            let before = rz;
            let batches = y.par_chunks_mut(BATCH).zip(r.par_chunks_mut(BATCH)).enumerate();
            let sums = batches.map(|(n, (y, r))| {
                let mut rz = Vector3::zeros();
                for (v, (y, r)) in (n * BATCH..).zip(y.iter_mut().zip(r)) {
                    *y += alpha.component_mul(&p[v]);
                    *r -= alpha.component_mul(&ap[v]);
                    rz += r.component_mul(&(*r / diagonal[v]));
                }
                rz
            });
            rz = sums.collect::<Vec<Vector3<f64>>>().iter().sum();
            let beta = over(rz, before);
            let along = p.par_iter_mut().zip(&r).zip(&diagonal).with_min_len(BATCH);
            along.for_each(|((p, r), d)| *p = r / *d + beta.component_mul(p));
        }
        Ok(())
    }
}

/// Returns the products of three columns; the same for any number of threads.
fn dot(a: &[Vector3<f64>], b: &[Vector3<f64>]) -> Vector3<f64> {
    let of_batch = |(a, b): (&[Vector3<f64>], &[Vector3<f64>])| -> Vector3<f64> {
        a.iter().zip(b).map(|(a, b)| a.component_mul(b)).sum()
    };
    a.par_chunks(BATCH).zip(b.par_chunks(BATCH)).map(of_batch).collect::<Vec<_>>().iter().sum()
}

/// Returns the area of each vertex, a third of that of its triangles, for these positions of the vertices.
pub(crate) fn masses(points: &[Vector3<f64>], faces: &[[u32; 3]]) -> Vec<f64> {
    let mut mass = vec![0.0; points.len()];
    for face in faces {
        let [a, b, c] = face.map(|v| points[v as usize]);
        // a third of half the cross product (lumped mass matrix)
        let third = (b - a).cross(&(c - a)).norm() / 6.0;
        face.iter().for_each(|&v| mass[v as usize] += third);
    }
    mass
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::mesh::shapes;

    #[test]
    fn a_step_keeps_constants_and_sums_and_flattens_waves_as_the_equation_says() {
        let sheet = shapes::surface(shapes::sheet(40, 40));
        let (stiffness, mass) = (Stiffness::new(&sheet), masses(sheet.points(), sheet.faces()));
        let k = std::f64::consts::PI / 10.0; // whole waves on the sheet, whose boundary lets nothing through
        let before: Vec<Vector3<f64>> = sheet.points().iter().map(|p| [2.0, (k * p.x).cos(), p.y].into()).collect();
        let b: Vec<Vector3<f64>> = before.iter().zip(&mass).map(|(x, m)| x * *m).collect();
        let mut after = before.clone();
        stiffness.solve(&mass, 5.0, &b, &mut after, &Control::default()).unwrap();
        let sum = |x: &[Vector3<f64>]| x.iter().zip(&mass).map(|(x, m)| x.z * m).sum::<f64>();
        assert!((sum(&after) / sum(&before) - 1.0).abs() < 1e-4);
        for (x, y) in before.iter().zip(&after) {
            assert!((y.x - 2.0).abs() < 1e-9);
            assert!((y.y - x.y / (1.0 + 5.0 * k * k)).abs() < 0.03, "{x} {y}");
        }
    }
}
