//! Helpers of the unit tests of several modules.

use std::ops::Range;

use nalgebra::Vector3;
use proptest::prelude::*;

use crate::geodesic::Solver;
use crate::geodesic::chain::{LinkLengths, chain_graph};
use crate::orient::map_area;
use crate::surface::mesh::{BORDER, shapes};
use crate::surface::voxels::{graph::VoxelGraph, voxelmesh::VoxelMesh};
use crate::surface::{Surface, VoxelSurface};
use crate::volume::{Affine, Mask};
use crate::{Control, Result};

pub(crate) type Mesh = (Vec<[f64; 3]>, Vec<[i64; 3]>);

/// Joins two meshes into one.
pub(crate) fn both(one: &Mesh, other: &Mesh) -> Mesh {
    let others = other.1.iter().map(|face| face.map(|v| v + one.0.len() as i64));
    ([&one.0[..], &other.0].concat(), one.1.iter().copied().chain(others).collect())
}

/// Moves the points of a mesh.
pub(crate) fn moved((points, faces): &Mesh, to: impl Fn(&[f64; 3]) -> [f64; 3]) -> Mesh {
    (points.iter().map(to).collect(), faces.clone())
}

/// Returns the number of triangles that a map flips.
pub(crate) fn flipped(surface: &Surface, uv: &[[f64; 2]]) -> usize {
    surface.faces().iter().filter(|&&face| map_area(&[face], uv) <= 0.0).count()
}

/// Generates masks that are not empty, with a share of foreground within `shares`.
pub(crate) fn masks(shape: [usize; 3], shares: Range<f64>) -> impl Strategy<Value = Mask> {
    let values = prop::collection::vec(0.0..1.0f64, shape.iter().product::<usize>());
    (values, shares).prop_filter_map("no foreground", move |(values, share)| {
        Mask::new(shape, values.into_iter().map(|value| value < share).collect()).ok()
    })
}

/// Returns the surface of a solid.
pub(crate) fn solid(mask: &Mask, spacing: [f64; 3]) -> Surface {
    let affine = Affine::from_spacing(spacing).unwrap();
    VoxelMesh::of_solid(mask, &affine, None, &Control::default()).unwrap().surface
}

/// Returns the distances from a source, by a separate search.
pub(crate) fn row<S: Solver>(solver: &S, source: u32) -> Vec<f32> {
    let mut row = vec![f32::NAN; solver.columns()];
    solver.row(source, &mut row, &mut solver.scratch(), &Control::default()).unwrap();
    row
}

/// A solver that calls a function for each row, which may fail.
pub(crate) struct Altered<'a, S, F>(pub &'a S, pub F);

impl<S: Solver, F: Fn(&mut [f32]) -> Result<()> + Sync> Solver for Altered<'_, S, F> {
    type Scratch = S::Scratch;

    fn scratch(&self) -> S::Scratch {
        self.0.scratch()
    }

    fn columns(&self) -> usize {
        self.0.columns()
    }

    fn row(&self, source: u32, row: &mut [f32], scratch: &mut S::Scratch, control: &Control) -> Result<()> {
        self.0.row(source, row, scratch, control)?;
        (self.1)(row)
    }

    fn fingerprint(&self, control: &Control) -> Result<u64> {
        self.0.fingerprint(control)
    }
}

/// Returns the surface voxels of a mask with a spacing in mm.
pub(crate) fn voxels(mask: &Mask, spacing: [f64; 3]) -> VoxelSurface {
    VoxelSurface::from_mask(mask, Affine::from_spacing(spacing).unwrap(), &Control::default()).unwrap()
}

/// Returns the surface voxels with their chain-code graph.
pub(crate) fn chained(mask: &Mask, spacing: [f64; 3]) -> (VoxelSurface, VoxelGraph) {
    let surface = voxels(mask, spacing);
    let graph = chain_graph(&surface, LinkLengths::ChainCode, &Control::default()).unwrap();
    (surface, graph)
}

pub(crate) fn with_threads<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(work)
}

/// Returns a plane grid of `m` × `n` squares of side 1, rolled up to three quarters of a cylinder.
pub(crate) fn curled(m: usize, n: usize) -> Surface {
    let sheet = shapes::surface(shapes::sheet(m, n));
    let radius = n as f64 / (1.5 * std::f64::consts::PI);
    let place = |p: &Vector3<f64>| Vector3::new(p.x, radius * (p.y / radius).sin(), radius * (p.y / radius).cos());
    sheet.moved(sheet.points().iter().map(place).collect()).unwrap()
}

/// Returns such a plane grid, cut open where y is `y` and x is at most `x`.
pub(crate) fn slit(m: usize, n: usize, x: f64, y: f64) -> Surface {
    let sheet = shapes::surface(shapes::sheet(m, n));
    let is_cut = |h: &u32| {
        let [a, b] = [sheet.origin(*h), sheet.target(*h)].map(|v| sheet.points()[v as usize]);
        a.y == y && b.y == y && a.x.max(b.x) <= x
    };
    sheet.cut_open(sheet.edges().filter(is_cut))
}

/// Asserts that half-edges of the same edge run in opposite directions, and that every vertex has one fan.
pub(crate) fn assert_sound(surface: &Surface) {
    for (h, &twin) in (0..).zip(surface.twins()) {
        if twin != BORDER {
            assert_eq!(surface.twins()[twin as usize], h);
            assert_eq!((surface.origin(h), surface.target(h)), (surface.target(twin), surface.origin(twin)));
        }
    }
    assert_eq!(Surface::fans_of(surface.faces(), surface.twins(), surface.len()), vec![1; surface.len()]);
}
