use super::*;
use crate::orient::map_area;
use crate::surface::decimate::{Decimation, Options, decimate};
use crate::surface::{Surface, mesh::shapes};
use crate::tests::flipped;
use proptest::prelude::*;

fn decimated(surface: &Surface, vertices: usize) -> Decimation {
    let options = Options { vertices, ..Options::default() };
    decimate(surface, &[], &options, &Control::default()).unwrap()
}

/// Extends a map of the survivors to all vertices; returns it with the number of flipped triangles.
fn carried(
    found: &Decimation, vertices: usize, map: impl Fn(u32) -> [f64; 2], is_mirrored: bool,
) -> (Vec<[f64; 2]>, usize) {
    let mut uv = vec![[f64::NAN; 2]; vertices];
    found.survivors.iter().for_each(|&v| uv[v as usize] = map(v));
    let turned =
        place(&found.removals, &mut uv, &Placing { is_mirrored, ..Default::default() }, &Control::default()).unwrap();
    (uv, turned)
}

/// Returns a plane grid in space whose inner vertices are moved at random, without flipping a triangle.
fn jittered(side: usize, moves: &[[f64; 2]]) -> Surface {
    let (points, faces) = shapes::sheet(side, side);
    let moved = points.iter().zip(moves).map(|(&[x, y, _], [dx, dy])| {
        let [x, y] = [(x, dx), (y, dy)].map(|(x, d)| if x == 0.0 || x == side as f64 { x } else { x + 0.24 * d });
        [x, 0.6 * y + 3.0, 0.8 * y]
    });
    shapes::surface((moved.collect(), faces))
}

fn in_plane(surface: &Surface, v: usize) -> [f64; 2] {
    let p = surface.points()[v];
    [p.x, 0.6 * (p.y - 3.0) + 0.8 * p.z]
}

fn worst(uv: &[[f64; 2]], truth: impl Fn(usize) -> [f64; 2]) -> f64 {
    let apart = |(v, at): (usize, &[f64; 2])| (at[0] - truth(v)[0]).hypot(at[1] - truth(v)[1]);
    uv.iter().enumerate().map(apart).fold(0.0, f64::max)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn a_plane_comes_back_in_its_own_places(
        moves in prop::collection::vec(prop::array::uniform2(-1.0f64..1.0), 196), vertices in 4usize..150,
    ) {
        let surface = jittered(13, &moves);
        let found = decimated(&surface, vertices);
        let (uv, turned) = carried(&found, surface.len(), |v| in_plane(&surface, v as usize), false);
        prop_assert_eq!(turned, 0);
        prop_assert!(worst(&uv, |v| in_plane(&surface, v)) < 1e-9);
        let mirror = |[x, y]: [f64; 2]| [x, 7.0 - y];
        let (uv, _) = carried(&found, surface.len(), |v| mirror(in_plane(&surface, v as usize)), true);
        prop_assert!(worst(&uv, |v| mirror(in_plane(&surface, v))) < 1e-9);
    }

    #[test]
    fn a_map_without_flips_stays_one(
        moves in prop::collection::vec(prop::array::uniform2(-1.0f64..1.0), 196),
        elsewhere in prop::collection::vec(prop::array::uniform2(-1.0f64..1.0), 196),
        vertices in 4usize..150,
    ) {
        // the survivors move far, but without flipping a triangle
        let surface = jittered(13, &moves);
        let found = decimated(&surface, vertices);
        let away = |v: u32, by: f64| {
            let ([x, y], [dx, dy]) = (in_plane(&surface, v as usize), elsewhere[v as usize]);
            [2.0 * x + 0.3 * y + by * dx, y + by * dy]
        };
        let is_flat = |by: f64| found.surface.faces().iter().all(|face| {
            let uv = face.map(|v| away(found.survivors[v as usize], by));
            map_area(&[[0, 1, 2]], &uv) > 1e-3
        });
        let Some(by) = [4.0, 2.0, 1.0, 0.5, 0.2, 0.1].into_iter().find(|&by| is_flat(by)) else { return Ok(()) };
        let (uv, turned) = carried(&found, surface.len(), |v| away(v, by), false);
        prop_assert_eq!((turned, flipped(&surface, &uv)), (0, 0));
    }
}

#[test]
fn a_coarse_map_that_folds_is_told() {
    let surface = shapes::surface(shapes::sheet(12, 12));
    let found = decimated(&surface, 40);
    let fold = |v: u32| {
        let p = surface.points()[v as usize];
        [(p.x - 6.0).abs(), p.y]
    };
    let (uv, turned) = carried(&found, surface.len(), fold, false);
    assert!(turned > 0 && uv.iter().flatten().all(|x| x.is_finite()));
}

#[test]
fn what_lies_outside_is_placed_half_way_between_the_middle_and_the_border() {
    let square = [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]].map(Place::from);
    for (outside, expected) in [([5.0, 1.0], [1.5, 1.0]), ([1.0, -7.0], [1.0, 0.5]), ([3.0, 3.0], [1.5, 1.5])] {
        assert!((inside(&square, outside.into()) - Place::from(expected)).norm() < 1e-12, "{outside:?}");
    }
}
