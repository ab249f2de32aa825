//! Distances between groups of vertices, such as parcels, without keeping distance rows.

use crate::error::check_points;
use crate::geodesic::Solver;
use crate::parallel::in_turn;
use crate::rows::fill;
use crate::{Control, Result};

/// The distance between two groups.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Linkage {
    /// The mean over all pairs of a vertex of one group and a vertex of the other.
    Mean,
    /// The smallest distance between two such vertices.
    Least,
}

/// Returns the distances in mm between groups of vertices, row by row: from each group (row) to each group (column).
/// A group without vertices has the distance NaN by [`Linkage::Mean`], and otherwise infinity.
///
/// # Errors
/// [`Error::NoSuchPoint`](crate::Error::NoSuchPoint), [`Error::Unreachable`](crate::Error::Unreachable) if vertices lie
/// in different components, and the errors of the solver.
pub fn between<S: Solver>(solver: &S, groups: &[Vec<u32>], linkage: Linkage, control: &Control) -> Result<Vec<f64>> {
    check_points(groups.iter().flatten().copied(), solver.columns())?;
    match linkage {
        Linkage::Mean => means(solver, groups, control),
        Linkage::Least => least(solver, groups, control),
    }
}

fn means<S: Solver>(solver: &S, groups: &[Vec<u32>], control: &Control) -> Result<Vec<f64>> {
    let members: Vec<u32> = groups.iter().flatten().copied().collect();
    control.begin("measuring distances", members.len() as u64);
    let mut sums = vec![0.0; members.len() * groups.len()]; // from each member to each group
    let mut rows: Vec<_> = sums.chunks_exact_mut(groups.len().max(1)).collect();
    let with_rows = |bundle: Vec<u32>| {
        let own: Vec<&mut [f64]> = bundle.iter().map(|&number| std::mem::take(&mut rows[number as usize])).collect();
        (bundle, own)
    };
    let bundles = solver.bundles(&members, rayon::current_num_threads(), control)?;
    let turns: Vec<_> = bundles.into_iter().map(with_rows).collect();
    let scratch = || (solver.scratch(), Vec::new());
    in_turn(turns.into_iter(), scratch, |(scratch, distances), (bundle, mut own)| {
        distances.resize(bundle.len() * members.len(), 0.0);
        let mut each: Vec<&mut [f32]> = distances.chunks_exact_mut(members.len()).collect();
        fill(solver, &members, &bundle, Some(&members), &mut each, scratch, control)?;
        for (row, sums) in each.iter().zip(&mut own) {
            let mut rest: &[f32] = row;
            for (group, sum) in groups.iter().zip(sums.iter_mut()) {
                let (of_group, others) = rest.split_at(group.len());
                *sum = of_group.iter().map(|&distance| f64::from(distance)).sum();
                rest = others;
            }
        }
        Ok(())
    })?;
    let mut rest: &[f64] = &sums;
    let mut found = Vec::with_capacity(groups.len() * groups.len());
    for from in groups {
        let (own, others) = rest.split_at(from.len() * groups.len());
        rest = others;
        for (column, to) in groups.iter().enumerate() {
            let sum: f64 = own.iter().skip(column).step_by(groups.len()).sum();
            found.push(sum / (from.len() * to.len()) as f64);
        }
    }
    Ok(found)
}

fn least<S: Solver>(solver: &S, groups: &[Vec<u32>], control: &Control) -> Result<Vec<f64>> {
    control.begin("measuring distances", groups.len() as u64);
    let mut found = vec![f64::INFINITY; groups.len() * groups.len()];
    let turns: Vec<_> = groups.iter().zip(found.chunks_exact_mut(groups.len().max(1))).collect();
    let scratch = || (solver.scratch(), vec![0.0; solver.columns()]);
    in_turn(turns.into_iter(), scratch, |(scratch, row), (from, own)| {
        solver.nearest(from, row, scratch, control)?;
        for (to, value) in groups.iter().zip(own) {
            *value = to.iter().map(|&member| f64::from(row[member as usize])).fold(f64::INFINITY, f64::min);
        }
        control.advance();
        Ok(())
    })?;
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geodesic::exact::Exact;
    use crate::geodesic::graph::GeodesicGraph;
    use crate::rows::DistanceRows;
    use crate::surface::mesh::shapes;
    use crate::tests::with_threads;

    fn brute_force<S: Solver>(solver: &S, groups: &[Vec<u32>], linkage: Linkage) -> Vec<f64> {
        let every: Vec<u32> = (0..solver.columns() as u32).collect();
        let rows = DistanceRows::compute(solver, &every, &Control::default()).unwrap();
        let pairs = groups.iter().flat_map(|from| groups.iter().map(move |to| (from, to)));
        let value = |(from, to): (&Vec<u32>, &Vec<u32>)| {
            let all = from.iter().flat_map(|&a| to.iter().map(move |&b| (a, b)));
            let all = all.map(|(a, b)| f64::from(rows.row(a as usize)[b as usize]));
            match linkage {
                Linkage::Mean => all.sum::<f64>() / (from.len() * to.len()) as f64,
                Linkage::Least => all.fold(f64::INFINITY, f64::min),
            }
        };
        pairs.map(value).collect()
    }

    #[test]
    fn distances_between_groups_are_those_between_all_their_vertices() {
        let surface = shapes::surface(shapes::torus(24, 13));
        let graph = GeodesicGraph::new(&surface, &Control::default()).unwrap();
        let mut groups = vec![Vec::new(); 7]; // interleaved, of different sizes, with a vertex of none
        (1..surface.len() as u32).for_each(|vertex| groups[(vertex * vertex % 7) as usize % 7].push(vertex));
        groups.retain(|group| !group.is_empty());
        for linkage in [Linkage::Mean, Linkage::Least] {
            let expected =
                [brute_force(&graph, &groups, linkage), brute_force(&Exact::new(&surface), &groups, linkage)];
            for threads in [1, 3] {
                let found = with_threads(threads, || {
                    [
                        between(&graph, &groups, linkage, &Control::default()).unwrap(),
                        between(&Exact::new(&surface), &groups, linkage, &Control::default()).unwrap(),
                    ]
                });
                for (found, expected) in found.iter().zip(&expected) {
                    assert_eq!(found.len(), groups.len() * groups.len());
                    for (a, b) in found.iter().zip(expected) {
                        assert!((a - b).abs() <= 1e-6 * b.abs(), "{a} instead of {b}");
                    }
                }
            }
            let on =
                |threads| with_threads(threads, || between(&graph, &groups, linkage, &Control::default()).unwrap());
            assert_eq!(on(1), on(5));
        }
    }
}
