//! A known map as the start: the optimisation continues on the finest level on which it can be repaired (`repair`).

use crate::embed::Place;
use nalgebra::Vector2;

use super::descent::Objective;
use super::levels::{APART, Convergence, Dials, HOPELESS, Level, Levels, MOST_ROUNDS, stage, weighted};
use super::outline::Outline;
use super::pairs::Pairs;
use super::repair::{Fault, repair};
use crate::rows::DistanceRows;
use crate::surface::Surface;
use crate::{Control, Error, Result};

/// The maximum factor between the scale of a start and that given by its area, in both directions, and the number of
/// times that the range of its scale is narrowed.
const WIDEST_SCALE: f64 = 2.0;
const NARROWINGS: usize = 26;

/// A known map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Start<'a> {
    /// The position of each vertex of the finest level, in any unit and location, possibly mirrored.
    pub places: &'a [[f64; 2]],
    /// The factor on the maximum number of steps, and the divisor of the smallest decrease over five steps; 1 is usual.
    pub patience: u32,
}

impl Start<'_> {
    /// Returns the positions, counterclockwise and centred at the origin, at a distance of at most 3 from it.
    pub(crate) fn counterclockwise(&self, surface: &Surface) -> Result<Vec<Place>> {
        if self.places.len() != surface.len() {
            return Err(Error::StartMismatch { places: self.places.len(), points: surface.len() });
        }
        if let Some(vertex) = self.places.iter().position(|place| place.iter().any(|x| !x.is_finite())) {
            return Err(Error::StartNotFinite { vertex });
        }
        let largest = self.places.as_flattened().iter().fold(0.0f64, |largest, x| largest.max(x.abs()));
        // products of huge or tiny positions would overflow
        let small = |x: f64| if largest > 0.0 { x / largest } else { x };
        let places: Vec<Place> = self.places.iter().map(|place| place.map(small).into()).collect();
        let centre = places.iter().sum::<Place>() / places.len() as f64;
        let double = |face: &[u32; 3]| {
            let [a, b, c] = face.map(|vertex| places[vertex as usize]);
            (b - a).perp(&(c - a))
        };
        let hand = surface.faces().iter().map(double).sum::<f64>().signum();
        Ok(places.iter().map(|place| (place - centre).component_mul(&Vector2::new(hand, 1.0))).collect())
    }
}

/// Returns the map (mm) with the smallest energy near a known one, with the guarantees of
/// [`flatten`](super::levels::flatten). The optimisation starts at the scale with the smallest energy. Vertices with
/// flipped triangles are moved to remove the flips, and coincident sides of a cut are drawn apart slightly. Where this
/// is not sufficient, it starts on the finest coarser level where it is. Errors: [`Error::StartMismatch`],
/// [`Error::StartNotFinite`]; [`Error::StartFolded`], [`Error::StartCrosses`] and [`Error::StartStuck`] if the start
/// cannot be repaired on any level, or makes no progress; and those of [`flatten`](super::levels::flatten). Panics like
/// [`flatten`](super::levels::flatten).
pub(crate) fn flatten_from(
    levels: &mut Levels, rows: &DistanceRows, start: Start, weighting: f64, control: &Control,
) -> Result<(Vec<[f64; 2]>, Convergence)> {
    let places = start.counterclockwise(levels.finest())?;
    let dials = Dials { patience: start.patience, ..weighted(weighting) };
    let pairs = Pairs::new(rows, levels.evaluated(), levels.area(), control)?;
    let mut first = None;
    for depth in 0..=levels.coarser.len() {
        let level = levels.prepare(depth, &pairs, control)?;
        let mut uv: Vec<_> = levels.vertices[depth].iter().map(|&vertex| places[vertex as usize]).collect();
        level.triangles.fit_area(&mut uv);
        match repair(&level.triangles, &level.outline, &mut uv, control)? {
            Some(fault) => {
                first.get_or_insert(fault);
            }
            None => {
                let settle = || level.settle_again(&mut uv, dials, stage(depth), control);
                let (convergence, finer) = levels.beside(depth, settle, &pairs, control)?;
                drop(level);
                if convergence.energies.last().is_some_and(|&energy| energy < HOPELESS) {
                    levels.coarser.truncate(depth);
                    return levels.refined(uv, convergence, finer, &pairs, dials, control);
                }
                first.get_or_insert(Fault::Stuck);
            }
        }
    }
    Err(match first {
        Some(Fault::Crossing(crossings)) => Error::StartCrosses { crossings },
        Some(Fault::Folded(triangles)) => Error::StartFolded { triangles },
        Some(Fault::Stuck) => Error::StartStuck,
        None => unreachable!("there is a level"),
    })
}

impl Level {
    /// Optimises a known map that does not overlap itself.
    fn settle_again(
        &self, uv: &mut Vec<Place>, dials: Dials, stage: &'static str, control: &Control,
    ) -> Result<Convergence> {
        let apart = Some((&self.outline, APART));
        self.scale(uv, dials, apart, control)?;
        self.ease_tiny(uv, dials.shape, control)?;
        self.energy(&self.pairs, dials, apart).descend(uv, dials.patience, MOST_ROUNDS, stage, control)
    }

    /// Scales a map to the smallest energy, by golden-section search.
    fn scale(&self, uv: &mut [Place], dials: Dials, outline: Option<(&Outline, f64)>, control: &Control) -> Result<()> {
        let energy = self.energy(&self.pairs, dials, outline);
        let at = |log: f64| {
            control.check()?;
            let scaled: Vec<_> = uv.iter().map(|place| place * log.exp()).collect();
            Ok(energy.evaluate(&scaled, control)?.0)
        };
        // each narrowing keeps 0.618 of the range and one of its two inner values; the logarithm makes it symmetric
        let golden = 0.5 * (5f64.sqrt() - 1.0);
        let (mut low, mut high) = (-WIDEST_SCALE.ln(), WIDEST_SCALE.ln());
        let inner = |low: f64, high: f64| [high - golden * (high - low), low + golden * (high - low)];
        let [mut a, mut b] = inner(low, high);
        let (mut of_a, mut of_b) = (at(a)?, at(b)?);
        for _ in 0..NARROWINGS {
            if of_a <= of_b {
                (high, b, of_b) = (b, a, of_a);
                a = inner(low, high)[0];
                of_a = at(a)?;
            } else {
                (low, a, of_a) = (a, b, of_b);
                b = inner(low, high)[1];
                of_b = at(b)?;
            }
        }
        let best = (0.5 * (low + high)).exp();
        uv.iter_mut().for_each(|place| *place *= best);
        Ok(())
    }
}
