//! The wave: windows that propagate from face to face, the nearest first.

use std::f64::consts::PI;

use super::Exact;
use super::envelope::Envelopes;
use super::frame::{Frame, Frames, around};
use super::rings::Rings;
use super::window::{Window, length};
use crate::surface::mesh::{Surface, next, previous};
use crate::{Control, Result};

/// The width of a bucket of the queue, in mean lengths of an edge.
const BUCKET: f64 = 0.5;

/// The maximum number of buckets, where edges differ in length.
const MOST_BUCKETS: f64 = 4096.0;

/// The minimum number of windows before those of finished edges are searched for.
const FIRST_SWEEP: usize = 1 << 14;

/// The tolerance in radians of the directions into which a path may bend, so that rounding leaves no gap.
const MARGIN: f64 = 1e-7;

/// Marks the vertices among the queue's entries.
const VERTEX: u32 = 1 << 31;

/// The path by which a vertex is nearest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Way {
    /// It is the source, or was not reached.
    Source,
    /// Along an edge, from its other end.
    Along { half_edge: u32 },
    /// Across the face of a half-edge, from a position `at` along it, and from there straight to the unfolded `root`:
    /// `x` along the half-edge, `y` beyond it.
    Across { half_edge: u32, at: f64, x: f64, y: f64, root: u32 },
}

/// Buffers of a search that are reused for all sources, and the results of the last one.
#[derive(Debug)]
pub struct Wave {
    pub(super) source: u32,
    pub(super) distance: Vec<f64>,
    pub(super) ways: Vec<Way>,
    spread: Vec<f64>,
    lowered: Vec<u32>,
    envelopes: Envelopes,
    /// The bucket in which each edge waits.
    due: Vec<usize>,
    taken: Vec<Window>,
    buckets: Vec<Vec<u32>>,
    current: Vec<u32>,
    now: usize,
    rings: Rings,
}

impl Wave {
    pub(super) fn new(exact: &Exact) -> Self {
        let vertices = exact.surface.len();
        let buckets = (2.0 * exact.frames.longest / bucket(&exact.frames)) as usize + 3;
        Self {
            source: 0,
            distance: vec![f64::INFINITY; vertices],
            ways: vec![Way::Source; vertices],
            spread: vec![f64::INFINITY; vertices],
            lowered: Vec::new(),
            envelopes: Envelopes::new(exact.frames.edges().len()),
            due: vec![usize::MAX; exact.frames.edges().len()],
            taken: Vec::new(),
            buckets: vec![Vec::new(); buckets.next_power_of_two()],
            current: Vec::new(),
            now: 0,
            rings: Rings::default(),
        }
    }

    fn clear(&mut self) {
        for vertex in self.lowered.drain(..) {
            self.distance[vertex as usize] = f64::INFINITY;
            self.spread[vertex as usize] = f64::INFINITY;
            self.ways[vertex as usize] = Way::Source;
        }
        self.envelopes.clear();
        let left = self.buckets.iter_mut().chain([&mut self.current]).flat_map(|bucket| bucket.drain(..));
        left.filter(|entry| entry & VERTEX == 0).for_each(|edge| self.due[edge as usize] = usize::MAX); // of a cancelled run
        self.now = 0;
    }

    /// Computes the distances from `source` to everything within reach.
    pub(super) fn run(&mut self, exact: &Exact, source: u32, control: &Control) -> Result<()> {
        self.clear();
        self.source = source;
        self.rings.limit(exact.surface, &exact.frames, source, exact.reach.rings);
        let mut step = Step {
            exact,
            surface: exact.surface,
            frames: &exact.frames,
            per_mm: bucket(&exact.frames).recip(),
            wave: self,
        };
        step.lower(source, 0.0, Way::Source);
        step.run(control)
    }
}

fn bucket(frames: &Frames) -> f64 {
    (BUCKET * frames.mean).max(2.0 * frames.longest / MOST_BUCKETS)
}

struct Step<'a> {
    exact: &'a Exact<'a>,
    surface: &'a Surface,
    frames: &'a Frames,
    per_mm: f64,
    wave: &'a mut Wave,
}

impl Step<'_> {
    fn run(&mut self, control: &Control) -> Result<()> {
        control.check()?;
        let mut empty = 0;
        let mut sweep_at = FIRST_SWEEP;
        let mut steps = 0u32;
        while empty < self.wave.buckets.len() {
            let slot = self.wave.now & (self.wave.buckets.len() - 1);
            if self.wave.buckets[slot].is_empty() {
                self.wave.now += 1;
                empty += 1;
                continue;
            }
            empty = 0;
            let mut current = std::mem::take(&mut self.wave.current);
            std::mem::swap(&mut current, &mut self.wave.buckets[slot]);
            for &entry in &current {
                steps = steps.wrapping_add(1);
                if steps.is_multiple_of(1024) {
                    control.check()?;
                }
                if entry & VERTEX == 0 {
                    self.advance(entry);
                } else {
                    self.spread(entry & !VERTEX);
                }
            }
            current.clear();
            self.wave.current = current;
            if self.wave.envelopes.len() > sweep_at {
                self.sweep();
                sweep_at = FIRST_SWEEP.max(2 * self.wave.envelopes.len());
            }
        }
        Ok(())
    }

    /// Drops windows behind the wave: on edges whose every point is nearer through their ends than the wave is now.
    fn sweep(&mut self) {
        let reached = self.wave.now as f64 / self.per_mm;
        let Wave { envelopes, distance, .. } = &mut *self.wave;
        let (surface, frames) = (self.surface, self.frames);
        envelopes.sweep(|edge| {
            let half_edge = frames.edges()[edge as usize];
            // a point t along an edge is within min(d₀ + t, d₁ + length − t) ≤ (d₀ + d₁ + length)/2
            let ends = distance[surface.origin(half_edge) as usize] + distance[surface.target(half_edge) as usize];
            0.5 * (ends + frames.of(half_edge).length) < reached
        });
    }

    fn push(&mut self, entry: u32, distance: f64) {
        let ring = self.wave.buckets.len();
        let bucket = ((distance * self.per_mm) as usize).clamp(self.wave.now, self.wave.now + ring - 1);
        self.wave.buckets[bucket & (ring - 1)].push(entry);
    }

    #[inline]
    fn lower(&mut self, vertex: u32, through: f64, way: Way) {
        let known = self.wave.distance[vertex as usize];
        if through >= known || through > self.exact.reach.mm {
            return;
        }
        if known == f64::INFINITY {
            self.wave.lowered.push(vertex);
        }
        self.wave.distance[vertex as usize] = through;
        self.wave.ways[vertex as usize] = way;
        self.push(vertex | VERTEX, through);
    }

    /// Propagates from a vertex: along its edges and, if paths may bend there, into the region hidden behind it.
    fn spread(&mut self, vertex: u32) {
        let reached = self.wave.distance[vertex as usize];
        if reached >= self.wave.spread[vertex as usize] {
            return;
        }
        if (reached * self.per_mm) as usize > self.wave.now {
            self.push(vertex | VERTEX, reached);
            return;
        }
        self.wave.spread[vertex as usize] = reached;
        let surface = self.surface;
        let fan = self.frames.fan(vertex);
        let mut is_cut = false;
        for half_edge in around(surface, fan.first) {
            if !self.wave.rings.has(half_edge) {
                is_cut = true;
                continue;
            }
            let last = previous(half_edge);
            self.lower(surface.target(half_edge), reached + self.frames.of(half_edge).length, Way::Along { half_edge });
            self.lower(surface.origin(last), reached + self.frames.of(last).length, Way::Along { half_edge: last });
        }
        let shadow = match self.wave.ways[vertex as usize] {
            _ if is_cut => [f64::NEG_INFINITY, f64::INFINITY],
            Way::Source => [f64::NEG_INFINITY, f64::INFINITY],
            _ if !fan.bends() => return,
            way => {
                let from = self.incoming(vertex, way);
                if fan.is_open {
                    self.shine(vertex, reached, [f64::NEG_INFINITY, from - PI]);
                    [from + PI, f64::INFINITY]
                } else {
                    // a shortest path leaves at least a half turn on both of its sides
                    let shadow = [from + PI, from + fan.angle - PI];
                    self.shine(vertex, reached, shadow.map(|angle| angle - fan.angle));
                    shadow
                }
            }
        };
        self.shine(vertex, reached, shadow);
    }

    /// Returns the direction around a vertex from which it is reached.
    fn incoming(&self, vertex: u32, way: Way) -> f64 {
        match way {
            Way::Source => 0.0,
            Way::Along { half_edge } if self.surface.origin(half_edge) == vertex => self.frames.direction(half_edge),
            Way::Along { half_edge } => {
                let outgoing = next(half_edge);
                self.frames.direction(outgoing) + self.frames.of(outgoing).angle()
            }
            Way::Across { half_edge, at, .. } => {
                let frame = self.frames.of(half_edge);
                let (x, y) = (at - frame.x, -frame.y);
                // the angle at the corner, from the edge to the half-edge's origin to the line of arrival
                let turn = (-frame.x * y + frame.y * x).atan2(-frame.x * x - frame.y * y);
                self.frames.direction(previous(half_edge)) + turn
            }
        }
    }

    /// Sends windows from a vertex into the faces around it, between two directions.
    fn shine(&mut self, vertex: u32, sigma: f64, [from, to]: [f64; 2]) {
        if to < from {
            return;
        }
        let surface = self.surface;
        for half_edge in around(surface, self.frames.fan(vertex).first) {
            let opposite = next(half_edge);
            let (edge, frame) = (self.frames.of(half_edge), self.frames.of(opposite));
            let start = self.frames.direction(half_edge);
            let angle = edge.angle();
            let (low, high) = (from - MARGIN - start, to + MARGIN - start);
            if !self.wave.rings.has(half_edge) || low >= angle || high <= 0.0 {
                continue;
            }
            let place = |turn: f64| {
                let (sin, cos) = turn.sin_cos();
                // law of sines in the triangle of the vertex, the opposite edge's origin, and the point that is hit
                edge.length * edge.length * sin / (sin * frame.x + cos * frame.y)
            };
            let from = if low <= 0.0 { 0.0 } else { place(low) };
            let to = if high >= angle { frame.length } else { place(high) };
            self.see(opposite, Window::new([from, to], [frame.x, frame.y], sigma, vertex));
        }
    }

    fn advance(&mut self, edge: u32) {
        if self.wave.due[edge as usize] != self.wave.now {
            return; // it was processed earlier
        }
        self.wave.due[edge as usize] = usize::MAX;
        let mut taken = std::mem::take(&mut self.wave.taken);
        let below = (self.wave.now + 1) as f64 / self.per_mm;
        let rest = self.wave.envelopes.take(edge, below, &mut taken);
        self.queue(edge, rest);
        let lower = self.frames.edges()[edge as usize];
        for window in taken.drain(..) {
            if window.leaves {
                let upper = self.surface.twins()[lower as usize];
                self.cross(upper, window.turned(self.frames.of(lower).length));
            } else {
                self.cross(lower, window);
            }
        }
        self.wave.taken = taken;
    }

    #[inline]
    fn queue(&mut self, edge: u32, least: f64) {
        let wave = &mut *self.wave;
        let bucket = ((least * self.per_mm) as usize).clamp(wave.now, wave.now + wave.buckets.len() - 1);
        if least < f64::INFINITY && bucket < wave.due[edge as usize] {
            wave.due[edge as usize] = bucket;
            let ring = wave.buckets.len();
            wave.buckets[bucket & (ring - 1)].push(edge);
        }
    }

    /// Propagates a window through the face of the half-edge that it enters.
    fn cross(&mut self, entered: u32, window: Window) {
        let frame = self.frames.of(entered);
        let corner = self.surface.origin(previous(entered));
        let (apart, up) = (frame.x - window.x, frame.y + window.y);
        // how far the opposite corner is to the right of the first line and to the left of the last one
        let right_of_first = window.y * apart - (window.from - window.x) * up;
        let left_of_last = (window.to - window.x) * up - window.y * apart;
        let straight = window.sigma + length(apart, up);
        if straight < self.wave.distance[corner as usize] {
            let bend = |at: f64| (at, window.at(at) + length(frame.x - at, frame.y));
            let (at, through) = if right_of_first < 0.0 {
                bend(window.from)
            } else if left_of_last < 0.0 {
                bend(window.to)
            } else {
                ((window.x + apart * window.y / up).clamp(window.from, window.to), straight)
            };
            let Window { x, y, root, .. } = window;
            self.lower(corner, through, Way::Across { half_edge: entered, at, x, y, root });
        }
        if right_of_first > 0.0 {
            self.leave_left(entered, frame, &window, left_of_last >= 0.0);
        }
        if left_of_last > 0.0 {
            self.leave_right(entered, frame, &window, right_of_first >= 0.0);
        }
    }

    /// Propagates the part of a window that leaves a face through the edge on the left, up to the corner or not.
    fn leave_left(&mut self, entered: u32, frame: Frame, window: &Window, to_corner: bool) {
        let left = previous(entered);
        let length = self.frames.of(left).length;
        let Window { x, y, .. } = *window;
        // lengths from the entered half-edge's origin
        // the line from (x, −y) through (at, 0) meets the line from the origin to the corner
        let hit = |at: f64| (length * at * y / (y * frame.x - (at - x) * frame.y)).clamp(0.0, length);
        let from = if to_corner { 0.0 } else { length - hit(window.to) };
        let to = length - hit(window.from);
        // the same origin in the frame of the left half-edge, which begins at the corner
        let along = ((frame.x - x) * frame.x + (frame.y + y) * frame.y) / length;
        let away = (frame.x * y + frame.y * x) / length;
        self.see(left, Window { from, to, x: along, y: away, ..*window });
    }

    /// Propagates the part of a window that leaves a face through the edge on the right, up to the corner or not.
    fn leave_right(&mut self, entered: u32, frame: Frame, window: &Window, to_corner: bool) {
        let right = next(entered);
        let length = self.frames.of(right).length;
        let (x, y) = (frame.length - window.x, window.y);
        let back = frame.length - frame.x;
        // lengths from the entered half-edge's target
        let hit = |at: f64| {
            let at = frame.length - at;
            (length * at * y / (y * back - (at - x) * frame.y)).clamp(0.0, length)
        };
        let from = hit(window.to);
        let to = if to_corner { length } else { hit(window.from) };
        let along = (x * back - y * frame.y) / length;
        let away = (back * y + frame.y * x) / length;
        self.see(right, Window { from, to, x: along, y: away, ..*window });
    }

    /// Adds a window to an edge from the face of a half-edge, which is its x-axis: the nearest parts of it are queued.
    #[inline]
    fn see(&mut self, half_edge: u32, mut window: Window) {
        let twin = self.surface.twins()[half_edge as usize];
        if !self.wave.rings.has(twin) {
            return;
        }
        let length = self.frames.of(half_edge).length;
        let [origin, target] = [self.surface.origin(half_edge), self.surface.target(half_edge)];
        window.trim(length, self.wave.distance[origin as usize], self.wave.distance[target as usize]);
        let is_some = window.to > window.from && window.y > 0.0; // not if anything is NaN
        if !is_some || window.least() > self.exact.reach.mm {
            return;
        }
        let window = Window { leaves: true, waits: true, ..window };
        let window = if twin < half_edge { window.turned(length) } else { window };
        let edge = self.frames.of(half_edge).edge;
        let least = self.wave.envelopes.insert(edge, length, &window);
        self.queue(edge, least);
    }
}
