use nalgebra::{Rotation3, Vector2, Vector3};
use proptest::prelude::*;

use super::*;
use crate::geodesic::path::checks::{assert_on_surface, bumpy};
use crate::geodesic::path::{Site, length};
use crate::geodesic::{graph::GeodesicGraph, solver::Solver};
use crate::surface::mesh::{BORDER, next, previous, shapes};
use crate::{Control, Error};

fn row(surface: &Surface, source: u32) -> Vec<f64> {
    row_within(surface, source, Reach::default())
}

fn row_within(surface: &Surface, source: u32, reach: Reach) -> Vec<f64> {
    let exact = Exact::new(surface).within(reach);
    let mut row = vec![0.0; surface.len()];
    exact.distances(source, &mut row, &mut exact.scratch(), &Control::default()).unwrap();
    row
}

fn assert_near(found: f64, expected: f64, relative: f64) {
    assert!((found - expected).abs() <= relative * expected.abs(), "{found} instead of {expected}");
}

fn assert_all(surface: &Surface, relative: f64, expected: impl Fn(Vector3<f64>, Vector3<f64>) -> Option<f64>) {
    for source in 0..surface.len() as u32 {
        for (&point, found) in surface.points().iter().zip(row(surface, source)) {
            if let Some(expected) = expected(surface.points()[source as usize], point) {
                assert_near(found, expected, relative);
            }
        }
    }
}

/// Returns the distances along the edges only (Bellman, Ford).
fn along_edges(surface: &Surface, source: u32) -> Vec<f64> {
    let mut row = vec![f64::INFINITY; surface.len()];
    row[source as usize] = 0.0;
    loop {
        let before = row.clone();
        for h in surface.edges() {
            let [a, b] = [surface.origin(h), surface.target(h)].map(|v| v as usize);
            row[a] = row[a].min(row[b] + surface.length(h));
            row[b] = row[b].min(row[a] + surface.length(h));
        }
        if row == before {
            return row;
        }
    }
}

/// Returns the lengths of shortest paths by their definition: of all lines that run straight through a sequence of
/// different faces, and of all chains of such lines, the shortest.
fn unfolded(surface: &Surface) -> Vec<Vec<f64>> {
    let n = surface.len();
    let mut rows = vec![vec![f64::INFINITY; n]; n];
    for h in 0..surface.twins().len() as u32 {
        let [a, b, c] = [h, next(h), previous(h)].map(|h| surface.points()[surface.origin(h) as usize]);
        let root = surface.origin(h) as usize;
        rows[root][surface.target(h) as usize] = (b - a).norm();
        rows[root][surface.origin(previous(h)) as usize] = (c - a).norm();
        let right = Vector2::new((b - a).norm(), 0.0);
        let left = Vector2::new((c - a).dot(&(b - a)), (b - a).cross(&(c - a)).norm()) / (b - a).norm();
        look(surface, &mut rows[root], &mut vec![h / 3], next(h), [right, left], [right, left]);
    }
    for middle in 0..n {
        for from in 0..n {
            for to in 0..n {
                rows[from][to] = rows[from][to].min(rows[from][middle] + rows[middle][to]);
            }
        }
    }
    (0..n).for_each(|v| rows[v][v] = 0.0);
    rows
}

fn look(
    surface: &Surface, row: &mut [f64], faces: &mut Vec<u32>, half_edge: u32, [right, left]: [Vector2<f64>; 2],
    [low, high]: [Vector2<f64>; 2],
) {
    let twin = surface.twins()[half_edge as usize];
    if twin == BORDER || faces.contains(&(twin / 3)) {
        return;
    }
    faces.push(twin / 3);
    let beyond = surface.origin(previous(twin)) as usize;
    let [q, p] = [surface.origin(twin), surface.target(twin)].map(|v| surface.points()[v as usize]);
    let (edge, side) = (q - p, surface.points()[beyond] - p);
    let axis = (left - right) / edge.norm();
    let place = right
        + axis * (side.dot(&edge) / edge.norm())
        + Vector2::new(axis.y, -axis.x) * (edge.cross(&side).norm() / edge.norm());
    let (is_right, is_left) = (high.perp(&place) <= 0.0, low.perp(&place) >= 0.0);
    if is_right && is_left {
        row[beyond] = row[beyond].min(place.norm());
    }
    if is_left {
        look(surface, row, faces, next(twin), [right, place], [low, if is_right { place } else { high }]);
    }
    if is_right {
        look(surface, row, faces, previous(twin), [place, left], [if is_left { place } else { low }, high]);
    }
    faces.pop();
}

fn assert_agrees_with_every_unfolding(surface: &Surface) {
    for (source, expected) in (0..).zip(unfolded(surface)) {
        for (found, expected) in row(surface, source).into_iter().zip(expected) {
            assert_near(found, expected, 1e-12);
        }
    }
}

#[test]
fn a_plane_is_euclidean() {
    assert_all(&shapes::surface(shapes::sheet(9, 7)), 1e-13, |a, b| Some((a - b).norm()));
}

#[test]
fn slivers_do_not_matter() {
    // columns 1, 1e-4, 1e-8 mm wide, and rows of ten times the width
    let widths = [1.0, 1e-8, 1e-4, 0.1, 1e-8, 1e-8, 2.0, 1e-6];
    let place = |n: f64| widths.iter().take(n as usize).sum::<f64>();
    let (points, faces) = shapes::sheet(8, 8);
    let points: Vec<_> = points.iter().map(|p| [place(p[0]), 10.0 * place(p[1]), 0.0]).collect();
    let (surface, _) = Surface::from_triangles(&points, &faces).unwrap();
    assert_all(&surface, 1e-9, |a, b| Some((a - b).norm()));
}

#[test]
fn paths_bend_at_the_end_of_a_slit() {
    let slit = crate::tests::slit(8, 8, 5.0, 4.0);
    assert_eq!(slit.len(), 81 + 5);
    let end = Vector3::new(5.0, 4.0, 0.0);
    assert_all(&slit, 1e-12, |a, b| {
        let (a, b) = if a.y < b.y { (a, b) } else { (b, a) };
        let is_across = a.y < 4.0 && b.y > 4.0;
        let crossing = a.x + (b.x - a.x) * (4.0 - a.y) / (b.y - a.y);
        let bent = (a - end).norm() + (b - end).norm();
        match is_across {
            true => Some(if crossing >= 5.0 { (a - b).norm() } else { bent }),
            false if a.y == 4.0 || b.y == 4.0 => None, // either side of the slit
            false => Some((a - b).norm()),
        }
    });
}

/// Returns the surface of the cube from 0 to `n`, in squares of side 1.
fn cube(n: i64) -> Surface {
    let mut points = Vec::new();
    let mut number = std::collections::HashMap::new();
    let mut faces = Vec::new();
    for (axis, end) in (0..3).flat_map(|axis| [(axis, 0), (axis, n)]) {
        for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
            let corner = |i: i64, j: i64| {
                let mut place = [end; 3];
                (place[(axis + 1) % 3], place[(axis + 2) % 3]) = (i, j);
                place
            };
            let mut vertex = |place: [i64; 3]| {
                *number.entry(place).or_insert_with(|| {
                    points.push(place.map(|x| x as f64));
                    points.len() as i64 - 1
                })
            };
            let [a, b, c, d] =
                [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)].map(&mut vertex);
            faces.extend(if end == n { [[a, b, c], [a, c, d]] } else { [[a, c, b], [a, d, c]] });
        }
    }
    shapes::surface((points, faces))
}

#[test]
fn a_cube_unfolds() {
    let surface = cube(5);
    let corner = surface.points().iter().position(|p| *p == Vector3::zeros()).unwrap() as u32;
    for (p, found) in surface.points().iter().zip(row(&surface, corner)) {
        let mut sorted = [p.x, p.y, p.z];
        sorted.sort_by(f64::total_cmp);
        // flat on the three faces of the corner; beyond, over the shortest of the edges in between
        let [least, middle, most] = sorted;
        let over = |a: f64, b: f64, c: f64| (a + b).hypot(c);
        let expected = if least == 0.0 {
            middle.hypot(most)
        } else {
            over(least, 5.0, middle).min(over(middle, 5.0, least)).min(if most == 5.0 { f64::INFINITY } else { most })
        };
        assert_near(found, expected, 1e-13);
    }
}

#[test]
fn a_finer_sphere_comes_four_times_nearer() {
    let error = |times: usize| {
        let surface = shapes::surface(shapes::sphere(times));
        let row = row(&surface, 5);
        let arc = |p: &Vector3<f64>| p.angle(&surface.points()[5]);
        let errors = surface.points().iter().zip(&row).filter(|(p, _)| arc(p) > 0.5);
        errors.map(|(p, found)| (found / arc(p) - 1.0).abs()).fold(0.0, f64::max)
    };
    let errors: Vec<f64> = (2..6).map(error).collect();
    assert!(errors[3] < 1e-3, "{errors:?}");
    assert!(errors.windows(2).all(|two| two[0] / two[1] > 3.0), "{errors:?}");
}

#[test]
fn what_is_apart_is_infinitely_far() {
    let sheet = shapes::sheet(3, 3);
    let count = sheet.0.len();
    let surface = shapes::surface(crate::tests::both(&sheet, &shapes::sphere(1)));
    let exact = Exact::new(&surface);
    let (mut wave, mut row) = (exact.scratch(), vec![0.0; surface.len()]);
    exact.row(2, &mut row, &mut wave, &Control::default()).unwrap();
    assert!(row.iter().enumerate().all(|(v, d)| d.is_finite() == (v < count)));
    let expected = Error::Unreachable { source_vertex: 2, vertex: count };
    assert_eq!(exact.path(&wave, count as u32, &Control::default()), Err(expected));
}

#[test]
fn a_cancelled_run_leaves_nothing_behind() {
    let surface = bumpy(40, 40, 3);
    let exact = Exact::new(&surface);
    let (mut wave, mut found) = (exact.scratch(), vec![0.0; surface.len()]);
    let control = Control::default();
    control.cancel();
    assert_eq!(exact.distances(7, &mut found, &mut wave, &control), Err(Error::Cancelled));
    for source in [7, 800, 7] {
        exact.distances(source, &mut found, &mut wave, &Control::default()).unwrap();
        assert_eq!(found, row(&surface, source));
    }
}

/// Checks that every path is as long as its distance, and runs through faces.
fn assert_paths(surface: &Surface, source: u32) {
    let exact = Exact::new(surface);
    let (mut wave, mut row) = (exact.scratch(), vec![0.0; surface.len()]);
    exact.distances(source, &mut row, &mut wave, &Control::default()).unwrap();
    for (target, &distance) in (0..).zip(&row) {
        let path = exact.path(&wave, target, &Control::default()).unwrap();
        assert_near(length(&path), distance, 1e-9);
        assert_eq!([path[0].site, path[path.len() - 1].site], [target, source].map(Site::Vertex));
        assert_on_surface(surface, &path);
    }
}

#[test]
fn distances_within_reach_are_those_without() {
    let surface = bumpy(20, 20, 5);
    let whole = row(&surface, 210);
    let near = row_within(&surface, 210, Reach { mm: 6.0, rings: None });
    assert!(whole.iter().any(|&d| d > 6.0));
    for (near, whole) in near.into_iter().zip(whole) {
        assert_eq!(near, if whole <= 6.0 { whole } else { f64::INFINITY });
    }
}

#[test]
fn rings_are_a_part_of_their_own() {
    let surface = bumpy(14, 14, 8);
    for (source, rings) in [(112, 0), (112, 1), (112, 3), (0, 2), (20, 4), (112, 40)] {
        let mut inside = vec![false; surface.len()];
        inside[source as usize] = true;
        let mut keep = vec![false; surface.faces().len()];
        for _ in 0..rings {
            for (face, keep) in surface.faces().iter().zip(&mut keep) {
                *keep |= face.iter().any(|&v| inside[v as usize]);
            }
            for (face, _) in surface.faces().iter().zip(&keep).filter(|&(_, &keep)| keep) {
                face.iter().for_each(|&v| inside[v as usize] = true);
            }
        }
        let found = row_within(&surface, source, Reach { rings: Some(rings), ..Reach::default() });
        let mut expected = vec![f64::INFINITY; surface.len()];
        expected[source as usize] = 0.0;
        let part = surface.part(&keep);
        if rings > 0 {
            let start = part.ids().iter().position(|&id| id == source).unwrap();
            part.ids().iter().zip(row(&part, start as u32)).for_each(|(&id, d)| expected[id as usize] = d);
        }
        for (&found, &expected) in found.iter().zip(&expected) {
            assert!(found == expected || (found - expected).abs() < 1e-12 * expected, "{found} {expected}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn tiny_surfaces_agree_with_every_unfolding(seed in any::<u64>(), m in 1usize..4, n in 1usize..4) {
        assert_agrees_with_every_unfolding(&bumpy(m, n, seed));
    }

    #[test]
    fn closed_surfaces_agree_with_every_unfolding(heights in prop::collection::vec(0.3f64..2.0, 18)) {
        let (points, faces) = shapes::sphere(1);
        let points = points.iter().zip(heights).map(|(p, h)| p.map(|x| h * x)).collect();
        assert_agrees_with_every_unfolding(&shapes::surface((points, faces)));
    }

    #[test]
    fn distances_are_a_metric_between_chord_and_links(seed in any::<u64>()) {
        let surface = bumpy(8, 6, seed);
        let rows: Vec<_> = (0..surface.len() as u32).map(|source| row(&surface, source)).collect();
        let graph = GeodesicGraph::new(&surface, &Control::default()).unwrap();
        for (a, from_a) in rows.iter().enumerate() {
            let links = crate::tests::row(&graph, a as u32);
            let edges = along_edges(&surface, a as u32);
            for (b, from_b) in rows.iter().enumerate() {
                let distance = from_a[b];
                assert_near(distance, from_b[a], 1e-9);
                prop_assert!(distance >= (surface.points()[a] - surface.points()[b]).norm() * (1.0 - 1e-12));
                prop_assert!(distance <= f64::from(links[b]) * (1.0 + 1e-6));
                prop_assert!(f64::from(links[b]) <= edges[b] * (1.0 + 1e-6));
                prop_assert!((0..rows.len()).all(|c| from_a[c] <= (distance + from_b[c]) * (1.0 + 1e-12)));
            }
        }
    }

    #[test]
    fn nothing_changes_when_moved_scaled_or_renumbered(seed in any::<u64>(), scale in -6i32..7) {
        let surface = bumpy(9, 9, seed);
        let expected = row(&surface, 31);
        let scale = 10f64.powi(scale);
        let turn = Rotation3::from_euler_angles(0.3, 1.1, -2.0);
        let place = |p: &Vector3<f64>| (turn * p + Vector3::new(5.0, -3.0, 8.0)) * scale;
        let number = |v: u32| (v * 37 + 11) % 100; // 37 and 100 have no common factor
        let mut points = vec![[0.0; 3]; 100];
        (0..).zip(surface.points()).for_each(|(v, p)| points[number(v) as usize] = place(p).into());
        let faces: Vec<[i64; 3]> =
            surface.faces().iter().rev().map(|&[a, b, c]| [b, c, a].map(|v| i64::from(number(v)))).collect();
        let found = row(&shapes::surface((points, faces)), number(31));
        (0..).zip(expected).for_each(|(v, expected)| assert_near(found[number(v) as usize], scale * expected, 1e-11));
    }

    #[test]
    fn paths_are_as_long_as_their_distances(seed in any::<u64>(), source in 0u32..99) {
        assert_paths(&bumpy(10, 8, seed), source);
    }
}
