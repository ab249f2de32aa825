//! The outside of a surface, and the orientation of a map. Distances leave rotation and handedness open.

use nalgebra::{Matrix2, Vector2, Vector3};

use crate::Result;
use crate::adjacency::{Arc, Links};
use crate::error::check_length;
use crate::surface::{VoxelSurface, voxels::graph::VoxelGraph};

/// The minimum share of a direction's variance that the map explains if this direction is used as the map's up.
const EXPLAINED: f64 = 0.05;

/// The number of times that normals are averaged with their neighbours, enough to smooth out the steps between voxels.
const SMOOTHING: usize = 4;

/// Mean normals shorter than this come from opposite sides and do not define an outside.
const SHORTEST_NORMAL: f64 = 0.3;

/// Returns outward unit normals (RAS+ mm), which point to the background. All are NaN for a voxel sheet, most of which
/// has background on both sides; elsewhere, thin parts take over the normals around them.
pub(crate) fn outward_normals(surface: &VoxelSurface, graph: &VoxelGraph) -> Vec<Vector3<f64>> {
    let points = 0..surface.len();
    let mut normals: Vec<_> =
        points.clone().map(|v| surface.outward(v).try_normalize(0.0).unwrap_or_else(Vector3::zeros)).collect();
    for _ in 0..SMOOTHING {
        normals = points.clone().map(|v| mean_around(graph, &normals, v)).collect();
    }
    let clear = |normal: &Vector3<f64>| normal.try_normalize(SHORTEST_NORMAL).unwrap_or_else(Vector3::zeros);
    normals = normals.iter().map(clear).collect();
    let unknown = |normals: &[Vector3<f64>]| normals.iter().filter(|normal| **normal == Vector3::zeros()).count();
    let mut missing = unknown(&normals);
    if 2 * missing > surface.len() {
        return vec![Vector3::repeat(f64::NAN); surface.len()];
    }
    while missing > 0 {
        let filled = |v: usize| {
            let known = normals[v] != Vector3::zeros();
            let normal = if known { normals[v] } else { mean_around(graph, &normals, v) };
            normal.try_normalize(0.0).unwrap_or_else(Vector3::zeros)
        };
        normals = points.clone().map(filled).collect();
        let left = unknown(&normals);
        if left == missing {
            break; // exact opposites remain unknown
        }
        missing = left;
    }
    let undefined = Vector3::repeat(f64::NAN);
    normals.into_iter().map(|normal| if normal == Vector3::zeros() { undefined } else { normal }).collect()
}

fn mean_around(graph: &VoxelGraph, normals: &[Vector3<f64>], vertex: usize) -> Vector3<f64> {
    let add = |(sum, count), arc: Arc| (sum + normals[arc.to as usize], count + 1.0);
    let (sum, count): (Vector3<f64>, f64) = graph.arcs(vertex as u32).fold((normals[vertex], 1.0), add);
    sum / count
}

/// Rotates a map about its mean, and mirrors it if necessary, such that
/// - the surface is seen from outside (from the background); a voxel sheet without an outside is not mirrored;
/// - superior is up, if a direction of the map corresponds to it; otherwise anterior, otherwise right.
///
/// `seen_from_outside` is positive if the map already shows the surface from outside, and negative if from inside.
pub(crate) fn orient(points: &[Vector3<f64>], seen_from_outside: f64, uv: &mut [[f64; 2]]) {
    if seen_from_outside < 0.0 {
        uv.iter_mut().for_each(|[_, v]| *v = -*v);
    }
    let mean = uv.iter().map(|&place| Vector2::from(place)).sum::<Vector2<f64>>() / uv.len() as f64;
    let Some(up) = up_direction(points, uv, mean) else {
        return;
    };
    for place in uv {
        let p = Vector2::from(*place) - mean;
        *place = [p.x * up.y - p.y * up.x, p.x * up.x + p.y * up.y]; // rotates `up` onto (0, 1)
    }
}

/// Rotates and translates a map rigidly such that the positions `places` on it come as close as possible to `onto`, by
/// least squares (Procrustes; Schönemann 1966). The means coincide afterwards. Returns the angle in radians,
/// counterclockwise; 0 if the positions do not determine it.
///
/// # Errors
/// [`Error::WrongLength`](crate::Error::WrongLength) if there is not one target per position.
pub fn turn_onto(places: &[[f64; 2]], onto: &[[f64; 2]], uv: &mut [[f64; 2]]) -> Result<f64> {
    check_length("targets", onto.len(), "positions", places.len())?;
    if places.is_empty() {
        return Ok(0.0);
    }
    let mean = |of: &[[f64; 2]]| of.iter().map(|&p| Vector2::from(p)).sum::<Vector2<f64>>() / of.len() as f64;
    let (from, to) = (mean(places), mean(onto));
    let pairs = || places.iter().zip(onto).map(|(&p, &q)| (Vector2::from(p) - from, Vector2::from(q) - to));
    let along: f64 = pairs().map(|(p, q)| p.dot(&q)).sum();
    let across: f64 = pairs().map(|(p, q)| p.perp(&q)).sum();
    // Σ q·(R p) is largest at tan θ = Σ p × q / Σ p·q (Procrustes in the plane)
    let turn = if along.hypot(across) > 0.0 { across.atan2(along) } else { 0.0 };
    let (sin, cos) = turn.sin_cos();
    for place in uv {
        let p = Vector2::from(*place) - from;
        *place = [to.x + p.x * cos - p.y * sin, to.y + p.x * sin + p.y * cos];
    }
    Ok(turn)
}

/// Returns a positive number if the map shows the surface from outside: the sum over all points of the orientation in
/// the map of their neighbourhood, projected along the outward direction.
pub(crate) fn handedness(surface: &VoxelSurface, graph: &VoxelGraph, uv: &[[f64; 2]]) -> f64 {
    let points = surface.points();
    let at_point = |v: usize| {
        let (mut du, mut dv) = (Vector3::zeros(), Vector3::zeros());
        for arc in graph.arcs(v as u32) {
            let step = points[arc.to as usize] - points[v];
            du += step * (uv[arc.to as usize][0] - uv[v][0]);
            dv += step * (uv[arc.to as usize][1] - uv[v][1]);
        }
        // du × dv = (area of the map per area of the surface) · normal, up to a positive factor, for any ring of steps
        du.cross(&dv).dot(&surface.outward(v))
    };
    (0..points.len()).map(at_point).sum()
}

/// Returns the signed area of a map in mm²: positive if most of its faces have the same orientation as on the surface.
pub(crate) fn map_area(faces: &[[u32; 3]], uv: &[[f64; 2]]) -> f64 {
    let double = |face: &[u32; 3]| {
        let [[ax, ay], [bx, by], [cx, cy]] = face.map(|v| uv[v as usize]);
        (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    };
    0.5 * faces.iter().map(double).sum::<f64>()
}

/// Returns the direction in the map along which superior (else anterior, right) grows fastest, by regression.
fn up_direction(points: &[Vector3<f64>], uv: &[[f64; 2]], mean: Vector2<f64>) -> Option<Vector2<f64>> {
    let centre = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
    let centred = || uv.iter().map(|&place| Vector2::from(place) - mean);
    let covariance: Matrix2<f64> = centred().map(|p| p * p.transpose()).sum();
    let inverse = covariance.try_inverse()?;
    [2, 1, 0].into_iter().find_map(|axis| {
        let moment: Vector2<f64> = centred().zip(points).map(|(p, x)| p * (x[axis] - centre[axis])).sum();
        // regression of the coordinate on the map; its explained share of the variance is R²
        let slope = inverse * moment;
        let total: f64 = points.iter().map(|x| (x[axis] - centre[axis]).powi(2)).sum();
        let explained = slope.dot(&moment) / total;
        (explained > EXPLAINED).then(|| slope.normalize())
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Control;
    use crate::geodesic::chain::{LinkLengths, chain_graph};
    use crate::tests::chained;
    use crate::volume::{Affine, Mask};

    /// Checks that the map of one side of a block, seen from outside, shows `right` to the right and `up` up.
    fn side(affine: [[f64; 4]; 4], on_side: impl Fn([u32; 3]) -> bool) -> (VoxelSurface, VoxelGraph) {
        let control = Control::default();
        let mask = Mask::from_fn([14, 15, 16], |v| (0..3).all(|a| (2..12).contains(&v[a]))).unwrap();
        let whole = VoxelSurface::from_mask(&mask, Affine::new(affine).unwrap(), &control).unwrap();
        let surface = whole.subset(&whole.voxels().iter().map(|&v| on_side(v)).collect::<Vec<_>>());
        let graph = chain_graph(&surface, LinkLengths::ChainCode, &control).unwrap();
        (surface, graph)
    }

    fn check(surface: &VoxelSurface, graph: &VoxelGraph, right: Vector3<f64>, up: Vector3<f64>) {
        let points = surface.points();
        let centre = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
        for (angle, mirror) in [(0.0f64, 1.0), (2.0, 1.0), (0.5, -1.0), (4.0, -1.0)] {
            let turned = |p: &Vector3<f64>| {
                let (x, y) = ((p - centre).dot(&right), mirror * (p - centre).dot(&up));
                [x * angle.cos() - y * angle.sin() + 7.0, x * angle.sin() + y * angle.cos()]
            };
            let mut uv: Vec<[f64; 2]> = points.iter().map(turned).collect();
            orient(&points, handedness(surface, graph, &uv), &mut uv);
            for (p, [u, v]) in points.iter().zip(uv) {
                assert!((u - (p - centre).dot(&right)).abs() < 1e-9 && (v - (p - centre).dot(&up)).abs() < 1e-9);
            }
        }
    }

    const RAS: [[f64; 4]; 4] =
        [[1.0, 0.0, 0.0, 5.0], [0.0, 1.0, 0.0, -3.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
    const LAS: [[f64; 4]; 4] =
        [[-1.0, 0.0, 0.0, 5.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];

    #[test]
    fn normals_of_a_ball_point_away_from_its_centre() {
        let (spacing, centre) = ([1.5, 0.75, 1.0], Vector3::new(18.0, 9.0, 12.0));
        let affine = Affine::from_spacing(spacing).unwrap();
        let inside = |v: [usize; 3]| (affine.to_mm(v.map(|x| x as f64)) - centre).norm() < 8.5;
        let (surface, graph) = chained(&Mask::from_fn([24, 24, 24], inside).unwrap(), spacing);
        for (point, normal) in surface.points().iter().zip(outward_normals(&surface, &graph)) {
            assert!((normal.norm() - 1.0).abs() < 1e-12 && (point - centre).normalize().dot(&normal) > 0.95);
        }
    }

    #[test]
    fn a_sheet_of_one_voxel_has_no_outside() {
        let (surface, graph) = chained(&Mask::from_fn([9, 9, 5], |v| v[2] == 2).unwrap(), [1.0; 3]);
        assert!(outward_normals(&surface, &graph).iter().all(|normal| normal.iter().all(|x| x.is_nan())));
    }

    #[test]
    fn a_thin_dome_has_no_outside_and_a_thick_one_has_two() {
        let centre = Vector3::repeat(15.5);
        for (half, is_thin) in [(0.5, true), (0.9, true), (1.5, false)] {
            let off = |v: [usize; 3]| (Vector3::from(v.map(|x| x as f64)) - centre).norm() - 12.0;
            let mask = Mask::from_fn([32, 32, 32], |v| off(v).abs() < half && v[2] > 18).unwrap();
            let (surface, graph) = chained(&mask, [1.0; 3]);
            for (point, normal) in surface.points().iter().zip(outward_normals(&surface, &graph)) {
                let height = (point - centre).norm() - 12.0;
                assert_eq!(normal.x.is_nan(), is_thin, "{half}");
                // away from the rim, on the upper and on the lower side
                let is_inner = !is_thin && point.z > 21.0 && height.abs() > 0.5;
                assert!(!is_inner || normal.dot(&(point - centre)) * height > 0.0, "{point} {normal}");
            }
        }
    }

    #[test]
    fn a_side_is_seen_from_outside_with_superior_up() {
        let (x, y, z) = (Vector3::x(), Vector3::y(), Vector3::z());
        // seen from the right, anterior is to the right
        let (right, graph) = side(RAS, |v| v[0] == 11);
        check(&right, &graph, y, z);
        let (left, graph) = side(RAS, |v| v[0] == 2);
        check(&left, &graph, -y, z);
        // the same anatomy stored from right to left gives the same map
        let (right, graph) = side(LAS, |v| v[0] == 2);
        check(&right, &graph, y, z);
        // from behind, right is to the right
        let (back, graph) = side(RAS, |v| v[1] == 2);
        check(&back, &graph, x, z);
    }

    #[test]
    fn a_level_patch_has_anterior_up() {
        let (top, graph) = side(RAS, |v| v[2] == 11);
        check(&top, &graph, Vector3::x(), Vector3::y());
        let (bottom, graph) = side(RAS, |v| v[2] == 2);
        check(&bottom, &graph, -Vector3::x(), Vector3::y());
    }

    #[test]
    fn superior_is_up_if_the_map_explains_a_twentieth_of_it() {
        let grid: Vec<[f64; 2]> = (0..400).map(|n| [f64::from(n % 20) - 9.5, f64::from(n / 20) - 9.5]).collect();
        let variance = 399.0 / 12.0; // of 20 steps of 1
        for (share, is_superior) in [(0.9f64, true), (0.06, true), (0.04, false), (0.0, false)] {
            let checker = |n: usize| if (n % 20 + n / 20).is_multiple_of(2) { 1.0 } else { -1.0 }; // not correlated with u and v
            let point = |(n, [u, v]): (usize, &[f64; 2])| {
                Vector3::new(0.0, -u, share.sqrt() * v + ((1.0 - share) * variance).sqrt() * checker(n))
            };
            let points: Vec<Vector3<f64>> = grid.iter().enumerate().map(point).collect();
            let mut uv = grid.clone();
            orient(&points, 1.0, &mut uv);
            let expected = grid.iter().map(|&[u, v]| if is_superior { [u, v] } else { [v, -u] });
            let off = uv.iter().zip(expected).map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1])).fold(0.0, f64::max);
            assert!(off < 1e-9, "{share} {off}");
        }
    }
}
