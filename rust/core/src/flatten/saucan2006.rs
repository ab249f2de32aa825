//! One map that is glued from certified patches, by Appleboim, Saucan and Zeevi (2006).

use super::map::{BASE_BYTES, FlatMap, PYTHON_BYTES};
use crate::atlas::glue::{self, Glued, Piece, Seams};
use crate::atlas::{ANGLES, Limit, Seeds, patches};
use crate::distortion::Evaluation;
use crate::distortion::evaluate::{self, REFERENCE_SOURCES, evaluate};
use crate::geodesic::{bend::Marking, bundle::BundleScratch, graph::GeodesicGraph};
use crate::surface::{Surface, mesh::BORDER};
use crate::{Control, Error, Result};

/// The largest angle of the patches in degrees, as in the paper's first figures; less if the bound on C requires it.
const ANGLE: f64 = 10.0;

/// The share of the permitted angle that is used, so that rounding does not move triangles out of the bound.
const WITHIN: f64 = 0.999;

/// A map in one piece, and the outcome of gluing.
#[derive(Debug, Clone)]
pub struct Whole {
    /// The surface, cut open where seams could not be closed; its faces are unchanged.
    pub surface: Surface,
    /// The map of that surface.
    pub map: FlatMap,
    /// The outcome of gluing the seams.
    pub seams: Seams,
    /// The number of patches that were glued.
    pub patches: usize,
    /// The proven upper bound of max(σ1, 1/σ2) over all triangles of the patches.
    pub certified: f64,
    /// The largest max(σ1, 1/σ2) that was measured in the patches.
    pub before: f64,
    /// σ1 and σ2 of each face.
    pub stretch: Vec<[f64; 2]>,
}

/// Flattens a surface in certified patches, glues them into one piece such that max(σ1, 1/σ2) ≤ `bound` for every
/// triangle, and cuts the surface open along the remaining seams. Distances are only used for the evaluation: along the
/// links of the uncut graph.
///
/// # Errors
/// [`Error::NotOnePiece`] if several pieces remain, and the errors of [`patches`] and [`glue::glue`].
pub fn saucan2006(surface: &Surface, bound: f64, evaluation: Evaluation, control: &Control) -> Result<Whole> {
    glue::check_bound(bound)?;
    // C of a projection is 1/cos of the angle, and patches must satisfy the bound before they are glued
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
    let distortion = evaluate(&Marking::new(&graph), &uv, REFERENCE_SOURCES, evaluation, control)?;
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

/// Cuts a surface open along the edges whose two sides are apart in a piece that contains all of its faces.
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

/// The memory per vertex for gluing in bytes: two layouts of positions, their springs and the history of the
/// optimisation. It was 2,400 to 3,100 bytes on cortex of 500 and 2,500 vertices. The growth of patches needs less.
const GLUING_BYTES: u64 = 4000;

/// Returns the maximum memory in bytes of [`saucan2006`] beside the surface's input: gluing, then evaluation.
pub fn memory_need(points: usize, threads: usize) -> u64 {
    let evaluating = GeodesicGraph::memory_need(points)
        + threads as u64 * BundleScratch::memory_need(points)
        + evaluate::memory_need(points);
    BASE_BYTES
        + Surface::memory_need(points)
        + FlatMap::memory_need(points)
        + PYTHON_BYTES * points as u64
        + evaluating.max(GLUING_BYTES * points as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patches_satisfy_the_bound_before_they_are_glued() {
        let pipe = crate::tests::curled(12, 60);
        for bound in [1.004, 1.01, 1.2] {
            let whole = saucan2006(&pipe, bound, Evaluation::default(), &Control::default()).unwrap();
            assert!(whole.patches > 1 && whole.before > 1.0 && whole.before <= bound, "{bound} {}", whole.before);
            assert!(whole.before <= whole.certified);
            let angle = 10f64.min((0.999 / bound).acos().to_degrees());
            let certified = 1.0 + angle.to_radians().tan();
            assert!(bound < 1.1 || (whole.certified - certified).abs() < 1e-12, "{} {certified}", whole.certified);
            assert!(whole.stretch.iter().all(|[most, least]| most.max(least.recip()) <= bound + 1e-9));
        }
    }
}
