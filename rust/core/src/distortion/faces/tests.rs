use super::*;
use crate::distortion::tests::grid;
use nalgebra::{Matrix2, Rotation3, Vector2};
use proptest::prelude::*;
use std::f64::consts::TAU;

fn in_space(uv: &[[f64; 2]], height: impl Fn(f64, f64) -> f64) -> Vec<Vector3<f64>> {
    uv.iter().map(|&[x, y]| Vector3::new(x, y, height(x, y))).collect()
}

fn measured(points: &[Vector3<f64>], faces: &[[u32; 3]], uv: &[[f64; 2]]) -> FaceDistortion {
    measure_faces(points, faces, uv, &Control::default()).unwrap()
}

/// Measures the map by a matrix of a flat surface that is rotated in space.
fn mapped(matrix: Matrix2<f64>) -> FaceDistortion {
    let (uv, faces) = grid(6, 4);
    let turn = Rotation3::from_euler_angles(0.3, -1.1, 2.0);
    let points: Vec<_> = in_space(&uv, |_, _| 0.0).iter().map(|p| turn * p + Vector3::new(30.0, -70.0, 5.0)).collect();
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
    assert_eq!((identity.edges, identity.edge.undefined, identity.areal.summary.undefined), (6 * 5 + 7 * 4 + 24, 0, 0));
    let (sin, cos) = 0.7f64.sin_cos();
    assert!(is_perfect(&mapped(Matrix2::new(cos, -sin, sin, cos))));
    assert!(is_perfect(&mapped(Matrix2::new(cos, sin, sin, -cos)))); // all of them mirrored: there is no minority
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
    // two triangles of a unit square whose diagonal becomes twice as long
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
    assert!(collapsed.flipped.per_face.iter().all(|is| !is));
    assert!(collapsed.areal.values[0].is_nan() && collapsed.areal.summary.undefined == 1);
    assert_eq!(collapsed.stretch[0][1], 0.0);
    for measure in [&collapsed.quasi_conformal, &collapsed.angle, &collapsed.isometric, &collapsed.symmetric_dirichlet]
    {
        assert!(measure.values[0].is_nan() && measure.values[1..].iter().all(|value| value.is_finite()));
        assert!(measure.summary.undefined == 1 && measure.summary.max.is_finite());
    }
    // reversed, with corners on a line that rounding bends
    let line = [[0.1, 0.1], [0.2, 0.2], [0.3, 0.3], [0.0, 0.5]];
    let whole = [[0.0, 0.0], [1.0, 0.0], [2.0, 1.0], [0.0, 1.0]];
    let torn = measured(&in_space(&line, |x, _| x), &[[0, 1, 2], [0, 2, 3]], &whole);
    assert!(torn.stretch[0].iter().all(|s| s.is_nan()) && torn.areal.values[1].is_nan());
    assert!(torn.angle.values[0].is_nan() && torn.angle.values[1].is_finite());
    assert!(torn.areal.values[0].is_finite() && torn.flipped.collapsed == 0);
    // an edge of 0 mm, and a vertex without a position
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

/// Computes the result of `wb_command -surface-distortion`, also in f32.
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
fn shares_beyond_factors_are_of_the_surface_whatever_the_maps_scale() {
    let (uv, faces) = grid(10, 1);
    let points = in_space(&uv, |_, _| 0.0);
    // the widths in the map of the last three of ten columns, which together keep the area
    let cases = [
        ([0.4, 1.4, 1.2], [0.2, 0.1, 0.1]),
        ([0.55, 1.4, 1.05], [0.2, 0.1, 0.0]),
        ([0.0, 1.45, 1.55], [0.3, 0.2, 0.1]), // one has no area
        ([1.0, 1.0, 1.0], [0.0; 3]),
    ];
    for (widths, expected) in cases {
        for scale in [1.0, 0.1, 30.0] {
            let width = |column: usize| if column < 7 { 1.0 } else { widths[column - 7] };
            let x = |place: f64| (0..place as usize).map(width).sum::<f64>();
            let map: Vec<[f64; 2]> = uv.iter().map(|&[at, y]| [scale * x(at), scale * y]).collect();
            let found = measured(&points, &faces, &map).area_beyond;
            assert!(found.iter().zip(expected).all(|(share, known)| (share - known).abs() < 1e-12), "{found:?}");
        }
    }
    // a change by exactly the factor is not beyond it
    let (uv, faces) = grid(4, 1);
    let points = in_space(&uv, |_, _| 0.0);
    let x = [0.0, 2.0, 2.5, 3.0, 4.0];
    let map: Vec<[f64; 2]> = uv.iter().map(|&[at, y]| [x[at as usize], y]).collect();
    assert_eq!(measured(&points, &faces, &map).area_beyond, [0.75, 0.75, 0.0]);
    let nowhere = vec![[0.0; 2]; uv.len()];
    assert!(measured(&points, &faces, &nowhere).area_beyond.iter().all(|share| share.is_nan()));
}

#[test]
fn areas_at_the_scale_that_keeps_the_whole_area() {
    for (s, bend) in [(0.3, 0.0), (1.0, 0.4), (4.0, 0.4)] {
        let (uv, faces) = grid(9, 7);
        let turn = Rotation3::from_euler_angles(0.3, -1.1, 2.0);
        let points: Vec<_> =
            in_space(&uv, |_, _| 0.0).iter().map(|p| turn * p + Vector3::new(30.0, -70.0, 5.0)).collect();
        let bent = |&[x, y]: &[f64; 2]| [s * (x + bend * (0.7 * x).sin()) - 40.0, s * (y + bend * y.cos()) + 9.0];
        let map: Vec<[f64; 2]> = uv.iter().map(bent).collect();
        let found = measured(&points, &faces, &map);
        // the outline remains a rectangle, whose sides determine the map's area
        let width = 9.0 + bend * (0.7f64 * 9.0).sin();
        let height = 7.0 + bend * (7f64.cos() - 1.0);
        let scale = (63.0 / (s * s * width * height)).sqrt();
        assert!((found.equal_area_scale / scale - 1.0).abs() < 1e-12);
        let values: Vec<f64> = found.areal.values.iter().map(|log| (log + (scale * scale).log2()).abs()).collect();
        let expected = Summary::of(&values, |_| 1.0);
        let close = |a: f64, b: f64| (a - b).abs() < 1e-9;
        assert!(close(found.equal_area.mean, expected.mean) && close(found.equal_area.max, expected.max));
        assert!(close(found.equal_area.median, expected.median) && close(found.equal_area.p95, expected.p95));
        assert_eq!((found.equal_area.undefined, expected.max > 0.1), (0, bend > 0.0));
    }
}

#[test]
fn areal_distortion_is_workbenchs() {
    let (uv, faces) = grid(40, 30);
    let points = in_space(&uv, |x, y| 3.0 * (0.4 * x).sin() * (0.3 * y).cos() - 40.0);
    let moved: Vec<_> = uv.iter().map(|&[x, y]| [1.1 * x + 0.3 * y.sin() - 60.0, 0.9 * y + 0.2 * x.cos()]).collect();
    let ours = measured(&points, &faces, &moved).areal;
    for (ours, theirs) in ours.values.iter().zip(workbench(&points, &faces, &moved)) {
        assert!((ours - f64::from(theirs)).abs() < 1e-4, "{ours} {theirs}");
    }
    assert!(ours.summary.p95 > 0.3);
}

proptest! {
    #[test]
    fn angles_are_those_between_sides(
        corners in prop::array::uniform3(prop::array::uniform3(-5.0..5.0f64)),
        places in prop::array::uniform3(prop::array::uniform2(-5.0..5.0f64)),
    ) {
        let (p, q) = (corners.map(Vector3::from), places.map(|[u, v]| Vector3::new(u, v, 0.0)));
        let wide = |c: &[Vector3<f64>; 3]| (c[1] - c[0]).cross(&(c[2] - c[0])).norm() > 0.1;
        prop_assume!(wide(&p) && wide(&q));
        // law of cosines
        let angle = |c: &[Vector3<f64>; 3], k: usize| {
            let [a, b, x] = [(k, (k + 1) % 3), (k, (k + 2) % 3), ((k + 1) % 3, (k + 2) % 3)].map(|(m, n)| (c[m] - c[n]).norm());
            ((a * a + b * b - x * x) / (2.0 * a * b)).clamp(-1.0, 1.0).acos().to_degrees()
        };
        let expected = (0..3).map(|k| (angle(&p, k) - angle(&q, k)).abs()).sum::<f64>() / 3.0;
        let found = measured(&p, &[[0, 1, 2]], &places).angle.values[0];
        prop_assert!((found - expected).abs() < 1e-5, "{found} {expected}");
    }

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
}

#[test]
fn of_equally_many_triangles_the_smaller_are_flipped_and_of_equal_ones_the_clockwise() {
    let faces = [[0, 1, 2], [2, 1, 3]];
    for (corner, mirror, flipped) in
        [(1.0, 1.0, [false, true]), (1.0, -1.0, [true, false]), (3.0, -1.0, [true, false]), (0.4, -1.0, [false, true])]
    {
        // the second triangle is folded onto the first; it is larger, smaller, or as large
        let points = in_space(&[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [corner, corner]], |_, _| 0.0);
        let uv = [[0.0, 0.0], [mirror, 0.0], [0.0, 1.0], [0.1 * mirror, 0.1]];
        let found = measured(&points, &faces, &uv).flipped;
        assert_eq!((&found.per_face[..], found.count), (&flipped[..], 1), "{corner} {mirror}");
    }
}
