//! The default method: descent on distances and triangles, from coarse to fine.

use super::check::check_disk;
use super::map::FlatMap;
use super::memory::{BASE_BYTES, SURFACE_BYTES, SURFACE_SHORTCUTS, reference_memory_need};
use crate::control::Control;
use crate::distortion::judge::{REFERENCE_SOURCES, judge};
use crate::embed::classical::classical_scaling;
use crate::embed::stress::levels;
use crate::error::{Error, Result};
use crate::geodesic::engine::Engine;
use crate::geodesic::graph::{self, GeodesicGraph};
use crate::orient::{map_area, orient};
use crate::rows::Rows;
use crate::sources::FEWEST_SOURCES;
use crate::store;
use crate::surface::Surface;

/// Flattens a connected surface by distance rows from sources on it, of whatever solver: the map of least stress whose triangles
/// keep their shape, from coarse to fine. No triangle is turned over. `weighting` leads from 0, where near distances and
/// shapes count most, to 1, where far distances do. The map is judged by the engine's distances. Who lends the rows has them
/// afterwards; else they are dropped as soon as all points are placed.
///
/// # Errors
/// [`Error::NotADisk`], [`Error::TooFewPoints`], [`Error::TooFewSources`] and those of the stages.
pub fn voxflat<R: Rows>(
    surface: &Surface,
    rows: R,
    weighting: f64,
    engine: &Engine<GeodesicGraph>,
    seed: u64,
    control: &Control,
) -> Result<FlatMap> {
    check_disk(surface)?;
    let sources = rows.sources().to_vec();
    if sources.len() < FEWEST_SOURCES {
        return Err(Error::TooFewSources { sources: sources.len(), needed: FEWEST_SOURCES });
    }
    control.begin("scaling", 1);
    let among = rows.among(control)?;
    let scaling = classical_scaling(&among)?;
    control.check()?;
    drop(among);
    let (mut uv, convergence) = levels::flatten(surface, &rows, &scaling.places, weighting, control)?;
    let convergence = Some(convergence);
    drop(rows); // those of the reference sources are as large
    orient(surface.points(), map_area(surface.faces(), &uv), &mut uv);
    let distortion = judge(engine, &uv, REFERENCE_SOURCES, seed, control)?;
    let (eigenvalues, planarity) = (scaling.eigenvalues, scaling.planarity);
    Ok(FlatMap { uv, normals: surface.normals(), sources, eigenvalues, planarity, distortion, convergence, rows: None })
}

/// What becomes of the rows from the sources when all points are placed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AfterPlacing {
    /// They make room for those of the reference sources.
    Dropped,
    /// They stay in memory.
    Kept,
    /// They were in a store all the time.
    Stored,
}

/// The memory in bytes that [`voxflat`] needs at most beside the surface's input, for a surface of `points` vertices.
pub fn memory_need(points: usize, sources: usize, threads: usize, rows: AfterPlacing) -> u64 {
    let in_flight = store::memory_need(points, sources, threads);
    let graph = graph::memory_need(points);
    let [points, sources, threads] = [points, sources, threads].map(|n| n as u64);
    let surface = SURFACE_BYTES * points;
    let reference = reference_memory_need(points);
    let stored = rows == AfterPlacing::Stored;
    let rows = match rows {
        AfterPlacing::Dropped => reference.max(4 * points * sources),
        AfterPlacing::Kept => reference + 4 * points * sources,
        AfterPlacing::Stored => reference.max(in_flight),
    };
    let scaling = (4 + 8 + 8) * sources * sources;
    let workers = threads * (4 + 16) * points;
    let shortcuts = if stored { store::TABLE_BYTES } else { 8 * SURFACE_SHORTCUTS * points }; // and the tables they are found in: less than the rows, and before them
    let descent = DESCENT_BYTES * points + 8 * points.min(levels::MOST_JUDGED as u64) * sources;
    BASE_BYTES + graph + surface + workers + rows + scaling + shortcuts + descent
}

/// What descent needs for a vertex: past steps, a factored matrix of springs, triangles, and coarser surfaces.
const DESCENT_BYTES: u64 = 2600;
