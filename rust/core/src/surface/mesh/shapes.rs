//! Surfaces of known shape for unit tests and the tests in `rust/core/tests`: points in mm and triangles, or a
//! [`Surface`].

use nalgebra::Vector3;

use super::Surface;

/// Returns a plane grid of `m` × `n` squares of side 1 at z = 0, each divided along a diagonal.
pub fn sheet(m: usize, n: usize) -> (Vec<[f64; 3]>, Vec<[i64; 3]>) {
    let points = (0..=m).flat_map(|i| (0..=n).map(move |j| [i as f64, j as f64, 0.0])).collect();
    (points, grid_faces(m, n, |i, j| i * (n + 1) + j))
}

/// Returns a torus of radii 3 and 1 with `m` × `n` squares, oriented outwards.
pub fn torus(m: usize, n: usize) -> (Vec<[f64; 3]>, Vec<[i64; 3]>) {
    let angle = |i: usize, n: usize| std::f64::consts::TAU * i as f64 / n as f64;
    let place = |i: usize, j: usize| {
        let (r, z) = (3.0 + angle(j, n).cos(), angle(j, n).sin());
        [r * angle(i, m).cos(), r * angle(i, m).sin(), z]
    };
    let points = (0..m).flat_map(|i| (0..n).map(move |j| place(i, j))).collect();
    (points, grid_faces(m, n, |i, j| i % m * n + j % n))
}

/// Returns an octahedron on the unit sphere whose faces were divided into four `times` times.
pub fn sphere(times: usize) -> (Vec<[f64; 3]>, Vec<[i64; 3]>) {
    let mut points: Vec<Vector3<f64>> = Vec::new();
    for axis in 0..3 {
        for sign in [1.0, -1.0] {
            points.push(Vector3::from_fn(|a, _| if a == axis { sign } else { 0.0 }));
        }
    }
    let mut faces: Vec<[i64; 3]> = Vec::new();
    for (x, y, z) in (0..8).map(|n| (n & 1, n >> 1 & 1, n >> 2)) {
        let face = [x, 2 + y, 4 + z];
        faces.push(if (x + y + z) % 2 == 0 { face } else { [face[0], face[2], face[1]] });
    }
    for _ in 0..times {
        let mut middle = std::collections::HashMap::new();
        let mut halve = |a: i64, b: i64| {
            *middle.entry((a.min(b), a.max(b))).or_insert_with(|| {
                points.push((points[a as usize] + points[b as usize]).normalize());
                points.len() as i64 - 1
            })
        };
        let quarters = |&[a, b, c]: &[i64; 3]| {
            let (d, e, f) = (halve(a, b), halve(b, c), halve(c, a));
            [[a, d, f], [b, e, d], [c, f, e], [d, e, f]]
        };
        faces = faces.iter().flat_map(quarters).collect();
    }
    (points.into_iter().map(Into::into).collect(), faces)
}

/// Returns the surface of a shape.
/// Panics if the triangles are not a surface, or do not run counterclockwise as seen from outside.
pub fn surface((points, faces): (Vec<[f64; 3]>, Vec<[i64; 3]>)) -> Surface {
    let (surface, repaired) = Surface::from_triangles(&points, &faces).unwrap();
    assert_eq!((repaired.turned, repaired.unused), (0, 0));
    surface
}

pub fn grid_faces(m: usize, n: usize, vertex: impl Fn(usize, usize) -> usize) -> Vec<[i64; 3]> {
    let squares = (0..m).flat_map(|i| (0..n).map(move |j| (i, j)));
    squares
        .flat_map(|(i, j)| {
            let [a, b, c, d] =
                [vertex(i, j), vertex(i + 1, j), vertex(i + 1, j + 1), vertex(i, j + 1)].map(|v| v as i64);
            [[a, b, c], [a, c, d]]
        })
        .collect()
}
