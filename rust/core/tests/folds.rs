//! The default map of a random surface flips no triangle, does not overlap itself, and is bit-identical for any number
//! of threads.
//!
//! `VOXFLAT_CASES=10000 cargo test --release --workspace --test folds` runs 10,000 cases, in half an hour on two cores.

use std::f64::consts::TAU;

use nalgebra::Vector3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use robust::{Coord, orient2d};
use voxflat::distortion::overlap::overlaps;
use voxflat::embed::stress::levels::Levels;
use voxflat::flatten::{self, FlatMap, voxflat::Options};
use voxflat::geodesic::{bend::Marking, graph::GeodesicGraph};
use voxflat::patch::largest_piece;
use voxflat::sources::Sources;
use voxflat::surface::Surface;
use voxflat::surface::cuts::open_to_disk;
use voxflat::surface::voxels::repair::to_genus_zero;
use voxflat::surface::voxels::voxelmesh::VoxelMesh;
use voxflat::volume::{Affine, Mask};
use voxflat::{Control, Error, Result};

#[allow(dead_code)] // not all shapes are used here
#[path = "../src/surface/mesh/shapes.rs"]
mod shapes;

type Triangles = (Vec<[f64; 3]>, Vec<[i64; 3]>);

/// Adds narrow and wide hills and pits along the outward direction `out` at each point.
fn add_hills(points: &mut [[f64; 3]], out: impl Fn(Vector3<f64>) -> Vector3<f64>, size: f64, rng: &mut ChaCha8Rng) {
    let before: Vec<Vector3<f64>> = points.iter().map(|&point| point.into()).collect();
    for _ in 0..rng.random_range(0..12) {
        let centre = before[rng.random_range(0..before.len())];
        let width = size * 10f64.powf(rng.random_range(-1.5..-0.3));
        let height = width * rng.random_range(-4.0..4.0);
        for (point, from) in points.iter_mut().zip(&before) {
            let hill = out(*from) * (height * (-(from - centre).norm_squared() / (2.0 * width * width)).exp());
            *point = (Vector3::from(*point) + hill).into();
        }
    }
}

/// Stretches along an axis, so that triangles become thin.
fn stretch(points: &mut [[f64; 3]], rng: &mut ChaCha8Rng) {
    if rng.random_bool(0.3) {
        let (axis, factor) = (rng.random_range(0..3), 10f64.powf(rng.random_range(-1.0..1.0)));
        points.iter_mut().for_each(|point| point[axis] *= factor);
    }
}

/// Returns a sheet with hills, which may be irregular or rolled up.
fn crumpled(rng: &mut ChaCha8Rng) -> Triangles {
    let most = if rng.random_bool(0.05) { 90 } else { 36 };
    let (m, n) = (rng.random_range(6..most), rng.random_range(6..most));
    let (mut points, faces) = shapes::sheet(m, n);
    let jitter = if rng.random_bool(0.5) { rng.random_range(0.0..0.3) } else { 0.0 };
    for point in &mut points {
        if point[0] > 0.0 && point[0] < m as f64 && point[1] > 0.0 && point[1] < n as f64 {
            (0..2).for_each(|axis| point[axis] += rng.random_range(-0.5..0.5) * 2.0 * jitter);
        }
    }
    add_hills(&mut points, |_| Vector3::z(), m.max(n) as f64, rng);
    if rng.random_bool(0.3) {
        let radius = m as f64 / rng.random_range(1.0..TAU - 0.2);
        for [x, y, z] in &mut points {
            let angle = *x / radius;
            [*x, *y, *z] = [(radius + *z) * angle.cos(), *y, (radius + *z) * angle.sin()];
        }
    }
    (points, faces)
}

/// Returns a ball with bumps and dents, most often with an opening.
fn blown(rng: &mut ChaCha8Rng) -> Triangles {
    let (mut points, mut faces) = shapes::sphere(if rng.random_bool(0.05) { 5 } else { rng.random_range(2..5) });
    add_hills(&mut points, |point| point.normalize(), 2.0, rng);
    if rng.random_bool(0.8) {
        let height = rng.random_range(-0.9..0.95);
        faces.retain(|face| face.iter().any(|&v| points[v as usize][2] < height));
    }
    (points, faces)
}

fn ring(rng: &mut ChaCha8Rng) -> Triangles {
    let (mut points, faces) = shapes::torus(rng.random_range(6..40), rng.random_range(4..20));
    let out = |point: Vector3<f64>| Vector3::new(point.x, point.y, 3.0 * point.z).normalize();
    add_hills(&mut points, out, 4.0, rng);
    (points, faces)
}

/// Returns the surface of a union of boxes, as an example of a segmentation.
fn boxes(rng: &mut ChaCha8Rng, control: &Control) -> Result<Surface> {
    let shape = [0; 3].map(|_| rng.random_range(6..20usize));
    let mut bits = vec![false; shape.iter().product()];
    for _ in 0..rng.random_range(1..9) {
        let low = shape.map(|n| rng.random_range(0..n));
        let high = [0, 1, 2].map(|k| (low[k] + rng.random_range(1..8)).min(shape[k]));
        for i in low[0]..high[0] {
            for j in low[1]..high[1] {
                bits[(i * shape[1] + j) * shape[2] + low[2]..(i * shape[1] + j) * shape[2] + high[2]].fill(true);
            }
        }
    }
    let spacing = if rng.random_bool(0.7) { [1.0; 3] } else { [0.5, 0.5, 3.0] };
    let affine = Affine::from_spacing(spacing)?;
    let repaired = to_genus_zero(&Mask::new(shape, bits)?, spacing, None, control)?;
    Ok(VoxelMesh::of(&repaired.mask, &affine, None, None, control)?.surface)
}

/// Returns a random disk.
fn random_disk(rng: &mut ChaCha8Rng, control: &Control) -> Result<Surface> {
    let surface = match rng.random_range(0..8) {
        0..3 => moved(crumpled(rng), rng)?,
        3..5 => moved(blown(rng), rng)?,
        5 => moved(ring(rng), rng)?,
        _ => boxes(rng, control)?,
    };
    Ok(open_to_disk(&largest_piece(&surface), control)?.surface)
}

fn moved((mut points, faces): Triangles, rng: &mut ChaCha8Rng) -> Result<Surface> {
    stretch(&mut points, rng);
    let size = 10f64.powf(rng.random_range(-1.0..1.5)); // bands of distances end at 10 and 30 mm
    points.iter_mut().flatten().for_each(|x| *x *= size);
    Ok(Surface::repaired(&points, &faces)?.0)
}

fn map(disk: &Surface, sources: usize, weighting: f64, threads: usize, control: &Control) -> Result<FlatMap> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
    pool.install(|| {
        let graph = GeodesicGraph::new(disk, control)?;
        let sources = Sources::Farthest { count: sources.min(disk.len()), seed: 0 }.choose(&graph, control)?;
        let levels = Levels::new(disk, &sources, control)?;
        let rows = levels.measure(&Marking::new(&graph), control)?;
        flatten::voxflat(
            levels,
            rows,
            &Options { weighting, ..Options::default() },
            &graph,
            Default::default(),
            control,
        )
    })
}

/// Returns the number of triangles that do not run counterclockwise, by exact arithmetic.
fn not_upright(disk: &Surface, uv: &[[f64; 2]]) -> usize {
    let place = |vertex: u32| Coord { x: uv[vertex as usize][0], y: uv[vertex as usize][1] };
    let is_upright = |face: &[u32; 3]| {
        let [a, b, c] = face.map(place);
        orient2d(a, b, c) > 0.0
    };
    disk.faces().iter().filter(|face| !is_upright(face)).count()
}

#[test]
fn no_triangle_is_turned_over_and_nothing_covered_whatever_the_surface() {
    let cases: u64 = std::env::var("VOXFLAT_CASES").ok().and_then(|text| text.parse().ok()).unwrap_or(60);
    let (mut mapped, mut refused) = (0, 0);
    for seed in 0..cases {
        let (mut rng, control) = (ChaCha8Rng::seed_from_u64(seed), Control::default());
        let Ok(disk) = random_disk(&mut rng, &control) else {
            refused += 1;
            continue;
        };
        let weighting = if rng.random_bool(0.7) { 0.5 } else { rng.random_range(0.0..=1.0) };
        let sources = rng.random_range(3..120);
        match map(&disk, sources, weighting, 2, &control) {
            Ok(one) => {
                mapped += 1;
                let faults = (not_upright(&disk, &one.uv), overlaps(disk.faces(), &one.uv, &control).unwrap().covering);
                assert_eq!(faults, (0, 0), "seed {seed}: not upright, covering, of {} vertices", disk.len());
                for threads in [1, 7] {
                    let other = map(&disk, sources, weighting, threads, &control).expect("as before");
                    let bits = |map: &FlatMap| map.uv.as_flattened().iter().map(|x| x.to_bits()).collect::<Vec<_>>();
                    assert!(bits(&one) == bits(&other), "seed {seed}: other bits by {threads} threads");
                }
            }
            Err(error) => {
                assert!(!matches!(error, Error::Cancelled), "seed {seed}");
                refused += 1;
            }
        }
    }
    assert!(9 * refused <= mapped, "{refused} refused, {mapped} mapped");
}
