//! An initial map without folds (Tutte 1963): the boundary lies on an ellipse, and springs hold the interior.
//!
//! The ellipse has the length and width of the boundary by landmark placement, and is rotated so that each part is
//! close to its position there: a strip starts as a strip. Springs of any stiffness create no folds. With equal
//! stiffness, parts far from the boundary would be crowded, so springs there are softened.

use crate::embed::Place;
use std::f64::consts::TAU;

use nalgebra::{Matrix2, Vector2};

use super::springs::Springs;
use super::triangles::TriangleEnergy;
use crate::surface::Surface;
use crate::{Control, Result};

/// The share of their area to which triangles may shrink.
const SMALL: f64 = 0.02;

/// The maximum number of times that springs are softened.
const ROUNDS: usize = 30;

/// The smallest factor by which a spring is softened at a time.
const SOFTER: f64 = 1e-2;

/// The stiffness that fixes the boundary; that of springs is about 1.
const FIRM: f64 = 1e9;

/// The number of positions on an ellipse at which lengths are summed.
const PLACES: usize = 4096;

/// The number of rotations of the boundary along the ellipse that are tried.
const STARTS: usize = 128;

/// The minimum ratio of an ellipse's width and length.
const NARROWEST: f64 = 0.005;

/// Returns the map of a disk whose vertices have approximate positions, which may fold.
pub fn spread(
    surface: &Surface, places: &[Place], triangles: &TriangleEnergy, springs: &Springs, control: &Control,
) -> Result<Vec<Place>> {
    let mut ground = vec![0.0; surface.len()];
    let mut forces = vec![Vector2::zeros(); surface.len()];
    for boundary in surface.boundary() {
        let vertices: Vec<usize> = boundary.iter().map(|&half_edge| surface.origin(half_edge) as usize).collect();
        let lengths: Vec<f64> = boundary.iter().map(|&half_edge| surface.length(half_edge)).collect();
        let outline: Vec<Place> = vertices.iter().map(|&vertex| places[vertex]).collect();
        for (&vertex, place) in vertices.iter().zip(on_ellipse(&outline, &lengths)) {
            // a penalty instead of a constraint: the matrix keeps its pattern, and its factor the symbolic part
            ground[vertex] = FIRM;
            forces[vertex] = FIRM * place;
        }
    }
    softened(triangles, |entries| Ok(springs.factor(entries, &ground)?.solve(&forces)), control)
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
