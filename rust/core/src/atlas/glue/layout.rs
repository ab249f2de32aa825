//! The layout of flat pieces during gluing: which edges are joined, and the position of each corner.
//!
//! Corner `3 f + k` is corner k of facet f, and also the side from it to corner k + 1. Joined corners around a vertex
//! form one *place*, which is numbered by its first corner. All numbers are those of [`Facets`], not of the input.

use std::collections::{HashMap, HashSet};

use nalgebra::Rotation2;

use super::strain::Place;
use crate::adjacency::distinct;
use crate::atlas::facets::{Facets, NONE};
use crate::embed::stress::triangles::Rest;
use crate::surface::mesh::{BORDER, next, previous};

/// Consecutive sides along the boundary of a piece, with another piece, or the same one, on their other side.
pub(super) type Chain = Vec<u32>;

#[derive(Clone)]
pub(super) struct Layout<'a> {
    pub facets: &'a Facets<'a>,
    /// The side across each side, or [`BORDER`].
    pub twins: Vec<u32>,
    /// The length of each side on the surface in mm.
    pub lengths: Vec<f64>,
    /// Whether each side separated two patches.
    pub seams: Vec<bool>,
    /// The shape of each facet on the surface. Its corners are the facet's places, beginning with the first.
    pub rests: Vec<Rest>,
    /// The place of each corner.
    pub place: Vec<u32>,
    /// The position of each place; other values are unused.
    pub uv: Vec<Place>,
    /// The piece of each facet.
    pub piece: Vec<u32>,
    /// The facets of each piece; none if it became part of another.
    pub members: Vec<Vec<u32>>,
    joined: Vec<bool>,
}

/// The changes made by joining.
#[derive(Default)]
pub(super) struct Joined {
    sides: Vec<u32>,
    places: Vec<(u32, u32)>,
    moved: Vec<(u32, Place)>,
    /// The joined places.
    pub at: Vec<u32>,
}

impl<'a> Layout<'a> {
    /// Creates the layout of patches, given the label and the flat corners of each face of the surface.
    pub fn new(facets: &'a Facets<'a>, labels: &[u32], flat: &[[[f64; 2]; 3]]) -> Self {
        let surface = facets.surface;
        let count = facets.len();
        // the corner of each half-edge of the surface
        let mut corner_of = vec![BORDER; 3 * count];
        for (facet, (&face, vertices)) in (0..).zip(facets.faces.iter().zip(&facets.vertices)) {
            let first = (0..3).find(|&k| surface.origin(3 * face + k) == vertices[0]).unwrap_or(0);
            (0..3).for_each(|k| corner_of[(3 * face + (first + k) % 3) as usize] = 3 * facet + k);
        }
        let mut half_edge = vec![0; 3 * count];
        corner_of.iter().zip(0..).for_each(|(&corner, h)| half_edge[corner as usize] = h);
        let twin = |&h: &u32| match surface.twins()[h as usize] {
            BORDER => BORDER,
            twin => corner_of[twin as usize],
        };
        let twins: Vec<u32> = half_edge.iter().map(twin).collect();
        let (piece, members) = components(facets, labels);
        let is_inside = |(side, &twin): (usize, &u32)| twin != BORDER && piece[side / 3] == piece[twin as usize / 3];
        let joined: Vec<bool> = twins.iter().enumerate().map(is_inside).collect();
        let mut layout = Self {
            lengths: half_edge.iter().map(|&h| surface.length(h)).collect(),
            seams: twins.iter().zip(&joined).map(|(&twin, &joined)| twin != BORDER && !joined).collect(),
            rests: (0..count as u32).map(|facet| Rest::of(facets.corners(facet), [0, 1, 2], 0.0)).collect(),
            place: vec![BORDER; 3 * count],
            uv: half_edge.iter().map(|&h| flat[h as usize / 3][h as usize % 3].into()).collect(),
            facets,
            twins,
            piece,
            members,
            joined,
        };
        layout.number_places(&(0..count as u32).collect::<Vec<u32>>());
        layout
    }

    /// Unites the joined corners of facets around each vertex into one place.
    fn number_places(&mut self, facets: &[u32]) {
        let corners = || facets.iter().flat_map(|&facet| 3 * facet..3 * facet + 3);
        corners().for_each(|corner| self.place[corner as usize] = BORDER);
        for corner in corners() {
            if self.place[corner as usize] == BORDER {
                let fan = self.around(corner);
                let first = fan.iter().copied().min().unwrap_or(corner);
                fan.into_iter().for_each(|other| self.place[other as usize] = first);
            }
        }
    }

    /// Divides a piece into the pieces of another layout of the same surface.
    pub fn take_apart(&mut self, piece: u32, patches: &Layout<'_>) {
        let facets = std::mem::take(&mut self.members[piece as usize]);
        for number in distinct(facets.iter().map(|&facet| patches.piece[facet as usize])) {
            let members = patches.members[number as usize].clone();
            members.iter().for_each(|&facet| self.piece[facet as usize] = self.members.len() as u32);
            self.members.push(members);
        }
        for corner in facets.iter().flat_map(|&facet| 3 * facet..3 * facet + 3) {
            self.joined[corner as usize] = patches.joined[corner as usize];
            self.uv[corner as usize] = patches.uv[corner as usize];
        }
        self.number_places(&facets);
    }

    /// Returns whether a side lies on the boundary of a piece.
    pub fn is_open(&self, side: u32) -> bool {
        !self.joined[side as usize]
    }

    /// Returns whether a side is not joined with the piece on its other side.
    pub fn is_cut(&self, side: u32) -> bool {
        self.is_open(side) && self.twins[side as usize] != BORDER
    }

    pub fn ends(&self, side: u32) -> [u32; 2] {
        [side, next(side)].map(|corner| self.place[corner as usize])
    }

    pub fn at(&self, corner: u32) -> Place {
        self.uv[self.place[corner as usize] as usize]
    }

    pub fn flat(&self, facet: u32) -> [Place; 3] {
        [0, 1, 2].map(|k| self.at(3 * facet + k))
    }

    /// Returns the corners that are joined around a corner's vertex, counterclockwise, starting from a boundary.
    pub fn around(&self, corner: u32) -> Vec<u32> {
        let mut first = corner;
        while self.joined[first as usize] {
            first = next(self.twins[first as usize]);
            if first == corner {
                break;
            }
        }
        let mut corners = vec![first];
        let mut last = first;
        while self.joined[previous(last) as usize] {
            last = self.twins[previous(last) as usize];
            if last == first {
                break;
            }
            corners.push(last);
        }
        corners
    }

    /// Returns whether a piece surrounds a place.
    pub fn is_inner(&self, place: u32) -> bool {
        let first = self.around(place)[0];
        self.joined[first as usize]
    }

    /// Returns the cuts between a piece and another one (or itself) as chains of sides of the facets `among`.
    pub fn chains(&self, among: &[u32], other: u32) -> Vec<Chain> {
        let sides = among.iter().flat_map(|&facet| [3 * facet, 3 * facet + 1, 3 * facet + 2]);
        let beyond = |side: u32| self.piece[self.twins[side as usize] as usize / 3];
        let cuts: Vec<u32> = sides.filter(|&side| self.is_cut(side) && beyond(side) == other).collect();
        self.chained(cuts)
    }

    /// Returns cuts as chains, each once, from either side.
    pub fn chained(&self, mut cuts: Vec<u32>) -> Vec<Chain> {
        cuts.sort_unstable();
        let from: HashMap<u32, u32> = cuts.iter().map(|&side| (self.ends(side)[0], side)).collect();
        let follows = |side: u32| {
            let after = *from.get(&self.ends(side)[1])?;
            let twin = self.twins[side as usize];
            let together = after != twin && self.ends(twin)[0] == self.ends(self.twins[after as usize])[1];
            together.then_some(after)
        };
        let has_before: HashSet<u32> = cuts.iter().filter_map(|&side| follows(side)).collect();
        let mut taken: HashSet<u32> = HashSet::new();
        let mut chains = Vec::new();
        // first those with a beginning, then closed ones
        let beginnings = cuts.iter().filter(|side| !has_before.contains(side));
        for &side in beginnings.chain(&cuts) {
            if taken.contains(&side) || taken.contains(&self.twins[side as usize]) {
                continue;
            }
            let mut chain = vec![side];
            taken.insert(side);
            let mut last = side;
            while let Some(after) = follows(last) {
                let twin = self.twins[after as usize];
                if taken.contains(&after) || taken.contains(&twin) {
                    break;
                }
                taken.insert(after);
                chain.push(after);
                last = after;
            }
            chains.push(chain);
        }
        chains
    }

    /// Returns the length of sides on the surface in mm.
    pub fn length(&self, sides: &[u32]) -> f64 {
        sides.iter().map(|&side| self.lengths[side as usize]).sum()
    }

    /// Returns the length of a piece's boundary on the surface in mm.
    pub fn boundary(&self, piece: u32) -> f64 {
        let sides = self.members[piece as usize].iter().flat_map(|&facet| 3 * facet..3 * facet + 3);
        sides.filter(|&side| self.is_open(side)).map(|side| self.lengths[side as usize]).sum()
    }

    pub fn place_rigidly(&mut self, piece: u32, turn: Rotation2<f64>, shift: Place) {
        for &facet in &self.members[piece as usize] {
            for corner in 3 * facet..3 * facet + 3 {
                if self.place[corner as usize] == corner {
                    self.uv[corner as usize] = turn * self.uv[corner as usize] + shift;
                }
            }
        }
    }

    /// Joins cuts: the ends of their two sides move to the mean of their positions. Slits without width are closed too.
    pub fn join(&mut self, cuts: &[u32]) -> Joined {
        let mut changed = Joined::default();
        let mut left: Vec<u32> = cuts.to_vec();
        while let Some(side) = left.pop() {
            if !self.is_open(side) {
                continue;
            }
            for side in [side, self.twins[side as usize]] {
                self.joined[side as usize] = true;
                changed.sides.push(side);
            }
            for corner in [side, next(side)] {
                let fan = self.around(corner);
                self.unify(&fan, &mut changed);
                let (out, back) = (fan[0], previous(fan[fan.len() - 1]));
                if self.is_cut(out) && self.twins[out as usize] == back && self.ends(out)[1] == self.ends(back)[0] {
                    left.push(out);
                }
            }
        }
        changed.at = distinct(changed.sides.iter().flat_map(|&side| self.ends(side)));
        changed
    }

    /// Unites corners around a vertex into one place.
    fn unify(&mut self, fan: &[u32], changed: &mut Joined) {
        let old = distinct(fan.iter().map(|&corner| self.place[corner as usize]));
        let [first, .., _] = old[..] else { return };
        let middle = old.iter().map(|&place| self.uv[place as usize]).sum::<Place>() / old.len() as f64;
        changed.moved.push((first, self.uv[first as usize]));
        self.uv[first as usize] = middle;
        for &corner in fan {
            let place = std::mem::replace(&mut self.place[corner as usize], first);
            changed.places.push((corner, place));
        }
    }

    pub fn part(&mut self, changed: Joined) {
        changed.sides.iter().for_each(|&side| self.joined[side as usize] = false);
        changed.places.iter().rev().for_each(|&(corner, place)| self.place[corner as usize] = place);
        changed.moved.iter().rev().for_each(|&(place, uv)| self.uv[place as usize] = uv);
    }

    pub fn unite(&mut self, larger: u32, smaller: u32) {
        let moved = std::mem::take(&mut self.members[smaller as usize]);
        moved.iter().for_each(|&facet| self.piece[facet as usize] = larger);
        self.members[larger as usize].extend(moved);
    }

    /// Returns the rigid motion that moves the other sides of cuts closest to them (Procrustes).
    pub fn fit(&self, cuts: &[u32]) -> (Rotation2<f64>, Place) {
        let pairs: Vec<[Place; 2]> = cuts.iter().flat_map(|&side| self.pairs(side)).collect();
        let centre = |n: usize| pairs.iter().map(|pair| pair[n]).sum::<Place>() / pairs.len() as f64;
        let [to, from] = [centre(0), centre(1)];
        let (mut dot, mut cross) = (0.0, 0.0);
        for [a, b] in &pairs {
            dot += (b - from).dot(&(a - to));
            cross += (b - from).perp(&(a - to));
        }
        // the rotation with the largest Σ a·(R b) (Procrustes in the plane)
        let turn = Rotation2::new(cross.atan2(dot));
        let shift = to - turn * from;
        (turn, shift)
    }

    /// Returns the distance between the two sides of a cut, at the end where it is larger.
    pub fn gap(&self, side: u32) -> f64 {
        let gaps = self.pairs(side).map(|[a, b]| (a - b).norm());
        gaps[0].max(gaps[1])
    }

    /// Returns the positions of the two ends of a side, each with the position of the same vertex on the other side.
    fn pairs(&self, side: u32) -> [[Place; 2]; 2] {
        let twin = self.twins[side as usize];
        [[self.at(side), self.at(next(twin))], [self.at(next(side)), self.at(twin)]]
    }
}

/// Returns the connected parts with equal labels, numbered by their first facets: a facet's part, and a part's facets.
fn components(facets: &Facets<'_>, labels: &[u32]) -> (Vec<u32>, Vec<Vec<u32>>) {
    let label = |facet: u32| labels[facets.faces[facet as usize] as usize];
    let mut piece = vec![NONE; facets.len()];
    let mut members: Vec<Vec<u32>> = Vec::new();
    for first in 0..facets.len() as u32 {
        if piece[first as usize] != NONE {
            continue;
        }
        let number = members.len() as u32;
        piece[first as usize] = number;
        let mut found = vec![first];
        let mut begun = 0;
        while let Some(&facet) = found.get(begun) {
            begun += 1;
            for other in facets.across[facet as usize] {
                if other != NONE && piece[other as usize] == NONE && label(other) == label(first) {
                    piece[other as usize] = number;
                    found.push(other);
                }
            }
        }
        members.push(found);
    }
    (piece, members)
}
