//! Shortest paths in a graph by a monotone bucket queue.
//!
//! Distances are sorted into buckets no wider than the shortest link (Dial; Denardo, Fox). A vertex taken from the
//! lowest bucket is then final, as in Dijkstra's algorithm, but the queue needs no comparisons. Only the few buckets
//! that one link can span are in use at a time, so they are kept in a ring.

use crate::adjacency::{Arc, Links};
use crate::error::{check_length, check_points};
use crate::{Control, Error, Result};

/// The maximum number of buckets in the ring. If lengths of links differ more, buckets are wider than the shortest
/// link. A vertex may then be taken out more than once, which costs time but remains correct.
const MOST_BUCKETS: f32 = 62.0;

/// The number of vertices whose links are prefetched together, instead of waiting for one after the other.
const AHEAD: usize = 32;

/// The number of links in one cache line.
const LINE: usize = 8;

/// Returns whether no vertex has more links than a voxel can have neighbours.
pub(super) fn is_sparse(graph: &impl Links) -> bool {
    graph.most_links() <= 26
}

/// A reusable search through one graph.
#[derive(Debug)]
pub(crate) struct Search {
    per_mm: f32,
    buckets: Vec<Vec<(u32, f32)>>,
    current: Vec<(u32, f32)>,
    /// Space for the neighbours of [`AHEAD`] vertices of a sparse graph; empty for other graphs.
    lowered: Vec<(u32, f32)>,
}

impl Search {
    /// Returns the memory in bytes that one worker needs for a row: its distances, and two entries of eight bytes per
    /// vertex in the buckets, because a vertex that comes closer is entered again.
    pub(crate) const fn memory_need(vertices: usize) -> u64 {
        (4 + 16) * vertices as u64
    }

    /// Creates a search whose buckets fit the links of `graph`.
    pub(crate) fn new(graph: &impl Links) -> Self {
        let [shortest, longest] = graph.extremes();
        // as wide as the shortest link if possible: what is passed on then lands in a later bucket (Denardo & Fox 1979)
        let width = shortest.max(longest / MOST_BUCKETS).max(f32::MIN_POSITIVE);
        // a power of two, so that the position in the ring is a mask instead of a division
        let ring = ((longest / width) as usize + 2).next_power_of_two();
        let lowered = if is_sparse(graph) { vec![(0, 0.0); AHEAD * graph.most_links() + 1] } else { Vec::new() };
        Self { per_mm: width.recip(), buckets: vec![Vec::new(); ring], current: Vec::new(), lowered }
    }

    /// Lowers `distance` to the distances from `seeds`: `distance[v]` becomes the minimum of its previous value and of
    /// `distance[seed]` plus the shortest path from a seed to v.
    ///
    /// If `distance` is infinite except for one seed at 0, this gives a distance row. Previous values are also limits:
    /// with a radius instead of infinity, only a disk is searched; with distances to other sources, only what is closer
    /// to a new one.
    pub(crate) fn lower(
        &mut self, graph: &impl Links, seeds: &[u32], distance: &mut [f32], control: &Control,
    ) -> Result<()> {
        let Self { per_mm, buckets, current, lowered } = self;
        let ring = buckets.len();
        let bucket_of = |distance: f32| (distance * *per_mm) as usize;
        buckets.iter_mut().for_each(Vec::clear);
        let mut now = seeds.iter().map(|&s| bucket_of(distance[s as usize])).min().unwrap_or(0);
        for &seed in seeds {
            buckets[bucket_of(distance[seed as usize]).min(now + ring - 1) & (ring - 1)]
                .push((seed, distance[seed as usize]));
        }
        let mut empty = 0;
        while empty < ring {
            control.check()?;
            std::mem::swap(current, &mut buckets[now & (ring - 1)]);
            if current.is_empty() {
                now += 1;
                empty += 1;
                continue;
            }
            empty = 0;
            for some in current.chunks(AHEAD) {
                let mut put = |neighbour: u32, through: f32| {
                    buckets[bucket_of(through) & (ring - 1)].push((neighbour, through));
                };
                if lowered.is_empty() {
                    pass_many(graph, some, distance, put);
                } else {
                    let count = pass_few(graph, some, distance, lowered);
                    lowered[..count].iter().for_each(|&(neighbour, through)| put(neighbour, through));
                }
            }
            current.clear();
        }
        Ok(())
    }
}

/// Lowers the distances of the neighbours of some vertices with few neighbours each; those that came closer are the
/// first entries of `lowered`, and their number is returned.
#[inline]
fn pass_few(graph: &impl Links, some: &[(u32, f32)], distance: &mut [f32], lowered: &mut [(u32, f32)]) -> usize {
    let first = |&(vertex, _): &(u32, f32)| graph.arcs(vertex).next().map_or(0, |arc| arc.to);
    std::hint::black_box(some.iter().map(first).fold(0, u32::wrapping_add));
    let mut count = 0;
    for &(vertex, reached) in some {
        if reached != distance[vertex as usize] {
            continue; // it came closer since it was put here
        }
        // Whether a neighbour comes closer is unpredictable, so there is no branch: each is written after those that
        // did, and counts if it does.
        for arc in graph.arcs(vertex) {
            let through = reached + arc.length;
            let known = &mut distance[arc.to as usize];
            let nearer = through < *known;
            *known = if nearer { through } else { *known };
            lowered[count] = (arc.to, through);
            count += usize::from(nearer);
        }
    }
    count
}

/// Lowers the distances of vertices with many neighbours; `put` receives those that come closer: about 1 in 30, which
/// is predicted well. The links are the bottleneck, so all of them are prefetched.
#[inline]
fn pass_many(graph: &impl Links, some: &[(u32, f32)], distance: &mut [f32], mut put: impl FnMut(u32, f32)) {
    let mut called = 0_u32;
    for &(vertex, reached) in some {
        if reached == distance[vertex as usize] {
            called = graph.arcs(vertex).step_by(LINE).fold(called, |called, arc| called.wrapping_add(arc.to));
        }
    }
    std::hint::black_box(called);
    for &(vertex, reached) in some {
        if reached != distance[vertex as usize] {
            continue;
        }
        for arc in graph.arcs(vertex) {
            let through = reached + arc.length;
            let known = &mut distance[arc.to as usize];
            if through < *known {
                *known = through;
                put(arc.to, through);
            }
        }
    }
}

/// Returns the vertices of a shortest path from the source of `row` to `target`, including both; of equal paths, the
/// one through the lowest vertices. (The black path in figure 3 of Grossmann et al.)
///
/// # Errors
/// [`Error::WrongLength`] if the row does not have one distance per vertex, [`Error::NoSuchPoint`],
/// [`Error::Unreachable`] if the row is infinite at `target` or does not start at `source`, and [`Error::Cancelled`].
pub fn trace_path(graph: &impl Links, row: &[f32], source: u32, target: u32, control: &Control) -> Result<Vec<u32>> {
    check_length("distances", row.len(), "vertices", graph.vertices())?;
    check_points([source, target], row.len())?;
    let unreachable = || Error::Unreachable { source_vertex: source as usize, vertex: target as usize };
    if row[target as usize].is_infinite() {
        return Err(unreachable());
    }
    // A link shorter than half a unit in the last place leads to a vertex that is not closer, and possibly back. So no
    // vertex is entered twice, and the search backtracks at dead ends: it ends within twice as many steps as vertices.
    let mut is_entered = vec![false; graph.vertices()];
    is_entered[target as usize] = true;
    let mut path = vec![target];
    while let Some(&vertex) = path.last() {
        control.check()?;
        if vertex == source {
            path.reverse();
            return Ok(path);
        }
        let reached = row[vertex as usize];
        // the row was made by the same sum of the same numbers, so equality is exact
        let leads_here = |arc: &Arc| row[arc.to as usize] + arc.length == reached;
        match graph.arcs(vertex).find(|arc| leads_here(arc) && !is_entered[arc.to as usize]) {
            Some(arc) => {
                is_entered[arc.to as usize] = true;
                path.push(arc.to);
            }
            None => drop(path.pop()),
        }
    }
    Err(unreachable())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::adjacency::{Listed, distinct};
    use crate::geodesic::graph::GeodesicGraph;
    use crate::surface::mesh::shapes;
    use crate::tests::{chained, masks, row as row_of};
    use crate::volume::Mask;
    use proptest::prelude::*;

    /// Returns distances by relaxing every arc until nothing changes (Bellman, Ford).
    fn relaxed(graph: &impl Links, sources: &[u32]) -> Vec<f32> {
        let mut distance = vec![f32::INFINITY; graph.vertices()];
        sources.iter().for_each(|&source| distance[source as usize] = 0.0);
        loop {
            let before = distance.clone();
            for v in 0..graph.vertices() as u32 {
                for arc in graph.arcs(v) {
                    let through = distance[v as usize] + arc.length;
                    distance[arc.to as usize] = distance[arc.to as usize].min(through);
                }
            }
            if before == distance {
                return distance;
            }
        }
    }

    proptest! {
        #[test]
        fn rows_equal_those_of_relaxation(mask in masks([5, 6, 7], 0.3..0.5), at in any::<prop::sample::Index>(), z in 0.15f64..7.0) {
            let (_, graph) = chained(&mask, [1.0, 1.3, z]);
            let source = at.index(graph.vertices()) as u32;
            prop_assert_eq!(row_of(&graph, source), relaxed(&graph, &[source]));
        }

        #[test]
        fn a_traced_path_is_as_long_as_its_distance(mask in masks([5, 6, 7], 0.3..0.5), picks in prop::array::uniform2(any::<prop::sample::Index>())) {
            let (_, graph) = chained(&mask, [1.0, 2.0, 0.5]);
            let [source, target] = picks.map(|pick| pick.index(graph.vertices()) as u32);
            let row = row_of(&graph, source);
            match trace_path(&graph, &row, source, target, &Control::default()) {
                Err(error) => {
                    prop_assert!(row[target as usize].is_infinite());
                    prop_assert_eq!(error, Error::Unreachable { source_vertex: source as usize, vertex: target as usize });
                }
                Ok(path) => {
                    let link = |pair: &[u32]| graph.arcs(pair[0]).find(|arc| arc.to == pair[1]).unwrap().length;
                    prop_assert_eq!((path[0], path[path.len() - 1]), (source, target));
                    prop_assert_eq!(path.windows(2).map(link).fold(0.0, |sum, link| sum + link), row[target as usize]);
                }
            }
        }

        #[test]
        fn adding_a_source_gives_the_distance_to_the_nearer(mask in masks([5, 6, 7], 0.3..0.5), picks in prop::array::uniform2(any::<prop::sample::Index>())) {
            let (_, graph) = chained(&mask, [1.0; 3]);
            let [a, b] = picks.map(|pick| pick.index(graph.vertices()) as u32);
            let mut both = row_of(&graph, a);
            both[b as usize] = 0.0;
            Search::new(&graph).lower(&graph, &[b], &mut both, &Control::default()).unwrap();
            let (from_a, from_b) = (row_of(&graph, a), row_of(&graph, b));
            let nearer: Vec<f32> = from_a.iter().zip(&from_b).map(|(&p, &q)| p.min(q)).collect();
            prop_assert_eq!(both, nearer);
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))] // of three graphs each
        #[test]
        fn rows_along_straight_links_equal_those_of_relaxation(
            wide in 1e-3f64..1.0,
            picks in prop::array::uniform3(any::<prop::sample::Index>()),
        ) {
            for (mut points, faces) in [shapes::torus(16, 9), shapes::sheet(13, 17), shapes::sphere(2)] {
                points.iter_mut().for_each(|point| point[1] *= wide); // links from very short to long
                let graph = GeodesicGraph::new(&shapes::surface((points, faces)), &Control::default()).unwrap();
                prop_assert!(!is_sparse(&graph));
                let sources = picks.map(|pick| pick.index(graph.vertices()) as u32);
                prop_assert_eq!(row_of(&graph, sources[0]), relaxed(&graph, &sources[..1]));
                let mut from_all = vec![f32::INFINITY; graph.vertices()];
                sources.iter().for_each(|&source| from_all[source as usize] = 0.0);
                Search::new(&graph).lower(&graph, &sources, &mut from_all, &Control::default()).unwrap();
                prop_assert_eq!(from_all, relaxed(&graph, &sources));
            }
        }
    }

    #[test]
    fn a_path_goes_round_an_obstacle() {
        // a plain cut in two by a river with one bridge (figure 3)
        let (surface, graph) = chained(&Mask::from_fn([41, 41, 1], |[i, j, _]| i != 20 || j == 35).unwrap(), [1.0; 3]);
        let [start, end, bridge] = [[0, 0, 0], [40, 0, 0], [20, 35, 0]].map(|v| surface.find(v).unwrap() as u32);
        let row = row_of(&graph, start);
        let path = trace_path(&graph, &row, start, end, &Control::default()).unwrap();
        assert!(path.contains(&bridge));
        let half = row[bridge as usize];
        assert!((row[end as usize] - 2.0 * half).abs() < 1e-4);
    }

    proptest! {
        /// Lengths that are negligible or zero: paths end, pass no vertex twice, and have the reported length.
        #[test]
        fn paths_end_whatever_the_lengths(
            links in prop::collection::vec((0u32..12, 0u32..12, prop::sample::select(vec![0.0f32, 1e-30, 1e-7, 1.0, 1e6])), 1..60),
            ends in prop::array::uniform2(0u32..12),
        ) {
            let graph = Listed::new(12, &links);
            let row = row_of(&graph, ends[0]);
            match trace_path(&graph, &row, ends[0], ends[1], &Control::default()) {
                Err(_) => prop_assert!(row[ends[1] as usize].is_infinite()),
                Ok(path) => {
                    let mut sum = 0.0f32;
                    for two in path.windows(2) {
                        let lengths = graph.arcs(two[0]).filter(|arc| arc.to == two[1]).map(|arc| arc.length);
                        sum += lengths.fold(f32::INFINITY, f32::min);
                    }
                    prop_assert_eq!(sum, row[ends[1] as usize]);
                    prop_assert_eq!(distinct(path.clone()).len(), path.len());
                }
            }
        }
    }
}
