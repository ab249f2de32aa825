//! The default method: descent on distances and triangles, from coarse to fine.

use super::check::check_disk;
use super::map::{BASE_BYTES, FlatMap, PYTHON_BYTES};
use crate::control::Control;
use crate::distortion::best_scale;
use crate::distortion::faces::equal_area_scale;
use crate::distortion::judge::{self, REFERENCE_SOURCES, judge};
use crate::embed::classical::{self, classical_scaling};
use crate::embed::stress::area_bound::bounded;
use crate::embed::stress::levels::{self, Levels};
use crate::embed::stress::start::{Start, flatten_from};
use crate::error::Result;
use crate::geodesic::bundle::BundleScratch;
use crate::geodesic::graph::GeodesicGraph;
use crate::orient::{map_area, orient, turn_onto};
use crate::rows::{DistanceRows, Rows};
use crate::sources::check_enough;
use crate::store;
use crate::surface::Surface;

/// Flattens a disk from its levels and the distances on them, of whatever solver: the map of least stress whose triangles
/// keep their shape, from coarse to fine. No triangle is turned over. In the end the map is brought to its scale, and judged by the graph's
/// distances; levels and rows are dropped before.
/// Errors: Those of [`check_disk`], [`check_enough`] and the stages, [`flatten_from`] among them.
pub fn voxflat(
    mut levels: Levels,
    rows: DistanceRows,
    &Options { weighting, start, max_area, scale }: &Options,
    graph: &GeodesicGraph,
    seed: u64,
    control: &Control,
) -> Result<FlatMap> {
    let surface = levels.finest();
    check_disk(surface)?;
    let sources = levels.landmarks().to_vec();
    check_enough(sources.len())?;
    control.begin("scaling", 1);
    let among = rows.among(control)?;
    let scaling = classical_scaling(&among)?;
    control.check()?;
    drop(among);
    let (mut uv, mut convergence) = match start {
        Some(start) => flatten_from(&mut levels, &rows, start, weighting, control)?,
        None => levels::flatten(&mut levels, &rows, &scaling.places, weighting, control)?,
    };
    if let Some(max_area) = max_area {
        let found;
        (uv, found) = bounded(&levels, &rows, &uv, weighting, max_area, control)?;
        convergence.energies.extend(found.energies);
    }
    let convergence = Some(convergence);
    let factor = match scale {
        Scale::Distances => {
            let judged: Vec<[f64; 2]> = levels.judged().iter().map(|&vertex| uv[vertex as usize]).collect();
            best_scale(&judged, &rows, control)?
        }
        Scale::Areas => equal_area_scale(surface.points(), surface.faces(), &uv),
    };
    if factor.is_finite() && factor > 0.0 {
        uv.iter_mut().flatten().for_each(|coordinate| *coordinate *= factor);
    }
    drop((levels, rows));
    match start {
        Some(start) => {
            let onto: Vec<[f64; 2]> = start.counterclockwise(surface)?.into_iter().map(Into::into).collect();
            turn_onto(&uv.clone(), &onto, &mut uv);
        }
        None => orient(surface.points(), map_area(surface.faces(), &uv), &mut uv),
    }
    let distortion = judge(graph, &uv, REFERENCE_SOURCES, seed, control)?;
    let (eigenvalues, planarity) = (scaling.eigenvalues, scaling.planarity);
    Ok(FlatMap { uv, normals: surface.normals(), sources, eigenvalues, planarity, distortion, convergence, rows: None })
}

/// How a map is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options<'a> {
    /// From 0, where near distances and shapes count most, to 1, where far distances do.
    pub weighting: f64,
    /// A map that is known, from which descent goes on; the map is turned as this one lies.
    pub start: Option<Start<'a>>,
    /// By which factor no triangle may change its area, against that of the whole, or as near to that as can be had: see
    /// [`bounded`]. More than 1.
    pub max_area: Option<f64>,
    /// What the map's mm are.
    pub scale: Scale,
}

impl Default for Options<'_> {
    fn default() -> Self {
        Self { weighting: 0.5, start: None, max_area: None, scale: Scale::Distances }
    }
}

/// What a map's mm are: a surface that is not flat has none that are right for both.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scale {
    /// Distances are right on average: the mean relative error of those from the sources is the least of any scale.
    Distances,
    /// The map's area is that of the surface.
    Areas,
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

/// What exact distances from a few sources take of a vertex, bytes: the faces laid flat, and what each thread knows of vertices and
/// edges. Distances along links are compared with them before the map is made.
const FLAT_FACES_BYTES: u64 = 260;
const WAVE_BYTES: u64 = 160;

/// The memory in bytes that [`voxflat`] needs at most beside the surface's input, for a surface of `points` vertices: what stays all the
/// time, and the most that one of the stages takes, the links' making, the comparison with exact distances, rows, descent, and judging.
pub fn memory_need(points: usize, sources: usize, threads: usize, rows: AfterPlacing) -> u64 {
    let (vertices, workers) = (points as u64, threads as u64);
    let searches = workers * BundleScratch::memory_need(points);
    let kept = if rows == AfterPlacing::Kept { 4 * vertices * sources as u64 } else { 0 };
    let storing = if rows == AfterPlacing::Stored { store::memory_need(points, sources, threads) } else { 0 };
    let comparing = (FLAT_FACES_BYTES + workers * WAVE_BYTES) * vertices;
    let descent = kept + classical::memory_need(sources) + levels::memory_need(points, sources);
    let judging = kept + searches + judge::memory_need(points);
    let measuring = kept + searches.max(storing);
    let stages = [comparing, measuring, descent, judging].into_iter().max().unwrap_or(0);
    BASE_BYTES
        + Surface::memory_need(points)
        + FlatMap::memory_need(points)
        + PYTHON_BYTES * vertices
        + GeodesicGraph::memory_need(points).max(GeodesicGraph::size(points) + stages)
}
