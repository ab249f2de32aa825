//! Dissolution of small patches into adjacent patches.

use nalgebra::Vector3;

use super::cone::narrowest;
use super::facets::{Facets, NONE};
use super::growth::Region;
use crate::{Control, Result};

/// The largest patch that is tried. Hardly any larger patch can be dissolved, and each attempt takes longer.
const LARGEST: usize = 200;

/// The maximum number of passes over all patches; each dissolves fewer.
const PASSES: usize = 4;

/// Patches, and the patch of each facet.
struct Parts<'a, 'b> {
    facets: &'a Facets<'b>,
    least: f64,
    regions: Vec<Region>,
    owner: Vec<u32>,
}

/// The new patch of a facet, and its new normal.
struct Move {
    facet: u32,
    to: u32,
    normal: Vector3<f64>,
}

/// Dissolves patches, the smallest first, if all their facets fit into adjacent patches, which are rotated if
/// necessary. The other patches only grow, and remain connected.
pub(super) fn dissolved(
    facets: &Facets<'_>, regions: Vec<Region>, least: f64, control: &Control,
) -> Result<Vec<Region>> {
    let mut owner = vec![NONE; facets.len()];
    for (number, region) in (0..).zip(&regions) {
        region.facets.iter().for_each(|&facet| owner[facet as usize] = number);
    }
    let mut parts = Parts { facets, least, regions, owner };
    for _ in 0..PASSES {
        let size = |n: u32| parts.regions[n as usize].facets.len();
        let mut order: Vec<u32> =
            (0..parts.regions.len() as u32).filter(|&n| (1..=LARGEST).contains(&size(n))).collect();
        let key = |&n: &u32| (size(n), parts.regions[n as usize].facets.iter().copied().min());
        order.sort_by_cached_key(key);
        let mut count = 0;
        for number in order {
            control.check()?;
            if let Some(moves) = parts.ways_out(number) {
                parts.dissolve(number, moves);
                count += 1;
            }
        }
        if count == 0 {
            break;
        }
    }
    parts.regions.retain(|region| !region.facets.is_empty());
    Ok(parts.regions)
}

impl Parts<'_, '_> {
    /// Returns a new patch for every facet of a patch, or none if one of the facets has no new patch.
    fn ways_out(&self, number: u32) -> Option<Vec<Move>> {
        let mut left = self.regions[number as usize].facets.clone();
        let mut moves: Vec<Move> = Vec::new();
        while !left.is_empty() {
            let before = left.len();
            left.retain(|&facet| match self.way_out(facet, number, &moves) {
                Some(way) => {
                    moves.push(way);
                    false
                }
                None => true,
            });
            if left.len() == before {
                return None;
            }
        }
        Some(moves)
    }

    /// Returns the patch beside a facet that has to rotate least for it.
    fn way_out(&self, facet: u32, from: u32, moves: &[Move]) -> Option<Move> {
        let moved = |facet: u32| moves.iter().find(|m| m.facet == facet).map(|m| m.to);
        let beside = self.facets.across[facet as usize].into_iter().filter(|&other| other != NONE);
        let ways = beside.filter_map(|other| match self.owner[other as usize] {
            owner if owner == from => moved(other),
            owner => Some(owner),
        });
        let normal = self.facets.normals[facet as usize];
        let ways = ways.filter_map(|to| {
            let old = moves.iter().rev().find(|m| m.to == to).map_or(self.regions[to as usize].normal, |m| m.normal);
            if normal.dot(&old) >= self.least {
                return Some((2.0 + normal.dot(&old), Move { facet, to, normal: old }));
            }
            let (turned, cosine) = self.turned(facet, to, moves)?;
            Some((cosine, Move { facet, to, normal: turned }))
        });
        ways.reduce(|best, way| if way.0 > best.0 { way } else { best }).map(|(_, way)| way)
    }

    /// Returns a normal within the angle of those of a patch, of the facets moved to it, and of one more facet, and the
    /// smallest cosine to them, if there is one. Only normals outside the cone of the previous ones matter.
    fn turned(&self, facet: u32, to: u32, moves: &[Move]) -> Option<(Vector3<f64>, f64)> {
        let normal = |facet: u32| self.facets.normals[facet as usize];
        let moved = moves.iter().filter(|m| m.to == to).map(|m| m.facet);
        let all: Vec<u32> = self.regions[to as usize].facets.iter().copied().chain(moved).chain([facet]).collect();
        let mut deciding = vec![normal(facet)];
        let mut axis = deciding[0];
        loop {
            let cosine = |&facet: &u32| normal(facet).dot(&axis);
            let least = all.iter().map(|facet| (cosine(facet), *facet)).reduce(|a, b| if b.0 < a.0 { b } else { a })?;
            if least.0 >= self.least {
                return Some((axis, least.0));
            }
            deciding.push(normal(least.1));
            axis = narrowest(&deciding);
            if deciding.iter().any(|n| n.dot(&axis) < self.least) {
                return None;
            }
        }
    }

    fn dissolve(&mut self, number: u32, moves: Vec<Move>) {
        self.regions[number as usize].facets.clear();
        for Move { facet, to, normal } in moves {
            let region = &mut self.regions[to as usize];
            region.facets.push(facet);
            region.area += self.facets.areas[facet as usize];
            region.normal = normal;
            self.owner[facet as usize] = to;
        }
    }
}
