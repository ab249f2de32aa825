//! The default method: optimisation of distances and triangles, from coarse to fine.

use super::check::check_domain;
use super::map::{BASE_BYTES, FlatMap, PYTHON_BYTES};
use crate::distortion::evaluate::{self, REFERENCE_SOURCES, evaluate};
use crate::distortion::{Evaluation, best_scale, faces::equal_area_scale};
use crate::embed::classical::{self, classical_scaling};
use crate::embed::stress::area_bound::bounded;
use crate::embed::stress::exact::exact;
use crate::embed::stress::levels::{self, Levels};
use crate::embed::stress::start::{Start, flatten_from};
use crate::geodesic::bend::{MarkedRows, Marking};
use crate::geodesic::{bundle::BundleScratch, graph::GeodesicGraph};
use crate::orient::{map_area, orient, turn_onto};
use crate::rows::Rows;
use crate::sources::check_enough;
use crate::surface::Surface;
use crate::{Control, Result, store};

/// Flattens a disk or a disk with holes, given its levels and the distances on them by any solver: minimises stress and the distortion of
/// triangles, from coarse to fine. No triangle is flipped. Finally, the map is scaled and evaluated by distances along
/// the graph; levels and rows are dropped before.
///
/// # Errors
/// [`Error::NotADisk`](crate::Error::NotADisk), [`Error::TooFewSources`](crate::Error::TooFewSources),
/// [`Error::ForeignRows`](crate::Error::ForeignRows); [`Error::NotPlanar`](crate::Error::NotPlanar) if the distances
/// describe a line or a point; [`Error::Folded`](crate::Error::Folded) if triangles are too thin for their areas to
/// differ from zero; [`Error::Uneven`](crate::Error::Uneven) if edge lengths vary too much; the errors that begin with
/// `Start` if the given start cannot be used; and [`Error::Cancelled`](crate::Error::Cancelled).
pub fn voxflat(
    mut levels: Levels, rows: MarkedRows, &Options { weighting, start, max_area, scale }: &Options,
    graph: &GeodesicGraph, evaluation: Evaluation, control: &Control,
) -> Result<FlatMap> {
    let surface = levels.finest();
    check_domain(surface)?;
    let sources = levels.landmarks().to_vec();
    check_enough(sources.len())?;
    let rows = rows.into_rows();
    levels.check_rows(&rows)?;
    control.begin("classical scaling", 1);
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
    let exact = exact(&levels, &rows, &uv, weighting, control)?;
    let is_exact = exact.is_some();
    uv = exact.unwrap_or(uv);
    let factor = match scale {
        Scale::Distances if is_exact => 1.0,
        Scale::Distances => {
            let evaluated: Vec<[f64; 2]> = levels.evaluated().iter().map(|&vertex| uv[vertex as usize]).collect();
            best_scale(&evaluated, None, &rows, control)?
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
            turn_onto(&uv.clone(), &onto, &mut uv)?;
        }
        None => orient(surface.points(), map_area(surface.faces(), &uv), &mut uv),
    }
    let distortion = evaluate(&Marking::new(graph), &uv, REFERENCE_SOURCES, evaluation, control)?;
    let (eigenvalues, planarity) = (scaling.eigenvalues, scaling.planarity);
    Ok(FlatMap { uv, normals: surface.normals(), sources, eigenvalues, planarity, distortion, convergence, rows: None })
}

/// Options of the default method.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options<'a> {
    /// From 0, which favours near distances and shapes, to 1, which favours far distances.
    pub weighting: f64,
    /// A known map from which the optimisation starts; the result is rotated to match it.
    pub start: Option<Start<'a>>,
    /// The maximum factor by which the area of a triangle may change relative to the whole map; the bound is approached
    /// as closely as possible. Greater than 1.
    pub max_area: Option<f64>,
    /// The scale of the map.
    pub scale: Scale,
}

impl Default for Options<'_> {
    fn default() -> Self {
        Self { weighting: 0.5, start: None, max_area: None, scale: Scale::Distances }
    }
}

/// How a map is scaled. No scale is right for both the distances and the areas of a curved surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scale {
    /// The scale with the smallest mean relative error of the distances from the sources, those of interior pairs.
    Distances,
    /// The scale that preserves the total area.
    Areas,
}

/// How rows from the sources are stored after placement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AfterPlacing {
    /// They are dropped, which makes room for the rows of the reference sources.
    Dropped,
    /// They stay in memory.
    Kept,
    /// They are kept on disk, in a store.
    Stored,
}

/// The memory per vertex of exact distances from a few sources, in bytes: faces unfolded into the plane, and each
/// thread's data on vertices and edges. They are compared with distances along links before the map is made.
const FLAT_FACES_BYTES: u64 = 260;
const WAVE_BYTES: u64 = 160;

/// Returns the maximum memory in bytes of [`voxflat`] beside the surface's input, for a surface of `points` vertices:
/// the permanent part, and the maximum over the stages (links, exact distances, rows, optimisation, figures).
pub fn memory_need(points: usize, sources: usize, threads: usize, rows: AfterPlacing) -> u64 {
    let (vertices, workers) = (points as u64, threads as u64);
    let searches = workers * (BundleScratch::memory_need(points) + Marking::memory_need(points));
    let kept = if rows == AfterPlacing::Kept { 4 * vertices * sources as u64 } else { 0 };
    let storing = if rows == AfterPlacing::Stored { store::memory_need(points, sources, threads) } else { 0 };
    let comparing = (FLAT_FACES_BYTES + workers * WAVE_BYTES) * vertices;
    let descent = kept + classical::memory_need(sources) + levels::memory_need(points, sources);
    let evaluating = kept + searches + evaluate::memory_need(points);
    let measuring = kept + searches.max(storing);
    let stages = [comparing, measuring, descent, evaluating].into_iter().max().unwrap_or(0);
    BASE_BYTES
        + Surface::memory_need(points)
        + FlatMap::memory_need(points)
        + PYTHON_BYTES * vertices
        + GeodesicGraph::memory_need(points).max(GeodesicGraph::size(points) + stages)
}
