//! Gluing of certified patches: the open problem of Appleboim, Saucan and Zeevi (2006).
//!
//! Each patch is certified, but between their planes there are seams, so that a picture of the patches has holes. Here,
//! adjacent patches are placed so that their common edges meet. Pieces are united along their longest common
//! boundaries: the smaller piece is moved rigidly to where the boundaries fit best, and common positions are merged.
//! The surroundings are moved until every triangle is within a bound C on max(σ1, 1/σ2), with low distortion energy. If
//! the bound cannot be reached, or if the piece would overlap itself, the step is undone, and a cut remains. Then the
//! remaining cuts are tried again in parts, and finally the distortion of every piece is minimised, so that a
//! developable surface is flattened without distortion.
//!
//! Each step checks that all triangles are within the bound, upright and free of overlaps. A final check uses exact
//! predicates; a piece that failed it would be divided into its patches again.

mod border;
mod layout;
mod merge;
mod retry;
mod seams;
mod settle;
mod strain;

use std::collections::HashMap;

use super::facets::Facets;
use super::{ANGLES, Atlas};
use crate::adjacency::distinct;
use crate::distortion::{faces::stretch_of, overlap::overlaps};
use crate::embed::stress::descent::Until;
use crate::error::check_length;
use crate::surface::Surface;
use crate::{Control, Error, Result};
use layout::Layout;
use seams::{Gluing, Obstacle};
use settle::are_within;

/// The smallest and the largest bound on C.
pub(crate) const BOUNDS: [f64; 2] = [1.000_001, 10.0];

/// The final optimisation of each piece ends when the energy hardly decreases, or no triangle is distorted.
const LAST: Until = Until { steps: 40, gain: 1e-6, enough: 1e-16 };

/// The number of such optimisations.
const TIMES: usize = 10;

/// Glued patches in the plane. A vertex that lies on both sides of a cut occurs more than once.
#[derive(Debug, Clone, PartialEq)]
pub struct Piece {
    /// Faces of the surface, ascending.
    pub faces: Vec<u32>,
    /// The corners of each of these faces, as indices into `vertices` and `uv`.
    pub corners: Vec<[u32; 3]>,
    /// The vertex of the surface for each row, ascending.
    pub vertices: Vec<u32>,
    /// Its position in mm.
    pub uv: Vec<[f64; 2]>,
    /// The area on the surface in mm².
    pub area: f64,
    /// The largest max(σ1, 1/σ2) of its triangles, measured in the plane.
    pub isometric: f64,
    /// The largest σ1/σ2 of its triangles, measured in the plane.
    pub quasi_conformal: f64,
}

/// The outcome of gluing. Lengths are on the surface in mm; each seam counts once.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Seams {
    /// The length of all seams between the patches.
    pub length: f64,
    /// The length of the closed seams.
    pub closed: f64,
    /// Cuts inside a piece. Closing them would exceed the bound, because the surface is curved around their ends.
    pub holonomy: f64,
    /// Cuts between pieces that cannot be united within the bound.
    pub bound: f64,
    /// Cuts that prevent a piece from overlapping itself.
    pub overlap: f64,
}

/// A surface as flat pieces, glued from patches.
#[derive(Debug, Clone, PartialEq)]
pub struct Glued {
    /// The piece of each face.
    pub labels: Vec<u32>,
    /// The pieces by decreasing area.
    pub pieces: Vec<Piece>,
    /// σ1 and σ2 of each face.
    pub stretch: Vec<[f64; 2]>,
    /// The outcome of gluing.
    pub seams: Seams,
    /// The number of glued patches.
    pub patches: usize,
    /// The largest max(σ1, 1/σ2) of the patches.
    pub before: f64,
}

impl Atlas {
    /// Returns the positions of the corners of each face in mm, in the plane of its patch.
    pub fn flat(&self, surface: &Surface) -> Vec<[[f64; 2]; 3]> {
        let of_face = |(corners, &label): (&[u32; 3], &u32)| {
            let patch = &self.patches[label as usize];
            corners.map(|v| patch.vertices.binary_search(&v).map_or([f64::NAN; 2], |row| patch.uv[row]))
        };
        surface.faces().iter().zip(&self.labels).map(of_face).collect()
    }
}

/// Glues patches such that max(σ1, 1/σ2) ≤ `bound` for every triangle. `labels` are the patches of the faces, and
/// `flat` the positions of their corners in the plane of the patch. Seams that cannot be closed remain as cuts.
///
/// The pieces do not depend on the numbering of vertices and triangles.
///
/// # Errors
/// [`Error::WrongLength`] if labels or positions are missing, [`Error::GlueBoundOutOfRange`],
/// [`Error::DegenerateFace`], [`Error::PatchesBeyondBound`] if a patch is distorted more than the bound permits, and
/// [`Error::Cancelled`].
pub fn glue(surface: &Surface, labels: &[u32], flat: &[[[f64; 2]; 3]], bound: f64, control: &Control) -> Result<Glued> {
    check_length("labels", labels.len(), "faces", surface.faces().len())?;
    check_length("flat triangles", flat.len(), "faces", surface.faces().len())?;
    check_bound(bound)?;
    let facets = Facets::of(surface, control)?;
    let all: Vec<u32> = (0..facets.len() as u32).collect();
    let patches = Layout::new(&facets, labels, flat);
    let before = all.iter().map(|&facet| worst(&patches, facet)).fold(1.0, f64::max);
    if !are_within(&patches, &all, bound) {
        let [least, most] = ANGLES;
        let angle = bound.recip().acos().to_degrees().clamp(least, most);
        return Err(Error::PatchesBeyondBound { bound, before, angle });
    }
    let mut gluing = Gluing::new(patches.clone(), bound, control);
    gluing.merge()?;
    gluing.retry()?;
    gluing.finish(LAST, TIMES)?;
    let Gluing { mut layout, mut reasons, .. } = gluing;
    control.begin("checking pieces", layout.members.len() as u64);
    for piece in 0..layout.members.len() as u32 {
        if !is_valid(&layout, piece, bound, control)? {
            for side in layout.members[piece as usize].iter().flat_map(|&facet| 3 * facet..3 * facet + 3) {
                reasons[side as usize] = Some(Obstacle::Overlap);
            }
            layout.take_apart(piece, &patches);
        }
        control.advance();
    }
    Ok(Glued { seams: seams(&layout, &reasons), patches: patches.members.len(), before, ..collected(&layout) })
}

/// Checks that patches can be glued within this bound on C.
pub(crate) fn check_bound(bound: f64) -> Result<()> {
    let [least, most] = BOUNDS;
    if (least..=most).contains(&bound) { Ok(()) } else { Err(Error::GlueBoundOutOfRange { bound, least, most }) }
}

/// Returns max(σ1, 1/σ2) of a facet.
fn worst(layout: &Layout<'_>, facet: u32) -> f64 {
    let [most, least] = stretch_of(layout.facets.corners(facet), layout.flat(facet).map(Into::into));
    most.max(least.recip())
}

/// Returns whether all triangles of a piece are within the bound, upright and free of overlaps, by exact predicates.
fn is_valid(layout: &Layout<'_>, piece: u32, bound: f64, control: &Control) -> Result<bool> {
    let members = &layout.members[piece as usize];
    if !are_within(layout, members, bound) {
        return Ok(false);
    }
    let uv: Vec<[f64; 2]> = members.iter().flat_map(|&facet| layout.flat(facet).map(Into::into)).collect();
    let faces: Vec<[u32; 3]> = (0..members.len() as u32).map(|n| [3 * n, 3 * n + 1, 3 * n + 2]).collect();
    Ok(overlaps(&faces, &uv, &control.part())?.covering == 0)
}

/// Returns the measured pieces by decreasing area.
fn collected(layout: &Layout<'_>) -> Glued {
    let facets = layout.facets;
    let mut members: Vec<Vec<u32>> = layout.members.iter().filter(|members| !members.is_empty()).cloned().collect();
    members.iter_mut().for_each(|members| members.sort_unstable());
    let area = |members: &[u32]| members.iter().map(|&facet| facets.areas[facet as usize]).sum::<f64>();
    let mut sorted: Vec<(f64, Vec<u32>)> = members.into_iter().map(|members| (area(&members), members)).collect();
    sorted.sort_by(|(a, p), (b, q)| b.total_cmp(a).then(p[0].cmp(&q[0])));
    let mut labels = vec![0; facets.len()];
    let mut stretch = vec![[f64::NAN; 2]; facets.len()];
    let mut pieces = Vec::with_capacity(sorted.len());
    for (number, (area, members)) in (0..).zip(sorted) {
        let piece = measured(layout, &members, area, &mut stretch);
        piece.faces.iter().for_each(|&face| labels[face as usize] = number);
        pieces.push(piece);
    }
    Glued { labels, pieces, stretch, seams: Seams::default(), patches: 0, before: 1.0 }
}

fn measured(layout: &Layout<'_>, members: &[u32], area: f64, stretch: &mut [[f64; 2]]) -> Piece {
    let (facets, surface) = (layout.facets, layout.facets.surface);
    let corners = members.iter().flat_map(|&facet| (0..3).map(move |k| (facet, k)));
    let rows =
        distinct(corners.map(|(facet, k)| (facets.vertices[facet as usize][k], layout.place[3 * facet as usize + k])));
    let row: HashMap<u32, u32> = rows.iter().map(|&(_, place)| place).zip(0..).collect();
    let mut piece = Piece {
        faces: Vec::with_capacity(members.len()),
        corners: Vec::with_capacity(members.len()),
        vertices: rows.iter().map(|&(vertex, _)| vertex).collect(),
        uv: rows.iter().map(|&(_, place)| layout.uv[place as usize].into()).collect(),
        area,
        isometric: 1.0,
        quasi_conformal: 1.0,
    };
    let mut by_face: Vec<(u32, u32)> = members.iter().map(|&facet| (facets.faces[facet as usize], facet)).collect();
    by_face.sort_unstable();
    for (face, facet) in by_face {
        let [most, least] = stretch_of(facets.corners(facet), layout.flat(facet).map(Into::into));
        stretch[face as usize] = [most, least];
        piece.isometric = piece.isometric.max(most).max(least.recip());
        piece.quasi_conformal = piece.quasi_conformal.max(most / least);
        // in the order of the corners of the face, which may begin elsewhere than the facet
        let first =
            (0..3).find(|&k| surface.faces()[face as usize][k] == facets.vertices[facet as usize][0]).unwrap_or(0);
        let corner = |k: usize| row[&layout.place[3 * facet as usize + (k + 3 - first) % 3]];
        piece.faces.push(face);
        piece.corners.push([corner(0), corner(1), corner(2)]);
    }
    piece
}

fn seams(layout: &Layout<'_>, reasons: &[Option<Obstacle>]) -> Seams {
    let mut found = Seams::default();
    for (side, twin) in (0..).zip(&layout.twins).filter(|&(side, &twin)| layout.seams[side as usize] && side < twin) {
        let length = layout.lengths[side as usize];
        let is_one = layout.piece[side as usize / 3] == layout.piece[*twin as usize / 3];
        found.length += length;
        let share = match reasons[side as usize] {
            _ if !layout.is_cut(side) => &mut found.closed,
            Some(Obstacle::Overlap) => &mut found.overlap,
            _ if is_one => &mut found.holonomy,
            _ => &mut found.bound,
        };
        *share += length;
    }
    found
}

#[cfg(test)]
mod tests;
