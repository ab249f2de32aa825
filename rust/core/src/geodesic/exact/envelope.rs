//! The nearest windows of every edge.

use super::window::Window;

/// Windows narrower than this share of their edge are dropped: vertices behind them are reached around the end of the
/// next window, on a path that is longer by at most its square.
const NARROWEST: f64 = 1e-12;

/// The windows of each edge that are nearest somewhere, side by side.
#[derive(Debug)]
pub(super) struct Envelopes {
    lists: Vec<Vec<Window>>,
    /// The edges that have windows.
    used: Vec<u32>,
    /// Lists of finished edges, for reuse.
    spare: Vec<Vec<Window>>,
    pieces: Vec<Window>,
    count: usize,
}

impl Envelopes {
    pub fn new(edges: usize) -> Self {
        Self { lists: vec![Vec::new(); edges], used: Vec::new(), spare: Vec::new(), pieces: Vec::new(), count: 0 }
    }

    pub fn clear(&mut self) {
        self.sweep(|_| true);
    }

    pub fn len(&self) -> usize {
        self.count
    }

    /// Takes the waiting windows of an edge that begin below a distance; returns the smallest distance of the others.
    pub fn take(&mut self, edge: u32, below: f64, taken: &mut Vec<Window>) -> f64 {
        let mut rest = f64::INFINITY;
        for window in self.lists[edge as usize].iter_mut().filter(|window| window.waits) {
            let least = window.least();
            if least < below {
                window.waits = false;
                taken.push(*window);
            } else {
                rest = rest.min(least);
            }
        }
        rest
    }

    /// Keeps the part of a new window that is nearer than the edge's other windows, and the parts of those that are not
    /// farther; returns the smallest distance of the kept part of the new window, infinity if there is none.
    pub fn insert(&mut self, edge: u32, length: f64, new: &Window) -> f64 {
        let Self { lists, used, spare, pieces, count } = self;
        let list = &mut lists[edge as usize];
        if list.is_empty() {
            used.push(edge);
            if list.capacity() == 0 {
                *list = spare.pop().unwrap_or_default();
            }
        }
        let first = list.iter().position(|old| old.to > new.from).unwrap_or(list.len());
        let overlapping = list[first..].iter().take_while(|old| old.from < new.to).count();
        pieces.clear();
        let mut least = f64::INFINITY;
        let mut emit = |window: &Window, is_new: bool, from: f64, to: f64| {
            if to - from > NARROWEST * length {
                let piece = Window { from, to, ..*window };
                least = if is_new { least.min(piece.least()) } else { least };
                pieces.push(piece);
            }
        };
        let (mut is_new, mut start) = (true, new.from); // the window of the current stretch, and where it begins
        for old in &list[first..first + overlapping] {
            let mut end = old.from.max(new.from);
            if old.from < new.from {
                (is_new, start) = (false, old.from);
            }
            for (next, wins) in new.against(old, end, old.to.min(new.to)).stretches() {
                if wins != is_new {
                    emit(if is_new { new } else { old }, is_new, start, end);
                    (is_new, start) = (wins, end);
                }
                end = next;
            }
            if is_new && end < old.to {
                emit(new, true, start, end);
                (is_new, start) = (false, end);
            }
            if !is_new {
                emit(old, false, start, old.to);
                (is_new, start) = (true, end);
            }
        }
        emit(new, true, start, new.to);
        if least < f64::INFINITY {
            *count += pieces.len();
            *count -= overlapping;
            list.splice(first..first + overlapping, pieces.drain(..));
        }
        least
    }

    /// Drops the windows of edges that no further window can reach first.
    pub fn sweep(&mut self, is_over: impl Fn(u32) -> bool) {
        let Self { lists, used, spare, count, .. } = self;
        used.retain(|&edge| {
            let list = &mut lists[edge as usize];
            let stays = !list.is_empty() && !is_over(edge);
            if !stays && list.capacity() > 0 {
                *count -= list.len();
                list.clear();
                spare.push(std::mem::take(list));
            }
            stays
        });
    }
}
