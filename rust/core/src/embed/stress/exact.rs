//! The end of the optimisation on surfaces that have a map without distortion: their triangles determine the map, and
//! the distances, which have small errors, only how parts lie that the triangles do not hold.

use super::levels::{APART, Dials, Levels, MOST_ROUNDS, stage, weighted};
use super::pairs::{Bands, Pairs};
use crate::embed::Place;
use crate::rows::DistanceRows;
use crate::{Control, Result};

/// The mean energy of the triangles below which an exact map is searched for, and below which a map is exact: lengths
/// then change by about 1 %, and 0.003 %.
const NEAR: f64 = 1e-3;
const EXACT: f64 = 1e-8;

/// The factor on the weight of distances, and its square on that of gaps of the outline.
const FAINT: f64 = 1e-6;

/// Returns the map (mm) near an optimised one in which all triangles keep their shape and size, if there is one.
/// Panics like [`flatten`](super::levels::flatten), or if the number of positions differs from the number of vertices.
pub(crate) fn exact(
    levels: &Levels, rows: &DistanceRows, uv: &[[f64; 2]], weighting: f64, control: &Control,
) -> Result<Option<Vec<[f64; 2]>>> {
    let dials = weighted(weighting);
    let mut uv: Vec<Place> = uv.iter().map(|&place| place.into()).collect();
    assert_eq!(uv.len(), levels.finest().len(), "one position per vertex");
    if levels.triangles(0).energy(&uv, dials.shape) > NEAR {
        return Ok(None);
    }
    let pairs = Pairs::new(rows, levels.evaluated(), levels.area(), control)?;
    let level = levels.prepare(0, &pairs, control)?;
    if level.outline.crossings(&uv, control)? > 0 {
        return Ok(None);
    }
    let bands = Bands { weights: dials.bands.weights.map(|weight| FAINT * weight), ..dials.bands };
    let energy = level.energy(&level.pairs, Dials { bands, ..dials }, Some((&level.outline, FAINT * FAINT * APART)));
    energy.descend(&mut uv, dials.patience, MOST_ROUNDS, stage(0), control)?;
    let is_exact = level.triangles.energy(&uv, dials.shape) < EXACT;
    Ok(is_exact.then(|| uv.into_iter().map(Into::into).collect()))
}
