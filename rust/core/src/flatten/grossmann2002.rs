//! Flattening by Grossmann, Kiryati and Kimmel (2002).

use nalgebra::Vector3;

use super::check::check_flattenable;
use super::map::{BASE_BYTES, FlatMap, PYTHON_BYTES};
use crate::distortion::Evaluation;
use crate::distortion::evaluate::{self, REFERENCE_SOURCES, evaluate};
use crate::embed::classical::{self, classical_scaling};
use crate::geodesic::bundle::BundleScratch;
use crate::orient::{handedness, orient, outward_normals};
use crate::place::radial::RadialFunctions;
use crate::rows::DistanceRows;
use crate::sources::{Sources, check_enough};
use crate::surface::{VoxelSurface, voxels::graph::VoxelGraph};
use crate::{Control, Result};

/// Flattens a connected part of a voxel surface by the method of Grossmann, Kiryati and Kimmel (2002): chain-code
/// geodesics, classical scaling of the sources, and radial functions for the other points. Rows are kept on request.
///
/// # Errors
/// Those of [`check_flattenable`] and of [`Sources::choose`],
/// [`Error::Unreachable`](crate::Error::Unreachable) if the surface is not connected,
/// [`Error::NotPlanar`](crate::Error::NotPlanar) if the distances describe a line or a point, and
/// [`Error::EigenNotConverged`](crate::Error::EigenNotConverged) or
/// [`Error::RadialSingular`](crate::Error::RadialSingular) if a system of equations has no solution.
pub fn grossmann2002(
    surface: &VoxelSurface, graph: &VoxelGraph, sources: &Sources, evaluation: Evaluation, keep_rows: bool,
    control: &Control,
) -> Result<FlatMap> {
    check_flattenable(surface, control)?;
    let sources = sources.choose(graph, control)?;
    check_enough(sources.len())?;
    let (among, rows) = DistanceRows::among_sources(graph, &sources, keep_rows, control)?;
    control.begin("classical scaling", 1);
    let scaling = classical_scaling(&among)?;
    control.check()?;
    let mut uv = place_rest(&surface.points(), &sources, &scaling.places, control)?;
    let seen_from_outside = handedness(surface, graph, &uv);
    orient(&surface.points(), seen_from_outside, &mut uv);

    let distortion = evaluate(graph, &uv, REFERENCE_SOURCES, evaluation, control)?;
    let (eigenvalues, planarity) = (scaling.eigenvalues, scaling.planarity);
    Ok(FlatMap {
        uv,
        normals: outward_normals(surface, graph),
        sources,
        eigenvalues,
        planarity,
        distortion,
        convergence: None,
        rows,
    })
}

/// Returns the positions of all points: those of the sources unchanged, the others by radial functions.
fn place_rest(
    points: &[Vector3<f64>], sources: &[u32], places: &[[f64; 2]], control: &Control,
) -> Result<Vec<[f64; 2]>> {
    let mut uv = if sources.len() < points.len() {
        let known: Vec<_> = sources.iter().map(|&source| points[source as usize]).collect();
        RadialFunctions::fit(&known, places)?.at_all(points, control)?
    } else {
        vec![[0.0; 2]; points.len()] // every point is a source
    };
    sources.iter().zip(places).for_each(|(&source, &place)| uv[source as usize] = place);
    Ok(uv)
}

/// The memory per voxel for placement in bytes: a point in mm, and its position before the map is oriented.
const PLACING_BYTES: u64 = 24 + 16;

/// Returns the maximum memory in bytes of [`grossmann2002`], beside the volume itself, for a surface of `points` voxels
/// with `links` links in its graph. Scaling ends before the evaluation begins.
pub fn memory_need(points: usize, links: usize, sources: usize, threads: usize) -> u64 {
    BASE_BYTES
        + VoxelSurface::memory_need(points)
        + FlatMap::memory_need(points)
        + (PLACING_BYTES + PYTHON_BYTES) * points as u64
        + VoxelGraph::memory_need(points, links)
        + threads as u64 * BundleScratch::memory_need(points)
        + classical::memory_need(sources).max(evaluate::memory_need(points))
}
