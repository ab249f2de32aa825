use super::*;
use crate::Error;
use crate::surface::mesh::shapes;
use crate::tests::flipped as turned_over;

fn cylinder() -> Surface {
    crate::tests::curled(16, 24)
}

fn flattened(surface: &Surface, rings: Option<u32>, sources: &[u32], starts: u32, seed: u64) -> Result<Mapped> {
    let control = Control::default();
    let options = Options { rings, sources, starts, seed, bands: Bands::default(), keep_rows: false };
    schwartz1989(surface, &GeodesicGraph::new(surface, &control)?, &options, &control)
}

fn evenly(surface: &Surface, step: usize) -> Vec<u32> {
    (0..surface.len() as u32).step_by(step).collect()
}

#[test]
fn a_cylinder_is_unrolled_whatever_the_neighbourhood() {
    let surface = cylinder();
    let sources = evenly(&surface, 9);
    for (rings, sources) in [(None, &[][..]), (Some(4), &sources), (Some(1), &sources)] {
        let Mapped { map, stresses, pairs } = flattened(&surface, rings, sources, 2, 4).unwrap();
        assert!(map.distortion.raw.relative_error < 0.01, "{rings:?}: {}", map.distortion.raw.relative_error);
        assert_eq!(turned_over(&surface, &map.uv), 0);
        assert_eq!(stresses.len(), 2);
        let convergence = map.convergence.unwrap();
        let least = convergence.energies.iter().copied().fold(f64::INFINITY, f64::min);
        assert!(convergence.converged && least == stresses[0].min(stresses[1]));
        assert_eq!(map.sources, sources);
        assert_eq!(map.eigenvalues.is_empty(), sources.is_empty());
        assert!(sources.is_empty() || map.planarity > 0.999);
        assert!(rings.is_some() || pairs == surface.len() * (surface.len() - 1) / 2);
    }
}

#[test]
fn short_distances_alone_fold() {
    let surface = cylinder();
    let short = flattened(&surface, Some(1), &[], 3, 0).unwrap();
    assert!(short.map.distortion.raw.relative_error > 0.1);
    assert!(turned_over(&surface, &short.map.uv) > surface.faces().len() / 20);
}

#[test]
fn a_map_is_seen_from_outside_whatever_the_start() {
    let sphere = shapes::surface(shapes::sphere(3));
    let upper: Vec<bool> = sphere.points().iter().map(|p| p.z >= -1e-9).collect();
    let half = sphere.part_of_vertices(&upper).unwrap();
    for seed in 0..6 {
        let found = flattened(&half, None, &[], 1, seed).unwrap();
        assert!(map_area(half.faces(), &found.map.uv) > 0.0);
        assert_eq!(turned_over(&half, &found.map.uv), 0);
    }
}

#[test]
fn usual_neighbourhoods_hold_a_tenth_and_a_hundred() {
    let control = Control::default();
    let enough = |surface: &Surface, wanted: f64| {
        let rings = usual_rings(surface, &control).unwrap();
        let sizes = sizes_of_rings(surface, None, &control).unwrap();
        assert!(sizes[rings as usize - 1] >= wanted);
        assert!(rings == 1 || sizes[rings as usize - 2] < wanted);
    };
    let large = shapes::surface(shapes::sheet(69, 29)); // estimated from a sample
    enough(&large, 210.0);
    enough(&cylinder(), 100.0);
    let long = shapes::surface(shapes::sheet(300, 1)); // a hundred vertices are far away
    enough(&long, 100.0);
    let small = shapes::surface(shapes::sheet(3, 2));
    enough(&small, 12.0);
}

#[test]
fn what_cannot_be_flattened_is_refused() {
    let closed = shapes::surface(shapes::sphere(2));
    assert!(matches!(flattened(&closed, Some(3), &[], 1, 0).unwrap_err(), Error::NotADisk { .. }));
    let surface = cylinder();
    let points = surface.len();
    let refused = |sources| flattened(&surface, Some(3), sources, 1, 0).unwrap_err();
    assert_eq!(refused(&[425]), Error::NoSuchPoint { vertex: 425, points });
    assert_eq!(refused(&[4, 5, 4]), Error::DuplicateSource { vertex: 4 });
}
