//! Flatten the label of a half pipe that is one voxel thick.

use voxflat::embed::stress::levels::Levels;
use voxflat::flatten::{self, voxflat::Options};
use voxflat::geodesic::{bend::Marking, graph::GeodesicGraph};
use voxflat::sources::Sources;
use voxflat::surface::voxels::voxelmesh::VoxelMesh;
use voxflat::volume::{Affine, Mask};
use voxflat::{Control, Result, patch};

fn main() -> Result<()> {
    let control = Control::default();
    let radius = |j: usize, k: usize| (j as f64 - 11.5).hypot(k as f64);
    let label = Mask::from_fn([20, 24, 13], |[_, j, k]| (radius(j, k) - 10.0).abs() < 0.6)?;
    let mesh = VoxelMesh::of(&label, &Affine::from_spacing([1.0; 3])?, None, None, &control)?;
    let surface = patch::largest_piece(&mesh.surface);

    let graph = GeodesicGraph::new(&surface, &control)?;
    let sources = Sources::Farthest { count: 50, seed: 0 }.choose(&graph, &control)?;
    let levels = Levels::new(&surface, &sources, &control)?;
    let rows = levels.measure(&Marking::new(&graph), &control)?;
    let map = flatten::voxflat(levels, rows, &Options::default(), &graph, Default::default(), &control)?;

    let error = map.distortion.raw.relative_error;
    println!("{} vertices; distances change by {:.2} % on average", map.uv.len(), 100.0 * error);
    assert!(map.uv.len() == surface.len() && error < 0.05); // a pipe can be unrolled
    Ok(())
}
