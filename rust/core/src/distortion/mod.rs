//! Distortion of distances by flattening.
//!
//! Every measure is a function of distance rows δ (mm, from reference sources to all points) and of the distances d in
//! the flat map. It does not depend on how the map was made. Figures are given at scale 1 (a flat map is in mm) and at
//! the best scale of the map, s* = argmin mean |s·d − δ|/δ. Pairs at distance δ = 0, such as a point with itself, are
//! excluded, because they have no relative error. Undefined figures are NaN.
//!
//! Rows are passed twice, once for each scale, and are never needed all at once. Only sums (`sums`) are kept of
//! each source. The figures and their standard errors, by the bootstrap over sources, follow from them.

pub mod bootstrap;
pub mod distances;
pub mod evaluate;
pub mod faces;
mod figures;
pub mod lower_bound;
pub mod overlap;
mod scale;
pub mod sums;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::error::check_length;
use crate::geodesic::bend::is_bent;
use crate::rows::Rows;
use crate::{Control, Result};
pub use figures::Figures;
pub use sums::Bands;

use bootstrap::{StandardErrors, standard_errors};
use scale::{Answer, Ratios};
use sums::Sums;

/// The number of pairs that are kept for a scatter plot of flat against geodesic distance.
const SCATTER: usize = 20_000;

/// The number of points that one task sums.
const CHUNK: usize = 4096;

/// The maximum memory in bytes for evaluating a map, beside the rows and the map itself. The histogram of ratios for
/// the best scale takes 16 MiB; the rest are the sums of each source, the sums of the threads, and the scatter plot.
pub(crate) const WORK_BYTES: u64 = 40 << 20;

/// The distortion of distances.
#[derive(Debug, Clone, PartialEq)]
pub struct Distortion {
    /// Figures at scale 1.
    pub raw: Figures,
    /// Figures at the scale with the smallest mean relative error.
    pub best_scale: Figures,
    /// Figures of interior pairs, whose shortest path does not [bend around the boundary](crate::geodesic::bend), at the
    /// scale with the smallest mean relative error of these pairs. NaN if the rows are not marked.
    pub interior: Figures,
    /// The share of interior pairs; NaN if the rows are not marked.
    pub interior_share: f64,
    /// The correlation of d and δ.
    pub pearson_r: f64,
    /// The mean of δ in mm (δ̄ of Grossmann et al.).
    pub mean_geodesic: f64,
    /// Standard errors of the figures, due to the choice of sources.
    pub standard_error: StandardErrors,
    /// The number of sources.
    pub sources: usize,
    /// The number of pairs.
    pub pairs: usize,
    /// For each point, the mean of |d − δ|/δ over the reference sources, at scale 1.
    pub per_point: Vec<f64>,
    /// Some of the pairs, as [δ, d] in mm.
    pub scatter: Vec<[f64; 2]>,
}

/// How maps are evaluated.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Evaluation {
    /// The distance bands of the figures.
    pub bands: Bands,
    /// The seed of the reference sources.
    pub seed: u64,
}

/// Evaluates flat maps of the same vertices (positions in mm) against distance rows to all of their points, which may be
/// marked. If the maps repeat in the second direction with a period, distances are measured to the nearest copy.
pub(crate) fn measure<R: Rows>(
    maps: &[&[[f64; 2]]], period: Option<f64>, rows: &R, are_marked: bool, evaluation: Evaluation, control: &Control,
) -> Result<Vec<Distortion>> {
    let (sources, columns) = (rows.sources().len(), rows.columns());
    maps.iter().try_for_each(|uv| check_length("positions", uv.len(), "points", columns))?;
    let mut maps: Vec<Evaluated> =
        maps.iter().map(|&uv| Evaluated::new(Plane { uv, period }, sources, are_marked, evaluation)).collect();
    control.begin("measuring distortion", 2);
    pass(&mut maps, rows, control, Evaluated::take_raw)?;
    control.advance();
    while maps.iter_mut().any(Evaluated::seeks_scale) {
        pass(&mut maps, rows, control, Evaluated::take_ratios)?;
    }
    pass(&mut maps, rows, control, Evaluated::take_best)?;
    control.advance();
    maps.into_iter().map(|map| map.distortion(control)).collect()
}

/// Returns the scale at which the distances of interior pairs are closest to the marked rows: argmin mean |s·d − δ|/δ.
/// The rows must reach all points of the map, which may have a period as in [`measure`]. NaN if all positions coincide.
pub(crate) fn best_scale<R: Rows>(uv: &[[f64; 2]], period: Option<f64>, rows: &R, control: &Control) -> Result<f64> {
    let mut map = [Evaluated::new(Plane { uv, period }, 0, true, Evaluation::default())];
    pass(&mut map, rows, control, |map, block, control| {
        map.begin_ratios(block, control)?;
        map.take_ratios(block, control)
    })?;
    while map[0].seeks_scale() {
        pass(&mut map, rows, control, Evaluated::take_ratios)?;
    }
    Ok(map[0].interior.scale.unwrap_or(f64::NAN))
}

fn pass<'a, R: Rows>(
    maps: &mut [Evaluated<'a>], rows: &R, control: &Control,
    take: impl Fn(&mut Evaluated<'a>, &Block, &Control) -> Result<()>,
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

    /// Computes one value per source in parallel, in order; `value` receives the source's number in the block.
    fn each_source<T: Send>(&self, control: &Control, value: impl Fn(usize) -> T + Sync) -> Result<Vec<T>> {
        let of_source = |n| control.check().map(|()| value(n));
        (0..self.sources.len()).into_par_iter().map(of_source).collect()
    }

    /// Visits (δ, d) for all pairs of the n-th source with other points, and whether the last bit of δ is a mark.
    #[inline]
    fn pairs(&self, n: usize, plane: Plane, mut visit: impl FnMut(f64, f64, bool)) {
        let source = self.sources[n] as usize;
        for (point, &delta) in self.row(n)[..plane.uv.len()].iter().enumerate() {
            if point != source && delta != 0.0 {
                visit(f64::from(delta), plane.apart(source, point), is_bent(delta));
            }
        }
    }
}

/// Positions in the plane, which may repeat in the second direction.
#[derive(Clone, Copy)]
struct Plane<'a> {
    uv: &'a [[f64; 2]],
    period: Option<f64>,
}

impl Plane<'_> {
    #[inline]
    fn apart(&self, one: usize, other: usize) -> f64 {
        let ([x, y], [u, v]) = (self.uv[one], self.uv[other]);
        // the nearest copy: the remainder is at most half a period
        let along = self.period.map_or(v - y, |period| v - y - period * ((v - y) / period).round());
        ((u - x) * (u - x) + along * along).sqrt()
    }
}

/// A map and its figures so far.
struct Evaluated<'a> {
    plane: Plane<'a>,
    /// Sums at scale 1, for each source.
    raw: Vec<Sums>,
    all: AtBestScale,
    /// Those of interior pairs; all pairs are interior if the rows are not marked.
    interior: AtBestScale,
    are_marked: bool,
    evaluation: Evaluation,
    /// The sum and the number of relative errors of each point.
    per_point: Vec<(f64, f64)>,
    /// Pairs for the scatter plot: the number of a source, and the cyclic offset from the source to the point.
    chosen: Vec<(usize, usize)>,
    scatter: Vec<[f64; 2]>,
}

/// Some of the pairs of a map, and their best scale.
#[derive(Default)]
struct AtBestScale {
    ratios: Ratios,
    scale: Option<f64>,
    /// Sums at the best scale, for each source.
    sums: Vec<Sums>,
}

impl AtBestScale {
    /// Looks for the best scale among the counted ratios. Returns whether they must be counted again elsewhere.
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

    /// Counts a pair, as long as the best scale is unknown.
    #[inline]
    fn count(&self, delta: f64, d: f64) {
        if self.scale.is_none() {
            self.ratios.add(delta, d);
        }
    }

    fn figures(&self) -> Figures {
        self.sums.iter().sum::<Sums>().figures(self.scale.unwrap_or(f64::NAN))
    }
}

impl<'a> Evaluated<'a> {
    fn new(plane: Plane<'a>, sources: usize, are_marked: bool, evaluation: Evaluation) -> Self {
        let uv = plane.uv;
        let mut rng = ChaCha8Rng::seed_from_u64(evaluation.seed);
        let others = uv.len().saturating_sub(1);
        let pairs = if others == 0 { 0 } else { SCATTER.min(sources * others) };
        let mut chosen: Vec<_> =
            (0..pairs).map(|_| (rng.random_range(0..sources), rng.random_range(1..uv.len()))).collect();
        chosen.sort_unstable(); // blocks arrive in the order of the sources
        Self {
            plane,
            raw: Vec::with_capacity(sources),
            all: AtBestScale::default(),
            interior: AtBestScale::default(),
            are_marked,
            evaluation,
            per_point: vec![(0.0, 0.0); uv.len()],
            chosen,
            scatter: Vec::with_capacity(pairs),
        }
    }

    /// Begins to count ratios around those of the first source.
    fn begin_ratios(&mut self, block: &Block, control: &Control) -> Result<()> {
        if block.first == 0 && !block.sources.is_empty() {
            control.check()?;
            let (mut all, mut interior) = (Vec::with_capacity(block.columns), Vec::new());
            block.pairs(0, self.plane, |delta, d, is_bent| {
                all.push((delta, d));
                if self.counts_as_interior(is_bent) {
                    interior.push((delta, d));
                }
            });
            self.all.ratios = Ratios::around_median(all.into_iter());
            self.interior.ratios = Ratios::around_median(interior.into_iter());
        }
        Ok(())
    }

    #[inline]
    fn counts_as_interior(&self, is_bent: bool) -> bool {
        !(is_bent && self.are_marked)
    }

    fn take_raw(&mut self, block: &Block, control: &Control) -> Result<()> {
        self.begin_ratios(block, control)?;
        let sums = block.each_source(control, |n| {
            let mut sums = Sums::default();
            block.pairs(n, self.plane, |delta, d, is_bent| {
                sums.add(&self.evaluation.bands, delta, d);
                self.count(delta, d, is_bent);
            });
            sums
        })?;
        self.raw.extend(sums);
        self.take_points(block, control)?;
        self.take_scatter(block);
        Ok(())
    }

    #[inline]
    fn count(&self, delta: f64, d: f64, is_bent: bool) {
        self.all.count(delta, d);
        if self.counts_as_interior(is_bent) {
            self.interior.count(delta, d);
        }
    }

    /// Adds to the sum of each point, source by source, so that the result does not depend on blocks or threads.
    fn take_points(&mut self, block: &Block, control: &Control) -> Result<()> {
        let plane = self.plane;
        self.per_point.par_chunks_mut(CHUNK).enumerate().try_for_each(|(chunk, sums)| {
            control.check()?;
            let start = chunk * CHUNK;
            for (n, &source) in block.sources.iter().enumerate() {
                let row = &block.row(n)[start..start + sums.len()];
                for (point, (sum, &delta)) in (start..).zip(sums.iter_mut().zip(row)) {
                    if point != source as usize && delta != 0.0 {
                        let delta = f64::from(delta);
                        sum.0 += (plane.apart(source as usize, point) - delta).abs() / delta;
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
            let point = (source + behind) % self.plane.uv.len(); // any point but the source
            [f64::from(block.row(n - block.first)[point]), self.plane.apart(source, point)]
        }));
    }

    /// Looks for the best scales among the counted ratios. Returns whether some must be counted again elsewhere.
    fn seeks_scale(&mut self) -> bool {
        self.all.seeks_scale() | self.interior.seeks_scale()
    }

    fn take_ratios(&mut self, block: &Block, control: &Control) -> Result<()> {
        block.each_source(control, |n| {
            block.pairs(n, self.plane, |delta, d, is_bent| self.count(delta, d, is_bent));
        })?;
        Ok(())
    }

    fn take_best(&mut self, block: &Block, control: &Control) -> Result<()> {
        let scales = [&self.all, &self.interior].map(|pairs| pairs.scale.unwrap_or(f64::NAN));
        let sums = block.each_source(control, |n| {
            let [mut all, mut interior] = [Sums::default(); 2];
            block.pairs(n, self.plane, |delta, d, is_bent| {
                all.add(&self.evaluation.bands, delta, scales[0] * d);
                if self.counts_as_interior(is_bent) {
                    interior.add(&self.evaluation.bands, delta, scales[1] * d);
                }
            });
            (all, interior)
        })?;
        for (all, interior) in sums {
            self.all.sums.push(all);
            self.interior.sums.push(interior);
        }
        Ok(())
    }

    fn distortion(self, control: &Control) -> Result<Distortion> {
        let raw = self.raw.iter().sum::<Sums>();
        let [interior, pairs] = [&self.interior.sums, &self.raw].map(|sums| sums.iter().sum::<Sums>().pairs() as f64);
        let undefined = || Sums::default().figures(f64::NAN);
        Ok(Distortion {
            raw: raw.figures(1.0),
            best_scale: self.all.figures(),
            interior: if self.are_marked { self.interior.figures() } else { undefined() },
            interior_share: if self.are_marked { interior / pairs } else { f64::NAN },
            pearson_r: raw.correlation(),
            mean_geodesic: raw.mean_geodesic(),
            standard_error: standard_errors(
                &self.raw,
                &self.all.sums,
                self.plane.uv.len(),
                self.evaluation.seed,
                control,
            )?,
            sources: self.raw.len(),
            pairs: raw.pairs(),
            per_point: self.per_point.iter().map(|(sum, count)| sum / count).collect(), // NaN without other sources
            scatter: self.scatter,
        })
    }
}

#[cfg(test)]
mod tests;
