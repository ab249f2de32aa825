//! The distortion of triangles as an energy: zero where they keep their shape and size, infinite where they fold.
//!
//! With J the map's Jacobian on a triangle and D its determinant, the energy is the mean over the surface of
//!
//!   ψ(J) = 2κ² (√(1 + φ(J)/κ²) − 1),
//!   φ(J) = 2 (1 − λ) ((σ₁ − 1)² + (σ₂ − 1)²) + λ (½ ‖J‖² (1 + 1/D²) − 2) + γ log² D,
//!
//! infinite for folded triangles. σ are J's singular values. The first term is as rigid as possible (Liu et al. 2008).
//! The second, the symmetric Dirichlet energy (Smith, Schaefer 2015), is as stiff around an undistorted map, but also a
//! barrier. γ is an additional penalty on changes of area. ψ is to φ as ρ is to squared errors of
//! [distances](super::pairs): triangles that cannot keep their shape, such as those of a deep pit, do not dominate the
//! map around them. Since σ₁ + σ₂ = √(‖J‖² + 2 D), φ is a function of h = ½ ‖J‖² and D.

mod lanes;

use crate::embed::Place;
use nalgebra::{Matrix2, Vector2, Vector3};
use rayon::prelude::*;

use crate::adjacency::Groups;
use crate::surface::Surface;

/// The minimum ratio of a triangle's height and longest side; thinner triangles count as if they had it, because their
/// shape is noise. Where a fifth of all triangles are thinner, the ratio is a share of theirs instead.
const THINNEST: f64 = 1e-4;
const MANY: f64 = 0.2;
const THINNER_THAN_MANY: f64 = 0.25;

/// Springs are half as stiff as the curvature of the energy in all four directions of J together, within these limits,
/// because springs have one stiffness for all directions.
const MODES: f64 = 2.0;
const SOFTEST: f64 = 1.0;
const STIFFEST: f64 = 1e9;

/// The number of triangles that are visited together.
const BATCH: usize = 2048;

/// The shape of a triangle on the surface.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rest {
    pub(crate) corners: [u32; 3],
    /// Maps two sides of the flat triangle, as columns, to J.
    pub(crate) inverse: Matrix2<f64>,
    /// Area in mm².
    pub(crate) area: f64,
    /// The logarithm of the factor by which its area is enlarged, if it is too thin.
    pub(crate) trim: f64,
}

impl Rest {
    /// Creates a triangle at `points` whose height is at least `thinnest` times the length of its longest side.
    pub(crate) fn of(points: [Vector3<f64>; 3], face: [u32; 3], thinnest: f64) -> Self {
        let sides = [0, 1, 2].map(|n| points[(n + 1) % 3] - points[n]);
        let longest = (0..3).max_by(|&a, &b| sides[a].norm_squared().total_cmp(&sides[b].norm_squared())).unwrap_or(0);
        let corners = [0, 1, 2].map(|n| face[(longest + n) % 3]);
        let (base, other) = (sides[longest], -sides[(longest + 2) % 3]);
        let length = base.norm().max(f64::MIN_POSITIVE);
        let along = other.dot(&base) / length;
        let own = base.cross(&other).norm() / length;
        let height = own.max(thinnest * length);
        // the inverse of the two sides as columns, with the base on the first axis
        let inverse = Matrix2::new(length.recip(), -along / (length * height), 0.0, height.recip());
        Self { corners, inverse, area: 0.5 * length * height, trim: (height / own).ln() }
    }

    /// Returns the height over the longest side, as a share of it.
    fn height(&self) -> f64 {
        2.0 * self.area * self.inverse.m11.powi(2)
    }

    pub(super) fn jacobian(&self, uv: &[Place]) -> Matrix2<f64> {
        let [a, b, c] = self.corners.map(|vertex| uv[vertex as usize]);
        Matrix2::from_columns(&[b - a, c - a]) * self.inverse
    }

    /// Returns the gradient of the function that is 1 at a corner and 0 at the others.
    pub(super) fn hat(&self, corner: usize) -> Place {
        let [b, c] = [self.inverse.row(0).transpose(), self.inverse.row(1).transpose()];
        [-b - c, b, c][corner]
    }

    pub(super) fn energy(&self, uv: &[Place], shape: Shape) -> f64 {
        self.area * shape.price(&self.jacobian(uv)).value
    }

    /// Returns the logarithm of its area in a map divided by that on the surface; NaN where it is folded.
    fn growth(&self, uv: &[Place]) -> f64 {
        (signed_area(self.corners, uv) / self.area).ln() + self.trim
    }

    /// Returns the off-diagonal spring entries for the energy ½ ‖J‖² times `scale`: for corners 01, 02, 12.
    pub(crate) fn springs(&self, scale: f64) -> [f64; 3] {
        let (b, c) = (self.inverse.row(0), self.inverse.row(1));
        let a = -b - c;
        [a.dot(&b) * scale, a.dot(&c) * scale, b.dot(&c) * scale]
    }
}

/// The weights of the triangles' energy.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shape {
    /// λ, the share of the barrier.
    pub barrier: f64,
    /// γ, the weight of changes of area.
    pub area: f64,
    /// κ, the distortion above which triangles count less; infinity for plain φ.
    pub outlier: f64,
}

/// ψ and its derivatives.
#[derive(Debug, Clone, Copy)]
pub(super) struct Price {
    pub(super) value: f64,
    /// With respect to h, and to D.
    pub(super) slopes: [f64; 2],
    /// With respect to h twice, to h and D, and to D twice.
    pub(super) bends: [f64; 3],
}

impl Price {
    /// The value for a fold.
    const INFINITE: Self = Self { value: f64::INFINITY, slopes: [0.0; 2], bends: [0.0; 3] };

    /// Returns its curvatures with respect to J: its Hessian's eigenvalues, two of which only change singular values.
    pub(super) fn curvatures(&self, jacobian: &Matrix2<f64>) -> [f64; 4] {
        let (half, area) = (0.5 * jacobian.norm_squared(), jacobian.determinant());
        let ([by_half, by_area], [half_half, half_area, area_area]) = (self.slopes, self.bends);
        // in the basis of σ₁ and σ₂: mean and half difference of the diagonal, ½ (σ₁² − σ₂²) = √(h² − D²); off-diagonal
        let mean = by_half + half * (half_half + area_area) + 2.0 * area * half_area;
        let apart = (half_half - area_area) * (half * half - area * area).max(0.0).sqrt();
        let across = by_area + area * (half_half + area_area) + 2.0 * half * half_area;
        let radius = apart.hypot(across);
        // rotation and reflection change no σ to first order: (ψ₁ ± ψ₂)/(σ₁ ± σ₂) (Smith, de Goes & Kim 2019)
        [mean + radius, mean - radius, by_half + by_area, by_half - by_area]
    }

    /// Returns ψ from φ (pseudo-Huber); `sharp` is 1/κ², which is 0 without outliers.
    #[inline(always)]
    fn pseudo_huber<const OUTLIERS: bool>(self, sharp: f64) -> Self {
        let root = if OUTLIERS { (1.0 + self.value.max(0.0) * sharp).sqrt() } else { 1.0 };
        // dψ/dφ and d²ψ/dφ²
        let (slope, bend) = (root.recip(), -0.5 * sharp * root.powi(-3));
        let ([by_half, by_area], [half_half, half_area, area_area]) = (self.slopes, self.bends);
        Self {
            // 2κ² (root − 1), without cancellation for small φ
            value: 2.0 * self.value / (1.0 + root),
            slopes: [slope * by_half, slope * by_area],
            bends: [
                slope * half_half + bend * by_half * by_half,
                slope * half_area + bend * by_half * by_area,
                slope * area_area + bend * by_area * by_area,
            ],
        }
    }
}

/// A bound on changes of area: a penalty on the growth or shrinkage of a triangle beyond it, relative to the whole map.
#[derive(Debug, Clone, Copy)]
pub(crate) struct AreaBound {
    /// The logarithm of the growth of the whole map.
    pub mean: f64,
    /// The logarithm of the factor by which triangles may differ from it.
    pub most: f64,
    /// The weight of the squared excess.
    pub weight: f64,
}

impl AreaBound {
    fn add(&self, price: Price, rest: &Rest, jacobian: &Matrix2<f64>) -> Price {
        let area = jacobian.determinant();
        let growth = area.ln() + rest.trim - self.mean;
        let beyond = growth - growth.clamp(-self.most, self.most);
        if beyond == 0.0 || !price.value.is_finite() {
            return price;
        }
        let ([by_half, by_area], [half_half, half_area, area_area]) = (price.slopes, price.bends);
        // with the excess e of log D: d/dD e² = 2 e/D and d²/dD² e² = 2 (1 − e)/D²
        let rise = 2.0 * self.weight / area;
        Price {
            value: price.value + self.weight * beyond * beyond,
            slopes: [by_half, by_area + rise * beyond],
            bends: [half_half, half_area, area_area + rise * (1.0 - beyond) / area],
        }
    }
}

impl Shape {
    pub(super) fn price(&self, jacobian: &Matrix2<f64>) -> Price {
        let (half, area) = (0.5 * jacobian.norm_squared(), jacobian.determinant());
        self.price_of::<true>(half, area, area.ln())
    }

    fn has_outliers(&self) -> bool {
        self.outlier.is_finite()
    }

    /// Returns the same, given h, D and its logarithm. Without branches, many triangles are processed together.
    #[inline(always)]
    fn price_of<const OUTLIERS: bool>(&self, half: f64, area: f64, log: f64) -> Price {
        let inverse = area.powi(2).recip();
        let sum = (2.0 * (half + area)).sqrt(); // of the singular values
        let (rigid, barrier, growth) = (4.0 * (1.0 - self.barrier), self.barrier, self.area);
        // d²/dh² of −√(2 (h + D)) = (2 (h + D))^−3/2, and the same with respect to D
        let bend = rigid / sum.powi(3);
        let distortion = Price {
            // (σ₁ − 1)² + (σ₂ − 1)² = 2 (h − (σ₁ + σ₂) + 1)
            value: rigid * (half - sum + 1.0) + barrier * (half * (1.0 + inverse) - 2.0) + growth * log * log,
            slopes: [
                rigid * (1.0 - sum.recip()) + barrier * (1.0 + inverse),
                -rigid / sum + (2.0 * growth * log - 2.0 * barrier * half * inverse) / area,
            ],
            bends: [
                bend,
                bend - 2.0 * barrier * inverse / area,
                bend + (6.0 * barrier * half * inverse + 2.0 * growth * (1.0 - log)) * inverse,
            ],
        };
        let price = distortion.pseudo_huber::<OUTLIERS>(self.outlier.powi(2).recip());
        // neither folded nor so close to a fold that 1/D² overflows
        let is_open = area > 0.0 && distortion.value.is_finite();
        let or = |number, other| if is_open { number } else { other };
        Price {
            value: or(price.value, Price::INFINITE.value),
            slopes: price.slopes.map(|slope| or(slope, 0.0)),
            bends: price.bends.map(|bend| or(bend, 0.0)),
        }
    }
}

/// Returns the gradient of a triangle's energy with respect to its sides, as columns, from the slopes of its penalty.
#[inline(always)]
fn by_sides(jacobian: &Matrix2<f64>, [by_half, by_area]: [f64; 2], inverse: &Matrix2<f64>, area: f64) -> Matrix2<f64> {
    let by_jacobian = jacobian * by_half + cofactors(jacobian) * by_area;
    by_jacobian * inverse.transpose() * area
}

#[inline(always)]
pub(super) fn cofactors(jacobian: &Matrix2<f64>) -> Matrix2<f64> {
    Matrix2::new(jacobian.m22, -jacobian.m21, -jacobian.m12, jacobian.m11)
}

#[derive(Debug)]
pub struct TriangleEnergy {
    rests: Vec<Rest>,
    /// The area of the surface in mm².
    pub(super) area: f64,
    /// For each vertex its corners: triangle × 3 + corner.
    around: Groups,
    /// An optional additional penalty during the optimisation.
    pub(super) bound: Option<AreaBound>,
}

impl TriangleEnergy {
    pub fn new(surface: &Surface) -> Self {
        let (points, faces) = (surface.points(), surface.faces());
        Self::of(faces, surface.len(), |number| faces[number].map(|vertex| points[vertex as usize]))
    }

    /// Creates the energy of triangles with any shapes, given the positions of each one's corners.
    pub(super) fn of(faces: &[[u32; 3]], vertices: usize, corners: impl Fn(usize) -> [Vector3<f64>; 3]) -> Self {
        let corners = &corners;
        let rests = |thinnest| (0..faces.len()).map(move |n| Rest::of(corners(n), faces[n], thinnest));
        let mut heights: Vec<f64> = rests(0.0).map(|rest| rest.height()).collect();
        let fifth = (MANY * heights.len() as f64) as usize;
        let thin = *heights.select_nth_unstable_by(fifth, f64::total_cmp).1;
        let rests: Vec<Rest> = rests(if thin < THINNEST { THINNER_THAN_MANY * thin } else { THINNEST }).collect();
        let around = Groups::new(vertices, rests.iter().flat_map(|rest| rest.corners));
        let area = rests.iter().map(|rest| rest.area).sum();
        Self { rests, area, around, bound: None }
    }

    pub fn corners(&self) -> impl ExactSizeIterator<Item = [u32; 3]> + '_ {
        self.rests.iter().map(|rest| rest.corners)
    }

    /// Iterates over the triangles around a vertex, with the number of its corner in each.
    pub(super) fn around(&self, vertex: usize) -> impl Iterator<Item = (&Rest, usize)> {
        let corners = self.around.of(vertex as u32);
        corners.iter().map(|&corner| (&self.rests[corner as usize / 3], corner as usize % 3))
    }

    /// Returns `weight` times the mean energy, and adds its gradient to `gradient`.
    pub fn add(&self, uv: &[Place], shape: Shape, weight: f64, gradient: &mut [Place]) -> f64 {
        let scale = weight / self.area;
        let mut energies = vec![0.0; self.rests.len()];
        let mut pulls = vec![[Vector2::zeros(); 3]; self.rests.len()];
        let found = energies.par_chunks_mut(BATCH).zip(pulls.par_chunks_mut(BATCH));
        self.rests.par_chunks(BATCH).zip(found).for_each(|(rests, (energies, pulls))| {
            if self.bound.is_none() {
                lanes::energies(rests, uv, shape, scale, energies, pulls);
                return;
            }
            for (rest, (energy, pulls)) in rests.iter().zip(energies.iter_mut().zip(pulls)) {
                (*energy, *pulls) = self.part(rest, uv, shape, scale);
            }
        });
        let pulls = pulls.as_flattened();
        gradient.par_iter_mut().with_min_len(BATCH).enumerate().for_each(|(vertex, gradient)| {
            self.around.of(vertex as u32).iter().for_each(|&corner| *gradient += pulls[corner as usize]);
        });
        scale * energies.iter().sum::<f64>()
    }

    pub fn energy(&self, uv: &[Place], shape: Shape) -> f64 {
        let of_batch = |rests: &[Rest]| rests.iter().map(|rest| rest.energy(uv, shape)).sum();
        self.rests.par_chunks(BATCH).map(of_batch).collect::<Vec<f64>>().iter().sum::<f64>() / self.area
    }

    /// Returns, for each triangle, the off-diagonal entries that it adds to a matrix of springs about as stiff as the
    /// energy around a map: for corners 01, 02, 12. A triangle with hardly any area is as stiff as its energy. If it
    /// were softer, the first step would flip it, and all others would have to wait for it.
    pub fn stiffness(&self, uv: &[Place], shape: Shape, weight: f64) -> Vec<[f64; 3]> {
        let of_triangle = |rest: &Rest| {
            let jacobian = rest.jacobian(uv);
            let price = self.price(rest, &jacobian, shape);
            // negative curvatures are left out, or the matrix would not be positive definite (Teran et al. 2005)
            let upward: f64 = price.curvatures(&jacobian).iter().map(|bend| bend.max(0.0)).sum();
            rest.springs(weight / self.area * rest.area * (upward / MODES).clamp(SOFTEST, STIFFEST))
        };
        self.rests.par_iter().with_min_len(BATCH).map(of_triangle).collect()
    }

    /// Returns, for each triangle, its area in a map divided by that on the surface, negative where it is folded.
    pub fn growths(&self, uv: &[Place]) -> Vec<f64> {
        self.rests.iter().map(|rest| signed_area(rest.corners, uv) / rest.area).collect()
    }

    fn price(&self, rest: &Rest, jacobian: &Matrix2<f64>, shape: Shape) -> Price {
        let price = shape.price(jacobian);
        self.bound.map_or(price, |bound| bound.add(price, rest, jacobian))
    }

    /// Returns a triangle's energy, and `scale` times its gradient with respect to the positions of its corners.
    fn part(&self, rest: &Rest, uv: &[Place], shape: Shape, scale: f64) -> (f64, [Place; 3]) {
        let jacobian = rest.jacobian(uv);
        let Price { value, slopes, .. } = self.price(rest, &jacobian, shape);
        let by_sides = by_sides(&jacobian, slopes, &rest.inverse, rest.area);
        let [b, c]: [Place; 2] = [by_sides.column(0).into(), by_sides.column(1).into()];
        (rest.area * value, [-b - c, b, c].map(|by_corner| scale * by_corner))
    }

    /// Returns the logarithm of the growth in area of a map without folds, and the largest deviation of a triangle from
    /// it.
    pub fn area_change(&self, uv: &[Place]) -> [f64; 2] {
        let flat: f64 = self.rests.iter().map(|rest| signed_area(rest.corners, uv)).sum();
        let own: f64 = self.rests.iter().map(|rest| rest.area * (-rest.trim).exp()).sum();
        let mean = (flat / own).ln();
        let most = self.rests.iter().map(|rest| (rest.growth(uv) - mean).abs()).fold(0.0, f64::max);
        [mean, most]
    }

    /// Scales a map to the area of the surface, if it has an area.
    pub fn fit_area(&self, uv: &mut [Place]) {
        let area: f64 = self.rests.iter().map(|rest| signed_area(rest.corners, uv)).sum();
        let factor = (self.area / area).sqrt();
        if factor.is_finite() {
            uv.iter_mut().for_each(|place| *place *= factor);
        }
    }

    /// Returns the number of triangles that are folded or have no area in a map.
    pub fn folded(&self, uv: &[Place]) -> usize {
        self.rests.par_iter().with_min_len(BATCH).filter(|rest| signed_area(rest.corners, uv) <= 0.0).count()
    }

    /// Returns how far a map without folds may move along `direction`, as a share, until a triangle has no area.
    pub fn farthest_step(&self, uv: &[Place], direction: &[Place]) -> f64 {
        let of_batch = |rests| lanes::farthest_step(rests, uv, direction);
        self.rests.par_chunks(BATCH).map(of_batch).reduce(|| f64::INFINITY, f64::min)
    }
}

pub(super) fn signed_area([a, b, c]: [u32; 3], uv: &[Place]) -> f64 {
    let [a, b, c] = [a, b, c].map(|vertex| uv[vertex as usize]);
    0.5 * (b - a).perp(&(c - a))
}

/// Returns the roots of a t² + b t + c; infinite or NaN if there are fewer.
#[inline(always)]
pub(super) fn roots(a: f64, b: f64, c: f64) -> [f64; 2] {
    let discriminant = b * b - 4.0 * a * c;
    // the sum without cancellation; the other root follows from the product c/a (Vieta)
    let q = -0.5 * (b + discriminant.sqrt().copysign(b)); // NaN without real roots
    [q / a, c / q]
}
