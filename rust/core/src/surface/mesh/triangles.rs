//! Triangles from files: their defects, and their assembly into a surface.

use nalgebra::Vector3;

use super::repair::{Repair, at_one_place, duplicates, has_no_area, is_soup};
use super::{BORDER, Surface, fans, next, twins_of_turned};
use crate::adjacency::{Sets, distinct};
use crate::{Error, Result};

/// The repairs that were made to a mesh.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Repairs {
    /// The number of reversed faces, so that neighbours agree and closed components point outwards.
    pub turned: usize,
    /// The number of vertices without a face, which were dropped.
    pub unused: usize,
    /// Vertices that were merged with another one at the same position: each with the lowest vertex of its group.
    pub merged: Vec<[u32; 2]>,
    /// The number of dropped faces without area.
    pub dropped: usize,
    /// The number of faces without area that were removed by flipping their longest edge.
    pub flipped: usize,
    /// The number of dropped faces with the same corners as others.
    pub duplicates: usize,
    /// Vertices that were split, because several fans of faces touched there.
    pub split: Vec<u32>,
    /// Edges of more than two faces, at which the surface was split into sheets.
    pub crowded_edges: Vec<[u32; 2]>,
    /// Vertices of faces that have no finite position.
    pub missing: Vec<u32>,
    /// The number of faces that were dropped because of them.
    pub incomplete: usize,
}

/// All defects that prevent triangles from being a surface.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Defects {
    /// Vertices of faces that have no finite position.
    pub missing: Vec<u32>,
    /// Faces with two equal corners or with collinear corners.
    pub degenerate: Vec<u32>,
    /// Faces with the same corners as an earlier face.
    pub duplicate: Vec<u32>,
    /// Edges of more than two faces, as pairs of vertices.
    pub crowded_edges: Vec<[u32; 2]>,
    /// Vertices at which several layers touch.
    pub pinched: Vec<u32>,
    /// One face of each component with only one side, like a Möbius strip.
    pub one_sided: Vec<u32>,
    /// Faces that are reversed with respect to their neighbours; these are repaired.
    pub turned: Vec<u32>,
    /// Vertices at exactly the same position as another one, where the mesh may be torn.
    pub coincident: Vec<u32>,
}

impl Defects {
    /// Returns an error for the first defect that prevents the triangles from being a surface.
    pub(crate) fn refuse(&self) -> Result<()> {
        let count = |list: &[u32]| list.len();
        if let Some(&vertex) = self.missing.first() {
            return Err(Error::PointNotFinite { vertex: vertex as usize });
        }
        if let Some(&face) = self.degenerate.first() {
            return Err(Error::DegenerateFace { face: face as usize, count: count(&self.degenerate) });
        }
        if let Some(&face) = self.duplicate.first() {
            return Err(Error::DuplicateFace { face: face as usize, count: count(&self.duplicate) });
        }
        if !self.crowded_edges.is_empty() {
            return Err(Error::CrowdedEdges { edges: self.crowded_edges.clone() });
        }
        if let Some(&face) = self.one_sided.first() {
            return Err(Error::OneSided { face: face as usize });
        }
        if let Some(&vertex) = self.pinched.first() {
            return Err(Error::PinchedVertex { vertex: vertex as usize, count: count(&self.pinched) });
        }
        Ok(())
    }
}

impl Surface {
    /// Creates a surface from points (mm) and triangles, and returns it with the repairs. Faces may only be reversed.
    ///
    /// # Errors
    /// [`Error::NoFaces`], [`Error::GraphTooLarge`] or [`Error::CornerOutOfRange`] of the faces; the error of the first
    /// of the [`defects`](Self::defects) that turning faces over does not repair; [`Error::PointTooFar`],
    /// [`Error::SurfaceTooSmall`] or [`Error::EdgeTooShort`] of the positions.
    pub fn from_triangles(points: &[[f64; 3]], faces: &[[i64; 3]]) -> Result<(Self, Repairs)> {
        let mut faces = checked(points, faces)?;
        let mut defects = Defects::default();
        let twins = join(points, &mut faces, &mut defects, false);
        defects.refuse()?;
        let (surface, repaired) = Self::joined(points, &faces, twins, defects, Repair::default());
        surface.check_scales()?;
        Ok((surface, repaired))
    }

    /// Creates a surface, and repairs all defects that have exactly one valid correction. Triangles without area are
    /// dropped or flipped away, and vertices merged for it, of which the lowest one keeps its number as id. Duplicates
    /// are dropped. Every fan around a vertex gets its own vertex. Faces of vertices without a finite position are
    /// dropped. At an edge of more than two faces, the surface is split into sheets: only two faces of one sheet stay
    /// joined. For valid triangles, the surface is bit-identical to that of [`Surface::from_triangles`].
    ///
    /// # Errors
    /// Those of [`Surface::from_triangles`], except for defects that were repaired.
    pub fn repaired(points: &[[f64; 3]], faces: &[[i64; 3]]) -> Result<(Self, Repairs)> {
        let given = checked(points, faces)?;
        let is_complete = |face: &[u32; 3]| face.iter().all(|&v| is_finite(&points[v as usize]));
        let (missing, count) = (missing(points, &given), given.len());
        let (kept, given): (Vec<u32>, Vec<[u32; 3]>) = (0..).zip(given).filter(|(_, face)| is_complete(face)).unzip();
        if let (true, Some(&vertex)) = (given.is_empty(), missing.first()) {
            return Err(Error::PointNotFinite { vertex: vertex as usize });
        }
        let mut faces = given.clone();
        let mut defects = Defects::default();
        let mut twins = join(points, &mut faces, &mut defects, true);
        let mut repair = Repair { numbers: (0..faces.len() as u32).collect(), ..Repair::default() };
        if !defects.degenerate.is_empty() || !defects.duplicate.is_empty() || is_soup(&given, points.len()) {
            repair = super::repair::repair(points, given);
            if repair.faces.is_empty() {
                defects.refuse()?;
            }
            faces = std::mem::take(&mut repair.faces);
            defects = Defects::default();
            twins = join(points, &mut faces, &mut defects, true);
        }
        let (split, crowded) = (std::mem::take(&mut defects.pinched), std::mem::take(&mut defects.crowded_edges));
        let number = |f: u32| kept[repair.numbers[f as usize] as usize];
        let as_given = |found: &mut Vec<u32>| found.iter_mut().for_each(|f| *f = number(*f));
        [&mut defects.degenerate, &mut defects.duplicate, &mut defects.one_sided].into_iter().for_each(as_given);
        defects.refuse()?;
        (defects.pinched, defects.crowded_edges) = (split, crowded);
        let (surface, mut repaired) = Self::joined(points, &faces, twins, defects, repair);
        (repaired.missing, repaired.incomplete) = (missing, count - kept.len());
        surface.check_scales()?;
        Ok((surface, repaired))
    }

    fn joined(
        points: &[[f64; 3]], faces: &[[u32; 3]], twins: Vec<u32>, defects: Defects, repair: Repair,
    ) -> (Self, Repairs) {
        let there = points.iter().filter(|point| is_finite(point)).count();
        let points: Vec<Vector3<f64>> = points.iter().map(|&p| p.into()).collect();
        let ids: Vec<u32> = (0..points.len() as u32).collect();
        let surface = Self::assemble(&points, &ids, faces, twins);
        let known = surface.ids.chunk_by(|a, b| a == b).count() + repair.merged.len(); // ids ascend
        let repaired = Repairs {
            turned: defects.turned.len(),
            unused: there - known,
            merged: repair.merged,
            dropped: repair.dropped,
            flipped: repair.flipped,
            duplicates: repair.duplicates,
            split: defects.pinched,
            crowded_edges: defects.crowded_edges,
            ..Repairs::default()
        };
        (surface, repaired)
    }

    /// Returns all defects of a mesh.
    ///
    /// # Errors
    /// [`Error::NoFaces`], [`Error::GraphTooLarge`], and [`Error::CornerOutOfRange`].
    pub fn defects(points: &[[f64; 3]], faces: &[[i64; 3]]) -> Result<Defects> {
        let mut faces = checked(points, faces)?;
        let mut defects = Defects::default();
        join(points, &mut faces, &mut defects, false);
        defects.coincident = coincident(points);
        Ok(defects)
    }
}

/// Returns the faces after checking that indices are in range.
fn checked(points: &[[f64; 3]], faces: &[[i64; 3]]) -> Result<Vec<[u32; 3]>> {
    let most = (u32::MAX / 8) as usize;
    if points.len() > most || faces.len() > most {
        return Err(Error::GraphTooLarge { points: points.len().max(faces.len()), most });
    }
    if faces.is_empty() {
        return Err(Error::NoFaces { points: points.len() });
    }
    let fits = |&v: &i64| usize::try_from(v).is_ok_and(|v| v < points.len());
    match faces.iter().position(|face| !face.iter().all(&fits)) {
        Some(face) => {
            let corner = faces[face].into_iter().find(|v| !fits(v)).unwrap_or_default();
            Err(Error::CornerOutOfRange { face, corner, points: points.len() })
        }
        None => Ok(faces.iter().map(|face| face.map(|v| v as u32)).collect()),
    }
}

fn is_finite(point: &[f64; 3]) -> bool {
    point.iter().all(|x| x.is_finite())
}

/// Returns the vertices of faces that have no finite position.
fn missing(points: &[[f64; 3]], faces: &[[u32; 3]]) -> Vec<u32> {
    distinct(faces.as_flattened().iter().copied().filter(|&v| !is_finite(&points[v as usize])))
}

/// Joins faces along their edges, reverses them so that neighbours agree, and lists defects. At edges of more than two
/// faces, `by_sheets` joins the two faces that are alone in their sheet there.
fn join(points: &[[f64; 3]], faces: &mut [[u32; 3]], defects: &mut Defects, by_sheets: bool) -> Vec<u32> {
    defects.missing = missing(points, faces);
    defects.degenerate = (0..faces.len() as u32).filter(|&f| has_no_area(points, &faces[f as usize])).collect();
    defects.duplicate = duplicates(faces);
    let (mut pairs, crowds) = pair_up(faces);
    defects.crowded_edges = crowds.iter().map(|&(edge, _)| edge).collect();
    if by_sheets && !crowds.is_empty() {
        join_sheets(points, faces, &mut pairs, &crowds);
    }
    let turned = turn(points, faces, &pairs, defects);
    let twins = twins_of_turned(&pairs, &turned);
    defects.turned = (0..faces.len() as u32).filter(|&f| turned[f as usize]).collect();
    for &face in &defects.turned {
        faces[face as usize].swap(1, 2);
    }
    let corner = fans(faces, &twins);
    let mut fan_of = vec![u32::MAX; points.len()];
    for (c, &vertex) in faces.as_flattened().iter().enumerate() {
        let known = &mut fan_of[vertex as usize];
        if *known == u32::MAX {
            *known = corner[c];
        } else if *known != corner[c] {
            defects.pinched.push(vertex);
        }
    }
    defects.pinched = distinct(std::mem::take(&mut defects.pinched));
    twins
}

/// An edge of more than two faces, as a pair of vertices, and its half-edges.
type Crowd = ([u32; 2], Vec<u32>);

/// Returns, for each half-edge, the only other one with the same vertices in either direction, or [`BORDER`]; and the
/// edges of more than two faces.
fn pair_up(faces: &[[u32; 3]]) -> (Vec<u32>, Vec<Crowd>) {
    let corners = faces.as_flattened();
    let ends = |h: u32| {
        let (a, b) = (corners[h as usize], corners[next(h) as usize]);
        [a.min(b), a.max(b)]
    };
    let mut order: Vec<([u32; 2], u32)> = (0..corners.len() as u32).map(|h| (ends(h), h)).collect();
    order.sort_unstable();
    let (mut pairs, mut crowds) = (vec![BORDER; corners.len()], Vec::new());
    for group in order.chunk_by(|a, b| a.0 == b.0) {
        match *group {
            [_] => {}
            [(_, g), (_, h)] => (pairs[g as usize], pairs[h as usize]) = (h, g),
            _ => crowds.push((group[0].0, group.iter().map(|&(_, h)| h).collect())),
        }
    }
    (pairs, crowds)
}

/// Joins half-edges at edges of more than two faces: two of the same sheet (the faces connected across other edges) if
/// it has no others there, and if this leaves it two sides.
fn join_sheets(points: &[[f64; 3]], faces: &[[u32; 3]], pairs: &mut [u32], crowds: &[Crowd]) {
    let corners = faces.as_flattened();
    let turned = turn(points, faces, pairs, &mut Defects::default());
    let mut sheets = Sets::new(faces.len());
    for (h, &pair) in (0..).zip(pairs.iter()).filter(|&(_, &pair)| pair != BORDER) {
        sheets.join(h / 3, pair / 3);
    }
    for (_, half_edges) in crowds {
        let mut by_sheet: Vec<(u32, u32)> = half_edges.iter().map(|&h| (sheets.find(h / 3), h)).collect();
        by_sheet.sort_unstable();
        for group in by_sheet.chunk_by(|a, b| a.0 == b.0) {
            if let [(_, g), (_, h)] = *group {
                let is_same_way = corners[g as usize] == corners[h as usize];
                if is_same_way == (turned[g as usize / 3] != turned[h as usize / 3]) {
                    (pairs[g as usize], pairs[h as usize]) = (h, g);
                }
            }
        }
    }
}

/// Returns which faces must be reversed so that all agree: the smaller group of a component, or that makes it point
/// outwards if closed.
fn turn(points: &[[f64; 3]], faces: &[[u32; 3]], pairs: &[u32], defects: &mut Defects) -> Vec<bool> {
    let corners = faces.as_flattened();
    let mut turned = vec![None; faces.len()];
    let mut members = Vec::new();
    for start in 0..faces.len() {
        if turned[start].is_some() {
            continue;
        }
        members.clear();
        members.push(start as u32);
        turned[start] = Some(false);
        let (mut has_sides, mut is_closed, mut at) = (true, true, 0);
        while let Some(&face) = members.get(at) {
            at += 1;
            for h in 3 * face..3 * face + 3 {
                let pair = pairs[h as usize];
                if pair == BORDER {
                    is_closed = false;
                    continue;
                }
                let disagree = corners[h as usize] == corners[pair as usize]; // both run in the same direction
                let wanted = turned[face as usize].map(|here| here ^ disagree);
                let there = &mut turned[pair as usize / 3];
                if there.is_none() {
                    *there = wanted;
                    members.push(pair / 3);
                } else if *there != wanted {
                    has_sides = false;
                }
            }
        }
        if !has_sides {
            defects.one_sided.push(start as u32);
        }
        let is_turned = |&face: &u32| turned[face as usize] == Some(true);
        let all_over = if is_closed && has_sides {
            let sign = |face: &u32| if is_turned(face) { -1.0 } else { 1.0 };
            members.iter().map(|face| sign(face) * six_volumes(points, faces[*face as usize])).sum::<f64>() < 0.0
        } else {
            2 * members.iter().filter(|face| is_turned(face)).count() > members.len()
        };
        if all_over {
            members.iter().for_each(|&face| turned[face as usize] = turned[face as usize].map(|here| !here));
        }
    }
    turned.into_iter().map(|here| here == Some(true)).collect()
}

/// Returns six times the signed volume between a face and the first point.
fn six_volumes(points: &[[f64; 3]], face: [u32; 3]) -> f64 {
    let origin = points.iter().find(|point| is_finite(point)).map_or_else(Vector3::zeros, |&point| point.into());
    let [a, b, c] = face.map(|v| Vector3::from(points[v as usize]) - origin);
    a.dot(&b.cross(&c))
}

/// Returns the vertices at the position of an earlier one.
fn coincident(points: &[[f64; 3]]) -> Vec<u32> {
    let all = (0..points.len() as u32).filter(|&v| is_finite(&points[v as usize])).collect();
    let mut found: Vec<u32> = at_one_place(points, all).into_iter().flat_map(|group| group[1..].to_vec()).collect();
    found.sort_unstable();
    found
}
