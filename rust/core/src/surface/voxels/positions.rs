//! Vertex positions that are finer than the voxel grid.
//!
//! Nodes start at the mean of their surfels' centres. A height z = a + b u + c v + d u² + e u v + f v² over the tangent
//! plane is fitted twice to the surrounding nodes, with higher weights for nearer ones. The first, wide fit gives
//! normals. The second, narrow fit gives the height a by which the node moves along its normal. Fitting smooths out the
//! steps of the grid, which make distances too long, but it shrinks folds, as do chords between nodes, which makes
//! distances too short. Nodes that stick out of the mean of their neighbours are therefore finally moved further
//! outwards (docs/decisions/0006).
//!
//! With an intensity or a probability image, the surface is where it has a given value, which is better than a fit.

use nalgebra::{Matrix6, Vector3, Vector6};
use rayon::prelude::*;

use crate::adjacency::starts_of;
use crate::{Control, Result};

/// The neighbours of each node, in compressed rows.
#[derive(Debug, Clone, Default)]
pub struct Neighbours {
    starts: Vec<u32>,
    to: Vec<u32>,
}

impl Neighbours {
    /// Creates it from pairs, which may be repeated and in any order.
    pub fn from_pairs(nodes: usize, pairs: &[[u32; 2]]) -> Self {
        let apart = || pairs.iter().filter(|[a, b]| a != b);
        let first = starts_of(nodes, apart().copied().flatten());
        let mut next = first.clone();
        let mut repeated = vec![0; first[nodes] as usize];
        for &[a, b] in apart() {
            for [from, to] in [[a, b], [b, a]] {
                repeated[next[from as usize] as usize] = to;
                next[from as usize] += 1;
            }
        }
        let mut starts = Vec::with_capacity(nodes + 1);
        let mut to: Vec<u32> = Vec::with_capacity(repeated.len() / 2);
        for node in 0..nodes {
            let beside = &mut repeated[first[node] as usize..first[node + 1] as usize];
            beside.sort_unstable();
            starts.push(to.len() as u32);
            let mut last = None;
            for &other in beside.iter() {
                if last.replace(other) != Some(other) {
                    to.push(other);
                }
            }
        }
        starts.push(to.len() as u32);
        Self { starts, to }
    }

    pub fn of(&self, node: u32) -> &[u32] {
        &self.to[self.starts[node as usize] as usize..self.starts[node as usize + 1] as usize]
    }
}

/// A fit of heights. Lengths are in units of the largest spacing.
#[derive(Debug, Clone, Copy)]
struct Fit {
    /// The width of the Gaussian weight.
    sigma: f64,
    reach: f64,
    /// Nodes whose normals have a smaller product lie on another bank.
    same_side: f64,
    /// A ridge that keeps curvature small where few nodes determine it.
    ridge: f64,
}

const FOR_NORMALS: Fit = Fit { sigma: 1.5, reach: 4.0, same_side: 0.2, ridge: 0.05 };
const FOR_HEIGHTS: Fit = Fit { sigma: 1.0, reach: 3.0, same_side: 0.0, ridge: 0.02 };

/// The distance below which neighbours count as coincident, in units of the smallest spacing.
const CLOSEST: f64 = 0.01;

/// The number of nodes in a step of the progress.
const CHUNK: u32 = 1024;

/// The number of steps of one fit, which are counted as done.
pub fn steps(nodes: usize) -> u64 {
    2 * nodes.div_ceil(CHUNK as usize) as u64
}

/// The number of times that normals are averaged with their neighbours' before the first fit.
const AVERAGED: usize = 4;

/// Nodes with their normals, in mm along the volume's axes.
#[derive(Debug, Clone)]
pub struct Places {
    /// The positions of the nodes.
    pub points: Vec<Vector3<f64>>,
    /// Outward unit vectors.
    pub normals: Vec<Vector3<f64>>,
}

/// Fits the surface through nodes at `base` (mm along the axes) with approximate normals `outward`.
pub fn fit(
    base: &[Vector3<f64>], outward: Vec<Vector3<f64>>, neighbours: &Neighbours, spacing: [f64; 3], control: &Control,
) -> Result<Places> {
    let unit = spacing.into_iter().fold(0.0, f64::max);
    let finest = spacing.into_iter().fold(unit, f64::min);
    let scaled: Vec<Vector3<f64>> = base.iter().map(|p| p / unit).collect();
    let mut normals = averaged(outward, neighbours);
    for (pass, fit) in [FOR_NORMALS, FOR_HEIGHTS].into_iter().enumerate() {
        let fitted: Vec<(f64, Vector3<f64>)> = (0..base.len() as u32)
            .into_par_iter()
            .map_init(
                || Around::new(base.len()),
                |around, node| {
                    if node.is_multiple_of(CHUNK) {
                        control.check()?;
                        control.advance();
                    }
                    around.collect(node, &scaled, neighbours, fit.reach, unit / finest);
                    Ok(fit.height(node, &around.nodes, &scaled, &normals))
                },
            )
            .collect::<Result<_>>()?;
        if pass == 0 {
            normals = fitted.into_iter().map(|(_, normal)| normal).collect();
        } else {
            let points = fitted.iter().zip(&normals).zip(base).map(|(((height, _), normal), base)| {
                let most = reach(normal, spacing);
                base + normal * (height * unit).clamp(-most, most)
            });
            let points = points.collect();
            return Ok(Places { points, normals: fitted.into_iter().map(|(_, normal)| normal).collect() });
        }
    }
    unreachable!("the second pass returns")
}

/// Returns the distance in mm along a direction until it has advanced by a complete voxel along one axis.
fn reach(direction: &Vector3<f64>, spacing: [f64; 3]) -> f64 {
    (0..3).map(|axis| spacing[axis] / direction[axis].abs()).fold(f64::INFINITY, f64::min)
}

/// Returns the width of a voxel along a direction in mm.
pub fn width(direction: &Vector3<f64>, spacing: [f64; 3]) -> f64 {
    (0..3).map(|axis| direction[axis].abs() * spacing[axis]).sum()
}

impl Places {
    /// Moves nodes back towards their `base`, until they are within half a voxel of it along each axis.
    pub fn within_half_a_voxel(&mut self, base: &[Vector3<f64>], spacing: [f64; 3]) {
        for (point, base) in self.points.iter_mut().zip(base) {
            let moved = *point - base;
            *point = base + moved * (0.5 * reach(&moved, spacing)).min(1.0);
        }
    }

    /// Moves each node along its normal away from the mean of its neighbours on the same side, by `share` of the
    /// distance, and by at most a quarter of a voxel. On a blade one voxel thick, more would produce spikes.
    ///
    /// A chord of length h of a curve with curvature κ is too short by κ²h²/24 of itself; moving the curve outwards by
    /// κh²/24 makes chords as long as the arcs were. Neighbours at distance h have their mean (κ₁ + κ₂)h²/4 below the
    /// node, so that chords require from a twelfth (κ₁ = κ₂) to a sixth (κ₂ = 0) of this. Values that are means over
    /// voxels with side a, which have variance a²/12 along each axis, shift their level by (κ₁ + κ₂)a²/24, another
    /// ninth if h² = 3a²/2. Fits through the steps of a label smooth folds, and require more than both.
    pub fn sharpen(&mut self, share: f64, neighbours: &Neighbours, spacing: [f64; 3]) {
        let moved = |node: usize| {
            let (point, normal) = (self.points[node], self.normals[node]);
            let is_beside = |other: &u32| self.normals[*other as usize].dot(&normal) > FOR_HEIGHTS.same_side;
            let heights = neighbours.of(node as u32).iter().filter(|other| is_beside(other));
            let heights = heights.map(|&other| (self.points[other as usize] - point).dot(&normal));
            let (sum, count) = heights.fold((0.0, 0.0), |(sum, count), height| (sum + height, count + 1.0));
            let most = 0.25 * reach(&normal, spacing);
            point - normal * (share * sum / f64::max(count, 1.0)).clamp(-most, most)
        };
        self.points = (0..self.points.len()).into_par_iter().map(moved).collect();
    }
}

impl Places {
    /// Moves coincident neighbours apart, each towards its `own` position as far as necessary. Nodes of one voxel share
    /// its centre, and fits can move nodes of several voxels to the same position.
    pub fn set_apart(&mut self, own: &[Vector3<f64>], neighbours: &Neighbours, spacing: [f64; 3]) {
        let least = CLOSEST * spacing.into_iter().fold(f64::INFINITY, f64::min);
        for share in [0.25, 0.5, 1.0] {
            let points = &self.points;
            let is_close = |&node: &u32| {
                let near = |&other: &u32| (points[other as usize] - points[node as usize]).norm() < least;
                neighbours.of(node).iter().any(near)
            };
            let close: Vec<u32> = (0..points.len() as u32).filter(is_close).collect();
            for node in close {
                let point = &mut self.points[node as usize];
                *point += (own[node as usize] - *point) * share;
            }
        }
    }
}

fn averaged(mut normals: Vec<Vector3<f64>>, neighbours: &Neighbours) -> Vec<Vector3<f64>> {
    for _ in 0..AVERAGED {
        let mean = |node: usize| {
            let around: Vector3<f64> = neighbours.of(node as u32).iter().map(|&n| normals[n as usize]).sum();
            (normals[node] + around).try_normalize(1e-9).unwrap_or(normals[node])
        };
        normals = (0..normals.len()).into_par_iter().map(mean).collect();
    }
    normals
}

/// The nodes around a node, reached over the surface.
#[derive(Debug)]
struct Around {
    seen: Vec<u32>,
    nodes: Vec<u32>,
}

impl Around {
    fn new(nodes: usize) -> Self {
        Self { seen: vec![u32::MAX; nodes], nodes: Vec::new() }
    }

    /// Collects `centre` and the nodes within `reach` of it that are reached in a few steps within this radius.
    fn collect(&mut self, centre: u32, points: &[Vector3<f64>], neighbours: &Neighbours, reach: f64, anisotropy: f64) {
        let steps = (1.5 * reach * anisotropy).ceil() as usize;
        self.nodes.clear();
        self.nodes.push(centre);
        self.seen[centre as usize] = centre;
        let mut done = 0;
        for _ in 0..steps {
            let end = self.nodes.len();
            for at in done..end {
                for &next in neighbours.of(self.nodes[at]) {
                    let apart = points[next as usize] - points[centre as usize];
                    if self.seen[next as usize] != centre && apart.norm_squared() <= reach * reach {
                        self.seen[next as usize] = centre;
                        self.nodes.push(next);
                    }
                }
            }
            if self.nodes.len() == end {
                break;
            }
            done = end;
        }
    }
}

/// The powers of u and v in the terms of a height.
const POWERS: [[usize; 2]; 6] = [[0, 0], [1, 0], [0, 1], [2, 0], [1, 1], [0, 2]];

/// The steepest slope that is accepted.
const STEEPEST: f64 = 2.0;

impl Fit {
    /// Returns the height of the fitted surface over a node, and its normal there.
    fn height(
        self, node: u32, around: &[u32], points: &[Vector3<f64>], normals: &[Vector3<f64>],
    ) -> (f64, Vector3<f64>) {
        let (origin, normal) = (points[node as usize], normals[node as usize]);
        let across = if normal.x.abs() < 0.7 { Vector3::x() } else { Vector3::y() };
        let Some(first) = normal.cross(&across).try_normalize(1e-9) else { return (0.0, normal) };
        let second = normal.cross(&first);
        let mut moments = [0.0; 15]; // weighted sums of powers of u and v, by degree, then by the power of v
        let mut right = Vector6::zeros();
        let mut count = 0;
        for &other in around {
            if normals[other as usize].dot(&normal) < self.same_side {
                continue;
            }
            count += 1;
            let apart = points[other as usize] - origin;
            let (u, v, height) = (apart.dot(&first), apart.dot(&second), apart.dot(&normal));
            // moving least squares with a Gaussian weight (Levin 1998)
            let weight = (-0.5 * apart.norm_squared() / (self.sigma * self.sigma)).exp();
            let (uu, uv, vv) = (u * u, u * v, v * v);
            let powers =
                [1.0, u, v, uu, uv, vv, uu * u, uu * v, u * vv, vv * v, uu * uu, uu * uv, uu * vv, uv * vv, vv * vv];
            moments.iter_mut().zip(powers).for_each(|(sum, power)| *sum += weight * power);
            for k in 0..6 {
                right[k] += weight * height * powers[k];
            }
        }
        let moment = |[a, b]: [usize; 2], [c, d]: [usize; 2]| {
            let degree = a + b + c + d;
            // powers of one degree follow those of lower degrees: d (d + 1)/2 come before
            moments[degree * (degree + 1) / 2 + b + d]
        };
        let mut matrix = Matrix6::from_fn(|i, j| moment(POWERS[i], POWERS[j]));
        for k in 0..6 {
            // a ridge on curvature; one on height and slope only makes the matrix definite
            matrix[(k, k)] += if k < 3 { 1e-6 } else { self.ridge };
        }
        // six unknowns need more than six nodes
        if count < 7 {
            return (0.0, normal);
        }
        match matrix.cholesky() {
            Some(factor) => {
                let found = factor.solve(&right);
                let [b, c] = [found[1], found[2]].map(|slope| slope.clamp(-STEEPEST, STEEPEST));
                // (−b, −c, 1) in the frame of the tangent plane is normal to the fit at the node
                (found[0], (normal - first * b - second * c).normalize())
            }
            None => (0.0, normal),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_are_sorted_and_distinct() {
        let neighbours = Neighbours::from_pairs(4, &[[2, 0], [0, 1], [1, 0], [3, 3], [0, 2]]);
        assert_eq!([0, 1, 2, 3].map(|node| neighbours.of(node)), [&[1, 2][..], &[0], &[0], &[]]);
    }

    #[test]
    fn nodes_stay_within_half_a_voxel() {
        let base = vec![Vector3::new(5.0, 5.0, 5.0); 3];
        let by = [Vector3::new(2.0, 0.4, -0.8), Vector3::new(0.1, -6.0, 3.0), Vector3::new(0.4, 0.9, -1.4)];
        let points = base.iter().zip(by).map(|(base, by)| base + by).collect();
        let mut places = Places { points, normals: vec![Vector3::z(); 3] };
        places.within_half_a_voxel(&base, [1.0, 2.0, 3.0]);
        let expected = [Vector3::new(0.5, 0.1, -0.2), Vector3::new(1.0 / 60.0, -1.0, 0.5), by[2]];
        for ((point, base), expected) in places.points.iter().zip(&base).zip(expected) {
            assert!((point - base - expected).norm() < 1e-12, "{point}");
        }
    }

    #[test]
    fn a_ridge_is_sharpened_by_its_share_and_at_most_a_quarter_of_a_voxel() {
        let neighbours = Neighbours::from_pairs(4, &[[0, 1], [0, 2], [0, 3]]);
        for (below, share, expected) in [(0.8, 0.25, 0.2), (0.8, 0.5, 0.4), (0.8, 1.0, 0.5), (-3.0, 1.0, -0.5)] {
            let points =
                vec![Vector3::zeros(), Vector3::new(1.0, 0.0, -below), Vector3::new(-1.0, 0.0, -below), Vector3::y()];
            let normals = vec![Vector3::z(), Vector3::z(), Vector3::z(), -Vector3::z()]; // the last is on another bank
            let mut places = Places { points, normals };
            places.sharpen(share, &neighbours, [1.0, 1.0, 2.0]);
            assert!((places.points[0] - Vector3::z() * expected).norm() < 1e-12, "{}", places.points[0]);
        }
    }
}
