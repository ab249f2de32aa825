//! Flattening after Zigelman, Kimmel and Kiryati (2002).

use super::check::check_disk;
use super::map::FlatMap;
use super::voxflat::{self, AfterPlacing};
use crate::adjacency::marked;
use crate::control::Control;
use crate::distortion::judge::{REFERENCE_SOURCES, judge};
use crate::embed::classical::{self, classical_scaling};
use crate::error::{Error, Result};
use crate::geodesic::graph::GeodesicGraph;
use crate::geodesic::marching::{Marching, Wave};
use crate::orient::{map_area, orient};
use crate::place::bilinear::Lattice;
use crate::place::reinsertion::{self, Placing};
use crate::rows::DistanceRows;
use crate::sources::{Sources, check_enough};
use crate::surface::Surface;
use crate::surface::decimate::{Decimation, Options, decimate};

/// Against the quadric error edges count more than usual: sources are to lie evenly.
const EVENNESS: f64 = 0.1;

/// Which vertices are the sources, which decides how the rest is placed.
#[derive(Debug, Clone)]
pub enum Sampling<'a> {
    /// What decimation to so many vertices leaves; the rest comes back by re-insertion.
    Decimation {
        /// How many.
        count: usize,
    },
    /// Any vertices; decimation leaves them, the rest comes back by re-insertion.
    Vertices(&'a [u32]),
    /// The pixels on a lattice of a range image; the rest is placed between them by bilinear functions.
    Grid {
        /// The pixel (row, column) that each vertex is.
        pixels: &'a [[u32; 2]],
        /// Distance of rows and of columns, mm.
        spacing: [f64; 2],
        /// About how many.
        count: usize,
    },
}

/// How the vertices that are no sources are placed.
enum Rest<'a> {
    Reinserted(Box<Decimation>),
    Between(Lattice<'a>),
}

/// Flattens a disk after Zigelman, Kimmel and Kiryati (2002): fast marching among the sources, classical scaling of them, and
/// the rest between them. Distances for the figures are those of the graph, as for every other map.
///
/// Vertices that decimation cannot take away without harm to the surface become sources, too. The rows from the sources are kept
/// in the map if so wished.
/// Panics if there is not one pixel a vertex.
pub fn zigelman2002(
    surface: &Surface,
    graph: &GeodesicGraph,
    sampling: &Sampling<'_>,
    wave: Wave,
    seed: u64,
    keep_rows: bool,
    control: &Control,
) -> Result<FlatMap> {
    check_disk(surface)?;
    let (sources, rest) = sample(surface, graph, sampling, control)?;
    let marching = Marching::new(surface, wave, control)?;
    let (among, rows) = DistanceRows::among_sources(&marching, &sources, keep_rows, control)?;
    drop(marching);
    control.begin("scaling", 1);
    let scaling = classical_scaling(&among)?;
    drop(among);
    control.check()?;
    let mut uv = match rest {
        Rest::Between(lattice) => lattice.place(&scaling.places, control)?,
        Rest::Reinserted(decimation) => reinserted(&decimation, surface.len(), &sources, &scaling.places, control)?,
    };
    orient(surface.points(), map_area(surface.faces(), &uv), &mut uv);
    let distortion = judge(graph, &uv, REFERENCE_SOURCES, seed, control)?;
    let (eigenvalues, planarity) = (scaling.eigenvalues, scaling.planarity);
    Ok(FlatMap { uv, normals: surface.normals(), sources, eigenvalues, planarity, distortion, convergence: None, rows })
}

fn sample<'a>(
    surface: &Surface,
    graph: &GeodesicGraph,
    sampling: &Sampling<'a>,
    control: &Control,
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
            assert_eq!(pixels.len(), points, "one pixel a vertex");
            let lattice = Lattice::new(pixels, spacing, checked(count)?)?;
            Ok((lattice.sources().to_vec(), Rest::Between(lattice)))
        }
    }
}

/// The places of all vertices from those of the sources, which are what decimation left.
fn reinserted(
    decimation: &Decimation,
    points: usize,
    sources: &[u32],
    places: &[[f64; 2]],
    control: &Control,
) -> Result<Vec<[f64; 2]>> {
    let mut uv = vec![[f64::NAN; 2]; points];
    sources.iter().zip(places).for_each(|(&source, &place)| uv[source as usize] = place);
    let coarse: Vec<[f64; 2]> = decimation.survivors.iter().map(|&v| uv[v as usize]).collect();
    let is_mirrored = map_area(decimation.surface.faces(), &coarse) < 0.0;
    let placing = Placing { is_mirrored, ..Default::default() };
    reinsertion::place(&decimation.removals, &mut uv, &placing, control)?;
    Ok(uv)
}

/// What fast marching and decimation keep of a vertex, bytes: fronts of 20 bytes, some twelve of them, the surface again as it
/// loses vertices, with the errors and the weights of what is removed.
const WORK_BYTES: u64 = 1500;

/// The memory in bytes that [`zigelman2002`] needs at most beside the surface's input: what [`voxflat`](super::voxflat()) needs
/// from as many sources as judge the map, fast marching, decimation, and scaling.
pub fn memory_need(points: usize, sources: usize, threads: usize) -> u64 {
    let judged = voxflat::memory_need(points, REFERENCE_SOURCES, threads, AfterPlacing::Dropped);
    judged + WORK_BYTES * points as u64 + classical::memory_need(sources)
}

#[cfg(test)]
mod tests;
