//! Flattening after Grossmann, Kiryati and Kimmel (2002).

use nalgebra::Vector3;

use super::check::check_flattenable;
use super::map::FlatMap;
use super::memory::{BASE_BYTES, reference_memory_need};
use crate::control::Control;
use crate::distortion::judge::{REFERENCE_SOURCES, judge};
use crate::embed::classical::classical_scaling;
use crate::error::{Error, Result};
use crate::geodesic::engine::Engine;
use crate::orient::{handedness, orient, outward_normals};
use crate::place::radial::RadialFunctions;
use crate::rows::{DistanceRows, Rows};
use crate::sources::{FEWEST_SOURCES, Sources};
use crate::surface::VoxelSurface;
use crate::surface::voxels::graph::VoxelGraph;

/// Flattens a connected part of a voxel surface after Grossmann, Kiryati and Kimmel (2002): chain-code geodesics, classical
/// scaling of the sources, radial functions for the rest. The rows from the sources are kept in the map if so wished.
///
/// # Errors
/// Those of [`check_flattenable`] and of the stages.
pub fn grossmann2002(
    surface: &VoxelSurface,
    graph: &VoxelGraph,
    sources: &Sources,
    seed: u64,
    keep_rows: bool,
    control: &Control,
) -> Result<FlatMap> {
    check_flattenable(surface, control)?;
    let sources = sources.choose(graph, control)?;
    if sources.len() < FEWEST_SOURCES {
        return Err(Error::TooFewSources { sources: sources.len(), needed: FEWEST_SOURCES });
    }
    let engine = Engine::new(graph, sources.len() + REFERENCE_SOURCES, control)?;
    let (among, rows) = if keep_rows {
        let rows = DistanceRows::by(&engine, &sources, control)?;
        (rows.among(control)?, Some(rows))
    } else {
        (DistanceRows::among_by(&engine, &sources, control)?, None)
    };
    control.begin("scaling", 1);
    let scaling = classical_scaling(&among)?;
    control.check()?;
    let mut uv = place_rest(&surface.points(), &sources, &scaling.places, control)?;
    let seen_from_outside = handedness(surface, graph, &uv);
    orient(&surface.points(), seen_from_outside, &mut uv);

    let distortion = judge(&engine, &uv, REFERENCE_SOURCES, seed, control)?;
    let (eigenvalues, planarity) = (scaling.eigenvalues, scaling.planarity);
    Ok(FlatMap {
        uv,
        normals: outward_normals(surface, graph),
        sources,
        eigenvalues,
        planarity,
        distortion,
        convergence: None,
        rows: rows.map(|rows| rows.as_computed(&engine, control)).transpose()?,
    })
}

/// The places of all points: those of the sources as they are, the rest by radial functions.
fn place_rest(
    points: &[Vector3<f64>],
    sources: &[u32],
    places: &[[f64; 2]],
    control: &Control,
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

/// Usual numbers of shortcuts of a voxel, and of lengths in the tables they are found in.
const VOXEL_SHORTCUTS: u64 = 36;
const VOXEL_FILL: u64 = 110;

/// The memory in bytes that [`grossmann2002`] needs at most beside the volume itself, for a surface of `points` voxels
/// with `links` links in its graph.
pub fn memory_need(points: usize, links: usize, sources: usize, threads: usize) -> u64 {
    let [points, links, sources, threads] = [points, links, sources, threads].map(|n| n as u64);
    let graph = 4 * links + 4 * points;
    let surface = (15 + 24 + 16 + 48 + 100) * points; // and what Python makes of it
    let scaling = (4 + 8 + 8) * sources * sources; // distances, B or the radial system, its factor
    let workers = threads * (4 + 16) * points;
    let reference = reference_memory_need(points);
    let shortcuts = (4 * VOXEL_FILL + 8 * VOXEL_SHORTCUTS) * points;
    BASE_BYTES + graph + surface + workers + scaling.max(reference) + shortcuts
}
