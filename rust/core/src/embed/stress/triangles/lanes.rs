//! Triangles that are processed together in the processor's registers, with the same bits as one by one.

use crate::embed::Place;
use nalgebra::{Matrix2, Vector2};
use pulp::{Arch, Simd, WithSimd};

use super::{Price, Rest, Shape, by_sides, roots};

const LANES: usize = 8;

type Lanes = [f64; LANES];

/// Sets the energies of triangles in a map, and `scale` times the gradients with respect to their corners.
pub(super) fn energies(
    rests: &[Rest], uv: &[Place], shape: Shape, scale: f64, energies: &mut [f64], pulls: &mut [[Place; 3]],
) {
    if shape.has_outliers() {
        Arch::new().dispatch(Energies::<true> { rests, uv, shape, scale, energies, pulls });
    } else {
        Arch::new().dispatch(Energies::<false> { rests, uv, shape, scale, energies, pulls });
    }
}

struct Energies<'a, const OUTLIERS: bool> {
    rests: &'a [Rest],
    uv: &'a [Place],
    shape: Shape,
    scale: f64,
    energies: &'a mut [f64],
    pulls: &'a mut [[Place; 3]],
}

impl<const OUTLIERS: bool> WithSimd for Energies<'_, OUTLIERS> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { rests, uv, shape, scale, energies, pulls } = self;
        let lanes = rests.chunks(LANES).zip(energies.chunks_mut(LANES).zip(pulls.chunks_mut(LANES)));
        for (rests, (energies, pulls)) in lanes {
            let mut sides = [[0.0; LANES]; 4];
            let mut inverses = [[0.0; LANES]; 4];
            let mut areas = [0.0; LANES];
            for (n, rest) in rests.iter().enumerate() {
                let [b, c] = sides_of(rest, uv);
                set(&mut sides, n, &Matrix2::from_columns(&[b, c]));
                set(&mut inverses, n, &rest.inverse);
                areas[n] = rest.area;
            }
            let mut jacobians = [[0.0; LANES]; 4];
            let [mut halves, mut growths] = [[0.0; LANES]; 2];
            for n in 0..LANES {
                let jacobian = get(&sides, n) * get(&inverses, n);
                set(&mut jacobians, n, &jacobian);
                halves[n] = 0.5 * jacobian.norm_squared();
                growths[n] = jacobian.determinant();
            }
            // apart from the loops around it, because a call of ln would keep them out of vector registers
            let logs = growths.map(f64::ln);
            let mut found = [0.0; LANES];
            let mut by_corners = [[0.0; LANES]; 6];
            for n in 0..LANES {
                let Price { value, slopes, .. } = shape.price_of::<OUTLIERS>(halves[n], growths[n], logs[n]);
                let by_sides = by_sides(&get(&jacobians, n), slopes, &get(&inverses, n), areas[n]);
                let (b, c) = (Vector2::new(by_sides.m11, by_sides.m21), Vector2::new(by_sides.m12, by_sides.m22));
                found[n] = areas[n] * value;
                let (a, b, c) = (scale * (-b - c), scale * b, scale * c);
                let parts = [a.x, a.y, b.x, b.y, c.x, c.y];
                (0..6).for_each(|part| by_corners[part][n] = parts[part]);
            }
            energies.copy_from_slice(&found[..energies.len()]);
            let [ax, ay, bx, by, cx, cy] = &by_corners;
            for (n, pulls) in pulls.iter_mut().enumerate() {
                *pulls = [Vector2::new(ax[n], ay[n]), Vector2::new(bx[n], by[n]), Vector2::new(cx[n], cy[n])];
            }
        }
    }
}

/// Returns how far a map may move along `direction` until the first of some triangles has no area.
pub(super) fn farthest_step(rests: &[Rest], uv: &[Place], direction: &[Place]) -> f64 {
    Arch::new().dispatch(Farthest { rests, uv, direction })
}

struct Farthest<'a> {
    rests: &'a [Rest],
    uv: &'a [Place],
    direction: &'a [Place],
}

impl WithSimd for Farthest<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> f64 {
        let Self { rests, uv, direction } = self;
        let mut farthest = [f64::INFINITY; LANES];
        for rests in rests.chunks(LANES) {
            let [mut at, mut way] = [[[0.0; LANES]; 4]; 2]; // a side of length zero never meets another one
            for (n, rest) in rests.iter().enumerate() {
                set(&mut at, n, &Matrix2::from_columns(&sides_of(rest, uv)));
                set(&mut way, n, &Matrix2::from_columns(&sides_of(rest, direction)));
            }
            for n in 0..LANES {
                let (b0, c0) = (Vector2::new(at[0][n], at[1][n]), Vector2::new(at[2][n], at[3][n]));
                let (b1, c1) = (Vector2::new(way[0][n], way[1][n]), Vector2::new(way[2][n], way[3][n]));
                // (b₀ + t b₁) × (c₀ + t c₁) = 0: the area, quadratic in the step, vanishes (Smith & Schaefer 2015)
                let [first, second] = roots(b1.perp(&c1), b0.perp(&c1) + b1.perp(&c0), b0.perp(&c0));
                let least = if first > 0.0 && first < farthest[n] { first } else { farthest[n] };
                farthest[n] = if second > 0.0 && second < least { second } else { least };
            }
        }
        farthest.into_iter().fold(f64::INFINITY, f64::min)
    }
}

#[inline(always)]
fn sides_of(rest: &Rest, values: &[Place]) -> [Place; 2] {
    let [a, b, c] = rest.corners; // without a closure, which would be a call
    let a = values[a as usize];
    [values[b as usize] - a, values[c as usize] - a]
}

#[inline(always)]
fn set([xx, yx, xy, yy]: &mut [Lanes; 4], n: usize, matrix: &Matrix2<f64>) {
    (xx[n], yx[n], xy[n], yy[n]) = (matrix.m11, matrix.m21, matrix.m12, matrix.m22);
}

#[inline(always)]
fn get([xx, yx, xy, yy]: &[Lanes; 4], n: usize) -> Matrix2<f64> {
    Matrix2::new(xx[n], xy[n], yx[n], yy[n])
}

#[cfg(test)]
mod tests {
    use super::super::TriangleEnergy;
    use super::*;
    use crate::surface::mesh::shapes;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Maps of a sheet, more and more of whose triangles are folded, and a direction for each.
    fn maps() -> (TriangleEnergy, Vec<[Vec<Vector2<f64>>; 2]>) {
        let surface = shapes::surface(shapes::sheet(7, 9)); // 126 triangles: a few are left over
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        let mut places = |by: f64| {
            let by = [by; 2].map(|by| surface.points().iter().map(|_| rng.random_range(-by..=by)).collect::<Vec<_>>());
            (0..surface.len()).map(|n| surface.points()[n].xy() + Vector2::new(by[0][n], by[1][n])).collect()
        };
        (TriangleEnergy::new(&surface), [0.0, 0.2, 0.4, 0.8].map(|by| [places(by), places(9.0)]).into())
    }

    #[test]
    fn triangles_have_the_same_bits_together_and_alone() {
        let (triangles, maps) = maps();
        let mut infinite = 0;
        for outlier in [f64::INFINITY, 0.2] {
            let shape = Shape { barrier: 0.05, area: 1.5, outlier };
            for [uv, _] in &maps {
                let count = triangles.rests.len();
                let (mut found, mut pulls) = (vec![0.0; count], vec![[Vector2::zeros(); 3]; count]);
                energies(&triangles.rests, uv, shape, 0.3, &mut found, &mut pulls);
                for ((rest, found), pulls) in triangles.rests.iter().zip(found).zip(pulls) {
                    let (energy, expected) = triangles.part(rest, uv, shape, 0.3);
                    assert_eq!(found.to_bits(), energy.to_bits());
                    let bits = |pulls: [Vector2<f64>; 3]| pulls.map(|pull| [pull.x.to_bits(), pull.y.to_bits()]);
                    assert_eq!(bits(pulls), bits(expected));
                    infinite += usize::from(energy.is_infinite());
                }
            }
        }
        assert!(infinite > 10);
    }

    #[test]
    fn the_farthest_step_is_the_least_of_all_triangles() {
        let (triangles, maps) = maps();
        for [uv, direction] in &maps {
            let alone = triangles.rests.iter().map(|rest| farthest_step(std::slice::from_ref(rest), uv, direction));
            let least = alone.fold(f64::INFINITY, f64::min);
            assert!(least.is_finite());
            assert_eq!(farthest_step(&triangles.rests, uv, direction).to_bits(), least.to_bits());
        }
    }
}
