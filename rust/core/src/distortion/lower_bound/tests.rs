use super::*;
use proptest::prelude::*;
use rand::Rng;

/// Returns the distances between random points of a cap of a unit sphere, and the points as polar angle and longitude.
fn cap(polar: f64, count: usize, seed: u64) -> (Table, Vec<[f64; 2]>) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut random =
        || [(1.0 - rng.random::<f64>() * (1.0 - polar.cos())).acos(), rng.random::<f64>() * std::f64::consts::TAU];
    let points: Vec<[f64; 2]> = (0..count).map(|_| random()).collect();
    let cosine = |[s, a]: [f64; 2], [t, b]: [f64; 2]| s.cos() * t.cos() + s.sin() * t.sin() * (a - b).cos();
    let apart = |n| if n / count == n % count { 0.0 } else { cosine(points[n / count], points[n % count]).acos() };
    (Table { count, distances: (0..count * count).map(apart).collect() }, points)
}

fn distance([x, y]: [f64; 2], [u, v]: [f64; 2]) -> f64 {
    (x - u).hypot(y - v)
}

fn errors(table: &Table, map: &[[f64; 2]]) -> Vec<f64> {
    let pairs = (0..table.count).flat_map(|i| (i + 1..table.count).map(move |j| (i, j)));
    pairs.map(|(i, j)| distance(map[i], map[j]) / table.at(i, j) - 1.0).collect()
}

fn value(one: &Inequality, errors: &[f64]) -> f64 {
    let parts = one.weights().enumerate().map(|(n, (pair, weight))| {
        let error = if n % 2 == 0 { errors[pair / 2] } else { -errors[pair / 2] };
        weight * error.max(0.0)
    });
    parts.sum()
}

/// Places four points such that five distances are changed by given errors; None if they cannot be.
fn placed(table: &Table, changes: [f64; 5], side: f64) -> Option<[[f64; 2]; 4]> {
    let changed = |i, j, n: usize| table.at(i, j) * (1.0 + changes[n]);
    let base = changed(0, 1, 0);
    let place = |near: f64, far: f64| {
        let x = (base * base + near * near - far * far) / (2.0 * base);
        (near > x.abs()).then(|| [x, (near * near - x * x).sqrt()])
    };
    let (c, [u, v]) = (place(changed(0, 2, 1), changed(1, 2, 2))?, place(changed(0, 3, 3), changed(1, 3, 4))?);
    Some([[0.0, 0.0], [base, 0.0], c, [u, side * v]])
}

proptest! {
    #[test]
    fn no_four_points_of_the_plane_violate_an_inequality(
        seed: u64, polar in 0.2..3.1, changes in prop::array::uniform5(-0.3..0.3), size in 0.0..1.0, up: bool,
    ) {
        let (table, _) = cap(polar, 4, seed);
        let mut found = Vec::new();
        table.inequalities([0, 1, 2, 3], &mut found);
        prop_assert!(found.len() <= most_inequalities(4));
        if let Some(map) = placed(&table, changes.map(|r: f64| r * size), if up { 1.0 } else { -1.0 }) {
            for one in &found {
                prop_assert!(value(one, &errors(&table, &map)) >= 1.0);
            }
        }
    }

    #[test]
    fn no_map_has_an_error_below_the_bound(seed: u64, polar in 0.2..3.0, noise in 0.0..1.0) {
        let (table, points) = cap(polar, 12, seed);
        let bound = table.lower_bound(&Control::default()).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut near = |x: f64| x + noise * (rng.random::<f64>() - 0.5);
        let map: Vec<[f64; 2]> = points.iter().map(|[s, a]| [near(s * a.cos()), near(s * a.sin())]).collect();
        for scale in [0.9, 1.0, 1.1] {
            let of = |[x, y]: [f64; 2]| [scale * x, scale * y];
            let errors = errors(&table, &map.iter().copied().map(of).collect::<Vec<_>>());
            prop_assert!(bound <= errors.iter().map(|r| r.abs()).sum::<f64>() / errors.len() as f64);
        }
    }
}

#[test]
fn a_distance_that_alone_repairs_four_points_reaches_the_bound() {
    let (mut inside, mut outside) = (0, 0);
    for seed in 0..100 {
        let (table, _) = cap(1.0, 4, seed);
        let mut found = Vec::new();
        table.inequalities([0, 1, 2, 3], &mut found);
        let repaired = [1.0, -1.0].map(|side| placed(&table, [0.0; 5], side).unwrap());
        let values = |one| repaired.map(|map| value(one, &errors(&table, &map)));
        let least = found.iter().flat_map(values).fold(f64::INFINITY, f64::min);
        *if found.len() == 1 { &mut inside } else { &mut outside } += 1;
        assert!(found.is_empty() || (1.0..1.3).contains(&least), "{seed}: {least}");
    }
    assert!(inside > 10 && outside > 10, "{inside}, {outside}");
}

#[test]
fn the_bound_of_a_plane_is_0_and_that_of_a_cap_is_half_of_the_error_of_a_map() {
    let (mut table, points) = cap(std::f64::consts::FRAC_PI_2, 50, 1);
    let map: Vec<[f64; 2]> = points.iter().map(|[s, a]| [s * a.cos(), s * a.sin()]).collect();
    let error = errors(&table, &map).iter().map(|r| r.abs()).sum::<f64>() / 1225.0;
    let bound = table.lower_bound(&Control::default()).unwrap();
    assert!(bound < error && bound > 0.4 * error, "{bound} {error}");
    table.distances = (0..2500).map(|n| distance(map[n / 50], map[n % 50])).collect();
    assert_eq!(table.lower_bound(&Control::default()).unwrap(), 0.0);
}

#[test]
fn a_packing_loads_no_pair_twice() {
    let one = |pairs| Inequality { pairs, up: [1.0; 6], down: [0.0, 0.5, 0.5, 0.5, 0.5, 0.5], factor: 0.0 };
    let disjoint = vec![one([0, 1, 2, 3, 4, 5]), one([6, 7, 8, 9, 10, 11])];
    let shared = vec![one([0, 1, 2, 3, 4, 5]), one([0, 7, 8, 9, 10, 11])];
    for (inequalities, expected) in [(disjoint, 2.0), (shared, 1.0), (Vec::new(), 0.0)] {
        let found = packing(inequalities, 12, &Control::default()).unwrap();
        assert!(found <= expected && found >= 0.97 * expected, "{found} of {expected}");
    }
}

#[test]
fn an_expectation_is_seldom_overestimated() {
    assert_eq!(expectation(&[0.3, 0.0]), 0.0);
    assert!((expectation(&[0.3; 100]) - 0.3 * DOUBT.powf(0.01)).abs() < 1e-12);
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut of_mean_1 = || if rng.random::<f64>() < 0.05 { 0.01 } else { 0.9995 / 0.95 };
    let too_high = (0..20_000).filter(|_| expectation(&[(); 100].map(|()| of_mean_1())) > 1.0).count();
    assert!(too_high < 200 && too_high > 0, "{too_high}"); // of 1 %
}
