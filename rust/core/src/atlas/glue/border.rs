//! Tests whether a piece is one to one: its triangles must be upright and surround each position once, and its boundary
//! must not meet itself. (For b boundary curves that do not meet, the number of counterclockwise ones equals the
//! surface's Euler characteristic plus the number of clockwise ones: 2 k = 2 − 2 g. So there is one, which covers
//! points once at most.)

use nalgebra::Vector2;
use robust::{Coord, orient2d};

use super::layout::Layout;
use super::strain::Place;
use crate::boxes::{Bounds, Tree};
use crate::{Control, Result};

struct Side {
    places: [u32; 2],
    ends: [Place; 2],
    moved: bool,
}

/// Returns whether the boundary of pieces to be united meets itself, where `moved` holds for one of the two positions.
pub(super) fn meets_itself(
    layout: &Layout<'_>, pieces: &[u32], moved: &dyn Fn(u32) -> bool, control: &Control,
) -> Result<bool> {
    let facets = pieces.iter().flat_map(|&piece| &layout.members[piece as usize]);
    let open = facets.flat_map(|&facet| 3 * facet..3 * facet + 3).filter(|&side| layout.is_open(side));
    let side = |side: u32| {
        let places = layout.ends(side);
        let ends = places.map(|place| layout.uv[place as usize]);
        Side { places, ends, moved: places.iter().any(|&place| moved(place)) }
    };
    let mut sides: Vec<Side> = open.map(side).collect();
    control.check()?;
    // only sides close to moved ones
    let (mut low, mut high) = (Vector2::repeat(f64::INFINITY), Vector2::repeat(f64::NEG_INFINITY));
    for end in sides.iter().filter(|side| side.moved).flat_map(|side| side.ends) {
        (low, high) = (low.inf(&end), high.sup(&end));
    }
    let margin = 1e-9 * (high - low).norm();
    sides.retain(|Side { ends: [a, b], .. }| {
        (0..2).all(|k| a[k].min(b[k]) <= high[k] + margin && a[k].max(b[k]) >= low[k] - margin)
    });
    let tree = Tree::over(sides.iter().map(|side| Bounds::of(&side.ends, margin)).collect());
    for (position, &n) in tree.order.iter().enumerate() {
        control.check()?;
        let side = &sides[n as usize];
        if side.moved && tree.any_other(position, &mut |other| meet(side, &sides[other as usize])) {
            return Ok(true);
        }
    }
    Ok(false)
}

/// Returns whether two sides without a common end meet.
fn meet(one: &Side, other: &Side) -> bool {
    let is_common = one.places.iter().any(|place| other.places.contains(place));
    if is_common || one.ends.iter().any(|end| other.ends.contains(end)) {
        return false; // their angle is checked with those of the facets around
    }
    let [a, b, c, d] = [one.ends[0], one.ends[1], other.ends[0], other.ends[1]].map(|p| Coord { x: p.x, y: p.y });
    let parts = |a, b, c, d| {
        let (left, right): (f64, f64) = (orient2d(a, b, c), orient2d(a, b, d));
        (left > 0.0 && right > 0.0) || (left < 0.0 && right < 0.0)
    };
    if parts(a, b, c, d) || parts(c, d, a, b) {
        return false;
    }
    // for collinear sides, the boxes decide
    (0..2).all(|k| {
        let [p, q, r, s] = [one.ends[0][k], one.ends[1][k], other.ends[0][k], other.ends[1][k]];
        p.min(q) <= r.max(s) && r.min(s) <= p.max(q)
    })
}
