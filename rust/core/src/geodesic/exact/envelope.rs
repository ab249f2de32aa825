//! The nearest windows of every edge.

use super::window::{Contest, State, Window};

const NONE: u32 = u32::MAX;

/// Windows narrower than this part of their edge are left out: vertices behind are reached around the next one's end, which is
/// longer by no more than its square.
const NARROWEST: f64 = 1e-12;

/// The windows of each edge that are nearest somewhere, side by side; edges go by their lower half-edge.
///
/// Windows lie in one list; those of an edge are linked, and those no longer used are used again.
#[derive(Debug)]
pub(super) struct Envelopes {
    heads: Vec<u32>,
    windows: Vec<Window>,
    unused: Vec<u32>,
    edges: Vec<u32>,
}

impl Envelopes {
    pub fn new(half_edges: usize) -> Self {
        Self { heads: vec![NONE; half_edges], windows: Vec::new(), unused: Vec::new(), edges: Vec::new() }
    }

    pub fn clear(&mut self) {
        self.edges.drain(..).for_each(|edge| self.heads[edge as usize] = NONE);
        self.windows.clear();
        self.unused.clear();
    }

    #[inline]
    pub fn get(&self, window: u32) -> &Window {
        &self.windows[window as usize]
    }

    /// How many windows there are.
    pub fn len(&self) -> usize {
        self.windows.len() - self.unused.len()
    }

    /// Takes a window out of the queue: the window, or nothing where nothing is left of it.
    #[inline]
    pub fn take(&mut self, window: u32) -> Option<Window> {
        let taken = &mut self.windows[window as usize];
        if taken.state == State::Beaten {
            self.unused.push(window);
            return None;
        }
        taken.state = State::Gone;
        Some(*taken)
    }

    /// Puts a window back into the queue.
    #[inline]
    pub fn put_back(&mut self, window: u32) {
        self.windows[window as usize].state = State::Waiting;
    }

    /// Keeps of a new window what is nearer than the edge's others, and of those what is not farther; lists the windows that
    /// the queue does not have yet.
    pub fn insert(&mut self, edge: u32, length: f64, new: Window, fresh: &mut Vec<u32>) {
        let mut place = Place { edge, before: NONE, slot: None, narrowest: NARROWEST * length };
        let mut at = self.heads[edge as usize];
        if at == NONE {
            self.edges.push(edge);
        }
        while at != NONE && self.windows[at as usize].to <= new.from {
            place.before = at;
            at = self.windows[at as usize].next;
        }
        let mut start = new.from; // of what nothing has beaten so far
        while at != NONE && self.windows[at as usize].from < new.to {
            let old = self.windows[at as usize];
            let (from, to) = (old.from.max(new.from), old.to.min(new.to));
            let contest = new.against(&old, from, to);
            if contest.is_lost() {
                self.link(&mut place, Window { from: start, to: from, ..new }, fresh);
                place.before = at;
                start = to;
            } else {
                self.follow(&place, old.next);
                place.slot = Some(at);
                start = self.divide(&mut place, &old, &new, start, contest, fresh);
                if let Some(slot) = place.slot.take() {
                    self.release(slot);
                }
            }
            at = old.next;
        }
        self.link(&mut place, Window { from: start, ..new }, fresh);
    }

    /// Links what a contest leaves of an old window and, from `start`, of the new one; returns where the part of the new one
    /// begins that is still to be linked.
    fn divide(
        &mut self,
        place: &mut Place,
        old: &Window,
        new: &Window,
        start: f64,
        contest: Contest,
        fresh: &mut Vec<u32>,
    ) -> f64 {
        let (mut is_new, mut start) = if old.from < new.from { (false, old.from) } else { (true, start) };
        let mut begin = old.from.max(new.from);
        for (end, wins) in contest.stretches() {
            if wins != is_new {
                if is_new {
                    self.link(place, Window { from: start, to: begin, ..*new }, fresh);
                } else {
                    self.keep(place, Window { from: start, to: begin, ..*old }, fresh);
                }
                (is_new, start) = (wins, begin);
            }
            begin = end;
        }
        if is_new {
            if begin == old.to {
                return start;
            }
            self.link(place, Window { from: start, to: begin, ..*new }, fresh);
            start = begin;
        }
        self.keep(place, Window { from: start, ..*old }, fresh);
        begin
    }

    /// Leaves out the windows of edges that no further window can reach first.
    pub fn sweep(&mut self, is_over: impl Fn(u32) -> bool) {
        let mut edges = std::mem::take(&mut self.edges);
        edges.retain(|&edge| {
            if self.heads[edge as usize] != NONE && !is_over(edge) {
                return true;
            }
            let mut at = std::mem::replace(&mut self.heads[edge as usize], NONE);
            while at != NONE {
                let next = self.windows[at as usize].next;
                self.release(at);
                at = next;
            }
            false
        });
        self.edges = edges;
    }

    /// Makes `next` follow on a place.
    #[inline]
    fn follow(&mut self, place: &Place, next: u32) {
        match place.before {
            NONE => self.heads[place.edge as usize] = next,
            before => self.windows[before as usize].next = next,
        }
    }

    /// Links a window at a place, in a slot of its own.
    fn link(&mut self, place: &mut Place, window: Window, fresh: &mut Vec<u32>) {
        if !place.fits(&window) {
            return;
        }
        let slot = self.unused.pop().unwrap_or_else(|| {
            self.windows.push(window);
            self.windows.len() as u32 - 1
        });
        self.put(place, slot, window);
        if window.state == State::Waiting {
            fresh.push(slot);
        }
    }

    /// Links a piece of an old window at a place: the first in the old slot.
    fn keep(&mut self, place: &mut Place, piece: Window, fresh: &mut Vec<u32>) {
        if place.fits(&piece) {
            match place.slot.take() {
                Some(slot) => self.put(place, slot, piece),
                None => self.link(place, piece, fresh),
            }
        }
    }

    fn put(&mut self, place: &mut Place, slot: u32, window: Window) {
        let next = match place.before {
            NONE => self.heads[place.edge as usize],
            before => self.windows[before as usize].next,
        };
        self.windows[slot as usize] = Window { next, ..window };
        self.follow(place, slot);
        place.before = slot;
    }

    /// Gives a window up; the queue may still have it.
    fn release(&mut self, window: u32) {
        let released = &mut self.windows[window as usize];
        if released.state == State::Waiting {
            released.state = State::Beaten;
        } else {
            self.unused.push(window);
        }
    }
}

/// Where in the list of an edge the next window is linked.
struct Place {
    edge: u32,
    before: u32,
    /// The slot of the window that is being divided.
    slot: Option<u32>,
    narrowest: f64,
}

impl Place {
    #[inline]
    fn fits(&self, window: &Window) -> bool {
        window.to - window.from > self.narrowest
    }
}
