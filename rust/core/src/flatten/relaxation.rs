//! Relaxation cuts: a few short cuts that reduce the distortion of a curved disk's map most (docs/decisions/0016).
//!
//! A curved disk cannot be flat. A cut from its boundary inwards lets it spread. Candidate cuts are tried on a
//! `Preview`, the map of a coarse surface. They lead to candidate tips that are spread evenly over the surface, each
//! along the shortest path from the boundary. The cut with the largest decrease in energy for its length is also made
//! on the surface itself. Then the next cut is chosen from the new boundary, so that cuts grow longer or branch. The
//! search ends when the total length is used up or no cut improves the map enough.

mod preview;

use rayon::prelude::*;

use super::check::check_domain;
use crate::surface::Surface;
use crate::surface::cuts::inward::{Inward, from_sides, spread};
use crate::surface::cuts::{Cut, Reason, described};
use crate::surface::decimate::{Options, decimate};
use crate::{Control, Error, Result};
use preview::{LANDMARKS, Preview};

/// The number of vertices of the coarse surface on which cuts are tried.
const COARSE: usize = 1000;

/// The number of candidate tips of cuts.
const TIPS: usize = 40;

/// The largest number of cuts.
const MOST_CUTS: usize = 32;

/// The value of a cut is its gain divided by this power of its length. Of cuts with the same gain per length, the
/// longest one is preferred, because many short cuts leave more pieces between them.
const POWER: f64 = 0.7;

/// The number of cuts that are tried at a time. It decides which cuts are tried, so it is fixed.
const AT_A_TIME: usize = 4;

/// Limits on the cuts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Relaxation {
    /// The maximum total length of the cuts, in mm.
    pub length: f64,
    /// The minimum decrease in energy per length of √area that is cut.
    pub least_gain: f64,
    /// The minimum share by which all cuts together reduce the distance error of the coarse map; otherwise, no cut is
    /// made. With 0, the error is not considered; it differs from the energy.
    pub least_relief: f64,
    /// If the distance error without cuts is at most this, no cut is made.
    pub bearable: f64,
    /// Cuts stay within this distance (mm along edges) of existing cuts, whose vertices share ids.
    pub within: f64,
}

impl Default for Relaxation {
    /// Cuts as long as they reduce the energy enough: about 350 mm on a hemisphere without its medial wall.
    fn default() -> Self {
        Self { length: f64::INFINITY, least_gain: 0.02, least_relief: 0.0, bearable: 0.0, within: f64::INFINITY }
    }
}

impl Relaxation {
    fn validate(&self) -> Result<()> {
        let options = [
            ("length", self.length, f64::INFINITY),
            ("least_gain", self.least_gain, f64::INFINITY),
            ("least_relief", self.least_relief, 1.0),
            ("bearable", self.bearable, f64::INFINITY),
            ("within", self.within, f64::INFINITY),
        ];
        match options.into_iter().find(|(_, value, most)| !(0.0..=*most).contains(value)) {
            Some((name, value, _)) => Err(Error::RelaxationOption { name, value }),
            None => Ok(()),
        }
    }
}

/// A disk with relaxation cuts.
#[derive(Debug, Clone, PartialEq)]
pub struct Relaxed {
    /// The disk: the faces of the input. Vertices on cuts are doubled and keep their ids.
    pub surface: Surface,
    /// The cuts in the order in which they were made, each from the boundary or from another cut inwards.
    pub cuts: Vec<Cut>,
    /// The energy of the coarse map before and after each cut; empty if no cut could be tried.
    pub energies: Vec<f64>,
    /// The mean relative distance error of the coarse map at its best scale, without cuts and with all cuts. Both are
    /// equal if no cut is made, and NaN if no cut could be tried.
    pub errors: [f64; 2],
}

/// Cuts a disk open where this reduces the distortion of its map most. The result is deterministic.
///
/// # Errors
/// [`Error::RelaxationOption`], [`Error::NotADisk`], and [`Error::Cancelled`].
pub fn relax(surface: &Surface, relaxation: Relaxation, control: &Control) -> Result<Relaxed> {
    relaxation.validate()?;
    check_domain(surface)?;
    let uncut = |energies, errors| Ok(Relaxed { surface: surface.clone(), cuts: Vec::new(), energies, errors });
    if relaxation.length == 0.0 {
        return uncut(Vec::new(), [f64::NAN; 2]);
    }
    let near: Option<Vec<bool>> = match relaxation.within {
        f64::INFINITY => None,
        within => Some(from_sides(surface, control)?.into_iter().map(|distance| distance <= within).collect()),
    };
    let mut open = surface.clone().into_input(false); // the id of a vertex is now its number
    let coarse = decimate(&open, &[], &Options { vertices: COARSE, ..Options::default() }, control)?.surface;
    control.begin("choosing relaxation cuts", MOST_CUTS as u64);
    if coarse.len() <= LANDMARKS {
        return uncut(Vec::new(), [f64::NAN; 2]);
    }
    let unit = surface.areas().iter().sum::<f64>().sqrt();
    let mut trials = Trials::new(coarse, relaxation.least_gain / unit, near, control)?;
    let (mut cuts, mut energies) = (Vec::new(), vec![trials.preview.energy]);
    let error = trials.preview.error(control)?;
    let mut left = relaxation.length;
    while cuts.len() < MOST_CUTS
        && error > relaxation.bearable
        && let Some(trial) = trials.best(left, control)?
    {
        let path = Inward::of(&open, control)?.to(trial.slit.tip);
        let mut path = path.unwrap_or_default();
        path.truncate(path.iter().take_while(|&&h| trials.allows(&open, h)).count());
        let (path, length) = shortened(surface, path, left); // it may be longer than on the coarse surface
        if path.is_empty() {
            break;
        }
        left -= length;
        open = open.cut_open(path.iter().copied());
        cuts.push(described(surface, &path, Reason::Relaxation));
        trials.accept(trial, control)?;
        energies.push(trials.preview.energy);
        control.advance();
    }
    let relieved = if cuts.is_empty() { error } else { trials.preview.error(control)? };
    if relaxation.least_relief > 0.0 && relieved > (1.0 - relaxation.least_relief) * error {
        energies.truncate(1);
        return uncut(energies, [error; 2]);
    }
    let is_cut = |&h: &u32| surface.twins()[h as usize] != open.twins()[h as usize];
    let seam: Vec<u32> = (0..surface.twins().len() as u32).filter(is_cut).collect();
    Ok(Relaxed { surface: surface.cut_open(seam), cuts, energies, errors: [error, relieved] })
}

/// A candidate tip of a cut.
#[derive(Debug, Clone, Copy)]
struct Tip {
    id: u32,
    /// The decrease in energy by a cut to it when it was last tried; arbitrary at first.
    gain: f64,
}

#[derive(Debug)]
struct Slit {
    /// The id of the vertex at the tip.
    tip: u32,
    half_edges: Vec<u32>,
    /// Length in mm.
    length: f64,
}

/// A cut and the coarse map after it.
struct Trial {
    slit: Slit,
    preview: Preview,
}

struct Trials {
    preview: Preview,
    tips: Vec<Tip>,
    /// The minimum decrease in energy per mm.
    least_rate: f64,
    /// The vertices, by their ids, on which cuts may lie; all if none.
    near: Option<Vec<bool>>,
}

impl Trials {
    fn new(coarse: Surface, least_rate: f64, near: Option<Vec<bool>>, control: &Control) -> Result<Self> {
        let mut trials = Self { preview: Preview::new(coarse, control)?, tips: Vec::new(), least_rate, near };
        let surface = &trials.preview.surface;
        let tips = spread(surface, TIPS, |v| trials.is_near(surface.ids()[v as usize]), control)?;
        trials.tips = tips.into_iter().map(|v| Tip { id: surface.ids()[v as usize], gain: f64::INFINITY }).collect();
        Ok(trials)
    }

    fn is_near(&self, id: u32) -> bool {
        self.near.as_ref().is_none_or(|near| near[id as usize])
    }

    /// Returns whether a cut may run along a half-edge of a surface with these ids.
    fn allows(&self, surface: &Surface, half_edge: u32) -> bool {
        [surface.origin(half_edge), surface.target(half_edge)].iter().all(|&v| self.is_near(surface.ids()[v as usize]))
    }

    /// Returns the most valuable cut that is no longer than `longest` mm; none if no cut improves the map enough.
    ///
    /// After a cut is made near by, the gain of another cut decreases, and hardly ever increases. Therefore, the cuts
    /// that were most valuable in their last trial are tried first, and cuts whose last value is below the best new one
    /// are skipped (Minoux 1978). No gain exceeds the total energy, so few cuts are tried if it is low.
    fn best(&mut self, longest: f64, control: &Control) -> Result<Option<Trial>> {
        let mut untried = self.slits(longest, control)?;
        let mut best: Option<(f64, Trial)> = None;
        loop {
            let most = |n: usize| self.tips[n].gain.min(self.preview.energy);
            let worth = |(n, slit): &(usize, Slit)| self.worth(most(*n), slit.length);
            untried.sort_by(|a, b| worth(b).total_cmp(&worth(a)).then(a.1.tip.cmp(&b.1.tip)));
            let bar = best.as_ref().map_or(0.0, |best| best.0);
            let count = untried.iter().take(AT_A_TIME).take_while(|slit| worth(slit) > bar).count();
            if count == 0 {
                return Ok(best.map(|(_, trial)| trial));
            }
            let batch: Vec<(usize, Slit)> = untried.drain(..count).collect();
            let tried = |(_, slit): &(usize, Slit)| self.preview.with(&slit.half_edges, control);
            let tried: Vec<Preview> = batch.par_iter().map(tried).collect::<Result<_>>()?;
            for ((n, slit), preview) in batch.into_iter().zip(tried) {
                self.tips[n].gain = self.preview.energy - preview.energy;
                let worth = self.worth(self.tips[n].gain, slit.length);
                if worth > best.as_ref().map_or(0.0, |best| best.0) {
                    best = Some((worth, Trial { slit, preview }));
                }
            }
        }
    }

    /// Returns the value of a cut with this gain; none if the gain is too small for its length.
    fn worth(&self, gain: f64, length: f64) -> f64 {
        if gain > self.least_rate * length { gain / length.powf(POWER) } else { 0.0 }
    }

    /// Returns the shortest path from the boundary to each tip; of paths that are too long, the beginning.
    fn slits(&self, longest: f64, control: &Control) -> Result<Vec<(usize, Slit)>> {
        let surface = &self.preview.surface;
        let inward = Inward::of(surface, control)?;
        let slit = |tip: &Tip| {
            let path = Some(inward.to(tip.id)?).filter(|path| path.iter().all(|&h| self.allows(surface, h)))?;
            let (half_edges, length) = shortened(surface, path, longest);
            let tip = surface.ids()[surface.target(*half_edges.last()?) as usize];
            Some(Slit { tip, half_edges, length })
        };
        Ok(self.tips.iter().enumerate().filter_map(|(n, tip)| Some((n, slit(tip)?))).collect())
    }

    fn accept(&mut self, trial: Trial, control: &Control) -> Result<()> {
        self.preview = trial.preview;
        self.preview.settle(control)
    }
}

/// Returns the longest beginning of a path that is at most `longest` mm long, and its length.
fn shortened(surface: &Surface, mut path: Vec<u32>, longest: f64) -> (Vec<u32>, f64) {
    let (mut length, mut count) = (0.0, 0);
    while count < path.len() && length + surface.length(path[count]) <= longest {
        length += surface.length(path[count]);
        count += 1;
    }
    path.truncate(count);
    (path, length)
}

#[cfg(test)]
mod tests;
