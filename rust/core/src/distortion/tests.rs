//! Figures against their definitions.

use super::*;
use proptest::prelude::*;

use crate::rows::DistanceRows;
use crate::tests::with_threads;

pub(super) fn grid(w: u32, h: u32) -> (Vec<[f64; 2]>, Vec<[u32; 3]>) {
    let uv = (0..(w + 1) * (h + 1)).map(|n| [f64::from(n % (w + 1)), f64::from(n / (w + 1))]).collect();
    let square = |n: u32| {
        let corner = n / w * (w + 1) + n % w;
        let [a, b, c, d] = [corner, corner + 1, corner + w + 1, corner + w + 2];
        if n.is_multiple_of(3) { [[a, b, c], [b, d, c]] } else { [[a, b, d], [a, d, c]] }
    };
    (uv, (0..w * h).flat_map(square).collect())
}

fn rows_of(sources: &[u32], points: &[[f64; 2]], wrong: impl Fn(usize, usize) -> f64) -> DistanceRows {
    let (points, wrong) = (&points, &wrong);
    let row = |&source: &u32| {
        let [x, y] = points[source as usize];
        let distance = move |(n, &[u, v]): (usize, &[f64; 2])| {
            (x - u).hypot(y - v) * if n == source as usize { 0.0 } else { wrong(source as usize, n) }
        };
        points.iter().enumerate().map(distance).map(|d| d as f32).collect::<Vec<f32>>()
    };
    DistanceRows::new(sources.to_vec(), points.len(), sources.iter().flat_map(row).collect())
}

fn evaluated(uv: &[[f64; 2]], rows: &DistanceRows) -> Distortion {
    evaluated_in(Bands::default(), uv, rows, false)
}

fn evaluated_in(bands: Bands, uv: &[[f64; 2]], rows: &DistanceRows, are_marked: bool) -> Distortion {
    measure(&[uv], None, rows, are_marked, Evaluation { bands, seed: 0 }, &Control::default()).unwrap().remove(0)
}

fn pairs(uv: &[[f64; 2]], rows: &DistanceRows) -> Vec<(f64, f64)> {
    let mut pairs = Vec::new();
    for (n, &source) in rows.sources().iter().enumerate() {
        for (point, place) in uv.iter().enumerate().filter(|&(point, _)| point != source as usize) {
            let [x, y] = uv[source as usize];
            pairs.push((f64::from(rows.row(n)[point]), (place[0] - x).hypot(place[1] - y)));
        }
    }
    pairs
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let values: Vec<f64> = values.collect();
    values.iter().sum::<f64>() / values.len() as f64
}

fn places() -> impl Strategy<Value = Vec<[f64; 2]>> {
    prop::collection::vec(prop::array::uniform2(-40.0..40.0f64), 12..30)
}

proptest! {
    #[test]
    fn figures_follow_their_definitions(uv in places(), stretch in 0.5..2.0f64, size in 0.2..2.0f64) {
        let rows = rows_of(&[0, 3, 7, 11], &uv, |a, b| stretch * (1.0 + 0.3 * ((a * 31 + b * 17) as f64).sin()));
        let distortion = evaluated_in(Bands([5.0, 10.0, 15.0, 30.0].map(|end| size * end)), &uv, &rows, false);
        let pairs = pairs(&uv, &rows);
        let close = |a: f64, b: f64| (a - b).abs() < 1e-9 || (a.is_nan() && b.is_nan());
        for figures in [distortion.raw, distortion.best_scale] {
            let s = figures.scale;
            let band = |low: f64, high: f64| {
                mean(pairs.iter().filter(|p| size * low < p.0 && p.0 <= size * high).map(|&(x, d)| (s * d - x).abs() / x))
            };
            prop_assert!(close(figures.relative_error, band(0.0, f64::INFINITY)));
            prop_assert!(close(figures.relative_error_0_5mm, band(0.0, 5.0)));
            prop_assert!(close(figures.relative_error_5_15mm, band(5.0, 15.0)));
            prop_assert!(close(figures.relative_error_15_30mm, band(15.0, 30.0)));
            prop_assert!(close(figures.relative_error_10mm, band(0.0, 10.0)));
            prop_assert!(close(figures.relative_error_30mm, band(0.0, 30.0)));
            prop_assert!(close(figures.absolute_error, mean(pairs.iter().map(|&(x, d)| (s * d - x).abs()))));
            let squares: f64 = pairs.iter().map(|&(x, d)| (s * d - x).powi(2)).sum();
            let sammon: f64 = pairs.iter().map(|&(x, d)| (s * d - x).powi(2) / x).sum();
            let total: f64 = pairs.iter().map(|p| p.0).sum();
            prop_assert!(close(figures.stress_1, (squares / pairs.iter().map(|p| p.0 * p.0).sum::<f64>()).sqrt()));
            prop_assert!(close(figures.sammon_stress, sammon / total));
        }
        prop_assert_eq!((distortion.raw.scale, distortion.pairs), (1.0, pairs.len()));
        prop_assert!(close(distortion.mean_geodesic, mean(pairs.iter().map(|p| p.0))));
        let (md, mx) = (mean(pairs.iter().map(|p| p.1)), mean(pairs.iter().map(|p| p.0)));
        let product = |f: &dyn Fn(&(f64, f64)) -> f64| pairs.iter().map(f).sum::<f64>();
        let r = product(&|p| (p.0 - mx) * (p.1 - md))
            / (product(&|p| (p.0 - mx).powi(2)) * product(&|p| (p.1 - md).powi(2))).sqrt();
        prop_assert!((distortion.pearson_r - r).abs() < 1e-9);
    }

    #[test]
    fn figures_do_not_depend_on_the_unit(uv in places(), power in -40..40i32) {
        let factor = f64::from(power).exp2();
        let rows = rows_of(&[0, 3, 7], &uv, |a, b| 1.0 + 0.3 * ((a * 31 + b * 17) as f64).sin());
        let scaled: Vec<f32> = (0..3).flat_map(|n| rows.row(n)).map(|distance| distance * factor as f32).collect();
        let scaled = DistanceRows::new(rows.sources().to_vec(), uv.len(), scaled);
        let places: Vec<[f64; 2]> = uv.iter().map(|place| place.map(|x| factor * x)).collect();
        let bands = Bands([4.0, 9.0, 16.0, 25.0]);
        let one = evaluated_in(bands, &uv, &rows, true);
        let other = evaluated_in(Bands(bands.0.map(|end| factor * end)), &places, &scaled, true);
        let bits = |of: &Distortion, unit: f64| {
            let all = [of.raw, of.best_scale, of.interior, of.standard_error.raw, of.standard_error.best_scale];
            let in_unit = |figures: Figures| Figures { absolute_error: figures.absolute_error / unit, ..figures };
            all.map(in_unit).iter().flat_map(Figures::named).map(|(_, value)| value.to_bits()).collect::<Vec<u64>>()
        };
        prop_assert_eq!(bits(&one, 1.0), bits(&other, factor));
    }

    #[test]
    fn no_scale_is_better_than_the_best(uv in places(), stretch in 0.2..5.0f64) {
        let rows = rows_of(&[0, 5, 9], &uv, |a, b| stretch * (1.0 + 0.4 * ((a * 7 + b * 13) as f64).sin()));
        let best = evaluated(&uv, &rows).best_scale;
        let pairs = pairs(&uv, &rows);
        let error = |s: f64| mean(pairs.iter().map(|&(x, d)| (s * d - x).abs() / x));
        // the objective is convex and piecewise linear: its least value is at one of its kinks
        let least = pairs.iter().map(|&(x, d)| error(x / d)).fold(f64::INFINITY, f64::min);
        prop_assert!(best.relative_error <= least + 1e-6, "{} > {}", best.relative_error, least);
    }

    #[test]
    fn points_have_the_mean_of_their_pairs(uv in places()) {
        let sources = [0, 4, 8];
        let rows = rows_of(&sources, &uv, |a, b| 1.0 + 0.2 * ((a + 3 * b) as f64).cos());
        let distortion = evaluated(&uv, &rows);
        for (point, &value) in distortion.per_point.iter().enumerate() {
            let errors = sources.iter().enumerate().filter(|&(_, &s)| s as usize != point).map(|(n, &s)| {
                let delta = f64::from(rows.row(n)[point]);
                let [x, y] = uv[s as usize];
                ((uv[point][0] - x).hypot(uv[point][1] - y) - delta).abs() / delta
            });
            prop_assert!((value - mean(errors)).abs() < 1e-12);
        }
    }
}

#[test]
fn a_perfect_map_has_no_error_and_a_scaled_one_only_its_scale() {
    let uv: Vec<[f64; 2]> = (0..50).map(|n| [f64::from(n % 7) * 3.0, f64::from(n / 7) * 2.0]).collect();
    let rows = rows_of(&[0, 20, 40], &uv, |_, _| 1.0);
    let perfect = evaluated(&uv, &rows);
    assert!(perfect.raw.relative_error < 1e-6 && (perfect.best_scale.scale - 1.0).abs() < 1e-6);
    assert!(perfect.scatter.iter().all(|[delta, d]| (delta - d).abs() < 1e-5 && *delta > 0.0));
    let doubled: Vec<[f64; 2]> = uv.iter().map(|p| p.map(|x| 2.0 * x)).collect();
    let scaled = evaluated(&doubled, &rows);
    assert!((scaled.raw.relative_error - 1.0).abs() < 1e-6);
    assert!((scaled.best_scale.scale - 0.5).abs() < 1e-6 && scaled.best_scale.relative_error < 1e-6);
}

#[test]
fn points_at_no_distance_from_each_other_are_left_out() {
    let uv = [[0.0, 0.0], [1.0, 0.0], [3.0, 0.0], [7.0, 2.0]];
    let apart = rows_of(&[0, 2], &uv[..3], |_, _| 2.0);
    // the last one coincides with the first one on the surface, but not in the map
    let rows: Vec<f32> = [0, 1].iter().flat_map(|&n| [apart.row(n), &[apart.row(n)[0]]].concat()).collect();
    let found = evaluated(&uv, &DistanceRows::new(vec![0, 2], 4, rows));
    assert_eq!((found.pairs, found.per_point[3]), (5, found.per_point[3].abs()));
    let figures = [found.raw, found.best_scale];
    assert!(figures.iter().all(|f| f.scale > 0.0 && f.relative_error.is_finite() && f.sammon_stress.is_finite()));
    assert!(found.per_point.iter().all(|error| error.is_finite()));
    // without positive distances, nothing is defined
    let none = evaluated(&uv[..2], &DistanceRows::new(vec![0], 2, vec![0.0, 0.0]));
    assert!(none.raw.relative_error.is_nan() && none.best_scale.scale.is_nan() && none.pairs == 0);
}

#[test]
fn undefined_figures_are_nan() {
    let uv = [[0.0, 0.0], [50.0, 0.0], [0.0, 60.0]];
    let rows = rows_of(&[0], &uv, |_, _| 1.0);
    let distortion = evaluated(&uv, &rows);
    assert!(distortion.raw.relative_error_10mm.is_nan() && distortion.raw.relative_error_30mm.is_nan());
    assert!(distortion.per_point[0].is_nan() && !distortion.per_point[1].is_nan());
}

/// Rows that are passed a few at a time.
struct Few<'a>(&'a DistanceRows, usize);

impl Rows for Few<'_> {
    fn sources(&self) -> &[u32] {
        self.0.sources()
    }

    fn columns(&self) -> usize {
        self.0.columns()
    }

    fn visit(&self, _: &Control, visit: &mut dyn FnMut(usize, &[f32]) -> Result<()>) -> Result<()> {
        (0..self.sources().len()).step_by(self.1).try_for_each(|first| {
            let end = self.sources().len().min(first + self.1);
            let rows: Vec<f32> = (first..end).flat_map(|n| self.0.row(n).to_vec()).collect();
            visit(first, &rows)
        })
    }
}

/// Compares figures bit by bit; NaN equals NaN.
fn same(a: &Distortion, b: &Distortion) -> bool {
    format!("{a:?}") == format!("{b:?}")
}

fn scattered(count: u32) -> Vec<[f64; 2]> {
    let turn = |n: u32, step: f64| 40.0 * (f64::from(n) * step).fract();
    (0..count).map(|n| [turn(n, 0.618_033_988), turn(n, 0.754_877_666)]).collect()
}

fn uneven(a: usize, b: usize) -> f64 {
    1.0 + 0.3 * ((a * 31 + b * 17) as f64).sin() + 0.2 * (a as f64).cos()
}

#[test]
fn blocks_threads_and_other_maps_change_no_bit() {
    let uv = scattered(5000);
    let other: Vec<[f64; 2]> = uv.iter().map(|[x, y]| [3.0 * x, y + 0.1 * x]).collect();
    let sources: Vec<u32> = (0..37).map(|n| n * 101).collect();
    let rows = rows_of(&sources, &uv, uneven);
    let (expected, alone) = (evaluated(&uv, &rows), evaluated(&other, &rows));
    assert!(!same(&expected, &alone));
    let errors = pairs(&uv, &rows).iter().map(|(delta, d)| (d - delta).abs() / delta).collect::<Vec<f64>>();
    for point in [1, 4095, 4096, 4999] {
        // no source, so that it is one of 4,999 others of each
        let others =
            errors.chunks(4999).zip(&sources).map(|(row, &source)| row[point - usize::from(point > source as usize)]);
        assert!((expected.per_point[point] - mean(others)).abs() < 1e-12, "{point}");
    }
    for (threads, block) in [(1, 1), (2, 5), (5, 37), (3, 64)] {
        let maps: [&[[f64; 2]]; 2] = [&other, &uv];
        let found = with_threads(threads, || {
            measure(&maps, None, &Few(&rows, block), false, Evaluation::default(), &Control::default()).unwrap()
        });
        assert!(same(&found[1], &expected));
        assert!(same(&found[0], &alone));
    }
}

#[test]
fn standard_errors_are_those_of_theory() {
    // all sources have equally many pairs: the relative error is the mean of the sources' means
    let uv = scattered(200);
    for count in [4, 100] {
        let sources: Vec<u32> = (0..count).map(|n| 2 * n).collect();
        let rows = rows_of(&sources, &uv, uneven);
        let found = evaluated(&uv, &rows);
        let errors: Vec<f64> = pairs(&uv, &rows).iter().map(|(x, d)| (d - x).abs() / x).collect();
        let means: Vec<f64> = errors.chunks(199).map(|of_source| mean(of_source.iter().copied())).collect();
        let (all, n) = (mean(means.iter().copied()), f64::from(count));
        let variance = means.iter().map(|x| (x - all).powi(2)).sum::<f64>() / (n - 1.0);
        let theory = (variance / n * (1.0 - n / 200.0)).sqrt();
        assert!((found.standard_error.raw.relative_error / theory - 1.0).abs() < 0.08);
        let again = evaluated(&uv, &rows).standard_error.raw;
        assert_eq!(again.stress_1.to_bits(), found.standard_error.raw.stress_1.to_bits());
    }
}

#[test]
fn standard_errors_of_all_points_and_of_one_source() {
    let uv = scattered(30);
    let all = evaluated(&uv, &rows_of(&(0..30).collect::<Vec<u32>>(), &uv, uneven)).standard_error;
    assert_eq!((all.raw.relative_error, all.best_scale.stress_1, all.pearson_r), (0.0, 0.0, 0.0));
    let one = evaluated(&uv, &rows_of(&[4], &uv, uneven)).standard_error;
    assert!(one.raw.relative_error.is_nan() && one.mean_geodesic.is_nan());
}

#[test]
fn a_map_in_one_place_has_no_best_scale() {
    let uv = scattered(30);
    let found = evaluated(&[[1.0, 2.0]; 30], &rows_of(&[3, 4], &uv, |_, _| 1.0));
    assert_eq!(found.raw.relative_error, 1.0);
    assert!(found.best_scale.scale.is_nan() && found.best_scale.stress_1.is_nan() && found.pearson_r.is_nan());
}

#[test]
fn the_best_scale_alone_is_that_of_the_figures() {
    let uv = scattered(200);
    // the first source is far off: ratios must be counted again elsewhere
    for first in [3.0, 50.0, 0.3] {
        let sources: Vec<u32> = (0..20).map(|n| 7 * n).collect();
        let rows = rows_of(&sources, &uv, |a, b| uneven(a, b) * if a == 0 { first } else { 3.0 });
        let marked = measure(&[&uv], None, &rows, true, Evaluation::default(), &Control::default()).unwrap().remove(0);
        let scale = marked.interior.scale;
        assert!((1.0..5.0).contains(&scale), "{scale}");
        for block in [1, 6, 20] {
            assert_eq!(best_scale(&uv, None, &Few(&rows, block), &Control::default()), Ok(scale), "{first} {block}");
        }
    }
    let one = vec![[1.0, 2.0]; 30];
    assert!(best_scale(&one, None, &rows_of(&[3], &scattered(30), |_, _| 1.0), &Control::default()).unwrap().is_nan());
}

#[test]
fn distances_of_a_periodic_map_are_those_to_the_nearest_copy() {
    let period = 7.5;
    let uv: Vec<[f64; 2]> = (0..40).map(f64::from).map(|n| [(0.7 * n).sin() * 9.0, (1.3 * n).cos() * 20.0]).collect();
    let nearest = |a: [f64; 2], b: [f64; 2]| {
        let copies = (-9..=9).map(|turns| (a[0] - b[0]).hypot(a[1] - b[1] + f64::from(turns) * period));
        copies.fold(f64::INFINITY, f64::min)
    };
    let sources = [0, 5, 17];
    let uv = &uv;
    let row = |&source: &u32| uv.iter().map(|&place| nearest(uv[source as usize], place) as f32).collect::<Vec<_>>();
    let rows = DistanceRows::new(sources.to_vec(), uv.len(), sources.iter().flat_map(row).collect());
    let found =
        measure(&[uv], Some(period), &rows, false, Evaluation::default(), &Control::default()).unwrap().remove(0);
    assert!(found.raw.relative_error < 1e-6 && found.per_point.iter().all(|error| *error < 1e-6));
    assert!(found.scatter.iter().all(|[delta, d]| (delta - d).abs() < 1e-5));
    assert!((best_scale(uv, Some(period), &rows, &Control::default()).unwrap() - 1.0).abs() < 1e-5);
    assert!(evaluated(uv, &rows).raw.relative_error > 0.1);
}
