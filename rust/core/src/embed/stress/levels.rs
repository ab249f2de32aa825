//! Multi-level optimisation: a map of few vertices is refined level by level, and optimised on every level.
//!
//! The coarsest map is spread by springs (`tutte`), which creates no folds. The optimisation preserves this, and so
//! does re-insertion from one level to the next: no intermediate map has a fold.

use crate::embed::Place;
use std::iter;

use super::descent::{Descended, Objective, Until, descend};
use super::group::Shapes;
use super::local::ease;
use super::outline::Outline;
use super::pairs::{Bands, Pairs};
use super::springs::Springs;
use super::triangles::{Shape, TriangleEnergy};
use super::{MapEnergy, tutte};
use crate::error::check_points;
use crate::geodesic::Solver;
use crate::geodesic::bend::{MarkedRows, Marking};
use crate::place::reinsertion::{self, Placing};
use crate::rows::{DistanceRows, Rows};
use crate::surface::Surface;
use crate::surface::decimate::{self, Decimation, decimate};
use crate::{Control, Error, Result};

/// The ratio of the numbers of vertices of successive levels.
const FALL: f64 = 3.0;

/// The number of vertices of the coarsest level.
const COARSEST: usize = 1600;

/// The minimum number of vertices of a level per landmark.
const FOR_A_LANDMARK: usize = 3;

/// The maximum number of vertices at which distances are compared.
pub(crate) const MOST_EVALUATED: usize = 15_000;

/// The memory per vertex of the optimisation in bytes: twenty past steps and gradient changes take 320, two triangles
/// 160, and the factored matrix of springs most of the rest; the coarser surfaces add half of the sum.
const VERTEX_BYTES: u64 = 1110;

/// Returns the maximum memory in bytes of [`flatten`], including its levels and rows. Distances of four bytes to the
/// vertices where they are compared exist in three copies: the rows, the pairs, and those of the current level.
pub(crate) fn memory_need(points: usize, sources: usize) -> u64 {
    VERTEX_BYTES * points as u64 + 3 * 4 * (most_evaluated(points, sources) * sources) as u64
}

/// Returns the maximum number of vertices at which distances are compared.
pub(super) fn most_evaluated(points: usize, sources: usize) -> usize {
    let sizes = || iter::successors(Some(points), |&size| coarser(size, sources));
    sizes().find(|&size| size <= MOST_EVALUATED).or_else(|| sizes().last()).unwrap_or(points)
}

/// Returns the number of vertices of the next coarser level, if there is one.
fn coarser(vertices: usize, landmarks: usize) -> Option<usize> {
    let size = (vertices as f64 / FALL) as usize;
    (size >= COARSEST.max(FOR_A_LANDMARK * landmarks)).then_some(size)
}

/// The number of steps between two updates of the springs and the scale.
const ROUND: usize = 40;

/// The maximum number of rounds of the first optimisation, which has the longest way, and of the others.
pub(super) const FIRST_ROUNDS: usize = 40;
pub(super) const MOST_ROUNDS: usize = 10;

/// The optimisation ends when five steps, or a round, decrease the energy by less than this share.
const GAIN: f64 = 1e-4;
const ROUND_GAIN: f64 = 2e-3;

/// An energy that no usable map has: it is below 1 after good optimisations, and below 10 where near distances count
/// most. Triangles without area block the optimisation, and it ends there.
pub(super) const HOPELESS: f64 = 1000.0;

/// Triangles with less than this share of their area would block the optimisation.
const TINY: f64 = 0.1;

/// The first optimisation: far distances without outliers, from some of the landmarks, and triangles with a barrier.
pub(super) const FIRST: Dials = Dials {
    bands: Bands { weights: [1.0, 0.0, 0.0], outliers: [f64::INFINITY; 2] },
    shape: Shape { barrier: 1.0, area: 0.0, outlier: f64::INFINITY },
    stiffness: 0.1,
    patience: 1,
};
pub(super) const FIRST_LANDMARKS: usize = 96;

/// The weights of the final map (docs/decisions/0013).
pub(crate) const FINAL: Dials = Dials {
    bands: Bands { weights: [1.0, 4.0, 0.5], outliers: [1.0, 0.02] },
    shape: Shape { barrier: 0.02, area: 3.0, outlier: 0.2 },
    stiffness: 0.25,
    patience: 1,
};

/// The factor on near distances and shapes at the local end of the weighting, and its inverse at the global end.
const WIDEST: f64 = 10.0;

/// Returns [`FINAL`] for a weighting between 0, local, and 1, global.
pub(super) fn weighted(weighting: f64) -> Dials {
    let near = WIDEST.powf(1.0 - 2.0 * weighting);
    let [all, thirty, ten] = FINAL.bands.weights;
    let bands = Bands { weights: [all, near * thirty, near * ten], ..FINAL.bands };
    Dials { bands, stiffness: near * FINAL.stiffness, ..FINAL }
}

/// The weights of the terms, and the length of the optimisation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Dials {
    pub bands: Bands,
    pub shape: Shape,
    /// β, the weight of the triangles relative to the distances.
    pub stiffness: f64,
    /// The factor on the maximum number of steps, and the divisor of the smallest decrease over five steps.
    pub patience: u32,
}

/// The convergence of the optimisation on the finest level.
#[derive(Debug, Clone, PartialEq)]
pub struct Convergence {
    /// The initial energy and the energy after every step of all rounds; the scale is updated between rounds.
    pub energies: Vec<f64>,
    /// Whether it ended because the energy hardly decreased.
    pub converged: bool,
}

/// Returns a map (mm) of a disk without folds that preserves the distances of rows among the compared vertices, and the
/// shapes of triangles. It starts from the positions of the rows' sources by classical scaling. A `weighting` of 0
/// favours near distances and shapes, 1 favours far distances; 0.5 is usual. Coarser surfaces are dropped after use.
/// Errors: [`Error::Folded`] if triangles are too thin for their areas to differ from zero, [`Error::Uneven`] if edge
/// lengths vary so much that the optimisation yields no map, [`Error::TooManySprings`], [`Error::Cancelled`].
/// Panics if the rows are not those of [`Levels::measure`] or [`Levels::take`].
pub(crate) fn flatten(
    levels: &mut Levels, rows: &DistanceRows, places: &[[f64; 2]], weighting: f64, control: &Control,
) -> Result<(Vec<[f64; 2]>, Convergence)> {
    let (uv, convergence) = unfold(levels, rows, places, weighted(weighting), control)?;
    let is_map = convergence.energies.last().is_some_and(|&energy| energy < HOPELESS);
    if is_map { Ok((uv, convergence)) } else { Err(Error::Uneven) }
}

/// Returns a map like [`flatten`], but with given weights and with any final energy.
pub(crate) fn unfold(
    levels: &mut Levels, rows: &DistanceRows, places: &[[f64; 2]], dials: Dials, control: &Control,
) -> Result<(Vec<[f64; 2]>, Convergence)> {
    let pairs = Pairs::new(rows, levels.evaluated(), levels.area(), control)?;
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

/// Returns the name of the stage in progress reports, on the finest level and on coarser ones.
pub(super) fn stage(depth: usize) -> &'static str {
    if depth == 0 { "optimising distances and shapes" } else { "optimising distances and shapes on a coarse level" }
}

/// The overhang of boundary vertices over a coarser map; the next one is used if the boundary crosses itself.
const OVERHANGS: [f64; 5] = [f64::INFINITY, 0.1, 1e-2, 1e-3, 1e-4];

/// The weight of the outline's gaps relative to the stress, where it is kept apart.
pub(super) const APART: f64 = 1e-3;

/// Coarser and coarser surfaces, all of which contain the landmarks.
#[derive(Debug)]
pub struct Levels<'a> {
    finest: &'a Surface,
    landmarks: Vec<u32>,
    pub(super) coarser: Vec<Decimation>,
    /// The vertices of every level, as numbers of the finest level.
    pub(super) vertices: Vec<Vec<u32>>,
    /// The shapes of a group, if the triangles do not have those of the surface.
    pub(super) shapes: Option<Shapes>,
}

pub(super) struct Level {
    pub(super) pairs: Pairs,
    pub(super) triangles: TriangleEnergy,
    springs: Springs,
    pub(super) outline: Outline,
}

impl<'a> Levels<'a> {
    /// Creates the levels of a disk.
    ///
    /// # Errors
    /// [`Error::NoSuchPoint`] for a landmark, and [`Error::Cancelled`].
    pub fn new(finest: &'a Surface, landmarks: &[u32], control: &Control) -> Result<Self> {
        check_points(landmarks.iter().copied(), finest.len())?;
        let vertices = vec![(0..finest.len() as u32).collect()];
        let mut levels = Self { finest, landmarks: landmarks.to_vec(), coarser: Vec::new(), vertices, shapes: None };
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

    pub(super) fn surface(&self, depth: usize) -> &Surface {
        if depth == 0 { self.finest } else { &self.coarser[depth - 1].surface }
    }

    /// Returns the vertices that every level has.
    pub(crate) fn landmarks(&self) -> &[u32] {
        &self.landmarks
    }

    /// Returns the surface itself.
    pub(crate) fn finest(&self) -> &'a Surface {
        self.finest
    }

    /// Returns the area of the shapes to preserve.
    pub(super) fn area(&self) -> f64 {
        self.shapes.as_ref().map_or_else(|| self.finest.area(), |shapes| shapes.area)
    }

    /// Returns the energy of a level's triangles.
    pub(super) fn triangles(&self, depth: usize) -> TriangleEnergy {
        let surface = self.surface(depth);
        match &self.shapes {
            None => TriangleEnergy::new(surface),
            Some(shapes) => TriangleEnergy::of(surface.faces(), surface.len(), |number| shapes.corners(depth, number)),
        }
    }

    /// Returns the vertices at which distances are compared, in ascending order: those of the finest small level. They
    /// include all landmarks.
    pub(crate) fn evaluated(&self) -> &[u32] {
        let small = self.vertices.iter().find(|vertices| vertices.len() <= MOST_EVALUATED);
        small.unwrap_or(&self.vertices[self.vertices.len() - 1])
    }

    /// Returns the marked distances from the landmarks to the compared vertices, in the numbering of the latter, by any
    /// solver.
    ///
    /// # Errors
    /// [`Error::Unreachable`] if the surface is not connected, and the errors of the solver.
    pub fn measure<S: Solver>(&self, marking: &Marking<S>, control: &Control) -> Result<MarkedRows> {
        let rows = MarkedRows::compute_to(marking, &self.landmarks, self.evaluated(), control)?;
        Ok(rows.renamed(self.numbers()))
    }

    /// Returns the same columns of complete, known rows of the marking's solver.
    ///
    /// # Errors
    /// [`Error::ForeignRows`] if the rows are not from the landmarks to all vertices, and the errors of reading them.
    pub fn take<S: Solver>(&self, rows: &impl Rows, marking: &Marking<S>, control: &Control) -> Result<MarkedRows> {
        if rows.sources() != self.landmarks || rows.columns() != self.finest.len() {
            return Err(Error::ForeignRows);
        }
        let rows = MarkedRows::take(rows, marking, self.evaluated(), control)?;
        Ok(rows.renamed(self.numbers()))
    }

    /// Checks that rows are from the landmarks to the compared vertices, in the numbering of the latter.
    pub(crate) fn check_rows(&self, rows: &DistanceRows) -> Result<()> {
        let are_own = rows.columns() == self.evaluated().len() && rows.sources() == self.numbers();
        if are_own { Ok(()) } else { Err(Error::ForeignRows) }
    }

    /// Returns the numbers of the landmarks among the compared vertices.
    pub(super) fn numbers(&self) -> Vec<u32> {
        let evaluated = self.evaluated();
        self.landmarks.iter().map(|vertex| evaluated.partition_point(|other| other < vertex) as u32).collect()
    }

    pub(super) fn prepare(&self, depth: usize, pairs: &Pairs, control: &Control) -> Result<Level> {
        let surface = self.surface(depth);
        let triangles = self.triangles(depth);
        let springs = Springs::new(triangles.corners().collect(), surface.len(), control)?;
        Ok(Level { pairs: pairs.among(&self.vertices[depth]), triangles, springs, outline: Outline::new(surface) })
    }

    /// Optimises on a level, and prepares the next finer one in parallel, which is mostly the work of one thread.
    pub(super) fn beside(
        &self, depth: usize, settle: impl FnOnce() -> Result<Convergence> + Send, pairs: &Pairs, control: &Control,
    ) -> Result<(Convergence, Option<Level>)> {
        let prepare = || depth.checked_sub(1).map(|finer| self.prepare(finer, pairs, control)).transpose();
        let (settled, finer) = rayon::join(settle, prepare);
        Ok((settled?, finer?))
    }

    /// Returns the finest level's map from that of the coarsest remaining one, and its convergence. Drops used levels.
    pub(super) fn refined(
        &mut self, mut uv: Vec<Place>, mut convergence: Convergence, mut finer: Option<Level>, pairs: &Pairs,
        dials: Dials, control: &Control,
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

    /// Returns the map of a level from that of the next coarser one. Its outline does not cross itself if that one's
    /// does not, unless parts of the map are closer to each other than the precision of positions.
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

    /// Optimises the first map, in which distances change much. Parts may pass through each other. If the outline
    /// crosses itself in the end, the optimisation is repeated with the outline kept apart.
    fn settle_first(
        &self, uv: &mut Vec<Place>, dials: Dials, stage: &'static str, control: &Control,
    ) -> Result<Convergence> {
        let start = uv.clone();
        let free = self.descend(uv, &vec![true; start.len()], dials, None, stage, control)?;
        if self.outline.crossings(uv, control)? == 0 {
            return Ok(free);
        }
        *uv = start;
        self.descend(uv, &self.outline.inside(uv.len()), dials, Some((&self.outline, APART)), stage, control)
    }

    /// Optimises the refinement of a coarser map, while the outline is kept apart.
    fn settle(&self, uv: &mut Vec<Place>, dials: Dials, stage: &'static str, control: &Control) -> Result<Convergence> {
        self.ease_tiny(uv, dials.shape, control)?;
        ease(&self.triangles, dials.shape, &self.outline.inside(uv.len()), uv, control)?;
        let is_apart = self.outline.crossings(uv, control)? == 0;
        let apart = Some((&self.outline, APART)).filter(|_| is_apart);
        self.energy(&self.pairs, dials, apart).descend(uv, dials.patience, MOST_ROUNDS, stage, control)
    }

    /// Enlarges the triangles that have hardly any area. No triangle counts as an outlier, because outliers would not
    /// move. Vertices of the boundary stay.
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
        &'a self, pairs: &'a Pairs, dials: Dials, outline: Option<(&'a Outline, f64)>,
    ) -> MapEnergy<'a> {
        let Self { triangles, springs, .. } = self;
        let Dials { bands, shape, stiffness, .. } = dials;
        MapEnergy { pairs, bands, triangles, shape, stiffness, springs, outline }
    }

    /// Optimises the first map, in which triangles can be tiny, by way of a map that preserves far distances.
    fn descend(
        &self, uv: &mut Vec<Place>, may_move: &[bool], dials: Dials, outline: Option<(&Outline, f64)>,
        stage: &'static str, control: &Control,
    ) -> Result<Convergence> {
        ease(&self.triangles, FIRST.shape, may_move, uv, control)?;
        let few = self.pairs.of_first(FIRST_LANDMARKS);
        self.energy(&few, FIRST, outline).descend(uv, FIRST.patience, FIRST_ROUNDS, stage, control)?;
        self.energy(&self.pairs, dials, outline).descend(uv, dials.patience, MOST_ROUNDS, stage, control)
    }
}

impl MapEnergy<'_> {
    /// Minimises the energy in rounds, as long as the outline does not cross itself.
    pub(super) fn descend(
        &self, uv: &mut Vec<Place>, patience: u32, rounds: usize, stage: &'static str, control: &Control,
    ) -> Result<Convergence> {
        let crossings = |uv: &[Place]| self.outline.map_or(Ok(0), |(outline, _)| outline.crossings(uv, control));
        descend_in_rounds(self, crossings, uv, patience, rounds, stage, control)
    }
}

/// Minimises an energy in rounds, each with its own springs, as long as the outline does not cross itself.
pub(super) fn descend_in_rounds(
    energy: &impl Objective, crossings: impl Fn(&[Place]) -> Result<usize>, uv: &mut Vec<Place>, patience: u32,
    rounds: usize, stage: &'static str, control: &Control,
) -> Result<Convergence> {
    let (rounds, patience) = (rounds * patience as usize, f64::from(patience));
    control.begin(stage, (rounds * ROUND) as u64);
    let mut curve: Vec<f64> = Vec::new();
    for _ in 0..rounds {
        let before = uv.clone();
        let until = Until { steps: ROUND, gain: GAIN / patience, enough: f64::NEG_INFINITY };
        let Descended { energies, converged } = descend(energy, uv, until, control)?;
        if crossings(uv)? > 0 {
            *uv = before; // a vertex crossed an edge by rounding
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
