use super::*;
use crate::surface::mesh::shapes;
use nalgebra::Vector2;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

const SHAPE: Shape = Shape { barrier: 0.2, area: 1.5, outlier: 0.3 };

fn shaken() -> (TriangleEnergy, Vec<Vector2<f64>>) {
    let surface = shapes::surface(shapes::sheet(8, 6));
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut by = || rng.random_range(-0.2..0.2);
    let uv = surface.points().iter().map(|p| p.xy() + Vector2::new(by(), by())).collect();
    (TriangleEnergy::new(&surface), uv)
}

#[test]
fn slope_and_bend_are_those_of_the_energy() {
    let (triangles, mut uv) = shaken();
    let at = |uv: &[Vector2<f64>], vertex: usize| {
        let mut local = Local::default();
        triangles.around(vertex).for_each(|(rest, corner)| local.add(rest, corner, uv, SHAPE));
        local
    };
    for vertex in [0, 7, 20, 31] {
        let here = at(&uv, vertex);
        for axis in 0..2 {
            let mut moved = |by: f64| {
                uv[vertex][axis] += by;
                let there = at(&uv, vertex);
                uv[vertex][axis] -= by;
                there
            };
            let (after, before) = (moved(1e-5), moved(-1e-5));
            let slope = (after.energy - before.energy) / 2e-5;
            let bend = (after.slope - before.slope) / 2e-5;
            assert!((slope - here.slope[axis]).abs() < 1e-6 * here.slope.norm(), "{slope} {}", here.slope);
            assert!((bend - here.bend.column(axis)).norm() < 1e-6 * here.bend.norm(), "{bend} {}", here.bend);
        }
    }
}

#[test]
fn a_triangle_of_hardly_any_area_grows_and_nothing_folds() {
    let (triangles, mut uv) = shaken();
    let (vertex, towards) = (20, 21);
    let way = uv[towards] - uv[vertex];
    let farthest = |uv: &[Vector2<f64>]| {
        let mut direction = vec![Vector2::zeros(); uv.len()];
        direction[vertex] = way;
        triangles.farthest_step(uv, &direction)
    };
    let almost = (1.0 - 1e-9) * farthest(&uv);
    uv[vertex] += almost * way;
    assert!(triangles.growths(&uv).iter().any(|&growth| growth < 1e-8));
    let before = triangles.energy(&uv, SHAPE);
    let start = uv.clone();
    let may_move: Vec<bool> = (0..uv.len()).map(|vertex| vertex != 7).collect();
    ease(&triangles, SHAPE, &may_move, &mut uv, &Control::default()).unwrap();
    assert!(triangles.growths(&uv).iter().all(|&growth| growth > 0.3));
    assert!(triangles.energy(&uv, SHAPE) < 0.1 * before);
    assert_eq!(uv[7], start[7]);
}
