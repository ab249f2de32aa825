//! Surface voxels as the vertices of a manifold, without an iso-surface.
//!
//! A *node* is a surface voxel seen from one side: a connected set of its surfels. The nodes around each point where
//! surfels meet (`Surfels::around_points`) form a polygon, which is a face. The mesh is thus the dual of the surfel
//! surface, with the surfels of each node contracted to one vertex. This preserves the topology if the surfels of each
//! node form a disk and the polygons form a simplicial complex. A voxel that carries several layers violates this; its
//! node is split into its surfels, for which it always holds.

use std::collections::HashSet;

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::surface::mesh::{BORDER, Surface};
use crate::surface::voxels::surfels::Surfels;
use crate::{Control, Error, Result};

/// The assignment of surfels to nodes.
#[derive(Debug, Clone)]
pub(crate) struct Nodes {
    /// The node of each surfel.
    pub of_surfel: Vec<u32>,
    /// The surface voxel of each node.
    pub voxel: Vec<u32>,
    /// The number of nodes that were added by splitting nodes with several layers.
    pub split: usize,
}

/// The polygons around the points where surfels meet, one after the other.
#[derive(Debug, Default)]
struct Polygons {
    corners: Vec<u32>,
    ends: Vec<u32>,
}

impl Polygons {
    fn iter(&self) -> impl Iterator<Item = &[u32]> {
        let starts = std::iter::once(0).chain(self.ends.iter().copied());
        starts.zip(&self.ends).map(|(start, &end)| &self.corners[start as usize..end as usize])
    }
}

impl Nodes {
    /// Returns the nodes of closed surfels, split until their polygons are a manifold, and the triangles. `place`
    /// returns the positions of nodes (mm), by which diagonals are chosen. It is called for the final nodes, and before
    /// only for the centres of surfels.
    pub(crate) fn triangulate(
        surfels: &Surfels, centres: &[Vector3<f64>], place: impl FnOnce(&Self) -> Result<Vec<Vector3<f64>>>,
        control: &Control,
    ) -> Result<(Self, Surface)> {
        let mut apart = not_a_disk(surfels);
        let whole = Self::group(surfels, |_| false).voxel.len();
        loop {
            control.check()?;
            let mut nodes = Self::group(surfels, |s| apart[s as usize]);
            let polygons = nodes.polygons(surfels);
            let rough = nodes.means(centres);
            let (faces, unlucky) = triangles(&polygons, &rough);
            let defects = nodes.defects(&polygons, &faces, unlucky, surfels);
            let is_final = defects.is_empty() || !nodes.mark(&defects, &mut apart);
            if is_final {
                nodes.split = nodes.voxel.len() - whole;
                let points = place(&nodes)?;
                let (better, unlucky) = triangles(&polygons, &points);
                let faces = if unlucky.is_empty() { better } else { faces };
                let surface = join(&points, &faces)?;
                return Ok((nodes, surface));
            }
        }
    }

    /// Groups the connected surfels of each voxel into a node; surfels marked `apart` get one node each.
    fn group(surfels: &Surfels, apart: impl Fn(u32) -> bool) -> Self {
        const NONE: u32 = u32::MAX;
        let mut nodes = Self { of_surfel: vec![NONE; surfels.len()], voxel: Vec::new(), split: 0 };
        let mut stack = Vec::with_capacity(6);
        for start in 0..surfels.len() as u32 {
            if nodes.of_surfel[start as usize] != NONE {
                continue;
            }
            let voxel = surfels.voxel(start);
            let node = nodes.voxel.len() as u32;
            nodes.voxel.push(voxel);
            nodes.of_surfel[start as usize] = node;
            stack.push(start);
            while let Some(surfel) = stack.pop().filter(|&s| !apart(s)) {
                for neighbour in surfels.neighbours(surfel).into_iter().flatten() {
                    let known = &mut nodes.of_surfel[neighbour as usize];
                    if *known == NONE && surfels.voxel(neighbour) == voxel {
                        *known = node;
                        stack.push(neighbour);
                    }
                }
            }
            stack.clear();
        }
        nodes
    }

    /// Returns the cyclic list of different nodes around each point with at least three nodes.
    fn polygons(&self, surfels: &Surfels) -> Polygons {
        let mut polygons = Polygons::default();
        let mut ring = Vec::new();
        surfels.around_points(|around| {
            ring.clear();
            ring.extend(around.iter().map(|&s| self.of_surfel[s as usize]));
            ring.dedup();
            while ring.len() > 1 && ring.first() == ring.last() {
                ring.pop();
            }
            if ring.len() > 2 {
                polygons.corners.extend_from_slice(&ring);
                polygons.ends.push(polygons.corners.len() as u32);
            }
        });
        polygons
    }

    /// Returns the mean of the surfels' values in each node.
    pub(crate) fn means(&self, values: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
        let mut sums = vec![(Vector3::zeros(), 0.0); self.voxel.len()];
        for (&node, value) in self.of_surfel.iter().zip(values) {
            let (sum, count) = &mut sums[node as usize];
            *sum += value;
            *count += 1.0;
        }
        sums.into_iter().map(|(sum, count)| sum / count).collect()
    }

    /// Returns nodes whose faces are not a manifold: polygons that pass them twice, edges of more than two faces,
    /// vertices with several fans or without faces.
    fn defects(&self, polygons: &Polygons, faces: &[[u32; 3]], mut found: Vec<u32>, surfels: &Surfels) -> Vec<u32> {
        found.extend(polygons.iter().flat_map(repeated));
        let mut edges: Vec<[u32; 2]> = faces.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]).collect();
        edges.par_sort_unstable();
        found.extend(edges.windows(2).filter(|two| two[0] == two[1]).flat_map(|two| two[0]));
        if found.is_empty() {
            let twins = twins_of(faces);
            let loose = Surface::fans_of(faces, &twins, self.voxel.len());
            let at_border = |node: u32| {
                // on a surface with a boundary, nodes there may have no face
                let mine = surfels.of_voxel(self.voxel[node as usize]).filter(|&s| self.of_surfel[s as usize] == node);
                mine.flat_map(|s| surfels.neighbours(s)).any(|neighbour| neighbour.is_none())
            };
            let wrong = |&node: &u32| loose[node as usize] != 1 && !at_border(node);
            found.extend((0..self.voxel.len() as u32).filter(wrong));
        }
        found
    }

    /// Marks the surfels of these nodes as apart; returns `false` if all of them were marked already.
    fn mark(&self, defects: &[u32], apart: &mut [bool]) -> bool {
        let wrong: HashSet<u32> = defects.iter().copied().collect();
        let mut is_new = false;
        for (surfel, node) in self.of_surfel.iter().enumerate() {
            if wrong.contains(node) {
                is_new |= !apart[surfel];
                apart[surfel] = true;
            }
        }
        is_new
    }
}

/// Returns the surfels of nodes that do not form a disk, such as the four around a rod or the six of an isolated voxel:
/// χ = surfels − inner edges + inner points is not 1.
fn not_a_disk(surfels: &Surfels) -> Vec<bool> {
    let nodes = Nodes::group(surfels, |_| false);
    let mut euler = vec![0i32; nodes.voxel.len()];
    for surfel in 0..surfels.len() as u32 {
        let node = nodes.of_surfel[surfel as usize];
        euler[node as usize] += 2; // doubled, because each inner edge is seen from both sides
        for neighbour in surfels.neighbours(surfel).into_iter().flatten() {
            euler[node as usize] -= i32::from(nodes.of_surfel[neighbour as usize] == node);
        }
    }
    surfels.around_points(|ring| {
        let node = nodes.of_surfel[ring[0] as usize];
        if ring.iter().all(|&s| nodes.of_surfel[s as usize] == node) {
            euler[node as usize] += 2;
        }
    });
    nodes.of_surfel.iter().map(|&node| euler[node as usize] != 2).collect()
}

/// Returns the nodes that a polygon passes more than once.
fn repeated(polygon: &[u32]) -> Vec<u32> {
    let again = |(n, node): (usize, &u32)| polygon[..n].contains(node).then_some(*node);
    polygon.iter().enumerate().filter_map(again).collect()
}

/// Divides polygons into triangles by the fan with the shortest longest diagonal, among fans whose diagonals are not
/// edges yet. Also returns the corners of polygons without such a fan.
fn triangles(polygons: &Polygons, points: &[Vector3<f64>]) -> (Vec<[u32; 3]>, Vec<u32>) {
    let key = |a: u32, b: u32| u64::from(a.min(b)) << 32 | u64::from(a.max(b));
    let mut sides = Vec::with_capacity(polygons.corners.len());
    for polygon in polygons.iter() {
        let n = polygon.len();
        sides.extend((0..n).map(|i| key(polygon[i], polygon[(i + 1) % n])));
    }
    sides.par_sort_unstable();
    let mut diagonals = HashSet::new();
    let (mut faces, mut unlucky) = (Vec::new(), Vec::new());
    for polygon in polygons.iter() {
        let n = polygon.len();
        let corner = |apex: usize, k: usize| polygon[(apex + k) % n];
        let longest = |apex: usize| {
            let place = |k| points[corner(apex, k) as usize];
            (2..n - 1).map(|k| (place(k) - place(0)).norm_squared()).fold(0.0, f64::max)
        };
        let is_new = |edge: u64| sides.binary_search(&edge).is_err() && !diagonals.contains(&edge);
        let is_free = |&apex: &usize| (2..n - 1).all(|k| is_new(key(corner(apex, 0), corner(apex, k))));
        let best = (0..n).filter(is_free).map(|apex| (longest(apex), apex)).min_by(|a, b| a.0.total_cmp(&b.0));
        let apex = best.map_or(0, |(_, apex)| apex);
        if best.is_none() {
            unlucky.extend_from_slice(polygon);
        }
        diagonals.extend((2..n - 1).map(|k| key(corner(apex, 0), corner(apex, k))));
        faces.extend((1..n - 1).map(|k| [corner(apex, 0), corner(apex, k), corner(apex, k + 1)]));
    }
    (faces, unlucky)
}

fn twins_of(faces: &[[u32; 3]]) -> Vec<u32> {
    let ends = |face: &[u32; 3]| [(face[0], face[1]), (face[1], face[2]), (face[2], face[0])];
    let mut keyed: Vec<((u32, u32), u32)> =
        faces.iter().flat_map(ends).zip(0..).map(|((a, b), h)| ((a.min(b), a.max(b)), h)).collect();
    keyed.par_sort_unstable();
    let mut twins = vec![BORDER; keyed.len()];
    for two in keyed.windows(2).filter(|two| two[0].0 == two[1].0) {
        let (g, h) = (two[0].1, two[1].1);
        (twins[g as usize], twins[h as usize]) = (h, g);
    }
    twins
}

/// Returns the surface of consistently oriented triangles. Drops unused vertices, and splits several fans at a
/// boundary.
fn join(points: &[Vector3<f64>], faces: &[[u32; 3]]) -> Result<Surface> {
    let ids: Vec<u32> = (0..points.len() as u32).collect();
    if faces.is_empty() {
        return Err(Error::NoFaces { points: points.len() });
    }
    Ok(Surface::assemble(points, &ids, faces, twins_of(faces)))
}
