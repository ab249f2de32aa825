//! All long computations end when cancelled, and are bit-identical for any number of threads.

use std::fmt::Debug;

use voxflat::distortion::{distances, evaluate, faces, lower_bound, overlap};
use voxflat::embed::{sammon, stress::levels::Levels};
use voxflat::flatten::relaxation::{Relaxation, relax};
use voxflat::flatten::{self, check_flattenable, grossmann2002, saucan2006, schwartz1989, zigelman2002};
use voxflat::geodesic::bend::Marking;
use voxflat::geodesic::chain::{LinkLengths, chain_graph};
use voxflat::geodesic::marching::{Marching, Wave};
use voxflat::geodesic::neighbourhood::{Neighbourhoods, sizes_of_rings};
use voxflat::geodesic::{exact::Exact, graph::GeodesicGraph};
use voxflat::place::reinsertion::{self, Placing};
use voxflat::rows::DistanceRows;
use voxflat::sources::Sources;
use voxflat::sphere::{map::spherical_map, pattern::pattern};
use voxflat::surface::mesh::curvature::smooth_mean_curvature;
use voxflat::surface::sulcal_depth::sulcal_depth;
use voxflat::surface::topology::loops;
use voxflat::surface::topology::thin::thin_places;
use voxflat::surface::voxels::repair::to_genus_zero;
use voxflat::surface::voxels::voxelmesh::VoxelMesh;
use voxflat::surface::{Surface, VoxelSurface, cuts, decimate};
use voxflat::volume::{Affine, Mask};
use voxflat::{Control, Error, Result, atlas, patch};

#[allow(dead_code)] // not all shapes are used here
#[path = "../src/surface/mesh/shapes.rs"]
mod shapes;

type Job<'a> = Box<dyn Fn(&Control) -> Result<String> + Sync + 'a>;

/// Returns the result of a job as text, which shows every bit, and in which NaN equals itself.
fn job<'a, T: Debug>(of: impl Fn(&Control) -> Result<T> + Sync + 'a) -> Job<'a> {
    Box::new(move |control| of(control).map(|found| format!("{found:?}")))
}

/// Returns a cap of a ball with furrows, a disk that cannot be flattened without distortion.
fn cap() -> Surface {
    let (points, faces) = shapes::sphere(4);
    let bumpy = |&[x, y, z]: &[f64; 3]| [x, y, z].map(|c| 20.0 * c * (1.0 + 0.1 * (9.0 * x).sin() * (7.0 * y).cos()));
    let ball = shapes::surface((points.iter().map(bumpy).collect(), faces));
    ball.part_of_vertices(&ball.points().iter().map(|p| p.z > -2.0).collect::<Vec<_>>()).unwrap()
}

#[test]
fn long_work_ends_when_it_is_cancelled_and_is_the_same_by_any_number_of_threads() {
    let control = &Control::default();
    let (disk, ball, torus) = (&cap(), &shapes::surface(shapes::sphere(4)), &shapes::surface(shapes::torus(24, 12)));
    let uv: &Vec<[f64; 2]> = &disk.points().iter().map(|p| [p.x + 0.3 * p.z, p.y]).collect();
    let graph = &GeodesicGraph::new(disk, control).unwrap();
    let sources: &Vec<u32> = &(0..disk.len() as u32).step_by(9).collect(); // enough sources for bundles
    let few = &sources[..10];
    let marching = &Marching::new(disk, Wave::Circle, control).unwrap();
    let pairs = &Neighbourhoods::measure(disk, Some(2), &few[..2], false, control).unwrap().0;
    let coarse =
        &decimate::decimate(disk, &[], &decimate::Options { vertices: 60, ..Default::default() }, control).unwrap();
    let mask =
        &Mask::from_fn([16; 3], |v| v.iter().map(|&x| (x as f64 - 7.5).powi(2)).sum::<f64>() < 40.0 && v[0] != 9)
            .unwrap();
    let affine = &Affine::from_spacing([1.0, 0.8, 1.1]).unwrap();
    let sheet = Mask::from_fn([30, 24, 12], |[i, j, k]| k == (j + i / 3) / 4).unwrap();
    let voxels = &VoxelSurface::from_mask(&sheet, *affine, control).unwrap();
    let links = &chain_graph(voxels, LinkLengths::ChainCode, control).unwrap();
    let farthest = &Sources::Farthest { count: 40, seed: 1 };
    let limit = atlas::Limit::Angle(15.0);
    let patches = &atlas::patches(disk, limit, atlas::Seeds::Curvature, control).unwrap();
    let jobs: Vec<(&str, Job)> = vec![
        ("graph", job(|c| GeodesicGraph::new(disk, c).map(|_| ()))),
        ("marching", job(|c| Marching::new(disk, Wave::Plane, c).map(|_| ()))),
        ("rows, bundled", job(|c| DistanceRows::compute(graph, sources, c))),
        ("rows, one by one", job(|c| DistanceRows::compute(graph, few, c))),
        ("rows to some", job(|c| DistanceRows::compute_to(graph, sources, few, c))),
        ("rows, marched", job(|c| DistanceRows::compute(marching, few, c))),
        ("rows, exact", job(|c| DistanceRows::compute(&Exact::new(disk), few, c))),
        ("rows of voxels", job(|c| DistanceRows::compute(links, few, c))),
        ("sources", job(|c| farthest.choose(graph, c))),
        ("neighbourhoods", job(|c| Neighbourhoods::measure(disk, Some(3), &few[..2], false, c))),
        ("rings", job(|c| sizes_of_rings(disk, None, c))),
        ("Sammon", job(|c| sammon::descend(pairs, uv.clone(), c))),
        (
            "flatten",
            job(|c| {
                let levels = Levels::new(disk, few, control)?;
                let rows = levels.measure(&Marking::new(graph), control)?;
                flatten::voxflat(levels, rows, &Default::default(), graph, Default::default(), c)
            }),
        ),
        ("voxels' check", job(|c| check_flattenable(voxels, c).map(|_| ()))),
        ("Grossmann", job(|c| grossmann2002(voxels, links, farthest, Default::default(), false, c))),
        ("Saucan", job(|c| saucan2006::saucan2006(disk, 1.5, Default::default(), c))),
        (
            "Schwartz",
            job(|c| {
                let options = schwartz1989::Options {
                    rings: Some(2),
                    sources: few,
                    starts: 2,
                    seed: 3,
                    bands: Default::default(),
                    keep_rows: false,
                };
                schwartz1989(disk, graph, &options, c)
            }),
        ),
        (
            "Zigelman",
            job(|c| {
                let sampling = zigelman2002::Sampling::Decimation { count: 40 };
                zigelman2002(disk, graph, &sampling, Wave::Circle, Default::default(), false, c)
            }),
        ),
        ("relaxation", job(|c| relax(disk, Relaxation { length: 30.0, ..Relaxation::default() }, c))),
        ("triangles", job(|c| faces::measure_faces(disk.points(), disk.faces(), uv, c))),
        ("overlaps", job(|c| overlap::overlaps(disk.faces(), uv, c))),
        ("evaluate", job(|c| evaluate::evaluate_all(graph, &[uv], None, sources, 0, Default::default(), c))),
        ("lower bound", job(|c| lower_bound::lower_bound(graph, lower_bound::Samples { points: 12, count: 9 }, 0, c))),
        ("error of distances", job(|c| distances::error_of_distances(disk, graph, Default::default(), c))),
        ("patches", job(|c| atlas::patches(disk, limit, atlas::Seeds::Flattest, c))),
        ("glue", job(|c| atlas::glue::glue(disk, &patches.labels, &patches.flat(disk), 1.5, c))),
        ("sphere", job(|c| spherical_map(ball, c))),
        ("folds", job(|c| pattern(ball, c))),
        ("curvature", job(|c| smooth_mean_curvature(disk, 2.0, c))),
        ("depth", job(|c| sulcal_depth(disk, 70.0, c))),
        ("thin places", job(|c| thin_places(ball, 3.0, c))),
        ("handles", job(|c| loops::handles(torus, c))),
        ("cuts", job(|c| cuts::open_to_disk(torus, c))),
        ("disk", job(|c| patch::disk(disk, graph, 0, 9.0, c))),
        (
            "decimation",
            job(|c| decimate::decimate(ball, &[], &decimate::Options { vertices: 100, ..Default::default() }, c)),
        ),
        ("reinsertion", job(|c| reinsertion::place(&coarse.removals, &mut uv.clone(), &Placing::default(), c))),
        ("repair", job(|c| to_genus_zero(mask, [1.0; 3], None, c))),
        ("voxel mesh", job(|c| VoxelMesh::of(mask, affine, None, None, c))),
    ];
    let pools = [1, 2, 7].map(|threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap());
    for (name, job) in &jobs {
        let cancelled = Control::default();
        cancelled.cancel();
        assert_eq!(job(&cancelled), Err(Error::Cancelled), "{name}");
        let found = pools.each_ref().map(|pool| pool.install(|| job(&Control::default()).unwrap()));
        assert!(found[0] == found[1] && found[0] == found[2], "{name}: the number of threads matters");
    }
}
