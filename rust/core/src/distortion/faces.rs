//! Distortion of triangles by flattening: areas, edges and shapes.
//!
//! Each triangle of the surface is mapped to the plane by an affine map. The singular values σ1 ≥ σ2 ≥ 0 of its
//! Jacobian are the largest and the smallest stretch. Measures are raw: a flat map is in mm, and σ1 = σ2 = 1 is
//! perfect. Only areas are also given at the scale that preserves the total area. Undefined values (a triangle without
//! area on the surface or in the plane, a vertex without a position) are NaN. The summary only counts them.
//!
//! Areas are absolute and σ2 is not negative, as in Connectome Workbench. A map with folds can therefore have good
//! figures here; [`Flipped`] and [`overlap`](super::overlap) report folds.

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::error::{check_length, check_points};
use crate::{Control, Result};

/// The number of items that one worker processes between two checks for cancellation.
const CHUNK: usize = 4096;

/// Factors of area change; the share of the surface beyond each of them is reported.
pub const AREA_FACTORS: [f64; 3] = [1.25, 1.5, 2.0];

/// The distortion of the triangles.
#[derive(Debug, Clone, PartialEq)]
pub struct FaceDistortion {
    /// For each vertex, log2(A_flat / A_surface), where the area of a vertex is a third of the area of its faces. The
    /// summary is that of the absolute values; each vertex counts once.
    ///
    /// The same as `wb_command -surface-distortion` (Connectome Workbench, `AlgorithmSurfaceDistortion.cxx` without
    /// options, on `SurfaceFile::computeNodeAreas`), but in f64 instead of f32. Workbench's areas are absolute too,
    /// because they are computed from squared lengths. It does not check the ratio: 0/0 and a vertex without faces are
    /// NaN, but a zero area on one side is ±∞. Here, that is NaN.
    pub areal: Measure,
    /// The factor by which the map must be multiplied to have the area of the surface.
    pub equal_area_scale: f64,
    /// The summary of `areal` at that scale.
    pub equal_area: Summary,
    /// The share of the surface, by area, in triangles whose area changes by more than each of [`AREA_FACTORS`] in
    /// either direction, at that scale. A triangle without area in the plane exceeds all factors. NaN without a scale.
    pub area_beyond: [f64; 3],
    /// |l_flat / l_surface − 1| over the edges; each edge counts once. (Workbench's `-edge-method` gives, for each
    /// vertex, the mean of |log2(l_flat / l_surface)| over its edges.) Edges of length 0 mm on the surface are undefined.
    pub edge: Summary,
    /// The number of edges, including undefined ones.
    pub edges: usize,
    /// For each face σ1/σ2, the quasi-conformal error (Haker et al., Ju et al.); 1 preserves angles. Summary by area.
    pub quasi_conformal: Measure,
    /// For each face, the mean of |angle in the plane − angle on the surface| in degrees. The summary is by area.
    pub angle: Measure,
    /// For each face max(σ1, 1/σ2), the C of a C-quasi-isometry (Saucan et al.); 1 preserves lengths. Summary by area.
    pub isometric: Measure,
    /// For each face, the symmetric Dirichlet energy ½(σ1² + σ2² + σ1⁻² + σ2⁻²) (SLIM, Rabinovich et al.); 2 preserves
    /// lengths. The summary is by area.
    pub symmetric_dirichlet: Measure,
    /// For each face, [σ1, σ2]; σ2 = 0 in a collapsed face.
    pub stretch: Vec<[f64; 2]>,
    /// Flipped triangles.
    pub flipped: Flipped,
}

/// The values of a measure and their distribution.
#[derive(Debug, Clone, PartialEq)]
pub struct Measure {
    /// One value per vertex or face; NaN where it is undefined.
    pub values: Vec<f64>,
    /// The summary of the defined values.
    pub summary: Summary,
}

/// The distribution of values; all NaN if none is defined.
///
/// A quantile is the smallest value that is not exceeded by at least this share of the weight, as in numpy's
/// `quantile(..., weights=..., method="inverted_cdf")`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Summary {
    /// The weighted mean.
    pub mean: f64,
    /// The weighted median.
    pub median: f64,
    /// The weighted 95th percentile.
    pub p95: f64,
    /// The largest value.
    pub max: f64,
    /// The number of undefined values, which are excluded.
    pub undefined: usize,
}

/// Triangles of the minority orientation.
#[derive(Debug, Clone, PartialEq)]
pub struct Flipped {
    /// The number of triangles with the less frequent orientation in the plane. If both are equally frequent, the one
    /// with less area; if the areas are equal too, the clockwise one.
    pub count: usize,
    /// The share of the surface's area in these triangles.
    pub area_share: f64,
    /// The number of triangles without area in the plane, which have no orientation.
    pub collapsed: usize,
    /// For each face, whether it is flipped.
    pub per_face: Vec<bool>,
}

/// Measures a flat map of triangles: `points` (mm) on the surface and `uv` (mm) in the plane are positions of the same
/// vertices.
///
/// # Errors
/// [`Error::WrongLength`](crate::Error::WrongLength) if there is not one position per point,
/// [`Error::NoSuchPoint`](crate::Error::NoSuchPoint) if a corner is not the number of a point, and
/// [`Error::Cancelled`](crate::Error::Cancelled).
pub fn measure_faces(
    points: &[Vector3<f64>], faces: &[[u32; 3]], uv: &[[f64; 2]], control: &Control,
) -> Result<FaceDistortion> {
    check_length("positions", uv.len(), "points", points.len())?;
    check_points(faces.iter().flatten().copied(), points.len())?;
    control.begin("measuring triangles", 7);
    let place = |vertex: u32| Vector3::new(uv[vertex as usize][0], uv[vertex as usize][1], 0.0);
    let triangle = |face: &[u32; 3]| Triangle::of(face.map(|vertex| points[vertex as usize]), face.map(place));
    let triangles = control.part().each("", faces, CHUNK, triangle)?;
    control.advance();
    let by_area = |value: fn(&Triangle) -> f64| {
        control.check()?;
        let value = |triangle: &Triangle| if triangle.is_defined() { value(triangle) } else { f64::NAN };
        let values: Vec<f64> = triangles.iter().map(value).collect();
        let summary = Summary::of(&values, |face| triangles[face].surface);
        control.advance();
        Ok(Measure { values, summary })
    };
    let quasi_conformal = by_area(|t| t.stretch[0] / t.stretch[1])?;
    let angle = by_area(|t| t.angle)?;
    let isometric = by_area(|t| t.stretch[0].max(t.stretch[1].recip()))?;
    let symmetric_dirichlet = by_area(|t| 0.5 * t.stretch.map(|s| s * s + (s * s).recip()).iter().sum::<f64>())?;
    let areal = areal(points.len(), faces, &triangles);
    let scale = equal_area_scale(points, faces, uv);
    control.advance();
    let mut edges = sorted_edges(faces);
    edges.dedup();
    let change = |&[a, b]: &[u32; 2]| {
        let on_surface = (points[a as usize] - points[b as usize]).norm();
        let ratio = (place(a) - place(b)).norm() / on_surface;
        if ratio.is_finite() { (ratio - 1.0).abs() } else { f64::NAN }
    };
    let edge = Summary::of(&control.part().each("", &edges, CHUNK, change)?, |_| 1.0);
    control.advance();
    Ok(FaceDistortion {
        equal_area: Summary::of(&at_scale(&areal.values, scale), |_| 1.0),
        area_beyond: AREA_FACTORS.map(|factor| share_beyond(factor, &triangles, scale)),
        equal_area_scale: scale,
        areal,
        edge,
        edges: edges.len(),
        quasi_conformal,
        angle,
        isometric,
        symmetric_dirichlet,
        stretch: triangles.iter().map(|triangle| triangle.stretch).collect(),
        flipped: Flipped::of(&triangles),
    })
}

/// Returns the factor by which a map must be multiplied to have the area of the surface: √(Σ A_surface / Σ A_flat). NaN
/// if the map has no area. Panics if the numbers of points and of positions differ.
pub(crate) fn equal_area_scale(points: &[Vector3<f64>], faces: &[[u32; 3]], uv: &[[f64; 2]]) -> f64 {
    assert_eq!(points.len(), uv.len(), "one position per vertex");
    let doubled = |[a, b, c]: [Vector3<f64>; 3]| (b - a).cross(&(c - a)).norm();
    let place = |vertex: u32| Vector3::new(uv[vertex as usize][0], uv[vertex as usize][1], 0.0);
    let on_surface: f64 = faces.iter().map(|face| doubled(face.map(|vertex| points[vertex as usize]))).sum();
    let flat: f64 = faces.iter().map(|face| doubled(face.map(place))).sum();
    if flat > 0.0 { (on_surface / flat).sqrt() } else { f64::NAN }
}

/// Returns the share of the surface in triangles whose area changes by more than a factor either way, at a scale.
fn share_beyond(factor: f64, triangles: &[Triangle], scale: f64) -> f64 {
    let known = || triangles.iter().filter(|triangle| triangle.surface > 0.0 && triangle.flat.is_finite());
    let is_beyond = |triangle: &&Triangle| {
        let ratio = scale * scale * triangle.flat.abs() / triangle.surface;
        ratio > factor || ratio < factor.recip()
    };
    let area = |triangle: &Triangle| triangle.surface;
    if scale.is_nan() {
        f64::NAN
    } else {
        let sum = known().filter(is_beyond).map(area).fold(0.0, |sum, area| sum + area); // an empty sum is 0, not -0
        sum / known().map(area).sum::<f64>()
    }
}

/// Returns |log2| of the areas at a scale.
fn at_scale(areal: &[f64], scale: f64) -> Vec<f64> {
    areal.iter().map(|log| (log + 2.0 * scale.log2()).abs()).collect()
}

/// Returns the edges of all faces in ascending order, each once per face.
pub(super) fn sorted_edges(faces: &[[u32; 3]]) -> Vec<[u32; 2]> {
    let sides = |&[a, b, c]: &[u32; 3]| [[a, b], [b, c], [c, a]].map(|[a, b]| [a.min(b), a.max(b)]);
    let mut edges: Vec<[u32; 2]> = faces.iter().flat_map(sides).collect();
    edges.par_sort_unstable();
    edges
}

/// Returns σ1 and σ2 of the affine map from a triangle on the surface to one in the plane; NaN if undefined.
pub(crate) fn stretch_of(points: [Vector3<f64>; 3], places: [[f64; 2]; 3]) -> [f64; 2] {
    Triangle::of(points, places.map(|[u, v]| Vector3::new(u, v, 0.0))).stretch
}

/// One triangle on the surface and in the plane.
#[derive(Debug, Clone, Copy)]
struct Triangle {
    /// Area on the surface in mm².
    surface: f64,
    /// Area in the plane in mm²; negative if clockwise.
    flat: f64,
    /// σ1 and σ2.
    stretch: [f64; 2],
    /// Mean error of the corners' angles in degrees.
    angle: f64,
}

impl Triangle {
    fn of(points: [Vector3<f64>; 3], places: [Vector3<f64>; 3]) -> Self {
        // the apex above its longest side projects onto that side, which makes the Jacobian most accurate
        let side = |k: usize| (points[(k + 1) % 3] - points[k]).norm_squared();
        let first = if side(0) >= side(1).max(side(2)) { 0 } else { 1 + usize::from(side(2) > side(1)) };
        let turned = |corners: [Vector3<f64>; 3]| [0, 1, 2].map(|k| corners[(first + k) % 3]);
        let (points, places) = (turned(points), turned(places));
        let (surface, flat) = (0.5 * doubled_area(&points).norm(), 0.5 * doubled_area(&places).z);
        let angle = (0..3).map(|k| (corner(&points, k) - corner(&places, k)).abs()).sum::<f64>() / 3.0;
        Self { surface, flat, stretch: stretch(&points, &places, surface, flat.abs()), angle }
    }

    /// Returns whether it has an area on the surface and one in the plane.
    fn is_defined(&self) -> bool {
        self.surface > 0.0 && self.flat.abs() > 0.0
    }
}

/// Returns the normal of a triangle, with a length of twice its area. It is zero if it is not longer than the rounding
/// error of zero, and NaN if a corner is not finite.
pub(crate) fn doubled_area(corners: &[Vector3<f64>; 3]) -> Vector3<f64> {
    let (a, b) = (corners[1] - corners[0], corners[2] - corners[0]);
    let longest = a.norm_squared().max(b.norm_squared()).max((b - a).norm_squared());
    let normal = a.cross(&b);
    if !longest.is_finite() || normal.iter().any(|x| x.is_nan()) {
        Vector3::repeat(f64::NAN)
    } else if normal.norm() <= 4.0 * f64::EPSILON * longest {
        Vector3::zeros()
    } else {
        normal
    }
}

fn corner(corners: &[Vector3<f64>; 3], k: usize) -> f64 {
    let (a, b) = (corners[(k + 1) % 3] - corners[k], corners[(k + 2) % 3] - corners[k]);
    // atan2 is accurate at all angles; acos loses half of the digits near 0° and 180°
    a.cross(&b).norm().atan2(a.dot(&b)).to_degrees()
}

/// Returns σ1 and σ2 of the affine map between triangles of these areas.
fn stretch(points: &[Vector3<f64>; 3], places: &[Vector3<f64>; 3], surface: f64, flat: f64) -> [f64; 2] {
    if !(surface > 0.0 && flat >= 0.0) {
        return [f64::NAN; 2];
    }
    let (base, other) = (points[1] - points[0], points[2] - points[0]);
    let (flat_base, flat_other) = (places[1] - places[0], places[2] - places[0]);
    let length = base.norm();
    let height = 2.0 * surface / length;
    // columns of the Jacobian: the images of unit vectors along the base and perpendicular to it
    let x = flat_base / length;
    // the part of the other side along the base is subtracted, and the rest divided by the height
    let y = (flat_other - flat_base * (base.dot(&other) / (length * length))) / height;
    // σ1 ± σ2 are the norms of its rotating and of its reflecting part
    let turning = (x.x + y.y).hypot(x.y - y.x);
    let mirroring = (x.x - y.y).hypot(x.y + y.x);
    let most = 0.5 * (turning + mirroring);
    // |rotation − reflection| / 2 would lose all digits of a small σ2
    let least = if flat > 0.0 { (flat / surface / most).min(most) } else { 0.0 };
    [most, least]
}

/// Returns the areas of vertices: each has a third of the areas of its faces.
fn vertex_areas(vertices: usize, faces: &[[u32; 3]], areas: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut sums = vec![0.0; vertices];
    for (face, area) in faces.iter().zip(areas) {
        face.iter().for_each(|&vertex| sums[vertex as usize] += area / 3.0);
    }
    sums
}

fn areal(vertices: usize, faces: &[[u32; 3]], triangles: &[Triangle]) -> Measure {
    let surface = vertex_areas(vertices, faces, triangles.iter().map(|triangle| triangle.surface));
    let flat = vertex_areas(vertices, faces, triangles.iter().map(|triangle| triangle.flat.abs()));
    let log_ratio = |(&surface, &flat): (&f64, &f64)| {
        if surface > 0.0 && flat > 0.0 { (flat / surface).log2() } else { f64::NAN }
    };
    let values: Vec<f64> = surface.iter().zip(&flat).map(log_ratio).collect();
    let absolute: Vec<f64> = values.iter().map(|value| value.abs()).collect();
    Measure { values, summary: Summary::of(&absolute, |_| 1.0) }
}

impl Summary {
    fn of(values: &[f64], weight: impl Fn(usize) -> f64) -> Self {
        let defined = values.iter().enumerate().filter(|(_, value)| !value.is_nan());
        let mut sorted: Vec<(f64, f64)> = defined.map(|(n, &value)| (value, weight(n))).collect();
        // pairs that compare equal have the same bits, so sums do not depend on the threads
        sorted.par_sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        let total: f64 = sorted.iter().map(|pair| pair.1).sum();
        let quantile = |share: f64| {
            let mut sum = 0.0;
            let reached = sorted.iter().find(|pair| {
                sum += pair.1;
                sum >= share * total
            });
            reached.map_or(f64::NAN, |pair| pair.0)
        };
        Self {
            mean: sorted.iter().map(|(value, weight)| value * weight).sum::<f64>() / total, // 0/0 is NaN: undefined
            median: quantile(0.5),
            p95: quantile(0.95),
            max: sorted.last().map_or(f64::NAN, |pair| pair.0),
            undefined: values.len() - sorted.len(),
        }
    }
}

impl Flipped {
    fn of(triangles: &[Triangle]) -> Self {
        let oriented = |sign: f64| triangles.iter().filter(move |triangle| triangle.flat * sign > 0.0);
        let area =
            |sign: f64| oriented(sign).map(|triangle| triangle.surface).filter(|area| !area.is_nan()).sum::<f64>();
        let of_sign = |sign: f64| (oriented(sign).count(), area(sign));
        let (left, right) = (of_sign(1.0), of_sign(-1.0));
        let (sign, (count, area)) = if left < right { (1.0, left) } else { (-1.0, right) };
        let placed = triangles.iter().filter(|triangle| !triangle.flat.is_nan() && !triangle.surface.is_nan());
        Self {
            count,
            // abs: the sum of no areas is −0
            area_share: area.abs() / placed.map(|triangle| triangle.surface).sum::<f64>(),
            collapsed: triangles.iter().filter(|triangle| triangle.flat == 0.0).count(),
            per_face: triangles.iter().map(|triangle| triangle.flat * sign > 0.0).collect(),
        }
    }
}

#[cfg(test)]
mod tests;
