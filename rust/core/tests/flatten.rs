//! Complete maps: properties that do not depend on the implementation of the stages.

use voxflat::flatten::{FlatMap, check_flattenable, grossmann2002};
use voxflat::geodesic::chain::{LinkLengths, chain_graph};
use voxflat::patch::{Disk, Selection, cut_out};
use voxflat::sources::Sources;
use voxflat::surface::{VoxelSurface, voxels::graph::VoxelGraph};
use voxflat::volume::{Affine, Mask};
use voxflat::{Control, Error, Result};

fn surface_of(mask: &Mask, spacing: [f64; 3]) -> VoxelSurface {
    VoxelSurface::from_mask(mask, Affine::from_spacing(spacing).unwrap(), &Control::default()).unwrap()
}

fn part(surface: &VoxelSurface, keep: Option<&Mask>, disk: Option<Disk>) -> Result<(VoxelSurface, VoxelGraph)> {
    cut_out(surface, &Selection { keep, disk }, LinkLengths::ChainCode, &Control::default())
}

fn whole(mask: &Mask, spacing: [f64; 3]) -> (VoxelSurface, VoxelGraph) {
    part(&surface_of(mask, spacing), None, None).unwrap()
}

fn flatten(mask: &Mask, spacing: [f64; 3], sources: usize) -> Result<FlatMap> {
    let (surface, graph) = whole(mask, spacing);
    grossmann2002(
        &surface,
        &graph,
        &Sources::Farthest { count: sources, seed: 0 },
        Default::default(),
        false,
        &Control::default(),
    )
}

/// Returns a half cylinder of this radius in voxels, one voxel thick.
fn half_cylinder(radius: f64, length: usize) -> Mask {
    let size = 2 * radius as usize + 5;
    let middle = size as f64 / 2.0;
    Mask::from_fn([length, size, size], |[_, j, k]| {
        let (y, z) = (j as f64 - middle, k as f64 - middle);
        z > 0.0 && (y.hypot(z) - radius).abs() < 0.6
    })
    .unwrap()
}

fn ball(radius: f64) -> Mask {
    let size = 2 * radius as usize + 5;
    let middle = size as f64 / 2.0;
    Mask::from_fn([size; 3], |v| v.iter().map(|&x| (x as f64 - middle).powi(2)).sum::<f64>() < radius * radius).unwrap()
}

#[test]
fn developable_sheets_flatten_with_the_estimators_error_only() {
    let plane = Mask::from_fn([50, 40, 3], |v| v[2] == 1).unwrap();
    for (mask, spacing) in [(plane, [1.0; 3]), (half_cylinder(15.0, 50), [1.0; 3]), (half_cylinder(15.0, 50), [0.5; 3])]
    {
        let map = flatten(&mask, spacing, 300).unwrap();
        let figures = map.distortion.raw;
        assert!(figures.relative_error < 0.05 && figures.stress_1 < 0.05, "{figures:?}");
        assert!(map.planarity > 0.99 && map.distortion.pearson_r > 0.995);
    }
}

#[test]
fn a_larger_voxel_size_gives_a_larger_map() {
    let mask = half_cylinder(10.0, 30);
    let (one, two) = (flatten(&mask, [1.0; 3], 100).unwrap(), flatten(&mask, [2.0; 3], 100).unwrap());
    for (a, b) in one.uv.iter().zip(&two.uv) {
        assert!((2.0 * a[0] - b[0]).hypot(2.0 * a[1] - b[1]) < 1e-3);
    }
    assert!((one.distortion.raw.relative_error - two.distortion.raw.relative_error).abs() < 1e-5);
}

#[test]
fn a_closed_surface_is_refused_and_a_patch_of_it_is_not() {
    let surface = surface_of(&ball(12.0), [1.0; 3]);
    let control = Control::default();
    assert!(matches!(check_flattenable(&surface, &control), Err(Error::Closed { euler: 2, .. })));
    let disk = Disk { seed_point: [14, 14, 2], radius: 15.0 };
    let (part, graph) = part(&surface, None, Some(disk)).unwrap();
    assert_eq!(check_flattenable(&part, &control).unwrap().euler, 1);
    let map =
        grossmann2002(&part, &graph, &Sources::Random { count: 100, seed: 1 }, Default::default(), false, &control)
            .unwrap();
    assert!(map.distortion.raw.relative_error < 0.1);
}

#[test]
fn a_geodesic_disk_holds_exactly_what_is_near_along_the_surface() {
    let surface = surface_of(&half_cylinder(12.0, 40), [1.0; 3]);
    let control = Control::default();
    let graph = chain_graph(&surface, LinkLengths::ChainCode, &control).unwrap();
    let seed = surface.voxels()[surface.len() / 2];
    let disk = Disk { seed_point: seed.map(i64::from), radius: 14.0 };
    let (part, _) = part(&surface, None, Some(disk)).unwrap();
    let source = surface.find(seed.map(i64::from)).unwrap() as u32;
    let rows = voxflat::rows::DistanceRows::compute(&graph, &[source], &control).unwrap();
    for (voxel, &distance) in surface.voxels().iter().zip(rows.row(0)) {
        assert_eq!(part.find(voxel.map(i64::from)).is_ok(), distance <= 14.0);
    }
}

#[test]
fn pieces_are_told_apart() {
    let two = Mask::from_fn([30, 20, 3], |[i, _, k]| k == 1 && !(10..14).contains(&i)).unwrap();
    let (largest, _) = whole(&two, [1.0; 3]);
    assert_eq!(largest.len(), 16 * 20);
    let error = part(&surface_of(&two, [1.0; 3]), Some(&two), None).unwrap_err();
    assert_eq!(error, Error::Disconnected { count: 2, sizes: "320, 200".into() });
}

#[test]
fn bad_patches_are_refused() {
    let surface = surface_of(&half_cylinder(8.0, 20), [1.0; 3]);
    let cut = |disk| part(&surface, None, Some(disk)).unwrap_err();
    for radius in [0.0, -3.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(cut(Disk { seed_point: [0; 3], radius }), Error::RadiusNotPositive { .. }));
    }
    assert!(matches!(cut(Disk { seed_point: [500, 0, 0], radius: 3.0 }), Error::SeedOffSurface { .. }));
    let elsewhere = Mask::from_fn(surface.shape(), |v| v == [0, 0, 0]).unwrap();
    let error = part(&surface, Some(&elsewhere), None).unwrap_err();
    assert_eq!(error, Error::EmptyPatch { points: surface.len() });
}

#[test]
fn a_line_of_voxels_is_no_surface() {
    let line = Mask::from_fn([50, 1, 1], |_| true).unwrap();
    assert!(matches!(flatten(&line, [1.0; 3], 20), Err(Error::NotPlanar { .. })));
}
