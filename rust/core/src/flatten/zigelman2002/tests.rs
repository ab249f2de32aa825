use super::*;
use crate::surface::mesh::shapes;

const SIDES: [usize; 2] = [40, 60];

fn cylinder() -> Surface {
    crate::tests::curled(SIDES[0], SIDES[1])
}

fn pixels() -> Vec<[u32; 2]> {
    (0..=SIDES[0] as u32).flat_map(|i| (0..=SIDES[1] as u32).map(move |j| [i, j])).collect()
}

fn flattened(surface: &Surface, sampling: &Sampling<'_>, wave: Wave) -> Result<FlatMap> {
    let control = Control::default();
    zigelman2002(
        surface,
        &GeodesicGraph::new(surface, &control)?,
        sampling,
        wave,
        Evaluation { seed: 1, ..Evaluation::default() },
        false,
        &control,
    )
}

/// Returns the mean relative error of distances between some vertices of the unrolled cylinder.
fn error(uv: &[[f64; 2]]) -> f64 {
    let pixels = pixels();
    let apart = |[a, b]: [f64; 2], [c, d]: [f64; 2]| (a - c).hypot(b - d);
    let chosen: Vec<usize> = (0..uv.len()).step_by(29).collect();
    let pairs = chosen.iter().flat_map(|&a| chosen.iter().map(move |&b| (a, b))).filter(|(a, b)| a < b);
    let errors =
        pairs.map(|(a, b)| apart(uv[a], uv[b]) / apart(pixels[a].map(f64::from), pixels[b].map(f64::from)) - 1.0);
    let errors: Vec<f64> = errors.map(f64::abs).collect();
    errors.iter().sum::<f64>() / errors.len() as f64
}

#[test]
fn a_cylinder_is_unrolled_whatever_the_sources() {
    let surface = cylinder();
    let pixels = pixels();
    let evenly: Vec<u32> = (0..surface.len() as u32).step_by(17).collect();
    for (sampling, most) in [
        (Sampling::Decimation { count: 150 }, 0.005),
        (Sampling::Vertices(&evenly), 0.005),
        (Sampling::Grid { pixels: &pixels, spacing: [1.0, 1.0], count: 150 }, 0.002),
    ] {
        let map = flattened(&surface, &sampling, Wave::Circle).unwrap();
        let found = error(&map.uv);
        assert!(found < most, "{sampling:?}: {found}");
        assert!(map.planarity > 0.999);
        assert_eq!(crate::tests::flipped(&surface, &map.uv), 0);
    }
}

#[test]
fn circles_measure_better_than_straight_fronts() {
    let surface = cylinder();
    let of = |wave| error(&flattened(&surface, &Sampling::Decimation { count: 150 }, wave).unwrap().uv);
    assert!(of(Wave::Circle) < of(Wave::Plane));
}

#[test]
fn given_sources_come_first_and_decimation_keeps_to_its_number() {
    let surface = cylinder();
    let given = [700, 3, 2400, 90, 1200];
    let map = flattened(&surface, &Sampling::Vertices(&given), Wave::Circle).unwrap();
    assert_eq!(map.sources[..5], given);
    let map = flattened(&surface, &Sampling::Decimation { count: 77 }, Wave::Circle).unwrap();
    assert_eq!(map.sources.len(), 77);
}

#[test]
fn what_cannot_be_flattened_is_refused() {
    let surface = cylinder();
    let points = surface.len();
    let refused = |sampling| flattened(&surface, &sampling, Wave::Circle).unwrap_err();
    assert_eq!(refused(Sampling::Decimation { count: 2 }), Error::TooFewSources { sources: 2, needed: 3 });
    let sources = points + 1;
    assert_eq!(refused(Sampling::Decimation { count: sources }), Error::TooManySources { sources, points });
    assert_eq!(refused(Sampling::Vertices(&[1, 2, 1, 5])), Error::DuplicateSource { vertex: 1 });
    let sphere = shapes::surface(shapes::sphere(3));
    let closed = flattened(&sphere, &Sampling::Decimation { count: 50 }, Wave::Circle).unwrap_err();
    assert!(matches!(closed, Error::NotADisk { .. }));
}
