//! Diffusion over a surface: values at vertices spread along it by a length in mm, whatever the triangles.

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::adjacency::starts_of;
use crate::error::check_length;
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
/// α + cot β) (Pinkall, Polthier 1993).
pub(crate) struct Stiffness {
    /// Where the neighbours of each vertex begin.
    first: Vec<u32>,
    neighbours: Vec<(u32, f64)>,
    total: Vec<f64>,
}

impl Stiffness {
    pub(crate) fn new(surface: &Surface) -> Self {
        Self::of(surface, |h| half_cotangent(surface, h), 0.0)
    }

    /// Creates the matrix with the negative weights of edges opposite obtuse angles, without which values spread too
    /// far. It stays positive semidefinite, because the matrix of a sliver is scaled as a whole.
    fn signed(surface: &Surface) -> Self {
        let weight = |h: u32| {
            let first = h - h % 3;
            let most = (first..first + 3).map(|side| half_cotangent(surface, side).abs()).fold(0.0, f64::max);
            half_cotangent(surface, h) * (0.5 * STIFFEST / most).min(1.0)
        };
        Self::of(surface, weight, f64::NEG_INFINITY)
    }

    fn of(surface: &Surface, half_cotangent: impl Fn(u32) -> f64, least: f64) -> Self {
        let mut links = Vec::with_capacity(3 * surface.len());
        for h in surface.edges() {
            let beyond = if surface.is_inner(h) { half_cotangent(surface.twins()[h as usize]) } else { 0.0 };
            links.push((surface.origin(h), surface.target(h), (half_cotangent(h) + beyond).clamp(least, STIFFEST)));
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

    /// Returns the neighbours of a vertex, with their weights.
    fn around(&self, v: usize) -> &[(u32, f64)] {
        &self.neighbours[self.first[v] as usize..self.first[v + 1] as usize]
    }

    /// Returns exp(−t M⁻¹ L) x, the solution of the heat equation after a time t, up to rounding errors. Vertices
    /// without area keep their values.
    ///
    /// With r = max(Σⱼ |wᵢⱼ|/Mᵢ), the eigenvalues of S = 1 − M⁻¹ L/r lie between −1 and 1, so that exp(−r t (1 − S)) is a
    /// sum of Chebyshev polynomials Tₖ(S) with the weights 2 exp(−r t) Iₖ(r t), and half of it for k = 0.
    fn diffuse(
        &self, mass: &[f64], rate: f64, weights: &[f64], x: &[Vector3<f64>], control: &Control,
    ) -> Result<Vec<Vector3<f64>>> {
        let applied = |x: &[Vector3<f64>], v: usize| {
            let pull: Vector3<f64> = self.around(v).iter().map(|&(w, weight)| (x[w as usize] - x[v]) * weight).sum();
            if mass[v] > 0.0 { x[v] + pull / (mass[v] * rate) } else { x[v] }
        };
        let mut sum: Vec<Vector3<f64>> = x.iter().map(|x| x * weights[0]).collect();
        let mut before = x.to_vec();
        let mut now: Vec<Vector3<f64>> =
            (0..x.len()).into_par_iter().with_min_len(BATCH).map(|v| applied(x, v)).collect();
        for weight in &weights[1..] {
            control.check()?;
            sum.par_iter_mut().zip(&now).with_min_len(BATCH).for_each(|(sum, now)| *sum += now * (2.0 * weight));
            let next = |(v, before): (usize, &mut Vector3<f64>)| *before = 2.0 * applied(&now, v) - *before;
            before.par_iter_mut().enumerate().with_min_len(BATCH).for_each(next);
            std::mem::swap(&mut before, &mut now);
            control.advance();
        }
        Ok(sum)
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
                let pull: Vector3<f64> = self.around(v).iter().map(|&(w, weight)| x[w as usize] * weight).sum();
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

/// Returns half the cotangent of the angle opposite a half-edge; 0 in a face without area.
fn half_cotangent(surface: &Surface, h: u32) -> f64 {
    let tip = surface.target(crate::surface::mesh::next(h));
    let [a, b, tip] = [surface.origin(h), surface.target(h), tip].map(|v| surface.points()[v as usize]);
    let (u, v) = (a - tip, b - tip);
    let cotangent = u.dot(&v) / u.cross(&v).norm();
    if cotangent.is_finite() { 0.5 * cotangent } else { 0.0 }
}

/// Returns columns of values at the vertices, smoothed along the surface by the heat kernel, which is a Gaussian of
/// standard deviation `deviation` in mm on a plane. Nothing flows through a boundary: constants, and integrals over the
/// surface, are preserved.
///
/// # Errors
/// [`Error::WrongLength`](crate::Error::WrongLength) if a column does not have one value per vertex, or
/// [`Error::Cancelled`](crate::Error::Cancelled).
pub fn smooth_values(
    surface: &Surface, columns: &[Vec<f64>], deviation: f64, control: &Control,
) -> Result<Vec<Vec<f64>>> {
    for column in columns {
        check_length("values", column.len(), "vertices", surface.len())?;
    }
    let (stiffness, mass) = (Stiffness::signed(surface), masses(surface.points(), surface.faces()));
    let pull = |v: usize| -> f64 { stiffness.around(v).iter().map(|(_, weight)| weight.abs()).sum() };
    let rates = (0..mass.len()).map(|v| if mass[v] > 0.0 { pull(v) / mass[v] } else { 0.0 });
    let rate = rates.fold(0.0, f64::max);
    if rate == 0.0 {
        return Ok(columns.to_vec());
    }
    let weights = scaled_bessel(rate * deviation * deviation / 2.0);
    control.begin("smoothing values", (columns.len().div_ceil(3) * (weights.len() - 1)) as u64);
    let mut smooth = Vec::with_capacity(columns.len());
    for three in columns.chunks(3) {
        let of = |k: usize, v: usize| three.get(k).map_or(0.0, |column| column[v]);
        let x: Vec<Vector3<f64>> = (0..surface.len()).map(|v| [of(0, v), of(1, v), of(2, v)].into()).collect();
        let x = stiffness.diffuse(&mass, rate, &weights, &x, control)?;
        smooth.extend((0..three.len()).map(|k| x.iter().map(|x| x[k]).collect()));
    }
    Ok(smooth)
}

/// Returns exp(−z) Iₖ(z) for k = 0, 1, ... until these modified Bessel functions are negligible, by Miller's backward
/// recurrence I₍ₖ₋₁₎ = I₍ₖ₊₁₎ + 2 k/z Iₖ, whose values are scaled so that I₀ + 2 Σ Iₖ = exp(z).
fn scaled_bessel(z: f64) -> Vec<f64> {
    let count = (8.5 * z.sqrt()).ceil() as usize + 40;
    let mut values = vec![0.0; count + 2];
    values[count] = f64::MIN_POSITIVE;
    for k in (1..=count).rev() {
        values[k - 1] = values[k + 1] + 2.0 * k as f64 / z * values[k];
        if values[k - 1] > 1e200 {
            values[k - 1..].iter_mut().for_each(|value| *value /= 1e200);
        }
    }
    let total = values[0] + 2.0 * values[1..].iter().sum::<f64>();
    let last = values.iter().rposition(|value| *value > 1e-15 * total).unwrap_or(0);
    values[..=last.max(1)].iter().map(|value| value / total).collect()
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
    fn smoothing_solves_the_heat_equation() {
        let sheet = shapes::surface(shapes::sheet(40, 40));
        let k = std::f64::consts::PI / 10.0;
        let of = |f: &dyn Fn(&Vector3<f64>) -> f64| sheet.points().iter().map(f).collect::<Vec<f64>>();
        let columns = [of(&|_| 2.0), of(&|p| (k * p.x).cos()), of(&|p| p.y), of(&|p| (k * p.y).cos())];
        let (deviation, control) = (2.0, Control::default());
        let smooth = smooth_values(&sheet, &columns, deviation, &control).unwrap();
        let expected = (-k * k * deviation * deviation / 2.0).exp();
        let mass = masses(sheet.points(), sheet.faces());
        let sum = |x: &[f64]| x.iter().zip(&mass).map(|(x, m)| x * m).sum::<f64>();
        assert!((sum(&smooth[2]) / sum(&columns[2]) - 1.0).abs() < 1e-12);
        for v in 0..sheet.len() {
            assert!((smooth[0][v] - 2.0).abs() < 1e-12);
            // within 0.002 except at the corners of the sheet, whose areas depend on the diagonal
            assert!((smooth[1][v] - expected * columns[1][v]).abs() < 0.015);
            assert!((smooth[3][v] - expected * columns[3][v]).abs() < 0.015);
        }
        // two steps are the same as a single one of their joint variance
        let first = smooth_values(&sheet, &columns, 1.2, &control).unwrap();
        let second = smooth_values(&sheet, &first, 1.6, &control).unwrap();
        assert!(second[1].iter().zip(&smooth[1]).all(|(a, b)| (a - b).abs() < 1e-12));
        let tiny = smooth_values(&sheet, &columns, 1e-9, &control).unwrap();
        assert!(tiny[1].iter().zip(&columns[1]).all(|(a, b)| (a - b).abs() < 1e-12));
    }

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
