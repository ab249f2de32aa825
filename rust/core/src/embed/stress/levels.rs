//! From coarse to fine: a map of few vertices, unfolded, then all others in between, and descent on every level.

use nalgebra::Vector2;

use super::MapEnergy;
use super::descent::{Descended, Until, descend};
use super::pairs::{Bands, Pairs};
use super::springs::Springs;
use super::triangles::{Shape, Triangles};
use crate::control::Control;
use crate::error::Result;
use crate::place::reinsertion;
use crate::rows::Rows;
use crate::surface::Surface;
use crate::surface::decimate::{Decimation, Options, decimate};

/// Vertices of the levels, from fine to coarse.
const SIZES: [usize; 3] = [15_000, 5_000, 1_600];

/// A level has at most so many times the vertices of the next finer one.
const LEAST_FALL: f64 = 0.7;

/// No longer edge is made by decimation, mm.
const LONGEST_EDGE: f64 = 8.0;

/// What of a map is judged by its stress: at most so many vertices.
const MOST_JUDGED: usize = 15_000;

pub fn flatten(
    surface: &Surface,
    rows: &impl Rows,
    start: &[[f64; 2]],
    control: &Control,
) -> Result<Vec<[f64; 2]>> {
    let t0 = std::time::Instant::now();
    let levels = levels(surface, rows.sources(), control)?;
    eprintln!("levels {:?} {:.2?}", levels.iter().map(|l| l.survivors.len()).collect::<Vec<_>>(), t0.elapsed());
    // the vertices of every level, as those of the surface
    let mut numbers: Vec<Vec<u32>> = vec![(0..surface.len() as u32).collect()];
    for level in &levels {
        let finer = &numbers[numbers.len() - 1];
        numbers.push(level.survivors.iter().map(|&v| finer[v as usize]).collect());
    }
    let judged = numbers.iter().position(|numbers| numbers.len() <= env("MJ", 15000.0) as usize).unwrap_or(numbers.len() - 1);
    let surfaces: Vec<&Surface> = std::iter::once(surface).chain(levels.iter().map(|level| &level.surface)).collect();
    let mut uv: Vec<Vector2<f64>> = numbers[levels.len()].iter().map(|&v| start[v as usize].into()).collect();
    for depth in (0..=levels.len()).rev() {
        if depth < levels.len() {
            uv = refine(&levels[depth], surfaces[depth].len(), &uv, control)?;
        }
        let judged = &numbers[judged.max(depth)];
        let mut places = vec![u32::MAX; surface.len()];
        (0..).zip(&numbers[depth]).for_each(|(n, &v)| places[v as usize] = n);
        let of = |vertices: &[u32]| vertices.iter().map(|&v| places[v as usize]).collect::<Vec<u32>>();
        let pairs = Pairs::new(rows, of(rows.sources()), of(judged), judged, control)?;
        let triangles = Triangles::new(surfaces[depth]);
        let springs = Springs::new(triangles.corners().collect(), surfaces[depth].len(), control)?;
        let level = Level { pairs, triangles, springs };
        eprintln!("level {depth}: {} vertices, folded {} {:.2?}", uv.len(), level.triangles.folded(&uv), t0.elapsed());
        if depth == levels.len() {
            level.unfold(&mut uv, control)?;
            eprintln!("  unfolded: folded {} {:.2?}", level.triangles.folded(&uv), t0.elapsed());
        }
        if depth == levels.len() { level.settle(&mut uv, control)?; }
        level.finish(&mut uv, control)?;
        eprintln!("  finished: folded {} {:.2?}", level.triangles.folded(&uv), t0.elapsed());
    }
    Ok(uv.into_iter().map(Into::into).collect())
}

/// Coarser and coarser surfaces, all with the landmarks.
fn levels(surface: &Surface, landmarks: &[u32], control: &Control) -> Result<Vec<Decimation>> {
    let mut levels: Vec<Decimation> = Vec::new();
    let mut keep = landmarks.to_vec();
    for size in SIZES {
        let finer = levels.last().map_or(surface, |level| &level.surface);
        let size = size.max(2 * landmarks.len());
        if size as f64 > LEAST_FALL * finer.len() as f64 {
            continue;
        }
        let options = Options { vertices: size, longest_edge: 2.0 * LONGEST_EDGE, ..Options::default() };
        let level = decimate(finer, &keep, &options, control)?;
        keep.iter_mut().for_each(|vertex| *vertex = level.survivors.partition_point(|&other| other < *vertex) as u32);
        levels.push(level);
    }
    Ok(levels)
}

/// The map of a finer level.
fn refine(level: &Decimation, vertices: usize, uv: &[Vector2<f64>], control: &Control) -> Result<Vec<Vector2<f64>>> {
    let mut finer = vec![[0.0; 2]; vertices];
    level.survivors.iter().zip(uv).for_each(|(&vertex, &place)| finer[vertex as usize] = place.into());
    let turned = reinsertion::place(&level.removals, &mut finer, false, control)?;
    eprintln!("  reinsertion turned {turned}");
    Ok(finer.into_iter().map(Into::into).collect())
}

struct Level {
    pairs: Pairs,
    triangles: Triangles,
    springs: Springs,
}

impl Level {
    fn descend(
        &self,
        uv: &mut Vec<Vector2<f64>>,
        bands: Bands,
        shape: Shape,
        stiffness: f64,
        until: Until,
        control: &Control,
    ) -> Result<Descended> {
        let Self { pairs, triangles, springs } = self;
        let t = std::time::Instant::now();
        let d = descend(&MapEnergy { pairs, bands, triangles, shape, stiffness, springs }, uv, until, control)?;
        eprintln!("   eps {} mu {:.3}: {} steps {:.6} -> {:.6} folded {} {:.2?}", shape.folds, shape.scale, d.energies.len()-1, d.energies[0], d.energies[d.energies.len()-1], triangles.folded(uv), t.elapsed());
        Ok(d)
    }

    /// Leads a map with folds to one without.
    fn unfold(&self, uv: &mut Vec<Vector2<f64>>, control: &Control) -> Result<()> {
        let bands = Bands { weights: [1.0, 0.3, 0.0], outlier: f64::INFINITY, local: f64::INFINITY };
        let mut shape = Shape { area: 0.0, folds: 1.0, scale: 1.0 };
        for folds in [1.0, 0.3, 0.1, 0.03, 0.01, 0.003] {
            shape.folds = folds;
            self.descend(uv, bands, shape, 0.02, Until { steps: 25, gain: 1e-5 }, control)?;
            if folds <= 0.1 && self.triangles.folded(uv) == 0 {
                break;
            }
        }
        Ok(())
    }

    fn settle(&self, uv: &mut Vec<Vector2<f64>>, control: &Control) -> Result<()> {
        let bands = Bands { weights: [1.0, 0.3, 0.0], outlier: f64::INFINITY, local: f64::INFINITY };
        let shape = Shape { area: 0.0, folds: 0.0, scale: 1.0 };
        for _ in 0..4 {
        self.descend(uv, bands, shape, 0.02, Until { steps: 15, gain: 1e-4 }, control)?;
        }
        Ok(())
    }

    fn finish(&self, uv: &mut Vec<Vector2<f64>>, control: &Control) -> Result<()> {
        let bands = Bands { weights: [env("A0",1.0), env("A1",4.0), env("A2",0.5)], outlier: env("KG",0.05), local: env("KL", 0.05) };
        for _ in 0..env("RO",12.0) as usize {
            let shape = Shape { area: env("GA",6.0), folds: 0.0, scale: self.triangles.best_scale(uv) };
            let d = self.descend(uv, bands, shape, env("BE",0.15), Until { steps: env("ST",15.0) as usize, gain: 1e-4 }, control)?;
            if d.energies.len() <= 6 {
                break;
            }
        }
        Ok(())
    }
}

fn env(name: &str, usual: f64) -> f64 { std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(usual) }
