//! Flattening by Schwartz, Shaw and Wolfson (1989): the generalised mapmaker's problem.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::check::check_disk;
use super::map::FlatMap;
use super::voxflat::{self, AfterPlacing};
use crate::distortion::evaluate::{REFERENCE_SOURCES, evaluate};
use crate::distortion::{Bands, Evaluation};
use crate::embed::sammon::{self, Descended, MOST_STEPS};
use crate::embed::{classical::classical_scaling, stress::levels::Convergence};
use crate::geodesic::neighbourhood::{Neighbourhoods, sizes_of_rings};
use crate::geodesic::{bend::Marking, graph::GeodesicGraph};
use crate::orient::{map_area, orient};
use crate::rows::DistanceRows;
use crate::sources::{FEWEST_SOURCES, Sources};
use crate::surface::Surface;
use crate::{Control, Error, Result};

/// The share of the surface in a neighbourhood: "roughly 10 percent of the surface area of the entire problem".
const SHARE: f64 = 0.1;

/// The minimum number of vertices in a neighbourhood, if there are as many: a tenth can be too few.
const SMALLEST: f64 = 100.0;

/// The distances that are preserved, and the start of the optimisation.
#[derive(Debug, Clone)]
pub struct Options<'a> {
    /// The number of rings in a neighbourhood; None for all pairs of vertices.
    pub rings: Option<u32>,
    /// Vertices whose distances to all others are preserved too.
    pub sources: &'a [u32],
    /// The number of random starts; the map with the smallest stress is kept.
    pub starts: u32,
    /// The seed of the random starts and of the reference sources.
    pub seed: u64,
    /// The distance bands of the figures.
    pub bands: Bands,
    /// Whether the map keeps the rows from the sources.
    pub keep_rows: bool,
}

/// A flat map, and the outcome of each start.
#[derive(Debug, Clone)]
pub struct Mapped {
    /// The map with the smallest stress.
    pub map: FlatMap,
    /// The final stress of each start.
    pub stresses: Vec<f64>,
    /// The number of preserved distances.
    pub pairs: usize,
}

/// Flattens a disk by the method of Schwartz, Shaw and Wolfson (1989): exact distances within neighbourhoods and from a
/// few sources, and Newton steps along each coordinate, from random starts, to the map with the smallest stress. All
/// vertices take part.
///
/// # Errors
/// [`Error::NotADisk`], [`Error::NoStarts`] if there is no start, the errors of [`Sources::choose`] and
/// [`Neighbourhoods::measure`], and [`Error::NotPlanar`] if the distances among the sources describe a line or a point.
pub fn schwartz1989(
    surface: &Surface, graph: &GeodesicGraph, options: &Options<'_>, control: &Control,
) -> Result<Mapped> {
    check_disk(surface)?;
    let sources = Sources::Given(options.sources.iter().map(|&v| v as usize).collect()).choose(graph, control)?;
    let (pairs, rows) = Neighbourhoods::measure(surface, options.rings, &sources, options.keep_rows, control)?;
    let rows = rows.map(|rows| DistanceRows::new(sources.clone(), surface.len(), rows));
    let (eigenvalues, planarity) = spectrum(&pairs, &sources)?;
    let (best, stresses) = best_of_starts(surface, &pairs, options, control)?;
    let Descended { mut uv, stresses: energies, converged, .. } = best;
    orient(surface.points(), map_area(surface.faces(), &uv), &mut uv);
    let (kept, convergence) = (pairs.pairs(), Some(Convergence { energies, converged }));
    drop(pairs);
    let evaluation = Evaluation { bands: options.bands, seed: options.seed };
    let distortion = evaluate(&Marking::new(graph), &uv, REFERENCE_SOURCES, evaluation, control)?;
    let map =
        FlatMap { uv, normals: surface.normals(), sources, eigenvalues, planarity, distortion, convergence, rows };
    Ok(Mapped { map, stresses, pairs: kept })
}

/// Optimises from every start, and returns the result with the smallest stress and the stresses of all starts.
fn best_of_starts(
    surface: &Surface, pairs: &Neighbourhoods, options: &Options<'_>, control: &Control,
) -> Result<(Descended, Vec<f64>)> {
    let side = surface.areas().iter().sum::<f64>().sqrt();
    let mut best: Option<Descended> = None;
    let mut stresses = Vec::new();
    for start in 0..options.starts {
        control.begin("optimising from a random start", MOST_STEPS as u64 + 1);
        let found = sammon::descend(pairs, scattered(surface.len(), side, options.seed, start), control)?;
        stresses.push(found.least);
        if best.as_ref().is_none_or(|best| found.least < best.least) {
            best = Some(found);
        }
    }
    Ok((best.ok_or(Error::NoStarts)?, stresses))
}

fn scattered(points: usize, side: f64, seed: u64, start: u32) -> Vec<[f64; 2]> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(u64::from(start));
    (0..points).map(|_| std::array::from_fn(|_| side * (rng.random::<f64>() - 0.5))).collect()
}

/// Returns the planarity of the distances among the sources; NaN if there are too few sources.
fn spectrum(pairs: &Neighbourhoods, sources: &[u32]) -> Result<(Vec<f64>, f64)> {
    if sources.len() < FEWEST_SOURCES {
        return Ok((Vec::new(), f64::NAN));
    }
    let mut among = Vec::with_capacity(sources.len() * sources.len());
    for &source in sources {
        let row = pairs.of_vertex(source as usize);
        let distance =
            |other: &u32| row.binary_search_by_key(other, |near| near.vertex).map_or(0.0, |n| row[n].distance);
        among.extend(sources.iter().map(distance));
    }
    let scaling = classical_scaling(&DistanceRows::new(sources.to_vec(), sources.len(), among))?;
    Ok((scaling.eigenvalues, scaling.planarity))
}

/// Returns the smallest number of rings with which neighbourhoods contain on average a tenth of the vertices, and at
/// least a hundred vertices if there are so many.
///
/// # Errors
/// [`Error::Cancelled`].
pub fn usual_rings(surface: &Surface, control: &Control) -> Result<u32> {
    control.begin("counting neighbours", 1);
    let vertices = surface.len() as f64;
    let wanted = (SHARE * vertices).max(SMALLEST.min(vertices));
    let mut rings = 1;
    // neighbourhoods are small compared with the surface, so the search need not reach its far end
    for most in std::iter::successors(Some(16), |most| Some(2 * most)) {
        let sizes = sizes_of_rings(surface, Some(most), control)?;
        rings = sizes.len().max(1) as u32;
        if let Some(enough) = sizes.iter().position(|&size| size >= wanted) {
            return Ok(enough as u32 + 1);
        }
        if sizes.len() < most as usize {
            break;
        }
    }
    Ok(rings)
}

/// The memory per distance in bytes, counted from both ends: as measured, and as merged.
const PAIR_BYTES: f64 = 2.0 * 16.0;

/// The memory per vertex in bytes, without distances: exact geometry, starts, maps.
const VERTEX_BYTES: u64 = 1500;

/// The memory per vertex and thread of exact distances, in bytes.
const WAVE_BYTES: u64 = 400;

/// Returns the maximum memory in bytes of [`schwartz1989`] beside the surface's input. Neighbourhoods are sampled.
///
/// # Errors
/// [`Error::Cancelled`].
pub fn memory_need(
    surface: &Surface, rings: Option<u32>, sources: usize, threads: usize, control: &Control,
) -> Result<u64> {
    let points = surface.len();
    let near = match rings {
        Some(_) => sizes_of_rings(surface, rings, control)?.last().copied().unwrap_or(1.0),
        None => points as f64,
    };
    let near = (1.05 * near + 2.0 * sources as f64).min(points as f64); // estimated from a sample
    let pairs = 0.5 * near * points as f64;
    let others = voxflat::memory_need(points, REFERENCE_SOURCES, threads, AfterPlacing::Dropped);
    Ok(others + (PAIR_BYTES * pairs) as u64 + (VERTEX_BYTES + WAVE_BYTES * threads as u64) * points as u64)
}

#[cfg(test)]
mod tests;
