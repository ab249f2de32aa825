use super::*;
use crate::surface::voxels::surfels::{Surfels, Touching};
use crate::tests::masks;
use proptest::prelude::*;
use std::collections::{BTreeSet, HashSet};

type Voxels = HashSet<[i64; 3]>;

const CUBE: [f64; 3] = [1.0; 3];

fn repaired(mask: &Mask) -> Repaired {
    to_genus_zero(mask, CUBE, None, &Control::default()).unwrap()
}

fn squared_norm(v: [i64; 3]) -> i64 {
    v.iter().map(|x| x * x).sum()
}

fn minus(a: [i64; 3], b: [i64; 3]) -> [i64; 3] {
    std::array::from_fn(|axis| a[axis] - b[axis])
}

fn ball(v: [usize; 3], centre: i64, radius: i64) -> bool {
    squared_norm(minus(v.map(|x| x as i64), [centre; 3])) <= radius * radius
}

/// Returns the number of pieces, by adding one voxel after the other and joining the pieces it touches. Two voxels touch
/// if their squared distance is at most `reach`: 1 through faces, 2 through edges, 3 through corners.
fn count_pieces(voxels: &Voxels, reach: i64) -> usize {
    let mut pieces: Vec<Vec<[i64; 3]>> = Vec::new();
    for &voxel in voxels {
        let touches = |piece: &Vec<_>| piece.iter().any(|&other| squared_norm(minus(voxel, other)) <= reach);
        let (touching, mut others): (Vec<_>, Vec<_>) = pieces.into_iter().partition(touches);
        others.push(touching.into_iter().flatten().chain([voxel]).collect());
        pieces = others;
    }
    pieces.len()
}

fn foreground(mask: &Mask) -> Voxels {
    mask.foreground().collect()
}

/// Returns the background of the volume and of one layer around it.
fn background(mask: &Mask) -> Voxels {
    let [ni, nj, nk] = mask.shape().map(|n| n as i64);
    let cells = (-1..=ni).flat_map(|i| (-1..=nj).flat_map(move |j| (-1..=nk).map(move |k| [i, j, k])));
    cells.filter(|&v| !mask.is_inside(v)).collect()
}

/// Returns vertices − edges + squares − cubes, plus one for each corner at which two background voxels only touch.
fn euler(voxels: &Voxels) -> i64 {
    let holds = |v: [i64; 3], offset: usize| {
        voxels.contains(&std::array::from_fn(|axis| v[axis] + (offset as i64 >> axis & 1)))
    };
    let mut sum = 0;
    for &v in voxels {
        for extent in 0..8usize {
            let full = (0..8).filter(|offset| offset & !extent == 0).all(|offset| holds(v, offset));
            sum += if !full { 0 } else { 1 - 2 * i64::from(extent.count_ones() % 2) };
        }
    }
    let blocks: HashSet<_> =
        voxels.iter().flat_map(|&v| (0..8).map(move |o: i64| minus(v, [o & 1, o >> 1 & 1, o >> 2]))).collect();
    for &v in &blocks {
        let missing: Vec<usize> = (0..8).filter(|&offset| !holds(v, offset)).collect();
        sum += i64::from(matches!(missing[..], [a, b] if a + b == 7));
    }
    sum
}

/// Checks for one component, one background and no handle; surfels form one closed surface of χ = 2.
fn assert_sphere(mask: &Mask) {
    let voxels = foreground(mask);
    assert_eq!((count_pieces(&voxels, 1), count_pieces(&background(mask), 2), euler(&voxels)), (1, 1, 1));
    let surfels = Surfels::new(mask, &crate::tests::voxels(mask, CUBE), Touching::Apart, &Control::default()).unwrap();
    let mut seen = BTreeSet::from([0]);
    let mut stack = vec![0];
    while let Some(surfel) = stack.pop() {
        stack.extend(surfels.neighbours(surfel).into_iter().flatten().filter(|&other| seen.insert(other)));
    }
    assert_eq!((seen.len(), surfels.euler()), (surfels.len(), 2));
}

fn assert_lists(mask: &Mask, repaired: &Repaired) {
    let set = |lists: [&Vec<[u32; 3]>; 2]| -> Voxels {
        let all: Vec<_> = lists.into_iter().flatten().map(|v| v.map(i64::from)).collect();
        let set = Voxels::from_iter(all.iter().copied());
        assert_eq!(set.len(), all.len());
        set
    };
    let (before, after) = (foreground(mask), foreground(&repaired.mask));
    assert_eq!(set([&repaired.cut, &repaired.dropped]), &before - &after);
    assert_eq!(set([&repaired.filled, &repaired.cavities]), &after - &before);
    for list in [&repaired.cut, &repaired.filled, &repaired.dropped, &repaired.cavities] {
        assert!(list.is_sorted());
    }
}

#[test]
fn a_ball_stays() {
    let mask = Mask::from_fn([21; 3], |v| ball(v, 10, 8)).unwrap();
    let repaired = repaired(&mask);
    assert_eq!((repaired.handles, repaired.considered), (0, [0, 0]));
    assert_eq!(foreground(&repaired.mask), foreground(&mask));
    assert_sphere(&mask);
}

#[test]
fn a_narrow_tunnel_is_filled_and_a_thin_handle_is_cut() {
    let tunnel = |v: [usize; 3]| v[0] == 10 && v[1] == 10;
    let wire = |v: [usize; 3]| {
        v[1] == 10 && (v[0] == 20 && (7..=13).contains(&v[2]) || v[0] > 10 && (v[2] == 7 || v[2] == 13))
    };
    let bored = Mask::from_fn([21; 3], |v| ball(v, 10, 8) && !tunnel(v)).unwrap();
    let wired = Mask::from_fn([21; 3], |v| ball(v, 10, 8) || wire(v)).unwrap();
    let both = Mask::from_fn([21; 3], |v| ball(v, 10, 8) && !tunnel(v) || wire(v)).unwrap();
    for (mask, handles, cut, filled) in [(bored, 1, 0, 1), (wired, 1, 1, 0), (both, 2, 1, 1)] {
        let repaired = repaired(&mask);
        assert_eq!((repaired.handles, repaired.cut.len(), repaired.filled.len()), (handles, cut, filled));
        assert!(repaired.filled.iter().all(|v| tunnel(v.map(|x| x as usize))));
        assert!(repaired.cut.iter().all(|v| wire(v.map(|x| x as usize))));
        assert_sphere(&repaired.mask);
        assert_lists(&mask, &repaired);
    }
}

#[test]
fn the_hole_of_a_torus_is_closed_where_it_is_narrower() {
    for (large, small) in [(9.0, 2.0), (5.0, 4.0)] {
        let mask = Mask::from_fn([30, 30, 15], |v| {
            let [x, y, z] = [v[0] as f64 - 15.0, v[1] as f64 - 15.0, v[2] as f64 - 7.0];
            (x.hypot(y) - large).hypot(z) < small
        });
        let mask = mask.unwrap();
        let repaired = repaired(&mask);
        let (is_cut, is_filled) = (!repaired.cut.is_empty(), !repaired.filled.is_empty());
        assert_eq!((repaired.handles, is_cut, is_filled), (1, large > 5.0, large <= 5.0));
        assert_sphere(&repaired.mask);
    }
}

#[test]
fn smaller_components_and_cavities_are_not_handles() {
    // a ball with two cavities, one of which holds a voxel; a speck beside it
    let hollow =
        |v: [usize; 3]| ball(v, 10, 8) && !ball(v, 10, 2) && v != [4, 10, 10] || v == [10, 10, 10] || v == [0, 0, 0];
    let mask = Mask::from_fn([21; 3], hollow).unwrap();
    let repaired = repaired(&mask);
    assert_eq!((repaired.handles, repaired.dropped.as_slice()), (0, &[[0, 0, 0]][..]));
    assert_eq!(repaired.cavities.len(), (0..5 * 5 * 5).filter(|n| ball([n / 25, n / 5 % 5, n % 5], 2, 2)).count());
    assert_sphere(&repaired.mask);
    assert_lists(&mask, &repaired);
}

#[test]
fn a_cut_goes_where_foreground_is_unlikely() {
    let mask = Mask::from_fn([9, 9, 3], |v| v[2] == 1 && (v[0] % 8 == 0 || v[1] % 8 == 0)).unwrap();
    for unlikely in [[3, 0, 1], [8, 5, 1]] {
        let index = |[i, j, k]: [usize; 3]| (i * 9 + j) * 3 + k;
        let mut probability = vec![1.0; 9 * 9 * 3];
        probability[index(unlikely)] = 0.25;
        probability[0] = f32::NAN;
        let repaired = to_genus_zero(&mask, CUBE, Some(&probability), &Control::default()).unwrap();
        assert_eq!((repaired.cut.as_slice(), repaired.filled.len()), (&[unlikely.map(|x| x as u32)][..], 0));
    }
}

#[test]
fn depth_is_measured_in_mm() {
    // a ring with two necks, one of three voxels along each axis: which is narrower, the spacing tells
    let mask = Mask::from_fn([24, 24, 9], |[i, j, _]| {
        let necks = [(i, j), (j, i)].map(|(across, along)| across < 5 && (10..13).contains(&along));
        let is_thin = |across: usize| (1..4).contains(&across);
        !((5..19).contains(&i) && (5..19).contains(&j)) && (!necks[0] || is_thin(i)) && (!necks[1] || is_thin(j))
    });
    let mask = mask.unwrap();
    for (spacing, along) in [([1.0, 4.0, 1.0], 1), ([4.0, 1.0, 1.0], 0), ([0.02, 0.005, 0.005], 0)] {
        let cut = to_genus_zero(&mask, spacing, None, &Control::default()).unwrap().cut;
        assert_eq!(cut.len(), 27);
        assert!(cut.iter().all(|v| (9..15).contains(&v[along])), "{spacing:?} {cut:?}");
    }
}

#[test]
fn wrong_input_is_refused() {
    let mask = Mask::from_fn([4; 3], |_| true).unwrap();
    let control = Control::default();
    let error = |spacing, probability, control| to_genus_zero(&mask, spacing, probability, control).unwrap_err();
    assert_eq!(error([1.0, -1.0, 1.0], None, &control), Error::SpacingNotPositive { axis: 1, spacing: -1.0 });
    let mismatch = Error::ShapeMismatch { shape: [4; 3], given: 1, needed: 64 };
    assert_eq!(error(CUBE, Some(&[0.5]), &control), mismatch);
}

/// Returns whether the voxels of `seeds` are connected in `voxels` by paths with a limited number of steps from a seed.
fn hang_together(seeds: &Voxels, voxels: &Voxels, reach: i64, steps: usize) -> bool {
    let mut near = seeds.clone();
    for _ in 1..steps {
        let next = |&&v: &&[i64; 3]| near.iter().any(|&n| squared_norm(minus(v, n)) <= reach);
        near = voxels.iter().filter(next).copied().collect();
    }
    !seeds.is_empty() && count_pieces(&near, reach) == 1
}

/// Applies the definition by geodesic neighbourhoods: of order 3 for 6⁺, of order 2 for 18.
fn is_simple_by_definition(block: &Voxels) -> bool {
    let cube = || (0..27).map(|n| [n / 9 - 1, n / 3 % 3 - 1, n % 3 - 1]).filter(|&v| v != [0; 3]);
    let foreground: Voxels = cube().filter(|v| block.contains(v)).collect();
    let background: Voxels = cube().filter(|v| !block.contains(v)).collect();
    let within = |set: &Voxels, most: i64| set.iter().filter(|&&v| squared_norm(v) <= most).copied().collect();
    hang_together(&within(&foreground, 1), &foreground, 1, 3)
        && hang_together(&within(&background, 2), &background, 2, 2)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]
    #[test]
    fn simple_voxels_are_those_of_the_definition(bits in 0u32..1 << 27, thin: u32, thick: bool) {
        let bits = if thick { bits | thin & AROUND } else { bits & thin };
        let place = |n: i64| [n / 9 - 1, n / 3 % 3 - 1, n % 3 - 1];
        let mut block: Voxels = (0..27).filter(|n| bits >> n & 1 == 1).map(place).collect();
        prop_assert_eq!(is_simple(bits), is_simple_by_definition(&block));
        prop_assert_eq!(is_simple(bits), is_simple(bits ^ 1 << 13));
        if is_simple(bits) {
            let topology = |block: &Voxels| {
                let cells = (0..125).map(|n| [n / 25 - 2, n / 5 % 5 - 2, n % 5 - 2]);
                let background = cells.filter(|v| !block.contains(v)).collect();
                (count_pieces(block, 1), count_pieces(&background, 2), euler(block))
            };
            block.insert([0; 3]);
            let with = topology(&block);
            block.remove(&[0; 3]);
            prop_assert_eq!(with, topology(&block));
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn any_volume_becomes_one_sphere(mask in masks([7; 3], 0.1..1.0), scale in 0.2..5.0) {
        let repaired = to_genus_zero(&mask, [1.0, scale, 1.0], None, &Control::default()).unwrap();
        assert_sphere(&repaired.mask);
        assert_lists(&mask, &repaired);
        let again = to_genus_zero(&repaired.mask, CUBE, None, &Control::default()).unwrap();
        prop_assert_eq!((again.handles, again.cut.len(), again.filled.len()), (0, 0, 0));
    }

    #[test]
    fn distances_are_exact(mask in masks([6; 3], 0.1..1.0), scale in prop::array::uniform3(0.1..4.0)) {
        let grid = Grid::around(mask.foreground(), &Control::default()).unwrap();
        let is_site = |cell: usize| mask.is_inside(grid.voxel(cell));
        let found = distances(&grid, scale, is_site, &Control::default()).unwrap();
        for (cell, found) in found.into_iter().enumerate() {
            let apart = |v: [i64; 3]| {
                let d = minus(v, grid.voxel(cell));
                (0..3).map(|axis| (d[axis] as f64 * scale[axis]).powi(2)).sum::<f64>().sqrt()
            };
            let nearest = mask.foreground().map(apart).fold(f64::INFINITY, f64::min);
            prop_assert!((f64::from(found) - nearest).abs() <= 1e-6 * nearest, "{} {}", found, nearest);
        }
    }
}
