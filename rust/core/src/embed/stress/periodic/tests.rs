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
    let start = uv.iter().zip(&along).map(|(place, x)| place[0] - x).sum::<f64>() / uv.len() as f64; // left to right
    for (place, x) in uv.iter().zip(&along) {
        assert!((place[0] - x - start).abs() < 0.1, "{place:?} {x}");
    }
}

/// Returns a tube that bends by a right angle and becomes wider.
fn horn() -> (Surface, Vec<u32>) {
    let (straight, seam) = tube(|i| 1.5 + 0.5 * i as f64 / ALONG as f64);
    let bend = |p: &nalgebra::Vector3<f64>| {
        let angle = p.x / (0.5 * ALONG as f64) * TAU / 4.0;
        nalgebra::Vector3::new((5.0 + p.y) * angle.sin(), (5.0 + p.y) * angle.cos(), p.z)
    };
    (straight.moved(straight.points().iter().map(bend).collect()).unwrap(), seam)
}

#[test]
fn a_bent_tube_has_no_folds_and_the_same_map_with_any_number_of_threads() {
    let (closed, seam) = horn();
    let found = with_threads(1, || flat(&closed, &seam));
    assert!((TAU * 1.5..TAU * 2.0).contains(&found.2), "{}", found.2);
    let again = with_threads(3, || flat(&closed, &seam));
    assert_eq!((found.1, found.2), (again.1, again.2));
}

#[test]
fn the_map_does_not_depend_on_the_seam() {
    let (closed, seam) = horn();
    let (_, uv, period, energy) = flat(&closed, &seam);
    // a seam that winds around half of the tube
    let winding: Vec<u32> = (0..=ALONG).map(|i| (i * AROUND + (i + 5) % AROUND) as u32).collect();
    let (_, wound, other, reached) = flat(&closed, &winding);
    assert!((period / other - 1.0).abs() < 1e-3, "{period} {other}");
    assert!((energy / reached - 1.0).abs() < 1e-2, "{energy} {reached}");
    let length = |uv: &[[f64; 2]]| {
        let along = || uv.iter().map(|place| place[0]);
        along().fold(0.0, f64::max) - along().fold(f64::INFINITY, f64::min)
    };
    assert!((length(&uv) / length(&wound) - 1.0).abs() < 0.01);
}

#[test]
fn the_gradient_is_that_of_the_energy_also_for_the_period() {
    let (closed, seam) = horn();
    let control = Control::default();
    let opened = cut(&closed, std::slice::from_ref(&seam)).unwrap();
    let tube = Tube::new(&closed, &opened, &seam).unwrap();
    let landmarks = random(closed.len(), 40, 1);
    let evaluated = tube.evaluated(&landmarks, usize::MAX);
    let rows = DistanceRows::compute(&Exact::new(&closed), &landmarks, &control).unwrap();
    let compared: Vec<u32> = evaluated.iter().map(|&vertex| tube.first_copies()[vertex as usize]).collect();
    let pairs = Pairs::new(&rows, &compared, opened.area(), &control).unwrap();
    let triangles = TriangleEnergy::new(&opened);
    let corners = triangles.corners().map(|corners| corners.map(|copy| tube.vertices()[copy as usize])).collect();
    let springs = Springs::new(corners, closed.len(), &control).unwrap();
    let (outline, copies) = tube.outline();
    let turns = tube.turns(&triangles);
    let dials = Dials { bands: crate::embed::stress::Bands { weights: [1.0, 0.5, 2.0], outliers: [0.2; 2] }, ..FIRST };
    let energy = TubeEnergy {
        pairs: &pairs,
        dials,
        triangles: &triangles,
        springs: &springs,
        turns: &turns,
        outline: &outline,
        copies: &copies,
        opened: opened.len(),
    };
    let places = tube.spread(tube.length(&rows, &evaluated), &triangles, &springs, &control).unwrap();
    let (_, gradient) = energy.evaluate(&places, &control).unwrap();
    assert_eq!(gradient[closed.len()].x, 0.0);
    let at = |vertex: usize, axis: usize, by: f64| {
        let mut moved = places.clone();
        moved[vertex][axis] += by;
        energy.evaluate(&moved, &control).unwrap().0
    };
    for (vertex, axis) in [(0, 0), (0, 1), (24, 1), (130, 0), (200, 1), (closed.len() - 1, 1), (closed.len(), 1)] {
        let slope = (at(vertex, axis, 1e-3) - at(vertex, axis, -1e-3)) / 2e-3;
        let found = gradient[vertex][axis];
        assert!((slope - found).abs() < 2e-3 * gradient[vertex].norm() + 1e-4, "{vertex} {slope} {found}");
    }
    // the springs' direction leads downhill, and the period follows it
    let factor = energy.factor(&places).unwrap();
    let along = factor.solve(&gradient);
    let slope: f64 = along.iter().zip(&gradient).map(|(a, b)| a.dot(b)).sum();
    assert!(slope > 0.0 && along.len() == places.len(), "{slope}");
}

#[test]
fn the_factor_with_a_period_solves_its_equations() {
    let (closed, seam) = tube(|_| 2.0);
    let opened = cut(&closed, std::slice::from_ref(&seam)).unwrap();
    let tube = Tube::new(&closed, &opened, &seam).unwrap();
    let triangles = TriangleEnergy::new(&opened);
    let corners = triangles.corners().map(|corners| corners.map(|copy| tube.vertices()[copy as usize])).collect();
    let springs = Springs::new(corners, closed.len(), &Control::default()).unwrap();
    let (turns, count) = (tube.turns(&triangles), closed.len());
    let stiffness: Vec<[f64; 3]> = (0..turns.len()).map(|n| [-1.0 - (n % 3) as f64, -0.5, -0.7]).collect();
    let ground: Vec<f64> = (0..count).map(|n| 0.1 + 0.01 * (n % 7) as f64).collect();
    let forces: Vec<Place> =
        (0..=count).map(|n| Vector2::new(if n == count { 0.0 } else { 1.0 }, (n % 5) as f64 - 2.0)).collect();
    let found = springs.factor_with_period(&stiffness, &ground, &turns).unwrap().solve(&forces);
    // the same sums, spring by spring over the copies
    let uv = tube.copies.positions(&found);
    let mut sums = vec![Vector2::zeros(); uv.len()];
    for (corners, entries) in triangles.corners().zip(&stiffness) {
        for (&entry, (a, b)) in entries.iter().zip([(0, 1), (0, 2), (1, 2)]) {
            let force = -entry * (uv[corners[a] as usize] - uv[corners[b] as usize]);
            sums[corners[a] as usize] += force;
            sums[corners[b] as usize] -= force;
        }
    }
    let mut sums = tube.copies.gather(&sums, count + 1);
    sums.iter_mut().zip(&found).zip(&ground).for_each(|((sum, place), ground)| *sum += place * *ground);
    for (sum, force) in sums.iter().zip(&forces) {
        assert!((sum - force).norm() < 1e-8, "{sum} {force}");
    }
}

#[test]
fn what_is_not_a_tube_is_refused() {
    let sheet = shapes::surface(shapes::sheet(4, 4));
    assert!(matches!(Tube::new(&sheet, &sheet, &[0, 1]), Err(Error::NotATube { loops: 1 })));
    let (closed, seam) = tube(|_| 2.0);
    assert!(Tube::new(&closed, &closed, &seam).is_err());
    let opened = cut(&closed, std::slice::from_ref(&seam)).unwrap();
    assert!(Tube::new(&closed, &opened, &seam[1..]).is_err());
}
