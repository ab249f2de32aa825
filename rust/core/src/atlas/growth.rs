//! Growth of patches over triangles that face in similar directions.

use std::collections::HashSet;

use nalgebra::Vector3;

use super::facets::{Facets, NONE};
use crate::{Control, Result};

/// Growing patches, and which facets are taken.
pub(super) struct Growth<'a, 'b> {
    pub facets: &'a Facets<'b>,
    /// The smallest cosine between a facet's normal and that of its patch.
    least: f64,
    pub taken: Vec<bool>,
    seen: Vec<u32>,
    epoch: u32,
    control: &'a Control,
}

/// Connected facets, and their direction.
#[derive(Debug, Clone)]
pub(super) struct Region {
    pub normal: Vector3<f64>,
    pub facets: Vec<u32>,
    pub area: f64,
}

impl<'a, 'b> Growth<'a, 'b> {
    pub fn new(facets: &'a Facets<'b>, least: f64, control: &'a Control) -> Self {
        Self { facets, least, taken: vec![false; facets.len()], seen: vec![0; facets.len()], epoch: 0, control }
    }

    /// Returns the free facets around a start whose normals are close enough to this one. The start is included if it
    /// is free and its own normal is close enough.
    pub fn around(&mut self, start: u32, normal: Vector3<f64>) -> Result<Region> {
        self.epoch += 1;
        let mut region = Region { normal, facets: Vec::new(), area: 0.0 };
        self.reach(start, normal, &mut region.facets);
        let mut at = 0;
        while at < region.facets.len() {
            if at % 1024 == 0 {
                self.control.check()?;
            }
            let facet = region.facets[at] as usize;
            region.area += self.facets.areas[facet];
            for next in self.facets.across[facet] {
                self.reach(next, normal, &mut region.facets);
            }
            at += 1;
        }
        Ok(region)
    }

    fn reach(&mut self, facet: u32, normal: Vector3<f64>, queue: &mut Vec<u32>) {
        let f = facet as usize;
        if facet != NONE
            && !self.taken[f]
            && self.seen[f] != self.epoch
            && self.facets.normals[f].dot(&normal) >= self.least
        {
            self.seen[f] = self.epoch;
            queue.push(facet);
        }
    }

    /// Rotates a region's plane towards its facets' mean normal and grows it again, as long as it becomes larger.
    pub fn climb(&mut self, mut region: Region) -> Result<Region> {
        loop {
            let sum: Vector3<f64> =
                region.facets.iter().map(|&f| self.facets.normals[f as usize] * self.facets.areas[f as usize]).sum();
            let normal = sum.normalize(); // all normals lie on one side
            let start = self.facets.facing(&region.facets, &normal);
            let grown = self.around(start, normal)?;
            if grown.area <= region.area {
                return Ok(region);
            }
            region = grown;
        }
    }

    /// Returns the connected components of the free facets of a region.
    pub fn pieces(&mut self, of: &Region) -> Result<Vec<Region>> {
        let free: Vec<u32> = of.facets.iter().copied().filter(|&f| !self.taken[f as usize]).collect();
        let mut pieces: Vec<Region> = Vec::new();
        let mut done = HashSet::new();
        for &start in &free {
            if done.contains(&start) {
                continue;
            }
            let piece = self.around(start, of.normal)?;
            done.extend(piece.facets.iter().copied());
            pieces.push(piece);
        }
        Ok(pieces)
    }

    pub fn take(&mut self, region: &Region) {
        for &facet in &region.facets {
            self.taken[facet as usize] = true;
            self.control.advance();
        }
    }
}
