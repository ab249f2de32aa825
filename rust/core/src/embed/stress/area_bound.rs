//! An optional bound on the change of areas: a penalty on values outside the bound grows until none is left.

use super::levels::{APART, Convergence, Levels, weighted};
use super::pairs::Pairs;
use super::triangles::AreaBound;
use crate::embed::Place;
use crate::rows::DistanceRows;
use crate::{Control, Result};

/// The initial penalty on the squared excess of an area change, its growth factor, the number of times that it grows,
/// and the share of the bound at which it begins.
const FIRST_PRICE: f64 = 1.0;
const PRICE_GROWTH: f64 = 4.0;
const DEARER: usize = 12;
const WITHIN: f64 = 0.98;

/// Optimises a map without folds (mm) until no triangle's area changes by more than a factor relative to the area of
/// the whole map. A penalty on larger changes grows until there are none. If this fails, the map with the smallest
/// maximum change is returned, and marked as not converged.
/// Panics like [`flatten`](super::levels::flatten), or if the number of positions differs from the number of vertices.
pub(crate) fn bounded(
    levels: &Levels, rows: &DistanceRows, uv: &[[f64; 2]], weighting: f64, max_area: f64, control: &Control,
) -> Result<(Vec<[f64; 2]>, Convergence)> {
    let pairs = Pairs::new(rows, levels.evaluated(), levels.area(), control)?;
    let mut level = levels.prepare(0, &pairs, control)?;
    let mut uv: Vec<Place> = uv.iter().map(|&place| place.into()).collect();
    assert_eq!(uv.len(), levels.finest().len(), "one position per vertex");
    level.check_unfolded(&uv)?;
    let is_apart = level.outline.crossings(&uv, control)? == 0;
    let most = max_area.ln();
    let [mut mean, mut worst] = level.triangles.area_change(&uv);
    let mut best = (worst, uv.clone());
    let mut energies = Vec::new();
    let mut weight = FIRST_PRICE;
    for _ in 0..DEARER {
        if worst <= most {
            break;
        }
        level.triangles.bound = Some(AreaBound { mean, most: most * WITHIN, weight });
        let apart = Some((&level.outline, APART)).filter(|_| is_apart);
        let stage = "limiting changes of area";
        let (energy, patience) = (level.energy(&level.pairs, weighted(weighting), apart), weighted(weighting).patience);
        energies.extend(energy.descend(&mut uv, patience, 2, stage, control)?.energies);
        [mean, worst] = level.triangles.area_change(&uv);
        if worst < best.0 {
            best = (worst, uv.clone());
        }
        weight *= PRICE_GROWTH;
    }
    let uv = best.1.into_iter().map(Into::into).collect();
    Ok((uv, Convergence { energies, converged: best.0 <= most }))
}
