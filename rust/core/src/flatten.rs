//! Whole methods, composed from the stages.

pub mod links;
pub mod relaxation;
pub mod saucan;
pub mod schwartz;
pub mod zigelman;

use nalgebra::Vector3;

use crate::adjacency::{Graph, Links};
use crate::control::Control;
use crate::distortion::{self, Distortion, measure};
use crate::embed::classical::classical_scaling;
use crate::embed::stress::levels::{self, Convergence};
use crate::error::{Error, Result};
use crate::geodesic::Solver;
use crate::geodesic::chain::{ChainWeights, LinkLengths};
use crate::geodesic::engine::Engine;
use crate::geodesic::graph::{self, GeodesicGraph};
use crate::orient::{handedness, orient, outward_normals};
use crate::patch::{self, Patch};
use crate::place::radial::RadialFunctions;
use crate::rows::{DistanceRows, PassingRows, Rows};
use crate::sources::{self, FEWEST_SOURCES, Sources};
use crate::store;
use crate::surface::cubes::CubeTopology;
use crate::surface::{Surface, VoxelSurface};

/// Reference sources from which the distortion is measured.
pub const REFERENCE_SOURCES: usize = 200;

/// Memory in bytes that rows from the reference sources take at most.
pub const KEPT_BYTES: u64 = 256 << 20;

/// A flat map of the points of a surface.
#[derive(Debug, Clone)]
pub struct FlatMap {
    /// The place of each point in the plane, mm.
    pub uv: Vec<[f64; 2]>,
    /// Unit normals (RAS+ mm) that point outside; NaN where there is no outside.
    pub normals: Vec<Vector3<f64>>,
    /// The sources, as vertices of the surface.
    pub sources: Vec<u32>,
    /// The eigenvalues of the scaling, mm², by falling magnitude.
    pub eigenvalues: Vec<f64>,
    /// The share of Σ λ² that the plane carries.
    pub planarity: f64,
    /// What flattening did to the distances.
    pub distortion: Distortion,
    /// How descent went, where the method descends.
    pub convergence: Option<Convergence>,
}

/// The 26-neighbour graph of a surface.
///
/// # Errors
/// As [`ChainWeights::new`] and [`Graph::of_voxels`].
pub fn chain_graph(surface: &VoxelSurface, lengths: LinkLengths, control: &Control) -> Result<Graph> {
    let weights = ChainWeights::new(surface.affine().spacing(), lengths)?;
    Graph::of_voxels(surface, weights.lengths(), control)
}

/// What is to be flattened of a surface, with its graph: the patch, or the largest component where none is given.
///
/// # Errors
/// Those of [`patch`]; [`Error::Disconnected`] if a given patch falls into pieces.
pub fn cut_out(
    surface: &VoxelSurface,
    patch: &Patch<'_>,
    lengths: LinkLengths,
    control: &Control,
) -> Result<(VoxelSurface, Graph)> {
    control.begin("cutting out the patch", 1);
    let mut part = match patch.keep {
        Some(mask) => patch::keep(surface, mask)?,
        None => surface.clone(),
    };
    let mut graph = chain_graph(&part, lengths, control)?;
    if let Some(disk) = patch.disk {
        part = patch::geodesic_disk(&part, &graph, disk, control)?;
        graph = chain_graph(&part, lengths, control)?;
    }
    let components = graph.components();
    if components.sizes.len() > 1 {
        if patch.keep.is_some() {
            return Err(Error::Disconnected { count: components.sizes.len(), sizes: components.describe() });
        }
        part = patch::largest_component(&part, &graph);
        graph = chain_graph(&part, lengths, control)?;
    }
    Ok((part, graph))
}

/// Can this connected surface be flattened?
///
/// # Errors
/// [`Error::TooFewPoints`], [`Error::Closed`], [`Error::Cancelled`].
pub fn check_flattenable(surface: &VoxelSurface, control: &Control) -> Result<CubeTopology> {
    let points = surface.len();
    if points < FEWEST_SOURCES {
        return Err(Error::TooFewPoints { points, needed: FEWEST_SOURCES });
    }
    let topology = CubeTopology::of(surface, control)?;
    if topology.is_closed() {
        return Err(Error::Closed { points, touching: topology.lining, euler: topology.euler });
    }
    Ok(topology)
}

/// Flattens a connected part of a voxel surface after Grossmann, Kiryati and Kimmel (2002): chain-code geodesics, classical
/// scaling of the sources, radial functions for the rest.
///
/// # Errors
/// Those of [`check_flattenable`] and of the stages.
pub fn grossmann2002(
    surface: &VoxelSurface,
    graph: &Graph,
    sources: &Sources,
    seed: u64,
    control: &Control,
) -> Result<FlatMap> {
    check_flattenable(surface, control)?;
    let sources = sources.choose(graph, control)?;
    if sources.len() < FEWEST_SOURCES {
        return Err(Error::TooFewSources { sources: sources.len(), needed: FEWEST_SOURCES });
    }
    let engine = Engine::new(graph, sources.len() + REFERENCE_SOURCES, control)?;
    let among = DistanceRows::among_by(&engine, &sources, control)?;
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
    })
}

/// Flattens a connected surface by distance rows from sources on it, of whatever solver: the map of least stress whose triangles
/// keep their shape, from coarse to fine. No triangle is turned over. `weighting` leads from 0, where near distances and
/// shapes count most, to 1, where far distances do. The map is judged by the engine's distances.
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
    Ok(FlatMap { uv, normals: surface.normals(), sources, eigenvalues, planarity, distortion, convergence })
}

/// Can this surface be flattened as it is?
///
/// # Errors
/// [`Error::TooFewPoints`], [`Error::NotADisk`].
pub fn check_disk(surface: &Surface) -> Result<()> {
    if surface.len() < FEWEST_SOURCES {
        return Err(Error::TooFewPoints { points: surface.len(), needed: FEWEST_SOURCES });
    }
    let (_, components) = surface.components();
    let loops = surface.boundary().len();
    let euler = (surface.len() + surface.faces().len()) as i64 - surface.edges().count() as i64;
    if components != 1 || euler != 1 {
        let handles = (2 * components as i64 - euler - loops as i64) / 2;
        return Err(Error::NotADisk { components, loops, handles: handles.max(0) as usize, euler });
    }
    Ok(())
}

/// The signed area of a map, mm²: positive if most of its faces run as they do on the surface.
pub fn map_area(faces: &[[u32; 3]], uv: &[[f64; 2]]) -> f64 {
    let double = |face: &[u32; 3]| {
        let [[ax, ay], [bx, by], [cx, cy]] = face.map(|v| uv[v as usize]);
        (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    };
    0.5 * faces.iter().map(double).sum::<f64>()
}

/// What a map does to the distances from `count` random reference sources.
///
/// # Errors
/// [`Error::Unreachable`], [`Error::Cancelled`].
pub fn judge<S: Solver>(
    engine: &Engine<S>,
    uv: &[[f64; 2]],
    count: usize,
    seed: u64,
    control: &Control,
) -> Result<Distortion> {
    let reference = reference_sources(uv.len(), count, seed);
    Ok(judge_all(engine, &[uv], &reference, KEPT_BYTES, seed, control)?.remove(0))
}

/// Random reference sources, other ones than a map of the same seed has.
pub fn reference_sources(points: usize, count: usize, seed: u64) -> Vec<u32> {
    sources::random(points, points.min(count), seed.wrapping_add(1))
}

/// What several maps of the same vertices do to the distances from the same sources. If their rows take more than `kept` bytes,
/// they are computed twice instead of being kept; the figures are the same.
///
/// # Errors
/// [`Error::Unreachable`], [`Error::Cancelled`].
pub fn judge_all<S: Solver>(
    engine: &Engine<S>,
    maps: &[&[[f64; 2]]],
    reference: &[u32],
    kept: u64,
    seed: u64,
    control: &Control,
) -> Result<Vec<Distortion>> {
    if 4 * reference.len() as u64 * engine.columns() as u64 <= kept {
        measure(maps, &DistanceRows::by(engine, reference, control)?, seed, control)
    } else {
        measure(maps, &PassingRows::new(engine, reference, kept), seed, control)
    }
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

/// What judging a map needs at most: rows, no fewer than one, and what is made of them.
fn reference_memory_need(points: u64) -> u64 {
    let rows = 4 * points * points.min(REFERENCE_SOURCES as u64);
    rows.min(KEPT_BYTES.max(4 * points)) + distortion::WORK_BYTES
}

/// What is needed whatever the size: threads, buffers, the allocator's reserve.
const BASE_BYTES: u64 = 16 << 20;

/// The memory in bytes that [`voxflat`] needs at most beside the surface's input, for a surface of `points` vertices; with
/// rows in memory, or in a store.
pub fn surface_memory_need(points: usize, sources: usize, threads: usize, stored: bool) -> u64 {
    let in_flight = store::memory_need(points, sources, threads);
    let graph = graph::memory_need(points);
    let [points, sources, threads] = [points, sources, threads].map(|n| n as u64);
    let surface = (24 + 4 + 2 * (12 + 12) + 24 + 16 + 8 + 100) * points; // and what Python makes of it
    let reference = reference_memory_need(points);
    let rows = reference.max(if stored { in_flight } else { 4 * points * sources });
    let scaling = (4 + 8 + 8) * sources * sources;
    let workers = threads * (4 + 16) * points;
    let shortcuts = if stored { store::TABLE_BYTES } else { 8 * SURFACE_SHORTCUTS * points }; // and the tables they are found in: less than the rows, and before them
    let descent = DESCENT_BYTES * points + 8 * points.min(levels::MOST_JUDGED as u64) * sources;
    BASE_BYTES + graph + surface + workers + rows + scaling + shortcuts + descent
}

/// What descent needs for a vertex: past steps, a factored matrix of springs, triangles, and coarser surfaces.
const DESCENT_BYTES: u64 = 2600;

/// Usual number of shortcuts of a vertex of a surface, where many sources are prepared for.
const SURFACE_SHORTCUTS: u64 = 220;

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
