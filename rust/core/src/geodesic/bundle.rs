//! Rows of a bundle of nearby sources, computed together.
//!
//! A search passes every link once per row, and mostly waits for the memory of the links. Here, the distances from all
//! sources of a bundle are adjacent at each vertex: a link is loaded once, and passed by a few vector instructions.
//! Vertices are visited in the order of their distances from the centre of the bundle. From afar, all its sources lie
//! in one direction, so that most vertices are visited when all of their distances are final. Where they are not, links
//! are passed again, window by window in that order, alternately forward and backward, until nothing changes.
//!
//! A distance is the smallest sum of lengths over all paths, added up from the source on. It does not depend on the
//! order in which vertices are visited, bit by bit, and therefore equals that of a search in [`super::shortest`].

use std::ops::Range;

use pulp::{Arch, Simd, WithSimd};

use super::shortest::Search;
use crate::adjacency::Links;
use crate::{Control, Result};

/// The maximum number of sources of a bundle: their distances fill a cache line.
pub(crate) const MOST_SOURCES: usize = 16;

/// The minimum number of sources for bundling; fewer sources are too far apart.
const FEWEST_SOURCES: usize = 96;

/// The maximum number of vertices of a small surface, on which all distances of a bundle fit into the cache.
const CACHED: usize = 1 << 12;

/// The minimum number of sources for bundling on a small surface.
const FEWEST_CACHED: usize = 32;

/// The size of a window in square roots of the number of vertices, such that its data fit into the cache.
const WINDOW: f64 = 4.0;

/// The number of positions by which links are prefetched.
const AHEAD: usize = 3;

/// The number of positions between two checks for cancellation.
const CHECK: usize = 512;

const NOWHERE: Range<usize> = Range { start: usize::MAX, end: 0 };

/// The number of vertices whose distances are written to all rows at a time, so that they stay in the cache.
const WRITTEN: usize = 256;

/// The adjacent distances from the sources of a bundle in mm.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
struct Lanes([f32; MOST_SOURCES]);

const UNKNOWN: Lanes = Lanes([f32::INFINITY; MOST_SOURCES]);

/// Buffers of a worker that are reused for all bundles.
#[derive(Debug)]
pub struct BundleScratch {
    search: Search,
    from_midst: Vec<f32>,
    /// The vertices in the order of their visits, after the bits of their distances from the centre.
    order: Vec<u64>,
    /// The position of each vertex in the order.
    places: Vec<u32>,
    /// Whether the vertex at a position has distances that are not yet passed to its neighbours.
    waiting: Vec<bool>,
    distances: Vec<Lanes>,
}

impl BundleScratch {
    /// Returns the memory in bytes that one worker needs.
    pub(crate) const fn memory_need(vertices: usize) -> u64 {
        let (lanes, order, from_midst, places, waiting) = (4 * MOST_SOURCES, 8, 4, 4, 1);
        Search::memory_need(vertices) + (lanes + order + from_midst + places + waiting) as u64 * vertices as u64
    }

    /// Creates the buffers for a graph.
    pub(crate) fn new(graph: &impl Links) -> Self {
        Self {
            search: Search::new(graph),
            from_midst: Vec::new(),
            order: Vec::new(),
            places: Vec::new(),
            waiting: Vec::new(),
            distances: Vec::new(),
        }
    }

    /// Writes the distances from one source to every vertex.
    pub(crate) fn row(&mut self, graph: &impl Links, source: u32, row: &mut [f32], control: &Control) -> Result<()> {
        search(&mut self.search, graph, source, f32::INFINITY, row, control)
    }

    /// Writes the distances from the nearest of several sources to every vertex.
    pub(crate) fn nearest(
        &mut self, graph: &impl Links, sources: &[u32], row: &mut [f32], control: &Control,
    ) -> Result<()> {
        row.fill(f32::INFINITY);
        sources.iter().for_each(|&source| row[source as usize] = 0.0);
        self.search.lower(graph, sources, row, control)
    }

    /// Writes the distances from each source of a bundle, its centre first, to every vertex or to the targets: one row
    /// per source. Panics if there are more sources than a bundle can have.
    pub(crate) fn rows(
        &mut self, graph: &impl Links, bundle: &[u32], targets: Option<&[u32]>, rows: &mut [&mut [f32]],
        control: &Control,
    ) -> Result<()> {
        assert!(bundle.len() <= MOST_SOURCES, "a bundle has {MOST_SOURCES} sources at most");
        let Some(&midst) = bundle.first() else { return Ok(()) };
        if let ([_], [row]) = (bundle, &mut *rows) {
            return self.alone(graph, midst, targets, row, control);
        }
        let farthest = self.begin(graph, midst, bundle, control)?;
        Arch::new().dispatch(Visits { graph, scratch: self, farthest, control })?;
        let Self { distances, .. } = self;
        let columns = rows.first().map_or(0, |row| row.len());
        for first in (0..columns).step_by(WRITTEN) {
            let some = first..columns.min(first + WRITTEN);
            for (lane, row) in rows.iter_mut().enumerate() {
                let row = &mut row[some.clone()];
                match targets {
                    None => row.iter_mut().zip(&distances[some.clone()]).for_each(|(to, from)| *to = from.0[lane]),
                    Some(targets) => {
                        let distance = |&target: &u32| distances[target as usize].0[lane];
                        row.iter_mut().zip(&targets[some.clone()]).for_each(|(to, target)| *to = distance(target));
                    }
                }
            }
        }
        Ok(())
    }

    /// Writes the distances from one source to every vertex, or to the targets.
    fn alone(
        &mut self, graph: &impl Links, source: u32, targets: Option<&[u32]>, row: &mut [f32], control: &Control,
    ) -> Result<()> {
        let Some(targets) = targets else { return self.row(graph, source, row, control) };
        self.from_midst.resize(graph.vertices(), 0.0);
        search(&mut self.search, graph, source, f32::INFINITY, &mut self.from_midst, control)?;
        row.iter_mut().zip(targets).for_each(|(to, &target)| *to = self.from_midst[target as usize]);
        Ok(())
    }

    /// Orders the vertices, and initialises the sources; returns the last position of a source.
    fn begin(&mut self, graph: &impl Links, midst: u32, bundle: &[u32], control: &Control) -> Result<usize> {
        let vertices = graph.vertices();
        self.from_midst.resize(vertices, 0.0);
        search(&mut self.search, graph, midst, f32::INFINITY, &mut self.from_midst, control)?;
        // distances are not negative, so their bits have the same order
        self.order.clear();
        self.order.extend((0..).zip(&self.from_midst).map(|(vertex, from)| u64::from(from.to_bits()) << 32 | vertex));
        self.order.sort_unstable();
        self.places.resize(vertices, 0);
        for (place, &vertex) in (0..).zip(&self.order) {
            self.places[vertex as u32 as usize] = place;
        }
        self.waiting.clear();
        self.waiting.resize(vertices, false);
        self.distances.clear();
        self.distances.resize(vertices, UNKNOWN);
        let mut farthest = 0;
        for (lane, &source) in bundle.iter().enumerate() {
            self.distances[source as usize].0[lane] = 0.0;
            let place = self.places[source as usize] as usize;
            self.waiting[place] = true;
            farthest = farthest.max(place);
        }
        Ok(farthest)
    }
}

/// Groups nearby sources into bundles of source numbers, the central one first. Bundles consist of one source if there
/// are few sources, and there are enough of them for all threads.
pub(super) fn bundles(graph: &impl Links, sources: &[u32], threads: usize, control: &Control) -> Result<Vec<Vec<u32>>> {
    let numbers = 0..sources.len() as u32;
    let fewest = if graph.vertices() > CACHED { FEWEST_SOURCES } else { FEWEST_CACHED };
    if sources.len() < fewest {
        return Ok(numbers.map(|number| vec![number]).collect());
    }
    let most = MOST_SOURCES.min(sources.len().div_ceil(threads));
    let mut found = Search::new(graph);
    let mut row = vec![0.0; graph.vertices()];
    let at = |row: &[f32], number: u32| row[sources[number as usize] as usize];
    // from the outermost source inwards, so that no few are left between bundles
    search(&mut found, graph, sources[0], f32::INFINITY, &mut row, control)?;
    let mut left: Vec<u32> = numbers.collect();
    left.sort_by(|&a, &b| at(&row, a).total_cmp(&at(&row, b)));
    let farthest = left.iter().rev().map(|&number| at(&row, number)).find(|from| from.is_finite()).unwrap_or(0.0);
    // a disk with this share of the sources has about this share of the area, which grows as its radius squared
    let mut radius = farthest * (most as f32 / sources.len() as f32).sqrt();
    let mut bundles = Vec::with_capacity(sources.len().div_ceil(most));
    let mut is_taken = vec![false; sources.len()];
    while let Some(&outermost) = left.last() {
        let mut near = loop {
            if !(radius > 0.0 && radius < 2.0 * farthest) {
                radius = f32::INFINITY;
            }
            search(&mut found, graph, sources[outermost as usize], radius, &mut row, control)?;
            let near: Vec<u32> = left.iter().copied().filter(|&number| at(&row, number) < radius).collect();
            if near.len() >= most.min(left.len()) || radius.is_infinite() {
                break near;
            }
            radius *= 1.5;
        };
        near.sort_by(|&a, &b| at(&row, a).total_cmp(&at(&row, b)));
        near.truncate(most);
        let last = near.last().map_or(0.0, |&number| at(&row, number));
        radius = 1.2 * last;
        let from_half = |number: u32| (at(&row, number) - 0.5 * last).abs();
        let midst = (0..near.len()).min_by(|&a, &b| from_half(near[a]).total_cmp(&from_half(near[b])));
        near.swap(0, midst.unwrap_or(0));
        near.iter().for_each(|&number| is_taken[number as usize] = true);
        left.retain(|&number| !is_taken[number as usize]);
        bundles.push(near);
    }
    Ok(bundles)
}

/// Writes the distances from a source to every vertex that is closer than a radius; elsewhere, the radius.
fn search(
    search: &mut Search, graph: &impl Links, source: u32, radius: f32, row: &mut [f32], control: &Control,
) -> Result<()> {
    row.fill(radius);
    row[source as usize] = 0.0;
    search.lower(graph, &[source], row, control)
}

struct Visits<'a, G> {
    graph: &'a G,
    scratch: &'a mut BundleScratch,
    /// The last position of a source: distances up to there are made final first.
    farthest: usize,
    control: &'a Control,
}

impl<G: Links> WithSimd for Visits<'_, G> {
    type Output = Result<()>;

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _: S) -> Result<()> {
        let vertices = self.scratch.order.len();
        let window = (WINDOW * (vertices as f64).sqrt()) as usize + 1;
        let (mut first, mut end) = (0, self.farthest + 1);
        while first < end {
            let mut places = first..end;
            // Bellman–Ford with sweeps to and fro (Yen 1970), within a window of positions that fits into the cache
            let mut is_forward = true;
            while !places.is_empty() {
                let left = if is_forward { self.forward(places)? } else { self.backward(places)? };
                places = left.start..left.end.min(end);
                is_forward = !is_forward;
            }
            (first, end) = (end, vertices.min(end + window));
        }
        Ok(())
    }
}

impl<G: Links> Visits<'_, G> {
    /// Visits the positions in order; returns where vertices wait afterwards.
    #[inline(always)]
    fn forward(&mut self, places: Range<usize>) -> Result<Range<usize>> {
        let end = places.end;
        let mut left = NOWHERE;
        for place in places {
            if self.is_waiting(place)? {
                self.call(place + AHEAD);
                let lowered = self.visit(place);
                widen(&mut left, lowered.start..place);
                widen(&mut left, end..lowered.end);
            }
        }
        Ok(left)
    }

    /// Visits the positions in reverse order; returns where vertices wait afterwards.
    #[inline(always)]
    fn backward(&mut self, places: Range<usize>) -> Result<Range<usize>> {
        let start = places.start;
        let mut left = NOWHERE;
        for place in places.rev() {
            if self.is_waiting(place)? {
                self.call(place.saturating_sub(AHEAD));
                let lowered = self.visit(place);
                widen(&mut left, lowered.start..start);
                widen(&mut left, place..lowered.end);
            }
        }
        Ok(left)
    }

    #[inline(always)]
    fn is_waiting(&self, place: usize) -> Result<bool> {
        if place.is_multiple_of(CHECK) {
            self.control.check()?;
        }
        Ok(self.scratch.waiting[place])
    }

    /// Prefetches the links of the vertex at a position, if it will be visited.
    #[inline(always)]
    fn call(&self, place: usize) {
        if self.scratch.waiting.get(place) == Some(&true) {
            let links = self.graph.arcs(self.scratch.order[place] as u32).step_by(8);
            std::hint::black_box(links.fold(0, |called, arc| called ^ arc.to));
        }
    }

    /// Passes the distances of the vertex at a position to its neighbours; returns a range with those that came closer.
    #[inline(always)]
    fn visit(&mut self, place: usize) -> Range<usize> {
        let BundleScratch { order, places, waiting, distances, .. } = &mut *self.scratch;
        let vertex = order[place] as u32;
        waiting[place] = false;
        let Lanes(reached) = distances[vertex as usize];
        let mut range = NOWHERE;
        for arc in self.graph.arcs(vertex) {
            let Lanes(known) = &mut distances[arc.to as usize];
            let mut nearer = [0.0; MOST_SOURCES];
            let mut changed = 0;
            for lane in 0..MOST_SOURCES {
                let through = reached[lane] + arc.length;
                nearer[lane] = if through < known[lane] { through } else { known[lane] };
                // a comparison of bits needs no branch, so all lanes are processed together
                changed |= nearer[lane].to_bits() ^ known[lane].to_bits();
            }
            if changed != 0 {
                *known = nearer;
                let place = places[arc.to as usize] as usize;
                waiting[place] = true;
                range = range.start.min(place)..range.end.max(place + 1);
            }
        }
        range
    }
}

/// Widens a range to contain another one, unless that is empty.
#[inline(always)]
fn widen(range: &mut Range<usize>, by: Range<usize>) {
    if !by.is_empty() {
        *range = range.start.min(by.start)..range.end.max(by.end);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::adjacency::Listed;
    use crate::geodesic::graph::GeodesicGraph;
    use crate::surface::mesh::shapes;
    use crate::tests::row;
    use proptest::prelude::*;

    fn searched(graph: &impl Links, sources: &[u32]) -> Vec<Vec<f32>> {
        sources.iter().map(|&source| row(graph, source)).collect()
    }

    fn bundled(graph: &impl Links, sources: &[u32], targets: Option<&[u32]>) -> Vec<Vec<f32>> {
        let columns = targets.map_or(graph.vertices(), <[u32]>::len);
        let mut rows = vec![vec![f32::NAN; columns]; sources.len()];
        let mut each: Vec<_> = rows.iter_mut().map(|row| &mut row[..]).collect();
        BundleScratch::new(graph).rows(graph, sources, targets, &mut each, &Control::default()).unwrap();
        rows
    }

    fn surfaces(squeezed: f64) -> impl Iterator<Item = GeodesicGraph> {
        [shapes::torus(40, 23), shapes::sheet(33, 47), shapes::sphere(4)].into_iter().map(move |(mut points, faces)| {
            points.iter_mut().for_each(|point| point[1] *= squeezed); // links from very short to long
            GeodesicGraph::new(&shapes::surface((points, faces)), &Control::default()).unwrap()
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(12))]
        #[test]
        fn rows_are_those_of_searches_wherever_the_sources_lie(
            squeezed in 1e-3f64..1.0,
            picks in prop::collection::vec(any::<prop::sample::Index>(), 1..=MOST_SOURCES),
        ) {
            for graph in surfaces(squeezed) {
                let sources: Vec<u32> = picks.iter().map(|pick| pick.index(graph.vertices()) as u32).collect();
                let expected = searched(&graph, &sources);
                prop_assert!(bundled(&graph, &sources, None) == expected);
                let targets: Vec<u32> = (0..graph.vertices() as u32).rev().step_by(5).collect();
                let columns = |row: &Vec<f32>| targets.iter().map(|&target| row[target as usize]).collect();
                let expected: Vec<Vec<f32>> = expected.iter().map(columns).collect();
                prop_assert!(bundled(&graph, &sources, Some(&targets)) == expected);
            }
        }

        #[test]
        fn rows_are_those_of_searches_in_any_graph(
            links in prop::collection::vec((0u32..40, 0u32..40, prop::sample::select(vec![0.0f32, 1e-30, 1e-7, 0.3, 1.0, 1e6])), 1..150),
            sources in prop::collection::vec(0u32..40, 1..=MOST_SOURCES),
        ) {
            let graph = Listed::new(40, &links); // not connected
            prop_assert_eq!(bundled(&graph, &sources, None), searched(&graph, &sources));
        }

        #[test]
        fn every_source_is_in_one_bundle(
            links in prop::collection::vec((0u32..150, 0u32..150, prop::sample::select(vec![0.0f32, 0.5, 1.0, 1e6])), 1..600),
            sources in prop::collection::vec(0u32..150, 0..300),
            threads in 1usize..40,
        ) {
            let graph = Listed::new(150, &links);
            let found = bundles(&graph, &sources, threads, &Control::default()).unwrap();
            let most = if sources.len() < FEWEST_CACHED { 1 } else { MOST_SOURCES.min(sources.len().div_ceil(threads)) };
            prop_assert!(found.iter().all(|bundle| (1..=most).contains(&bundle.len())));
            let mut numbers: Vec<u32> = found.into_iter().flatten().collect();
            numbers.sort_unstable();
            prop_assert_eq!(numbers, (0..sources.len() as u32).collect::<Vec<_>>());
        }
    }
}
