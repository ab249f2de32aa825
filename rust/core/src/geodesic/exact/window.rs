//! Windows: the parts of edges that are visible from a source.

/// A stretch of an edge that straight lines reach from one point, through faces unfolded into the plane.
///
/// The edge's half-edge with the lower number is the x-axis. In mm.
#[derive(Debug, Clone, Copy)]
pub(super) struct Window {
    /// Where the stretch begins and ends.
    pub from: f64,
    pub to: f64,
    /// The origin of the lines: along the edge, and its distance from the edge.
    pub x: f64,
    pub y: f64,
    /// The distance of that point, a vertex, from the source.
    pub sigma: f64,
    pub root: u32,
    /// Whether the lines come from the face of that half-edge, rather than go there.
    pub leaves: bool,
    /// Whether it is still to be propagated into the next face.
    pub waits: bool,
}

/// The relative difference by which a window must be nearer than another one to replace it: more than rounding.
const TIE: f64 = 1e-14;

impl Window {
    /// Creates the window of an edge that is visible from a vertex, before its destination is known.
    pub fn new([from, to]: [f64; 2], [x, y]: [f64; 2], sigma: f64, root: u32) -> Self {
        Self { from, to, x, y, sigma, root, leaves: true, waits: true }
    }

    #[inline]
    pub fn at(&self, x: f64) -> f64 {
        self.sigma + length(x - self.x, self.y)
    }

    #[inline]
    pub fn least(&self) -> f64 {
        if self.x < self.from {
            self.at(self.from)
        } else if self.x > self.to {
            self.at(self.to)
        } else {
            self.sigma + self.y
        }
    }

    /// Returns the same window with the edge's other half-edge, whose length is given, as the x-axis.
    #[inline]
    pub fn turned(self, length: f64) -> Self {
        Self { from: length - self.to, to: length - self.from, x: length - self.x, leaves: !self.leaves, ..self }
    }

    /// Drops the parts that are farther than through the edge's ends, which are `origin` and `target` away from the
    /// source (the filter of Xin and Wang, for a part of a window). Parts that are equal up to rounding are kept: lines
    /// that nearly run along the edge may be the only ones that lead to what is behind it.
    #[inline]
    pub fn trim(&mut self, length: f64, origin: f64, target: f64) {
        let slack = TIE * (self.sigma + self.x.abs() + self.y + length);
        self.from = self.from.max(nearer_beyond(self.x, self.y, origin - self.sigma + slack));
        self.to = self.to.min(length - nearer_beyond(length - self.x, self.y, target - self.sigma + slack));
    }

    /// Returns where between `from` and `to` this window is nearer than `old`.
    pub fn against(&self, old: &Self, from: f64, to: f64) -> Contest {
        let ahead = old.sigma - self.sigma;
        let (dx, dy) = (old.x - self.x, old.y - self.y);
        let apart = dx * dx + dy * dy;
        if ahead * ahead >= apart && ahead <= 0.0 {
            return Contest::of(&[to], &[false]); // the path to it leads past the other's origin
        }
        if ahead > 0.0 && ahead * ahead >= apart * (1.0 + 1e-9) && ahead > 4.0 * TIE * old.sigma {
            return Contest::of(&[to], &[true]);
        }
        let wins = |from: f64, to: f64| {
            let middle = 0.5 * (from + to);
            let known = old.at(middle);
            self.at(middle) < known - TIE * known
        };
        let [first, second] = self.ties(old).map(|x| if x > from && x < to { x } else { to });
        let (first, second) = (first.min(second), first.max(second));
        if first >= to {
            Contest::of(&[to], &[wins(from, to)])
        } else if second >= to {
            Contest::of(&[first, to], &[wins(from, first), wins(first, to)])
        } else {
            Contest::of(&[first, second, to], &[wins(from, first), wins(first, second), wins(second, to)])
        }
    }

    /// Returns where both are equally near, if anywhere: roots of 2 δ √(x² + y²) = b − 2 d x, squared; one may be
    /// spurious.
    #[inline]
    fn ties(&self, old: &Self) -> [f64; 2] {
        let delta = self.sigma - old.sigma;
        let d = old.x - self.x;
        // squared once more: e x² − d b x + (b² − 4 δ² y²)/4 = 0; differences of squares are products, to keep digits
        let e = (d - delta) * (d + delta);
        let b = e + (old.y - self.y) * (old.y + self.y);
        let root = delta.abs() * (b * b + 4.0 * e * self.y * self.y).max(0.0).sqrt();
        // the root without cancellation; the other one follows from the product of both (Vieta)
        let sum = d * b + root.copysign(d * b);
        let constant = 0.5 * (b - 2.0 * delta * self.y) * (b + 2.0 * delta * self.y);
        [self.x + 0.5 * sum / e, self.x + constant / sum]
    }
}

/// Up to three successive stretches, and which window is nearer there.
#[derive(Debug, Clone, Copy)]
pub(super) struct Contest {
    ends: [f64; 3],
    wins: [bool; 3],
    count: usize,
}

impl Contest {
    fn of(ends: &[f64], wins: &[bool]) -> Self {
        let mut contest = Self { ends: [0.0; 3], wins: [false; 3], count: ends.len() };
        contest.ends[..ends.len()].copy_from_slice(ends);
        contest.wins[..wins.len()].copy_from_slice(wins);
        contest
    }

    /// Returns the end of each stretch, and whether the new window is nearer.
    pub fn stretches(self) -> impl Iterator<Item = (f64, bool)> {
        self.ends.into_iter().zip(self.wins).take(self.count)
    }
}

/// Returns up to where on an axis a point at (`x`, `y`) is no nearer than the path through the origin, `ahead` away.
#[inline]
fn nearer_beyond(x: f64, y: f64, ahead: f64) -> f64 {
    if ahead == f64::INFINITY {
        f64::NEG_INFINITY
    } else if ahead <= -x {
        // at p ≥ 0, the distance is at least p − x, which is no less than p + ahead
        f64::INFINITY
    } else {
        // (p − x)² + y² = (p + ahead)² is linear in p
        0.5 * (x * x + y * y - ahead * ahead) / (x + ahead)
    }
}

#[inline]
pub(super) fn length(x: f64, y: f64) -> f64 {
    (x * x + y * y).sqrt()
}
