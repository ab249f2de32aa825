use nalgebra::Vector3;
use proptest::prelude::*;

use super::*;
use crate::geodesic::path::checks::{assert_on_surface, bumpy};
use crate::geodesic::{exact::Exact, path::length};
use crate::surface::mesh::shapes;

/// Returns the relative excess length of each vertex's path over the exact one, and checks every path.
fn excess(surface: &Surface, wave: Wave, source: u32) -> Vec<f64> {
    let control = Control::default();
    let marching = Marching::new(surface, wave, &control).unwrap();
    let marched = marching.march(source, &control).unwrap();
    let (exact, mut row) = (Exact::new(surface), vec![0.0; surface.len()]);
    exact.distances(source, &mut row, &mut exact.scratch(), &control).unwrap();
    let of = |target: u32| {
        let path = marched.path(target, &control).unwrap();
        assert_on_surface(surface, &path);
        assert_eq!([path[0].site, path[path.len() - 1].site], [target, source].map(Site::Vertex));
        length(&path) / row[target as usize] - 1.0
    };
    (0..surface.len() as u32).filter(|&target| target != source).map(of).collect()
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

fn greatest(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::NEG_INFINITY, f64::max)
}

fn least(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::INFINITY, f64::min)
}

/// Returns a sheet with random triangles, in the plane or bent onto a cylinder of radius 5; none if a triangle is
/// flipped.
fn irregular(seed: u64, is_bent: bool) -> Option<Surface> {
    let (flat, faces) = (bumpy(16, 14, seed), shapes::sheet(16, 14).1);
    let is_turned = |face: &[u32; 3]| {
        let [a, b, c] = face.map(|v| flat.points()[v as usize].xy());
        (b - a).perp(&(c - a)) <= 0.0
    };
    if flat.faces().iter().any(is_turned) {
        return None;
    }
    let place = |p: &Vector3<f64>| match is_bent {
        true => [5.0 * (p.x / 5.0).sin(), p.y, 5.0 * (p.x / 5.0).cos()],
        false => [p.x, p.y, 0.0],
    };
    Some(shapes::surface((flat.points().iter().map(place).collect(), faces)))
}

#[test]
fn paths_in_a_plane_are_straight() {
    let surface = shapes::surface(shapes::sheet(14, 14));
    for source in [0, 7, 112] {
        let excess = excess(&surface, Wave::Circle, source);
        assert!(greatest(&excess) < 1e-6 && least(&excess) > -1e-12, "{excess:?}");
    }
}

#[test]
fn a_path_to_the_source_is_a_point() {
    let surface = shapes::surface(shapes::sphere(2));
    let control = Control::default();
    let path = Marching::new(&surface, Wave::Circle, &control).unwrap().march(9, &control).unwrap().path(9, &control);
    assert_eq!(path.unwrap(), [PathPoint::at(&surface, Site::Vertex(9))]);
}

#[test]
fn a_finer_sphere_brings_paths_nearer_to_great_circles() {
    let error = |times: usize, wave: Wave| {
        let surface = shapes::surface(shapes::sphere(times));
        let control = Control::default();
        let marching = Marching::new(&surface, wave, &control).unwrap();
        let marched = marching.march(0, &control).unwrap();
        let of = |target: u32| {
            let arc = surface.points()[target as usize].angle(&surface.points()[0]);
            (length(&marched.path(target, &control).unwrap()) / arc - 1.0).abs()
        };
        mean(&(1..surface.len() as u32).map(of).collect::<Vec<_>>())
    };
    // the distances of straight fronts themselves are hardly more accurate
    for (wave, falls, finest) in [(Wave::Plane, 0.95, 0.0045), (Wave::Circle, 0.3, 0.0014)] {
        let errors = [2, 3, 4].map(|times| error(times, wave));
        assert!(errors.windows(2).all(|two| two[1] < falls * two[0]) && errors[2] < finest, "{wave:?} {errors:?}");
    }
}

#[test]
fn paths_bend_round_the_corner_of_a_hole() {
    let sheet = shapes::surface(shapes::sheet(12, 12));
    let middle = |face: &[u32; 3]| face.iter().map(|&v| sheet.points()[v as usize]).sum::<Vector3<f64>>() / 3.0;
    let keep: Vec<bool> = sheet.faces().iter().map(|face| middle(face).x < 4.0 || middle(face).y < 4.0).collect();
    let bent = sheet.part(&keep); // an L
    let excess = excess(&bent, Wave::Circle, 12);
    assert!(mean(&excess) < 1e-3 && greatest(&excess) < 0.015 && least(&excess) > -1e-12, "{excess:?}");
}

#[test]
fn paths_go_round_the_end_of_a_cut() {
    let slit = crate::tests::slit(12, 10, 9.0, 5.0);
    assert_eq!(slit.len(), 13 * 11 + 9);
    let excess = excess(&slit, Wave::Circle, 3);
    assert!(mean(&excess) < 1e-3 && greatest(&excess) < 0.015 && least(&excess) > -1e-12, "{excess:?}");
}

#[test]
fn where_no_front_comes_is_unreachable_and_work_is_cancelled() {
    let apart = crate::tests::slit(4, 8, 4.0, 4.0);
    let control = Control::default();
    let marching = Marching::new(&apart, Wave::Circle, &control).unwrap();
    let marched = marching.march(0, &control).unwrap();
    let target = marched.distance.iter().position(|d| d.is_infinite()).unwrap();
    let expected = Error::Unreachable { source_vertex: 0, vertex: target };
    assert_eq!(marched.path(target as u32, &control), Err(expected));
    control.cancel();
    assert_eq!(marched.path(4, &control), Err(Error::Cancelled));
    assert!(matches!(marching.march(0, &control), Err(Error::Cancelled)));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    #[test]
    fn paths_on_irregular_developable_sheets_are_hardly_too_long(seed in any::<u64>(), is_bent: bool, source in 0u32..255) {
        let Some(sheet) = irregular(seed, is_bent) else { return Err(TestCaseError::reject("folded")) };
        let excess = excess(&sheet, Wave::Circle, source);
        prop_assert!(least(&excess) > -1e-12);
        prop_assert!(greatest(&excess) < 0.05 && mean(&excess) < 2e-3, "{} {}", greatest(&excess), mean(&excess));
    }

    #[test]
    fn paths_on_rough_sheets_end_and_are_not_much_too_long(seed in any::<u64>(), source in 0u32..154, plane: bool) {
        let wave = if plane { Wave::Plane } else { Wave::Circle };
        let excess = excess(&bumpy(13, 10, seed), wave, source);
        prop_assert!(least(&excess) > -1e-12);
        prop_assert!(mean(&excess) < 0.04, "{}", mean(&excess));
    }

    #[test]
    fn paths_on_slivers_end(flat in -9i32..0, sheared in -3.0f64..3.0, seed in any::<u64>(), source in 0u32..99) {
        let thin = 10f64.powi(flat);
        let place = |p: &Vector3<f64>| [p.x + sheared * p.y, p.y * thin, p.z * thin];
        let points: Vec<_> = bumpy(10, 8, seed).points().iter().map(place).collect();
        let Ok((surface, _)) = Surface::from_triangles(&points, &shapes::sheet(10, 8).1) else { return Ok(()) };
        let excess = excess(&surface, Wave::Circle, source);
        prop_assert!(least(&excess) > -1e-9, "{}", least(&excess));
    }
}
