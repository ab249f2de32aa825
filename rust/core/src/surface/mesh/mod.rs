//! The surface itself: an oriented triangle mesh in which every point has a neighbourhood like a disk or a half-disk.
//!
//! A mesh from a file and the boundary of a label volume ([`surfels`](crate::surface::voxels::surfels)) both become a
//! [`Surface`], and later stages treat them alike. A surface is immutable: a part of it, or a cut surface, is a new
//! surface, whose [`ids`](Surface::ids) are the vertices of the input.

pub mod curvature;
pub mod diffusion;
pub mod paths;
mod repair;
#[cfg(test)]
pub(crate) mod shapes;
pub mod triangles;

use nalgebra::Vector3;

use crate::adjacency::Components;
use crate::error::{check_length, check_points};
use crate::scales::{SHORTEST_EDGE, SMALLEST, is_near};
use crate::{Error, Result};

/// Marks a half-edge with no face on its other side.
pub const BORDER: u32 = u32::MAX;

/// An oriented 2-manifold of triangles, with or without a boundary.
///
/// Half-edge `3 f + k` leads from corner `k` of face `f` to its corner `k + 1`. Faces run counterclockwise as seen from
/// outside.
#[derive(Debug, Clone, PartialEq)]
pub struct Surface {
    points: Vec<Vector3<f64>>,
    faces: Vec<[u32; 3]>,
    twins: Vec<u32>,
    ids: Vec<u32>,
}

/// Returns the next half-edge of the same face.
#[inline]
pub(crate) const fn next(half_edge: u32) -> u32 {
    if half_edge % 3 == 2 { half_edge - 2 } else { half_edge + 1 }
}

/// Returns the previous half-edge of the same face.
#[inline]
pub(crate) const fn previous(half_edge: u32) -> u32 {
    if half_edge.is_multiple_of(3) { half_edge + 2 } else { half_edge - 1 }
}

/// Returns unit normals of the vertices, weighted by the areas of the faces, on the side from which the faces run
/// counterclockwise; zero where undefined.
///
/// # Errors
/// [`Error::NoSuchPoint`] if a corner is not the number of a point.
pub fn vertex_normals(points: &[Vector3<f64>], faces: &[[u32; 3]]) -> Result<Vec<Vector3<f64>>> {
    check_points(faces.iter().flatten().copied(), points.len())?;
    Ok(normals(points, faces))
}

/// Returns [`vertex_normals`] of valid faces.
pub(crate) fn normals(points: &[Vector3<f64>], faces: &[[u32; 3]]) -> Vec<Vector3<f64>> {
    let mut sums = vec![Vector3::zeros(); points.len()];
    for face in faces {
        let [a, b, c] = face.map(|v| points[v as usize]);
        let area = (b - a).cross(&(c - a));
        face.iter().for_each(|&v| sums[v as usize] += area);
    }
    sums.into_iter().map(|sum: Vector3<f64>| sum.try_normalize(0.0).unwrap_or_default()).collect()
}

impl Surface {
    /// Creates a surface from joined faces: `twins` are the half-edges on the other side of each one. Every fan of
    /// faces around a vertex gets its own vertex, so that a vertex where several layers touch is split. Unused vertices
    /// are dropped. The order is preserved.
    pub(crate) fn assemble(points: &[Vector3<f64>], ids: &[u32], faces: &[[u32; 3]], twins: Vec<u32>) -> Self {
        let corner = fans(faces, &twins);
        let old = faces.as_flattened();
        // the fans in the order of their vertices, then of their first corners
        let mut firsts: Vec<u32> = (0..corner.len() as u32).filter(|&c| corner[c as usize] == c).collect();
        firsts.sort_by_key(|&c| old[c as usize]);
        let mut number = vec![0; corner.len()];
        firsts.iter().enumerate().for_each(|(n, &c)| number[c as usize] = n as u32);
        Self {
            points: firsts.iter().map(|&c| points[old[c as usize] as usize]).collect(),
            ids: firsts.iter().map(|&c| ids[old[c as usize] as usize]).collect(),
            faces: corner.chunks_exact(3).map(|c| [0, 1, 2].map(|k| number[c[k] as usize])).collect(),
            twins,
        }
    }

    /// Restores a surface from its parts, bit by bit.
    ///
    /// # Errors
    /// [`Error::WrongLength`], [`Error::NoSuchPoint`], [`Error::PointNotFinite`] or [`Error::TwinsDisagree`] if the
    /// parts do not belong together.
    pub fn restored(points: &[Vector3<f64>], faces: &[[u32; 3]], twins: Vec<u32>, ids: &[u32]) -> Result<Self> {
        check_length("twins", twins.len(), "half-edges", 3 * faces.len())?;
        check_length("ids", ids.len(), "vertices", points.len())?;
        check_points(faces.iter().flatten().copied(), points.len())?;
        finite(points.iter().map(|p| (*p).into()))?;
        let corners = faces.as_flattened();
        let ends = |h: u32| [corners[h as usize], corners[next(h) as usize]];
        let agrees = |(h, &twin): (u32, &u32)| match twins.get(twin as usize) {
            None => twin == BORDER,
            Some(&back) => back == h && ends(h) == [ends(twin)[1], ends(twin)[0]],
        };
        match (0..).zip(&twins).position(|pair| !agrees(pair)) {
            Some(half_edge) => Err(Error::TwinsDisagree { half_edge }),
            None => Ok(Self::assemble(points, ids, faces, twins)),
        }
    }

    /// Returns the number of fans of faces around each of `vertices` vertices: one on a surface.
    pub(crate) fn fans_of(faces: &[[u32; 3]], twins: &[u32], vertices: usize) -> Vec<u32> {
        let mut count = vec![0; vertices];
        for (corner, &first) in (0..).zip(&fans(faces, twins)) {
            count[faces.as_flattened()[corner as usize] as usize] += u32::from(first == corner);
        }
        count
    }

    /// Returns the faces for which `keep` is true, with their vertices.
    pub(crate) fn part(&self, keep: &[bool]) -> Self {
        assert_eq!(keep.len(), self.faces.len(), "one value per face");
        let mut number = vec![BORDER; keep.len()];
        let kept: Vec<u32> = (0..keep.len() as u32).filter(|&f| keep[f as usize]).collect();
        kept.iter().enumerate().for_each(|(n, &f)| number[f as usize] = n as u32);
        let twin = |h: u32| match self.twins[h as usize] {
            BORDER => BORDER,
            t if number[t as usize / 3] == BORDER => BORDER,
            t => 3 * number[t as usize / 3] + t % 3,
        };
        let twins = kept.iter().flat_map(|&f| [3 * f, 3 * f + 1, 3 * f + 2]).map(twin).collect();
        let faces: Vec<[u32; 3]> = kept.iter().map(|&f| self.faces[f as usize]).collect();
        Self::assemble(&self.points, &self.ids, &faces, twins)
    }

    /// Returns the faces for which `keep` is true, with their vertices.
    ///
    /// # Errors
    /// [`Error::WrongLength`] if there is not one value per face.
    pub fn part_of_faces(&self, keep: &[bool]) -> Result<Self> {
        check_length("values to keep", keep.len(), "faces", self.faces.len())?;
        Ok(self.part(keep))
    }

    /// Returns the faces whose three corners are vertices for which `keep` is true.
    ///
    /// # Errors
    /// [`Error::WrongLength`] if there is not one value per vertex.
    pub fn part_of_vertices(&self, keep: &[bool]) -> Result<Self> {
        check_length("values to keep", keep.len(), "vertices", self.points.len())?;
        let faces: Vec<bool> = self.faces.iter().map(|face| face.iter().all(|&v| keep[v as usize])).collect();
        Ok(self.part(&faces))
    }

    /// Cuts the surface open along half-edges (and their twins). Vertices along the cut are doubled and keep their ids.
    pub(crate) fn cut_open(&self, half_edges: impl IntoIterator<Item = u32>) -> Self {
        let mut twins = self.twins.clone();
        for half_edge in half_edges {
            let twin = std::mem::replace(&mut twins[half_edge as usize], BORDER);
            if twin != BORDER {
                twins[twin as usize] = BORDER;
            }
        }
        Self::assemble(&self.points, &self.ids, &self.faces, twins)
    }

    /// Returns the same surface with other vertex positions, at which distances are then measured.
    ///
    /// # Errors
    /// [`Error::WrongLength`] if there is not one point per vertex, [`Error::PointNotFinite`], [`Error::PointTooFar`]
    /// or [`Error::SurfaceTooSmall`] of the points.
    pub fn moved(&self, points: Vec<Vector3<f64>>) -> Result<Self> {
        check_length("points", points.len(), "vertices", self.points.len())?;
        finite(points.iter().map(|p| (*p).into()))?;
        let moved = Self { points, ..self.clone() };
        moved.check_size()?;
        Ok(moved)
    }

    /// Returns the same surface, whose vertices are those vertices of another input.
    ///
    /// # Errors
    /// [`Error::WrongLength`] if there is not one id per vertex.
    pub fn with_ids(&self, ids: Vec<u32>) -> Result<Self> {
        check_length("ids", ids.len(), "vertices", self.points.len())?;
        Ok(Self { ids, ..self.clone() })
    }

    /// Returns it as a separate input: each vertex gets its number as id; faces of a mirrored surface are reversed.
    pub(crate) fn into_input(mut self, is_mirrored: bool) -> Self {
        self.ids = (0..self.points.len() as u32).collect();
        if is_mirrored {
            self.faces.iter_mut().for_each(|face| face.swap(1, 2));
            self.twins = twins_of_turned(&self.twins, &vec![true; self.faces.len()]);
        }
        self
    }

    /// Returns the memory of a surface in bytes: a vertex has a point of three f64, an id, and two faces of three
    /// corners and twins.
    pub(crate) const fn memory_need(vertices: usize) -> u64 {
        (24 + 4 + 2 * (12 + 12)) * vertices as u64
    }

    /// Returns the longest side of the bounding box, if it lies in the supported range.
    fn check_size(&self) -> Result<f64> {
        if let Some(far) = self.points.iter().position(|p| !p.iter().all(|&x| is_near(x))) {
            return Err(Error::PointTooFar { vertex: self.ids[far] as usize, at: self.points[far].into() });
        }
        let low = self.points.iter().fold(Vector3::repeat(f64::INFINITY), |low, p| low.inf(p));
        let high = self.points.iter().fold(Vector3::repeat(f64::NEG_INFINITY), |high, p| high.sup(p));
        let size = (high - low).max();
        if size < SMALLEST && !self.is_empty() { Err(Error::SurfaceTooSmall { size }) } else { Ok(size) }
    }

    /// Checks the size and the edges: an edge that is too short compared with the box has no direction.
    fn check_scales(&self) -> Result<()> {
        let size = self.check_size()?;
        match self.edges().find(|&edge| self.length(edge) < SHORTEST_EDGE * size) {
            Some(edge) => {
                let [a, b] = [self.origin(edge), self.target(edge)].map(|v| self.ids[v as usize] as usize);
                Err(Error::EdgeTooShort { a, b, length: self.length(edge), size })
            }
            None => Ok(()),
        }
    }

    /// Returns the number of vertices.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Returns whether there are no vertices.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// Returns the positions of the vertices in RAS+ mm.
    pub fn points(&self) -> &[Vector3<f64>] {
        &self.points
    }

    /// Returns the triangles.
    pub fn faces(&self) -> &[[u32; 3]] {
        &self.faces
    }

    /// Returns the half-edge on the other side of each half-edge, or [`BORDER`].
    pub fn twins(&self) -> &[u32] {
        &self.twins
    }

    /// Returns the vertex of the input for each vertex; the two sides of a cut share it.
    pub fn ids(&self) -> &[u32] {
        &self.ids
    }

    /// Returns the vertex at which a half-edge begins.
    #[inline]
    pub(crate) fn origin(&self, half_edge: u32) -> u32 {
        self.faces.as_flattened()[half_edge as usize]
    }

    /// Returns the vertex at which a half-edge ends.
    #[inline]
    pub(crate) fn target(&self, half_edge: u32) -> u32 {
        self.origin(next(half_edge))
    }

    /// Returns the length of a half-edge in mm.
    pub(crate) fn length(&self, half_edge: u32) -> f64 {
        let [a, b] = [self.origin(half_edge), self.target(half_edge)].map(|v| self.points[v as usize]);
        (a - b).norm()
    }

    /// Iterates over one half-edge of each edge, the one with the lower number.
    pub(crate) fn edges(&self) -> impl Iterator<Item = u32> + '_ {
        (0..self.twins.len() as u32).filter(|&h| h < self.twins[h as usize])
    }

    /// Returns whether an edge has faces on both sides.
    pub(crate) fn is_inner(&self, half_edge: u32) -> bool {
        self.twins[half_edge as usize] != BORDER
    }

    /// Returns unit normals of the faces; zero for faces without area.
    pub(crate) fn face_normals(&self) -> Vec<Vector3<f64>> {
        let normal = |face: &[u32; 3]| {
            let [a, b, c] = face.map(|v| self.points[v as usize]);
            (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or_default()
        };
        self.faces.iter().map(normal).collect()
    }

    /// Returns outward unit normals of the vertices: [`vertex_normals`].
    pub fn normals(&self) -> Vec<Vector3<f64>> {
        normals(&self.points, &self.faces)
    }

    /// Returns the areas of the faces in mm².
    pub(crate) fn areas(&self) -> Vec<f64> {
        let area = |face: &[u32; 3]| {
            let [a, b, c] = face.map(|v| self.points[v as usize]);
            0.5 * (b - a).cross(&(c - a)).norm()
        };
        self.faces.iter().map(area).collect()
    }

    /// Returns the connected components of the faces.
    pub fn components(&self) -> Components {
        self.pieces(|_| true)
    }

    /// Returns the connected components of the faces for which a rule holds.
    pub(crate) fn pieces(&self, is_allowed: impl Fn(u32) -> bool) -> Components {
        let beyond = |face: u32| {
            let twins = self.twins[3 * face as usize..3 * face as usize + 3].iter();
            twins.filter(|&&twin| twin != BORDER).map(|twin| twin / 3)
        };
        Components::of(self.faces.len(), beyond, is_allowed)
    }

    /// Returns the total area in mm².
    pub fn area(&self) -> f64 {
        self.areas().iter().sum()
    }

    /// Returns, for each vertex, whether it lies on the boundary.
    pub(crate) fn is_on_boundary(&self) -> Vec<bool> {
        let mut is_on_boundary = vec![false; self.len()];
        for half_edge in (0..self.twins.len() as u32).filter(|&h| self.twins[h as usize] == BORDER) {
            is_on_boundary[self.origin(half_edge) as usize] = true; // each is the origin of one half-edge of a loop
        }
        is_on_boundary
    }

    /// Returns the boundary loops as ordered half-edges, with the surface on their left.
    pub fn boundary(&self) -> Vec<Vec<u32>> {
        let mut seen = vec![false; self.twins.len()];
        let mut loops = Vec::new();
        for start in 0..self.twins.len() as u32 {
            if self.twins[start as usize] != BORDER || seen[start as usize] {
                continue;
            }
            let mut path = Vec::new();
            let mut half_edge = start;
            while !seen[half_edge as usize] {
                seen[half_edge as usize] = true;
                path.push(half_edge);
                half_edge = next(half_edge); // rotate around the target until the fan ends
                while self.twins[half_edge as usize] != BORDER {
                    half_edge = next(self.twins[half_edge as usize]);
                }
            }
            loops.push(path);
        }
        loops
    }
}

/// Returns the pairs after faces were reversed by exchanging their corners 1 and 2, and so their half-edges 0 and 2.
fn twins_of_turned(pairs: &[u32], turned: &[bool]) -> Vec<u32> {
    let renamed = |h: u32| if turned[h as usize / 3] { h - h % 3 + (2 - h % 3) } else { h };
    let mut twins = vec![BORDER; pairs.len()];
    for (h, &pair) in pairs.iter().enumerate() {
        if pair != BORDER {
            twins[renamed(h as u32) as usize] = renamed(pair);
        }
    }
    twins
}

/// Returns, for each corner, the first corner of its fan: the corners around a vertex that are connected across edges.
fn fans(faces: &[[u32; 3]], twins: &[u32]) -> Vec<u32> {
    let mut first = vec![BORDER; 3 * faces.len()];
    for start in 0..first.len() as u32 {
        if first[start as usize] != BORDER {
            continue;
        }
        // counterclockwise around the vertex until the boundary or the start, then clockwise
        let mut corner = start;
        loop {
            first[corner as usize] = start;
            match twins[previous(corner) as usize] {
                BORDER => break,
                twin if twin == start => break,
                twin if first[twin as usize] != BORDER => break, // only where faces disagree
                twin => corner = twin,
            }
        }
        corner = start;
        loop {
            match twins[corner as usize] {
                BORDER => break,
                twin if first[next(twin) as usize] != BORDER => break,
                twin => corner = next(twin),
            }
            first[corner as usize] = start;
        }
    }
    first
}

fn finite(mut points: impl Iterator<Item = [f64; 3]>) -> Result<()> {
    match points.position(|p| !p.iter().all(|x| x.is_finite())) {
        Some(vertex) => Err(Error::PointNotFinite { vertex }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;
    use crate::surface::topology::Topology;
    use crate::tests::assert_sound;
    use proptest::prelude::*;

    #[test]
    fn normals_point_outside() {
        let surface = shapes::surface(shapes::sphere(3));
        assert!(surface.points().iter().zip(surface.normals()).all(|(p, n)| p.dot(&n) > 0.99));
        assert!((surface.areas().iter().sum::<f64>() - 4.0 * std::f64::consts::PI).abs() < 0.2);
    }

    #[test]
    fn a_cut_doubles_its_inner_vertices() {
        let sphere = shapes::surface(shapes::sphere(3));
        // along a path of three edges
        let first = 0;
        let second = next(sphere.twins()[next(first) as usize]);
        let third = next(sphere.twins()[next(second) as usize]);
        assert_eq!([sphere.target(first), sphere.target(second)], [sphere.origin(second), sphere.origin(third)]);
        let open = sphere.cut_open([first, second, third]);
        assert_sound(&open);
        assert_eq!((open.len(), Topology::of(&open).euler, open.boundary().len()), (sphere.len() + 2, 1, 1));
        assert!(open.points().iter().zip(open.ids()).all(|(p, &id)| *p == sphere.points()[id as usize]));
    }

    #[test]
    fn a_cut_surface_is_restored() {
        let sphere = shapes::surface(shapes::sphere(2));
        for surface in [sphere.cut_open([0]), sphere.cut_open([0, next(sphere.twins()[next(0) as usize])])] {
            let restore = |twins: Vec<u32>| Surface::restored(surface.points(), surface.faces(), twins, surface.ids());
            assert_eq!(restore(surface.twins().to_vec()).unwrap(), surface);
            let mut other = surface.twins().to_vec();
            other.swap(3, 9);
            assert!(matches!(restore(other), Err(Error::TwinsDisagree { .. })));
        }
    }

    #[test]
    fn defects_are_found() {
        let (points, faces) = shapes::sheet(2, 2);
        let refused = |points: &[[f64; 3]], faces: &[[i64; 3]]| Surface::from_triangles(points, faces).unwrap_err();
        assert_eq!(refused(&points, &[]), Error::NoFaces { points: 9 });
        assert_eq!(refused(&points, &[[0, 1, 9]]), Error::CornerOutOfRange { face: 0, corner: 9, points: 9 });
        assert_eq!(refused(&points, &[[0, -1, 2]]), Error::CornerOutOfRange { face: 0, corner: -1, points: 9 });
        assert_eq!(refused(&points, &[[0, 1, 1]]), Error::DegenerateFace { face: 0, count: 1 });
        assert_eq!(refused(&points, &[[0, 1, 2]]), Error::DegenerateFace { face: 0, count: 1 }); // on one line
        let mut twice = faces.clone();
        twice.push([faces[0][1], faces[0][2], faces[0][0]]);
        assert_eq!(refused(&points, &twice), Error::DuplicateFace { face: 8, count: 1 });
        let mut nan = points.clone();
        nan[4][1] = f64::NAN;
        assert_eq!(refused(&nan, &faces), Error::PointNotFinite { vertex: 4 });
        let mut third = points.clone();
        third.push([0.2, 0.2, 3.0]);
        let mut fin = faces.clone();
        fin.push([faces[0][0], faces[0][2], 9]); // on the diagonal of the first square
        assert_eq!(refused(&third, &fin), Error::CrowdedEdges { edges: vec![[0, 4]] });
        let bow = [[0, 3, 4], [4, 8, 5]];
        assert_eq!(refused(&points, &bow), Error::PinchedVertex { vertex: 4, count: 1 });
    }

    #[test]
    fn a_mobius_strip_is_refused() {
        let n = 12;
        let place = |i: usize, side: f64| {
            let angle = std::f64::consts::TAU * i as f64 / n as f64;
            let (r, z) = (5.0 + side * (angle / 2.0).cos(), side * (angle / 2.0).sin());
            [r * angle.cos(), r * angle.sin(), z]
        };
        let points: Vec<[f64; 3]> = (0..n).flat_map(|i| [place(i, -1.0), place(i, 1.0)]).collect();
        let mut faces = Vec::new();
        for i in 0..n as i64 {
            let [a, b] = [2 * i, 2 * i + 1];
            let [c, d] = if i + 1 < n as i64 { [a + 2, b + 2] } else { [1, 0] };
            faces.extend([[a, c, d], [a, d, b]]);
        }
        assert_eq!(Surface::from_triangles(&points, &faces).unwrap_err(), Error::OneSided { face: 0 });
    }

    proptest! {
        #[test]
        fn turned_faces_are_turned_back(turned in prop::collection::vec(any::<bool>(), 512), outside in any::<bool>()) {
            let (points, mut faces) = shapes::sphere(3);
            let whole = shapes::surface((points.clone(), faces.clone()));
            for (face, &turn) in faces.iter_mut().zip(&turned) {
                if turn == outside {
                    face.swap(0, 1);
                }
            }
            let (surface, repaired) = Surface::from_triangles(&points, &faces).unwrap();
            assert_sound(&surface);
            prop_assert_eq!(repaired.turned, turned.iter().filter(|&&turn| turn == outside).count());
            prop_assert!(surface.normals().iter().zip(whole.normals()).all(|(a, b)| (a - b).norm() < 1e-12));
        }

        #[test]
        fn any_part_is_sound(keep in prop::collection::vec(any::<bool>(), 168)) {
            prop_assume!(keep.contains(&true));
            let torus = shapes::surface(shapes::torus(12, 7));
            let part = torus.part(&keep);
            assert_sound(&part);
            prop_assert_eq!(part.faces().len(), keep.iter().filter(|&&k| k).count());
            let kept = torus.faces().iter().zip(&keep).filter(|&(_, &k)| k).map(|(face, _)| face);
            for (face, old) in part.faces().iter().zip(kept) {
                prop_assert_eq!(face.map(|v| part.ids()[v as usize]), *old);
            }
            let half_edges: usize = part.boundary().iter().map(Vec::len).sum();
            prop_assert_eq!(half_edges, part.twins().iter().filter(|&&t| t == BORDER).count());
        }
    }
}
