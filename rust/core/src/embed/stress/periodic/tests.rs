use super::*;
use crate::geodesic::exact::Exact;
use crate::sources::random;
use crate::surface::cuts::cut;
use crate::surface::mesh::shapes;
use crate::tests::with_threads;
use std::f64::consts::TAU;

const AROUND: usize = 24;
const ALONG: usize = 16;

/// Returns a tube whose axis is x, with the radius at each of its rings, and the vertices along a straight seam.
fn tube(radius: impl Fn(usize) -> f64) -> (Surface, Vec<u32>) {
    let place = |i: usize, j: usize| {
        // rings are turned against each other, so that no edge of the seam is parallel to the axis
        let angle = TAU * (j as f64 - 0.5 * i as f64) / AROUND as f64;
        [0.5 * i as f64, radius(i) * angle.cos(), radius(i) * angle.sin()]
    };
    let points = (0..=ALONG).flat_map(|i| (0..AROUND).map(move |j| (i, j))).map(|(i, j)| place(i, j)).collect();
    let faces = shapes::grid_faces(ALONG, AROUND, |i, j| i * AROUND + j % AROUND);
    let seam = (0..=ALONG).map(|i| (i * AROUND + i / 2) as u32).collect();
    (shapes::surface((points, faces)), seam)
}

/// Returns the map of a tube, its period, and the last energy.
fn flat(closed: &Surface, seam: &[u32]) -> (Surface, Vec<[f64; 2]>, f64, f64) {
    let control = Control::default();
    let opened = cut(closed, &[seam.to_vec()]).unwrap();
    let tube = Tube::new(closed, &opened, seam).unwrap();
    let landmarks = random(closed.len(), 60, 1);
    let evaluated = tube.evaluated(&landmarks, usize::MAX);
    let rows = DistanceRows::compute(&Exact::new(closed), &landmarks, &control).unwrap();
    let (uv, period, found) = flatten_tube(&tube, &rows, &evaluated, 0.5, &control).unwrap();
    let sides = tube.copies.clone();
    for (n, (&of, turns)) in sides.of.iter().zip(&sides.turns).enumerate() {
        let twin = sides.of.iter().position(|&other| other == of).unwrap();
        let apart = [uv[n][0] - uv[twin][0], uv[n][1] - uv[twin][1]];
        assert_eq!(apart[0], 0.0);
        assert!((apart[1] - (turns - sides.turns[twin]) * period).abs() < 1e-12 * period, "{apart:?} {period}");
    }
    let places: Vec<Place> = uv.iter().map(|&place| place.into()).collect();
    assert_eq!(TriangleEnergy::new(&opened).folded(&places), 0);
    (opened, uv, period, *found.energies.last().unwrap())
}

#[test]
fn a_cylinder_is_unrolled() {
    let (closed, seam) = tube(|_| 2.0);
    let (opened, uv, period, energy) = flat(&closed, &seam);
    let round = AROUND as f64 * 4.0 * (0.5 * TAU / AROUND as f64).sin(); // of the polygon
    assert!((period / round - 1.0).abs() < 0.01, "{period} {round}");
    assert!(energy < 1e-3, "{energy}");
    let along: Vec<f64> = opened.points().iter().map(|point| point.x).collect();
    let start = uv.iter().zip(&along).map(|(place, x)| place[0] - x).sum::<f64>() / uv.len() as f64;
    for (place, x) in uv.iter().zip(&along) {
        assert!((place[0] - x - start).abs() < 0.1, "{place:?} {x}");
    }
}
