use std::f64::consts::PI;

use nalgebra::{Rotation3, Vector3};
use proptest::prelude::*;

use super::locate::Locator;
use super::map::{spherical_map, turned_over};
use super::pattern::pattern;
use super::register::{Template, register};
use crate::surface::{Surface, mesh::shapes};
use crate::{Control, Error};

fn bent(times: usize, by: impl Fn(Vector3<f64>) -> Vector3<f64>) -> Surface {
    let (points, faces) = shapes::sphere(times);
    shapes::surface((points.into_iter().map(|p| by(p.into()).into()).collect(), faces))
}

/// Maps the sphere to a shape without symmetries.
fn folded(p: Vector3<f64>) -> Vector3<f64> {
    let ripples = 0.12 * (7.0 * p.x + 2.0 * p.z).sin() + 0.1 * (8.0 * p.y - 3.0 * p.x * p.x).sin();
    Vector3::new(1.0 * p.x + 0.3 * p.y * p.y, 1.6 * p.y, 0.8 * p.z + 0.2 * p.x) * (1.0 + ripples)
}

/// Returns the area of a spherical triangle (Van Oosterom, Strackee 1983).
fn excess([a, b, c]: [Vector3<f64>; 3]) -> f64 {
    2.0 * a.dot(&b.cross(&c)).atan2(1.0 + a.dot(&b) + b.dot(&c) + c.dot(&a))
}

fn assert_covers_once(faces: &[[u32; 3]], places: &[Vector3<f64>]) {
    assert_eq!(turned_over(faces, places), 0);
    let area: f64 = faces.iter().map(|face| excess(face.map(|v| places[v as usize]))).sum();
    assert!((area - 4.0 * PI).abs() < 1e-9, "{area}");
    assert!(places.iter().all(|place| (place.norm() - 1.0).abs() < 1e-12));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn any_closed_surface_without_handles_covers_the_sphere_once(
        waves in prop::collection::vec((prop::array::uniform3(-9.0..9.0f64), 0.0..0.4f64), 1..6),
        stretch in prop::array::uniform3(0.05..3.0f64),
        noise in 0.0..0.05f64,
        times in 0..5usize,
    ) {
        let surface = bent(times, |p| {
            let radius: f64 = waves.iter().map(|(k, by)| by * Vector3::from(*k).dot(&p).sin()).sum();
            let shake = Vector3::new((91.0 * p.y).sin(), (87.0 * p.z).sin(), (93.0 * p.x).sin()) * noise;
            p.component_mul(&Vector3::from(stretch)) * radius.exp() + shake
        });
        let places = spherical_map(&surface, &Control::default()).unwrap();
        assert_covers_once(surface.faces(), &places);
    }

    #[test]
    fn the_triangle_that_holds_a_place_is_found(place in prop::array::uniform3(-1.0..1.0f64), times in 0..4usize) {
        let place = Vector3::from(place);
        prop_assume!(place.norm() > 0.01);
        let sphere = shapes::surface(shapes::sphere(times));
        let found = Locator::over(&sphere).locate(&place.normalize());
        let there = found.vector(sphere.faces(), sphere.points()).normalize();
        prop_assert!(found.weights.iter().all(|&weight| weight > -1e-12));
        prop_assert!((there - place.normalize()).norm() < 1e-12);
    }
}

#[test]
fn a_sphere_stays_as_it_is_but_for_a_rotation() {
    let sphere = shapes::surface(shapes::sphere(4));
    let places = spherical_map(&sphere, &Control::default()).unwrap();
    let worst = sphere.edges().map(|h| {
        let [a, b] = [sphere.origin(h), sphere.target(h)].map(|v| places[v as usize]);
        ((a - b).norm() / sphere.length(h)).ln().abs()
    });
    assert!(worst.fold(0.0, f64::max) < 0.1);
}

#[test]
fn holes_are_closed_and_handles_are_refused() {
    let sphere = shapes::surface(shapes::sphere(4));
    let holed =
        sphere.part_of_vertices(&sphere.points().iter().map(|p| p.z < 0.8 && p.x < 0.98).collect::<Vec<_>>()).unwrap();
    let places = spherical_map(&holed, &Control::default()).unwrap();
    assert_eq!((places.len(), turned_over(holed.faces(), &places)), (holed.len(), 0));
    // a boundary with more edges than are filled at once
    let disk = shapes::surface(shapes::sheet(200, 3));
    let places = spherical_map(&disk, &Control::default()).unwrap();
    assert_eq!((places.len(), turned_over(disk.faces(), &places)), (disk.len(), 0));
    let torus = shapes::surface(shapes::torus(12, 7));
    let refused = Error::NotASphere { components: 1, loops: 0, handles: 1 };
    assert_eq!(spherical_map(&torus, &Control::default()), Err(refused));
}

#[test]
fn a_turned_copy_is_recovered_and_a_mirrored_one_agrees_less() {
    let control = Control::default();
    let surface = bent(4, folded);
    let of = pattern(&surface, &control).unwrap();
    let sphere = surface.moved(spherical_map(&surface, &control).unwrap()).unwrap();
    let mirrored = bent(4, |p| {
        let q = folded(Vector3::new(-p.x, p.y, p.z));
        Vector3::new(-q.x, q.y, q.z)
    });
    let of_mirrored = pattern(&mirrored, &control).unwrap();
    let mirrored_sphere = mirrored.moved(spherical_map(&mirrored, &control).unwrap()).unwrap();
    let templates = [
        Template::new(mirrored_sphere, of_mirrored.depths, of_mirrored.places, of_mirrored.areas).unwrap(),
        Template::new(sphere.clone(), of.depths, of.places, of.areas).unwrap(),
    ];
    let turn = Rotation3::from_euler_angles(0.4, 2.0, -1.3);
    let turned = surface.moved(surface.points().iter().map(|p| turn * p * 30.0).collect()).unwrap();
    let found = register(&turned, &templates, None, &control).unwrap();
    assert_eq!(found.template, 1);
    assert_covers_once(turned.faces(), &found.points);
    let off = found.points.iter().zip(sphere.points()).map(|(p, q)| (p - q).norm());
    assert!(off.sum::<f64>() / (turned.len() as f64) < 0.03);
    assert!(found.alignments[1].score > found.alignments[0].score + 0.1);
}
