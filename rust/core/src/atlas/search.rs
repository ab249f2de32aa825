//! The choice of patches.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use rand::{SeedableRng, seq::SliceRandom};
use rand_chacha::ChaCha8Rng;

use super::facets::Facets;
use super::growth::{Growth, Region};
use crate::Result;

/// The minimum number of candidates that contain each facet, if there are enough candidates.
const COVER: u8 = 3;

pub(super) fn shuffled(facets: &Facets<'_>, seed: u64) -> Vec<u32> {
    let mut order: Vec<u32> = (0..facets.len() as u32).collect();
    order.shuffle(&mut ChaCha8Rng::seed_from_u64(seed));
    order
}

/// Takes one region after another, each on the plane of the next free seed, as in the paper.
pub(super) fn one_after_another(growth: &mut Growth<'_, '_>, seeds: &[u32]) -> Result<Vec<Region>> {
    let mut regions = Vec::new();
    for &seed in seeds {
        if !growth.taken[seed as usize] {
            let region = growth.around(seed, growth.facets.normals[seed as usize])?;
            growth.take(&region);
            regions.push(region);
        }
    }
    Ok(regions)
}

/// Takes the largest region first: candidates grow around the seeds, and the largest remainder is kept repeatedly.
/// Candidates only shrink when others are kept, so that only the one that appears largest must be computed again.
pub(super) fn largest_first(growth: &mut Growth<'_, '_>, seeds: &[u32]) -> Result<Vec<Region>> {
    let mut candidates: BinaryHeap<Candidate> = candidates(growth, seeds)?.into_iter().map(Candidate::from).collect();
    let mut regions = Vec::new();
    while let Some(Candidate { region, .. }) = candidates.pop() {
        if region.facets.iter().any(|&facet| growth.taken[facet as usize]) {
            candidates.extend(growth.pieces(&region)?.into_iter().map(Candidate::from));
            continue;
        }
        let climbed = growth.climb(region.clone())?;
        growth.take(&climbed);
        regions.push(climbed);
        candidates.extend(growth.pieces(&region)?.into_iter().map(Candidate::from)); // the rest of it
    }
    Ok(regions)
}

/// Returns regions around seeds, in their order, until every facet belongs to enough of them.
fn candidates(growth: &mut Growth<'_, '_>, seeds: &[u32]) -> Result<Vec<Region>> {
    let mut covered = vec![0u8; growth.facets.len()];
    let mut regions = Vec::new();
    for &seed in seeds {
        if covered[seed as usize] >= COVER {
            continue;
        }
        let first = growth.around(seed, growth.facets.normals[seed as usize])?;
        let climbed = growth.climb(first.clone())?;
        let has_left_its_seed = !climbed.facets.contains(&seed);
        for region in has_left_its_seed.then_some(first).into_iter().chain([climbed]) {
            region.facets.iter().for_each(|&f| covered[f as usize] = covered[f as usize].saturating_add(1));
            regions.push(region);
        }
    }
    Ok(regions)
}

/// A region that may become a patch. The largest comes first; of equally large ones, the one that begins first.
struct Candidate {
    region: Region,
    first: u32,
}

impl From<Region> for Candidate {
    fn from(region: Region) -> Self {
        let first = region.facets.iter().copied().min().unwrap_or(u32::MAX);
        Self { region, first }
    }
}

impl Ord for Candidate {
    fn cmp(&self, other: &Self) -> Ordering {
        self.region.area.total_cmp(&other.region.area).then(other.first.cmp(&self.first))
    }
}

impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Candidate {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Candidate {}
