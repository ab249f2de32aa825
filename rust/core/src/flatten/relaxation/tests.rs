use super::*;
use crate::distortion::Evaluation;
use crate::embed::stress::levels::Levels;
use crate::flatten::voxflat::Options;
use crate::geodesic::bend::Marking;
use crate::geodesic::graph::GeodesicGraph;
use crate::sources::Sources;
use crate::surface::cuts::{cut, open_to_disk};
use crate::surface::{mesh::shapes, topology::Topology};

fn relaxed(surface: &Surface, length: f64, least_gain: f64) -> Relaxed {
    relax(surface, Relaxation { length, least_gain, ..Relaxation::default() }, &Control::default()).unwrap()
}

/// Returns the part of a sphere below a height, which is more than half of it for a positive height.
fn cap(height: f64) -> Surface {
    let sphere = shapes::surface(shapes::sphere(4));
    let below: Vec<bool> = sphere.points().iter().map(|p| p.z < height).collect();
    sphere.part_of_vertices(&below).unwrap()
}

/// Checks that the result is the given disk, cut along the reported cuts.
fn assert_cut(surface: &Surface, relaxed: &Relaxed) {
    assert!(Topology::of(&relaxed.surface).is_disk());
    let paths: Vec<Vec<u32>> = relaxed.cuts.iter().map(|cut| cut.vertices.clone()).collect();
    assert_eq!(cut(surface, &paths).unwrap(), relaxed.surface);
    for cut in &relaxed.cuts {
        let ends = cut.vertices.windows(2).map(|pair| [pair[0], pair[1]].map(|v| surface.points()[v as usize]));
        assert!((cut.length - ends.map(|[a, b]| (a - b).norm()).sum::<f64>()).abs() < 1e-9);
        assert_eq!(cut.reason, Reason::Relaxation);
    }
    assert_eq!(relaxed.energies.len(), relaxed.cuts.len() + 1);
}

#[test]
fn cuts_relieve_a_cap_and_keep_to_their_length() {
    let cap = cap(0.3);
    for length in [0.5, 1.5, 3.0] {
        let relaxed = relaxed(&cap, length, 0.0);
        assert_cut(&cap, &relaxed);
        let total: f64 = relaxed.cuts.iter().map(|cut| cut.length).sum();
        assert!(0.7 * length < total && total <= length, "{total} of {length}");
        assert!(relaxed.energies.windows(2).all(|pair| pair[1] < pair[0]), "{:?}", relaxed.energies);
    }
}

#[test]
fn a_path_is_as_long_as_allowed() {
    let sheet = shapes::surface(shapes::sheet(9, 1));
    let along: Vec<u32> = sheet.boundary()[0].iter().copied().take(6).collect();
    for (longest, count) in [(0.0, 0), (2.999, 2), (3.0, 3), (99.0, 6)] {
        let (path, length) = shortened(&sheet, along.clone(), longest);
        assert_eq!((&path[..], length), (&along[..count], count as f64), "{longest}");
    }
}

#[test]
fn a_cut_cap_has_a_better_map() {
    let cap = cap(0.5);
    let error = |surface: &Surface| {
        let control = Control::default();
        let graph = GeodesicGraph::new(surface, &control).unwrap();
        let sources = Sources::Farthest { count: 60, seed: 0 }.choose(&graph, &control).unwrap();
        let levels = Levels::new(surface, &sources, &control).unwrap();
        let rows = levels.measure(&Marking::new(&graph), &control).unwrap();
        let map = crate::flatten::voxflat(levels, rows, &Options::default(), &graph, Evaluation::default(), &control)
            .unwrap();
        map.distortion.best_scale.relative_error
    };
    let relaxed = relaxed(&cap, 3.0, 0.0);
    let [before, after] = [&cap, &relaxed.surface].map(error);
    assert!(after < 0.7 * before, "{before} {after}");
}

#[test]
fn cuts_that_hardly_mend_distances_are_not_made() {
    let cap = cap(0.5);
    let all = relaxed(&cap, 1.0, 0.0);
    let [before, after] = all.errors;
    assert!(0.0 < after && after < 0.9 * before, "{before} {after}");
    let least_relief =
        |share: f64| Relaxation { length: 1.0, least_gain: 0.0, least_relief: share, ..Relaxation::default() };
    let share = 1.0 - after / before;
    let made = |share| relax(&cap, least_relief(share), &Control::default()).unwrap();
    assert_eq!(made(share - 1e-9), all);
    let none = made(share + 1e-9);
    assert_eq!((none.cuts.len(), &none.surface, none.errors), (0, &cap, [before; 2]));
    let bearable = |bearable| Relaxation { length: 1.0, least_gain: 0.0, bearable, ..Relaxation::default() };
    assert_eq!(relax(&cap, bearable(before * (1.0 - 1e-9)), &Control::default()).unwrap(), all);
    assert_eq!(relax(&cap, bearable(before * (1.0 + 1e-9)), &Control::default()).unwrap(), none);
}

#[test]
fn what_is_flat_or_developable_is_not_cut() {
    let sheet = shapes::surface(shapes::sheet(20, 30));
    let rolled = |p: &nalgebra::Vector3<f64>| [12.0 * (p.x / 12.0).cos(), 12.0 * (p.x / 12.0).sin(), p.y].into();
    let rolled = sheet.moved(sheet.points().iter().map(rolled).collect()).unwrap();
    for surface in [sheet, rolled] {
        let relaxed = relax(&surface, Relaxation::default(), &Control::default()).unwrap();
        assert_eq!((relaxed.cuts.len(), &relaxed.surface), (0, &surface));
    }
}

#[test]
fn a_sphere_is_opened_and_relaxed_and_earlier_cuts_stay() {
    let sphere = shapes::surface(shapes::sphere(4));
    let opened = open_to_disk(&sphere, &Control::default()).unwrap();
    let relaxed = relax(&opened.surface, Relaxation::default(), &Control::default()).unwrap();
    assert!(!relaxed.cuts.is_empty());
    assert_cut(&opened.surface, &relaxed);
    let seams = opened.surface.twins().iter().zip(relaxed.surface.twins());
    assert!(seams.filter(|(before, _)| **before == u32::MAX).all(|(_, after)| *after == u32::MAX));
}

#[test]
fn what_is_too_small_or_no_disk_or_not_wanted() {
    let triangle = shapes::surface(shapes::sheet(1, 1)).part(&[true, false]);
    assert_eq!(relaxed(&triangle, 9.0, 0.0).surface, triangle);
    let cap = cap(0.0);
    assert_eq!(relaxed(&cap, 0.0, 0.0).surface, cap);
    assert_eq!(relaxed(&cap, 1e-3, 0.0).surface, cap);
    let control = Control::default();
    let closed = relax(&shapes::surface(shapes::sphere(2)), Relaxation::default(), &control);
    assert!(matches!(closed, Err(Error::NotADisk { .. })));
    let usual = Relaxation::default();
    let refuses = |refused: Relaxation| {
        assert!(matches!(relax(&cap, refused, &control), Err(Error::RelaxationOption { .. })), "{refused:?}");
    };
    for wrong in [f64::NAN, -1.0] {
        refuses(Relaxation { length: wrong, ..usual });
        refuses(Relaxation { least_gain: wrong, ..usual });
        refuses(Relaxation { bearable: wrong, ..usual });
        refuses(Relaxation { within: wrong, ..usual });
        refuses(Relaxation { least_relief: if wrong < 0.0 { 1.1 } else { wrong }, ..usual });
    }
}

#[test]
fn cuts_may_be_kept_near_those_that_are_there() {
    let control = Control::default();
    let open = open_to_disk(&shapes::surface(shapes::sphere(4)), &control).unwrap().surface;
    let within = |within| relax(&open, Relaxation { within, length: 2.0, ..Relaxation::default() }, &control).unwrap();
    let distances = from_sides(&open, &control).unwrap();
    let farthest = |relaxed: &Relaxed| {
        let vertices = relaxed.cuts.iter().flat_map(|cut| &cut.vertices);
        vertices.map(|&v| distances[v as usize]).fold(0.0, f64::max)
    };
    let (near, free) = (within(0.4), within(f64::INFINITY));
    assert!((0.1..=0.4).contains(&farthest(&near)), "{}", farthest(&near));
    assert!(farthest(&free) > 0.6);
    assert_cut(&open, &near);
    assert!(within(0.0).cuts.is_empty());
}
