//! The voxels between two surfaces with the same triangles, such as white and pial: the triangle whose column contains
//! each voxel, and the depth within that column.
//!
//! A prism connects each triangle with its counterpart. It is divided into three tetrahedra, along diagonals from the
//! vertex with the lower number inside to that with the higher number outside. Neighbours share the diagonals, so that
//! prisms that are not inverted fill the ribbon without gaps or overlaps.

use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use crate::error::{check_length, check_points};
use crate::{Control, Result};

/// The tolerance in barycentric coordinates, so that voxels on a common side lie in at least one tetrahedron.
const SLACK: f64 = 1e-9;

/// The number of triangles that one worker processes between two checks for cancellation.
const CHUNK: usize = 256;

/// A voxel in a column.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InColumn {
    /// The number of the voxel; its last index counts fastest.
    pub voxel: u64,
    /// The triangle of the column.
    pub triangle: u32,
    /// The barycentric coordinates in the triangle.
    pub weights: [f64; 3],
    /// The depth, from 0 at the inner surface to 1 at the outer surface.
    pub fraction: f64,
}

/// Finds the voxels whose centres lie between two surfaces, in ascending order without duplicates.
///
/// Where columns overlap, a voxel is assigned to the column in which its depth is closest to `middle`, a fraction; of
/// several such columns, to the first.
///
/// # Arguments
/// - `inner`, `outer`: The vertices of both surfaces, in voxel indices.
/// - `numbers`: The identity of each vertex; the two sides of a cut share it.
/// - `shape`: The shape of the volume.
///
/// # Errors
/// [`Error::WrongLength`](crate::Error::WrongLength) if the surfaces and numbers differ in length,
/// [`Error::NoSuchPoint`](crate::Error::NoSuchPoint) if a corner is not the number of a vertex, and
/// [`Error::Cancelled`](crate::Error::Cancelled).
pub fn voxels(
    inner: &[[f64; 3]], outer: &[[f64; 3]], faces: &[[u32; 3]], numbers: &[i64], shape: [usize; 3], middle: f64,
    control: &Control,
) -> Result<Vec<InColumn>> {
    check_length("outer vertices", outer.len(), "inner vertices", inner.len())?;
    check_length("numbers", numbers.len(), "inner vertices", inner.len())?;
    check_points(faces.iter().flatten().copied(), inner.len())?;
    control.begin("finding voxels of the ribbon", faces.len().div_ceil(CHUNK) as u64);
    let of_chunk = |(part, faces): (usize, &[[u32; 3]])| {
        control.check()?;
        let mut found = Vec::new();
        for (triangle, face) in ((part * CHUNK) as u32..).zip(faces) {
            let place = |surface: &[[f64; 3]]| face.map(|vertex| Vector3::from(surface[vertex as usize]));
            let numbers = face.map(|vertex| numbers[vertex as usize]);
            column(triangle, &place(inner), &place(outer), &numbers, shape, &mut found);
        }
        control.advance();
        Ok(found)
    };
    let parts: Vec<Vec<InColumn>> = faces.par_chunks(CHUNK).enumerate().map(of_chunk).collect::<Result<_>>()?;
    let mut found = parts.concat();
    let off = |of: &InColumn| (of.fraction - middle).abs();
    found.par_sort_by(|a, b| a.voxel.cmp(&b.voxel).then(off(a).total_cmp(&off(b))).then(a.triangle.cmp(&b.triangle)));
    found.dedup_by_key(|of| of.voxel);
    Ok(found)
}

fn column(
    triangle: u32, inner: &[Vector3<f64>; 3], outer: &[Vector3<f64>; 3], numbers: &[i64; 3], shape: [usize; 3],
    found: &mut Vec<InColumn>,
) {
    if !inner.iter().chain(outer).flatten().all(|x| x.is_finite()) {
        return;
    }
    let mut order = [0, 1, 2];
    order.sort_by_key(|&k| (numbers[k], k));
    for split in 1..4 {
        // inner vertices up to the (4 - split)-th, outer ones from there on
        let ends: [(usize, bool); 4] =
            std::array::from_fn(|n| if n < 4 - split { (order[n], false) } else { (order[n - 1], true) });
        let corners = ends.map(|(k, is_outer)| if is_outer { outer[k] } else { inner[k] });
        tetrahedron(&corners, shape, |voxel, parts| {
            let (mut weights, mut fraction) = ([0.0; 3], 0.0);
            for (&(k, is_outer), part) in ends.iter().zip(parts) {
                weights[k] += part;
                fraction += if is_outer { part } else { 0.0 };
            }
            found.push(InColumn { voxel, triangle, weights, fraction });
        });
    }
}

/// Calls `call` for each voxel in a tetrahedron, with its barycentric coordinates.
fn tetrahedron(corners: &[Vector3<f64>; 4], shape: [usize; 3], mut call: impl FnMut(u64, [f64; 4])) {
    let [a, b, c, d] = corners;
    let Some(inverse) = Matrix3::from_columns(&[b - a, c - a, d - a]).try_inverse() else { return };
    let low = a.inf(b).inf(c).inf(d);
    let high = a.sup(b).sup(c).sup(d);
    let [i, j, k] = [0, 1, 2].map(|axis| {
        let first = low[axis].ceil().max(0.0);
        let last = high[axis].floor().min(shape[axis] as f64 - 1.0);
        if first <= last { first as usize..last as usize + 1 } else { 0..0 }
    });
    for i in i {
        for j in j.clone() {
            for k in k.clone() {
                let of = inverse * (Vector3::new(i as f64, j as f64, k as f64) - a);
                let parts = [1.0 - of.sum(), of.x, of.y, of.z];
                if parts.iter().all(|&part| part >= -SLACK) {
                    call(((i * shape[1] + j) * shape[2] + k) as u64, parts);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::mesh::shapes;
    use proptest::prelude::*;

    fn sheet(height: f64) -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
        let (points, faces) = shapes::sheet(4, 4);
        let points = points.iter().map(|[x, y, _]| [3.0 * x + 0.13, 3.0 * y + 0.17, height]).collect();
        (points, faces.iter().map(|face| face.map(|v| v as u32)).collect())
    }

    proptest! {
        #[test]
        fn prisms_fill_what_lies_between(
            shifts in prop::collection::vec(prop::array::uniform3(-0.4..0.4f64), 25),
            numbers in Just((0..25i64).collect::<Vec<_>>()).prop_shuffle(),
        ) {
            let (inner, faces) = sheet(1.3);
            let (mut outer, _) = sheet(6.2);
            for (n, (place, shift)) in outer.iter_mut().zip(&shifts).enumerate() {
                let is_inside = (5..20).contains(&n) && (1..4).contains(&(n % 5));
                (0..2).filter(|_| is_inside).for_each(|axis| place[axis] += shift[axis]);
            }
            let control = Control::default();
            let found = voxels(&inner, &outer, &faces, &numbers, [20, 20, 10], 0.5, &control).unwrap();
            prop_assert_eq!(found.len(), 12 * 12 * 5);
            for of in found {
                let at = [of.voxel / 200, of.voxel / 10 % 20, of.voxel % 10].map(|n| n as f64);
                prop_assert!((of.fraction - (at[2] - 1.3) / 4.9).abs() < 1e-9);
                prop_assert!((of.weights.iter().sum::<f64>() - 1.0).abs() < 1e-9);
                let face = faces[of.triangle as usize];
                for axis in 0..2 { // not far from where the straight column would be
                    let place: f64 = (0..3).map(|k| of.weights[k] * inner[face[k] as usize][axis]).sum();
                    prop_assert!((place - at[axis]).abs() <= 0.41);
                }
            }
        }
    }

    #[test]
    fn a_voxel_of_several_columns_goes_to_the_nearest_one() {
        let triangle = [[-1.0, -1.0], [5.0, -1.0], [-1.0, 5.0]];
        let [inner, outer] =
            [[0.0, 9.0], [6.0, 2.0]].map(|heights| heights.map(|z| triangle.map(|[x, y]| [x, y, z])).concat());
        let (faces, numbers) = ([[0, 1, 2], [3, 5, 4]], [0, 1, 2, 3, 4, 5]);
        // 2 lies at 2/6 in one column and at 7/7 in the other, 4 at 4/6 and 5/7, 5 at 5/6 and 4/7
        for (middle, expected) in [(0.0, [0, 0, 0, 0, 0, 1, 1, 1, 1, 1]), (1.0, [0, 0, 1, 1, 1, 0, 0, 1, 1, 1])] {
            let found = voxels(&inner, &outer, &faces, &numbers, [1, 1, 10], middle, &Control::default()).unwrap();
            assert_eq!(found.iter().map(|of| of.triangle).collect::<Vec<u32>>(), expected);
        }
    }

    #[test]
    fn what_has_no_volume_holds_nothing() {
        let flat = [[0.0; 3], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]];
        let far = flat.map(|[x, y, z]| [x + 1e6, y, z + 1.0]);
        let control = Control::default();
        for (inner, outer) in [(flat, flat), (flat, [[f64::NAN; 3]; 3]), (far, far.map(|[x, y, z]| [x, y, z + 2.0]))] {
            let found = voxels(&inner, &outer, &[[0, 1, 2]], &[0, 1, 2], [5, 5, 5], 0.5, &control);
            assert_eq!(found, Ok(vec![]));
        }
    }
}
