//! Shortest paths in a graph by a monotone bucket queue.
//!
//! Distances are sorted into buckets no wider than the shortest link (Dial; Denardo, Fox). A vertex taken from the lowest
//! bucket is then final, as in Dijkstra's algorithm, but the queue costs no comparison. Only the few buckets that one link
//! can span are alive at a time, so they are kept in a ring.

use super::Solver;
use crate::adjacency::Graph;
use crate::control::Control;
use crate::error::{Error, Result};

/// Most buckets in the ring. Where links differ more in length, buckets are wider than the shortest link: a vertex may
/// then be taken out more than once, which costs time but no correctness.
const MOST_BUCKETS: f32 = 62.0;

/// Room for the neighbours of a voxel, 26, rounded up to a power of two.
const MOST_NEIGHBOURS: usize = 32;

/// A reusable search through one graph.
#[derive(Debug)]
pub struct Search {
    per_mm: f32,
    buckets: Vec<Vec<(u32, f32)>>,
    current: Vec<(u32, f32)>,
}

impl Search {
    /// A search whose buckets fit the links of `graph`.
    pub fn new(graph: &Graph) -> Self {
        let longest = graph.lengths().iter().copied().fold(0.0, f32::max);
        let shortest = graph.lengths().iter().copied().fold(longest, f32::min);
        let width = shortest.max(longest / MOST_BUCKETS);
        let ring = ((longest / width) as usize + 2).next_power_of_two();
        Self { per_mm: width.recip(), buckets: vec![Vec::new(); ring], current: Vec::new() }
    }

    /// Lowers `distance` to the distances from `seeds`: `distance[v]` becomes the least of what it was and of
    /// `distance[seed]` plus the shortest path from a seed to v.
    ///
    /// With `distance` infinite but for one seed at 0 this is a distance row. What it was before is a limit, too: with a
    /// radius in place of infinity only a disk is searched, with the distances to a set of sources only what comes nearer
    /// to a new one.
    ///
    /// # Errors
    /// [`Error::Cancelled`].
    pub fn lower(&mut self, graph: &Graph, seeds: &[u32], distance: &mut [f32], control: &Control) -> Result<()> {
        let Self { per_mm, buckets, current } = self;
        let ring = buckets.len();
        let bucket_of = |distance: f32| (distance * *per_mm) as usize;
        buckets.iter_mut().for_each(Vec::clear);
        let mut now = seeds.iter().map(|&s| bucket_of(distance[s as usize])).min().unwrap_or(0);
        for &seed in seeds {
            buckets[bucket_of(distance[seed as usize]).min(now + ring - 1) & (ring - 1)]
                .push((seed, distance[seed as usize]));
        }
        let mut lowered = [(0, 0.0); MOST_NEIGHBOURS];
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
            for &(vertex, reached) in current.iter() {
                if reached != distance[vertex as usize] {
                    continue; // it has come nearer since it was put here
                }
                // Whether a neighbour comes nearer cannot be predicted, so it is not branched on: each is written behind the
                // `count` that do, and counts if it does.
                let mut count = 0;
                for arc in graph.arcs(vertex) {
                    let through = reached + arc.length;
                    let known = &mut distance[arc.to as usize];
                    let nearer = through < *known;
                    *known = if nearer { through } else { *known };
                    lowered[count % MOST_NEIGHBOURS] = (arc.to, through);
                    count += usize::from(nearer);
                }
                for &(neighbour, through) in &lowered[..count.min(MOST_NEIGHBOURS)] {
                    buckets[bucket_of(through) & (ring - 1)].push((neighbour, through));
                }
            }
            current.clear();
        }
        Ok(())
    }
}

impl Solver for Graph {
    type Scratch = Search;

    fn scratch(&self) -> Search {
        Search::new(self)
    }

    fn vertices(&self) -> usize {
        self.len()
    }

    fn row(&self, source: u32, row: &mut [f32], search: &mut Search, control: &Control) -> Result<()> {
        row.fill(f32::INFINITY);
        row[source as usize] = 0.0;
        search.lower(self, &[source], row, control)
    }
}

/// The vertices of a shortest path from the source of `row` to `target`, both included; of equal paths the one through the
/// lowest vertices. (Grossmann et al., figure 3: the black path.)
///
/// # Errors
/// [`Error::Unreachable`] if the row is infinite at `target`.
pub fn trace_path(graph: &Graph, row: &[f32], source: u32, target: u32) -> Result<Vec<u32>> {
    if row[target as usize].is_infinite() {
        return Err(Error::Unreachable { source_vertex: source as usize, vertex: target as usize });
    }
    let mut path = vec![target];
    let mut vertex = target;
    while vertex != source {
        let reached = row[vertex as usize];
        // the row was made by the same sum of the same numbers, so equality is exact
        let previous = graph.arcs(vertex).find(|arc| row[arc.to as usize] + arc.length == reached);
        vertex = previous.ok_or(Error::Unreachable { source_vertex: source as usize, vertex: target as usize })?.to;
        path.push(vertex);
    }
    path.reverse();
    Ok(path)
}
