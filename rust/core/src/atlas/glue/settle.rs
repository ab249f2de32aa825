//! Settling: what lies around a new seam is moved until every triangle is within the bound, and then to a better place.

use std::collections::HashMap;

use super::layout::Layout;
use super::strain::{Place, Price, Region, Strain};
use crate::adjacency::distinct;
use crate::control::Control;
use crate::distortion::faces::stretch_of;
use crate::embed::stress::descent::{Until, descend};
use crate::embed::stress::triangles::Rest;
use crate::error::{Error, Result};

/// The excess over such a part of the range, by its logarithm, is made less: what is within it is well within the bound.
const ASIDE: f64 = 0.8;

/// Steps of descent of the excess between two looks at the bound.
const STEPS: usize = 10;

/// Looks at the bound.
const LOOKS: usize = 8;

/// A part of the excess that remains after the steps between two looks: if more does, it is given up.
const REMAINS: f64 = 0.7;

/// A place on the boundary has less than a full turn of triangles, by so much.
const SLIT: f64 = 1e-9;

/// Part of a sheet that is moved while the rest is held.
pub(super) struct Around {
    /// The places that move, as they are numbered in the region.
    pub free: Vec<u32>,
    /// All facets that change.
    pub facets: Vec<u32>,
    region: Region,
    /// Nothing is held.
    pub is_all: bool,
}

impl Around {
    /// The places so many rings around others.
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

    /// Moves the free places until every facet is within the bound, and then so many steps to where they change less. Returns
    /// where they were; nothing, and moves none, if the bound is not reached.
    pub fn settle(
        &self,
        layout: &mut Layout<'_>,
        bound: f64,
        steps: usize,
        control: &Control,
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

    /// Are all facets within the bound, and beside each other around every place?
    pub fn is_sound(&self, layout: &Layout<'_>, bound: f64) -> bool {
        is_sound(layout, &self.facets, &self.free, bound)
    }

    /// Moves the free places of a map within the bound to where triangles change less.
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

/// Are facets upright and within a bound?
pub(super) fn are_within(layout: &Layout<'_>, facets: &[u32], bound: f64) -> bool {
    facets.iter().all(|&facet| {
        let flat = layout.flat(facet);
        let [most, least] = stretch_of(layout.facets.corners(facet), flat.map(Into::into));
        let [a, b, c] = flat.map(|p| robust::Coord { x: p.x, y: p.y });
        most <= bound && least.recip() <= bound && robust::orient2d(a, b, c) > 0.0
    })
}

/// Besides: do the facets around each place lie beside each other? Inside a piece they go around it once, at its boundary not
/// quite.
fn is_sound(layout: &Layout<'_>, facets: &[u32], places: &[u32], bound: f64) -> bool {
    use std::f64::consts::{PI, TAU};
    let angle = |&corner: &u32| {
        let facet = corner / 3;
        let [p, q, r] = [0, 1, 2].map(|k| layout.at(3 * facet + (corner + k) % 3));
        (q - p).perp(&(r - p)).atan2((q - p).dot(&(r - p)))
    };
    let lies_once = |&place: &u32| {
        let turn: f64 = layout.around(place).iter().map(angle).sum();
        turn < if layout.is_inner(place) { TAU + PI } else { TAU - SLIT }
    };
    are_within(layout, facets, bound) && places.iter().all(lies_once)
}
