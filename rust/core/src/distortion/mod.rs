//! Distortion: what flattening did to the distances.
//!
//! A measure is a pure function of distance rows δ (mm, from reference sources to all points) and the flat map's distances
//! d. It never looks at how the map was made. Figures are given raw (a flat map is in mm) and at the map's best scale
//! s* = argmin mean |s·d − δ|/δ. Pairs of a point with itself, or with another at no distance from it, are left out: they have
//! no relative error. Undefined figures are NaN.
//!
//! Rows are passed twice, once for each scale, and are never needed all at once. What is kept of each source are its
//! [sums](sums::Sums), from which the figures and, by the bootstrap over sources, their standard errors follow.

pub mod bootstrap;
pub mod distances;
pub mod faces;
mod figures;
pub mod judge;
pub mod overlap;
mod scale;
pub mod sums;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::control::Control;
use crate::error::Result;
use crate::rows::Rows;
pub use figures::Figures;

use bootstrap::{StandardErrors, standard_errors};
use scale::{Answer, Ratios};
use sums::Sums;

/// Pairs kept to be drawn as a scatter of flat against geodesic distance.
const SCATTER: usize = 20_000;

/// Points that one task sums up.
const CHUNK: usize = 4096;

/// The memory in bytes that measuring a map needs at most beside rows and the map itself: 16 MiB are the histogram of
/// ratios in which the best scale is found, the rest sums of each source, what threads sum up, and the scatter.
pub const WORK_BYTES: u64 = 40 << 20;

/// What flattening did to the distances.
#[derive(Debug, Clone, PartialEq)]
pub struct Distortion {
    /// At scale 1.
    pub raw: Figures,
    /// At the scale with the least mean relative error.
    pub best_scale: Figures,
    /// Correlation of d and δ.
    pub pearson_r: f64,
    /// Mean of δ, mm (Grossmann et al.: δ̄).
    pub mean_geodesic: f64,
    /// How far the figures scatter with the choice of the sources.
    pub standard_error: StandardErrors,
    /// Number of sources.
    pub sources: usize,
    /// Number of pairs.
    pub pairs: usize,
    /// For each point the mean of |d − δ|/δ over the reference sources, at scale 1.
    pub per_point: Vec<f64>,
    /// Some of the pairs, as [δ, d] in mm.
    pub scatter: Vec<[f64; 2]>,
}

/// Measures flat maps (places in mm, of the same vertices) against distance rows to all of their points.
pub fn measure<R: Rows>(maps: &[&[[f64; 2]]], rows: &R, seed: u64, control: &Control) -> Result<Vec<Distortion>> {
    let mut maps: Vec<Judged> = maps.iter().map(|uv| Judged::new(uv, rows.sources().len(), seed)).collect();
    control.begin("measuring distortion", 2);
    pass(&mut maps, rows, control, Judged::take_raw)?;
    control.advance();
    while maps.iter_mut().any(Judged::seeks_scale) {
        pass(&mut maps, rows, control, Judged::take_ratios)?;
    }
    pass(&mut maps, rows, control, Judged::take_best)?;
    control.advance();
    maps.into_iter().map(|map| map.distortion(seed, control)).collect()
}

/// The scale at which a map's distances are nearest to those of rows to all of its points: argmin mean |s·d − δ|/δ. NaN where
/// all places are one.
pub fn best_scale<R: Rows>(uv: &[[f64; 2]], rows: &R, control: &Control) -> Result<f64> {
    let mut map = [Judged::new(uv, 0, 0)];
    pass(&mut map, rows, control, |map, block, control| {
        map.begin_ratios(block, control)?;
        map.take_ratios(block, control)
    })?;
    while map[0].seeks_scale() {
        pass(&mut map, rows, control, Judged::take_ratios)?;
    }
    Ok(map[0].scale.unwrap_or(f64::NAN))
}

fn pass<'a, R: Rows>(
    maps: &mut [Judged<'a>],
    rows: &R,
    control: &Control,
    take: impl Fn(&mut Judged<'a>, &Block, &Control) -> Result<()>,
) -> Result<()> {
    let columns = rows.columns().max(1);
    rows.visit(control, &mut |first, data| {
        let sources = &rows.sources()[first..first + data.len() / columns];
        let block = Block { first, sources, data, columns };
        maps.iter_mut().try_for_each(|map| take(map, &block, control))
    })
}

struct Block<'a> {
    first: usize,
    sources: &'a [u32],
    data: &'a [f32],
    columns: usize,
}

impl Block<'_> {
    fn row(&self, n: usize) -> &[f32] {
        &self.data[n * self.columns..(n + 1) * self.columns]
    }

    /// One value a source, in parallel, in the order of the sources, by its number among these.
    fn each_source<T: Send>(&self, control: &Control, value: impl Fn(usize) -> T + Sync) -> Result<Vec<T>> {
        let of_source = |n| control.check().map(|()| value(n));
        (0..self.sources.len()).into_par_iter().map(of_source).collect()
    }

    /// Visits the (δ, d) of all pairs of the n-th source with others.
    #[inline]
    fn pairs(&self, n: usize, uv: &[[f64; 2]], mut visit: impl FnMut(f64, f64)) {
        let source = self.sources[n] as usize;
        let from = uv[source];
        for (point, (&delta, &place)) in self.row(n).iter().zip(uv).enumerate() {
            if point != source && delta != 0.0 {
                visit(f64::from(delta), apart(from, place));
            }
        }
    }
}

fn apart([x, y]: [f64; 2], [u, v]: [f64; 2]) -> f64 {
    ((u - x) * (u - x) + (v - y) * (v - y)).sqrt()
}

/// A map, and what is known of it so far.
struct Judged<'a> {
    uv: &'a [[f64; 2]],
    /// At scale 1 and at the best scale, source by source.
    raw: Vec<Sums>,
    best: Vec<Sums>,
    ratios: Ratios,
    scale: Option<f64>,
    /// Sum and number of relative errors of each point.
    per_point: Vec<(f64, f64)>,
    /// Pairs for the scatter, as the number of a source and how far behind it, around the end, the point is.
    chosen: Vec<(usize, usize)>,
    scatter: Vec<[f64; 2]>,
}

impl<'a> Judged<'a> {
    fn new(uv: &'a [[f64; 2]], sources: usize, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let others = uv.len().saturating_sub(1);
        let pairs = if others == 0 { 0 } else { SCATTER.min(sources * others) };
        let mut chosen: Vec<_> =
            (0..pairs).map(|_| (rng.random_range(0..sources), rng.random_range(1..uv.len()))).collect();
        chosen.sort_unstable(); // blocks come in the order of the sources
        Self {
            uv,
            raw: Vec::with_capacity(sources),
            best: Vec::with_capacity(sources),
            ratios: Ratios::default(),
            scale: None,
            per_point: vec![(0.0, 0.0); uv.len()],
            chosen,
            scatter: Vec::with_capacity(pairs),
        }
    }

    /// Begins to count ratios around those of the first source.
    fn begin_ratios(&mut self, block: &Block, control: &Control) -> Result<()> {
        if block.first == 0 && !block.sources.is_empty() {
            control.check()?;
            let mut first = Vec::with_capacity(block.columns);
            block.pairs(0, self.uv, |delta, d| first.push((delta, d)));
            self.ratios = Ratios::around_median(first.into_iter());
        }
        Ok(())
    }

    fn take_raw(&mut self, block: &Block, control: &Control) -> Result<()> {
        self.begin_ratios(block, control)?;
        let (uv, ratios) = (self.uv, &self.ratios);
        let sums = block.each_source(control, |n| {
            let mut sums = Sums::default();
            block.pairs(n, uv, |delta, d| {
                sums.add(delta, d);
                ratios.add(delta, d);
            });
            sums
        })?;
        self.raw.extend(sums);
        self.take_points(block, control)?;
        self.take_scatter(block);
        Ok(())
    }

    /// Adds to each point's sum, source by source, so that it does not depend on blocks or threads.
    fn take_points(&mut self, block: &Block, control: &Control) -> Result<()> {
        let uv = self.uv;
        self.per_point.par_chunks_mut(CHUNK).enumerate().try_for_each(|(chunk, sums)| {
            control.check()?;
            let start = chunk * CHUNK;
            for (n, &source) in block.sources.iter().enumerate() {
                let row = &block.row(n)[start..start + sums.len()];
                for (point, (sum, &delta)) in (start..).zip(sums.iter_mut().zip(row)) {
                    if point != source as usize && delta != 0.0 {
                        let delta = f64::from(delta);
                        sum.0 += (apart(uv[source as usize], uv[point]) - delta).abs() / delta;
                        sum.1 += 1.0;
                    }
                }
            }
            Ok(())
        })
    }

    fn take_scatter(&mut self, block: &Block) {
        let begin = self.scatter.len();
        let here = self.chosen[begin..].iter().take_while(|&&(n, _)| n < block.first + block.sources.len());
        self.scatter.extend(here.map(|&(n, behind)| {
            let source = block.sources[n - block.first] as usize;
            let point = (source + behind) % self.uv.len(); // any but the source
            [f64::from(block.row(n - block.first)[point]), apart(self.uv[source], self.uv[point])]
        }));
    }

    /// Looks for the best scale among the ratios that were counted; if it lies elsewhere they have to be counted there.
    fn seeks_scale(&mut self) -> bool {
        if self.scale.is_none() {
            match self.ratios.median() {
                Answer::Found(scale) => {
                    self.scale = Some(scale);
                    self.ratios = Ratios::default();
                }
                Answer::Elsewhere(ratios) => self.ratios = ratios,
            }
        }
        self.scale.is_none()
    }

    fn take_ratios(&mut self, block: &Block, control: &Control) -> Result<()> {
        if self.scale.is_none() {
            block.each_source(control, |n| block.pairs(n, self.uv, |delta, d| self.ratios.add(delta, d)))?;
        }
        Ok(())
    }

    fn take_best(&mut self, block: &Block, control: &Control) -> Result<()> {
        let (uv, scale) = (self.uv, self.scale.unwrap_or(f64::NAN));
        let sums = block.each_source(control, |n| {
            let mut sums = Sums::default();
            block.pairs(n, uv, |delta, d| sums.add(delta, scale * d));
            sums
        })?;
        self.best.extend(sums);
        Ok(())
    }

    fn distortion(self, seed: u64, control: &Control) -> Result<Distortion> {
        let scale = self.scale.unwrap_or(f64::NAN);
        let [raw, best] = [&self.raw, &self.best].map(|parts| parts.iter().sum::<Sums>());
        Ok(Distortion {
            raw: raw.figures(1.0),
            best_scale: best.figures(scale),
            pearson_r: raw.correlation(),
            mean_geodesic: raw.mean_geodesic(),
            standard_error: standard_errors(&self.raw, &self.best, self.uv.len(), seed, control)?,
            sources: self.raw.len(),
            pairs: raw.pairs(),
            per_point: self.per_point.iter().map(|(sum, count)| sum / count).collect(), // NaN where there is no other source
            scatter: self.scatter,
        })
    }
}

#[cfg(test)]
mod tests;
