use proptest::prelude::*;

use super::*;
use crate::surface::{mesh::shapes, topology::Topology};
use crate::tests;
use crate::volume::Mask;

fn solid(shape: [usize; 3], is_inside: impl Fn([usize; 3]) -> bool) -> Surface {
    tests::solid(&Mask::from_fn(shape, is_inside).unwrap(), [1.0; 3])
}

/// Checks that each loop removes a handle and separates nothing.
fn assert_cut(surface: &Surface) -> Vec<Handle> {
    let (open, handles) = cut_handles(surface, &Control::default()).unwrap();
    let before = Topology::of(surface);
    let after = Topology::of(&open);
    assert_eq!((after.genus, after.components.len()), (0, before.components.len()));
    assert_eq!(handles.len(), before.genus);
    assert_eq!(after.faces, before.faces);
    let mut so_far = surface.clone();
    for (n, handle) in (1..).zip(&handles) {
        so_far = so_far.cut_open(handle.half_edges.iter().copied());
        assert_eq!(Topology::of(&so_far).genus, before.genus - n);
        let loops = handle.vertices.iter().zip(handle.vertices.iter().cycle().skip(1));
        let mut length = 0.0;
        for (&a, &b) in loops {
            let is_edge = |h: &u32| {
                [surface.origin(*h), surface.target(*h)] == [a.min(b), a.max(b)]
                    || [surface.target(*h), surface.origin(*h)] == [a.min(b), a.max(b)]
            };
            assert!(surface.edges().any(|h| is_edge(&h)), "{a} {b} of {:?}", handle.vertices);
            length += (surface.points()[a as usize] - surface.points()[b as usize]).norm();
        }
        assert!((length - handle.length).abs() < 1e-9 * length);
    }
    assert_eq!(so_far.twins(), open.twins());
    handles
}

#[test]
fn what_has_no_handle_has_no_loop() {
    for shape in [shapes::sheet(4, 4), shapes::sphere(2)] {
        let surface = shapes::surface(shape);
        assert_eq!(cut_handles(&surface, &Control::default()).unwrap(), (surface, vec![]));
    }
    let nothing = shapes::surface(shapes::sheet(1, 1)).part(&[false, false]);
    assert_eq!(handles(&nothing, &Control::default()).unwrap(), []);
}

#[test]
fn the_loop_of_a_torus_goes_around_its_tube() {
    for (m, n) in [(60, 20), (31, 9), (5, 40), (3, 3), (200, 12)] {
        let torus = shapes::surface(shapes::torus(m, n));
        let handle = assert_cut(&torus).remove(0);
        let round = n as f64 * 2.0 * (std::f64::consts::PI / n as f64).sin(); // the polygon in the circle of radius 1
        let through = 2.0 * m as f64 * 2.0 * (std::f64::consts::PI / m as f64).sin(); // that of radius 2
        assert!((handle.length - round.min(through)).abs() < 1e-9, "{m} {n}: {}", handle.length);
    }
}

#[test]
fn a_loop_does_not_save_length_through_a_hole() {
    // without a toll, the way through the hole in the tube would seem shorter
    let (m, n) = (60, 20);
    let torus = shapes::surface(shapes::torus(m, n));
    let is_hole = |i: usize, j: usize| (20..26).contains(&i) && (6..12).contains(&j);
    let holed = torus.part(&(0..2 * m * n).map(|f| !is_hole(f / 2 / n, f / 2 % n)).collect::<Vec<_>>());
    let handle = assert_cut(&holed).remove(0);
    let round = n as f64 * 2.0 * (std::f64::consts::PI / n as f64).sin();
    assert!((handle.length - round).abs() < 1e-9, "{} {round}", handle.length);
}

#[test]
fn handles_are_where_the_bridges_are() {
    // two slabs, joined by rods of two by two voxels: each after the first makes a handle
    let rods = [[3, 3], [3, 24], [13, 14], [24, 3], [24, 24]];
    let is_rod = |i: usize, j: usize| rods.iter().any(|&[a, b]| (a..a + 2).contains(&i) && (b..b + 2).contains(&j));
    let surface = solid([30, 30, 16], |[i, j, k]| !(4..12).contains(&k) || is_rod(i, j));
    let handles = assert_cut(&surface);
    assert_eq!(handles.len(), 4);
    for handle in handles {
        assert!(handle.length < 8.0, "{}", handle.length);
        let near =
            |&[a, b]: &[usize; 2]| (handle.centre.xy() - nalgebra::Vector2::new(a as f64 + 0.5, b as f64 + 0.5)).norm();
        assert!(rods.iter().map(near).fold(f64::INFINITY, f64::min) < 1.0, "{}", handle.centre);
        assert!((3.0..13.0).contains(&handle.centre.z));
    }
}

#[test]
fn dense_handles_are_all_found() {
    // a lattice of rods that touch at every third voxel
    let lattice = solid([14; 3], |v| v.iter().filter(|&&x| x % 3 == 1).count() >= 2);
    let handles = assert_cut(&lattice);
    assert!(handles.len() > 50);
}

#[test]
fn several_components_have_their_own() {
    let ring = |i: usize, j: usize| (i, j) != (2, 2) && (1..4).contains(&i) && (1..4).contains(&j);
    let surface = solid([5, 12, 5], |[i, j, k]| (k == 1 || k == 3) && (ring(i, j) || (j > 5 && ring(i, j - 6))));
    assert_eq!(Topology::of(&surface).components.len(), 4);
    assert_eq!(assert_cut(&surface).len(), 4);
}

/// Returns the shortest non-separating loop by trying all vertices, shortest paths and edges, and cutting each loop
/// open.
fn shortest_of_all(surface: &Surface) -> f64 {
    let shrunk = Shrunk::new(surface, TOLL);
    let genus = Topology::of(surface).genus;
    let mut search = EdgeSearch::new(surface.len());
    let mut best = f64::INFINITY;
    for root in shrunk.nodes() {
        search.clear();
        search.seed(root);
        while search.settle(&shrunk.network, |_| true).is_some() {}
        for edge in surface.edges() {
            let [a, b] = shrunk.ends(edge);
            let is_closed = search.step(a).is_none_or(|step| step.half_edge != edge)
                && search.step(b).is_none_or(|step| step.half_edge != edge)
                && search.is_settled(a);
            let half_edges = if is_closed { shrunk.closed_by(&search, edge) } else { vec![] };
            let length: f64 = half_edges.iter().map(|&h| surface.length(h)).sum();
            if is_closed && length < best && Topology::of(&surface.cut_open(half_edges)).genus < genus {
                best = length;
            }
        }
    }
    best
}

#[test]
fn a_plate_has_a_handle_for_each_hole() {
    for (side, gap, wide) in [(6usize, 14usize, 6usize), (1, 60, 24)] {
        let size = side * gap;
        let plate = |[i, j, _]: [usize; 3]| (i % gap) < gap - wide || (j % gap) < gap - wide;
        let surface = solid([size + gap - wide, size + gap - wide, 5], plate);
        let (cut, handles) = cut_handles(&surface, &Control::default()).unwrap();
        assert_eq!(handles.len(), side * side);
        assert_eq!(Topology::of(&cut).genus, 0);
        let opened = crate::surface::cuts::open_to_disk(&surface, &Control::default()).unwrap();
        assert!(Topology::of(&opened.surface).is_disk());
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]
    #[test]
    fn the_shortest_loop_is_found(mask in tests::masks([4; 3], 0.4..0.9)) {
        let surface = tests::solid(&mask, [1.0, 1.3, 0.8]);
        let found = handles(&surface, &Control::default()).unwrap();
        if let Some(shortest) = found.iter().map(|handle| handle.length).reduce(f64::min) {
            let best = shortest_of_all(&surface);
            prop_assert!(shortest >= best - 1e-9 && shortest <= 1.1 * best, "{} {}", shortest, best);
        }
    }
}

proptest! {
    #[test]
    fn any_part_of_a_torus_is_cut(keep in prop::collection::vec(prop::bool::weighted(0.8), 168)) {
        assert_cut(&shapes::surface(shapes::torus(12, 7)).part(&keep));
    }

    #[test]
    fn any_volume_is_cut(mask in (3..7usize).prop_flat_map(|size| tests::masks([size; 3], 0.2..0.9))) {
        assert_cut(&tests::solid(&mask, [1.0; 3]));
    }
}
