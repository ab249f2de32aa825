//! An initial map without folds (Tutte 1963): the boundary lies on an ellipse, and springs hold the interior.
//!
//! The ellipse has the length and width of the boundary by landmark placement, and is rotated so that each part is
//! close to its position there: a strip starts as a strip. Springs of any stiffness create no folds. With equal
//! stiffness, parts far from the boundary would be crowded, so springs there are softened.
//!
//! Of several boundary loops, the one that encloses the largest area by landmark placement lies on the ellipse. Each
//! other loop surrounds a hole, which is filled with triangles of springs between its vertices. A hole that cannot be
//! filled in this way is held open by springs to a virtual vertex.

use crate::embed::Place;
use std::f64::consts::TAU;

use nalgebra::{Matrix2, Vector2};

use super::springs::Springs;
use super::triangles::TriangleEnergy;
use crate::surface::Surface;
use crate::surface::cuts::holes::fill_holes;
use crate::surface::topology::Topology;
use crate::{Control, Result};

/// The share of their area to which triangles may shrink.
const SMALL: f64 = 0.02;

/// The maximum number of times that springs are softened.
const ROUNDS: usize = 30;

/// The smallest factor by which a spring is softened at a time.
const SOFTER: f64 = 1e-2;

/// The stiffness that fixes the boundary; that of springs is about 1.
const FIRM: f64 = 1e9;

/// The stiffness of all springs to a virtual vertex together, with which a hole keeps its size among springs of stiffness 1:
/// at a distance of k/2π springs, each of its k vertices is pulled inwards about as much as outwards.
const ACROSS: f64 = 8.0;

/// The number of positions on an ellipse at which lengths are summed.
const PLACES: usize = 4096;

/// The number of rotations of the boundary along the ellipse that are tried.
const STARTS: usize = 128;

/// The minimum ratio of an ellipse's width and length.
const NARROWEST: f64 = 0.005;

/// Returns the map of a disk, possibly with holes, whose vertices have approximate positions, which may fold.
pub fn spread(
    surface: &Surface, places: &[Place], triangles: &TriangleEnergy, springs: &Springs, control: &Control,
) -> Result<Vec<Place>> {
    let mut holes = Topology::of(surface).loops;
    let at = |vertex: u32| places[vertex as usize];
    let cross = |&half_edge: &u32| at(surface.origin(half_edge)).perp(&at(surface.target(half_edge)));
    let area = |n: &usize| holes[*n].half_edges.iter().map(cross).sum::<f64>().abs();
    let outer = (0..holes.len()).max_by(|a, b| area(a).total_cmp(&area(b)));
    let boundary = holes.remove(outer.unwrap_or(0)).half_edges;
    let vertices: Vec<u32> = boundary.iter().map(|&half_edge| surface.origin(half_edge)).collect();
    let lengths: Vec<f64> = boundary.iter().map(|&half_edge| surface.length(half_edge)).collect();
    let outline: Vec<Place> = vertices.iter().map(|&vertex| at(vertex)).collect();
    let mut ground = vec![0.0; surface.len()];
    let mut forces = vec![Vector2::zeros(); surface.len()];
    for (&vertex, place) in vertices.iter().zip(on_ellipse(&outline, &lengths)) {
        // a penalty instead of a constraint: the matrix keeps its pattern, and its factor the symbolic part
        ground[vertex as usize] = FIRM;
        forces[vertex as usize] = FIRM * place;
    }
    if holes.is_empty() {
        return softened(triangles, |entries| Ok(springs.factor(entries, &ground)?.solve(&forces)), control);
    }
    let filled = fill_holes(surface, &holes, control)?;
    let mut corners = filled.surface.faces().to_vec();
    let mut across = vec![[-1.0; 3]; filled.added.len()];
    for (&hole, middle) in filled.left.iter().zip(surface.len() as u32..) {
        let half_edges = &holes[hole].half_edges;
        corners.extend(half_edges.iter().map(|&h| [surface.target(h), surface.origin(h), middle]));
        across.resize(across.len() + half_edges.len(), [-ACROSS / half_edges.len() as f64; 3]);
    }
    let count = surface.len() + filled.left.len();
    ground.resize(count, 0.0);
    forces.resize(count, Vector2::zeros());
    let springs = Springs::new(corners, count, control)?;
    let balanced = |entries: &[[f64; 3]]| {
        let mut uv = springs.factor(&[entries, &across].concat(), &ground)?.solve(&forces);
        uv.truncate(surface.len());
        Ok(uv)
    };
    softened(triangles, balanced, control)
}

/// Returns the map by springs that are softened where triangles are small. `balanced` returns the map for the entries
/// of each triangle in the matrix of springs.
pub(super) fn softened(
    triangles: &TriangleEnergy, balanced: impl Fn(&[[f64; 3]]) -> Result<Vec<Place>>, control: &Control,
) -> Result<Vec<Place>> {
    let mut stiffness = vec![1.0f64; triangles.corners().len()];
    let mut rounds = 0;
    loop {
        control.check()?;
        let entries: Vec<[f64; 3]> = stiffness.iter().map(|&stiffness| [-stiffness; 3]).collect();
        let uv = balanced(&entries)?;
        let growths = triangles.growths(&uv);
        rounds += 1;
        if rounds == ROUNDS || growths.iter().all(|&growth| growth > SMALL) {
            return Ok(uv);
        }
        // √growth is the factor by which lengths shrank
        let softer = |growth: f64| growth.max(0.0).sqrt().clamp(SOFTER, SOFTER.recip());
        stiffness.iter_mut().zip(growths).for_each(|(stiffness, growth)| *stiffness *= softer(growth));
    }
}

/// Returns a closed line of positions on the ellipse with its extents: in the same order, counterclockwise, with the
/// given distances between successive positions, each as close to its original position as possible.
fn on_ellipse(outline: &[Place], lengths: &[f64]) -> Vec<Place> {
    let centre = outline.iter().sum::<Place>() / outline.len() as f64;
    let next = |n: usize| outline[(n + 1) % outline.len()] - centre;
    let area: f64 = (0..outline.len()).map(|n| (outline[n] - centre).perp(&next(n))).sum();
    let mirror = Vector2::new(1.0, if area < 0.0 { -1.0 } else { 1.0 });
    let centred: Vec<Place> = outline.iter().map(|place| (place - centre).component_mul(&mirror)).collect();
    let round: f64 = lengths.iter().sum();
    let spread: Matrix2<f64> =
        centred.iter().zip(lengths).map(|(place, length)| place * place.transpose() * (length / round)).sum();
    let axes = spread.symmetric_eigen();
    // a circle of radius r has a variance of r²/2 along each axis
    let extents = axes.eigenvalues.map(|square| (2.0 * square.max(0.0)).sqrt());
    let extents = extents.map(|extent| extent.max(NARROWEST * extents.max()).max(f64::MIN_POSITIVE));
    let turn = if axes.eigenvectors.determinant() < 0.0 {
        axes.eigenvectors * Matrix2::new(1.0, 0.0, 0.0, -1.0)
    } else {
        axes.eigenvectors
    };
    let place = |n: usize| {
        let (sin, cos) = (n as f64 / PLACES as f64 * TAU).sin_cos();
        turn * Vector2::new(extents.x * cos, extents.y * sin)
    };
    let ellipse: Vec<Place> = (0..PLACES).map(place).collect();
    let mut along = vec![0.0];
    for n in 0..PLACES {
        along.push(along[n] + (ellipse[(n + 1) % PLACES] - ellipse[n]).norm());
    }
    // the position on the ellipse at a share of its length
    let at = |share: f64| {
        let length = share.rem_euclid(1.0) * along[PLACES];
        let n = along.partition_point(|&other| other <= length).clamp(1, PLACES) - 1;
        let part = (length - along[n]) / (along[n + 1] - along[n]);
        ellipse[n] + (ellipse[(n + 1) % PLACES] - ellipse[n]) * part
    };
    let mut shares = Vec::with_capacity(lengths.len());
    lengths.iter().fold(0.0, |sum, length| {
        shares.push(sum / round);
        sum + length
    });
    let fits =
        |start: f64| centred.iter().zip(&shares).map(|(place, share)| place.dot(&at(start + share))).sum::<f64>();
    let best = (0..STARTS).map(|n| n as f64 / STARTS as f64).max_by(|&a, &b| fits(a).total_cmp(&fits(b)));
    shares.iter().map(|share| at(best.unwrap_or(0.0) + share)).collect()
}
