//! The stress of a map: the deviation of its distances from those on the surface.
//!
//! Over pairs of a landmark and a vertex with geodesic distance δ and flat distance d, r = (d − δ)/δ, the stress is
//!
//!   Σ_b a_b · mean over the pairs of band b of ρ(r),   ρ(r) = 2κ² (√(1 + r²/κ²) − 1)
//!
//! for the bands of all pairs, of near pairs, and of nearer ones. ρ is r² for small errors; κ is the error above which
//! it grows only like |r| (pseudo-Huber), so that a few distances that no map can preserve do not dominate it.
//!
//! A path that [bends around the boundary](crate::geodesic::bend) is an upper bound for the distance in the plane:
//! r = max(0, (d − δ)/δ). So the map of a flat sheet is exact, whatever its outline.

use crate::embed::Place;
use nalgebra::{Matrix2, Vector2};
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use crate::adjacency::marked;
use crate::geodesic::bend::is_bent;
use crate::rows::DistanceRows;
use crate::{Control, Result};

/// The number of vertices that are visited together.
const BATCH: usize = 256;

/// The number of landmarks that are visited together, in the processor's registers.
const LANES: usize = 16;

/// Nearer pairs are ignored (as a share of the farthest pair), because their relative error is meaningless.
const NEAREST: f32 = 4e-6;

/// A lower limit of flat distances, as a share of the nearest pair that counts.
const APART: f32 = 1e-6;

/// The share of the pairs' curvature, along and across together, that springs put on a vertex. The other vertex of a
/// pair may move with it, and in the motions that remain to the end, most do (docs/decisions/0033).
const HELD: f64 = 1.0 / 16.0;

/// The upper ends of the bands, in square roots of the surface's area: maps do not depend on its unit. On a human
/// hemisphere, they are about 30 and 10 mm.
const BANDS: [f32; 3] = [f32::INFINITY, NEAR, NEAR / 3.0];
const NEAR: f32 = 0.11;

/// The weights of the bands, and the relative error above which outliers count less.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bands {
    /// a_b, of all pairs, of near pairs, and of nearer ones.
    pub weights: [f64; 3],
    /// κ of far pairs, and of near ones; infinity for plain squares.
    pub outliers: [f64; 2],
}

/// Distances from landmarks to vertices.
#[derive(Debug)]
pub struct Pairs {
    landmarks: Vec<u32>,
    vertices: Vec<u32>,
    /// One row per vertex in mm, padded with zeros to complete lanes.
    table: Vec<f32>,
    width: usize,
    /// The upper ends of the bands in mm, and the number of pairs of each.
    pub(super) ends: [f32; 3],
    counts: [usize; 3],
    /// Nearer pairs are ignored, mm.
    nearest: f32,
}

impl Pairs {
    /// Creates pairs from marked distance rows; their sources and columns are indices into `vertices`. `area` is that of
    /// the surface.
    pub fn new(rows: &DistanceRows, vertices: &[u32], area: f64, control: &Control) -> Result<Self> {
        let landmarks: Vec<u32> = rows.sources().iter().map(|&number| vertices[number as usize]).collect();
        let width = landmarks.len().next_multiple_of(LANES);
        let mut table = vec![0.0; width * vertices.len()];
        for n in 0..landmarks.len() {
            control.check()?;
            table[n..].iter_mut().step_by(width).zip(rows.row(n)).for_each(|(to, &distance)| *to = distance);
        }
        let ends = BANDS.map(|end| end * area.sqrt() as f32);
        Ok(Self::of(landmarks, vertices.to_vec(), table, width, ends))
    }

    fn of(landmarks: Vec<u32>, vertices: Vec<u32>, table: Vec<f32>, width: usize, ends: [f32; 3]) -> Self {
        let nearest = NEAREST * table.par_iter().copied().reduce(|| 0.0, f32::max);
        let within = |end: f32| table.par_iter().filter(|&&distance| distance > nearest && distance <= end).count();
        let counts = ends.map(within);
        Self { landmarks, vertices, table, width, ends, counts, nearest }
    }

    /// Returns the pairs among some vertices, ascending and with all landmarks, by their numbers in this order.
    pub fn among(&self, vertices: &[u32]) -> Self {
        let number = |vertex: &u32| vertices.binary_search(vertex).ok().map(|number| number as u32);
        let rows = self.vertices.iter().zip(self.table.chunks_exact(self.width.max(1)));
        let kept: Vec<(u32, &[f32])> = rows.filter_map(|(vertex, row)| Some((number(vertex)?, row))).collect();
        let table = kept.iter().flat_map(|(_, row)| row.iter().copied()).collect();
        let numbers = kept.iter().map(|&(number, _)| number).collect();
        Self::of(self.landmarks.iter().filter_map(number).collect(), numbers, table, self.width, self.ends)
    }

    pub fn of_first(&self, landmarks: usize) -> Self {
        let landmarks = self.landmarks[..landmarks.min(self.landmarks.len())].to_vec();
        let width = landmarks.len().next_multiple_of(LANES);
        let mut table = vec![0.0; width * self.vertices.len()];
        for (to, from) in table.chunks_exact_mut(width.max(1)).zip(self.table.chunks_exact(self.width.max(1))) {
            to[..landmarks.len()].copy_from_slice(&from[..landmarks.len()]);
        }
        Self::of(landmarks, self.vertices.clone(), table, width, self.ends)
    }

    /// Returns the positions of the vertices by their distances to the landmarks (de Silva, Tenenbaum 2004): with X the
    /// landmarks' positions and μ the means of the squared distances among them, x = −½ X⁺ (δ² − μ) from the centre.
    /// Vertices without pairs lie at the centre.
    pub fn landmark_places(&self, places: &[[f64; 2]], vertices: usize) -> Vec<Place> {
        let count = places.len() as f64;
        let centre = places.iter().map(|&place| Vector2::from(place)).sum::<Place>() / count;
        let centred: Vec<Place> = places.iter().map(|&place| Vector2::from(place) - centre).collect();
        let gram: Matrix2<f64> = centred.iter().map(|place| place * place.transpose()).sum();
        let Some(inverse) = gram.try_inverse() else { return vec![centre; vertices] };
        let square = |distance: f32| f64::from(distance).powi(2);
        let mut means = vec![0.0; places.len()];
        let rows = || self.vertices.iter().zip(self.table.chunks_exact(self.width.max(1)));
        let is_landmark = marked(vertices, &self.landmarks);
        for (_, row) in rows().filter(|&(&vertex, _)| is_landmark[vertex as usize]) {
            means.iter_mut().zip(row).for_each(|(mean, &distance)| *mean += square(distance) / count);
        }
        let mut found = vec![centre; vertices];
        for (&vertex, row) in rows() {
            let terms = centred.iter().zip(&means).zip(row);
            let sum: Place = terms.map(|((place, mean), &distance)| place * (square(distance) - mean)).sum();
            found[vertex as usize] -= 0.5 * inverse * sum;
        }
        found
    }

    fn of_kernels(&self, bands: &Bands) -> Dials {
        let steps = [0, 1, 2].map(|band| (bands.weights[band] / self.counts[band].max(1) as f64) as f32);
        Dials {
            steps,
            ends: self.ends,
            nearest: self.nearest,
            sharp: bands.outliers.map(|outlier| outlier.recip() as f32),
        }
    }

    /// Returns the two coordinates of the landmarks, padded to complete lanes.
    fn places(&self, uv: &[Place]) -> [Vec<f32>; 2] {
        let mut places = [vec![0.0; self.width], vec![0.0; self.width]];
        for (n, &landmark) in self.landmarks.iter().enumerate() {
            let place = uv[landmark as usize];
            (places[0][n], places[1][n]) = (place.x as f32, place.y as f32);
        }
        places
    }

    /// Returns the stress, and adds its gradient to `gradient`.
    pub fn add(&self, uv: &[Place], bands: &Bands, gradient: &mut [Place], control: &Control) -> Result<f64> {
        Ok(self.add_all::<false>(uv, f32::NAN, bands, gradient, control)?.0)
    }

    /// Returns the stress of a map that repeats in the second direction, where distances are those to the nearest copy,
    /// and its derivative with respect to the period; adds its gradient to `gradient`.
    pub fn add_around(
        &self, uv: &[Place], period: f64, bands: &Bands, gradient: &mut [Place], control: &Control,
    ) -> Result<(f64, f64)> {
        self.add_all::<true>(uv, period as f32, bands, gradient, control)
    }

    fn add_all<const REPEATS: bool>(
        &self, uv: &[Place], period: f32, bands: &Bands, gradient: &mut [Place], control: &Control,
    ) -> Result<(f64, f64)> {
        let places = self.places(uv);
        let of_batch = |(vertices, table): (&[u32], &[f32])| {
            control.check()?;
            let sums = [vec![0.0f32; self.width], vec![0.0f32; self.width]];
            let batch = Batch { places: &places, uv, period, vertices, table, width: self.width, sums };
            Ok(Arch::new().dispatch(Stress::<REPEATS> { batch, dials: self.of_kernels(bands) }))
        };
        let batches = self.vertices.par_chunks(BATCH).zip(self.table.par_chunks((BATCH * self.width).max(1)));
        let parts: Vec<Found> = batches.map(of_batch).collect::<Result<_>>()?;
        let (mut energy, mut of_period) = (0.0, 0.0);
        for (part, vertices) in parts.iter().zip(self.vertices.chunks(BATCH)) {
            energy += part.energy;
            of_period += part.of_period;
            vertices.iter().zip(&part.of_vertices).for_each(|(&vertex, by)| gradient[vertex as usize] += by);
            for (n, &landmark) in self.landmarks.iter().enumerate() {
                gradient[landmark as usize] -= Vector2::new(part.of_landmarks[0][n], part.of_landmarks[1][n]).cast();
            }
        }
        Ok((energy, of_period))
    }

    /// Adds to `diagonal` the stiffness of springs that hold each vertex, from the positive curvature of the stress
    /// with respect to its own position. The curvature of a pair is ρ''/δ² along, and ρ'/(δ d) across.
    pub fn add_curvature(&self, uv: &[Place], bands: &Bands, diagonal: &mut [f64]) {
        self.add_all_curvature::<false>(uv, f32::NAN, bands, diagonal);
    }

    /// Like [`add_curvature`](Self::add_curvature), for a map that repeats in the second direction.
    pub fn add_curvature_around(&self, uv: &[Place], period: f64, bands: &Bands, diagonal: &mut [f64]) {
        self.add_all_curvature::<true>(uv, period as f32, bands, diagonal);
    }

    fn add_all_curvature<const REPEATS: bool>(&self, uv: &[Place], period: f32, bands: &Bands, diagonal: &mut [f64]) {
        let places = self.places(uv);
        let of_batch = |(vertices, table): (&[u32], &[f32])| {
            let sums = vec![0.0; self.width];
            let batch = Batch { places: &places, uv, period, vertices, table, width: self.width, sums };
            Arch::new().dispatch(Curvature::<REPEATS> { batch, dials: self.of_kernels(bands) })
        };
        let batches = self.vertices.par_chunks(BATCH).zip(self.table.par_chunks((BATCH * self.width).max(1)));
        let parts: Vec<(Vec<f64>, Vec<f64>)> = batches.map(of_batch).collect();
        for ((of_vertices, of_landmarks), vertices) in parts.iter().zip(self.vertices.chunks(BATCH)) {
            vertices.iter().zip(of_vertices).for_each(|(&vertex, bend)| diagonal[vertex as usize] += bend);
            self.landmarks.iter().zip(of_landmarks).for_each(|(&vertex, bend)| diagonal[vertex as usize] += bend);
        }
    }
}

#[inline(always)]
fn weight([all, near, nearer]: [f32; 3], ends: [f32; 3], distance: f32) -> f32 {
    let within = |end: f32, step: f32| if distance <= end { step } else { 0.0 };
    all + within(ends[1], near) + within(ends[2], nearer)
}

/// Returns the relative error of a distance, which is not negative if its path bends around the boundary.
#[inline(always)]
fn bounded(error: f32, distance: f32) -> f32 {
    if is_bent(distance) { error.max(0.0) } else { error }
}

struct Batch<'a, Sums> {
    places: &'a [Vec<f32>; 2],
    uv: &'a [Place],
    /// The period in the second direction, if the map repeats.
    period: f32,
    vertices: &'a [u32],
    table: &'a [f32],
    width: usize,
    /// Sums over the landmarks.
    sums: Sums,
}

#[derive(Clone, Copy)]
struct Dials {
    /// The weight of a pair by its distance, in steps, and where they end.
    steps: [f32; 3],
    ends: [f32; 3],
    nearest: f32,
    /// 1/κ.
    sharp: [f32; 2],
}

/// Returns how often a map repeats between two points, and their difference to the nearest copy.
#[inline(always)]
fn nearest_copy<const REPEATS: bool>(difference: f32, period: f32) -> (f32, f32) {
    let turns = if REPEATS { (difference / period).round_ties_even() } else { 0.0 };
    (turns, if REPEATS { difference - turns * period } else { difference })
}

/// The stress of a batch of vertices, its gradient by their positions, and its negative gradient by the landmarks'.
struct Found {
    energy: f64,
    /// The derivative with respect to the period.
    of_period: f64,
    of_vertices: Vec<Place>,
    of_landmarks: [Vec<f32>; 2],
}

struct Stress<'a, const REPEATS: bool> {
    batch: Batch<'a, [Vec<f32>; 2]>,
    dials: Dials,
}

impl<const REPEATS: bool> WithSimd for Stress<'_, REPEATS> {
    type Output = Found;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Found {
        let Batch { places, uv, period, vertices, table, width, mut sums } = self.batch;
        let of_vertices = Vec::with_capacity(vertices.len());
        let mut found = Found { energy: 0.0, of_period: 0.0, of_vertices, of_landmarks: Default::default() };
        let [sums_x, sums_y] = &mut sums;
        // local copies, or each of the lanes would load its own from memory
        let Dials { steps, ends, nearest, sharp: [far, near] } = self.dials;
        let apart = (APART * nearest) * (APART * nearest);
        for (&vertex, row) in vertices.iter().zip(table.chunks_exact(width.max(1))) {
            let place = uv[vertex as usize].cast::<f32>();
            let mut total = [[0.0f32; LANES]; 4];
            let lanes = row.chunks_exact(LANES).zip(places[0].chunks_exact(LANES).zip(places[1].chunks_exact(LANES)));
            let sums = sums_x.chunks_exact_mut(LANES).zip(sums_y.chunks_exact_mut(LANES));
            for ((row, (x, y)), (sum_x, sum_y)) in lanes.zip(sums) {
                for n in 0..LANES {
                    let delta = row[n];
                    let dx = place.x - x[n];
                    let (turns, dy) = nearest_copy::<REPEATS>(place.y - y[n], period);
                    // `apart` keeps the pull of coincident points finite
                    let flat = (dx * dx + dy * dy + apart).sqrt();
                    let inverse = if delta > nearest { delta.recip() } else { 0.0 };
                    let counts = if delta > nearest { weight(steps, ends, delta) } else { 0.0 };
                    let error = bounded(flat * inverse - 1.0, delta);
                    let outlying = error * if delta > ends[1] { far } else { near };
                    let root = (1.0 + outlying * outlying).sqrt();
                    // ρ = 2 r²/(1 + √(1 + r²/κ²)), without cancellation for small r
                    total[0][n] += counts * 2.0 * error * error / (root + 1.0);
                    // ∂ρ/∂d · ∂d/∂x = 2 r/(√(1 + r²/κ²) δ) · Δx/d
                    let pull = 2.0 * counts * error * inverse / (root * flat);
                    total[1][n] += pull * dx;
                    total[2][n] += pull * dy;
                    if REPEATS {
                        // Δy = difference − turns · period
                        total[3][n] -= turns * pull * dy;
                    }
                    sum_x[n] += pull * dx;
                    sum_y[n] += pull * dy;
                }
            }
            let mut sums = [0.0; 4]; // interleaved, because each sum waits for its previous term
            for n in 0..LANES {
                (0..4).for_each(|part| sums[part] += f64::from(total[part][n]));
            }
            let [energy, x, y, of_period] = sums;
            found.energy += energy;
            found.of_period += of_period;
            found.of_vertices.push(Vector2::new(x, y));
        }
        found.of_landmarks = sums;
        found
    }
}

struct Curvature<'a, const REPEATS: bool> {
    batch: Batch<'a, Vec<f64>>,
    dials: Dials,
}

impl<const REPEATS: bool> WithSimd for Curvature<'_, REPEATS> {
    /// Of the vertices, and of the landmarks.
    type Output = (Vec<f64>, Vec<f64>);

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Self::Output {
        let Batch { places, uv, period, vertices, table, width, sums: mut of_landmarks } = self.batch;
        let Dials { steps, ends, nearest, sharp: [far, near] } = self.dials;
        let mut of_vertices = Vec::with_capacity(vertices.len());
        for (&vertex, row) in vertices.iter().zip(table.chunks_exact(width.max(1))) {
            let place = uv[vertex as usize].cast::<f32>();
            let mut sum = 0.0;
            let lanes = row.chunks_exact(LANES).zip(places[0].chunks_exact(LANES).zip(places[1].chunks_exact(LANES)));
            for ((row, (x, y)), sums) in lanes.zip(of_landmarks.chunks_exact_mut(LANES)) {
                let mut bends = [0.0f32; LANES];
                for n in 0..LANES {
                    let distance = row[n];
                    let dx = place.x - x[n];
                    let (_, dy) = nearest_copy::<REPEATS>(place.y - y[n], period);
                    let flat = (dx * dx + dy * dy).sqrt().max(APART * nearest);
                    let error = flat / distance - 1.0;
                    let is_slack = is_bent(distance) && error < 0.0;
                    let outlying = error * if distance > ends[1] { far } else { near };
                    let root = (1.0 + outlying * outlying).sqrt();
                    // ½ ρ'' and ½ ρ' δ/d; the latter is negative for pairs that are too close, which no spring can be
                    let (along, across) = ((root * root * root).recip(), (error / root * distance / flat).max(0.0));
                    let bend = 2.0 * weight(steps, ends, distance) * (along + across) / (distance * distance);
                    bends[n] = if distance > nearest && !is_slack { bend } else { 0.0 };
                }
                for (of_landmark, bend) in sums.iter_mut().zip(bends) {
                    let bend = HELD * f64::from(bend);
                    *of_landmark += bend;
                    sum += bend;
                }
            }
            of_vertices.push(sum);
        }
        (of_vertices, of_landmarks)
    }
}
