use proptest::prelude::*;

use nalgebra::{Matrix2, Vector2, Vector3};

use super::*;
use crate::atlas::{Limit, Seeds, patches, tests::shaken};
use crate::distortion::overlap::{counterclockwise, interiors_meet};
use crate::surface::mesh::{BORDER, next, shapes};
use crate::tests::{Mesh, both, moved};

fn glued(surface: &Surface, angle: f64, bound: f64) -> Glued {
    let atlas = patches(surface, Limit::Angle(angle), Seeds::Curvature, &Control::default()).unwrap();
    let glued = glue(surface, &atlas.labels, &atlas.flat(surface), bound, &Control::default()).unwrap();
    check(surface, &atlas.labels, &glued, bound);
    glued
}

/// Returns σ1 and σ2 by a singular value decomposition of the map from an orthonormal frame of the triangle.
fn singular(points: [Vector3<f64>; 3], uv: [[f64; 2]; 3]) -> [f64; 2] {
    let [p, q] = [points[1] - points[0], points[2] - points[0]];
    let across = (q - p * (q.dot(&p) / p.norm_squared())).normalize();
    let on_surface = Matrix2::new(p.norm(), q.dot(&p) / p.norm(), 0.0, q.dot(&across));
    let side = |n: usize| Vector2::new(uv[n][0] - uv[0][0], uv[n][1] - uv[0][1]);
    let jacobian = Matrix2::from_columns(&[side(1), side(2)]) * on_surface.try_inverse().unwrap();
    assert!(jacobian.determinant() > 0.0, "a triangle is folded");
    let values = jacobian.svd(false, false).singular_values;
    [values.max(), values.min()]
}

/// Checks all guarantees, using only the returned values.
fn check(surface: &Surface, patches: &[u32], glued: &Glued, bound: f64) {
    let mut rows = vec![None; surface.faces().len()];
    for (number, piece) in glued.pieces.iter().enumerate() {
        let flat = |corners: [u32; 3]| corners.map(|row| piece.uv[row as usize]);
        for (&face, &corners) in piece.faces.iter().zip(&piece.corners) {
            assert_eq!(corners.map(|row| piece.vertices[row as usize]), surface.faces()[face as usize]);
            assert!(rows[face as usize].replace(corners).is_none(), "a face in two pieces");
            assert_eq!(glued.labels[face as usize], number as u32);
            let stretch = singular(surface.faces()[face as usize].map(|v| surface.points()[v as usize]), flat(corners));
            assert!(stretch[0] <= bound + 1e-9 && stretch[1].recip() <= bound + 1e-9, "{stretch:?}");
            assert!((0..2).all(|k| (stretch[k] - glued.stretch[face as usize][k]).abs() < 1e-7));
        }
        let triangle = |&c: &[u32; 3]| counterclockwise(flat(c).map(|[x, y]| robust::Coord { x, y })).unwrap();
        let triangles: Vec<_> = piece.corners.iter().map(triangle).collect();
        for (n, triangle) in triangles.iter().enumerate() {
            assert!(!triangles[..n].iter().any(|other| interiors_meet(triangle, other)), "a piece lies on itself");
        }
        let part: Vec<bool> = glued.labels.iter().map(|&label| label == number as u32).collect();
        assert_eq!(surface.part(&part).components().count(), 1, "a piece hangs together");
    }
    let [mut seams, mut cuts] = [0.0; 2];
    for side in surface.edges().filter(|&side| surface.twins()[side as usize] != BORDER) {
        let twin = surface.twins()[side as usize];
        let [one, other] = [side, twin].map(|side| {
            let of = |corner: u32| rows[corner as usize / 3].unwrap()[corner as usize % 3];
            (glued.labels[side as usize / 3], of(side), of(next(side)))
        });
        let is_closed = one == (other.0, other.2, other.1);
        let is_seam = patches[side as usize / 3] != patches[twin as usize / 3];
        assert!(is_closed || is_seam, "a patch was cut");
        seams += if is_seam { surface.length(side) } else { 0.0 };
        cuts += if is_closed { 0.0 } else { surface.length(side) };
    }
    let Seams { length, closed, holonomy, bound, overlap } = glued.seams;
    assert!((length - seams).abs() < 1e-9 * (1.0 + seams) && (length - closed - cuts).abs() < 1e-9 * (1.0 + seams));
    assert!((holonomy + bound + overlap - cuts).abs() < 1e-9 * (1.0 + seams));
}

fn most_change(glued: &Glued) -> f64 {
    glued.stretch.iter().flatten().map(|sigma| (sigma - 1.0).abs()).fold(0.0, f64::max)
}

fn with_hole(shake: &[[f64; 3]], size: f64) -> Mesh {
    let (points, faces) = shaken(9, shake, size);
    let kept = |face: &[i64; 3]| !face.iter().all(|&v| (3..=6).contains(&(v / 10)) && (3..=6).contains(&(v % 10)));
    let faces = faces.into_iter().filter(kept).collect::<Vec<_>>();
    let mut number = vec![-1; points.len()];
    let mut used = Vec::new();
    for &v in faces.iter().flatten() {
        if number[v as usize] < 0 {
            number[v as usize] = used.len() as i64;
            used.push(points[v as usize]);
        }
    }
    (used, faces.into_iter().map(|face| face.map(|v| number[v as usize])).collect())
}

fn shakes() -> impl Strategy<Value = Vec<[f64; 3]>> {
    prop::collection::vec(prop::array::uniform3(-1.0..1.0f64), 100)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn what_is_promised_holds_on_rough_surfaces(
        shake in shakes(),
        size in 0.01..0.8f64,
        angle in 3.0..30.0f64,
        bound in 1.17..3.0f64,
    ) {
        glued(&shapes::surface(shaken(9, &shake, size)), angle, bound);
        glued(&shapes::surface(with_hole(&shake, size)), angle, bound);
        let (mut points, faces) = shapes::torus(12, 8);
        points.iter_mut().zip(&shake).for_each(|(p, by)| (0..3).for_each(|k| p[k] += 0.2 * size * by[k]));
        glued(&shapes::surface((points, faces)), angle, bound);
    }
}

/// Returns a sheet of irregular triangles, folded along the straight lines x = 0, 1, 2 and so on. `at` returns the
/// position in space of a point of the plane.
fn folded(m: usize, n: usize, at: impl Fn(f64, f64) -> [f64; 3]) -> Mesh {
    moved(&shapes::sheet(m, n), |&[x, y, _]| {
        let inner = y > 0.5 && y < n as f64 - 0.5;
        at(x, y + if inner { 0.4 * (7.0 * x + 3.0 * y).sin() } else { 0.0 })
    })
}

#[test]
fn two_patches_of_a_plane_are_one_piece() {
    let surface = shapes::surface(shapes::sheet(8, 6));
    let labels: Vec<u32> = surface.faces().iter().map(|face| u32::from(face[0] < 28)).collect();
    let rotated_and_translated = |(face, &label): (&[u32; 3], &u32)| {
        let (sin, cos) = (1.0 + f64::from(label)).sin_cos();
        face.map(|v| surface.points()[v as usize]).map(|p| [cos * p.x - sin * p.y, sin * p.x + cos * p.y + 7.0])
    };
    let flat: Vec<[[f64; 2]; 3]> = surface.faces().iter().zip(&labels).map(rotated_and_translated).collect();
    let found = glue(&surface, &labels, &flat, 1.01, &Control::default()).unwrap();
    check(&surface, &labels, &found, 1.01);
    assert_eq!((found.pieces.len(), found.patches), (1, 2));
    assert!(found.seams.length > 0.0 && (found.seams.closed - found.seams.length).abs() < 1e-12);
    assert!(most_change(&found) < 1e-9);
}

#[test]
fn developable_surfaces_become_flat_without_distortion() {
    let wave = folded(40, 12, |x, y| [0.7 * x, y, 3.0 * (0.4 * x).sin()]);
    let roll = folded(24, 10, |x, y| [(4.0 + 0.2 * x) * (0.2 * x).cos(), y, (4.0 + 0.2 * x) * (0.2 * x).sin()]);
    let cone = folded(24, 10, |x, y| {
        let (r, angle) = (5.0 + y, 0.2 * x);
        [0.6 * r * angle.cos(), 0.6 * r * angle.sin(), 0.8 * r]
    });
    for mesh in [wave, roll, cone] {
        let surface = shapes::surface(mesh);
        let found = glued(&surface, 10.0, 1.5);
        assert_eq!(found.pieces.len(), 1);
        assert!(found.patches > 5 && (found.seams.closed - found.seams.length).abs() < 1e-9);
        assert!(most_change(&found) < 1e-6, "{}", most_change(&found));
    }
}

#[test]
fn a_closed_cylinder_is_cut_along_one_line() {
    let (m, n) = (36, 20);
    let place = |i: usize, j: usize| {
        let (sin, cos) = (i as f64 / m as f64 * std::f64::consts::TAU).sin_cos();
        [5.0 * cos, 5.0 * sin, j as f64]
    };
    let points = (0..m).flat_map(|i| (0..=n).map(move |j| place(i, j))).collect();
    let surface = shapes::surface((points, shapes::grid_faces(m, n, |i, j| i % m * (n + 1) + j)));
    let found = glued(&surface, 12.0, 1.5);
    assert_eq!(found.pieces.len(), 1);
    assert!(most_change(&found) < 1e-6, "{}", most_change(&found));
    let cut = found.seams.length - found.seams.closed;
    assert!((cut - found.seams.holonomy).abs() < 1e-9 && cut >= n as f64 - 1e-9 && cut < 1.2 * n as f64, "{cut}");
}

#[test]
fn a_sphere_and_a_torus_are_mostly_closed() {
    for mesh in [shapes::sphere(4), shapes::torus(40, 20)] {
        let surface = shapes::surface(mesh);
        let found = glued(&surface, 10.0, 1.5);
        assert!(found.seams.closed > 0.8 * found.seams.length, "{:?}", found.seams);
        assert!(found.seams.closed < found.seams.length);
    }
}

#[test]
fn surfaces_that_do_not_hang_together_stay_apart() {
    let sheet = shapes::sheet(4, 4);
    let two = both(&sheet, &moved(&sheet, |&[x, y, z]| [x + 9.0, y, z + 2.0]));
    let found = glued(&shapes::surface(two), 10.0, 1.5);
    assert_eq!((found.pieces.len(), found.patches, found.seams.length), (2, 2, 0.0));
}

#[test]
fn bounds_that_cannot_be_kept_are_refused() {
    let surface = shapes::surface(shapes::torus(30, 16));
    let control = Control::default();
    let atlas = patches(&surface, Limit::Angle(20.0), Seeds::Curvature, &control).unwrap();
    let with = |bound: f64| glue(&surface, &atlas.labels, &atlas.flat(&surface), bound, &control);
    for bound in [f64::NAN, 1.0, 0.5, -3.0, 10.1, f64::INFINITY] {
        assert!(matches!(with(bound), Err(Error::GlueBoundOutOfRange { .. })));
    }
    assert!(matches!(with(1.01), Err(Error::PatchesBeyondBound { .. })));
}
