//! Small inputs of any kind and size give a valid map or an error, never a panic.
//!
//! `VOXFLAT_CASES=100000 cargo test --release --test hostile` runs 100,000 cases of each test.

use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

use proptest::prelude::*;
use voxflat::atlas::glue::glue;
use voxflat::distortion::{evaluate::evaluate_all, faces::measure_faces};
use voxflat::embed::stress::levels::Levels;
use voxflat::flatten::{self, FlatMap, grossmann2002, saucan2006, schwartz1989, voxflat::Options, zigelman2002};
use voxflat::geodesic::bend::Marking;
use voxflat::geodesic::marching::{Marching, Wave};
use voxflat::geodesic::neighbourhood::Neighbourhoods;
use voxflat::geodesic::{Solver, chain::LinkLengths, exact::Exact, graph::GeodesicGraph, shortest::trace_path};
use voxflat::orient::turn_onto;
use voxflat::patch::{self, Selection, cut_out};
use voxflat::rows::DistanceRows;
use voxflat::scales::{FARTHEST, SMALLEST};
use voxflat::sources::{Sources, cells};
use voxflat::sphere::{map::flipped, register::Template, register::register};
use voxflat::surface::cuts::open_to_disk;
use voxflat::surface::mesh::paths::{path_to_any, shortest_path};
use voxflat::surface::mesh::vertex_normals;
use voxflat::surface::voxels::repair::to_genus_zero;
use voxflat::surface::voxels::voxelmesh::VoxelMesh;
use voxflat::surface::{Surface, VoxelSurface};
use voxflat::volume::{Affine, Mask};
use voxflat::{Control, Error, Result};

#[path = "../src/surface/mesh/shapes.rs"]
mod shapes;

fn cases(usual: u32) -> ProptestConfig {
    let cases = std::env::var("VOXFLAT_CASES").ok().and_then(|text| text.parse().ok()).unwrap_or(usual);
    ProptestConfig { cases, max_global_rejects: 1 << 20, failure_persistence: None, ..ProptestConfig::default() }
}

/// Runs work that should be fast; it is cancelled after 20 s, which is a failure.
fn watched(
    work: impl FnOnce(&Control) -> std::result::Result<(), TestCaseError>,
) -> std::result::Result<(), TestCaseError> {
    let control = Control::default();
    let (done, wait) = channel::<()>();
    let hung = std::thread::scope(|scope| {
        let watching = &control;
        let watch = scope.spawn(move || {
            let hung = wait.recv_timeout(Duration::from_secs(20)) == Err(RecvTimeoutError::Timeout);
            if hung {
                watching.cancel();
            }
            hung
        });
        let found = work(&control);
        drop(done);
        found.map(|()| watch.join().expect("it only waits"))
    })?;
    prop_assert!(!hung, "it took more than 20 s");
    Ok(())
}

type Soup = (Vec<[f64; 3]>, Vec<[i64; 3]>);

/// Generates coordinates: small integers, so that points coincide; ordinary, tiny and huge numbers; rarely NaN.
fn coordinate() -> impl Strategy<Value = f64> {
    prop_oneof![
        8 => (0..4).prop_map(f64::from),
        6 => -3.0..3.0,
        2 => (-1.0..1.0, -40..30).prop_map(|(x, power): (f64, i32)| x * 10f64.powi(power)),
        1 => prop::sample::select(vec![0.0, -0.0, 1e19, 1e107, -1e300, 1e-300, f64::MIN_POSITIVE, f64::NAN, f64::INFINITY]),
    ]
}

/// Generates arbitrary triangles.
fn soup() -> impl Strategy<Value = Soup> {
    (3usize..12).prop_flat_map(|count| {
        let faces = prop::collection::vec(prop::array::uniform3(-1..count as i64 + 1), 0..24);
        (prop::collection::vec(prop::array::uniform3(coordinate()), count), faces)
    })
}

/// Generates sheets, balls and rings, some of whose vertices are displaced, and some of whose triangles are removed,
/// reversed or duplicated.
fn spoiled() -> impl Strategy<Value = Soup> {
    let whole = prop::sample::select(vec![0, 1, 2]).prop_map(|kind| match kind {
        0 => shapes::sheet(5, 4),
        1 => shapes::sphere(1),
        _ => shapes::torus(6, 4),
    });
    let places = prop::collection::vec((any::<prop::sample::Index>(), prop::array::uniform3(coordinate())), 0..4);
    let gone = prop::collection::vec((any::<prop::sample::Index>(), 0..5), 0..6);
    (whole, places, gone, -9..10).prop_map(|((mut points, mut faces), places, gone, power)| {
        let size = 10f64.powi(power);
        points.iter_mut().flatten().for_each(|x| *x *= size);
        places.into_iter().for_each(|(at, place)| *at.get_mut(&mut points) = place.map(|x| size * x));
        for (at, how) in gone {
            let n = at.index(faces.len());
            match how {
                0 => drop(faces.swap_remove(n)),
                1 => faces[n].swap(0, 1),
                2 => faces.push(faces[n]),
                3 => faces[n][0] = faces[n][1],
                _ => faces[n][2] = faces[0][0],
            }
        }
        (points, faces)
    })
}

fn default_map(surface: &Surface, graph: &GeodesicGraph, weighting: f64, control: &Control) -> Result<FlatMap> {
    let count = 8.min(surface.len());
    let sources = Sources::Farthest { count, seed: 0 }.choose(graph, control)?;
    let levels = Levels::new(surface, &sources, control)?;
    let rows = levels.measure(&Marking::new(graph), control)?;
    flatten::voxflat(levels, rows, &Options { weighting, ..Options::default() }, graph, Default::default(), control)
}

fn all_maps(surface: &Surface, control: &Control) -> Result<Vec<Result<FlatMap>>> {
    let graph = GeodesicGraph::new(surface, control)?;
    let options = schwartz1989::Options {
        rings: Some(2),
        sources: &[0],
        starts: 1,
        seed: 0,
        bands: Default::default(),
        keep_rows: false,
    };
    let sampling = zigelman2002::Sampling::Decimation { count: 6 };
    Ok(vec![
        default_map(surface, &graph, 0.5, control),
        flatten::zigelman2002(surface, &graph, &sampling, Wave::Circle, Default::default(), false, control),
        flatten::schwartz1989(surface, &graph, &options, control).map(|mapped| mapped.map),
        saucan2006(surface, 2.0, Default::default(), control).map(|whole| whole.map),
    ])
}

/// Checks that the positions of a map are finite, and that its figures are numbers or undefined.
fn assert_valid(map: &FlatMap) -> std::result::Result<(), TestCaseError> {
    prop_assert!(map.uv.iter().flatten().all(|x| x.is_finite()), "{:?}", map.uv);
    prop_assert!(map.normals.iter().all(|n| n.iter().all(|x| x.is_nan()) || n.norm() < 1.0 + 1e-9));
    prop_assert!(map.eigenvalues.iter().all(|x| x.is_finite()));
    prop_assert!(map.distortion.raw.relative_error.is_nan() || map.distortion.raw.relative_error >= 0.0);
    if let Some(convergence) = &map.convergence {
        prop_assert!(convergence.energies.iter().all(|x| x.is_finite()), "{:?}", convergence.energies);
    }
    Ok(())
}

/// Calls all functions on triangles; each of them may return an error.
fn worked_through((points, faces): &Soup, control: &Control) -> std::result::Result<(), TestCaseError> {
    let defects = Surface::defects(points, faces);
    for made in [Surface::from_triangles(points, faces), Surface::repaired(points, faces)] {
        let Ok((surface, _)) = made else { continue };
        prop_assert!(defects.is_ok());
        let (low, high) = surface.points().iter().fold(([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]), |(l, h), p| {
            ([0, 1, 2].map(|k| l[k].min(p[k])), [0, 1, 2].map(|k| h[k].max(p[k])))
        });
        prop_assert!((0..3).any(|k| high[k] - low[k] >= SMALLEST) && high.iter().all(|&x| x <= FARTHEST));
        let piece = patch::largest_piece(&surface);
        let Ok(opened) = open_to_disk(&piece, control) else { continue };
        let Ok(maps) = all_maps(&opened.surface, control) else { continue };
        for map in maps.iter().flatten() {
            assert_valid(map)?;
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(cases(100))]

    #[test]
    fn triangles_without_sense_are_a_surface_or_refused(soup in soup()) {
        watched(|control| worked_through(&soup, control))?;
    }

    #[test]
    fn spoiled_surfaces_are_mapped_or_refused(soup in spoiled()) {
        watched(|control| worked_through(&soup, control))?;
    }

    #[test]
    fn any_mask_is_mapped_or_refused(
        shape in prop::array::uniform3(1usize..6),
        bits in prop::collection::vec(prop::bool::weighted(0.6), 125),
        spacing in prop::array::uniform3(prop::sample::select(vec![1.0, 1.0, 0.5, 3.0, 30.0])),
        power in -9..10,
    ) {
        let size = 10f64.powi(power);
        let Ok(mask) = Mask::new(shape, bits[..shape.iter().product()].to_vec()) else { return Ok(()) };
        let Ok(affine) = Affine::from_spacing(spacing.map(|h| size * h)) else { return Ok(()) };
        watched(|control| {
            if let Ok(repaired) = to_genus_zero(&mask, affine.spacing(), None, control)
                && let Ok(mesh) = VoxelMesh::of(&repaired.mask, &affine, None, None, control)
                && let Ok(opened) = open_to_disk(&patch::largest_piece(&mesh.surface), control)
                && let Ok(maps) = all_maps(&opened.surface, control)
            {
                for map in maps.iter().flatten() {
                    assert_valid(map)?;
                }
            }
            if let Ok(voxels) = VoxelSurface::from_mask(&mask, affine, control)
                && let Ok((part, graph)) = cut_out(&voxels, &Selection::default(), LinkLengths::ChainCode, control)
                && let Ok(map) =
                    grossmann2002(&part, &graph, &Sources::Farthest { count: 5, seed: 0 }, Default::default(), false, control)
            {
                assert_valid(&map)?;
            }
            Ok(())
        })?;
    }

    #[test]
    fn twice_the_size_is_the_same_map_twice_as_large(
        heights in prop::collection::vec(0.0..1.5f64, 42), power in -20..25,
    ) {
        let (mut points, faces) = shapes::sheet(6, 5);
        points.iter_mut().zip(&heights).for_each(|(point, height)| point[2] += height);
        points.iter_mut().flatten().for_each(|x| *x *= 0.25); // no distance is beyond 10 mm
        let size = 2f64.powi(power);
        let large: Vec<[f64; 3]> = points.iter().map(|point| point.map(|x| size * x)).collect();
        let [one, other] = [&points, &large].map(|points| shapes::surface((points.clone(), faces.clone())));
        let control = Control::default();
        let rows = |surface: &Surface| {
            let graph = GeodesicGraph::new(surface, &control).unwrap();
            let marching = Marching::new(surface, Wave::Circle, &control).unwrap();
            let exact = Exact::new(surface);
            [
                DistanceRows::compute(&graph, &[0, 17], &control).unwrap(),
                DistanceRows::compute(&marching, &[0, 17], &control).unwrap(),
                DistanceRows::compute(&exact, &[0, 17], &control).unwrap(),
            ]
        };
        for (one, other) in rows(&one).into_iter().zip(rows(&other)) {
            let scaled: Vec<f32> = one.into_data().iter().map(|distance| distance * size as f32).collect();
            prop_assert_eq!(scaled, other.into_data());
        }
        let longest = if power > 0 { size } else { 1.0 };
        for (n, (one, other)) in all_maps(&one, &control).unwrap().into_iter().zip(all_maps(&other, &control).unwrap()).enumerate() {
            if n == 0 && longest > 1.0 {
                continue; // distances up to 10 and 30 mm have separate weights
            }
            match (one, other) {
                (Ok(one), Ok(other)) => {
                    let scaled: Vec<[f64; 2]> = one.uv.iter().map(|place| place.map(|x| size * x)).collect();
                    prop_assert_eq!(&scaled, &other.uv, "{}", n);
                    let [error, expected] = [&other, &one].map(|map| map.distortion.best_scale.relative_error);
                    prop_assert!((error / expected - 1.0).abs() < 1e-9 || expected < 1e-6, "{} {}", error, expected);
                }
                (one, other) => prop_assert_eq!(one.is_err(), other.is_err(), "{}", n),
            }
        }
    }
}

#[test]
fn sizes_beyond_the_scales_are_refused() {
    let (points, faces) = shapes::sheet(4, 4);
    for size in [1e107, 1e19, 3e10, 2e10, 1e-9, 2e-10, 1e-30, 1e-200] {
        let is_taken = size == 2e10 || size == 1e-9;
        let sized: Vec<[f64; 3]> = points.iter().map(|point| point.map(|x| size * x)).collect();
        for made in [Surface::from_triangles(&sized, &faces), Surface::repaired(&sized, &faces)] {
            assert_eq!(made.is_ok(), is_taken, "{size:e}: {:?}", made.err());
        }
    }
    let far: Vec<[f64; 3]> = points.iter().map(|&[x, y, z]| [x, y, z + 1.1e11]).collect();
    assert!(matches!(Surface::from_triangles(&far, &faces), Err(Error::PointTooFar { vertex: 0, .. })));
}

#[test]
fn vertices_that_do_not_exist_and_values_of_wrong_lengths_are_errors() {
    let (surface, control) = (shapes::surface(shapes::sheet(4, 4)), Control::default());
    let (graph, none) = (GeodesicGraph::new(&surface, &control).unwrap(), surface.len() as u32);
    let (marching, exact) = (Marching::new(&surface, Wave::Circle, &control).unwrap(), Exact::new(&surface));
    let mut row = vec![0.0; surface.len()];
    let missing = [
        DistanceRows::compute(&graph, &[none], &control).err(),
        DistanceRows::compute_to(&exact, &[0], &[none], &control).err(),
        exact.distances(none, &mut row, &mut exact.scratch(), &control).err(),
        marching.march(none, &control).err(),
        marching.march(0, &control).unwrap().path(none, &control).err(),
        trace_path(&graph, DistanceRows::compute(&graph, &[0], &control).unwrap().row(0), 0, none, &control).err(),
        Levels::new(&surface, &[none], &control).err(),
        Neighbourhoods::measure(&surface, Some(1), &[none], false, &control).err(),
        cells(&graph, &[0, none], 1, 0, &control).err(),
        vertex_normals(surface.points(), &[[0, 1, none]]).err(),
        flipped(&[[0, 1, none]], surface.points()).err(),
    ];
    for (n, error) in missing.into_iter().enumerate() {
        assert_eq!(error, Some(Error::NoSuchPoint { vertex: surface.len(), points: surface.len() }), "case {n}");
    }
    let uv = vec![[0.0; 2]; surface.len() - 1];
    let ones = vec![1.0; surface.len() - 1];
    let wrong = [
        surface.part_of_faces(&[true]).err(),
        surface.part_of_vertices(&[true]).err(),
        surface.moved(Vec::new()).err(),
        exact.distances(0, &mut row[1..], &mut exact.scratch(), &control).err(),
        shortest_path(&surface, &[0, 1], Some(&ones), &control).err(),
        path_to_any(&surface, 0, &[true], &[true], &ones, &control).err(),
        measure_faces(surface.points(), surface.faces(), &uv, &control).err(),
        evaluate_all(&graph, &[&uv], None, &[0], 0, Default::default(), &control).err(),
        glue(&surface, &[0], &[[[0.0; 2]; 3]], 1.5, &control).err(),
        turn_onto(&[[0.0; 2]], &[], &mut []).err(),
        Template::new(shapes::surface(shapes::sphere(1)), Vec::new(), Vec::new(), Vec::new()).err(),
    ];
    for (n, error) in wrong.into_iter().enumerate() {
        assert!(matches!(error, Some(Error::WrongLength { .. })), "case {n}: {error:?}");
    }
    let options = schwartz1989::Options {
        rings: Some(2),
        sources: &[0],
        starts: 0,
        seed: 0,
        bands: Default::default(),
        keep_rows: false,
    };
    assert_eq!(schwartz1989(&surface, &graph, &options, &control).err(), Some(Error::NoStarts));
    let none = register(&surface, &[], None, &control).err();
    assert_eq!(none, Some(Error::NoSuchTemplate { template: 0, templates: 0 }));
}
