//! One map that is glued of certified patches, after Appleboim, Saucan and Zeevi (2006).

use super::map::{BASE_BYTES, FlatMap, PYTHON_BYTES};
use crate::atlas::glue::{self, Glued, Piece, Seams};
use crate::atlas::{ANGLES, Limit, Seeds, patches};
use crate::control::Control;
use crate::distortion::judge::{self, REFERENCE_SOURCES, judge};
use crate::error::{Error, Result};
use crate::geodesic::bundle::BundleScratch;
use crate::geodesic::graph::GeodesicGraph;
use crate::surface::Surface;
use crate::surface::mesh::BORDER;

/// The angle of the patches, degrees, as in the paper's first figures; less where the bound on C asks for it.
const ANGLE: f64 = 10.0;

/// The part of the angle that a bound allows which is used, so that rounding takes no triangle beyond the bound.
const WITHIN: f64 = 0.999;

/// A map of one piece, and what became of its seams.
#[derive(Debug, Clone)]
pub struct Whole {
    /// The surface, cut open where seams could not be closed; its faces are as they were.
    pub surface: Surface,
    /// The map of that surface.
    pub map: FlatMap,
    /// What became of the seams.
    pub seams: Seams,
    /// Patches that were glued.
    pub patches: usize,
    /// No triangle of the patches had a greater max(σ1, 1/σ2): proven.
    pub certified: f64,
    /// The greatest max(σ1, 1/σ2) that was measured in the patches.
    pub before: f64,
    /// σ1 and σ2 of each face.
    pub stretch: Vec<[f64; 2]>,
}

/// Flattens a surface in certified patches, glues these to one piece such that max(σ1, 1/σ2) ≤ `bound` for every triangle, and cuts
/// the surface open where seams remain. Distances are measured for the figures only, along the graph's links over what was cut.
/// Errors: [`Error::NotOnePiece`] if more than one piece remains, and those of [`patches`], [`glue::glue`] and the stages.
pub fn saucan2006(surface: &Surface, bound: f64, seed: u64, control: &Control) -> Result<Whole> {
    glue::check_bound(bound)?;
    // C of a projection is 1/cos of the angle; patches must be within the bound before they are glued
    let angle = ANGLE.min((WITHIN * bound.recip().acos().to_degrees()).max(ANGLES[0]));
    let atlas = patches(surface, Limit::Angle(angle), Seeds::Curvature, control)?;
    let Glued { pieces, stretch, seams, patches, before, .. } =
        glue::glue(surface, &atlas.labels, &atlas.flat(surface), bound, control)?;
    let certified = atlas.certificate.c;
    drop(atlas);
    let [piece] = &pieces[..] else { return Err(Error::NotOnePiece { bound, pieces: pieces.len() }) };
    let surface = opened(surface, piece);
    let mut uv = vec![[f64::NAN; 2]; surface.len()];
    for (face, rows) in surface.faces().iter().zip(&piece.corners) {
        face.iter().zip(rows).for_each(|(&vertex, &row)| uv[vertex as usize] = piece.uv[row as usize]);
    }
    let graph = GeodesicGraph::new(&surface, control)?;
    let distortion = judge(&graph, &uv, REFERENCE_SOURCES, seed, control)?;
    let map = FlatMap {
        uv,
        normals: surface.normals(),
        sources: Vec::new(),
        eigenvalues: Vec::new(),
        planarity: f64::NAN,
        distortion,
        convergence: None,
        rows: None,
    };
    Ok(Whole { surface, map, seams, patches, certified, before, stretch })
}

/// A surface cut open along the edges whose two sides lie apart in a piece of all its faces.
fn opened(surface: &Surface, piece: &Piece) -> Surface {
    let ends = |half_edge: u32| {
        let rows = piece.corners[half_edge as usize / 3];
        let side = half_edge as usize % 3;
        [rows[side], rows[(side + 1) % 3]]
    };
    let is_apart = |&half_edge: &u32| {
        let twin = surface.twins()[half_edge as usize];
        let reversed = |[a, b]: [u32; 2]| [b, a];
        twin != BORDER && ends(half_edge) != reversed(ends(twin))
    };
    surface.cut_open((0..3 * surface.faces().len() as u32).filter(is_apart))
}

/// What gluing needs for a vertex, bytes: two sheets of places, their springs and what descent keeps of them. It was 2,400 to 3,100 on
/// cortex of 500 and 2,500 vertices; growing patches before needs less.
const GLUING_BYTES: u64 = 4000;

/// The memory in bytes that [`saucan2006`] needs at most beside the surface's input: to glue, and then to judge what was glued.
pub fn memory_need(points: usize, threads: usize) -> u64 {
    let judging = GeodesicGraph::memory_need(points)
        + threads as u64 * BundleScratch::memory_need(points)
        + judge::memory_need(points);
    BASE_BYTES
        + Surface::memory_need(points)
        + FlatMap::memory_need(points)
        + PYTHON_BYTES * points as u64
        + judging.max(GLUING_BYTES * points as u64)
}
