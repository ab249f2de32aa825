//! Interpolation by radial functions.
//!
//! Grossmann et al. (2002), section 4, equations 7 to 9: each flat coordinate is f(x) = Σᵢ bᵢ |x − xᵢ| + a₀ + a·x with
//! Σ bᵢ = 0, Σ bᵢ xᵢ = 0 and f(xᵢ) = ξᵢ. It is the smoothest of all such functions.

use faer::{Mat, Side, linalg::solvers::Solve};
use nalgebra::{Matrix3, Vector3};

use crate::{Control, Error, Result};

/// The number of points per task: few enough to cancel soon, and to keep both threads busy.
const BATCH: usize = 1024;

/// Two coordinates interpolated in space.
#[derive(Debug, Clone)]
pub(crate) struct RadialFunctions {
    centre: Vector3<f64>,
    axes: Vec<Vector3<f64>>,
    x: Vec<f64>,
    y: Vec<f64>,
    z: Vec<f64>,
    weights: [Vec<f64>; 2],
    linear: [Vec<f64>; 2],
}

impl RadialFunctions {
    /// Fits functions with the values `values[i]` at `points[i]` (mm).
    ///
    /// The linear part covers only the directions in which the points extend. For points in a plane or on a line,
    /// equations 8 and 9 do not determine the other directions, which are excluded.
    pub(crate) fn fit(points: &[Vector3<f64>], values: &[[f64; 2]]) -> Result<Self> {
        let m = points.len();
        let centre = points.iter().sum::<Vector3<f64>>() / m.max(1) as f64;
        let axes = extended_axes(points, centre);
        let size = m + 1 + axes.len();
        let polynomial = |i: usize, k: usize| {
            if k == 0 { 1.0 } else { axes[k - 1].dot(&(points[i] - centre)) }
        };
        // [A E; Eᵀ 0] [b; a] = [ξ; 0] (Grossmann, Kiryati & Kimmel 2002, section 4)
        let system = Mat::from_fn(size, size, |r, c| match (r < m, c < m) {
            (true, true) => (points[r] - points[c]).norm(),
            (true, false) => polynomial(r, c - m),
            (false, true) => polynomial(c, r - m),
            (false, false) => 0.0,
        });
        let right = Mat::from_fn(size, 2, |r, k| if r < m { values[r][k] } else { 0.0 });
        // symmetric but indefinite because of the zero block: Bunch–Kaufman instead of Cholesky
        let solution = system.lblt(Side::Lower).solve(&right);
        let column = |k: usize| solution.col(k).iter().copied().collect::<Vec<f64>>();
        let [first, second] = [column(0), column(1)];
        let residual = &system * &solution - &right;
        // the factor of a singular matrix need not fail, but its solution does not satisfy the equations
        let tolerance = 1e-6 * right.norm_max();
        if residual.col_iter().flat_map(|column| column.iter()).any(|r| !r.is_finite() || r.abs() > tolerance) {
            return Err(Error::RadialSingular { sources: m });
        }
        let coordinate = |axis: usize| points.iter().map(|p| p[axis] - centre[axis]).collect();
        Ok(Self {
            centre,
            axes,
            x: coordinate(0),
            y: coordinate(1),
            z: coordinate(2),
            weights: [first[..m].to_vec(), second[..m].to_vec()],
            linear: [first[m..].to_vec(), second[m..].to_vec()],
        })
    }

    /// Returns the two values at a point (mm).
    pub(crate) fn at(&self, point: &Vector3<f64>) -> [f64; 2] {
        let p = point - self.centre;
        let mut sum = [self.linear[0][0], self.linear[1][0]];
        for (k, axis) in self.axes.iter().enumerate() {
            sum[0] += self.linear[0][k + 1] * axis.dot(&p);
            sum[1] += self.linear[1][k + 1] * axis.dot(&p);
        }
        let radial = self.radial(&p);
        [sum[0] + radial[0], sum[1] + radial[1]]
    }

    /// Returns Σᵢ bᵢ |p − xᵢ|, in lanes that the compiler can vectorise.
    fn radial(&self, p: &Vector3<f64>) -> [f64; 2] {
        const LANES: usize = 8;
        let mut sums = [[0.0; LANES]; 2];
        let [first, second] = &self.weights;
        let whole = self.x.len() / LANES * LANES;
        for start in (0..whole).step_by(LANES) {
            let range = start..start + LANES;
            let (x, y, z) = (&self.x[range.clone()], &self.y[range.clone()], &self.z[range.clone()]);
            let (b, c) = (&first[range.clone()], &second[range]);
            for lane in 0..LANES {
                let r = distance(p, x[lane], y[lane], z[lane]);
                sums[0][lane] += b[lane] * r;
                sums[1][lane] += c[lane] * r;
            }
        }
        let mut total = sums.map(|lanes| lanes.iter().sum::<f64>());
        for i in whole..self.x.len() {
            let r = distance(p, self.x[i], self.y[i], self.z[i]);
            total[0] += first[i] * r;
            total[1] += second[i] * r;
        }
        total
    }

    /// Returns the values at many points, computed in parallel.
    pub(crate) fn at_all(&self, points: &[Vector3<f64>], control: &Control) -> Result<Vec<[f64; 2]>> {
        control.each("placing the remaining points", points, BATCH, |point| self.at(point))
    }
}

#[inline(always)]
fn distance(p: &Vector3<f64>, x: f64, y: f64, z: f64) -> f64 {
    let (dx, dy, dz) = (p.x - x, p.y - y, p.z - z);
    (dx * dx + dy * dy + dz * dz).sqrt()
}

/// Returns the principal directions in which points extend by more than rounding.
fn extended_axes(points: &[Vector3<f64>], centre: Vector3<f64>) -> Vec<Vector3<f64>> {
    let covariance: Matrix3<f64> = points.iter().map(|p| (p - centre) * (p - centre).transpose()).sum();
    let eigen = covariance.symmetric_eigen();
    let largest = eigen.eigenvalues.max();
    let extended = |k: &usize| eigen.eigenvalues[*k] > 1e-12 * largest;
    (0..3).filter(extended).map(|k| eigen.eigenvectors.column(k).into_owned()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn random_points(count: usize, spread: [f64; 3], seed: u64) -> Vec<Vector3<f64>> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        (0..count).map(|_| Vector3::from(spread.map(|s| 100.0 + s * rng.random_range(-1.0..1.0)))).collect()
    }

    fn close(a: [f64; 2], b: [f64; 2], tolerance: f64) -> bool {
        (a[0] - b[0]).abs() < tolerance && (a[1] - b[1]).abs() < tolerance
    }

    const SPREADS: [[f64; 3]; 5] =
        [[40.0, 30.0, 20.0], [40.0, 30.0, 0.1], [40.0, 30.0, 0.0], [0.0, 30.0, 20.0], [40.0, 0.0, 0.0]];

    #[test]
    fn the_known_points_keep_their_values() {
        for spread in SPREADS {
            let points = random_points(57, spread, 2);
            let values: Vec<[f64; 2]> = points.iter().map(|p| [(p.x / 9.0).sin() * 20.0, p.y * p.z / 50.0]).collect();
            let functions = RadialFunctions::fit(&points, &values).unwrap();
            for (point, value) in points.iter().zip(values) {
                assert!(close(functions.at(point), value, 1e-6), "{spread:?}");
            }
        }
    }

    #[test]
    fn linear_functions_are_exact_everywhere() {
        for spread in SPREADS {
            let linear = |p: &Vector3<f64>| [3.0 + p.x - 2.0 * p.y + 0.5 * p.z, p.z - p.x];
            let points = random_points(20, spread, 3);
            let values: Vec<[f64; 2]> = points.iter().map(linear).collect();
            let functions = RadialFunctions::fit(&points, &values).unwrap();
            for point in random_points(50, spread, 4) {
                assert!(close(functions.at(&point), linear(&point), 1e-6), "{spread:?}");
            }
        }
    }

    #[test]
    fn the_side_conditions_hold() {
        let points = random_points(61, SPREADS[0], 5);
        let values: Vec<[f64; 2]> = points.iter().map(|p| [p.norm(), (p.x / 5.0).cos()]).collect();
        let functions = RadialFunctions::fit(&points, &values).unwrap();
        for weights in &functions.weights {
            let size: f64 = weights.iter().map(|b| b.abs()).sum();
            let moment: Vector3<f64> = weights.iter().zip(&points).map(|(&b, p)| p * b).sum();
            assert!(weights.iter().sum::<f64>().abs() < 1e-9 * size && moment.norm() < 1e-6 * size);
        }
    }

    #[test]
    fn many_points_are_placed_as_one_by_one() {
        let points = random_points(30, SPREADS[0], 6);
        let values: Vec<[f64; 2]> = points.iter().map(|p| [p.x, p.y.sin()]).collect();
        let functions = RadialFunctions::fit(&points, &values).unwrap();
        let others = random_points(3000, SPREADS[0], 7);
        let together = functions.at_all(&others, &Control::default()).unwrap();
        assert!(together.iter().zip(&others).all(|(&value, point)| value == functions.at(point)));
    }

    #[test]
    fn coinciding_points_are_refused() {
        let points = vec![Vector3::new(1.0, 2.0, 3.0); 5];
        let values = vec![[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0], [4.0, 0.0]];
        assert!(matches!(RadialFunctions::fit(&points, &values), Err(Error::RadialSingular { sources: 5 })));
    }
}
