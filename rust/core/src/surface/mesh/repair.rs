//! Repair of triangle meshes: removal of defects that have exactly one valid correction.
//!
//! - If no triangles share a vertex (triangle soup, as in STL files), vertices at the same position are merged.
//! - Of triangles with the same corners, one is kept.
//! - A triangle without area whose corners coincide is removed by an edge collapse, unless this changes the topology:
//!   no loop of three edges may be closed, and no two parts of the boundary joined (the link condition of Dey,
//!   Edelsbrunner, Guha, Nekhayev 1999). The merged vertex has the lower number.
//! - A triangle whose corners are collinear is removed by flipping its longest edge; at a boundary, it is dropped.
//! - A triangle without area that is attached by one edge is dropped, and so is a component without area.
//!
//! Files have single precision. If there are triangles without area, edges are collapsed too whose length is explained
//! by rounding and negligible beside the others. No point is moved. Vertices that merely coincide remain separate, like
//! those on the two sides of a cut and on banks that touch.

use std::collections::{HashMap, VecDeque};

use nalgebra::Vector3;

use super::next;
use crate::adjacency::{Sets, distinct};

/// The rounding error of zero.
const ROUNDING: f64 = 4.0 * f64::EPSILON;

/// The number of times that failed repairs are retried after others have succeeded.
const ROUNDS: usize = 64;

/// The relative error of a coordinate in single precision; also the length of the longest edge that is attributed to
/// it, in units of the median edge.
const SINGLE: f64 = 4.0 * f32::EPSILON as f64;
const NOTHING: f64 = 1e-4;

/// The maximum number of flips for each triangle without area; one is usual.
const MOST_FLIPS: usize = 16;

/// Triangles after the repair.
#[derive(Debug, Default)]
pub(super) struct Repair {
    /// The remaining triangles in their order.
    pub faces: Vec<[u32; 3]>,
    /// Their original numbers.
    pub numbers: Vec<u32>,
    /// Merged vertices, each with the lowest vertex of its group.
    pub merged: Vec<[u32; 2]>,
    /// The number of dropped triangles without area.
    pub dropped: usize,
    /// The number of triangles without area that were flipped away.
    pub flipped: usize,
    /// The number of dropped triangles with the same corners as others.
    pub duplicates: usize,
}

/// Repairs triangles. Defects without a unique correction remain.
pub(super) fn repair(points: &[[f64; 3]], mut faces: Vec<[u32; 3]>) -> Repair {
    let mut groups = Sets::new(points.len());
    if is_soup(&faces, points.len()) {
        for group in at_one_place(points, faces.as_flattened().to_vec()) {
            group[1..].iter().for_each(|&vertex| _ = groups.join(group[0], vertex));
        }
        faces.iter_mut().for_each(|face| *face = face.map(|v| groups.find(v)));
    }
    let mut repair = Repair::default();
    let mut is_kept = vec![true; faces.len()];
    for (face, is_kept) in faces.iter().zip(&mut is_kept) {
        if face[0] == face[1] || face[1] == face[2] || face[2] == face[0] {
            *is_kept = false;
            repair.dropped += 1;
        }
    }
    for face in duplicates(&faces) {
        repair.duplicates += usize::from(std::mem::replace(&mut is_kept[face as usize], false));
    }
    if faces.iter().zip(&is_kept).any(|(face, &is_kept)| is_kept && has_no_area(points, face)) {
        let mut complex = Complex::new(points, faces, is_kept, groups);
        complex.take_away_what_has_no_area(&mut repair);
        (faces, is_kept, groups) = (complex.faces, complex.is_kept, complex.groups);
    }
    let used = faces.iter().zip(&is_kept).zip(0..).filter(|&((_, &is_kept), _)| is_kept);
    (repair.faces, repair.numbers) = used.map(|((face, _), n)| (face.map(|v| groups.find(v)), n)).unzip();
    let all = 0..points.len() as u32;
    repair.merged = all.map(|v| [v, groups.find(v)]).filter(|[v, lowest]| v != lowest).collect();
    repair
}

/// Returns whether the corners of a face are collinear or coincide.
pub(super) fn has_no_area(points: &[[f64; 3]], &[a, b, c]: &[u32; 3]) -> bool {
    let place = |v: u32| Vector3::from(points[v as usize]);
    let (ab, ac) = (place(b) - place(a), place(c) - place(a));
    let longest = ab.norm_squared().max(ac.norm_squared()).max((ac - ab).norm_squared());
    ab.cross(&ac).norm() <= ROUNDING * longest
}

/// Returns whether the shortest edge of a face is negligible compared with its longest one.
fn is_needle(shortest: f64, longest: f64) -> bool {
    shortest <= ROUNDING * longest
}

pub(super) fn duplicates(faces: &[[u32; 3]]) -> Vec<u32> {
    let sorted = |mut face: [u32; 3]| {
        face.sort_unstable();
        face
    };
    let mut keyed: Vec<([u32; 3], u32)> = faces.iter().zip(0..).map(|(&face, n)| (sorted(face), n)).collect();
    keyed.sort_unstable();
    let mut found: Vec<u32> = keyed.windows(2).filter(|two| two[0].0 == two[1].0).map(|two| two[1].1).collect();
    found.sort_unstable();
    found
}

/// Returns the groups of vertices that share a position, ascending.
pub(super) fn at_one_place(points: &[[f64; 3]], mut vertices: Vec<u32>) -> Vec<Vec<u32>> {
    let bits = |v: u32| points[v as usize].map(|x| (x + 0.0).to_bits()); // −0 is 0
    vertices.sort_unstable_by_key(|&v| (bits(v), v));
    vertices.chunk_by(|&a, &b| bits(a) == bits(b)).filter(|group| group.len() > 1).map(<[u32]>::to_vec).collect()
}

/// Returns whether no triangle shares a vertex with another one.
pub(super) fn is_soup(faces: &[[u32; 3]], vertices: usize) -> bool {
    let mut is_used = vec![false; vertices];
    let is_new = |&v: &u32| !std::mem::replace(&mut is_used[v as usize], true);
    faces.len() > 1 && faces.as_flattened().iter().all(is_new)
}

/// Triangles with their neighbours, which need not form a surface.
struct Complex<'a> {
    points: &'a [[f64; 3]],
    faces: Vec<[u32; 3]>,
    is_kept: Vec<bool>,
    /// The triangles of each vertex, and some that were its triangles before.
    around: Vec<Vec<u32>>,
    /// The number of triangles of each edge, lower vertex first.
    edges: HashMap<[u32; 2], u32>,
    /// The number of boundary edges of each vertex.
    borders: Vec<u32>,
    /// The longest edge whose ends count as coincident, in mm.
    rounding: f64,
    groups: Sets,
}

impl<'a> Complex<'a> {
    fn new(points: &'a [[f64; 3]], faces: Vec<[u32; 3]>, is_kept: Vec<bool>, groups: Sets) -> Self {
        let (around, borders) = (vec![Vec::new(); points.len()], vec![0; points.len()]);
        let rounding = rounding(points, &faces);
        let mut complex = Self { points, faces, is_kept, around, edges: HashMap::new(), borders, rounding, groups };
        for face in 0..complex.faces.len() as u32 {
            if complex.is_kept[face as usize] {
                complex.add(face, complex.faces[face as usize]);
            }
        }
        complex
    }

    fn take_away_what_has_no_area(&mut self, repair: &mut Repair) {
        let is_flat = |complex: &Self, face: u32| {
            let corners = &complex.faces[face as usize];
            let is_flat = || {
                has_no_area(complex.points, corners) || complex.lengths(corners).iter().any(|&l| l <= complex.rounding)
            };
            complex.is_kept[face as usize] && is_flat()
        };
        let all = 0..self.faces.len() as u32;
        let mut queue: VecDeque<u32> = all.filter(|&face| is_flat(self, face)).collect();
        let most_flips = MOST_FLIPS * queue.len();
        for _ in 0..ROUNDS {
            let (mut waiting, mut progress) = (Vec::new(), false);
            while let Some(face) = queue.pop_front() {
                if !is_flat(self, face) {
                    continue;
                }
                match self.repair(face, repair.flipped < most_flips) {
                    Some(Done::Collapsed(gone, changed)) => {
                        repair.dropped += gone;
                        queue.extend(changed);
                    }
                    Some(Done::Flipped(changed)) => {
                        repair.flipped += 1;
                        queue.extend(changed);
                    }
                    Some(Done::Dropped) => repair.dropped += 1,
                    None => {
                        waiting.push(face);
                        continue;
                    }
                }
                progress = true;
            }
            queue.extend(waiting);
            if !progress || queue.is_empty() {
                break;
            }
        }
        let left: Vec<u32> = queue.into_iter().filter(|&face| is_flat(self, face)).collect();
        repair.dropped += self.drop_specks(&left);
    }

    /// Drops components without area, unless all components are such.
    fn drop_specks(&mut self, flat: &[u32]) -> usize {
        let mut pieces = Sets::new(self.points.len());
        let kept = |complex: &Self| (0..complex.faces.len()).filter(|&f| complex.is_kept[f]).collect::<Vec<_>>();
        let mut has_area = vec![false; self.points.len()];
        for &face in &kept(self) {
            let [a, b, c] = self.faces[face];
            pieces.join(a, b);
            pieces.join(a, c);
        }
        for &face in &kept(self) {
            let piece = pieces.find(self.faces[face][0]) as usize;
            has_area[piece] |= !has_no_area(self.points, &self.faces[face]);
        }
        if !has_area.contains(&true) {
            return 0;
        }
        let mut dropped = 0;
        for &face in flat {
            if self.is_kept[face as usize] && !has_area[pieces.find(self.faces[face as usize][0]) as usize] {
                self.remove(face);
                dropped += 1;
            }
        }
        dropped
    }

    /// Removes a triangle without area if there is one right way.
    fn repair(&mut self, face: u32, may_flip: bool) -> Option<Done> {
        let corners = self.faces[face as usize];
        let lengths = self.lengths(&corners);
        let [shortest, longest] = [f64::lt, f64::gt].map(|is_more: fn(&f64, &f64) -> bool| {
            (1..3).fold(0, |best, k| if is_more(&lengths[k], &lengths[best]) { k } else { best })
        });
        let is_point = |k: usize| is_needle(lengths[k], lengths[longest]) || lengths[k] <= self.rounding;
        let in_turn = [shortest, (shortest + 1) % 3, (shortest + 2) % 3].into_iter();
        let short: Vec<usize> = in_turn.filter(|&k| is_point(k)).collect();
        let collapsed = short.iter().find_map(|&k| self.collapse(corners[k], corners[(k + 1) % 3]));
        if collapsed.is_some() || !has_no_area(self.points, &corners) {
            return collapsed;
        }
        let flipped = if short.is_empty() { self.flip(face, longest, may_flip) } else { None };
        flipped.or_else(|| self.drop_ear(face))
    }

    /// Merges the two ends of an edge if this preserves the topology.
    fn collapse(&mut self, a: u32, b: u32) -> Option<Done> {
        let [kept, gone] = if self.around[a as usize].len() >= self.around[b as usize].len() { [a, b] } else { [b, a] };
        let star = self.star(gone);
        let third = |&face: &u32| {
            let corners = self.faces[face as usize];
            corners.contains(&kept).then(|| corners.into_iter().find(|&v| v != kept && v != gone)).flatten()
        };
        let opposite: Vec<u32> = star.iter().filter_map(third).collect();
        if !matches!(opposite.len(), 1 | 2) || opposite.first() == opposite.get(1) {
            return None;
        }
        if opposite.len() == 2 && self.borders[kept as usize] > 0 && self.borders[gone as usize] > 0 {
            return None; // two parts of the boundary would be joined
        }
        let around = star.iter().flat_map(|&face| self.faces[face as usize]).filter(|&v| v != kept && v != gone);
        if around.into_iter().any(|v| self.count(v, kept) > 0 && !opposite.contains(&v)) {
            return None; // a loop of three edges would be closed
        }
        if opposite.iter().any(|&c| self.count(c, kept) == 1 && self.count(c, gone) == 1) {
            return None; // an ear, whose tip would be left without a face
        }
        if let [c, d] = opposite[..] {
            let is_tetrahedron = |v: u32| {
                self.star(c).into_iter().any(|f| {
                    let corners = self.faces[f as usize];
                    corners.contains(&d) && corners.contains(&v)
                })
            };
            if self.count(c, d) > 0 && is_tetrahedron(gone) && is_tetrahedron(kept) {
                return None;
            }
        }
        for &face in &star {
            self.remove(face);
        }
        let mut moved = Vec::new();
        for face in star {
            let corners = self.faces[face as usize];
            if !corners.contains(&kept) {
                self.add(face, corners.map(|v| if v == gone { kept } else { v }));
                moved.push(face);
            }
        }
        self.around[gone as usize] = Vec::new();
        self.groups.join(kept, gone);
        Some(Done::Collapsed(opposite.len(), moved))
    }

    /// Connects the middle corner of a collinear triangle to the triangle across its longest edge.
    fn flip(&mut self, face: u32, longest: usize, may_flip: bool) -> Option<Done> {
        let corners = self.faces[face as usize];
        let [a, b, c] = [longest, (longest + 1) % 3, (longest + 2) % 3].map(|k| corners[k]);
        match self.count(a, b) {
            1 if self.borders[c as usize] == 0 => {
                self.remove(face);
                Some(Done::Dropped)
            }
            2 if may_flip => {
                let beyond = self.star(a).into_iter().find(|&f| f != face && self.faces[f as usize].contains(&b))?;
                let other = self.faces[beyond as usize];
                let d = other.into_iter().find(|&v| v != a && v != b)?;
                if d == c || self.count(c, d) > 0 {
                    return None;
                }
                self.remove(face);
                self.remove(beyond);
                self.add(face, other.map(|v| if v == b { c } else { v }));
                self.add(beyond, other.map(|v| if v == a { c } else { v }));
                Some(Done::Flipped([face, beyond]))
            }
            _ => None,
        }
    }

    /// Drops a triangle that is attached by at most one edge.
    fn drop_ear(&mut self, face: u32) -> Option<Done> {
        let corners = self.faces[face as usize];
        let free = (0..3).filter(|&k| self.count(corners[k], corners[(k + 1) % 3]) == 1).count();
        (free == 2).then(|| {
            self.remove(face);
            Done::Dropped
        })
    }

    fn lengths(&self, corners: &[u32; 3]) -> [f64; 3] {
        lengths(self.points, corners)
    }

    /// Returns the triangles of a vertex, ascending.
    fn star(&self, v: u32) -> Vec<u32> {
        let is_there = |&face: &u32| self.is_kept[face as usize] && self.faces[face as usize].contains(&v);
        distinct(self.around[v as usize].iter().copied().filter(is_there))
    }

    fn count(&self, a: u32, b: u32) -> u32 {
        self.edges.get(&[a.min(b), a.max(b)]).copied().unwrap_or(0)
    }

    fn add(&mut self, face: u32, corners: [u32; 3]) {
        self.faces[face as usize] = corners;
        self.is_kept[face as usize] = true;
        for k in 0..3 {
            self.around[corners[k] as usize].push(face);
            self.change(corners[k], corners[next(k as u32) as usize], 1);
        }
    }

    fn remove(&mut self, face: u32) {
        self.is_kept[face as usize] = false;
        let corners = self.faces[face as usize];
        (0..3).for_each(|k| self.change(corners[k], corners[next(k as u32) as usize], -1));
    }

    fn change(&mut self, a: u32, b: u32, by: i32) {
        let before = self.count(a, b);
        let now = before.saturating_add_signed(by);
        if now == 0 {
            self.edges.remove(&[a.min(b), a.max(b)]);
        } else {
            self.edges.insert([a.min(b), a.max(b)], now);
        }
        for v in [a, b] {
            self.borders[v as usize] += u32::from(now == 1);
            self.borders[v as usize] -= u32::from(before == 1);
        }
    }
}

fn lengths(points: &[[f64; 3]], corners: &[u32; 3]) -> [f64; 3] {
    let place = |k: usize| Vector3::from(points[corners[k % 3] as usize]);
    [0, 1, 2].map(|k| (place(k + 1) - place(k)).norm())
}

/// Returns the length of the longest edge that is attributed to rounding.
fn rounding(points: &[[f64; 3]], faces: &[[u32; 3]]) -> f64 {
    let farthest =
        faces.as_flattened().iter().flat_map(|&v| points[v as usize]).fold(0.0, |far, x: f64| x.abs().max(far));
    let mut all: Vec<f64> = faces.iter().flat_map(|face| lengths(points, face)).collect();
    let middle = all.len() / 2;
    let (_, median, _) = all.select_nth_unstable_by(middle, f64::total_cmp);
    (SINGLE * farthest).min(NOTHING * *median)
}

/// How a triangle without area was removed.
enum Done {
    /// An edge was collapsed, which removed this number of triangles; the listed ones changed a corner.
    Collapsed(usize, Vec<u32>),
    /// The edge between these triangles was flipped.
    Flipped([u32; 2]),
    Dropped,
}

#[cfg(test)]
mod tests;
