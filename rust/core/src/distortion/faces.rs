//! Distortion of triangles: what flattening did to areas, edges and shapes.
//!
//! Each triangle of the surface is mapped to the plane by an affine map; the singular values σ1 ≥ σ2 ≥ 0 of its Jacobian
//! are the most and the least that it stretches. All measures are raw: a flat map is in mm, and σ1 = σ2 = 1 is perfect.
//! What is undefined (a triangle without area on the surface or in the plane, a vertex without place) is NaN, is left out
//! of the summary, and is counted there.
//!
//! Areas are absolute and σ2 is not negative, as in Connectome Workbench: a map can fold and still have good figures here.
//! [`Flipped`] and [`overlap`](super::overlap) tell.

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::control::Control;
use crate::error::{Error, Result};

/// What one worker does between two looks at whether it should stop.
const CHUNK: usize = 4096;

/// What flattening did to the triangles.
#[derive(Debug, Clone, PartialEq)]
pub struct FaceDistortion {
    /// For each vertex log2(A_flat / A_surface), where the area of a vertex is a third of that of its faces; the summary is
    /// that of the absolute values, in which each vertex counts once.
    ///
    /// This is what `wb_command -surface-distortion` computes (Connectome Workbench, `AlgorithmSurfaceDistortion.cxx`
    /// without options, on `SurfaceFile::computeNodeAreas`), in f64 where it has f32. There areas are absolute too, since
    /// they are computed from squared lengths, and the ratio is not checked: 0/0 and a vertex without faces are NaN, but a
    /// zero area on one side is ±∞. Here that is NaN.
    pub areal: Measure,
    /// |l_flat / l_surface − 1| over the edges, in which each edge counts once. (Workbench's `-edge-method` has for each
    /// vertex the mean of |log2(l_flat / l_surface)| over its edges.) Edges that are 0 mm long on the surface are undefined.
    pub edge: Summary,
    /// Number of edges, the undefined ones among them.
    pub edges: usize,
    /// For each face σ1/σ2, the quasi-conformal error (Haker et al., Ju et al.); 1 keeps angles. The summary is by area.
    pub quasi_conformal: Measure,
    /// For each face the mean over its corners of |angle in the plane − angle on the surface|, degrees. The summary is by
    /// area.
    pub angle: Measure,
    /// For each face max(σ1, 1/σ2), the C of a C-quasi-isometry (Saucan et al.); 1 keeps lengths. The summary is by area.
    pub isometric: Measure,
    /// For each face the symmetric Dirichlet energy ½(σ1² + σ2² + σ1⁻² + σ2⁻²) (SLIM, Rabinovich et al.); 2 keeps lengths.
    /// The summary is by area.
    pub symmetric_dirichlet: Measure,
    /// For each face [σ1, σ2]; σ2 = 0 in a collapsed one.
    pub stretch: Vec<[f64; 2]>,
    /// Triangles that are turned over.
    pub flipped: Flipped,
}

/// A measure: its values and how they are spread.
#[derive(Debug, Clone, PartialEq)]
pub struct Measure {
    /// One value a vertex or a face; NaN where it is undefined.
    pub values: Vec<f64>,
    /// Of those that are defined.
    pub summary: Summary,
}

/// How values are spread; all NaN where none is defined.
///
/// Quantiles are the smallest value that at least this share of the weight does not exceed: numpy's
/// `quantile(..., weights=..., method="inverted_cdf")`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Summary {
    /// Weighted mean.
    pub mean: f64,
    /// Weighted median.
    pub median: f64,
    /// Weighted 95th percentile.
    pub p95: f64,
    /// The largest.
    pub max: f64,
    /// Number of values that are NaN and are left out.
    pub undefined: usize,
}

/// Triangles of the minority orientation.
#[derive(Debug, Clone, PartialEq)]
pub struct Flipped {
    /// Number of triangles with the orientation in the plane that fewer of them have (of equally many those with less area,
    /// of equal area the clockwise ones).
    pub count: usize,
    /// Their share of the surface's area.
    pub area_share: f64,
    /// Number of triangles without area in the plane, which have no orientation.
    pub collapsed: usize,
    /// For each face: is it one of the minority?
    pub per_face: Vec<bool>,
}

/// Measures a flat map of triangles: `points` (mm) on the surface, `uv` (mm) in the plane, the same vertices in both.
///
/// # Errors
/// [`Error::NoSuchPoint`], [`Error::Cancelled`].
///
/// # Panics
/// If there is not one place a vertex.
pub fn measure_faces(
    points: &[Vector3<f64>],
    faces: &[[u32; 3]],
    uv: &[[f64; 2]],
    control: &Control,
) -> Result<FaceDistortion> {
    assert_eq!(points.len(), uv.len(), "one place a vertex");
    all_exist(faces, points.len())?;
    control.begin("measuring triangles", 7);
    let place = |vertex: u32| Vector3::new(uv[vertex as usize][0], uv[vertex as usize][1], 0.0);
    let triangle = |face: &[u32; 3]| Triangle::of(face.map(|vertex| points[vertex as usize]), face.map(place));
    let triangles = in_chunks(faces, control, triangle)?;
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
    control.advance();
    let mut edges = sorted_edges(faces);
    edges.dedup();
    let change = |&[a, b]: &[u32; 2]| {
        let on_surface = (points[a as usize] - points[b as usize]).norm();
        let ratio = (place(a) - place(b)).norm() / on_surface;
        if ratio.is_finite() { (ratio - 1.0).abs() } else { f64::NAN }
    };
    let edge = Summary::of(&in_chunks(&edges, control, change)?, |_| 1.0);
    control.advance();
    Ok(FaceDistortion {
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

/// Are all corners among this many vertices?
pub(super) fn all_exist(faces: &[[u32; 3]], points: usize) -> Result<()> {
    match faces.as_flattened().iter().find(|&&vertex| vertex as usize >= points) {
        Some(&vertex) => Err(Error::NoSuchPoint { vertex: vertex as usize, points }),
        None => Ok(()),
    }
}

/// The edges of every face, each as often as it has faces, in ascending order.
pub(super) fn sorted_edges(faces: &[[u32; 3]]) -> Vec<[u32; 2]> {
    let sides = |&[a, b, c]: &[u32; 3]| [[a, b], [b, c], [c, a]].map(|[a, b]| [a.min(b), a.max(b)]);
    let mut edges: Vec<[u32; 2]> = faces.iter().flat_map(sides).collect();
    edges.par_sort_unstable();
    edges
}

/// One value an item, in parallel, in the order of the items.
fn in_chunks<T: Sync, U: Copy + Send>(
    items: &[T],
    control: &Control,
    value: impl Fn(&T) -> U + Sync,
) -> Result<Vec<U>> {
    let of_chunk = |chunk: &[T]| control.check().map(|()| chunk.iter().map(&value).collect());
    Ok(items.par_chunks(CHUNK).map(of_chunk).collect::<Result<Vec<Vec<U>>>>()?.concat())
}

/// One triangle on the surface and in the plane.
#[derive(Debug, Clone, Copy)]
struct Triangle {
    /// Area on the surface, mm².
    surface: f64,
    /// Area in the plane, mm²; negative if clockwise.
    flat: f64,
    /// σ1 and σ2.
    stretch: [f64; 2],
    /// Mean error of the corners' angles, degrees.
    angle: f64,
}

impl Triangle {
    fn of(points: [Vector3<f64>; 3], places: [Vector3<f64>; 3]) -> Self {
        // seen from the longest side the corner beyond it stands above that side: the Jacobian is as exact as can be
        let side = |k: usize| (points[(k + 1) % 3] - points[k]).norm_squared();
        let first = if side(0) >= side(1).max(side(2)) { 0 } else { 1 + usize::from(side(2) > side(1)) };
        let turned = |corners: [Vector3<f64>; 3]| [0, 1, 2].map(|k| corners[(first + k) % 3]);
        let (points, places) = (turned(points), turned(places));
        let (surface, flat) = (0.5 * doubled_area(&points).norm(), 0.5 * doubled_area(&places).z);
        let angle = (0..3).map(|k| (corner(&points, k) - corner(&places, k)).abs()).sum::<f64>() / 3.0;
        Self { surface, flat, stretch: stretch(&points, &places, surface, flat.abs()), angle }
    }

    /// Has it an area on the surface and one in the plane?
    fn is_defined(&self) -> bool {
        self.surface > 0.0 && self.flat.abs() > 0.0
    }
}

/// The normal of a triangle, as long as twice its area; zero if it is no longer than what rounding leaves of zero, NaN if a
/// corner is not finite.
fn doubled_area(corners: &[Vector3<f64>; 3]) -> Vector3<f64> {
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

/// The angle at a corner, degrees.
fn corner(corners: &[Vector3<f64>; 3], k: usize) -> f64 {
    let (a, b) = (corners[(k + 1) % 3] - corners[k], corners[(k + 2) % 3] - corners[k]);
    a.cross(&b).norm().atan2(a.dot(&b)).to_degrees()
}

/// σ1 and σ2 of the affine map between triangles of these areas.
fn stretch(points: &[Vector3<f64>; 3], places: &[Vector3<f64>; 3], surface: f64, flat: f64) -> [f64; 2] {
    if !(surface > 0.0 && flat >= 0.0) {
        return [f64::NAN; 2];
    }
    let (base, other) = (points[1] - points[0], points[2] - points[0]);
    let (flat_base, flat_other) = (places[1] - places[0], places[2] - places[0]);
    let length = base.norm();
    let height = 2.0 * surface / length;
    // the Jacobian's columns: where unit vectors along the base and square to it go
    let x = flat_base / length;
    let y = (flat_other - flat_base * (base.dot(&other) / (length * length))) / height;
    // σ1 ± σ2 are the sizes of its turning and of its mirroring part
    let turning = (x.x + y.y).hypot(x.y - y.x);
    let mirroring = (x.x - y.y).hypot(x.y + y.x);
    let most = 0.5 * (turning + mirroring);
    // |turning − mirroring| / 2 would lose all digits of a small σ2
    let least = if flat > 0.0 { (flat / surface / most).min(most) } else { 0.0 };
    [most, least]
}

/// The areas of vertices: each has a third of those of its faces.
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
        // pairs that compare equal are the same bits: the sums do not depend on the threads
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
mod tests {
    use super::*;
    use nalgebra::{Matrix2, Rotation3, Vector2};
    use proptest::prelude::*;
    use std::f64::consts::{SQRT_2, TAU};

    /// A rectangle of w × h squares, each cut in two.
    fn grid(w: u32, h: u32) -> (Vec<[f64; 2]>, Vec<[u32; 3]>) {
        let uv = (0..(w + 1) * (h + 1)).map(|n| [f64::from(n % (w + 1)), f64::from(n / (w + 1))]).collect();
        let square = |n: u32| {
            let corner = n / w * (w + 1) + n % w;
            let [a, b, c, d] = [corner, corner + 1, corner + w + 1, corner + w + 2];
            if n.is_multiple_of(3) { [[a, b, c], [b, d, c]] } else { [[a, b, d], [a, d, c]] }
        };
        (uv, (0..w * h).flat_map(square).collect())
    }

    fn in_space(uv: &[[f64; 2]], height: impl Fn(f64, f64) -> f64) -> Vec<Vector3<f64>> {
        uv.iter().map(|&[x, y]| Vector3::new(x, y, height(x, y))).collect()
    }

    fn measured(points: &[Vector3<f64>], faces: &[[u32; 3]], uv: &[[f64; 2]]) -> FaceDistortion {
        measure_faces(points, faces, uv, &Control::default()).unwrap()
    }

    /// A flat surface, mapped by a matrix and turned anywhere in space.
    fn mapped(matrix: Matrix2<f64>) -> FaceDistortion {
        let (uv, faces) = grid(6, 4);
        let turn = Rotation3::from_euler_angles(0.3, -1.1, 2.0);
        let points: Vec<_> =
            in_space(&uv, |_, _| 0.0).iter().map(|p| turn * p + Vector3::new(30.0, -70.0, 5.0)).collect();
        let image: Vec<[f64; 2]> = uv.iter().map(|&p| (matrix * Vector2::from(p)).into()).collect();
        measured(&points, &faces, &image)
    }

    fn all_are(values: &[f64], expected: f64) -> bool {
        values.iter().all(|value| (value - expected).abs() < 1e-9 * expected.abs().max(1.0))
    }

    fn is_perfect(distortion: &FaceDistortion) -> bool {
        all_are(&distortion.areal.values, 0.0)
            && distortion.edge.max < 1e-12
            && all_are(distortion.stretch.as_flattened(), 1.0)
            && all_are(&distortion.quasi_conformal.values, 1.0)
            && all_are(&distortion.isometric.values, 1.0)
            && all_are(&distortion.symmetric_dirichlet.values, 2.0)
            && all_are(&distortion.angle.values, 0.0)
            && (distortion.flipped.count, distortion.flipped.collapsed) == (0, 0)
            && distortion.flipped.area_share.is_sign_positive()
    }

    #[test]
    fn an_isometry_is_perfect() {
        let identity = mapped(Matrix2::identity());
        assert!(is_perfect(&identity));
        assert_eq!(
            (identity.edges, identity.edge.undefined, identity.areal.summary.undefined),
            (6 * 5 + 7 * 4 + 24, 0, 0)
        );
        let (sin, cos) = 0.7f64.sin_cos();
        assert!(is_perfect(&mapped(Matrix2::new(cos, -sin, sin, cos))));
        assert!(is_perfect(&mapped(Matrix2::new(cos, sin, sin, -cos)))); // all of them mirrored: none is the minority
    }

    #[test]
    fn a_cylinder_unrolls_isometrically() {
        let (uv, faces) = grid(20, 8);
        let step = TAU / 24.0;
        let chord = 2.0 * 10.0 * (0.5 * step).sin();
        let roll = |&[x, y]: &[f64; 2]| Vector3::new(10.0 * (x * step).cos(), 10.0 * (x * step).sin(), 1.5 * y);
        let points: Vec<_> = uv.iter().map(roll).collect();
        let unrolled: Vec<_> = uv.iter().map(|[x, y]| [chord * x, 1.5 * y]).collect();
        assert!(is_perfect(&measured(&points, &faces, &unrolled)));
    }

    #[test]
    fn a_similarity_changes_lengths_only() {
        for s in [0.25, 3.0] {
            let distortion = mapped(Matrix2::identity() * s);
            assert!(all_are(&distortion.areal.values, 2.0 * s.log2()));
            assert!((distortion.areal.summary.median - 2.0 * s.log2().abs()).abs() < 1e-9);
            assert!((distortion.edge.mean - (s - 1.0).abs()).abs() < 1e-9);
            assert!(all_are(&distortion.quasi_conformal.values, 1.0) && all_are(&distortion.angle.values, 0.0));
            assert!(all_are(&distortion.isometric.values, s.max(1.0 / s)));
            assert!(all_are(&distortion.symmetric_dirichlet.values, s * s + 1.0 / (s * s)));
        }
    }

    #[test]
    fn a_stretch_and_a_shear_have_their_singular_values() {
        let (a, b) = (3.0f64, 0.4f64);
        let (sin, cos) = 1.2f64.sin_cos();
        let stretched = mapped(Matrix2::new(cos, -sin, sin, cos) * Matrix2::new(a, 0.0, 0.0, b));
        assert!(stretched.stretch.iter().all(|s| all_are(&[s[0] - a, s[1] - b], 0.0)));
        assert!(all_are(&stretched.areal.values, (a * b).log2()));
        assert!(all_are(&stretched.quasi_conformal.values, a / b) && all_are(&stretched.isometric.values, a));
        let energy = 0.5 * (a * a + b * b + 1.0 / (a * a) + 1.0 / (b * b));
        assert!(all_are(&stretched.symmetric_dirichlet.values, energy));
        // half of the inner corners of the squares' halves are 45° and become atan(b/a) and its complement
        let lean = 45.0 - (b / a).atan().to_degrees();
        assert!(all_are(&stretched.angle.values, 2.0 * lean / 3.0));
        // unit shear: σ1 is the golden ratio
        let golden = 0.5 * (1.0 + 5f64.sqrt());
        let sheared = mapped(Matrix2::new(1.0, 1.0, 0.0, 1.0));
        assert!(sheared.stretch.iter().all(|s| all_are(&[s[0] - golden, s[1] - 1.0 / golden], 0.0)));
        assert!(all_are(&sheared.areal.values, 0.0) && all_are(&sheared.quasi_conformal.values, golden * golden));
        assert!(all_are(&sheared.symmetric_dirichlet.values, golden * golden + 1.0 / (golden * golden)));
    }

    #[test]
    fn edges_count_once() {
        // two triangles of a unit square, the diagonal of which is made twice as long
        let points = in_space(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], |_, _| 0.0);
        let uv = [[0.0, 0.0], [1.0, 0.0], [2.0, 2.0], [0.0, 1.0]];
        let distortion = measured(&points, &[[0, 1, 2], [0, 2, 3]], &uv);
        let expected = (1.0 + 2.0 * (5f64.sqrt() - 1.0)) / 5.0;
        assert!((distortion.edge.mean - expected).abs() < 1e-12 && distortion.edges == 5);
        assert!((distortion.edge.max - (5f64.sqrt() - 1.0)).abs() < 1e-12);
    }

    #[test]
    fn flipped_triangles_are_the_minority() {
        let (uv, faces) = grid(3, 3);
        let points = in_space(&uv, |_, _| 0.0);
        let mut folded = uv.clone();
        folded[0] = [0.9, 0.9]; // beyond the opposite side of its one triangle
        for mirror in [1.0, -1.0] {
            let uv: Vec<_> = folded.iter().map(|&[x, y]| [mirror * x, y]).collect();
            let flipped = measured(&points, &faces, &uv).flipped;
            assert_eq!((flipped.count, flipped.collapsed), (1, 0));
            assert!((flipped.area_share - 1.0 / 18.0).abs() < 1e-12);
            assert_eq!(flipped.per_face.iter().position(|&is| is), Some(0));
        }
    }

    #[test]
    fn what_is_undefined_is_nan_and_counted() {
        let (uv, faces) = grid(3, 3);
        let points = in_space(&uv, |_, _| 0.0);
        let mut flat = uv.clone();
        flat[0] = [0.5, 0.5]; // on the opposite side of its one triangle
        let collapsed = measured(&points, &faces, &flat);
        assert_eq!((collapsed.flipped.count, collapsed.flipped.collapsed), (0, 1));
        assert!(collapsed.areal.values[0].is_nan() && collapsed.areal.summary.undefined == 1);
        assert_eq!(collapsed.stretch[0][1], 0.0);
        for measure in
            [&collapsed.quasi_conformal, &collapsed.angle, &collapsed.isometric, &collapsed.symmetric_dirichlet]
        {
            assert!(measure.values[0].is_nan() && measure.values[1..].iter().all(|value| value.is_finite()));
            assert!(measure.summary.undefined == 1 && measure.summary.max.is_finite());
        }
        // the other way round, with corners on a line that rounding bends
        let line = [[0.1, 0.1], [0.2, 0.2], [0.3, 0.3], [0.0, 0.5]];
        let whole = [[0.0, 0.0], [1.0, 0.0], [2.0, 1.0], [0.0, 1.0]];
        let torn = measured(&in_space(&line, |x, _| x), &[[0, 1, 2], [0, 2, 3]], &whole);
        assert!(torn.stretch[0].iter().all(|s| s.is_nan()) && torn.areal.values[1].is_nan());
        assert!(torn.areal.values[0].is_finite() && torn.flipped.collapsed == 0);
        // an edge of 0 mm, and a vertex without place
        let twice = [[0.0, 0.0], [0.0, 0.0], [1.0, 1.0], [0.0, 1.0], [7.0, 7.0]];
        let doubled = measured(
            &in_space(&twice, |_, _| 0.0),
            &[[0, 1, 2], [0, 2, 3]],
            &[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [f64::NAN, 1.0], [7.0, 7.0]],
        );
        assert_eq!((doubled.edges, doubled.edge.undefined), (5, 3));
        assert!(doubled.areal.values.iter().all(|value| value.is_nan()) && doubled.areal.summary.mean.is_nan());
        assert_eq!(doubled.flipped.collapsed, 0);
        let nothing = measured(&[], &[], &[]);
        assert!(nothing.edge.mean.is_nan() && nothing.isometric.summary.p95.is_nan());
        assert!(nothing.flipped.area_share.is_nan());
    }

    #[test]
    fn summaries_weigh_by_area() {
        // a small triangle that keeps its size beside a large one that is stretched
        let points = in_space(&[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [-9.0, 0.0]], |_, _| 0.0);
        let uv = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [-18.0, 0.0]];
        let distortion = measured(&points, &[[0, 1, 2], [0, 2, 3]], &uv);
        let Summary { mean, median, p95, max, undefined } = distortion.isometric.summary;
        assert!((mean - 1.9).abs() < 1e-12 && undefined == 0);
        assert!(all_are(&[median, p95, max], 2.0));
        let counted = Summary::of(&[4.0, f64::NAN, 1.0, 3.0, 2.0], |_| 1.0);
        assert_eq!(counted, Summary { mean: 2.5, median: 2.0, p95: 4.0, max: 4.0, undefined: 1 });
    }

    #[test]
    fn a_small_stretch_keeps_its_digits() {
        let (s, scale) = (1e-9, 1e-6);
        let points = in_space(&[[0.0, 0.0], [1.0, 0.0], [0.3, 0.8]], |_, _| 0.0);
        let uv = [[0.0, 0.0], [scale, 0.0], [0.3 * scale, 0.8 * scale * s]];
        let stretch = measured(&points, &[[0, 1, 2]], &uv).stretch[0];
        assert!((stretch[0] / scale - 1.0).abs() < 1e-12 && (stretch[1] / scale / s - 1.0).abs() < 1e-6);
    }

    /// What `wb_command -surface-distortion` computes, with its f32.
    fn workbench(points: &[Vector3<f64>], faces: &[[u32; 3]], uv: &[[f64; 2]]) -> Vec<f32> {
        let areas = |points: Vec<[f32; 3]>| {
            let mut sums = vec![0f32; points.len()];
            for face in faces {
                let squared = |m: usize, n: usize| {
                    let [p, q] = [points[face[m] as usize], points[face[n] as usize]];
                    f64::from((0..3).map(|k| (p[k] - q[k]).powi(2)).sum::<f32>())
                };
                let (a, b, c) = (squared(0, 1), squared(1, 2), squared(2, 0));
                let area = (0.25 * (4.0 * a * c - (a - b + c).powi(2)).abs().sqrt()) as f32;
                face.iter().for_each(|&vertex| sums[vertex as usize] += area / 3.0);
            }
            sums
        };
        let surface = areas(points.iter().map(|p| [p.x as f32, p.y as f32, p.z as f32]).collect());
        let flat = areas(uv.iter().map(|&[x, y]| [x as f32, y as f32, 0.0]).collect());
        flat.iter().zip(surface).map(|(flat, surface)| (flat / surface).ln() / 2f32.ln()).collect()
    }

    #[test]
    fn areal_distortion_is_workbenchs() {
        let (uv, faces) = grid(40, 30);
        let points = in_space(&uv, |x, y| 3.0 * (0.4 * x).sin() * (0.3 * y).cos() - 40.0);
        let moved: Vec<_> =
            uv.iter().map(|&[x, y]| [1.1 * x + 0.3 * y.sin() - 60.0, 0.9 * y + 0.2 * x.cos()]).collect();
        let ours = measured(&points, &faces, &moved).areal;
        for (ours, theirs) in ours.values.iter().zip(workbench(&points, &faces, &moved)) {
            assert!((ours - f64::from(theirs)).abs() < 1e-4, "{ours} {theirs}");
        }
        assert!(ours.summary.p95 > 0.3);
    }

    #[test]
    fn vertices_share_out_the_area_of_the_faces() {
        let (uv, faces) = grid(30, 20);
        let points = in_space(&uv, |x, y| (0.5 * x).sin() + (0.7 * y).cos());
        let place = |v: u32| Vector3::new(uv[v as usize][0], uv[v as usize][1], 0.0);
        let triangle = |face: &[u32; 3]| Triangle::of(face.map(|v| points[v as usize]), face.map(place)).surface;
        let areas: Vec<f64> = faces.iter().map(triangle).collect();
        let shares: f64 = vertex_areas(uv.len(), &faces, areas.iter().copied()).iter().sum();
        let whole: f64 = areas.iter().sum();
        assert!((shares - whole).abs() < 1e-9 && whole > 600.0);
    }

    proptest! {
        #[test]
        fn singular_values_are_those_of_the_jacobian(
            corners in prop::array::uniform3(prop::array::uniform3(-5.0..5.0f64)),
            places in prop::array::uniform3(prop::array::uniform2(-5.0..5.0f64)),
        ) {
            let p = corners.map(Vector3::from);
            let normal = (p[1] - p[0]).cross(&(p[2] - p[0]));
            prop_assume!(normal.norm() > 0.1);
            let x = (p[2] - p[0]).normalize();
            let y = normal.normalize().cross(&x);
            let flat = |v: Vector3<f64>| Vector2::new(v.dot(&x), v.dot(&y));
            let before = Matrix2::from_columns(&[flat(p[1] - p[0]), flat(p[2] - p[0])]);
            let u = places.map(Vector2::from);
            let jacobian = Matrix2::from_columns(&[u[1] - u[0], u[2] - u[0]]) * before.try_inverse().unwrap();
            let expected = jacobian.svd(false, false).singular_values;
            let stretch = measured(&p, &[[0, 1, 2]], &places).stretch[0];
            prop_assert!(stretch[0] >= stretch[1]);
            for k in 0..2 {
                prop_assert!((stretch[k] - expected[k]).abs() < 1e-9 * expected[0], "{stretch:?} {expected}");
            }
        }

        #[test]
        fn numbering_and_rigid_motion_do_not_matter(seed in 0u32..1000, angle in 0.0..TAU) {
            let (flat, faces) = grid(5, 4);
            let jitter = |n: usize, k: u32| 0.3 * f64::from((n as u32 * 37 + k * 11 + seed) % 97).sin();
            let points = in_space(&flat, |x, y| (x + f64::from(seed)).sin() + 0.5 * y.cos());
            let uv: Vec<_> = flat.iter().enumerate().map(|(n, p)| [p[0] + jitter(n, 0), p[1] + jitter(n, 1)]).collect();
            let first = measured(&points, &faces, &uv);
            let last = points.len() - 1;
            let turn = Rotation3::from_euler_angles(angle, 0.5, -angle);
            let points: Vec<_> = points.iter().rev().map(|p| turn * p + Vector3::new(9.0, -4.0, 1.0)).collect();
            let (sin, cos) = angle.sin_cos();
            let uv: Vec<_> = uv.iter().rev().map(|[x, y]| [cos * x - sin * y + 3.0, sin * x + cos * y]).collect();
            let faces: Vec<_> = faces.iter().rev().map(|&[a, b, c]| [b, c, a].map(|v| last as u32 - v)).collect();
            let second = measured(&points, &faces, &uv);
            prop_assert_eq!(first.flipped.count, second.flipped.count);
            for (a, b) in [
                (first.areal.summary, second.areal.summary),
                (first.edge, second.edge),
                (first.angle.summary, second.angle.summary),
            ] {
                prop_assert!((a.mean - b.mean).abs() < 1e-9 && (a.max - b.max).abs() < 1e-9);
            }
            for (a, b) in first.areal.values.iter().zip(second.areal.values.iter().rev()) {
                prop_assert!((a - b).abs() < 1e-8);
            }
        }
    }

    #[test]
    fn the_number_of_threads_changes_no_bit() {
        let (uv, faces) = grid(120, 90);
        let points = in_space(&uv, |x, y| 2.0 * (0.3 * x).sin() * (0.2 * y).sin());
        let uv: Vec<_> = uv.iter().map(|&[x, y]| [x + (SQRT_2 * y).sin(), y + 0.8 * (SQRT_2 * x).cos()]).collect();
        let with = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let distortion = pool.install(|| measured(&points, &faces, &uv));
            assert!(distortion.flipped.count > 0);
            format!("{distortion:?}") // shortest digits that read back to the same bits
        };
        let one = with(1);
        assert!(one == with(2) && one == with(7));
    }

    #[test]
    fn wrong_corners_are_refused_and_cancelling_is_obeyed() {
        let (uv, faces) = grid(2, 2);
        let points = in_space(&uv, |_, _| 0.0);
        let control = Control::default();
        let beyond = measure_faces(&points, &[[0, 1, 9]], &uv, &control);
        assert_eq!(beyond, Err(Error::NoSuchPoint { vertex: 9, points: 9 }));
        measure_faces(&points, &faces, &uv, &control).unwrap();
        let progress = control.progress();
        assert_eq!((progress.stage, progress.done), ("measuring triangles", progress.total));
        control.cancel();
        assert_eq!(measure_faces(&points, &faces, &uv, &control), Err(Error::Cancelled));
    }
}
