//! The triangles in an order that depends only on their positions.

use std::cmp::Ordering;

use nalgebra::Vector3;

use crate::distortion::faces::doubled_area;
use crate::surface::{Surface, mesh::BORDER};
use crate::{Control, Error, Result};

/// Marks that there is no facet.
pub(super) const NONE: u32 = u32::MAX;

/// The triangles of a surface, sorted by the positions of their corners. Results computed in this order, including sums
/// and ties, do not depend on the numbering of vertices and triangles. (Triangles whose corners have the same positions
/// in the same order cannot be distinguished, and keep the order of their numbers.)
pub(super) struct Facets<'a> {
    pub surface: &'a Surface,
    /// The face of the surface for each facet.
    pub faces: Vec<u32>,
    /// The vertices of each facet, beginning with the first by position.
    pub vertices: Vec<[u32; 3]>,
    /// The facets across the three sides, or [`NONE`].
    pub across: Vec<[u32; 3]>,
    /// Unit normals.
    pub normals: Vec<Vector3<f64>>,
    /// Areas in mm².
    pub areas: Vec<f64>,
}

impl<'a> Facets<'a> {
    pub fn of(surface: &'a Surface, control: &Control) -> Result<Self> {
        control.begin("sorting triangles", 1);
        let count = surface.faces().len();
        let first: Vec<u32> = (0..count as u32).map(|face| first_corner(surface, face)).collect();
        let half_edges = |face: u32| [0, 1, 2].map(|k| 3 * face + (first[face as usize] + k) % 3);
        let place = |half_edge: u32| surface.points()[surface.origin(half_edge) as usize];
        let mut faces: Vec<u32> = (0..count as u32).collect();
        faces.sort_by(|&a, &b| by_places(&half_edges(a).map(place), &half_edges(b).map(place)));
        control.check()?;
        let mut number = vec![NONE; count];
        faces.iter().zip(0..).for_each(|(&face, facet)| number[face as usize] = facet);
        let beyond = |half_edge: u32| match surface.twins()[half_edge as usize] {
            BORDER => NONE,
            twin => number[twin as usize / 3],
        };
        let doubled: Vec<Vector3<f64>> = faces.iter().map(|&face| doubled_area(&half_edges(face).map(place))).collect();
        let is_flat = |n: &Vector3<f64>| n.norm() == 0.0;
        if let Some(facet) = doubled.iter().position(is_flat) {
            let count = doubled.iter().filter(|n| is_flat(n)).count();
            return Err(Error::DegenerateFace { face: faces[facet] as usize, count });
        }
        Ok(Self {
            surface,
            vertices: faces.iter().map(|&face| half_edges(face).map(|h| surface.origin(h))).collect(),
            across: faces.iter().map(|&face| half_edges(face).map(beyond)).collect(),
            normals: doubled.iter().map(|n| n.normalize()).collect(),
            areas: doubled.iter().map(|n| 0.5 * n.norm()).collect(),
            faces,
        })
    }

    pub fn len(&self) -> usize {
        self.faces.len()
    }

    /// Returns the positions of a facet's corners in mm.
    pub fn corners(&self, facet: u32) -> [Vector3<f64>; 3] {
        self.vertices[facet as usize].map(|v| self.surface.points()[v as usize])
    }

    /// Returns the facet whose normal is closest to a direction; of equally close ones, the first in the order.
    /// Panics if `among` is empty.
    pub fn facing(&self, among: &[u32], direction: &Vector3<f64>) -> u32 {
        let key = |facet: u32| (self.normals[facet as usize].dot(direction), std::cmp::Reverse(facet));
        let further = |a: &u32, b: &u32| {
            let ((x, p), (y, q)) = (key(*a), key(*b));
            x.total_cmp(&y).then(p.cmp(&q))
        };
        among.iter().copied().max_by(further).expect("there is a facet")
    }

    /// Returns the facets from the flattest to the most curved.
    ///
    /// The curvature at a vertex is Σ |β| l / Σ A, over the edges around it with exterior angle β and length l, and
    /// over its triangles. That of a facet is the maximum over its corners. It is 0 only where the surface is flat: on
    /// a saddle, where the mean curvature can vanish, the absolute angles do not cancel.
    pub fn by_curvature(&self) -> Vec<u32> {
        let mut bend = vec![0.0; self.surface.len()];
        let mut area = vec![0.0; self.surface.len()];
        for facet in 0..self.len() as u32 {
            let f = facet as usize;
            self.vertices[facet as usize].iter().for_each(|&v| area[v as usize] += self.areas[f]);
            for &other in self.across[f].iter().filter(|&&other| other != NONE && other > facet) {
                let (a, b) = (self.normals[f], self.normals[other as usize]);
                let angle = a.cross(&b).norm().atan2(a.dot(&b));
                let theirs = self.vertices[other as usize];
                let ends: Vec<u32> = self.vertices[f].into_iter().filter(|v| theirs.contains(v)).collect();
                let [p, q] = [ends[0], ends[1]].map(|v| self.surface.points()[v as usize]);
                ends.iter().for_each(|&v| bend[v as usize] += angle * (p - q).norm());
            }
        }
        let curvature = |facet: u32| {
            self.vertices[facet as usize].iter().map(|&v| bend[v as usize] / area[v as usize]).fold(0.0, f64::max)
        };
        let mut order: Vec<(f64, u32)> = (0..self.len() as u32).map(|facet| (curvature(facet), facet)).collect();
        order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        order.into_iter().map(|(_, facet)| facet).collect()
    }
}

fn first_corner(surface: &Surface, face: u32) -> u32 {
    let place = |k: u32| [surface.points()[surface.origin(3 * face + k) as usize]];
    (1..3).fold(0, |first, k| if by_places(&place(k), &place(first)) == Ordering::Less { k } else { first })
}

fn by_places(a: &[Vector3<f64>], b: &[Vector3<f64>]) -> Ordering {
    let values = |places: &[Vector3<f64>]| places.iter().flat_map(|p| [p.x, p.y, p.z]).collect::<Vec<f64>>();
    let (a, b) = (values(a), values(b));
    a.iter().zip(&b).map(|(x, y)| x.total_cmp(y)).find(|order| order.is_ne()).unwrap_or(Ordering::Equal)
}
