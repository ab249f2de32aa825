//! A bound on what areas change by, on request: a price on what is beyond, which grows until nothing is.

use super::levels::{APART, Convergence, Levels, weighted};
use super::pairs::Pairs;
use super::triangles::AreaBound;
use crate::control::Control;
use crate::embed::Place;
use crate::error::Result;
use crate::rows::DistanceRows;

/// The price of the square of what areas change beyond a bound, at first, how much it grows, and how often; what it begins at, as a part
/// of the bound.
const FIRST_PRICE: f64 = 1.0;
const PRICE_GROWTH: f64 = 4.0;
const DEARER: usize = 12;
const WITHIN: f64 = 0.98;

/// A map without folds (mm), led on to where no triangle's area changes by more than a factor, against the area of the whole: what is
/// beyond has a price that grows until nothing is. If that cannot be had the map is the one whose worst triangle is the best that was
/// found, and is told as not converged.
/// Panics as [`flatten`](super::levels::flatten); or if there is not one place a vertex.
pub fn bounded(
    levels: &Levels,
    rows: &DistanceRows,
    uv: &[[f64; 2]],
    weighting: f64,
    max_area: f64,
    control: &Control,
) -> Result<(Vec<[f64; 2]>, Convergence)> {
    let pairs = Pairs::new(rows, levels.evaluated(), control)?;
    let mut level = levels.prepare(0, &pairs, control)?;
    let mut uv: Vec<Place> = uv.iter().map(|&place| place.into()).collect();
    assert_eq!(uv.len(), levels.finest().len(), "one place a vertex");
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
        let stage = "keeping areas within their bound";
        energies.extend(level.rounds(&level.pairs, &mut uv, weighted(weighting), 2, apart, stage, control)?.energies);
        [mean, worst] = level.triangles.area_change(&uv);
        if worst < best.0 {
            best = (worst, uv.clone());
        }
        weight *= PRICE_GROWTH;
    }
    let uv = best.1.into_iter().map(Into::into).collect();
    Ok((uv, Convergence { energies, converged: best.0 <= most }))
}
