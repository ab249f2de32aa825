//! From coarse to fine: a map of few vertices, then all others in between, and descent on every level.
//!
//! The coarsest map is spread by springs (`tutte`), which fold nothing. Descent keeps it so, and so does re-insertion from
//! one level to the next: no map on the way has a fold.

use crate::embed::Place;
use std::iter;

use super::MapEnergy;
use super::descent::{Descended, Until, descend};
use super::local::ease;
use super::outline::Outline;
use super::pairs::{Bands, Pairs};
use super::springs::Springs;
use super::triangles::{Shape, TriangleEnergy};
use super::tutte;
use crate::control::Control;
use crate::error::{Error, Result};
use crate::geodesic::Solver;
use crate::place::reinsertion::{self, Placing};
use crate::rows::{DistanceRows, Rows};
use crate::surface::Surface;
use crate::surface::decimate::{self, Decimation, decimate};

/// How many times as many vertices a level has as the next coarser one.
const FALL: f64 = 3.0;

/// Vertices of the coarsest level.
const COARSEST: usize = 1600;

/// Vertices of a level for each landmark, at least.
const FOR_A_LANDMARK: usize = 3;

/// Distances are kept to at most so many vertices.
pub const MOST_EVALUATED: usize = 15_000;

/// What descent keeps of a vertex, bytes: twenty past steps and changes of the gradient, 320; two triangles, 160; most of the
/// rest is the factored matrix of springs; and all of that half again for the coarser surfaces.
const VERTEX_BYTES: u64 = 1110;

/// The memory in bytes that [`flatten`] needs at most, its levels and rows among it: of distances of four bytes to the
/// vertices that are judged there are three copies, the rows, the pairs, and those of the level at hand.
pub fn memory_need(points: usize, sources: usize) -> u64 {
    let sizes = || iter::successors(Some(points), |&size| coarser(size, sources));
    let evaluated = sizes().find(|&size| size <= MOST_EVALUATED).or_else(|| sizes().last()).unwrap_or(points);
    VERTEX_BYTES * points as u64 + 3 * 4 * (evaluated * sources) as u64
}

/// How many vertices the level has that is next coarser than one, if there is one.
fn coarser(vertices: usize, landmarks: usize) -> Option<usize> {
    let size = (vertices as f64 / FALL) as usize;
    (size >= COARSEST.max(FOR_A_LANDMARK * landmarks)).then_some(size)
}

/// Steps between two looks at what the springs and the scale should be.
const ROUND: usize = 40;

/// Most rounds of the first descent, which has the farthest way, and of the others.
const FIRST_ROUNDS: usize = 40;
pub(super) const MOST_ROUNDS: usize = 10;

/// Five steps that gain less than this part of the energy are the end, and so is a round.
const GAIN: f64 = 1e-4;
const ROUND_GAIN: f64 = 2e-3;

/// An energy that is no map's: those of descents that ended well are below 1, and below 10 where near distances count most. Triangles
/// without area hold descent back, and there it ends.
pub(super) const HOPELESS: f64 = 1000.0;

/// Triangles with less than this part of their area would hold descent back.
const TINY: f64 = 0.1;

/// The first descent: far distances as they are, from some of the landmarks, and triangles with a barrier.
const FIRST: Dials = Dials {
    bands: Bands { weights: [1.0, 0.0, 0.0], outliers: [f64::INFINITY; 2] },
    shape: Shape { barrier: 1.0, area: 0.0, outlier: f64::INFINITY },
    stiffness: 0.1,
    patience: 1,
};
const FIRST_LANDMARKS: usize = 96;

/// What makes the map (docs/decisions/0013).
pub(crate) const FINAL: Dials = Dials {
    bands: Bands { weights: [1.0, 4.0, 0.5], outliers: [1.0, 0.02] },
    shape: Shape { barrier: 0.02, area: 3.0, outlier: 0.2 },
    stiffness: 0.25,
    patience: 1,
};

/// How much more near distances and shapes count in a map that is all for them, and how much less in one that is not at all.
const WIDEST: f64 = 10.0;

/// [`FINAL`] for a weighting between 0, local, and 1, global.
pub(super) fn weighted(weighting: f64) -> Dials {
    let near = WIDEST.powf(1.0 - 2.0 * weighting);
    let [all, thirty, ten] = FINAL.bands.weights;
    let bands = Bands { weights: [all, near * thirty, near * ten], ..FINAL.bands };
    Dials { bands, stiffness: near * FINAL.stiffness, ..FINAL }
}

/// What counts how much, and how long descent goes on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Dials {
    pub bands: Bands,
    pub shape: Shape,
    /// β, the weight of the triangles beside the distances.
    pub stiffness: f64,
    /// How many times as many steps there may be, and how many times as little five of them may gain.
    pub patience: u32,
}

/// How descent on the finest level went.
#[derive(Debug, Clone, PartialEq)]
pub struct Convergence {
    /// The energy at first and after every step, of one round after the other; between rounds the scale is found anew.
    pub energies: Vec<f64>,
    /// It ended because little was gained any more.
    pub converged: bool,
}

/// A map (mm) of a disk that keeps the distances of rows among the vertices that are judged, and the shape of triangles, and folds
/// nowhere. Where the rows' sources lie by classical scaling says how to begin. `weighting` leads from 0, where near distances and the triangles' shape count most,
/// to 1, where far distances do; 0.5 is usual. Coarser surfaces are dropped when they have served.
/// Errors: [`Error::Folded`] if triangles are too thin for their areas to be told from nothing, [`Error::Uneven`] if edges are so uneven in
/// length that descent comes to no map, [`Error::TooManySprings`], [`Error::Cancelled`].
/// Panics if the rows are others than those of [`Levels::measure`] and [`Levels::take`].
pub fn flatten(
    levels: &mut Levels,
    rows: &DistanceRows,
    places: &[[f64; 2]],
    weighting: f64,
    control: &Control,
) -> Result<(Vec<[f64; 2]>, Convergence)> {
    let (uv, convergence) = unfold(levels, rows, places, weighted(weighting), control)?;
    let is_map = convergence.energies.last().is_some_and(|&energy| energy < HOPELESS);
    if is_map { Ok((uv, convergence)) } else { Err(Error::Uneven) }
}

/// The same by any dials, whatever the energy in the end.
pub(crate) fn unfold(
    levels: &mut Levels,
    rows: &DistanceRows,
    places: &[[f64; 2]],
    dials: Dials,
    control: &Control,
) -> Result<(Vec<[f64; 2]>, Convergence)> {
    let pairs = Pairs::new(rows, levels.evaluated(), control)?;
    let depth = levels.coarser.len();
    let level = levels.prepare(depth, &pairs, control)?;
    control.begin("unfolding", 1);
    let coarsest = levels.surface(depth);
    let places = level.pairs.landmark_places(places, coarsest.len());
    let mut uv = tutte::spread(coarsest, &places, &level.triangles, &level.springs, control)?;
    level.check_unfolded(&uv)?;
    let settle = || level.settle_first(&mut uv, dials, stage(depth), control);
    let (convergence, finer) = levels.beside(depth, settle, &pairs, control)?;
    drop(level);
    levels.refined(uv, convergence, finer, &pairs, dials, control)
}

/// What the user is told, on the finest level and on coarser ones.
pub(super) fn stage(depth: usize) -> &'static str {
    if depth == 0 { "keeping distances and shapes" } else { "keeping distances and shapes, coarsely" }
}

/// How far vertices of the boundary may come out of a coarser map, if the boundary crosses itself by the one before.
const OVERHANGS: [f64; 5] = [f64::INFINITY, 0.1, 1e-2, 1e-3, 1e-4];

/// What the gaps of the outline count beside the stress, where it is kept from running into itself.
pub(super) const APART: f64 = 1e-3;

/// Coarser and coarser surfaces, all of them with the landmarks.
#[derive(Debug)]
pub struct Levels<'a> {
    finest: &'a Surface,
    landmarks: Vec<u32>,
    pub(super) coarser: Vec<Decimation>,
    /// The vertices of every level, as those of the finest.
    pub(super) vertices: Vec<Vec<u32>>,
}

pub(super) struct Level {
    pub(super) pairs: Pairs,
    pub(super) triangles: TriangleEnergy,
    springs: Springs,
    pub(super) outline: Outline,
}

impl<'a> Levels<'a> {
    /// The levels of a disk.
    pub fn new(finest: &'a Surface, landmarks: &[u32], control: &Control) -> Result<Self> {
        let vertices = vec![(0..finest.len() as u32).collect()];
        let mut levels = Self { finest, landmarks: landmarks.to_vec(), coarser: Vec::new(), vertices };
        let mut keep = landmarks.to_vec();
        loop {
            let finer = levels.surface(levels.coarser.len());
            let Some(size) = coarser(finer.len(), landmarks.len()) else { return Ok(levels) };
            let level = decimate(finer, &keep, &decimate::Options { vertices: size, ..Default::default() }, control)?;
            if level.survivors.len() as f64 > 0.8 * finer.len() as f64 {
                return Ok(levels);
            }
            let number = |vertex: u32| level.survivors.partition_point(|&other| other < vertex) as u32;
            keep.iter_mut().for_each(|vertex| *vertex = number(*vertex));
            let known = &levels.vertices[levels.coarser.len()];
            let vertices = level.survivors.iter().map(|&vertex| known[vertex as usize]).collect();
            levels.vertices.push(vertices);
            levels.coarser.push(level);
        }
    }

    fn surface(&self, depth: usize) -> &Surface {
        if depth == 0 { self.finest } else { &self.coarser[depth - 1].surface }
    }

    /// The vertices that every level has.
    pub fn landmarks(&self) -> &[u32] {
        &self.landmarks
    }

    /// The surface itself.
    pub fn finest(&self) -> &'a Surface {
        self.finest
    }

    /// The vertices to which distances are kept, in ascending order: those of the finest level that has few enough, all landmarks
    /// among them.
    pub fn evaluated(&self) -> &[u32] {
        let small = self.vertices.iter().find(|vertices| vertices.len() <= MOST_EVALUATED);
        small.unwrap_or(&self.vertices[self.vertices.len() - 1])
    }

    /// The distances from the landmarks to the vertices that are judged, all of them numbered as these.
    pub fn measure<S: Solver>(&self, solver: &S, control: &Control) -> Result<DistanceRows> {
        Ok(self.numbered(DistanceRows::compute_to(solver, &self.landmarks, self.evaluated(), control)?))
    }

    /// The same of whole rows that were measured before.
    /// Panics if the rows are from others than the landmarks, or do not reach to every vertex.
    pub fn take(&self, rows: &impl Rows, control: &Control) -> Result<DistanceRows> {
        assert_eq!(rows.sources(), self.landmarks, "rows from the landmarks");
        Ok(self.numbered(rows.to(self.evaluated(), control)?))
    }

    fn numbered(&self, rows: DistanceRows) -> DistanceRows {
        let evaluated = self.evaluated();
        let number = |vertex: &u32| evaluated.partition_point(|other| other < vertex) as u32;
        DistanceRows::new(self.landmarks.iter().map(number).collect(), evaluated.len(), rows.into_data())
    }

    pub(super) fn prepare(&self, depth: usize, pairs: &Pairs, control: &Control) -> Result<Level> {
        let surface = self.surface(depth);
        let triangles = TriangleEnergy::new(surface);
        let springs = Springs::new(triangles.corners().collect(), surface.len(), control)?;
        Ok(Level { pairs: pairs.among(&self.vertices[depth]), triangles, springs, outline: Outline::new(surface) })
    }

    /// Descent on a level, and beside it what the next finer one needs, of which much is the work of one thread.
    pub(super) fn beside(
        &self,
        depth: usize,
        settle: impl FnOnce() -> Result<Convergence> + Send,
        pairs: &Pairs,
        control: &Control,
    ) -> Result<(Convergence, Option<Level>)> {
        let prepare = || depth.checked_sub(1).map(|finer| self.prepare(finer, pairs, control)).transpose();
        let (settled, finer) = rayon::join(settle, prepare);
        Ok((settled?, finer?))
    }

    /// The map of the finest level from that of the coarsest that is left, and how descent went there. Levels are dropped when they
    /// have served.
    pub(super) fn refined(
        &mut self,
        mut uv: Vec<Place>,
        mut convergence: Convergence,
        mut finer: Option<Level>,
        pairs: &Pairs,
        dials: Dials,
        control: &Control,
    ) -> Result<(Vec<[f64; 2]>, Convergence)> {
        while let Some(level) = finer {
            let depth = self.coarser.len() - 1;
            uv = self.refine(depth, &uv, &level.outline, control)?;
            self.coarser.truncate(depth);
            level.check_unfolded(&uv)?;
            let settle = || level.settle(&mut uv, dials, stage(depth), control);
            (convergence, finer) = self.beside(depth, settle, pairs, control)?;
        }
        Ok((uv.into_iter().map(Into::into).collect(), convergence))
    }

    /// The map of a level from that of the next coarser one; its outline crosses itself nowhere if that one's does not, unless
    /// parts of the map lie nearer to each other than vertices can be placed.
    fn refine(&self, depth: usize, uv: &[Place], outline: &Outline, control: &Control) -> Result<Vec<Place>> {
        let Decimation { survivors, removals, .. } = &self.coarser[depth];
        let mut finer = vec![[0.0; 2]; self.surface(depth).len()];
        survivors.iter().zip(uv).for_each(|(&vertex, &place)| finer[vertex as usize] = place.into());
        for overhang in OVERHANGS {
            reinsertion::place(removals, &mut finer, &Placing { overhang, ..Default::default() }, control)?;
            let places: Vec<Place> = finer.iter().map(|&place| place.into()).collect();
            if overhang == OVERHANGS[OVERHANGS.len() - 1] || outline.crossings(&places, control)? == 0 {
                return Ok(places);
            }
        }
        unreachable!("the last overhang is the end")
    }
}

impl Level {
    pub(super) fn check_unfolded(&self, uv: &[Place]) -> Result<()> {
        let triangles = self.triangles.folded(uv);
        if triangles > 0 { Err(Error::Folded { triangles }) } else { Ok(()) }
    }

    /// Descent to the map of least energy from the first map, where all still moves far: parts may pass through each other, and only if
    /// the outline runs into itself in the end, this descent is made again with the outline kept apart.
    fn settle_first(
        &self,
        uv: &mut Vec<Place>,
        dials: Dials,
        stage: &'static str,
        control: &Control,
    ) -> Result<Convergence> {
        let start = uv.clone();
        let free = self.descend(uv, &vec![true; start.len()], dials, None, stage, control)?;
        if self.outline.crossings(uv, control)? == 0 {
            return Ok(free);
        }
        *uv = start;
        self.descend(uv, &self.outline.inside(uv.len()), dials, Some((&self.outline, APART)), stage, control)
    }

    /// The same from a coarser map, its outline kept from running into itself.
    fn settle(&self, uv: &mut Vec<Place>, dials: Dials, stage: &'static str, control: &Control) -> Result<Convergence> {
        self.ease_tiny(uv, dials.shape, control)?;
        ease(&self.triangles, dials.shape, &self.outline.inside(uv.len()), uv, control)?;
        let is_apart = self.outline.crossings(uv, control)? == 0;
        let apart = Some((&self.outline, APART)).filter(|_| is_apart);
        self.rounds(&self.pairs, uv, dials, MOST_ROUNDS, apart, stage, control)
    }

    /// Eases the triangles that have hardly any area left as if none were an outlier, which would be let lie. Vertices of the boundary
    /// stay.
    pub(super) fn ease_tiny(&self, uv: &mut [Place], shape: Shape, control: &Control) -> Result<()> {
        let mut may_move = vec![false; uv.len()];
        for (corners, growth) in self.triangles.corners().zip(self.triangles.growths(uv)) {
            if growth < TINY {
                corners.iter().for_each(|&vertex| may_move[vertex as usize] = true);
            }
        }
        self.outline.vertices().for_each(|vertex| may_move[vertex as usize] = false);
        ease(&self.triangles, Shape { outlier: f64::INFINITY, ..shape }, &may_move, uv, control)
    }

    pub(super) fn energy<'a>(
        &'a self,
        pairs: &'a Pairs,
        dials: Dials,
        outline: Option<(&'a Outline, f64)>,
    ) -> MapEnergy<'a> {
        let Self { triangles, springs, .. } = self;
        let Dials { bands, shape, stiffness, .. } = dials;
        MapEnergy { pairs, bands, triangles, shape, stiffness, springs, outline }
    }

    /// From the first map, in which triangles may be tiny, by way of one that keeps far distances.
    fn descend(
        &self,
        uv: &mut Vec<Place>,
        may_move: &[bool],
        dials: Dials,
        outline: Option<(&Outline, f64)>,
        stage: &'static str,
        control: &Control,
    ) -> Result<Convergence> {
        ease(&self.triangles, FIRST.shape, may_move, uv, control)?;
        let few = self.pairs.of_first(FIRST_LANDMARKS);
        self.rounds(&few, uv, FIRST, FIRST_ROUNDS, outline, stage, control)?;
        self.rounds(&self.pairs, uv, dials, MOST_ROUNDS, outline, stage, control)
    }

    #[expect(clippy::too_many_arguments)]
    pub(super) fn rounds(
        &self,
        pairs: &Pairs,
        uv: &mut Vec<Place>,
        dials: Dials,
        rounds: usize,
        outline: Option<(&Outline, f64)>,
        stage: &'static str,
        control: &Control,
    ) -> Result<Convergence> {
        let (rounds, patience) = (rounds * dials.patience as usize, f64::from(dials.patience));
        control.begin(stage, (rounds * ROUND) as u64);
        let energy = self.energy(pairs, dials, outline);
        let mut curve: Vec<f64> = Vec::new();
        for _ in 0..rounds {
            let before = outline.map(|_| uv.clone());
            let until = Until { steps: ROUND, gain: GAIN / patience, enough: f64::NEG_INFINITY };
            let Descended { energies, converged } = descend(&energy, uv, until, control)?;
            if let Some(before) = before
                && self.outline.crossings(uv, control)? > 0
            {
                *uv = before; // a vertex slipped through an edge by rounding
                curve.push(energies[0]);
                return Ok(Convergence { energies: curve, converged: false });
            }
            let [first, last] = [energies[0], energies[energies.len() - 1]];
            curve.extend(energies);
            if converged || first - last < ROUND_GAIN / patience * first {
                return Ok(Convergence { energies: curve, converged: true });
            }
        }
        Ok(Convergence { energies: curve, converged: false })
    }
}
