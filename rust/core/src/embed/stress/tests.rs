use super::levels::Levels;
use super::*;
use crate::Error;
use crate::distortion::overlap::overlaps;
use crate::embed::classical::classical_scaling;
use crate::geodesic::bend::{Marking, is_bent, marked};
use crate::geodesic::graph::GeodesicGraph;
use crate::orient::map_area;
use crate::rows::{DistanceRows, Rows};
use crate::sources::Sources;
use crate::surface::{Surface, mesh::shapes};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// An area in mm² on which bands end at about 30 and 10 mm.
const AREA: f64 = 75_000.0;

fn sheet() -> (Surface, DistanceRows) {
    let surface = shapes::surface(shapes::sheet(20, 14));
    let rows = straight(&surface, (0..surface.len() as u32).step_by(7), 1.0);
    (surface, rows)
}

/// Returns the distances in the plane of the first two axes, multiplied by a factor.
fn straight(surface: &Surface, sources: impl Iterator<Item = u32>, times: f32) -> DistanceRows {
    let (sources, places): (Vec<u32>, _) = (sources.collect(), plan(surface));
    let row = |&a: &u32| places.iter().map(move |b| (a, b)).collect::<Vec<_>>();
    let distance = |(a, b): (u32, &Vector2<f64>)| marked((places[a as usize] - b).norm() as f32 * times, false);
    let data = sources.iter().flat_map(row).map(distance).collect();
    DistanceRows::new(sources, surface.len(), data)
}

/// Marks a third of the distances as those of bent paths.
fn partly_bent(rows: DistanceRows) -> DistanceRows {
    let (sources, columns) = (rows.sources().to_vec(), rows.columns());
    let data =
        (0..).zip(rows.into_data()).map(|(n, distance)| marked(distance, n % 3 == 0 && distance > 0.0)).collect();
    DistanceRows::new(sources, columns, data)
}

/// Returns the slope of an energy with respect to one coordinate.
fn slope(
    uv: &[Vector2<f64>], (vertex, axis): (usize, usize), step: f64, energy: impl Fn(&[Vector2<f64>]) -> f64,
) -> f64 {
    let moved = |by: f64| {
        let mut uv = uv.to_vec();
        uv[vertex][axis] += by;
        energy(&uv)
    };
    (moved(step) - moved(-step)) / (2.0 * step)
}

fn shaken(surface: &Surface, by: f64) -> Vec<Vector2<f64>> {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    plan(surface).iter().map(|p| p + Vector2::from_fn(|_, _| rng.random_range(-by..by))).collect()
}

fn with_energy(check: impl Fn(&mut MapEnergy, &Surface)) {
    let (surface, rows) = sheet();
    let all: Vec<u32> = (0..surface.len() as u32).collect();
    let control = Control::default();
    let pairs = Pairs::new(&rows, &all, AREA, &control).unwrap();
    let triangles = TriangleEnergy::new(&surface);
    let springs = Springs::new(triangles.corners().collect(), surface.len(), &control).unwrap();
    let shape = Shape { barrier: 0.3, area: 2.0, outlier: 0.4 };
    let bands = Bands { weights: [1.0, 0.5, 2.0], outliers: [0.2, 0.05] };
    let (pairs, triangles, springs) = (&pairs, &triangles, &springs);
    check(&mut MapEnergy { pairs, bands, triangles, shape, stiffness: 0.2, springs, outline: None }, &surface);
}

#[test]
fn the_gradient_is_that_of_the_energy() {
    with_energy(|energy, surface| {
        let uv = shaken(surface, 0.2);
        let control = Control::default();
        let (_, gradient) = energy.evaluate(&uv, &control).unwrap();
        for (vertex, axis) in [(0, 0), (11, 1), (100, 0), (211, 1), (surface.len() - 1, 0)] {
            let slope = slope(&uv, (vertex, axis), 1e-3, |uv| energy.evaluate(uv, &control).unwrap().0);
            let found = gradient[vertex][axis];
            assert!((slope - found).abs() < 1e-4 * gradient[vertex].norm() + 1e-6, "{slope} {found}");
        }
    });
}

#[test]
fn a_plane_has_no_energy_and_descent_finds_it() {
    with_energy(|energy, surface| {
        let control = Control::default();
        let flat = plan(surface);
        assert!(energy.evaluate(&flat, &control).unwrap().0.abs() < 1e-9);
        let mut uv = tutte::spread(surface, &flat, energy.triangles, energy.springs, &control).unwrap();
        let until = descent::Until { steps: 200, gain: 1e-9, enough: f64::NEG_INFINITY };
        let run = descent::descend(energy, &mut uv, until, &control).unwrap();
        assert!(run.energies.windows(2).all(|two| two[1] <= two[0]), "{:?}", run.energies);
        assert_eq!(energy.triangles.folded(&uv), 0);
        let (energy, _) = energy.evaluate(&uv, &control).unwrap();
        assert!(energy < 1e-6, "{energy}");
    });
}

#[test]
fn the_first_map_of_a_plate_with_a_hole_has_no_fold() {
    for (size, hole) in [(24, 8..16), (140, 4..136)] {
        // the second hole has more edges than holes that are filled
        let sheet = shapes::surface(shapes::sheet(size, size));
        let is_in = |f: usize| hole.contains(&(f / 2 / size)) && hole.contains(&(f / 2 % size));
        let plate = sheet.part(&(0..sheet.faces().len()).map(|f| !is_in(f)).collect::<Vec<_>>());
        let (triangles, control) = (TriangleEnergy::new(&plate), Control::default());
        let springs = Springs::new(triangles.corners().collect(), plate.len(), &control).unwrap();
        let uv = tutte::spread(&plate, &plan(&plate), &triangles, &springs, &control).unwrap();
        assert_eq!((triangles.folded(&uv), Outline::new(&plate).crossings(&uv, &control).unwrap()), (0, 0));
    }
}

#[test]
fn the_eigenvalues_are_those_of_the_hessian() {
    use nalgebra::{Matrix2, SMatrix, SVector};
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let shape = Shape { barrier: 0.02, area: 2.0, outlier: 0.2 };
    for _ in 0..200 {
        let jacobian = Matrix2::from_fn(|_, _| rng.random_range(-1.5..1.5));
        if jacobian.determinant() < 0.05 {
            continue;
        }
        let slopes = |jacobian: &Matrix2<f64>| {
            let [by_half, by_area] = shape.price(jacobian).slopes;
            let matrix = jacobian * by_half + triangles::cofactors(jacobian) * by_area;
            SVector::<f64, 4>::from_column_slice(matrix.as_slice())
        };
        let hessian = SMatrix::<f64, 4, 4>::from_columns(&[0, 1, 2, 3].map(|n| {
            let moved = |by: f64| {
                let mut moved = jacobian;
                moved[n] += by;
                slopes(&moved)
            };
            (moved(1e-5) - moved(-1e-5)) / 2e-5
        }));
        let mut expected = hessian.symmetric_eigenvalues().as_slice().to_vec();
        let mut found = shape.price(&jacobian).curvatures(&jacobian).to_vec();
        expected.sort_by(f64::total_cmp);
        found.sort_by(f64::total_cmp);
        let size = 1.0 + expected[3].abs().max(expected[0].abs());
        for (found, expected) in found.iter().zip(&expected) {
            assert!((found - expected).abs() < 1e-4 * size, "{found} {expected} of {jacobian}");
        }
    }
}

/// Computes the stress by its definition, in double precision.
fn plain_stress(rows: &DistanceRows, ends: [f32; 3], bands: &Bands, uv: &[Vector2<f64>]) -> f64 {
    let mut sums = [(0.0, 0usize); 3];
    for (n, &source) in rows.sources().iter().enumerate() {
        for (vertex, &distance) in rows.row(n).iter().enumerate().filter(|(_, distance)| **distance > 0.0) {
            let error = (uv[source as usize] - uv[vertex]).norm() / f64::from(distance) - 1.0;
            let error = if is_bent(distance) && error < 0.0 { 0.0 } else { error };
            let k = bands.outliers[usize::from(distance <= ends[1])];
            let outlying = 2.0 * k * k * ((1.0 + (error / k).powi(2)).sqrt() - 1.0);
            for (sum, end) in sums.iter_mut().zip(ends) {
                if distance <= end {
                    *sum = (sum.0 + outlying, sum.1 + 1);
                }
            }
        }
    }
    sums.iter().zip(bands.weights).map(|(&(sum, count), weight)| weight * sum / count as f64).sum()
}

#[test]
fn the_stress_is_what_its_definition_says() {
    let surface = shapes::surface(shapes::sheet(45, 9)); // with all three bands
    for (count, times) in [(5, 1.1), (16, 1.1), (33, 1.1), (33, 1.0)] {
        let rows = partly_bent(straight(&surface, (0..count).map(|n| n * surface.len() as u32 / count), times));
        let all: Vec<u32> = (0..surface.len() as u32).collect();
        let control = Control::default();
        let pairs = Pairs::new(&rows, &all, AREA, &control).unwrap();
        let bands = Bands { weights: [1.0, 4.0, 0.5], outliers: [0.3, 0.05] };
        let uv = shaken(&surface, 0.3);
        let found = pairs.add(&uv, &bands, &mut vec![Vector2::zeros(); uv.len()], &control).unwrap();
        let expected = plain_stress(&rows, pairs.ends, &bands, &uv);
        assert!((found - expected).abs() < 1e-5 * expected, "{found} {expected}");
    }
}

#[test]
fn without_outliers_the_energy_is_plain_and_next_to_a_fold_it_is_infinite() {
    let rest = nalgebra::Matrix2::new(1.1, 0.2, -0.1, 0.8);
    let plain = Shape { barrier: 0.4, area: 3.0, outlier: f64::INFINITY };
    let kept = Shape { outlier: 0.5, ..plain };
    let (phi, psi) = (plain.price(&rest).value, kept.price(&rest).value);
    assert!((psi - 0.5 * ((1.0 + 4.0 * phi).sqrt() - 1.0)).abs() < 1e-14);
    for shape in [plain, kept] {
        for height in [0.0, -1.0, 1e-200] {
            assert_eq!(shape.price(&nalgebra::Matrix2::new(1.0, 0.0, 0.0, height)).value, f64::INFINITY);
        }
        assert!(shape.price(&nalgebra::Matrix2::identity()).value.abs() < 1e-12);
    }
}

#[test]
fn the_energy_of_triangles_is_that_of_their_singular_values() {
    let surface = shapes::surface(shapes::sheet(6, 5));
    let triangles = TriangleEnergy::new(&surface);
    let uv = shaken(&surface, 0.15);
    let shape = Shape { barrier: 0.4, area: 3.0, outlier: 0.5 };
    let mut expected = 0.0;
    for face in surface.faces() {
        let [a, b, c] = face.map(|v| v as usize);
        let sides = |p: &dyn Fn(usize) -> Vector2<f64>| nalgebra::Matrix2::from_columns(&[p(b) - p(a), p(c) - p(a)]);
        let rest = sides(&|v| surface.points()[v].xy());
        let jacobian = sides(&|v| uv[v]) * rest.try_inverse().unwrap();
        let [s1, s2]: [f64; 2] = jacobian.singular_values().into();
        let dirichlet = 0.5 * (s1 * s1 + s2 * s2 + s1.powi(-2) + s2.powi(-2)) - 2.0;
        let rigid = 2.0 * ((s1 - 1.0).powi(2) + (s2 - 1.0).powi(2));
        let growth = (s1 * s2).ln().powi(2);
        let distortion = 0.6 * rigid + 0.4 * dirichlet + 3.0 * growth;
        expected += 0.5 * rest.determinant().abs() * 0.5 * ((1.0 + 4.0 * distortion).sqrt() - 1.0);
    }
    expected /= triangles.area;
    let found = triangles.add(&uv, shape, 1.0, &mut vec![Vector2::zeros(); uv.len()]);
    assert!((triangles.area - 30.0).abs() < 1e-12);
    assert!((found - expected).abs() < 1e-12 * expected, "{found} {expected}");
    assert!((triangles.energy(&uv, shape) - expected).abs() < 1e-12 * expected);
}

#[test]
fn the_factor_solves_what_the_springs_say() {
    let surface = shapes::surface(shapes::sheet(5, 4));
    let triangles = TriangleEnergy::new(&surface);
    let springs = Springs::new(triangles.corners().collect(), surface.len(), &Control::default()).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let entries: Vec<[f64; 3]> = triangles.corners().map(|_| [0; 3].map(|_| -rng.random_range(0.1..2.0))).collect();
    let ground: Vec<f64> = (0..surface.len()).map(|_| rng.random_range(0.0..0.1)).collect();
    let mut dense = nalgebra::DMatrix::from_diagonal(&nalgebra::DVector::from_vec(ground.clone()));
    for (corners, entries) in triangles.corners().zip(&entries) {
        for (entry, (a, b)) in entries.iter().zip([(0, 1), (0, 2), (1, 2)]) {
            let [a, b] = [corners[a] as usize, corners[b] as usize];
            dense[(a, b)] += entry;
            dense[(b, a)] += entry;
            dense[(a, a)] -= entry;
            dense[(b, b)] -= entry;
        }
    }
    let forces = shaken(&surface, 1.0);
    let moved = springs.factor(&entries, &ground).unwrap().solve(&forces);
    for axis in 0..2 {
        let balance = &dense * nalgebra::DVector::from_iterator(moved.len(), moved.iter().map(|by| by[axis]));
        assert!(balance.iter().zip(&forces).all(|(pull, force)| (pull - force[axis]).abs() < 1e-9));
    }
}

#[test]
fn a_step_ends_where_the_first_triangle_has_no_area() {
    let surface = shapes::surface(shapes::sheet(4, 4));
    let triangles = TriangleEnergy::new(&surface);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for _ in 0..50 {
        let uv = plan(&surface);
        let along: Vec<_> = uv.iter().map(|_| Vector2::from_fn(|_, _| rng.random_range(-1.0..1.0))).collect();
        let farthest = triangles.farthest_step(&uv, &along);
        let folded = |step: f64| {
            let moved: Vec<_> = uv.iter().zip(&along).map(|(place, by)| place + by * step).collect();
            triangles.folded(&moved)
        };
        assert!((0..100).all(|n| folded(farthest * f64::from(n) / 100.0 * 0.999) == 0));
        assert!(folded(farthest * 1.001) > 0);
    }
}

/// Returns a ribbon 2 mm wide around a circle of radius 6 mm, which rises so that it never meets itself.
fn ramp(degrees: f64) -> Surface {
    let steps = (degrees / 4.0) as usize;
    let (mut points, faces) = shapes::sheet(steps, 4);
    for point in &mut points {
        let (angle, radius) = (point[0] / steps as f64 * degrees.to_radians(), 6.0 + point[1] / 2.0);
        *point = [radius * angle.cos(), radius * angle.sin(), angle * 0.01];
    }
    shapes::surface((points, faces))
}

fn plan(surface: &Surface) -> Vec<Vector2<f64>> {
    surface.points().iter().map(|p| p.xy()).collect()
}

#[test]
fn the_outline_is_pushed_as_its_energy_says() {
    let surface = ramp(359.5); // the distance between the two ends is less than the gap
    let outline = outline::Outline::new(&surface);
    let uv = plan(&surface);
    let mut gradient = vec![Vector2::zeros(); uv.len()];
    let energy = outline.add(&uv, 2.0, &mut gradient);
    assert!(energy > 0.0);
    let mut pushed = 0;
    for vertex in 0..uv.len() {
        for axis in 0..2 {
            let energy = |uv: &[_]| outline.add(uv, 2.0, &mut vec![Vector2::zeros(); uv.len()]);
            let slope = slope(&uv, (vertex, axis), 1e-6, energy);
            assert!((slope - gradient[vertex][axis]).abs() < 1e-5 * (1.0 + slope.abs()), "{slope} {gradient:?}");
        }
        pushed += usize::from(gradient[vertex].norm() > 0.0);
    }
    assert!((10..=20).contains(&pushed), "{pushed}"); // the ends' vertices
    let far = plan(&ramp(300.0));
    assert_eq!(outline::Outline::new(&ramp(300.0)).add(&far, 1.0, &mut vec![Vector2::zeros(); far.len()]), 0.0);
}

#[test]
fn a_step_ends_where_the_outline_meets_itself() {
    let surface = ramp(340.0);
    let outline = outline::Outline::new(&surface);
    let control = Control::default();
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut met = 0;
    for _ in 0..30 {
        let uv = plan(&surface);
        let along: Vec<_> = uv.iter().map(|_| Vector2::from_fn(|_, _| rng.random_range(-1.0..1.0))).collect();
        let farthest = outline.farthest_step(&uv, &along, 10.0);
        let crossings = |step: f64| {
            let moved: Vec<_> = uv.iter().zip(&along).map(|(place, by)| place + by * step).collect();
            outline.crossings(&moved, &control).unwrap()
        };
        assert!((0..200).all(|n| crossings(farthest * f64::from(n) / 200.0) == 0));
        assert!(crossings(farthest * 1.0001) > 0);
        met += usize::from(farthest < 10.0);
    }
    assert_eq!(met, 30);
}

#[test]
fn parts_of_a_map_that_distances_draw_onto_each_other_stay_apart() {
    let surface = ramp(420.0);
    let sources: Vec<u32> = (0..surface.len() as u32).step_by(3).collect();
    let rows = straight(&surface, sources.iter().copied(), 1.0);
    let places: Vec<[f64; 2]> = sources.iter().map(|&v| plan(&surface)[v as usize].into()).collect();
    let control = Control::default();
    // the given map overlaps itself over 60 degrees
    let drawn: Vec<[f64; 2]> = plan(&surface).into_iter().map(Into::into).collect();
    assert!(overlaps(surface.faces(), &drawn, &control).unwrap().covering > 0);
    let mut levels = Levels::new(&surface, &sources, &control).unwrap();
    let (uv, _) = levels::flatten(&mut levels, &rows, &places, 0.5, &control).unwrap();
    let overlap = overlaps(surface.faces(), &uv, &control).unwrap();
    assert_eq!((overlap.crossings, overlap.covering), (0, 0));
    let uv: Vec<_> = uv.into_iter().map(Into::into).collect();
    assert_eq!(TriangleEnergy::new(&surface).folded(&uv), 0);
}

#[test]
fn a_bound_on_areas_has_the_gradient_of_its_price() {
    let surface = shapes::surface(shapes::sheet(6, 5));
    let mut triangles = TriangleEnergy::new(&surface);
    triangles.bound = Some(triangles::AreaBound { mean: 0.1, most: 0.2, weight: 3.0 });
    let uv = shaken(&surface, 0.2);
    let shape = Shape { barrier: 0.4, area: 3.0, outlier: 0.5 };
    let [mean, most] = triangles.area_change(&uv);
    assert!(mean.abs() < 0.2 && most > 0.3, "{mean} {most}");
    let energy = |uv: &[Vector2<f64>]| triangles.add(uv, shape, 2.0, &mut vec![Vector2::zeros(); uv.len()]);
    let mut gradient = vec![Vector2::zeros(); uv.len()];
    triangles.add(&uv, shape, 2.0, &mut gradient);
    for (vertex, axis) in [(0, 0), (8, 1), (17, 0), (30, 1)] {
        let slope = slope(&uv, (vertex, axis), 1e-6, energy);
        assert!((slope - gradient[vertex][axis]).abs() < 1e-6 * gradient[vertex].norm(), "{slope} {gradient:?}");
    }
}

#[test]
fn a_start_that_is_none_is_refused() {
    let (surface, rows) = sheet();
    let control = Control::default();
    let mut levels = Levels::new(&surface, rows.sources(), &control).unwrap();
    let mut from = |places: &[[f64; 2]]| {
        start::flatten_from(&mut levels, &rows, start::Start { places, patience: 1 }, 0.5, &control).err()
    };
    let mut places: Vec<[f64; 2]> = plan(&surface).into_iter().map(Into::into).collect();
    assert_eq!(from(&places[1..]), Some(Error::StartMismatch { places: surface.len() - 1, points: surface.len() }));
    let line: Vec<[f64; 2]> = places.iter().map(|&[x, _]| [x, 0.0]).collect();
    assert_eq!(from(&line), Some(Error::StartStuck));
    places[5][1] = f64::INFINITY;
    assert_eq!(from(&places), Some(Error::StartNotFinite { vertex: 5 }));
}

#[test]
fn vertices_are_held_as_their_pairs_bend_upwards() {
    let surface = shapes::surface(shapes::sheet(45, 9)); // with all three bands
    let (source, others) = (7, surface.len());
    let rows = partly_bent(straight(&surface, [source as u32].into_iter(), 1.1));
    let all: Vec<u32> = (0..others as u32).collect();
    let pairs = Pairs::new(&rows, &all, AREA, &Control::default()).unwrap();
    let bands = Bands { weights: [1.0, 4.0, 0.5], outliers: [0.3, 0.05] };
    let uv = shaken(&surface, 0.3);
    let mut held = vec![0.0; others];
    pairs.add_curvature(&uv, &bands, &mut held);
    let mut sum = 0.0;
    for vertex in (0..others).filter(|&vertex| vertex != source) {
        // with one source, a vertex is in one pair, whose curvatures are the eigenvalues of the Hessian
        let stress = |by: Vector2<f64>| {
            let mut moved = uv.clone();
            moved[vertex] += by;
            plain_stress(&rows, pairs.ends, &bands, &moved)
        };
        let step = 1e-4;
        let along = (uv[vertex] - uv[source]).normalize() * step;
        let across = Vector2::new(-along.y, along.x);
        let bend = |by: Vector2<f64>| (stress(by) - 2.0 * stress(Vector2::zeros()) + stress(-by)) / (step * step);
        let expected = (bend(along).max(0.0) + bend(across).max(0.0)) / 16.0;
        assert!((held[vertex] - expected).abs() < 1e-3 * expected + 1e-7, "{vertex}: {} {expected}", held[vertex]);
        sum += held[vertex];
    }
    assert!((held[source] - sum).abs() < 1e-9 * sum);
}

#[test]
fn distances_to_landmarks_give_the_places_of_a_plane() {
    let surface = shapes::surface(shapes::sheet(9, 6));
    let rows = straight(&surface, [3u32, 20, 41, 66].into_iter(), 1.0);
    let all: Vec<u32> = (0..surface.len() as u32).collect();
    let pairs = Pairs::new(&rows, &all, AREA, &Control::default()).unwrap();
    let places: Vec<[f64; 2]> = rows.sources().iter().map(|&v| plan(&surface)[v as usize].into()).collect();
    let found = pairs.landmark_places(&places, surface.len());
    assert!(found.iter().zip(plan(&surface)).all(|(found, place)| (found - place).norm() < 1e-5));
}

#[test]
fn a_bound_on_areas_is_kept_by_every_triangle() {
    let sphere = shapes::surface(shapes::sphere(4));
    let cap = sphere.part_of_vertices(&sphere.points().iter().map(|p| p.z > -0.2).collect::<Vec<_>>()).unwrap();
    let cap = cap.moved(cap.points().iter().map(|p| p * 20.0).collect()).unwrap();
    let control = Control::default();
    let graph = GeodesicGraph::new(&cap, &control).unwrap();
    let sources = Sources::Farthest { count: 30, seed: 0 }.choose(&graph, &control).unwrap();
    let mut levels = Levels::new(&cap, &sources, &control).unwrap();
    let rows = levels.measure(&Marking::new(&graph), &control).unwrap().into_rows();
    let places = classical_scaling(&rows.among(&control).unwrap()).unwrap().places;
    let (free, _) = levels::flatten(&mut levels, &rows, &places, 0.5, &control).unwrap();
    let change = |uv: &[[f64; 2]]| {
        let area = |face: &[u32; 3], uv: &[[f64; 2]]| map_area(&[*face], uv);
        let areas: Vec<[f64; 2]> = cap.faces().iter().zip(cap.areas()).map(|(f, own)| [area(f, uv), own]).collect();
        let total = areas.iter().fold([0.0, 0.0], |sum, of| [sum[0] + of[0], sum[1] + of[1]]);
        let logs = areas.iter().map(|[flat, own]| (flat / own / (total[0] / total[1])).ln().abs());
        logs.fold(0.0, f64::max).exp()
    };
    for bound in [1.4, 1.2] {
        let (uv, found) = area_bound::bounded(&levels, &rows, &free, 0.5, bound, &control).unwrap();
        assert!(found.converged && change(&free) > bound, "{bound} {}", change(&free));
        assert!(change(&uv) <= bound * (1.0 + 1e-9), "{bound} {}", change(&uv));
    }
}

#[test]
fn the_weighting_multiplies_near_distances_and_shapes_by_10_to_a_tenth() {
    for (weighting, factor) in [(0.0, 10.0), (0.25, 10f64.sqrt()), (0.5, 1.0), (1.0, 0.1)] {
        let (found, usual) = (levels::weighted(weighting), levels::FINAL);
        let near = |(a, b): (f64, f64)| assert!((a / b / factor - 1.0).abs() < 1e-12, "{weighting} {a} {b}");
        let [all, thirty, ten] = found.bands.weights;
        near((thirty, usual.bands.weights[1]));
        near((ten, usual.bands.weights[2]));
        near((found.stiffness, usual.stiffness));
        assert_eq!((all, found.bands.outliers, found.shape), (1.0, usual.bands.outliers, usual.shape));
    }
}

#[test]
fn more_steps_would_hardly_lower_the_energy() {
    let sphere = shapes::surface(shapes::sphere(4));
    let cap = sphere.part_of_vertices(&sphere.points().iter().map(|p| p.z > -0.85).collect::<Vec<_>>()).unwrap();
    let cap = cap.moved(cap.points().iter().map(|p| p * 20.0).collect()).unwrap();
    let control = Control::default();
    let graph = GeodesicGraph::new(&cap, &control).unwrap();
    let sources = Sources::Farthest { count: 30, seed: 0 }.choose(&graph, &control).unwrap();
    let last = |patience: u32| {
        let mut levels = Levels::new(&cap, &sources, &control).unwrap();
        let rows = levels.measure(&Marking::new(&graph), &control).unwrap().into_rows();
        let places = classical_scaling(&rows.among(&control).unwrap()).unwrap().places;
        let dials = levels::Dials { patience, ..levels::FINAL };
        let (_, found) = levels::unfold(&mut levels, &rows, &places, dials, &control).unwrap();
        found.energies[found.energies.len() - 1]
    };
    let [usual, patient] = [1, 20].map(last);
    assert!(patient <= usual && usual < 1.001 * patient, "{usual} {patient}");
}

#[test]
fn thin_triangles_keep_their_area_unless_a_few_are_thinner_than_a_ten_thousandth() {
    let area = |place: &dyn Fn(f64) -> f64| {
        let sheet = shapes::surface(shapes::sheet(10, 10));
        let sheet = sheet.moved(sheet.points().iter().map(|p| [p.x, place(p.y), 0.0].into()).collect()).unwrap();
        TriangleEnergy::new(&sheet).area
    };
    // one of ten rows is thin; its longest sides are the diagonals
    let with_row = |height: f64| area(&|y| if y < 1.0 { 1.0 - height } else { y });
    let (thin, thinner) = (with_row(0.01), with_row(1e-5));
    assert!((thin - 90.0 - 0.1).abs() < 1e-9, "{thin}");
    assert!((thinner - 90.0 - 20.0 * 0.5 * 1e-4 * (1.0 + 1e-10)).abs() < 1e-9, "{thinner}");
    // if many are thinner, they stay as they are
    let all = area(&|y| 1e-5 * y);
    assert!((all - 0.001).abs() < 1e-12, "{all}");
}
