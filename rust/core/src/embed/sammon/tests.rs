use super::*;
use crate::surface::{Surface, mesh::shapes};
use nalgebra::Vector3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn random(count: usize, side: f64, seed: u64) -> Vec<[f64; 2]> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..count).map(|_| [rng.random_range(0.0..side), rng.random_range(0.0..side)]).collect()
}

fn plane() -> Surface {
    let surface = shapes::surface(shapes::sheet(12, 9));
    let by = random(surface.len(), 0.4, 5);
    let moved = surface.points().iter().zip(by).map(|(p, [x, y])| p + Vector3::new(x, y, 0.0));
    surface.moved(moved.collect()).unwrap()
}

fn pairs(surface: &Surface, rings: Option<u32>, sources: &[u32]) -> Neighbourhoods {
    Neighbourhoods::measure(surface, rings, sources, false, &Control::default()).unwrap().0
}

fn stress(pairs: &Neighbourhoods, uv: &[[f64; 2]]) -> f64 {
    step(pairs, uv, &Control::default()).unwrap().0
}

#[test]
fn the_stress_is_sammons() {
    let surface = shapes::surface(shapes::sphere(2));
    let pairs = pairs(&surface, Some(2), &[4]);
    let uv = random(surface.len(), 3.0, 1);
    let (mut above, mut below) = (0.0, 0.0);
    for a in 0..surface.len() {
        for near in pairs.of_vertex(a).iter().filter(|near| near.vertex as usize > a) {
            let ([x, y], [u, v]) = (uv[a], uv[near.vertex as usize]);
            let delta = f64::from(near.distance);
            above += ((x - u).hypot(y - v) - delta).powi(2) / delta;
            below += delta;
        }
    }
    let found = stress(&pairs, &uv);
    assert!((found / (above / below) - 1.0).abs() < 1e-12);
}

#[test]
fn the_derivatives_are_those_of_the_stress() {
    let surface = shapes::surface(shapes::sphere(2));
    let pairs = pairs(&surface, Some(2), &[4]);
    let uv = random(surface.len(), 3.0, 2);
    for vertex in 0..surface.len() {
        let pull = Pull::of(vertex, pairs.of_vertex(vertex), &uv);
        for axis in 0..2 {
            let at = |by: f64| {
                let mut uv = uv.clone();
                uv[vertex][axis] += by;
                stress(&pairs, &uv) * pairs.total()
            };
            // a pair counts from both ends, and the gradient is half a derivative
            let step = 1e-4;
            let (left, middle, right) = (at(-step), at(0.0), at(step));
            let scale = pull.stiffness;
            assert!(((right - left) / (2.0 * step) - 4.0 * pull.gradient[axis]).abs() < 1e-5 * scale);
            assert!(((right - 2.0 * middle + left) / (step * step) - 4.0 * pull.curvature[axis]).abs() < 1e-3 * scale);
        }
    }
}

#[test]
fn a_plane_comes_out_as_a_plane() {
    let surface = plane();
    let sources: Vec<u32> = (0..surface.len() as u32).step_by(6).collect();
    for pairs in [pairs(&surface, None, &[]), pairs(&surface, Some(3), &sources)] {
        for seed in 0..4 {
            let found = descend(&pairs, random(surface.len(), 10.0, seed), &Control::default()).unwrap();
            assert!(found.converged, "seed {seed}: {}", found.least);
            for a in 0..surface.len() {
                for b in 0..a {
                    let flat = (found.uv[a][0] - found.uv[b][0]).hypot(found.uv[a][1] - found.uv[b][1]);
                    let straight = (surface.points()[a] - surface.points()[b]).norm();
                    assert!((flat - straight).abs() < 0.05, "seed {seed}: {flat} instead of {straight}");
                }
            }
        }
    }
}

#[test]
fn the_map_of_least_stress_on_the_way_is_kept() {
    let surface = shapes::surface(shapes::sphere(2));
    let pairs = pairs(&surface, Some(2), &[]);
    let control = Control::default();
    for seed in 0..6 {
        let start = random(surface.len(), 3.0, seed);
        let found = descend(&pairs, start.clone(), &control).unwrap();
        assert_eq!(found.stresses[0], stress(&pairs, &start));
        assert_eq!(found.least, found.stresses.iter().copied().fold(f64::INFINITY, f64::min));
        assert_eq!(found.least, stress(&pairs, &found.uv));
        assert!(found.least < found.stresses[0]);
        // many more steps would hardly lower it
        let (mut uv, mut least) = (found.uv.clone(), found.least);
        for _ in 0..200 {
            let (stress, moved) = step(&pairs, &uv, &control).unwrap();
            (uv, least) = (moved, least.min(stress));
        }
        assert!(least > 0.999 * found.least, "{least} {}", found.least);
        // from there, it does not get worse
        assert!(descend(&pairs, found.uv.clone(), &control).unwrap().least <= found.least);
    }
}

#[test]
fn points_in_one_place_do_not_harm() {
    let surface = plane();
    let pairs = pairs(&surface, None, &[]);
    let mut start = random(surface.len(), 9.0, 3);
    let first = start[0];
    start[1..40].fill(first);
    let found = descend(&pairs, start, &Control::default()).unwrap();
    assert!(found.stresses.iter().all(|stress| stress.is_finite()));
}
