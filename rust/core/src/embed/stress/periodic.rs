//! Maps of tubes that repeat in the second direction: the two sides of a seam from end to end differ by one period.
//!
//! The unknowns are the positions of the vertices of the closed tube, and the period. The tube is also cut open along
//! the seam: each of its vertices has one copy there, or two copies one period apart. Triangles are compared on the
//! opened tube. Distances are measured around the closed one, and compared with the distance to the nearest copy in the
//! plane. The ends are free, but neither they nor their copies may cross each other.

use crate::embed::Place;
use std::collections::HashMap;

use nalgebra::Vector2;

use super::descent::{Objective, SAFE};
use super::levels::{
    APART, Convergence, Dials, FIRST, FIRST_LANDMARKS, FIRST_ROUNDS, HOPELESS, MOST_ROUNDS, descend_in_rounds, stage,
    weighted,
};
use super::local::ease;
use super::outline::Outline;
use super::pairs::Pairs;
use super::springs::{Factor, Springs};
use super::triangles::TriangleEnergy;
use super::tutte::softened;
use crate::adjacency::distinct;
use crate::rows::DistanceRows;
use crate::surface::Surface;
use crate::{Control, Error, Result};

/// The periods between the ends and their copies.
const BESIDE: [i32; 2] = [-1, 1];

/// A tube, closed and cut open along a seam.
#[derive(Debug)]
pub struct Tube<'a> {
    pub(crate) closed: &'a Surface,
    pub(crate) opened: &'a Surface,
    copies: Copies,
    /// The half-edges of the opened tube's boundary at the first and the second end, in its order.
    ends: [Vec<u32>; 2],
}

/// Copies of the vertices of a closed tube, each moved by a number of periods.
#[derive(Debug, Clone)]
struct Copies {
    of: Vec<u32>,
    turns: Vec<f64>,
}

impl Copies {
    /// Returns the positions of all copies. The last one of `places` is the period.
    fn positions(&self, places: &[Place]) -> Vec<Place> {
        let period = places[places.len() - 1].y;
        let place = |(&of, turns): (&u32, f64)| places[of as usize] + Vector2::new(0.0, turns * period);
        self.of.iter().zip(self.turns.iter().copied()).map(place).collect()
    }

    /// Adds up the gradient of all copies; the last entry is that of the period.
    fn gather(&self, gradient: &[Place], places: usize) -> Vec<Place> {
        let mut sums = vec![Vector2::zeros(); places];
        for ((&of, turns), by) in self.of.iter().zip(&self.turns).zip(gradient) {
            sums[of as usize] += by;
            // a copy lies at y + turns · period
            sums[places - 1].y += turns * by.y;
        }
        sums
    }
}

impl<'a> Tube<'a> {
    /// Creates a tube from the closed surface, and the same triangles cut open along a seam: a path of the closed
    /// surface's vertices from the first end to the second.
    ///
    /// # Errors
    /// [`Error::NotATube`] if the surface does not have two boundary loops, or the seam does not open it to a disk.
    pub fn new(closed: &'a Surface, opened: &'a Surface, seam: &[u32]) -> Result<Self> {
        let mut of = vec![0; opened.len()];
        let corners = opened.faces().as_flattened().iter().zip(closed.faces().as_flattened());
        corners.for_each(|(&copy, &vertex)| of[copy as usize] = vertex);
        let steps: HashMap<[u32; 2], f64> =
            seam.windows(2).flat_map(|two| [([two[0], two[1]], 0.0), ([two[1], two[0]], 1.0)]).collect();
        let boundary = opened.boundary();
        let is_tube = closed.boundary().len() == 2 && closed.faces().len() == opened.faces().len();
        if !is_tube || boundary.len() != 1 || seam.len() < 2 || opened.len() != closed.len() + seam.len() {
            return Err(Error::NotATube { loops: closed.boundary().len() });
        }
        // 0 along the lower side of the map, 1 back along the upper side, none at the ends
        let side = |edge: u32| {
            let step = [opened.origin(edge), opened.target(edge)].map(|copy| of[copy as usize]);
            steps.get(&step).copied().filter(|_| closed.is_inner(edge))
        };
        let mut outline = boundary[0].clone();
        let start = (1..outline.len()).find(|&n| side(outline[n]) == Some(0.0) && side(outline[n - 1]).is_none());
        outline.rotate_left(start.unwrap_or(0));
        let mut turns = vec![0.0; opened.len()];
        let mut ends = [Vec::new(), Vec::new()];
        let mut last = 0.0;
        for edge in outline {
            if let Some(turn) = side(edge) {
                [opened.origin(edge), opened.target(edge)].iter().for_each(|&copy| turns[copy as usize] = turn);
                last = turn;
            } else {
                ends[usize::from(last == 0.0)].push(edge);
            }
        }
        Ok(Self { closed, opened, copies: Copies { of, turns }, ends })
    }

    /// Returns the vertex of the closed tube for each vertex of the opened one.
    pub(crate) fn vertices(&self) -> &[u32] {
        &self.copies.of
    }

    /// Returns one vertex of the opened tube for each vertex of the closed one.
    pub(crate) fn first_copies(&self) -> Vec<u32> {
        let mut first = vec![0; self.closed.len()];
        self.copies.of.iter().enumerate().rev().for_each(|(copy, &of)| first[of as usize] = copy as u32);
        first
    }

    /// Returns the vertices of the closed tube at the first or the second end.
    fn end(&self, end: usize) -> Vec<u32> {
        self.ends[end].iter().map(|&edge| self.copies.of[self.opened.origin(edge) as usize]).collect()
    }

    /// Returns the vertices at which distances are compared: at most about `most`, with the landmarks and the ends.
    pub(crate) fn evaluated(&self, landmarks: &[u32], most: usize) -> Vec<u32> {
        let step = self.closed.len().div_ceil(most);
        let some = (0..self.closed.len() as u32).step_by(step).chain(landmarks.iter().copied());
        distinct(some.chain(self.end(0)).chain(self.end(1)))
    }

    /// Returns the distance between the ends: the mean over the landmarks of their distances to both ends.
    fn length(&self, rows: &DistanceRows, evaluated: &[u32]) -> f64 {
        let columns = [0, 1].map(|end| {
            let column = |vertex: &u32| evaluated.binary_search(vertex).ok();
            self.end(end).iter().filter_map(column).collect::<Vec<_>>()
        });
        let nearest = |row: &[f32], end: &[usize]| end.iter().map(|&n| f64::from(row[n])).fold(f64::INFINITY, f64::min);
        let both = |n: usize| columns.iter().map(|end| nearest(rows.row(n), end)).sum::<f64>();
        let count = rows.sources().len();
        (0..count).map(both).sum::<f64>() / count as f64
    }

    /// Returns positions and a period without folds: springs hold the tube between two straight collars, which are
    /// connected to the edges at its ends (Tutte 1963; Gortler, Gotsman, Thurston 2006).
    fn spread(
        &self, length: f64, triangles: &TriangleEnergy, springs: &Springs, control: &Control,
    ) -> Result<Vec<Place>> {
        let count = self.closed.len();
        // the circumference of a cylinder with this area and length
        let period = triangles.area / length;
        let mut ground = vec![0.0; count];
        let mut forces = vec![Vector2::zeros(); count];
        for (end, edges) in self.ends.iter().enumerate() {
            let round: f64 = edges.iter().map(|&edge| self.opened.length(edge)).sum();
            let beyond = round / edges.len() as f64; // the collar is one edge wide
            let u = if end == 0 { -beyond } else { length + beyond };
            let mut along = 0.0;
            for &edge in edges {
                let next = along + self.opened.length(edge);
                let [from, to] = [self.opened.origin(edge), self.opened.target(edge)].map(|copy| copy as usize);
                for (copy, at) in [(from, along), (from, next), (to, next)] {
                    let share = if end == 0 { 1.0 - at / round } else { at / round }; // the first end runs downwards
                    let vertex = self.copies.of[copy] as usize;
                    ground[vertex] += 1.0;
                    forces[vertex] += Vector2::new(u, (share - self.copies.turns[copy]) * period);
                }
                along = next;
            }
        }
        let turns = self.turns(triangles);
        let balanced = |entries: &[[f64; 3]]| {
            let (pulls, _) = springs.of_period(entries, &turns);
            let own = |(force, pull): (&Place, f64)| force - Vector2::new(0.0, pull * period);
            let forces: Vec<Place> = forces.iter().zip(pulls).map(own).collect();
            let mut places = springs.factor(entries, &ground)?.solve(&forces);
            places.push(Vector2::new(0.0, period));
            Ok(self.copies.positions(&places))
        };
        let uv = softened(triangles, balanced, control)?;
        Ok(self.places(&uv, period))
    }

    /// Returns the positions of the closed tube's vertices, and the period, from those of the opened one.
    fn places(&self, uv: &[Place], period: f64) -> Vec<Place> {
        let mut places = vec![Vector2::zeros(); self.closed.len() + 1];
        for ((&of, turns), place) in self.copies.of.iter().zip(&self.copies.turns).zip(uv) {
            places[of as usize] = place - Vector2::new(0.0, turns * period);
        }
        places[self.closed.len()] = Vector2::new(0.0, period);
        places
    }

    /// Returns the periods that are added at the corners of each triangle.
    fn turns(&self, triangles: &TriangleEnergy) -> Vec<[f64; 3]> {
        triangles.corners().map(|corners| corners.map(|copy| self.copies.turns[copy as usize])).collect()
    }

    /// Returns the outline of the ends and their copies, and the copies of vertices that it refers to, which begin with
    /// those of the opened tube.
    fn outline(&self) -> (Outline, Copies) {
        let mut copies = self.copies.clone();
        let mut outline = Outline::of(self.opened, self.ends.iter().flatten().copied());
        let mut known: HashMap<(u32, i32), u32> =
            (0..).zip(copies.of.iter().zip(&copies.turns)).map(|(n, (&of, &turns))| ((of, turns as i32), n)).collect();
        let edges = outline.edges().to_vec();
        for by in BESIDE {
            let mut copy = |n: u32| {
                let (of, turns) = (self.copies.of[n as usize], self.copies.turns[n as usize] as i32 + by);
                *known.entry((of, turns)).or_insert_with(|| {
                    copies.of.push(of);
                    copies.turns.push(f64::from(turns));
                    copies.of.len() as u32 - 1
                })
            };
            outline.extend(edges.iter().map(|edge| edge.map(&mut copy)));
        }
        (outline, copies)
    }
}

/// The energy of a periodic map, as a function of the places of the closed tube's vertices and the period.
struct TubeEnergy<'a> {
    pairs: &'a Pairs,
    dials: Dials,
    triangles: &'a TriangleEnergy,
    springs: &'a Springs,
    /// The periods at the corners of the triangles.
    turns: &'a [[f64; 3]],
    outline: &'a Outline,
    /// The copies of vertices; the triangles and pairs refer to the first ones.
    copies: &'a Copies,
    /// The number of vertices of the opened tube.
    opened: usize,
}

impl Objective for TubeEnergy<'_> {
    fn evaluate(&self, places: &[Place], control: &Control) -> Result<(f64, Vec<Place>)> {
        let uv = self.copies.positions(places);
        let mut gradient = vec![Vector2::zeros(); uv.len()];
        let (own, Dials { bands, shape, stiffness, .. }) = (self.opened, &self.dials);
        let of_triangles = self.triangles.add(&uv[..own], *shape, *stiffness, &mut gradient[..own]);
        if of_triangles.is_infinite() {
            return Ok((of_triangles, vec![Vector2::zeros(); places.len()]));
        }
        let of_outline = self.outline.add(&uv, APART, &mut gradient);
        let period = places[places.len() - 1].y;
        let (of_pairs, slope) = self.pairs.add_around(&uv, period, bands, &mut gradient, control)?;
        let mut gathered = self.copies.gather(&gradient, places.len());
        gathered[places.len() - 1].y += slope;
        Ok((of_triangles + of_outline + of_pairs, gathered))
    }

    fn factor(&self, places: &[Place]) -> Result<Factor> {
        let uv = self.copies.positions(places);
        let mut ground = vec![0.0; uv.len()];
        self.pairs.add_curvature_around(&uv, places[places.len() - 1].y, &self.dials.bands, &mut ground);
        self.outline.add_curvature(&uv, APART, &mut ground);
        let mut gathered = vec![0.0; places.len() - 1];
        self.copies.of.iter().zip(&ground).for_each(|(&of, ground)| gathered[of as usize] += ground);
        let stiffness = self.triangles.stiffness(&uv[..self.opened], self.dials.shape, self.dials.stiffness);
        self.springs.factor_with_period(&stiffness, &gathered, self.turns)
    }

    fn farthest_step(&self, places: &[Place], direction: &[Place]) -> f64 {
        let [uv, direction] = [places, direction].map(|places| self.copies.positions(places));
        let unfolded = self.triangles.farthest_step(&uv[..self.opened], &direction[..self.opened]);
        self.outline.farthest_step(&uv, &direction, unfolded.min(1.0 / SAFE))
    }
}

/// Returns a map (mm) of the opened tube without folds, and its period, that preserve the distances of rows among the
/// compared vertices of the closed tube, and the shapes of triangles. The first direction leads from the first end to
/// the second, and the surface is seen from outside. The numbers in `rows` refer to `evaluated`. A `weighting` as in
/// [`flatten`](super::levels::flatten).
/// Errors: those of [`flatten`](super::levels::flatten).
pub(crate) fn flatten_tube(
    tube: &Tube, rows: &DistanceRows, evaluated: &[u32], weighting: f64, control: &Control,
) -> Result<(Vec<[f64; 2]>, f64, Convergence)> {
    let (opened, dials) = (tube.opened.len(), weighted(weighting));
    let first = tube.first_copies();
    let compared: Vec<u32> = evaluated.iter().map(|&vertex| first[vertex as usize]).collect();
    let pairs = Pairs::new(rows, &compared, tube.opened.area(), control)?;
    let triangles = TriangleEnergy::new(tube.opened);
    let corners = triangles.corners().map(|corners| corners.map(|copy| tube.copies.of[copy as usize])).collect();
    let springs = Springs::new(corners, tube.closed.len(), control)?;
    let (outline, copies) = tube.outline();
    let turns = tube.turns(&triangles);
    control.begin("unfolding", 1);
    let mut places = tube.spread(tube.length(rows, evaluated), &triangles, &springs, control)?;
    let mut uv = tube.copies.positions(&places);
    let folded = triangles.folded(&uv);
    if folded > 0 {
        return Err(Error::Folded { triangles: folded });
    }
    // vertices at the seam have two copies, which must move together
    let mut copied = vec![0; tube.closed.len()];
    tube.copies.of.iter().for_each(|&of| copied[of as usize] += 1);
    let may_move: Vec<bool> = tube.copies.of.iter().map(|&of| copied[of as usize] == 1).collect();
    ease(&triangles, FIRST.shape, &may_move, &mut uv, control)?;
    places = tube.places(&uv, places[places.len() - 1].y);
    let few = pairs.of_first(FIRST_LANDMARKS);
    let crossings = |places: &[Place]| outline.crossings(&copies.positions(places), control);
    let mut convergence = Convergence { energies: Vec::new(), converged: false };
    for (pairs, dials, rounds) in [(&few, FIRST, FIRST_ROUNDS), (&pairs, dials, MOST_ROUNDS)] {
        let energy = TubeEnergy {
            pairs,
            dials,
            triangles: &triangles,
            springs: &springs,
            turns: &turns,
            outline: &outline,
            copies: &copies,
            opened,
        };
        convergence = descend_in_rounds(&energy, crossings, &mut places, 1, rounds, stage(0), control)?;
    }
    if !convergence.energies.last().is_some_and(|&energy| energy < HOPELESS) {
        return Err(Error::Uneven);
    }
    let period = places[places.len() - 1].y;
    let uv = tube.copies.positions(&places).into_iter().map(Into::into).collect();
    Ok((uv, period, convergence))
}

#[cfg(test)]
mod tests;
