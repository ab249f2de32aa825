//! A group of surfaces with the same triangles, combined into the distances and shapes of one.
//!
//! For surfaces k with weights w_k and distances δ_k, all scaled to the same area, the distance with the least
//! Σ w_k |d − δ_k|/δ_k is, for log-normal δ_k, the one with 1/d² = Σ w_k/δ_k² (docs/decisions/0051). The same holds for
//! lengths in every direction of a triangle, where the inverses of its metrics take the place of 1/δ². So a group needs
//! the memory of one surface, however many there are.

use nalgebra::{Matrix2, Vector3};

use super::levels::{self, Levels};
use crate::geodesic::Solver;
use crate::geodesic::bend::{MarkedRows, Marking, is_bent, marked};
use crate::geodesic::graph::GeodesicGraph;
use crate::rows::DistanceRows;
use crate::surface::Surface;
use crate::{Control, Error, Result};

/// The height of a triangle, as a share of its longest side, below which it is too thin for its metric to count.
const THINNEST: f64 = 1e-2;

/// The memory per vertex of a group in bytes: the triangles of all levels, and their sums, take 3/2 of 2 × (12 + 24).
const VERTEX_BYTES: u64 = 108;

/// Returns the memory in bytes that a group needs beside the map of its mean: its sums, and one surface with its links
/// and rows at a time.
pub fn memory_need(points: usize, sources: usize) -> u64 {
    let pairs = (levels::most_evaluated(points, sources) * sources) as u64;
    (16 + 4) * pairs + VERTEX_BYTES * points as u64 + Surface::memory_need(points) + GeodesicGraph::size(points)
}

/// Sums over the surfaces of a group.
#[derive(Debug)]
pub struct Group {
    landmarks: Vec<u32>,
    /// The vertices at which distances are compared.
    evaluated: Vec<u32>,
    /// The vertices and triangles of every level.
    levels: Vec<(Vec<u32>, Vec<[u32; 3]>)>,
    weight: f64,
    /// Of the square roots of areas.
    size: f64,
    /// Of inverse squares of distances, and of the weights of those that bend around the boundary.
    distances: Vec<f64>,
    bent: Vec<f64>,
    /// Of the inverses of the metrics of each level's triangles: their entries 11, 12, 22.
    metrics: Vec<Vec<[f64; 3]>>,
}

/// The shapes of a group's triangles.
#[derive(Debug)]
pub(super) struct Shapes {
    pub(super) area: f64,
    /// The two sides of the triangles of each level.
    sides: Vec<Vec<[[f64; 2]; 2]>>,
}

impl Shapes {
    /// Returns the positions of a triangle's corners, up to a motion.
    pub(super) fn corners(&self, depth: usize, number: usize) -> [Vector3<f64>; 3] {
        let [b, c] = self.sides[depth][number].map(|[x, y]| Vector3::new(x, y, 0.0));
        [Vector3::zeros(), b, c]
    }
}

impl Group {
    /// Creates an empty group, whose surfaces have the triangles of the levels.
    pub fn new(levels: &Levels) -> Self {
        let depths = 0..=levels.coarser.len();
        let of_depth = |depth: usize| (levels.vertices[depth].clone(), levels.surface(depth).faces().to_vec());
        let all: Vec<(Vec<u32>, Vec<[u32; 3]>)> = depths.map(of_depth).collect();
        let pairs = levels.landmarks().len() * levels.evaluated().len();
        let metrics = all.iter().map(|(_, faces)| vec![[0.0; 3]; faces.len()]).collect();
        let (landmarks, evaluated) = (levels.landmarks().to_vec(), levels.evaluated().to_vec());
        let (distances, bent) = (vec![0.0; pairs], vec![0.0; pairs]);
        Self { landmarks, evaluated, levels: all, weight: 0.0, size: 0.0, distances, bent, metrics }
    }

    /// Adds a surface, with its distances by any solver.
    ///
    /// # Errors
    /// [`Error::ForeignRows`] if the surface does not have the triangles of the group, and those of the solver.
    pub fn add<S: Solver>(
        &mut self, surface: &Surface, marking: &Marking<S>, weight: f64, control: &Control,
    ) -> Result<()> {
        if surface.faces() != self.levels[0].1 {
            return Err(Error::ForeignRows);
        }
        let rows = MarkedRows::compute_to(marking, &self.landmarks, &self.evaluated, control)?.into_rows().into_data();
        let size = surface.area().sqrt();
        self.weight += weight;
        self.size += weight * size;
        for ((sum, bent), distance) in self.distances.iter_mut().zip(&mut self.bent).zip(rows) {
            *sum += weight * (size / f64::from(distance)).powi(2);
            *bent += if is_bent(distance) { weight } else { 0.0 };
        }
        for ((vertices, faces), metrics) in self.levels.iter().zip(&mut self.metrics) {
            for (face, sum) in faces.iter().zip(metrics) {
                let [a, b, c] = face.map(|vertex| surface.points()[vertices[vertex as usize] as usize]);
                let (b, c) = ((b - a) / size, (c - a) / size);
                let [e, f, g] = [b.dot(&b), b.dot(&c), c.dot(&c)];
                let longest = e.max(g).max(e + g - 2.0 * f);
                let square = (e * g - f * f).max((THINNEST * longest).powi(2)).max(f64::MIN_POSITIVE);
                for (sum, entry) in sum.iter_mut().zip([g, -f, e]) {
                    *sum += weight * entry / square;
                }
            }
        }
        Ok(())
    }

    /// Returns the distances of the group between the levels' vertices, and gives the levels its shapes.
    ///
    /// # Errors
    /// [`Error::ForeignRows`] if the group was made for other levels, or is empty.
    pub fn combine(&self, levels: &mut Levels) -> Result<MarkedRows> {
        let are_own = self.landmarks == levels.landmarks()
            && self.levels.iter().map(|(vertices, _)| vertices).eq(&levels.vertices);
        if !are_own || self.weight <= 0.0 {
            return Err(Error::ForeignRows);
        }
        let size = self.size / self.weight;
        let sides = |&[e, f, g]: &[f64; 3]| {
            let metric = Matrix2::new(e, f, f, g).try_inverse().unwrap_or_default() * self.weight * size * size;
            let length = metric.m11.sqrt().max(f64::MIN_POSITIVE);
            [[length, 0.0], [metric.m12 / length, metric.determinant().max(0.0).sqrt() / length]]
        };
        let sides: Vec<Vec<[[f64; 2]; 2]>> =
            self.metrics.iter().map(|metrics| metrics.iter().map(sides).collect()).collect();
        let area = sides[0].iter().map(|[b, c]| 0.5 * b[0] * c[1]).sum();
        levels.shapes = Some(Shapes { area, sides });
        let combined =
            |(&sum, &bent): (&f64, &f64)| marked((size * (self.weight / sum).sqrt()) as f32, 2.0 * bent > self.weight);
        let rows = self.distances.iter().zip(&self.bent).map(combined).collect();
        Ok(MarkedRows::new(DistanceRows::new(levels.numbers(), self.evaluated.len(), rows)))
    }
}
