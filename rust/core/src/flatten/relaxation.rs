//! Relaxation cuts: the short cuts that a map of a curved disk gains most by.

mod sketch;

use rayon::prelude::*;

use crate::control::Control;
use crate::error::{Error, Result};
use crate::flatten::check_disk;
use crate::surface::Surface;
use crate::surface::cuts::{Cut, Reason};
use crate::surface::decimate::{Options, decimate};
use crate::surface::inward::{self, Inward};
use sketch::{Sketch, Slit};

/// Vertices of the coarse surface on which cuts are tried.
const COARSE: usize = 1600;

/// Places into which cuts may lead, as far from each other and from the boundary as they go.
const TIPS: usize = 40;

/// Cuts that are tried at a time.
const AT_A_TIME: usize = 4;

/// How far a surface is cut.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Budget {
    /// All relaxation cuts together are no longer, mm.
    pub length: f64,
    /// Nor are there more.
    pub count: usize,
    /// Each gains at least so much energy for each length of √area.
    pub least_gain: f64,
}

/// A disk with relaxation cuts.
#[derive(Debug, Clone)]
pub struct Relaxed {
    /// The disk: the faces of the input; vertices on cuts are doubled and keep their ids.
    pub surface: Surface,
    /// Where it was cut, in this order.
    pub cuts: Vec<Cut>,
    /// The energy of a coarse map at first and after each cut.
    pub energies: Vec<f64>,
}

/// Cuts a disk open where it relieves its map most.
///
/// # Errors
/// [`Error::NotADisk`], [`Error::TooFewPoints`], [`Error::Cancelled`] and those of flattening.
pub fn relax(surface: &Surface, budget: Budget, control: &Control) -> Result<Relaxed> {
    check_disk(surface)?;
    let own = surface.clone().into_input(false); // a vertex' id is its number
    let coarse = decimate(&own, &[], &Options { vertices: COARSE, ..Options::default() }, control)?.surface;
    let mut sketch = Sketch::new(coarse, control)?;
    let tips = inward::spread(&sketch.surface, TIPS, control)?;
    let mut tips: Vec<Tip> = tips.iter().map(|&v| Tip { id: sketch.surface.ids()[v as usize], gain: f64::INFINITY }).collect();
    let (mut open, mut cuts, mut energies) = (own.clone(), Vec::new(), vec![sketch.energy]);
    let mut left = budget.length;
    let unit = surface.areas().iter().sum::<f64>().sqrt();
    while cuts.len() < budget.count {
        let Some((better, slit)) = best(&sketch, &mut tips, budget.least_gain / unit, left, control)? else { break };
        let Some(path) = Inward::new(&open, control)?.to(&open, |id| id == slit.tip) else { break };
        let length: f64 = path.iter().map(|&h| surface.length(h)).sum();
        if length > left {
            tips.retain(|tip| tip.id != slit.tip);
            continue;
        }
        left -= length;
        open = open.cut_open(path.iter().copied());
        cuts.push(described(surface, &path, length));
        sketch = better;
        sketch.settle(control)?;
        energies.push(sketch.energy);
        if std::env::var("RELAX").is_ok() {
            eprintln!("cut {:.0} mm (coarse {:.0}), E {:.5} by {:.5}, rate {:.5}, total {:.0}", length, slit.length, sketch.energy, energies[energies.len() - 2] - sketch.energy, (energies[energies.len() - 2] - sketch.energy) / length * unit, budget.length - left);
        }
        tips.retain(|tip| tip.id != slit.tip);
    }
    let half_edges = surface.twins().iter().zip(open.twins()).enumerate().filter(|(_, (a, b))| a != b);
    let surface = surface.cut_open(half_edges.map(|(h, _)| h as u32));
    Ok(Relaxed { surface, cuts, energies })
}

#[derive(Debug, Clone, Copy)]
struct Tip {
    id: u32,
    /// What a cut to it gained when it was tried last.
    gain: f64,
}

fn described(surface: &Surface, path: &[u32], length: f64) -> Cut {
    let end = path.last().map(|&h| surface.target(h));
    Cut { vertices: path.iter().map(|&h| surface.origin(h)).chain(end).collect(), length, reason: Reason::Relaxation }
}

fn best(sketch: &Sketch, tips: &mut [Tip], least: f64, left: f64, control: &Control) -> Result<Option<(Sketch, Slit)>> {
    let inward = Inward::new(&sketch.surface, control)?;
    let slit = |tip: &Tip| {
        let half_edges = inward.to(&sketch.surface, |id| id == tip.id)?;
        let length = half_edges.iter().map(|&h| sketch.surface.length(h)).sum();
        Some(Slit { tip: tip.id, half_edges, length })
    };
    let mut open: Vec<(usize, Slit)> = tips.iter().enumerate().filter_map(|(n, tip)| Some((n, slit(tip)?))).filter(|(_, slit)| slit.length <= left).collect();
    let rate = |tips: &[Tip], n: usize, slit: &Slit| tips[n].gain / slit.length;
    let mut found: Option<(f64, Sketch, Slit)> = None;
    loop {
        open.sort_by(|a, b| rate(tips, b.0, &b.1).total_cmp(&rate(tips, a.0, &a.1)).then(a.1.tip.cmp(&b.1.tip)));
        let bar = found.as_ref().map_or(least, |found| found.0);
        let count = open.iter().take(AT_A_TIME).take_while(|(n, slit)| rate(tips, *n, slit) > bar).count();
        if count == 0 {
            return Ok(found.map(|(_, sketch, slit)| (sketch, slit)));
        }
        let batch: Vec<(usize, Slit)> = open.drain(..count).collect();
        let tried: Vec<Sketch> = batch.par_iter().map(|(_, slit)| sketch.with(slit, control)).collect::<Result<_>>()?;
        for ((n, slit), cut) in batch.into_iter().zip(tried) {
            tips[n].gain = sketch.energy - cut.energy;
            let rate = rate(tips, n, &slit);
            if rate > found.as_ref().map_or(least, |found| found.0) {
                found = Some((rate, cut, slit));
            }
        }
    }
}
