use super::*;
use crate::adjacency::marked;
use crate::surface::mesh::BORDER;
use crate::surface::mesh::shapes;
use crate::surface::topology::Topology;
use crate::tests::assert_sound;
use proptest::prelude::*;

fn decimated(surface: &Surface, vertices: usize) -> Decimation {
    let options = Options { vertices, ..Options::default() };
    decimate(surface, &[], &options, &Control::default()).unwrap()
}

fn relief(side: usize, heights: &[f64]) -> Surface {
    let (points, faces) = shapes::sheet(side, side);
    let lifted = points.iter().zip(heights).map(|(&[x, y, _], z)| [x + 0.2 * z, y, *z]);
    shapes::surface((lifted.collect(), faces))
}

fn assert_right(surface: &Surface, found: &Decimation) {
    let Decimation { survivors, surface: coarse, removals } = found;
    assert_sound(coarse);
    assert_eq!(survivors.len() + removals.len(), surface.len());
    let [before, after] = [surface, coarse].map(Topology::of);
    assert_eq!((after.euler, after.loops.len()), (before.euler, before.loops.len()));
    assert_eq!(after.components.len(), before.components.len());
    assert_eq!(coarse.len(), survivors.len());
    for (n, &v) in survivors.iter().enumerate() {
        assert_eq!((coarse.points()[n], coarse.ids()[n]), (surface.points()[v as usize], surface.ids()[v as usize]));
    }
    let mut on_boundary = vec![false; surface.len()];
    surface.boundary().iter().flatten().for_each(|&h| on_boundary[surface.origin(h) as usize] = true);
    let mut is_known = marked(surface.len(), survivors);
    for removal in removals.iter().rev() {
        assert!(removal.neighbours.iter().all(|&v| is_known[v as usize]), "neighbours come back before");
        assert!(!std::mem::replace(&mut is_known[removal.vertex as usize], true));
        assert_eq!(removal.is_closed, !on_boundary[removal.vertex as usize]);
        assert_eq!(removal.neighbours.len(), removal.weights.len());
        let sum = removal.weights.iter().fold([0.0, 0.0], |[re, im], w| [re + w[0], im + w[1]]);
        assert!((sum[0] - 1.0).abs() < 1e-9 && sum[1].abs() < 1e-9);
        assert!(!removal.is_closed || removal.weights.iter().all(|w| w[0] > 0.0 && w[1] == 0.0));
    }
    let boundary = coarse.boundary();
    let mut stays_boundary = boundary.iter().flatten().map(|&h| survivors[coarse.origin(h) as usize]);
    assert!(stays_boundary.all(|v| on_boundary[v as usize]));
}

#[test]
fn known_shapes_keep_their_topology() {
    for (shape, vertices) in
        [(shapes::sheet(30, 20), 40), (shapes::torus(40, 24), 60), (shapes::sphere(4), 50), (shapes::sphere(4), 300)]
    {
        let surface = shapes::surface(shape);
        let found = decimated(&surface, vertices);
        assert_eq!(found.survivors.len(), vertices);
        assert_right(&surface, &found);
    }
}

#[test]
fn decimation_ends_at_the_smallest_surface() {
    for (shape, at_least) in [(shapes::sheet(9, 7), 3), (shapes::sphere(3), 4), (shapes::torus(20, 12), 7)] {
        let surface = shapes::surface(shape);
        let found = decimated(&surface, 0);
        assert_right(&surface, &found);
        assert!((at_least..30).contains(&found.survivors.len()), "{}", found.survivors.len());
    }
}

#[test]
fn an_annulus_and_several_components_are_kept_apart() {
    let (points, faces) = shapes::sheet(20, 20);
    let whole = shapes::surface((points, faces));
    let hole: Vec<bool> = whole.points().iter().map(|p| (p.x - 10.0).abs().max((p.y - 10.0).abs()) > 3.0).collect();
    let annulus = whole.part_of_vertices(&hole).unwrap();
    assert_right(&annulus, &decimated(&annulus, 12));
    let halves = whole.part_of_vertices(&whole.points().iter().map(|p| p.x != 10.0).collect::<Vec<_>>()).unwrap();
    assert_right(&halves, &decimated(&halves, 20));
}

#[test]
fn a_sphere_is_kept_round_and_its_edges_even() {
    let surface = shapes::surface(shapes::sphere(5));
    let found = decimated(&surface, 400);
    assert_right(&surface, &found);
    assert!(found.surface.normals().iter().zip(found.surface.points()).all(|(n, p)| n.dot(p) > 0.95));
    let mut lengths: Vec<f64> = found.surface.edges().map(|h| found.surface.length(h)).collect();
    lengths.sort_by(f64::total_cmp);
    assert!(lengths[lengths.len() - 1] < 5.0 * lengths[0], "{} {}", lengths[0], lengths[lengths.len() - 1]);
}

#[test]
fn a_plane_stays_where_it_is() {
    let surface = shapes::surface(shapes::sheet(24, 24));
    let found = decimated(&surface, 100);
    assert!((found.surface.areas().iter().sum::<f64>() - 576.0).abs() < 1e-9, "the corners of the sheet stay");
    assert!(found.surface.face_normals().iter().all(|n| n.z > 0.999));
}

#[test]
fn what_is_to_be_kept_stays() {
    let surface = shapes::surface(shapes::sphere(4));
    let keep: Vec<u32> = (0..40).map(|n| n * 17).collect();
    let options = Options { vertices: 60, ..Options::default() };
    let found = decimate(&surface, &keep, &options, &Control::default()).unwrap();
    assert_right(&surface, &found);
    assert!(keep.iter().all(|v| found.survivors.contains(v)));
    let refused = decimate(&surface, &[5000], &options, &Control::default()).unwrap_err();
    assert_eq!(refused, Error::NoSuchPoint { vertex: 5000, points: surface.len() });
}

#[test]
fn no_edge_becomes_too_long() {
    let surface = shapes::surface(shapes::sheet(30, 30));
    let options = Options { vertices: 0, longest_edge: 4.0, ..Options::default() };
    let found = decimate(&surface, &[], &options, &Control::default()).unwrap();
    assert!(found.surface.edges().all(|h| found.surface.length(h) <= 4.0));
    assert!((60..400).contains(&found.survivors.len()), "{}", found.survivors.len());
}

#[test]
fn the_error_of_a_position_is_its_distance_from_planes_by_area_and_from_borders() {
    let heights: Vec<f64> = (0..36).map(|n| (1.7 * f64::from(n)).sin()).collect();
    let surface = relief(5, &heights);
    let quadrics = quadric::of_vertices(&surface, surface.points());
    let place = Vector3::new(1.3, -0.4, 2.1);
    let mut expected = vec![0.0; surface.len()];
    for (f, face) in (0u32..).zip(surface.faces()) {
        let corners = face.map(|v| surface.points()[v as usize]);
        let normal = surface.face_normals()[f as usize];
        let off = (place - corners[0]).dot(&normal).powi(2) * surface.areas()[f as usize] / 3.0;
        face.iter().for_each(|&v| expected[v as usize] += off);
        for k in (0..3).filter(|k| surface.twins()[3 * f as usize + k] == BORDER) {
            let [a, b] = [corners[k], corners[(k + 1) % 3]];
            let off = (place - a).dot(&(b - a).cross(&normal)).powi(2); // of the distance times the length
            [face[k], face[(k + 1) % 3]].iter().for_each(|&v| expected[v as usize] += 2.0 * off);
        }
    }
    for (quadric, expected) in quadrics.iter().zip(expected) {
        assert!((quadric.at(place) / expected - 1.0).abs() < 1e-9, "{} {expected}", quadric.at(place));
    }
}

#[test]
fn no_face_turns_by_more_than_78_degrees_or_becomes_a_sliver() {
    // the apex (½, ½√3) above a side of length 1 moves to this place
    let is_sound = |start: [f64; 3], to: [f64; 3]| {
        let points = vec![start, [0.0; 3], [1.0, 0.0, 0.0], to];
        let surface = shapes::surface((points, vec![[0, 1, 2], [0, 2, 3]]));
        let options = Options::default();
        let work = Work::new(&surface, &[], &options);
        let mut ring = Ring::default();
        work.left.ring(0, &mut ring);
        assert_eq!(ring.vertices, [1, 2, 3]);
        work.stays_sound(0, [0, 1], 2, &ring)
    };
    let equilateral = [0.5, 0.75f64.sqrt(), 0.0];
    for (angle, expected) in [(0.0f64, true), (78.0, true), (79.0, false), (179.0, false)] {
        let (sin, cos) = angle.to_radians().sin_cos();
        assert_eq!(is_sound(equilateral, [0.6, 0.8 * cos, 0.8 * sin]), expected, "{angle}");
    }
    // 4 √3 · area / the sum of the squared sides is 0.15 if the height is 0.0653; a sliver may stay one
    assert!(is_sound(equilateral, [0.5, 0.066, 0.0]) && !is_sound(equilateral, [0.5, 0.064, 0.0]));
    assert!(is_sound([0.5, 0.02, 0.0], [0.5, 0.021, 0.0]) && !is_sound([0.5, 0.02, 0.0], [0.5, 0.019, 0.0]));
}

#[test]
fn bad_options_are_refused() {
    let surface = shapes::surface(shapes::sheet(3, 3));
    for (longest_edge, evenness) in
        [(0.0, 0.1), (-1.0, 0.1), (f64::NAN, 0.1), (1.0, f64::NAN), (1.0, -0.1), (1.0, f64::INFINITY)]
    {
        let options = Options { vertices: 4, longest_edge, evenness, any_shape: false };
        let refused = decimate(&surface, &[], &options, &Control::default()).unwrap_err();
        assert!(matches!(refused, Error::DecimationOption { .. }));
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn any_relief_keeps_its_topology(heights in prop::collection::vec(-1.5f64..1.5, 196), vertices in 3usize..150) {
        let surface = relief(13, &heights);
        let found = decimated(&surface, vertices);
        assert_right(&surface, &found);
        let again = decimated(&surface, vertices);
        prop_assert_eq!(found.removals, again.removals);
        prop_assert_eq!(found.surface, again.surface);
    }

    #[test]
    fn any_part_of_a_torus_keeps_its_topology(keep in prop::collection::vec(prop::bool::weighted(0.9), 480), vertices in 3usize..200) {
        let torus = shapes::surface(shapes::torus(20, 12));
        let part = torus.part(&keep);
        assert_right(&part, &decimated(&part, vertices));
    }
}
