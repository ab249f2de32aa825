use super::*;
use crate::rows::DistanceRows;
use crate::surface::Surface;
use crate::surface::mesh::shapes;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn sheet() -> (Surface, DistanceRows) {
    let surface = shapes::surface(shapes::sheet(20, 14));
    let sources: Vec<u32> = (0..surface.len() as u32).step_by(7).collect();
    let apart = |a: u32, b: usize| (surface.points()[a as usize] - surface.points()[b]).norm() as f32;
    let data = sources.iter().flat_map(|&a| (0..surface.len()).map(move |b| apart(a, b))).collect();
    let rows = DistanceRows::new(sources, surface.len(), data);
    (surface, rows)
}

fn shaken(surface: &Surface, by: f64) -> Vec<Vector2<f64>> {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    surface
        .points()
        .iter()
        .map(|p| p.xy() + Vector2::new(rng.random_range(-by..by), rng.random_range(-by..by)))
        .collect()
}

fn with_energy(check: impl Fn(&mut MapEnergy, &Surface)) {
    let (surface, rows) = sheet();
    let all: Vec<u32> = (0..surface.len() as u32).collect();
    let control = Control::default();
    let pairs = Pairs::new(&rows, &all, &control).unwrap();
    let triangles = Triangles::new(&surface);
    let springs = Springs::new(triangles.corners().collect(), surface.len(), &control).unwrap();
    let shape = Shape { area: 2.0, scale: 1.1 };
    let bands = Bands { weights: [1.0, 0.5, 2.0], outliers: [0.2, 0.05] };
    check(
        &mut MapEnergy { pairs: &pairs, bands, triangles: &triangles, shape, stiffness: 0.2, springs: &springs },
        &surface,
    );
}

#[test]
fn the_gradient_is_that_of_the_energy() {
    with_energy(|energy, surface| {
        let uv = shaken(surface, 0.2);
        let control = Control::default();
        let (_, gradient) = energy.evaluate(&uv, &control).unwrap();
        for (vertex, axis) in [(0, 0), (11, 1), (100, 0), (211, 1), (surface.len() - 1, 0)] {
            let moved = |step: f64| {
                let mut uv = uv.clone();
                uv[vertex][axis] += step;
                energy.evaluate(&uv, &control).unwrap().0
            };
            let slope = (moved(1e-3) - moved(-1e-3)) / 2e-3;
            assert!(
                (slope - gradient[vertex][axis]).abs() < 1e-4 * gradient[vertex].norm() + 1e-6,
                "{slope} {}",
                gradient[vertex][axis]
            );
        }
    });
}

#[test]
fn a_plane_has_no_energy_and_descent_finds_it() {
    with_energy(|energy, surface| {
        let control = Control::default();
        energy.shape = Shape { area: 2.0, scale: 1.0 };
        let flat: Vec<_> = surface.points().iter().map(|p| p.xy()).collect();
        assert!(energy.evaluate(&flat, &control).unwrap().0.abs() < 1e-9);
        let mut uv = tutte::spread(surface, &flat, energy.triangles, energy.springs, &control).unwrap();
        let until = descent::Until { steps: 200, gain: 1e-9 };
        let run = descent::descend(energy, &mut uv, until, &control).unwrap();
        assert!(run.energies.windows(2).all(|two| two[1] <= two[0]), "{:?}", run.energies);
        assert_eq!(energy.triangles.folded(&uv), 0);
        let (energy, _) = energy.evaluate(&uv, &control).unwrap();
        assert!(energy < 1e-6, "{energy}");
    });
}
