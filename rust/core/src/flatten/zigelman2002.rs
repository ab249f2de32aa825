//! Flattening by Zigelman, Kimmel and Kiryati (2002).

use super::check::check_disk;
use super::map::FlatMap;
use super::voxflat::{self, AfterPlacing};
use crate::adjacency::marked;
use crate::distortion::Evaluation;
use crate::distortion::evaluate::{REFERENCE_SOURCES, evaluate};
use crate::embed::classical::{self, classical_scaling};
use crate::error::check_length;
use crate::geodesic::marching::{Marching, Wave};
use crate::geodesic::{bend::Marking, graph::GeodesicGraph};
use crate::orient::{map_area, orient};
use crate::place::bilinear::Lattice;
use crate::place::reinsertion::{self, Placing};
use crate::rows::DistanceRows;
use crate::sources::{Sources, check_enough};
use crate::surface::Surface;
use crate::surface::decimate::{Decimation, Options, decimate};
use crate::{Control, Error, Result};

/// The weight of edge lengths against the quadric error; higher than usual, so that sources are evenly spaced.
const EVENNESS: f64 = 0.1;

/// How the sources are chosen, which also determines how the other vertices are placed.
#[derive(Debug, Clone)]
pub enum Sampling<'a> {
    /// The vertices that remain after decimation to this number; the others are re-inserted.
    Decimation {
        /// The number of vertices.
        count: usize,
    },
    /// Given vertices, which decimation keeps; the others are re-inserted.
    Vertices(&'a [u32]),
    /// The pixels on a lattice of a range image; the others are placed by bilinear interpolation.
    Grid {
        /// The pixel (row, column) of each vertex.
        pixels: &'a [[u32; 2]],
        /// The distance between rows and between columns, in mm.
        spacing: [f64; 2],
        /// The approximate number of sources.
        count: usize,
    },
}

/// How the vertices other than the sources are placed.
enum Rest<'a> {
    Reinserted(Box<Decimation>),
    Between(Lattice<'a>),
}

/// Flattens a disk by the method of Zigelman, Kimmel and Kiryati (2002): fast marching among the sources, classical
/// scaling of the sources, and placement of the other vertices between them. The evaluation uses the graph, as always.
///
/// Vertices that decimation cannot remove without harm to the surface also become sources. The map optionally keeps the
/// distance rows.
///
/// # Errors
/// [`Error::NotADisk`]; [`Error::TooFewSources`], [`Error::TooManySources`], [`Error::NoSuchPoint`] or
/// [`Error::DuplicateSource`] of the sampling; [`Error::WrongLength`] or [`Error::NoCell`] of a grid;
/// [`Error::NotPlanar`] if the distances describe a line or a point; and [`Error::Cancelled`].
pub fn zigelman2002(
    surface: &Surface, graph: &GeodesicGraph, sampling: &Sampling<'_>, wave: Wave, evaluation: Evaluation,
    keep_rows: bool, control: &Control,
) -> Result<FlatMap> {
    check_disk(surface)?;
    let (sources, rest) = sample(surface, graph, sampling, control)?;
    let marching = Marching::new(surface, wave, control)?;
    let (among, rows) = DistanceRows::among_sources(&marching, &sources, keep_rows, control)?;
    drop(marching);
    control.begin("classical scaling", 1);
    let scaling = classical_scaling(&among)?;
    drop(among);
    control.check()?;
    let mut uv = match rest {
        Rest::Between(lattice) => lattice.place(&scaling.places, control)?,
        Rest::Reinserted(decimation) => reinserted(&decimation, surface.len(), &sources, &scaling.places, control)?,
    };
    orient(surface.points(), map_area(surface.faces(), &uv), &mut uv);
    let distortion = evaluate(&Marking::new(graph), &uv, REFERENCE_SOURCES, evaluation, control)?;
    let (eigenvalues, planarity) = (scaling.eigenvalues, scaling.planarity);
    Ok(FlatMap { uv, normals: surface.normals(), sources, eigenvalues, planarity, distortion, convergence: None, rows })
}

fn sample<'a>(
    surface: &Surface, graph: &GeodesicGraph, sampling: &Sampling<'a>, control: &Control,
) -> Result<(Vec<u32>, Rest<'a>)> {
    let points = surface.len();
    let checked = |count: usize| {
        check_enough(count)?;
        if count > points { Err(Error::TooManySources { sources: count, points }) } else { Ok(count) }
    };
    let left = |keep: &[u32], vertices: usize| {
        let options = Options { vertices, evenness: EVENNESS, ..Options::default() };
        decimate(surface, keep, &options, control)
    };
    match *sampling {
        Sampling::Decimation { count } => {
            let decimation = left(&[], checked(count)?)?;
            Ok((decimation.survivors.clone(), Rest::Reinserted(Box::new(decimation))))
        }
        Sampling::Vertices(vertices) => {
            let given = Sources::Given(vertices.iter().map(|&v| v as usize).collect());
            let mut sources = given.choose(graph, control)?;
            let decimation = left(&sources, checked(sources.len())?)?;
            let is_source = marked(points, &sources);
            sources.extend(decimation.survivors.iter().filter(|&&v| !is_source[v as usize]));
            Ok((sources, Rest::Reinserted(Box::new(decimation))))
        }
        Sampling::Grid { pixels, spacing, count } => {
            check_length("pixels", pixels.len(), "vertices", points)?;
            let lattice = Lattice::new(pixels, spacing, checked(count)?)?;
            Ok((lattice.sources().to_vec(), Rest::Between(lattice)))
        }
    }
}

/// Returns the positions of all vertices, given those of the sources, which are the vertices that decimation left.
fn reinserted(
    decimation: &Decimation, points: usize, sources: &[u32], places: &[[f64; 2]], control: &Control,
) -> Result<Vec<[f64; 2]>> {
    let mut uv = vec![[f64::NAN; 2]; points];
    sources.iter().zip(places).for_each(|(&source, &place)| uv[source as usize] = place);
    let coarse: Vec<[f64; 2]> = decimation.survivors.iter().map(|&v| uv[v as usize]).collect();
    let is_mirrored = map_area(decimation.surface.faces(), &coarse) < 0.0;
    let placing = Placing { is_mirrored, ..Default::default() };
    reinsertion::place(&decimation.removals, &mut uv, &placing, control)?;
    Ok(uv)
}

/// The memory per vertex of fast marching and decimation, in bytes: about twelve fronts of 20 bytes, and a copy of the
/// surface during decimation, with the errors and weights of removed vertices.
const WORK_BYTES: u64 = 1500;

/// Returns the maximum memory in bytes of [`zigelman2002`] beside the surface's input: that of
/// [`voxflat`](super::voxflat()) for the reference sources, and that of fast marching, decimation, and scaling.
pub fn memory_need(points: usize, sources: usize, threads: usize) -> u64 {
    let evaluated = voxflat::memory_need(points, REFERENCE_SOURCES, threads, AfterPlacing::Dropped);
    evaluated + WORK_BYTES * points as u64 + classical::memory_need(sources)
}

#[cfg(test)]
mod tests;
