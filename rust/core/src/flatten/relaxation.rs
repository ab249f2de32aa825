//! Relaxation cuts: the few short cuts that relieve the map of a curved disk most (docs/decisions/0016).
//!
//! A disk with curvature cannot be flat; a cut from its boundary inwards lets it spread. Which cut is best is tried on a
//! `Sketch`, the map of a coarse surface. Cuts may lead into places spread evenly over the surface, each along the shortest
//! way from the boundary. The one that lowers the map's energy most for its length is made, on the surface itself, too; then
//! the next, from the boundary as it is now, so that cuts grow branches or get longer. It ends when the length is used up
//! or no cut gains enough.

mod sketch;

use rayon::prelude::*;

use super::check::check_disk;
use crate::control::Control;
use crate::error::{Error, Result};
use crate::surface::Surface;
use crate::surface::cuts::inward::{Inward, from_lips, spread};
use crate::surface::cuts::{Cut, Reason, described};
use crate::surface::decimate::{Options, decimate};
use sketch::{LANDMARKS, Sketch};

/// Vertices of the coarse surface on which cuts are tried.
const COARSE: usize = 1000;

/// Places into which cuts may lead.
const TIPS: usize = 40;

/// Most cuts.
const MOST_CUTS: usize = 32;

/// A cut is worth its gain by this power of its length: of equal gains for their length the longer cut is taken, since many
/// short cuts leave more pieces between them.
const POWER: f64 = 0.7;

/// Cuts that are tried at a time, whatever the number of threads: which are tried at all depends on it.
const AT_A_TIME: usize = 4;

/// How much is cut.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Relaxation {
    /// The cuts together are no longer than this, mm.
    pub length: f64,
    /// For each length of √area that is cut, the energy falls by so much at least.
    pub least_gain: f64,
    /// All cuts together take at least this share off the error of the coarse map's distances; else none is made. 0 asks nothing
    /// of the error, which is not what the energy is.
    pub least_relief: f64,
    /// None is made, either, where without any that error is no more than this.
    pub bearable: f64,
    /// Cuts stay within this distance, mm along edges, of the cuts that the surface has: of vertices that share an id.
    pub within: f64,
}

impl Default for Relaxation {
    /// As long as it pays: about 350 mm of a hemisphere without its medial wall.
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
    /// The disk: the faces of the input, whose vertices on cuts are doubled and keep their ids.
    pub surface: Surface,
    /// The cuts in the order in which they were made, each from the boundary, or from another cut, inwards.
    pub cuts: Vec<Cut>,
    /// The energy of the coarse map at first and after each cut; empty where nothing was to be tried.
    pub energies: Vec<f64>,
    /// The mean relative error of the coarse map's distances, at its best scale, without cuts and with all of them; the same
    /// twice where none is made, NaN where nothing was to be tried.
    pub errors: [f64; 2],
}

/// Cuts a disk open where that relieves its map most. The result is the same each time, for any number of threads.
pub fn relax(surface: &Surface, relaxation: Relaxation, control: &Control) -> Result<Relaxed> {
    relaxation.validate()?;
    check_disk(surface)?;
    if relaxation.length == 0.0 {
        return Ok(Relaxed { surface: surface.clone(), cuts: Vec::new(), energies: Vec::new(), errors: [f64::NAN; 2] });
    }
    let near: Option<Vec<bool>> = match relaxation.within {
        f64::INFINITY => None,
        within => Some(from_lips(surface, control)?.into_iter().map(|distance| distance <= within).collect()),
    };
    let mut open = surface.clone().into_input(false); // a vertex' id is now its number
    let coarse = decimate(&open, &[], &Options { vertices: COARSE, ..Options::default() }, control)?.surface;
    control.begin("cutting", MOST_CUTS as u64);
    if coarse.len() <= LANDMARKS {
        return Ok(Relaxed { surface: surface.clone(), cuts: Vec::new(), energies: Vec::new(), errors: [f64::NAN; 2] });
    }
    let unit = surface.areas().iter().sum::<f64>().sqrt();
    let mut trials = Trials::new(coarse, relaxation.least_gain / unit, near, control)?;
    let (mut cuts, mut energies) = (Vec::new(), vec![trials.sketch.energy]);
    let error = trials.sketch.error(control)?;
    let mut left = relaxation.length;
    while cuts.len() < MOST_CUTS
        && error > relaxation.bearable
        && let Some(trial) = trials.best(left, control)?
    {
        let path = Inward::of(&open, control)?.to(trial.slit.tip);
        let mut path = path.unwrap_or_default();
        path.truncate(path.iter().take_while(|&&h| trials.allows(&open, h)).count());
        let (path, length) = shortened(surface, path, left); // it may be longer than the coarse one
        if path.is_empty() {
            break;
        }
        left -= length;
        open = open.cut_open(path.iter().copied());
        cuts.push(described(surface, &path, Reason::Relaxation));
        trials.accept(trial, control)?;
        energies.push(trials.sketch.energy);
        control.advance();
    }
    let relieved = if cuts.is_empty() { error } else { trials.sketch.error(control)? };
    if relaxation.least_relief > 0.0 && relieved > (1.0 - relaxation.least_relief) * error {
        energies.truncate(1);
        return Ok(Relaxed { surface: surface.clone(), cuts: Vec::new(), energies, errors: [error; 2] });
    }
    let is_cut = |&h: &u32| surface.twins()[h as usize] != open.twins()[h as usize];
    let seam: Vec<u32> = (0..surface.twins().len() as u32).filter(is_cut).collect();
    Ok(Relaxed { surface: surface.cut_open(seam), cuts, energies, errors: [error, relieved] })
}

/// A place into which a cut may lead.
#[derive(Debug, Clone, Copy)]
struct Tip {
    id: u32,
    /// By how much a cut to it lowered the energy when it was last tried; at first it may be anything.
    gain: f64,
}

#[derive(Debug)]
struct Slit {
    /// The id of the vertex where it ends.
    tip: u32,
    half_edges: Vec<u32>,
    /// mm.
    length: f64,
}

/// A cut and what the coarse map becomes by it.
struct Trial {
    slit: Slit,
    sketch: Sketch,
}

struct Trials {
    sketch: Sketch,
    tips: Vec<Tip>,
    /// By how much a cut has to lower the energy, for each mm.
    least_rate: f64,
    /// Where cuts may lie, by the ids of vertices; anywhere if there is none.
    near: Option<Vec<bool>>,
}

impl Trials {
    fn new(coarse: Surface, least_rate: f64, near: Option<Vec<bool>>, control: &Control) -> Result<Self> {
        let mut trials = Self { sketch: Sketch::new(coarse, control)?, tips: Vec::new(), least_rate, near };
        let surface = &trials.sketch.surface;
        let tips = spread(surface, TIPS, |v| trials.is_near(surface.ids()[v as usize]), control)?;
        trials.tips = tips.into_iter().map(|v| Tip { id: surface.ids()[v as usize], gain: f64::INFINITY }).collect();
        Ok(trials)
    }

    fn is_near(&self, id: u32) -> bool {
        self.near.as_ref().is_none_or(|near| near[id as usize])
    }

    /// May a cut run along a half-edge of a surface with these ids?
    fn allows(&self, surface: &Surface, half_edge: u32) -> bool {
        [surface.origin(half_edge), surface.target(half_edge)].iter().all(|&v| self.is_near(surface.ids()[v as usize]))
    }

    /// The cut, no longer than `longest` mm, that is worth most; none if none gains enough.
    ///
    /// A cut gains less once another is made near it, hardly ever more. So those that were worth most when they were tried
    /// last are tried first, and none that was worth less than another is now (Minoux 1978). None gains more than all the energy
    /// that there is, so that on a surface that is nearly flat few are tried.
    fn best(&mut self, longest: f64, control: &Control) -> Result<Option<Trial>> {
        let mut untried = self.slits(longest, control)?;
        let mut best: Option<(f64, Trial)> = None;
        loop {
            let most = |n: usize| self.tips[n].gain.min(self.sketch.energy);
            let worth = |(n, slit): &(usize, Slit)| self.worth(most(*n), slit.length);
            untried.sort_by(|a, b| worth(b).total_cmp(&worth(a)).then(a.1.tip.cmp(&b.1.tip)));
            let bar = best.as_ref().map_or(0.0, |best| best.0);
            let count = untried.iter().take(AT_A_TIME).take_while(|slit| worth(slit) > bar).count();
            if count == 0 {
                return Ok(best.map(|(_, trial)| trial));
            }
            let batch: Vec<(usize, Slit)> = untried.drain(..count).collect();
            let tried = |(_, slit): &(usize, Slit)| self.sketch.with(&slit.half_edges, control);
            let tried: Vec<Sketch> = batch.par_iter().map(tried).collect::<Result<_>>()?;
            for ((n, slit), sketch) in batch.into_iter().zip(tried) {
                self.tips[n].gain = self.sketch.energy - sketch.energy;
                let worth = self.worth(self.tips[n].gain, slit.length);
                if worth > best.as_ref().map_or(0.0, |best| best.0) {
                    best = Some((worth, Trial { slit, sketch }));
                }
            }
        }
    }

    /// What a cut is worth by what it gains; nothing if that is too little for its length.
    fn worth(&self, gain: f64, length: f64) -> f64 {
        if gain > self.least_rate * length { gain / length.powf(POWER) } else { 0.0 }
    }

    /// The shortest way from the boundary to each tip; of those that are too long the beginning.
    fn slits(&self, longest: f64, control: &Control) -> Result<Vec<(usize, Slit)>> {
        let surface = &self.sketch.surface;
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
        self.sketch = trial.sketch;
        self.sketch.settle(control)
    }
}

/// As much of a path as is no longer than `longest` mm, and how long that is.
fn shortened(surface: &Surface, mut path: Vec<u32>, longest: f64) -> (Vec<u32>, f64) {
    let mut length = 0.0;
    let count = path
        .iter()
        .take_while(|&&h| {
            length + surface.length(h) <= longest && {
                length += surface.length(h);
                true
            }
        })
        .count();
    path.truncate(count);
    (path, length)
}

#[cfg(test)]
mod tests;
