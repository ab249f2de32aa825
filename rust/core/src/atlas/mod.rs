//! Quasi-isometric patches with a certificate, by Appleboim, Saucan and Zeevi (2006).
//!
//! A patch is projected orthogonally onto a plane. If every direction in it is inclined by at most θ to the plane,
//! lengths change by a factor C ≤ 1 + tan θ at most, and angles by a dilatation K ≤ (1 + tan θ)^1.5 (Gehring, Väisälä).
//!
//! The paper accepts a triangle whose two new edges are inclined by at most θ. This is not sufficient: a triangle can
//! be steeper between its edges, and the edges of one that is thin along a contour line can all be level while it is
//! upright. The certificate holds if the *normal* of the triangle is inclined by at most θ to that of the plane. Then
//! every direction in it is, including its edges. This depends only on the surface, not on its triangulation.
//!
//! Projection preserves the directions along contour lines and shrinks those across them by the cosine of the
//! inclination: σ1 = 1, σ2 = cos θ. So C and K are at most 1 / cos θ, far below the paper's bounds (1.015 instead of
//! 1.176 for 10°). A given bound is converted to the angle that this formula permits.
//!
//! The paper assumes that a projection is one to one. But a spiral staircase of level steps would overlap itself. Here,
//! triangles that would overlap are assigned to other patches.

mod cone;
mod dissolve;
mod facets;
pub mod glue;
mod growth;
mod projection;
mod search;

use nalgebra::Vector3;

use crate::adjacency::distinct;
use crate::distortion::faces::stretch_of;
use crate::surface::Surface;
use crate::{Control, Error, Result};
use facets::Facets;
use growth::Growth;
pub use projection::Plane;
use projection::{Projected, project};

/// The smallest and the largest angle of a patch in degrees.
pub(crate) const ANGLES: [f64; 2] = [0.01, 80.0];

/// The number of angles that are tried to reach a number of patches.
const BISECTIONS: usize = 12;

/// The requirement on the patches.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Limit {
    /// The maximum inclination in degrees of any direction to its patch's plane; certified by the paper's theorem.
    Angle(f64),
    /// The maximum change factor of lengths, and of ratios of two lengths at a point; certified by the cosine.
    Bound(f64),
    /// The maximum number of patches, with the smallest angle for which they were found.
    Count(usize),
}

/// How the seeds of patches are chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Seeds {
    /// In the flattest regions: candidates grow around all of them, rotated to be as large as possible; the largest is
    /// kept.
    Curvature,
    /// At the flattest free triangle, repeatedly; each patch stays on the plane of its seed, as in the paper.
    Flattest,
    /// At a random free triangle, repeatedly; each patch stays on the plane of its seed, as in the paper's alternative.
    Random(u64),
}

/// Proven bounds for every triangle of the patches.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Certificate {
    /// The maximum inclination of any direction to the plane in degrees.
    pub angle: f64,
    /// The maximum factor by which lengths change: max(σ1, 1/σ2) ≤ C.
    pub c: f64,
    /// The maximal dilatation: σ1/σ2 ≤ K.
    pub k: f64,
}

impl Certificate {
    /// Returns the certificate for an angle by the theorem of Gehring and Väisälä, as in the paper.
    pub(crate) fn of_angle(angle: f64) -> Result<Self> {
        let [least, most] = ANGLES;
        if !(least..=most).contains(&angle) {
            return Err(Error::AngleOutOfRange { angle, least, most });
        }
        // C ≤ cot α + 1, α from the normal, so cot α = tan θ (Appleboim, Saucan & Zeevi 2006, theorem 1)
        let c = 1.0 + angle.to_radians().tan();
        // K ≤ (cot α + 1)^3/2 (theorem 1)
        Ok(Self { angle, c, k: c.powf(1.5) })
    }

    /// Returns the certificate for the largest angle whose cosine satisfies a bound on C, and thus on K.
    pub(crate) fn of_bound(bound: f64) -> Result<Self> {
        let [least, most] = ANGLES.map(|angle| angle.to_radians().cos().recip());
        if !(least..=most).contains(&bound) {
            return Err(Error::BoundOutOfRange { bound, least, most });
        }
        // σ₂ = cos θ and σ₁ = 1, so 1/σ₂ and σ₁/σ₂ are both 1/cos θ
        Ok(Self { angle: bound.recip().acos().to_degrees(), c: bound, k: bound })
    }
}

/// A part of the surface in its plane.
#[derive(Debug, Clone, PartialEq)]
pub struct Patch {
    /// Faces of the surface, ascending.
    pub faces: Vec<u32>,
    /// Their vertices, ascending.
    pub vertices: Vec<u32>,
    /// The position of each of these vertices in mm.
    pub uv: Vec<[f64; 2]>,
    /// The plane onto which it is projected.
    pub plane: Plane,
    /// The largest inclination of a triangle in degrees.
    pub tilt: f64,
    /// The area on the surface in mm².
    pub area: f64,
    /// The largest max(σ1, 1/σ2) of its triangles, measured in the plane.
    pub isometric: f64,
    /// The largest σ1/σ2 of its triangles, measured in the plane.
    pub quasi_conformal: f64,
}

/// A surface as flat patches: every triangle belongs to one patch.
#[derive(Debug, Clone, PartialEq)]
pub struct Atlas {
    /// The patch of each face.
    pub labels: Vec<u32>,
    /// The patches by decreasing area.
    pub patches: Vec<Patch>,
    /// The bounds that hold for all patches.
    pub certificate: Certificate,
    /// σ1 and σ2 of each face.
    pub stretch: Vec<[f64; 2]>,
}

/// Flattens a surface of any topology in as few certified patches as are found.
///
/// The patches do not depend on the numbering of vertices and triangles.
///
/// # Errors
/// [`Error::AngleOutOfRange`] or [`Error::BoundOutOfRange`] of the limit, [`Error::TooFewPatches`] if no angle gives so
/// few patches, [`Error::DegenerateFace`] for a triangle without area, and [`Error::Cancelled`].
pub fn patches(surface: &Surface, limit: Limit, seeds: Seeds, control: &Control) -> Result<Atlas> {
    let certificate = match limit {
        Limit::Angle(angle) => Some(Certificate::of_angle(angle)?),
        Limit::Bound(bound) => Some(Certificate::of_bound(bound)?),
        Limit::Count(_) => None,
    };
    let facets = Facets::of(surface, control)?;
    let order = match seeds {
        Seeds::Curvature | Seeds::Flattest => facets.by_curvature(),
        Seeds::Random(seed) => search::shuffled(&facets, seed),
    };
    let grow = |certificate: &Certificate| grown(&facets, certificate, seeds, &order, control);
    match (certificate, limit) {
        (Some(certificate), _) => finished(&facets, grow(&certificate)?, certificate, control),
        (None, Limit::Count(count)) => {
            let (certificate, patches) = at_most(count, grow)?;
            finished(&facets, patches, certificate, control)
        }
        (None, _) => unreachable!("an angle and a bound have a certificate"),
    }
}

fn grown(
    facets: &Facets<'_>, certificate: &Certificate, seeds: Seeds, order: &[u32], control: &Control,
) -> Result<Vec<Projected>> {
    let least = certificate.angle.to_radians().cos();
    control.begin("growing patches", facets.len() as u64);
    let mut growth = Growth::new(facets, least, control);
    let regions = match seeds {
        Seeds::Curvature => {
            let regions = search::largest_first(&mut growth, order)?;
            dissolve::dissolved(facets, regions, least, control)?
        }
        Seeds::Flattest | Seeds::Random(_) => search::one_after_another(&mut growth, order)?,
    };
    control.begin("projecting patches", regions.len() as u64);
    let mut patches = Vec::with_capacity(regions.len());
    for region in regions {
        patches.extend(project(facets, region, control)?);
        control.advance();
    }
    Ok(patches)
}

/// Returns the patches with the smallest angle, by bisection, that gives at most this number of patches.
fn at_most(
    count: usize, grow: impl Fn(&Certificate) -> Result<Vec<Projected>>,
) -> Result<(Certificate, Vec<Projected>)> {
    let [mut least, mut most] = ANGLES;
    let certificate = Certificate::of_angle(most)?;
    let mut best = (certificate, grow(&certificate)?);
    if best.1.len() > count {
        return Err(Error::TooFewPatches { count, least: best.1.len(), most });
    }
    for _ in 0..BISECTIONS {
        let certificate = Certificate::of_angle(0.5 * (least + most))?;
        let patches = grow(&certificate)?;
        if patches.len() <= count {
            most = certificate.angle;
            best = (certificate, patches);
        } else {
            least = certificate.angle;
        }
    }
    Ok(best)
}

/// Returns the measured patches by decreasing area.
fn finished(
    facets: &Facets<'_>, mut grown: Vec<Projected>, certificate: Certificate, control: &Control,
) -> Result<Atlas> {
    control.begin("measuring patches", grown.len() as u64);
    grown.iter_mut().for_each(|(_, facets)| facets.sort_unstable());
    let area = |(_, of): &Projected| of.iter().map(|&facet| facets.areas[facet as usize]).sum::<f64>();
    let mut sorted: Vec<(f64, Projected)> = grown.into_iter().map(|patch| (area(&patch), patch)).collect();
    sorted.sort_by(|(a, (_, p)), (b, (_, q))| b.total_cmp(a).then(p[0].cmp(&q[0])));
    let mut labels = vec![0; facets.len()];
    let mut stretch = vec![[f64::NAN; 2]; facets.len()];
    let mut patches = Vec::with_capacity(sorted.len());
    for (number, (area, (plane, of))) in (0..).zip(sorted) {
        control.check()?;
        let patch = measured(facets, plane, &of, area, &mut stretch);
        patch.faces.iter().for_each(|&face| labels[face as usize] = number);
        patches.push(patch);
        control.advance();
    }
    Ok(Atlas { labels, patches, certificate, stretch })
}

fn measured(facets: &Facets<'_>, plane: Plane, of: &[u32], area: f64, stretch: &mut [[f64; 2]]) -> Patch {
    let vertices = distinct(of.iter().flat_map(|&facet| facets.vertices[facet as usize]));
    let uv = vertices.iter().map(|&v| plane.project(&facets.surface.points()[v as usize])).collect();
    let mut patch = Patch {
        faces: of.iter().map(|&facet| facets.faces[facet as usize]).collect(),
        vertices,
        uv,
        plane,
        tilt: 0.0,
        area,
        isometric: 1.0,
        quasi_conformal: 1.0,
    };
    for (&facet, &face) in of.iter().zip(&patch.faces) {
        let corners = facets.corners(facet);
        let [most, least] = stretch_of(corners, corners.map(|p| plane.project(&p)));
        stretch[face as usize] = [most, least];
        patch.tilt = patch.tilt.max(inclination(&facets.normals[facet as usize], &plane.normal));
        patch.isometric = patch.isometric.max(most).max(least.recip());
        patch.quasi_conformal = patch.quasi_conformal.max(most / least);
    }
    patch.faces.sort_unstable();
    patch
}

/// Returns the angle between unit vectors in degrees.
fn inclination(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    // acos would lose half of the digits of small angles
    a.cross(b).norm().atan2(a.dot(b)).to_degrees()
}

#[cfg(test)]
mod tests;
