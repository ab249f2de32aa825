//! Evaluation of maps by geodesic distances from reference sources.

use super::{Distortion, Evaluation, WORK_BYTES, measure};
use crate::geodesic::Solver;
use crate::rows::{DistanceRows, PassingRows};
use crate::{Control, Result, sources};

/// The number of reference sources for the distortion.
pub const REFERENCE_SOURCES: usize = 200;

/// The maximum memory in bytes for keeping the rows from reference sources when several maps are compared.
pub const KEPT_BYTES: u64 = 256 << 20;

/// Returns the maximum memory in bytes for evaluating a map of `points` points by [`REFERENCE_SOURCES`], and their
/// rows.
pub(crate) fn memory_need(points: usize) -> u64 {
    let (rows, of_points) = (4 * points.min(REFERENCE_SOURCES) as u64, 16);
    (rows + of_points) * points as u64 + WORK_BYTES
}

/// Evaluates a map by the distances from `count` random reference sources.
pub(crate) fn evaluate(
    solver: &impl Solver, uv: &[[f64; 2]], count: usize, evaluation: Evaluation, control: &Control,
) -> Result<Distortion> {
    let reference = reference_sources(uv.len(), count, evaluation.seed);
    Ok(evaluate_all(solver, &[uv], None, &reference, u64::MAX, evaluation, control)?.remove(0))
}

/// Returns random reference sources. They differ from the sources of a map with the same seed.
pub fn reference_sources(points: usize, count: usize, seed: u64) -> Vec<u32> {
    sources::random(points, points.min(count), seed.wrapping_add(1))
}

/// Evaluates several maps of the same vertices by the distances from the same sources. If the rows take more than
/// `kept` bytes, they are computed twice instead of being kept; the figures are the same. Maps may repeat in the second
/// direction with a period; distances are then those to the nearest copy.
///
/// # Errors
/// [`Error::NoSuchPoint`](crate::Error::NoSuchPoint) for a source, [`Error::WrongLength`](crate::Error::WrongLength) if
/// a map does not have one position per vertex, [`Error::Unreachable`](crate::Error::Unreachable) if the surface is not
/// connected, and the errors of the solver.
pub fn evaluate_all<S: Solver>(
    solver: &S, maps: &[&[[f64; 2]]], period: Option<f64>, reference: &[u32], kept: u64, evaluation: Evaluation,
    control: &Control,
) -> Result<Vec<Distortion>> {
    if 4 * reference.len() as u64 * solver.columns() as u64 <= kept {
        measure(
            maps,
            period,
            &DistanceRows::compute(solver, reference, control)?,
            solver.tells_bends(),
            evaluation,
            control,
        )
    } else {
        measure(maps, period, &PassingRows::new(solver, reference, kept), solver.tells_bends(), evaluation, control)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geodesic::exact::Exact;
    use crate::surface::mesh::shapes;
    use crate::tests::Altered;
    use std::sync::atomic::{AtomicUsize, Ordering};

    #[test]
    fn rows_that_are_not_kept_are_computed_twice_and_figures_are_the_same() {
        let (control, sheet) = (Control::default(), shapes::surface(shapes::sheet(6, 4)));
        let uv: Vec<[f64; 2]> = sheet.points().iter().map(|p| [1.1 * p.x, p.y]).collect();
        let squeezed: Vec<[f64; 2]> = sheet.points().iter().map(|p| [0.5 * p.x, p.y]).collect();
        let (reference, evaluation) = ([0, 7, 30], Evaluation { seed: 3, ..Evaluation::default() });
        let exact = Exact::new(&sheet);
        let evaluated = |kept| {
            let rows = AtomicUsize::new(0);
            let counting = Altered(&exact, |_: &mut [f32]| {
                rows.fetch_add(1, Ordering::Relaxed);
                Ok(())
            });
            let found =
                evaluate_all(&counting, &[&uv, &squeezed], None, &reference, kept, evaluation, &control).unwrap();
            (found, rows.into_inner())
        };
        let all = 4 * 3 * 35; // bytes of three rows to 35 points
        let (kept, rows) = evaluated(all);
        assert_eq!(rows, 3);
        assert!(kept.len() == 2 && kept[0].raw.relative_error < 0.1 && kept[1].raw.relative_error > 0.2);
        for bytes in [all - 1, 4 * 35, 0] {
            let (passed, rows) = evaluated(bytes);
            assert_eq!((format!("{passed:?}"), rows), (format!("{kept:?}"), 6), "{bytes}");
        }
        let alone = evaluate(&exact, &uv, 3, evaluation, &control).unwrap();
        let same = evaluate_all(&exact, &[&uv], None, &reference_sources(35, 3, 3), 0, evaluation, &control).unwrap();
        assert_eq!(format!("{alone:?}"), format!("{:?}", same[0]));
    }

    #[test]
    fn reference_sources_are_others_than_the_sources_of_a_map_with_the_same_seed() {
        for seed in [0, 1, 17, u64::MAX] {
            let (of_map, reference) = (sources::random(1000, 100, seed), reference_sources(1000, 100, seed));
            let both = reference.iter().filter(|source| of_map.contains(source)).count();
            assert!(reference.len() == 100 && both < 30, "{both}"); // ten if they are independent
        }
        assert_eq!(reference_sources(5, 100, 0), [0, 1, 2, 3, 4]);
    }
}
