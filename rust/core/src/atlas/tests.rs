use std::collections::HashMap;

use proptest::prelude::*;

use super::*;
use crate::distortion::{faces::measure_faces, overlap::overlaps};
use crate::surface::mesh::shapes;
use crate::tests::{Mesh, moved};

/// The positions of a triangle's corners, bit by bit.
type Corners = [[u64; 3]; 3];

/// The patch of a triangle, and the positions of its corners there, bit by bit.
type Flat = (u32, [[u64; 2]; 3]);

const ALL_SEEDS: [Seeds; 3] = [Seeds::Curvature, Seeds::Flattest, Seeds::Random(7)];

fn made(surface: &Surface, limit: Limit, seeds: Seeds) -> Atlas {
    patches(surface, limit, seeds, &Control::default()).unwrap()
}

/// Returns a plane grid with the given displacements, scaled by `size`.
pub(super) fn shaken(side: usize, shake: &[[f64; 3]], size: f64) -> Mesh {
    let (mut points, faces) = shapes::sheet(side, side);
    for (point, by) in points.iter_mut().zip(shake) {
        (0..3).for_each(|k| point[k] += size * by[k] * if k == 2 { 2.0 } else { 0.4 });
    }
    (points, faces)
}

/// Checks all guarantees, using only the returned values.
fn check(surface: &Surface, atlas: &Atlas) {
    let Certificate { angle, c, k } = atlas.certificate;
    let mut seen = vec![false; surface.faces().len()];
    for (number, patch) in atlas.patches.iter().enumerate() {
        let local = |v: u32| patch.vertices.binary_search(&v).unwrap() as u32;
        let faces: Vec<[u32; 3]> = patch.faces.iter().map(|&f| surface.faces()[f as usize].map(local)).collect();
        let points: Vec<Vector3<f64>> = patch.vertices.iter().map(|&v| surface.points()[v as usize]).collect();
        for &face in &patch.faces {
            assert!(!std::mem::replace(&mut seen[face as usize], true), "a face in two patches");
            assert_eq!(atlas.labels[face as usize], number as u32);
        }
        assert_eq!(overlaps(&faces, &patch.uv, &Control::default()).unwrap().covering, 0);
        let figures = measure_faces(&points, &faces, &patch.uv, &Control::default()).unwrap();
        assert_eq!((figures.flipped.count, figures.flipped.collapsed), (0, 0));
        let measured = [
            figures.isometric.summary.max / patch.isometric,
            figures.quasi_conformal.summary.max / patch.quasi_conformal,
        ];
        assert!(measured.iter().all(|ratio| (ratio - 1.0).abs() < 1e-9), "{measured:?}");
        assert!(patch.isometric <= c && patch.quasi_conformal <= k, "{c} {k} {patch:?}");
        assert!(patch.tilt <= angle * (1.0 + 1e-9));
        check_plane(patch, &points, &faces, angle);
        let part: Vec<bool> = (0..seen.len()).map(|f| atlas.labels[f] == number as u32).collect();
        assert_eq!(surface.part(&part).components().count(), 1, "a patch hangs together");
    }
    assert!(seen.iter().all(|&is| is), "a face in no patch");
    assert!(atlas.patches.windows(2).all(|two| two[0].area >= two[1].area));
}

/// Checks that every direction in every triangle is within the angle, and that lengths change by at most its cosine.
fn check_plane(patch: &Patch, points: &[Vector3<f64>], faces: &[[u32; 3]], angle: f64) {
    let Plane { normal, axes: [u, v], .. } = patch.plane;
    assert!((u.cross(&v) - normal).norm() < 1e-14 && (normal.norm() - 1.0).abs() < 1e-14);
    for [a, b, c] in faces.iter().map(|face| face.map(|n| n as usize)) {
        for step in 0..60 {
            // from a corner to points all along the side beyond it, from each corner
            let (a, b, c) = [(a, b, c), (b, c, a), (c, a, b)][step % 3];
            let share = step as f64 / 60.0;
            let direction = points[b] * share + points[c] * (1.0 - share) - points[a];
            let flat = [0, 1].map(|k| patch.uv[b][k] * share + patch.uv[c][k] * (1.0 - share) - patch.uv[a][k]);
            assert!((direction.dot(&normal).abs() / direction.norm()).asin().to_degrees() <= angle + 1e-6);
            let ratio = flat[0].hypot(flat[1]) / direction.norm();
            assert!(ratio <= 1.0 + 1e-9 && ratio >= angle.to_radians().cos() - 1e-9);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn certificates_hold_on_rough_surfaces(
        shake in prop::collection::vec(prop::array::uniform3(-1.0..1.0f64), 64),
        size in 0.01..1.0f64,
        angle in 2.0..70.0f64,
        bound in 1.001..4.0f64,
    ) {
        let surface = shapes::surface(shaken(7, &shake, size));
        for seeds in ALL_SEEDS {
            check(&surface, &made(&surface, Limit::Angle(angle), seeds));
            check(&surface, &made(&surface, Limit::Bound(bound), seeds));
        }
    }

    #[test]
    fn numbers_of_vertices_and_faces_do_not_matter(
        shake in prop::collection::vec(prop::array::uniform3(-1.0..1.0f64), 81),
        flat in 0usize..81,
        angle in 3.0..40.0f64,
        seed in any::<u64>(),
    ) {
        // a part of it remains level, so that there are ties
        let mut shake = shake;
        shake[..flat].fill([0.0; 3]);
        let mesh = shaken(8, &shake, 0.3);
        let renumbered = renumber(&mesh, seed);
        for seeds in ALL_SEEDS {
            let [one, other] = [&mesh, &renumbered].map(|mesh| {
                let surface = shapes::surface(mesh.clone());
                let atlas = made(&surface, Limit::Angle(angle), seeds);
                by_places(&surface, &atlas)
            });
            prop_assert_eq!(one, other);
        }
    }
}

/// Renumbers the vertices and faces of a mesh, and rotates the corners of its faces.
fn renumber((points, faces): &Mesh, seed: u64) -> Mesh {
    use rand::{SeedableRng, seq::SliceRandom};
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.shuffle(&mut rng);
    let mut number = vec![0; order.len()];
    order.iter().zip(0..).for_each(|(&old, new)| number[old] = new);
    let mut faces: Vec<[i64; 3]> = faces.iter().map(|face| face.map(|v| number[v as usize])).collect();
    faces.shuffle(&mut rng);
    faces.iter_mut().zip(0..).for_each(|(face, n)| face.rotate_left(n % 3));
    (order.iter().map(|&old| points[old]).collect(), faces)
}

/// Returns, for each triangle, its patch and the positions of its corners in the patch, bit by bit.
fn by_places(surface: &Surface, atlas: &Atlas) -> HashMap<Corners, Flat> {
    let bits = |v: u32| <[f64; 3]>::from(surface.points()[v as usize]).map(f64::to_bits);
    let triangle = |(face, &label): (usize, &u32)| {
        let patch = &atlas.patches[label as usize];
        let mut corners = surface.faces()[face];
        corners.sort_by_key(|&v| bits(v));
        let uv = |v: u32| patch.uv[patch.vertices.binary_search(&v).unwrap()].map(f64::to_bits);
        (corners.map(bits), (label, corners.map(uv)))
    };
    atlas.labels.iter().enumerate().map(triangle).collect()
}

#[test]
fn a_plane_is_one_patch_without_distortion() {
    let sheet = shapes::surface(moved(&shapes::sheet(9, 7), |&[x, y, _]| [0.6 * x, y, 0.8 * x + 3.0]));
    for seeds in ALL_SEEDS {
        for limit in [Limit::Angle(0.01), Limit::Angle(80.0), Limit::Bound(1.1), Limit::Count(1)] {
            let atlas = made(&sheet, limit, seeds);
            assert_eq!((atlas.patches.len(), atlas.patches[0].faces.len()), (1, 126));
            assert!(atlas.patches[0].isometric - 1.0 < 1e-12 && atlas.patches[0].tilt < 1e-6);
            check(&sheet, &atlas);
        }
    }
}

#[test]
fn certificates_are_the_papers() {
    assert!((Certificate::of_angle(10.0).unwrap().c - 1.1763).abs() < 5e-5);
    assert!((Certificate::of_angle(5.0).unwrap().c - 1.0875).abs() < 5e-5);
    assert!((Certificate::of_angle(10.0).unwrap().k - 1.1763f64.powf(1.5)).abs() < 1e-4);
    let bound = Certificate::of_bound(1.1763).unwrap();
    assert!((bound.c, bound.k) == (1.1763, 1.1763) && (bound.angle - 31.77).abs() < 0.01);
    for angle in [f64::NAN, 0.0, -3.0, 80.1, f64::INFINITY] {
        assert!(matches!(Certificate::of_angle(angle), Err(Error::AngleOutOfRange { .. })));
    }
    for bound in [f64::NAN, 1.0, 0.9, 6.0] {
        assert!(matches!(Certificate::of_bound(bound), Err(Error::BoundOutOfRange { .. })));
    }
}

/// The paper's test of a triangle's two new edges is not sufficient.
#[test]
fn edges_within_the_angle_do_not_suffice() {
    // a level triangle, and one beside it that is nearly upright on a level contour line
    let points = vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, -1.0, 0.0], [0.5, 0.001, 0.02]];
    let surface = shapes::surface((points, vec![[0, 2, 1], [0, 1, 3]]));
    let inclination = |a: usize, b: usize| {
        let edge = surface.points()[b] - surface.points()[a];
        (edge.z.abs() / edge.norm()).asin().to_degrees()
    };
    assert!(inclination(0, 3) < 3.0 && inclination(1, 3) < 3.0);
    let flat: Vec<[f64; 2]> = surface.points().iter().map(|p| [p.x, p.y]).collect();
    let figures = measure_faces(surface.points(), surface.faces(), &flat, &Control::default()).unwrap();
    assert!(figures.isometric.summary.max > 10.0);
    for seeds in ALL_SEEDS {
        let atlas = made(&surface, Limit::Angle(10.0), seeds);
        assert_eq!(atlas.patches.len(), 2);
        check(&surface, &atlas);
    }
}

#[test]
fn a_sphere_takes_fewer_patches_the_steeper_they_may_be() {
    let sphere = shapes::surface(shapes::sphere(4));
    let mut counts = Vec::new();
    for angle in [5.0, 10.0, 20.0, 40.0, 80.0] {
        let atlas = made(&sphere, Limit::Angle(angle), Seeds::Curvature);
        check(&sphere, &atlas);
        // a triangle reaches less than 5° beyond the place where the sphere has its normal
        let cap = std::f64::consts::TAU * (1.0 - (angle + 5.0).to_radians().cos());
        assert!(atlas.patches.len() as f64 >= sphere.areas().iter().sum::<f64>() / cap);
        assert!(atlas.patches[0].area <= cap);
        counts.push(atlas.patches.len());
    }
    assert!(counts.windows(2).all(|two| two[1] < two[0]), "{counts:?}");
    let plain = made(&sphere, Limit::Angle(20.0), Seeds::Random(1));
    assert!(4 * counts[2] < 3 * plain.patches.len());
}

#[test]
fn a_number_of_patches_is_kept_by_the_smallest_angle() {
    let torus = shapes::surface(shapes::torus(40, 16));
    let atlas = made(&torus, Limit::Count(40), Seeds::Curvature);
    check(&torus, &atlas);
    assert!(atlas.patches.len() <= 40);
    let steeper = made(&torus, Limit::Angle(0.9 * atlas.certificate.angle), Seeds::Curvature);
    assert!(steeper.patches.len() > 40);
    let none = patches(&torus, Limit::Count(1), Seeds::Curvature, &Control::default());
    assert!(matches!(none, Err(Error::TooFewPatches { count: 1, .. })));
}

/// Two and a half turns of a spiral staircase, which is nearly level everywhere, but overlaps itself.
#[test]
fn a_spiral_staircase_does_not_lie_on_itself() {
    let spiral = shapes::surface(moved(&shapes::sheet(157, 2), |&[n, rail, _]| {
        let (turn, r) = (-0.1 * n, [1.0, 1.3, 2.0][rail as usize]);
        [r * turn.cos(), r * turn.sin(), 0.05 * turn]
    }));
    assert!(spiral.face_normals().iter().all(|n| n.z.abs() > 10f64.to_radians().cos()));
    for seeds in ALL_SEEDS {
        let atlas = made(&spiral, Limit::Angle(15.0), seeds);
        check(&spiral, &atlas);
        assert!((3..=5).contains(&atlas.patches.len()), "{}", atlas.patches.len());
    }
}

#[test]
fn all_is_done_in_the_end_and_flat_triangles_are_refused() {
    let sheet = shapes::surface(shapes::sheet(5, 5));
    let control = Control::default();
    patches(&sheet, Limit::Angle(5.0), Seeds::Curvature, &control).unwrap();
    assert_eq!(control.progress().done, control.progress().total);
    let squeezed = sheet.points().iter().map(|p| if p.x < 1.5 { Vector3::new(1.0, p.y, 0.0) } else { *p }).collect();
    let squeezed = sheet.moved(squeezed).unwrap();
    let found = patches(&squeezed, Limit::Angle(5.0), Seeds::Curvature, &Control::default());
    assert!(matches!(found, Err(Error::DegenerateFace { count: 10, .. })), "{found:?}");
}
