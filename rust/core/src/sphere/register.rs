//! Registration: rotates and warps a surface's sphere until the pattern of its folds matches a template's.
//!
//! All computations use a surface of about 10,000 vertices. First, a grid of rotations is compared by the correlation
//! of depths and by the fit of one rigid motion from the smoothed surface's positions to the template's (Kabsch 1976).
//! The best ones are refined. Then vertices move step by step: each by the Gauss-Newton step of the differences (as in
//! spherical demons, Yeo et al. 2010), smoothed over the sphere, and back by the energy of the [map](super::map) where
//! triangles are distorted. No step flips a triangle. Finally, decimated vertices are re-inserted into kernels.

use nalgebra::{Matrix3, Matrix3x4, Matrix4, Rotation3, Unit, UnitQuaternion, Vector3, Vector4};
use rayon::prelude::*;

use super::locate::{Located, Locator};
use super::map::{Metric, check_closed, closed, levels, map_of_level, refined};
use super::pattern::{Pattern, SCALES, Smoothing, pattern};
use crate::adjacency::marked;
use crate::error::check_length;
use crate::surface::Surface;
use crate::{Control, Error, Result};

/// The maximum number of vertices of the surface on which the registration is computed.
const MOST_VERTICES: usize = 12_000;

/// The number of rotations that are tried, about 11° apart.
const ROTATIONS: usize = 6000;

/// The number of rotations that are evaluated again at more vertices, and the number of these that are refined.
const AGAIN: usize = 300;
const REFINED: usize = 24;

/// The number of vertices at which rotations are evaluated; the first evaluation uses every third of them.
const EVALUATED: usize = 450;

/// The number of sweeps over the re-inserted vertices of a level.
const NEW_SWEEPS: usize = 3;

/// The weights of the scales' correlations and of the rigid fit in the score of a rotation.
const ROTATION_WEIGHTS: [f64; 4] = [1.0, 1.0, 0.5, 1.0];

/// A template: a sphere with the pattern at each of its vertices.
#[derive(Debug, Clone)]
pub struct Template {
    sphere: Surface,
    depths: Vec<Vec<f64>>,
    places: Vec<Vector3<f64>>,
    weights: Vec<f64>,
    depth_slopes: Vec<Vec<Vector3<f64>>>,
    place_slopes: [Vec<Vector3<f64>>; 3],
}

/// The agreement of a surface's pattern with a template's after the best rotation.
#[derive(Debug, Clone, PartialEq)]
pub struct Alignment {
    /// The correlations of depths for each scale.
    pub correlations: Vec<f64>,
    /// The fit of a rigid motion of the positions to the template's: 1 for the same shape.
    pub rigid: f64,
    /// The score of rotations and of templates: the weighted sum of both.
    pub score: f64,
}

/// A surface on a template's sphere.
#[derive(Debug, Clone, PartialEq)]
pub struct Registration {
    /// The positions of the vertices on the unit sphere.
    pub points: Vec<Vector3<f64>>,
    /// The index of the template.
    pub template: usize,
    /// The alignment with each template.
    pub alignments: Vec<Alignment>,
    /// The correlations of depths after the warp for each scale.
    pub correlations: Vec<f64>,
    /// The share of the variance of the template's positions that an affine map of the surface's explains.
    pub affine: f64,
}

impl Template {
    /// Creates a template from a sphere, counterclockwise as seen from outside, and the [pattern](super::pattern) at
    /// its vertices: depths for each scale, positions, and the weight of each vertex.
    ///
    /// # Errors
    /// [`Error::NotASphere`], and [`Error::WrongLength`] if values are missing for a vertex or a scale.
    pub fn new(sphere: Surface, depths: Vec<Vec<f64>>, places: Vec<Vector3<f64>>, weights: Vec<f64>) -> Result<Self> {
        check_closed(&sphere)?;
        check_length("lists of depths", depths.len(), "scales", SCALES.len())?;
        depths.iter().try_for_each(|depth| check_length("depths", depth.len(), "vertices", sphere.len()))?;
        check_length("places", places.len(), "vertices", sphere.len())?;
        check_length("weights", weights.len(), "vertices", sphere.len())?;
        let of = |axis: usize| slopes(&sphere, &places.iter().map(|p| p[axis]).collect::<Vec<_>>());
        let place_slopes = [of(0), of(1), of(2)];
        let depth_slopes = depths.iter().map(|depth| slopes(&sphere, depth)).collect();
        Ok(Self { sphere, depths, places, weights, depth_slopes, place_slopes })
    }

    fn locator(&self) -> Locator<'_> {
        Locator::over(&self.sphere)
    }
}

/// Returns the gradient at each vertex of a sphere, for a function that is linear between vertices.
fn slopes(sphere: &Surface, values: &[f64]) -> Vec<Vector3<f64>> {
    let mut sums = vec![Vector3::zeros(); sphere.len()];
    let mut areas = vec![0.0; sphere.len()];
    for face in sphere.faces() {
        let [a, b, c] = face.map(|v| sphere.points()[v as usize]);
        let [x, y, z] = face.map(|v| values[v as usize]);
        let normal = (b - a).cross(&(c - a));
        let double = normal.norm();
        // Σ value · (n × opposite side)/(2 A): gradients of hat functions
        let slope = normal.cross(&((c - b) * x + (a - c) * y + (b - a) * z)) / (double * double);
        for &v in face {
            sums[v as usize] += slope * double;
            areas[v as usize] += double;
        }
    }
    let points = sphere.points();
    let tangent = |v: usize| {
        let s: Vector3<f64> = sums[v] / areas[v];
        s - points[v] * s.dot(&points[v])
    };
    (0..sums.len()).map(tangent).collect()
}

/// Registers a surface to the template whose pattern agrees better after a rotation, or to the `named` one.
///
/// # Errors
/// [`Error::NoSuchTemplate`] if the named template does not exist, or there is none; [`Error::NotASphere`] if the
/// surface is not connected or has handles; [`Error::Folded`] if triangles are too thin for a map; and
/// [`Error::Cancelled`].
pub fn register(
    surface: &Surface, templates: &[Template], named: Option<usize>, control: &Control,
) -> Result<Registration> {
    let count = templates.len();
    if named.unwrap_or(0) >= count {
        return Err(Error::NoSuchTemplate { template: named.unwrap_or(0), templates: count });
    }
    let closed = closed(surface, control)?;
    let levels = levels(&closed, control)?;
    let level = |n: usize| if n == 0 { &closed } else { &levels[n - 1].surface };
    let depth = (0..=levels.len()).find(|&n| level(n).len() <= MOST_VERTICES).unwrap_or(levels.len());
    let subject = Subject::new(level(depth), map_of_level(&closed, &levels, depth, control)?, control)?;
    control.begin("trying rotations", ((ROTATIONS + AGAIN) * templates.len()) as u64);
    let align = |template: &Template| {
        let locator = template.locator();
        let rotation = subject.rotation(template, &locator, control)?;
        let places: Vec<Vector3<f64>> = subject.places.iter().map(|p| rotation * p).collect();
        Ok((subject.alignment(template, &locator, &places), places))
    };
    let mut aligned: Vec<(Alignment, Vec<Vector3<f64>>)> = templates.iter().map(align).collect::<Result<_>>()?;
    let score = |n: usize| aligned[n].0.score;
    let best = (0..aligned.len()).max_by(|&a, &b| score(a).total_cmp(&score(b)).then(b.cmp(&a)));
    let chosen = named.or(best).unwrap_or(0);
    let mut places = std::mem::take(&mut aligned[chosen].1);
    let (template, locator) = (&templates[chosen], templates[chosen].locator());
    subject.warp(template, &locator, &mut places, control)?;
    let correlations = subject.alignment(template, &locator, &places).correlations;
    let affine = subject.affine(template, &locator, &places).1;
    for n in (0..depth).rev() {
        let finer = level(n);
        places = refined(&levels[n], finer, &places, true, control)?;
        let is_old = marked(finer.len(), &levels[n].survivors);
        Metric::new(finer).relax(finer, &mut places, NEW_SWEEPS, |v| !is_old[v], control)?;
    }
    places.truncate(surface.len());
    let alignments = aligned.into_iter().map(|(alignment, _)| alignment).collect();
    Ok(Registration { points: places, template: chosen, alignments, correlations, affine })
}

impl Alignment {
    fn new(correlations: Vec<f64>, rigid: f64) -> Self {
        let terms = correlations.iter().chain([&rigid]);
        let score = ROTATION_WEIGHTS.iter().zip(terms).map(|(weight, term)| weight * term).sum();
        Self { correlations, rigid, score }
    }
}

/// The surface to be registered, on its own sphere.
struct Subject<'a> {
    surface: &'a Surface,
    places: Vec<Vector3<f64>>,
    pattern: Pattern,
    evaluated: Vec<u32>,
}

/// The parameters of one stage of the warp.
struct Stage {
    steps: usize,
    /// The weights of differences of depths for each scale, and of positions.
    depths: [f64; 3],
    places: f64,
    /// The standard deviation of the smoothing of steps in radians.
    smoothing: f64,
    /// The number of sweeps that reduce distortion after each step.
    sweeps: usize,
}

/// First the overall shape, then finer and finer folds.
const STAGES: [Stage; 4] = [
    Stage { steps: 20, depths: [0.0, 0.0, 0.0], places: 4.0, smoothing: 0.30, sweeps: 1 },
    Stage { steps: 30, depths: [0.5, 0.5, 0.0], places: 3.0, smoothing: 0.15, sweeps: 1 },
    Stage { steps: 30, depths: [0.5, 1.0, 1.0], places: 2.0, smoothing: 0.12, sweeps: 1 },
    Stage { steps: 30, depths: [0.0, 1.0, 1.0], places: 2.0, smoothing: 0.08, sweeps: 1 },
];

/// The unit of differences of positions (relative to [`super::pattern::RADIUS`]).
const PLACE_UNIT: f64 = 20.0;

/// The damping that is added to the diagonal of the Gauss-Newton matrix and shortens steps, for slopes in 1/radian.
const DAMPING: f64 = 2.0;

/// The longest step in radians.
const LONGEST: f64 = 0.05;

impl<'a> Subject<'a> {
    fn new(surface: &'a Surface, places: Vec<Vector3<f64>>, control: &Control) -> Result<Self> {
        let pattern = pattern(surface, control)?;
        // evenly by area, in the order of the vertices
        let (mut evaluated, mut sum) = (Vec::with_capacity(EVALUATED), 0.0);
        for (v, area) in pattern.areas.iter().enumerate() {
            sum += area * EVALUATED as f64;
            if sum > evaluated.len() as f64 + 0.5 {
                evaluated.push(v as u32);
            }
        }
        Ok(Self { surface, places, pattern, evaluated })
    }

    /// Returns the agreement with a template if the vertices lie at `places` on its sphere.
    fn alignment(&self, template: &Template, locator: &Locator<'_>, places: &[Vector3<f64>]) -> Alignment {
        let all: Vec<u32> = (0..places.len() as u32).collect();
        let at: Vec<Located> = places.iter().map(|place| locator.locate(place)).collect();
        Alignment::new(self.correlations(template, &all, &at), self.rigid_fit(template, &all, &at))
    }

    fn correlations(&self, template: &Template, of: &[u32], at: &[Located]) -> Vec<f64> {
        let faces = template.sphere.faces();
        let weight = |(&v, at): (&u32, &Located)| self.pattern.areas[v as usize] * at.value(faces, &template.weights);
        let weights: Vec<f64> = of.iter().zip(at).map(weight).collect();
        let of_scale = |n: usize| {
            let (own, theirs) = (&self.pattern.depths[n], &template.depths[n]);
            correlation(of.iter().zip(at).map(|(&v, at)| [own[v as usize], at.value(faces, theirs)]), &weights)
        };
        (0..SCALES.len()).map(of_scale).collect()
    }

    /// Returns the fit of a rigid motion of the positions to the template's at `at`: 1 for the same shape.
    fn rigid_fit(&self, template: &Template, of: &[u32], at: &[Located]) -> f64 {
        let faces = template.sphere.faces();
        let pair = |(&v, at): (&u32, &Located)| [self.pattern.places[v as usize], at.vector(faces, &template.places)];
        let pairs: Vec<[Vector3<f64>; 2]> = of.iter().zip(at).map(pair).collect();
        let total: f64 = of.iter().map(|&v| self.pattern.areas[v as usize]).sum();
        let mean = |k: usize| -> Vector3<f64> {
            of.iter().zip(&pairs).map(|(&v, pair)| pair[k] * self.pattern.areas[v as usize]).sum::<Vector3<f64>>()
                / total
        };
        let means = [mean(0), mean(1)];
        let (mut cross, mut squares) = (Matrix3::zeros(), [0.0; 2]);
        for (&v, pair) in of.iter().zip(&pairs) {
            let area = self.pattern.areas[v as usize];
            let [p, q] = [pair[0] - means[0], pair[1] - means[1]];
            cross += p * q.transpose() * area;
            squares[0] += p.norm_squared() * area;
            squares[1] += q.norm_squared() * area;
        }
        // the best rotation attains σ₁ + σ₂ ± σ₃, with the sign that excludes reflections (Kabsch 1976)
        let mut values = cross.singular_values();
        values.as_mut_slice().sort_by(|a, b| b.total_cmp(a));
        (values[0] + values[1] + values[2] * cross.determinant().signum()) / (squares[0] * squares[1]).sqrt()
    }

    /// Returns the rotation after which the patterns agree best.
    fn rotation(&self, template: &Template, locator: &Locator<'_>, control: &Control) -> Result<Rotation3<f64>> {
        let score = |rotation: &Rotation3<f64>, of: &[u32]| {
            let at: Vec<Located> = of.iter().map(|&v| locator.locate(&(rotation * self.places[v as usize]))).collect();
            let correlations = self.correlations(template, of, &at);
            Alignment::new(correlations, self.rigid_fit(template, of, &at)).score
        };
        let best = |of: &[u32], among: Vec<usize>, count: usize| {
            let evaluate = |n: usize| {
                control.check()?;
                control.advance();
                Ok((score(&rotation(n, ROTATIONS), of), n))
            };
            let mut found: Vec<(f64, usize)> = among.into_par_iter().map(evaluate).collect::<Result<_>>()?;
            found.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
            found.truncate(count);
            Ok(found)
        };
        let few: Vec<u32> = self.evaluated.iter().copied().step_by(3).collect();
        let promising = best(&few, (0..ROTATIONS).collect(), AGAIN)?.into_iter().map(|(_, n)| n).collect();
        let tried = best(&self.evaluated, promising, REFINED)?;
        let refine = |&(value, n): &(f64, usize)| {
            let (mut best, mut value) = (rotation(n, ROTATIONS), value);
            for angle in [0.1f64, 0.05, 0.025, 0.0125] {
                for _ in 0..4 {
                    control.check()?;
                    let before = value;
                    for axis in [Vector3::x(), Vector3::y(), Vector3::z()] {
                        for turn in [angle, -angle] {
                            let other = Rotation3::from_axis_angle(&Unit::new_unchecked(axis), turn) * best;
                            let of_other = score(&other, &self.evaluated);
                            if of_other > value {
                                (best, value) = (other, of_other);
                            }
                        }
                    }
                    if value == before {
                        break;
                    }
                }
            }
            Ok((value, n, best))
        };
        let found: Vec<(f64, usize, Rotation3<f64>)> = tried.par_iter().map(refine).collect::<Result<_>>()?;
        let best = found.iter().max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)));
        Ok(best.map_or_else(Rotation3::identity, |best| best.2))
    }

    /// Returns the least-squares affine map of the positions to the template's, and the explained variance share.
    fn affine(&self, template: &Template, locator: &Locator<'_>, places: &[Vector3<f64>]) -> (Matrix3x4<f64>, f64) {
        let faces = template.sphere.faces();
        let (mut normal, mut right) = (Matrix4::zeros(), Matrix3x4::zeros());
        let (mut mean, mut square) = (Vector3::zeros(), 0.0);
        for (v, place) in places.iter().enumerate() {
            let area = self.pattern.areas[v];
            let p = self.pattern.places[v].push(1.0);
            let q = locator.locate(place).vector(faces, &template.places);
            normal += p * p.transpose() * area;
            right += q * p.transpose() * area;
            mean += q * area;
            square += q.norm_squared() * area;
        }
        // normal equations: the affine map A = (Σ q pᵀ)(Σ p pᵀ)⁻¹ in homogeneous coordinates
        let affine = normal.try_inverse().map_or_else(Matrix3x4::zeros, |inverse| right * inverse);
        let explained = (affine * normal * affine.transpose()).trace() - mean.norm_squared();
        (affine, explained / (square - mean.norm_squared()))
    }

    fn warp(
        &self, template: &Template, locator: &Locator<'_>, places: &mut [Vector3<f64>], control: &Control,
    ) -> Result<()> {
        let faces = template.sphere.faces();
        let metric = Metric::new(&self.surface.moved(places.to_vec())?);
        let smoothing = Smoothing::new(places, self.surface.faces());
        control.begin("warping the sphere", STAGES.iter().map(|stage| stage.steps as u64).sum());
        let mut ring = Vec::new();
        for stage in &STAGES {
            let mut affine = Matrix3x4::zeros();
            for step in 0..stage.steps {
                control.check()?;
                if step % 5 == 0 {
                    affine = self.affine(template, locator, places).0;
                }
                let at: Vec<Located> = places.par_iter().map(|place| locator.locate(place)).collect();
                let force = |v: usize| {
                    let at = &at[v];
                    // Levenberg: (λ I + Σ w g gᵀ) step = Σ w g · difference
                    let (mut matrix, mut right) = (Matrix3::identity() * DAMPING, Vector3::zeros());
                    let mut add = |difference: f64, slope: Vector3<f64>, weight: f64| {
                        let slope = slope - places[v] * slope.dot(&places[v]);
                        matrix += slope * slope.transpose() * weight;
                        right += slope * (difference * weight);
                    };
                    let count = at.value(faces, &template.weights);
                    for n in (0..SCALES.len()).filter(|&n| stage.depths[n] > 0.0) {
                        let difference = self.pattern.depths[n][v] - at.value(faces, &template.depths[n]);
                        add(difference, at.vector(faces, &template.depth_slopes[n]), stage.depths[n] * count);
                    }
                    let moved: Vector4<f64> = self.pattern.places[v].push(1.0);
                    let apart = affine * moved - at.vector(faces, &template.places);
                    for axis in 0..3 {
                        let slope = at.vector(faces, &template.place_slopes[axis]) / PLACE_UNIT;
                        add(apart[axis] / PLACE_UNIT, slope, stage.places);
                    }
                    let step = matrix.cholesky().map_or_else(Vector3::zeros, |cholesky| cholesky.solve(&right));
                    step * (LONGEST / step.norm().max(LONGEST)).min(1.0)
                };
                let steps: Vec<Vector3<f64>> = (0..places.len()).into_par_iter().map(force).collect();
                let steps = smoothing.smoothed(&steps, stage.smoothing, smoothing.step, control)?;
                for v in 0..places.len() {
                    let tangent = steps[v] - places[v] * steps[v].dot(&places[v]);
                    metric.shift(self.surface, v, (places[v] + tangent).normalize(), places);
                }
                for _ in 0..stage.sweeps {
                    for v in 0..places.len() {
                        metric.ease(self.surface, v, places, &mut ring);
                    }
                }
                control.advance();
            }
        }
        Ok(())
    }
}

fn correlation(pairs: impl Iterator<Item = [f64; 2]>, weights: &[f64]) -> f64 {
    let mut sums = [0.0; 6];
    for ([x, y], w) in pairs.zip(weights) {
        for (sum, term) in sums.iter_mut().zip([1.0, x, y, x * x, y * y, x * y]) {
            *sum += w * term;
        }
    }
    let [n, x, y, xx, yy, xy] = sums;
    // Pearson's correlation, from weighted sums
    let spread = (n * xx - x * x) * (n * yy - y * y);
    if spread > 0.0 { (n * xy - x * y) / spread.sqrt() } else { 0.0 }
}

/// Returns the n-th of evenly spread rotations (super-Fibonacci spirals, Alexa 2022).
fn rotation(n: usize, count: usize) -> Rotation3<f64> {
    const PHI: f64 = std::f64::consts::SQRT_2;
    const PSI: f64 = 1.533_751_168_755_204_3;
    let s = n as f64 + 0.5;
    let t = s / count as f64;
    let [alpha, beta] = [PHI, PSI].map(|by| std::f64::consts::TAU * s / by);
    let [r, q] = [t.sqrt(), (1.0 - t).sqrt()];
    let quaternion = nalgebra::Quaternion::new(r * alpha.sin(), r * alpha.cos(), q * beta.sin(), q * beta.cos());
    UnitQuaternion::from_quaternion(quaternion).to_rotation_matrix()
}

#[cfg(test)]
mod tests {
    use nalgebra::DMatrix;

    use super::*;
    use crate::surface::mesh::shapes;

    #[test]
    fn the_share_that_an_affine_map_explains_is_that_of_linear_regression() {
        let control = Control::default();
        let sphere = shapes::surface(shapes::sphere(3));
        let egg =
            sphere.moved(sphere.points().iter().map(|p| [2.0 * p.x, p.y + 0.4 * p.x * p.x, p.z].into()).collect());
        let egg = egg.unwrap();
        let subject = Subject::new(&egg, sphere.points().to_vec(), &control).unwrap();
        for noise in [0.0, 8.0, 60.0] {
            let shake = |n: usize| Vector3::new((7.1 * n as f64).sin(), (3.3 * n as f64).cos(), (1.7 * n as f64).sin());
            let shift = Vector3::new(30.0, -90.0, 15.0);
            let own = &subject.pattern.places;
            let places: Vec<Vector3<f64>> =
                (0..own.len()).map(|n| 0.7 * own[n].yzx() + shift + shake(n) * noise).collect();
            let depths = vec![vec![0.0; own.len()]; SCALES.len()];
            let template = Template::new(sphere.clone(), depths, places.clone(), vec![1.0; own.len()]).unwrap();
            let share = subject.affine(&template, &template.locator(), sphere.points()).1;
            let areas = &subject.pattern.areas;
            let design = DMatrix::from_fn(own.len(), 4, |n, k| areas[n].sqrt() * if k < 3 { own[n][k] } else { 1.0 });
            let targets = DMatrix::from_fn(own.len(), 3, |n, k| areas[n].sqrt() * places[n][k]);
            let rest = &targets - &design * design.clone().svd(true, true).solve(&targets, 1e-12).unwrap();
            let mean: Vector3<f64> = places.iter().zip(areas).map(|(p, area)| p * *area).sum();
            let spread: f64 = places.iter().zip(areas).map(|(p, area)| (p - mean).norm_squared() * area).sum();
            let expected = 1.0 - rest.norm_squared() / spread;
            assert!((share - expected).abs() < 1e-6, "{noise} {share} {expected}");
            assert!(noise > 0.0 || (share - 1.0).abs() < 1e-6);
        }
    }

    #[test]
    fn a_rigid_motion_turns_and_does_not_mirror() {
        let control = Control::default();
        let sphere = shapes::surface(shapes::sphere(4));
        let stretched = sphere.points().iter().map(|p| [3.0 * p.x, 2.0 * p.y, p.z].into()).collect();
        let egg = sphere.moved(stretched).unwrap();
        let subject = Subject::new(&egg, sphere.points().to_vec(), &control).unwrap();
        let all: Vec<u32> = (0..egg.len() as u32).collect();
        let fit = |to: &dyn Fn(&Vector3<f64>) -> Vector3<f64>| {
            let places = subject.pattern.places.iter().map(to).collect();
            let template =
                Template::new(sphere.clone(), vec![vec![0.0; egg.len()]; 3], places, vec![1.0; egg.len()]).unwrap();
            let locator = template.locator();
            let at: Vec<Located> = sphere.points().iter().map(|place| locator.locate(place)).collect();
            subject.rigid_fit(&template, &all, &at)
        };
        let turn = Rotation3::from_euler_angles(0.4, 2.0, -1.3);
        assert!((fit(&|p| turn * p * 7.0) - 1.0).abs() < 1e-9);
        // the best rotation of a copy that is mirrored along any axis gives up the smallest moment
        let moments =
            subject.pattern.places.iter().zip(&subject.pattern.areas).map(|(p, area)| p.component_mul(p) * *area);
        let [x, y, z]: [f64; 3] = moments.sum::<Vector3<f64>>().into();
        let mirrored = fit(&|p| turn * Vector3::new(-p.x, p.y, p.z));
        assert!((mirrored - (x + y - z) / (x + y + z)).abs() < 1e-6, "{mirrored}");
    }
}
