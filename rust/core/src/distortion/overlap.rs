//! Overlaps of a flat map with itself.
//!
//! A map without flipped triangles can still cover itself where distant parts of its boundary run into each other. The
//! tests are exact by Shewchuk's predicate (crate `robust`), for positions in mm of any size that does not underflow.
//! Only interiors count: triangles that touch, doubled vertices along a cut and coincident edges are not overlaps.

use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;
use robust::{Coord, orient2d};

use super::faces::sorted_edges;
use crate::boxes::{Bounds, Tree};
use crate::error::check_points;
use crate::{Control, Result};

/// The number of searches in one step of the progress.
const CHUNK: usize = 256;

/// The places where a flat map overlaps itself.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Overlap {
    /// The number of pairs of boundary edges that cross at a point that is not an end of either. It is zero in an
    /// embedding. A boundary that crosses itself exactly at a vertex, or inside the map, appears only in `covering`.
    pub crossings: usize,
    /// The number of triangles that cover a part of another triangle.
    pub covering: usize,
    /// For each face, whether it covers a part of another face.
    pub per_face: Vec<bool>,
}

/// Finds where a flat map (`uv`, mm) of triangles overlaps itself. Triangles without area or with an undefined corner
/// cover nothing. Edges with one face form the boundary.
///
/// # Errors
/// [`Error::NoSuchPoint`](crate::Error::NoSuchPoint) if a corner has no position, and
/// [`Error::Cancelled`](crate::Error::Cancelled).
pub fn overlaps(faces: &[[u32; 3]], uv: &[[f64; 2]], control: &Control) -> Result<Overlap> {
    check_points(faces.iter().flatten().copied(), uv.len())?;
    let place = |vertex: u32| Coord { x: uv[vertex as usize][0], y: uv[vertex as usize][1] };
    let edges = sorted_edges(faces);
    let boundary = edges.chunk_by(|a, b| a == b).filter(|same| same.len() == 1).map(|same| same[0].map(place));
    let boundary: Vec<_> = boundary.filter(|ends| is_placed(ends)).collect();
    let (numbers, triangles): (Vec<usize>, Vec<_>) =
        (0..).zip(faces).filter_map(|(n, face)| Some((n, counterclockwise(face.map(place))?))).unzip();
    control.begin("looking for overlaps", (boundary.len().div_ceil(CHUNK) + triangles.len().div_ceil(CHUNK)) as u64);
    let crossings = count_crossings(&boundary, control)?;
    let mut per_face = vec![false; faces.len()];
    let covering = find_covering(&triangles, control)?;
    numbers.iter().zip(&covering).for_each(|(&n, &covers)| per_face[n] = covers);
    Ok(Overlap { crossings, covering: covering.iter().filter(|&&covers| covers).count(), per_face })
}

type Segment = [Coord<f64>; 2];
pub(crate) type Triangle = [Coord<f64>; 3];

fn is_placed(corners: &[Coord<f64>]) -> bool {
    corners.iter().all(|corner| corner.x.is_finite() && corner.y.is_finite())
}

/// Returns the triangle with counterclockwise orientation; none if it has no interior.
pub(crate) fn counterclockwise([a, b, c]: Triangle) -> Option<Triangle> {
    match orient2d(a, b, c) {
        _ if !is_placed(&[a, b, c]) => None,
        left if left > 0.0 => Some([a, b, c]),
        left if left < 0.0 => Some([a, c, b]),
        _ => None,
    }
}

/// Returns whether segments cross at a point that is not an end of either.
fn cross([a, b]: Segment, [c, d]: Segment) -> bool {
    let opposite = |left: f64, right: f64| (left > 0.0 && right < 0.0) || (left < 0.0 && right > 0.0);
    // each segment has its ends strictly on both sides of the other's line
    opposite(orient2d(a, b, c), orient2d(a, b, d)) && opposite(orient2d(c, d, a), orient2d(c, d, b))
}

/// Returns whether counterclockwise triangles have a common interior point. Convex sets have none if and only if a line
/// separates them; for polygons, a line along one of their sides does.
pub(crate) fn interiors_meet(a: &Triangle, b: &Triangle) -> bool {
    let outside = |a: &Triangle, k: usize, b: &Triangle| b.iter().all(|&p| orient2d(a[k], a[(k + 1) % 3], p) <= 0.0);
    (0..3).all(|k| !outside(a, k, b) && !outside(b, k, a))
}

/// Returns the number of pairs of segments that cross at a point that is not an end of either.
pub(crate) fn count_crossings(segments: &[Segment], control: &Control) -> Result<usize> {
    let tree = Tree::over(segments.iter().map(|ends| Bounds::around(ends)).collect());
    let of_chunk = |chunk: Range<usize>| {
        let mut count = 0;
        for position in chunk {
            control.check()?;
            let n = tree.order[position];
            // count each pair once
            tree.any_other(position, &mut |other| {
                count += usize::from(other > n && cross(segments[n as usize], segments[other as usize]));
                false
            });
        }
        control.advance();
        Ok(count)
    };
    chunks(segments.len()).map(of_chunk).try_reduce(|| 0, |a, b| Ok(a + b))
}

/// Returns which triangles cover a part of another one. The search from a triangle ends at the first hit, and both are
/// marked, so that a map with many folds takes no longer than a good one. Marks are always correct, and the search from
/// an unmarked triangle is complete, so the order of the threads does not matter.
fn find_covering(triangles: &[Triangle], control: &Control) -> Result<Vec<bool>> {
    let tree = Tree::over(triangles.iter().map(|corners| Bounds::around(corners)).collect());
    let covering: Vec<AtomicBool> = triangles.iter().map(|_| AtomicBool::new(false)).collect();
    let is_marked = |n: u32| covering[n as usize].load(Ordering::Relaxed);
    let mark = |n: u32| covering[n as usize].store(true, Ordering::Relaxed);
    chunks(triangles.len()).try_for_each(|chunk| {
        for position in chunk {
            control.check()?;
            let n = tree.order[position];
            let meets = |other: u32| {
                let meet = interiors_meet(&triangles[n as usize], &triangles[other as usize]);
                if meet {
                    mark(n);
                    mark(other);
                }
                meet
            };
            if !is_marked(n) {
                tree.any_other(position, &mut { meets });
            }
        }
        control.advance();
        Ok(())
    })?;
    Ok(covering.into_iter().map(AtomicBool::into_inner).collect())
}

/// Iterates in parallel over the numbers below `count`, in chunks of one progress step.
fn chunks(count: usize) -> impl IndexedParallelIterator<Item = Range<usize>> {
    (0..count.div_ceil(CHUNK)).into_par_iter().map(move |n| n * CHUNK..((n + 1) * CHUNK).min(count))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::distortion::tests::grid;
    use proptest::prelude::*;
    use std::collections::HashMap;

    fn found(faces: &[[u32; 3]], uv: &[[f64; 2]]) -> Overlap {
        overlaps(faces, uv, &Control::default()).unwrap()
    }

    fn counts(faces: &[[u32; 3]], uv: &[[f64; 2]]) -> (usize, usize) {
        let overlap = found(faces, uv);
        (overlap.crossings, overlap.covering)
    }

    /// Returns the area that two triangles share, by clipping one at the sides of the other.
    fn shared_area(a: [[f64; 2]; 3], b: [[f64; 2]; 3]) -> f64 {
        let left =
            |a: [f64; 2], b: [f64; 2], p: [f64; 2]| (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]);
        let turn = left(b[0], b[1], b[2]).signum();
        let mut polygon = a.to_vec();
        for k in 0..3 {
            let side = |p: [f64; 2]| turn * left(b[k], b[(k + 1) % 3], p);
            let mut kept = Vec::new();
            for (n, &p) in polygon.iter().enumerate() {
                let q = polygon[(n + 1) % polygon.len()];
                let (from, to) = (side(p), side(q));
                if from >= 0.0 {
                    kept.push(p);
                }
                if from * to < 0.0 {
                    let t = from / (from - to);
                    kept.push([p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1])]);
                }
            }
            polygon = kept;
        }
        let fan = (2..polygon.len()).map(|n| left(polygon[0], polygon[n - 1], polygon[n]));
        0.5 * fan.sum::<f64>().abs()
    }

    /// Rounds positions to a lattice with a power of two of points per mm. There, the signs in [`brute_force`] have no
    /// rounding error, and on a coarse lattice no shared area is as small as a rounding error.
    fn on_lattice(per_mm: f64, uv: impl Iterator<Item = [f64; 2]>) -> Vec<[f64; 2]> {
        uv.map(|p| p.map(|x| (x * per_mm).round() / per_mm)).collect()
    }

    /// Finds overlaps by their definition: shared areas, and crossings as the solution of two equations.
    fn brute_force(faces: &[[u32; 3]], uv: &[[f64; 2]]) -> Overlap {
        let corners = |face: &[u32; 3]| face.map(|v| uv[v as usize]);
        let has_area = |face: &[u32; 3]| shared_area(corners(face), corners(face)) > 0.0;
        let covers = |n: usize| {
            let others = faces.iter().enumerate().filter(|&(m, other)| m != n && has_area(other));
            has_area(&faces[n])
                && others.map(|(_, other)| shared_area(corners(&faces[n]), corners(other))).any(|area| area > 1e-12)
        };
        let per_face: Vec<bool> = (0..faces.len()).map(covers).collect();
        let mut uses = HashMap::new();
        for [a, b, c] in faces {
            for (a, b) in [(a, b), (b, c), (c, a)] {
                *uses.entry((a.min(b), a.max(b))).or_insert(0) += 1;
            }
        }
        let boundary: Vec<_> = uses.iter().filter(|(_, uses)| **uses == 1).map(|(ends, _)| *ends).collect();
        let crosses = |m: usize, n: usize| {
            let [a, b, c, d] = [boundary[m].0, boundary[m].1, boundary[n].0, boundary[n].1].map(|&v| uv[v as usize]);
            let (p, q, r) = ([b[0] - a[0], b[1] - a[1]], [d[0] - c[0], d[1] - c[1]], [c[0] - a[0], c[1] - a[1]]);
            let det = p[0] * q[1] - p[1] * q[0];
            let (s, t) = ((r[0] * q[1] - r[1] * q[0]) * det.signum(), (r[0] * p[1] - r[1] * p[0]) * det.signum());
            s > 0.0 && s < det.abs() && t > 0.0 && t < det.abs()
        };
        let crossings = (0..boundary.len()).map(|n| (0..n).filter(|&m| crosses(m, n)).count()).sum();
        Overlap { crossings, covering: per_face.iter().filter(|&&covers| covers).count(), per_face }
    }

    fn triples(vertices: u32, most: usize) -> impl Strategy<Value = Vec<[u32; 3]>> {
        prop::collection::vec(prop::array::uniform3(0..vertices), 1..most)
    }

    proptest! {
        /// Integers: corners on sides, sides on sides, the same triangle twice, triangles without area.
        #[test]
        fn touching_triangles_are_as_by_brute_force(
            places in prop::collection::vec(prop::array::uniform2(0..8i32), 24),
            faces in triples(24, 16),
        ) {
            let uv: Vec<_> = places.iter().map(|p| p.map(f64::from)).collect();
            prop_assert_eq!(found(&faces, &uv), brute_force(&faces, &uv));
        }

        #[test]
        fn a_soup_is_as_by_brute_force(
            places in prop::collection::vec(prop::array::uniform2(-9.0..9.0f64), 300),
            size in 0.02..1.0f64,
        ) {
            // separate triangles, from small and scattered to large and overlapping
            let centre = |n: usize| places[(n / 3 * 3 + 150) % 300];
            let corner = |(n, p): (usize, &[f64; 2])| [0, 1].map(|k| centre(n)[k] + size * p[k]);
            let uv = on_lattice(16.0, places.iter().enumerate().map(corner));
            let faces: Vec<[u32; 3]> = (0..100).map(|n| [3 * n, 3 * n + 1, 3 * n + 2]).collect();
            prop_assert_eq!(found(&faces, &uv), brute_force(&faces, &uv));
        }

        #[test]
        fn a_shaken_map_is_as_by_brute_force(
            shake in prop::collection::vec(prop::array::uniform2(-1.0..1.0f64), 99),
            size in 0.0..1.5f64,
        ) {
            let (uv, faces) = grid(10, 8);
            let uv = on_lattice(16.0, uv.iter().zip(&shake).map(|(p, d)| [p[0] + size * d[0], p[1] + size * d[1]]));
            prop_assert_eq!(found(&faces, &uv), brute_force(&faces, &uv));
        }
    }

    #[test]
    fn a_seam_is_no_overlap() {
        // a grid that is cut along a column: the vertices there are doubled and coincide
        let (mut uv, faces) = grid(6, 4);
        uv.iter_mut().for_each(|p| *p = [p[0] * 0.1 + 0.3 * p[1], p[1] * 0.7]);
        let columns = |n: u32| n % 7;
        let doubled: Vec<u32> = (0..uv.len() as u32).filter(|&n| columns(n) == 3).collect();
        let copy = |n: u32| 35 + n / 7;
        let right = |face: &[u32; 3]| face.iter().any(|&v| columns(v) > 3);
        let cut: Vec<_> =
            faces.iter().map(|face| face.map(|v| if right(face) && columns(v) == 3 { copy(v) } else { v })).collect();
        doubled.iter().for_each(|&v| uv.push(uv[v as usize]));
        assert_eq!(counts(&cut, &uv), (0, 0));
        // minimal overlap
        (35..40).for_each(|v| uv[v][0] -= 1e-15);
        assert!(counts(&cut, &uv).1 > 0);
    }

    #[test]
    fn a_fold_covers_what_lies_under_it() {
        let (uv, faces) = grid(4, 3);
        // folded at x = 3: the last column covers the previous one
        let folded: Vec<_> = uv.iter().map(|&[x, y]| [3.0 - (x - 3.0).abs(), y]).collect();
        let overlap = found(&faces, &folded);
        assert_eq!((overlap.crossings, overlap.covering), (0, 12)); // boundaries coincide and do not cross
        let covers = |n: usize| (n / 2) % 4 >= 2;
        assert!(overlap.per_face.iter().enumerate().all(|(n, &is)| is == covers(n)));
        // two triangles at a common side
        let square = [[0.0, 0.0], [1.0, 0.0], [0.3, 1.0], [0.4, -1.0]];
        let mut fold = square;
        fold[3][1] = 0.2;
        assert_eq!(counts(&[[0, 1, 2], [1, 0, 3]], &square), (0, 0));
        assert_eq!(counts(&[[0, 1, 2], [1, 0, 3]], &fold), (0, 2));
    }

    #[test]
    fn what_has_no_interior_covers_nothing() {
        let uv = [[0.0, 0.0], [4.0, 0.0], [0.0, 4.0], [1.0, 1.0], [2.0, 2.0], [f64::NAN, 0.0]];
        assert_eq!(counts(&[[0, 1, 2], [0, 3, 4], [3, 3, 1], [1, 2, 5]], &uv), (0, 0));
        assert_eq!(counts(&[[0, 1, 2], [0, 1, 2]], &uv), (0, 2));
        // an infinite corner, along either axis
        for far in [[f64::INFINITY, 1.0], [1.0, f64::INFINITY], [f64::NEG_INFINITY; 2]] {
            let uv = [[0.0, 0.0], [4.0, 0.0], [0.0, 4.0], [1.0, 1.0], [2.0, 1.0], far];
            assert_eq!(counts(&[[0, 1, 2], [3, 4, 5]], &uv), (0, 0), "{far:?}");
            assert_eq!(counts(&[[0, 1, 2], [4, 3, 5]], &uv), (0, 0), "{far:?}");
        }
    }
}
