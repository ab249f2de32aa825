//! Settling: the surroundings of a new seam are moved until every triangle is within the bound, and then optimised.

use std::collections::HashMap;

use super::layout::Layout;
use super::strain::{Place, Price, Region, Strain};
use crate::adjacency::distinct;
use crate::distortion::faces::stretch_of;
use crate::embed::stress::descent::{Until, descend};
use crate::embed::stress::triangles::Rest;
use crate::{Control, Error, Result};

/// The excess over this share of the range (by its logarithm) is minimised, to stay well within the bound.
const ASIDE: f64 = 0.8;

/// The number of optimisation steps between two checks of the bound.
const STEPS: usize = 10;

/// The number of checks of the bound.
const LOOKS: usize = 8;

/// The attempt is abandoned if more than this share of the excess remains between two checks.
const REMAINS: f64 = 0.7;

/// The triangles around a place on the boundary must leave this angle of a full turn free, in radians.
const SLIT: f64 = 1e-9;

/// The moving part of a layout; the rest is fixed.
pub(super) struct Around {
    /// The moving places, in the numbering of the region.
    pub free: Vec<u32>,
    /// All facets that change.
    pub facets: Vec<u32>,
    region: Region,
    /// Whether nothing is fixed.
    pub is_all: bool,
}

impl Around {
    /// Returns the places within this number of rings around given places.
    pub fn new(layout: &Layout<'_>, places: &[u32], rings: usize, control: &Control) -> Result<Self> {
        let mut number: HashMap<u32, u32> = places.iter().copied().zip(0..).collect();
        let mut order = places.to_vec();
        let mut fans: Vec<Vec<u32>> = Vec::new();
        let (mut begun, mut free) = (0, order.len());
        for ring in 0..=rings {
            for n in begun..free {
                let fan = layout.around(order[n]);
                for corner in fan.iter().flat_map(|corner| (corner / 3 * 3)..(corner / 3 * 3 + 3)) {
                    let place = layout.place[corner as usize];
                    number.entry(place).or_insert_with(|| {
                        order.push(place);
                        order.len() as u32 - 1
                    });
                }
                fans.push(fan);
            }
            control.check()?;
            begun = free;
            if ring < rings {
                free = order.len();
            }
        }
        let facets = distinct(fans.iter().flatten().map(|corner| corner / 3));
        let rest = |&facet: &u32| {
            let rest = layout.rests[facet as usize];
            let local = |k: u32| number[&layout.place[(3 * facet + k) as usize]];
            Rest { corners: rest.corners.map(local), ..rest }
        };
        let held: Vec<Place> = order[free..].iter().map(|&place| layout.uv[place as usize]).collect();
        let is_all = held.is_empty();
        let region = Region::new(facets.iter().map(rest).collect(), free, held, control)?;
        order.truncate(free);
        Ok(Self { free: order, facets, region, is_all })
    }

    fn read(&self, layout: &Layout<'_>) -> Vec<Place> {
        self.free.iter().map(|&place| layout.uv[place as usize]).collect()
    }

    pub fn write(&self, layout: &mut Layout<'_>, uv: &[Place]) {
        self.free.iter().zip(uv).for_each(|(&place, &uv)| layout.uv[place as usize] = uv);
    }

    /// Moves the free places until every facet is within the bound, and then reduces distortion for a number of steps.
    /// Returns the previous positions; if the bound is not reached, returns nothing and moves nothing.
    pub fn settle(
        &self, layout: &mut Layout<'_>, bound: f64, steps: usize, control: &Control,
    ) -> Result<Option<Vec<Place>>> {
        let before = self.read(layout);
        if self.come_within(layout, bound, control)? {
            self.relax(layout, bound, Until { steps, gain: 1e-3, enough: 0.0 }, control)?;
            if is_sound(layout, &self.facets, &self.free, bound) {
                return Ok(Some(before));
            }
        }
        self.write(layout, &before);
        Ok(None)
    }

    fn come_within(&self, layout: &mut Layout<'_>, bound: f64, control: &Control) -> Result<bool> {
        let strain = Strain { region: &self.region, price: Price::Excess(bound.powf(ASIDE)) };
        let mut uv = self.read(layout);
        for _ in 0..LOOKS {
            if are_within(layout, &self.facets, bound) {
                return Ok(true);
            }
            let until = Until { steps: STEPS, gain: 1e-2, enough: 0.0 };
            let energies = match descend(&strain, &mut uv, until, control) {
                Err(Error::Uneven) => return Ok(false),
                other => other?.energies,
            };
            self.write(layout, &uv);
            if energies[energies.len() - 1] > REMAINS * energies[0] {
                break;
            }
        }
        Ok(are_within(layout, &self.facets, bound))
    }

    /// Returns whether all facets are within the bound and surround every place without overlap.
    pub fn is_sound(&self, layout: &Layout<'_>, bound: f64) -> bool {
        is_sound(layout, &self.facets, &self.free, bound)
    }

    /// Reduces the distortion of a layout within the bound by moving the free places.
    pub fn relax(&self, layout: &mut Layout<'_>, bound: f64, until: Until, control: &Control) -> Result<bool> {
        let mut uv = self.read(layout);
        let strain = Strain { region: &self.region, price: Price::Change(bound) };
        let converged = match descend(&strain, &mut uv, until, control) {
            Err(Error::Uneven) => return Ok(true),
            other => other?.converged,
        };
        self.write(layout, &uv);
        Ok(converged)
    }
}

/// Returns whether facets are upright and within a bound.
pub(super) fn are_within(layout: &Layout<'_>, facets: &[u32], bound: f64) -> bool {
    facets.iter().all(|&facet| {
        let flat = layout.flat(facet);
        let [most, least] = stretch_of(layout.facets.corners(facet), flat.map(Into::into));
        let [a, b, c] = flat.map(|p| robust::Coord { x: p.x, y: p.y });
        most <= bound && least.recip() <= bound && robust::orient2d(a, b, c) > 0.0
    })
}

/// Returns whether, in addition, the facets around each place do not overlap. At a boundary, they go around it less
/// than once.
fn is_sound(layout: &Layout<'_>, facets: &[u32], places: &[u32], bound: f64) -> bool {
    use std::f64::consts::{PI, TAU};
    let angle = |&corner: &u32| {
        let facet = corner / 3;
        let [p, q, r] = [0, 1, 2].map(|k| layout.at(3 * facet + (corner + k) % 3));
        (q - p).perp(&(r - p)).atan2((q - p).dot(&(r - p)))
    };
    let lies_once = |&place: &u32| {
        let turn: f64 = layout.around(place).iter().map(angle).sum();
        // upright triangles go around an inner place a whole number of times: once is below one and a half
        turn < if layout.is_inner(place) { TAU + PI } else { TAU - SLIT }
    };
    are_within(layout, facets, bound) && places.iter().all(lies_once)
}
