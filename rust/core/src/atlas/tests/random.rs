//! What is promised of patches, on 10,000 random surfaces, by brute force from what is returned alone.

use nalgebra::{Matrix2, Rotation3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use robust::{Coord, orient2d};

use super::*;

const SURFACES: u64 = 10_000;

/// A triangle in the plane.
type Flat = [[f64; 2]; 3];

#[test]
fn ten_thousand_random_surfaces() {
    let most: Vec<usize> = (0..SURFACES)
        .into_par_iter()
        .map(|number| {
            let mut rng = ChaCha8Rng::seed_from_u64(number);
            let mesh = random_mesh(number, &mut rng);
            let (limit, seeds) = (random_limit(&mut rng), ALL_SEEDS[usize::min(rng.random_range(0..6), 2)]);
            let surface = oriented(&mesh);
            let atlas = made(&surface, limit, seeds);
            let told = || format!("surface {number}, {limit:?}, {seeds:?}");
            is_a_partition(&surface, &atlas).unwrap_or_else(|why| panic!("{why}: {}", told()));
            for (n, patch) in atlas.patches.iter().enumerate() {
                keeps_its_certificate(&surface, &atlas, patch)
                    .unwrap_or_else(|why| panic!("{why}: patch {n}, {}", told()));
                is_one_to_one(&surface, patch).unwrap_or_else(|why| panic!("{why}: patch {n}, {}", told()));
            }
            let renumbered = oriented(&renumber(&mesh, number));
            let other = made(&renumbered, limit, seeds);
            assert!(by_places(&surface, &atlas) == by_places(&renumbered, &other), "numbers matter: {}", told());
            atlas.patches.iter().map(|patch| patch.faces.len()).max().unwrap_or(0)
        })
        .collect();
    // the checks above say something only where patches have several triangles
    let large = most.iter().filter(|&&faces| faces >= 4).count();
    assert!(3 * large > most.len(), "{large} have a patch of four triangles");
}

// ------------------------------------------------------------------------------------------ surfaces

/// Thin boxes that the noise turns inside out are turned back.
fn oriented((points, faces): &Mesh) -> Surface {
    Surface::from_triangles(points, faces).unwrap().0
}

fn random_mesh(number: u64, rng: &mut ChaCha8Rng) -> Mesh {
    let noise = 10f64.powf(rng.random_range(-3.0..-0.5));
    let (mut points, faces) = match number % 5 {
        0 => shapes::sheet(rng.random_range(1..7), rng.random_range(1..7)),
        1 => bumpy(shapes::sphere(rng.random_range(0..3)), rng),
        2 => shapes::torus(rng.random_range(3..9), rng.random_range(3..6)),
        3 => chain_of_tori(rng.random_range(2..4)),
        _ => boxes(rng.random_range(1..6), rng),
    };
    // boxes keep their level sides now and then, and grids their level places: there are ties
    let share = [0.0, 0.5, 1.0][rng.random_range(0..3)];
    for point in &mut points {
        if rng.random_bool(share) {
            point.iter_mut().for_each(|x| *x += noise * rng.random_range(-1.0..1.0));
        }
    }
    (points, faces)
}

/// With a few random waves on it.
fn bumpy((mut points, faces): Mesh, rng: &mut ChaCha8Rng) -> Mesh {
    let waves: Vec<[f64; 4]> = (0..3).map(|_| std::array::from_fn(|_| rng.random_range(-3.0..3.0))).collect();
    for point in &mut points {
        let height: f64 = waves.iter().map(|[a, b, c, d]| (a * point[0] + b * point[1] + c * point[2] + d).sin()).sum();
        point.iter_mut().for_each(|x| *x *= 1.0 + 0.2 * height);
    }
    (points, faces)
}

/// A closed tube with as many handles: from each of two tori a triangle is taken, and their borders are joined.
fn chain_of_tori(count: usize) -> Mesh {
    let (mut points, mut faces) = shapes::torus(6, 4);
    for n in 1..count {
        let (others, mut more) = shapes::torus(6, 4);
        let ([a, b, c], [x, y, z]) = (faces.pop().unwrap(), more.remove(0));
        let first = points.len() as i64;
        let kept: Vec<i64> = (0..others.len() as i64).filter(|v| ![x, y, z].contains(v)).collect();
        let number = |v: i64| match v {
            v if v == x => a,
            v if v == y => c,
            v if v == z => b,
            v => first + kept.binary_search(&v).unwrap() as i64,
        };
        faces.extend(more.iter().map(|face| face.map(number)));
        points.extend(kept.iter().map(|&v| others[v as usize]).map(|[i, j, k]| [i + 8.0 * n as f64, j, k]));
    }
    (points, faces)
}

/// Boxes of any size, turned anyhow, that may reach through each other.
fn boxes(count: usize, rng: &mut ChaCha8Rng) -> Mesh {
    const SIDES: [[i64; 4]; 6] = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let (mut points, mut faces) = (Vec::new(), Vec::new());
    for _ in 0..count {
        let [size, place, turn]: [Vector3<f64>; 3] =
            [0.1..3.0, -3.0..3.0, -3.0..3.0].map(|range| Vector3::from_fn(|_, _| rng.random_range(range.clone())));
        let turn = if rng.random_bool(0.5) { Rotation3::new(turn) } else { Rotation3::identity() };
        let first = points.len() as i64;
        let corner = |n: usize| Vector3::new((n & 1) as f64, (n >> 1 & 1) as f64, (n >> 2) as f64);
        points.extend((0..8).map(|n| <[f64; 3]>::from(place + turn * corner(n).component_mul(&size))));
        let halves = SIDES.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]);
        faces.extend(halves.map(|face| face.map(|v| first + v)));
    }
    (points, faces)
}

fn random_limit(rng: &mut ChaCha8Rng) -> Limit {
    match rng.random_range(0..8) {
        0..4 => Limit::Angle(10f64.powf(rng.random_range(0.5..1.9))),
        _ => Limit::Bound(1.0 + 10f64.powf(rng.random_range(-2.5..0.6))),
    }
}

// -------------------------------------------------------------------------------------------- checks

fn is_a_partition(surface: &Surface, atlas: &Atlas) -> std::result::Result<(), String> {
    let mut seen = vec![0; surface.faces().len()];
    for (number, patch) in atlas.patches.iter().enumerate() {
        for &face in &patch.faces {
            seen[face as usize] += 1;
            if atlas.labels[face as usize] != number as u32 {
                return Err(format!("face {face} has another label"));
            }
        }
    }
    seen.iter().all(|&times| times == 1).then_some(()).ok_or("not every face is in one patch".into())
}

/// σ1 and σ2 of each triangle by the singular value decomposition of its own linear map.
fn keeps_its_certificate(surface: &Surface, atlas: &Atlas, patch: &Patch) -> std::result::Result<(), String> {
    let Certificate { angle, c, k } = atlas.certificate;
    let Plane { normal, .. } = patch.plane;
    for (&face, flat) in patch.faces.iter().zip(flat_triangles(surface, patch)) {
        let [p, q, r] = surface.faces()[face as usize].map(|v| surface.points()[v as usize]);
        let x = (q - p).normalize();
        let up = (q - p).cross(&(r - p)).normalize();
        let y = up.cross(&x);
        let space = Matrix2::new((q - p).dot(&x), (r - p).dot(&x), (q - p).dot(&y), (r - p).dot(&y));
        let [u, v] = [1, 2].map(|n: usize| [flat[n][0] - flat[0][0], flat[n][1] - flat[0][1]]);
        let linear = Matrix2::new(u[0], v[0], u[1], v[1]) * space.try_inverse().ok_or("no inverse")?;
        let sigma = linear.svd(false, false).singular_values;
        let (most, least) = (sigma.max(), sigma.min());
        if linear.determinant() <= 0.0 {
            return Err(format!("face {face} is turned over"));
        }
        // what rounding does to thin triangles grows with their thinness
        let thin = 1e-13 * space.norm_squared() / space.determinant().abs();
        if most.max(1.0 / least) > c * (1.0 + 1e-9 + thin) || most / least > k * (1.0 + 1e-9 + thin) {
            return Err(format!("face {face} has σ {most} and {least}, promised are C {c} and K {k}"));
        }
        let [told, other] = atlas.stretch[face as usize];
        if (told - most).abs() + (other - least).abs() > 1e-9 + thin * c {
            return Err(format!("face {face} has σ {most} and {least}, told are {told} and {other}"));
        }
        if up.cross(&normal).norm().atan2(up.dot(&normal)).to_degrees() > angle + 1e-5 {
            return Err(format!("face {face} is steeper than {angle}°"));
        }
    }
    Ok(())
}

/// No two triangles of a patch share more than a side: every pair is tried, by exact predicates.
fn is_one_to_one(surface: &Surface, patch: &Patch) -> std::result::Result<(), String> {
    let triangles = flat_triangles(surface, patch);
    for (row, &vertex) in patch.vertices.iter().enumerate() {
        let projected = patch.plane.project(&surface.points()[vertex as usize]);
        if projected != patch.uv[row] {
            return Err(format!("vertex {vertex} is not where it is projected to"));
        }
    }
    for (n, one) in triangles.iter().enumerate() {
        if let Some(other) = triangles[..n].iter().position(|other| !separated(one, other) && !separated(other, one)) {
            return Err(format!("triangles {n} and {other} lie on each other"));
        }
    }
    Ok(())
}

/// Whether a side of the first triangle, counterclockwise, has all of the second one beyond it.
fn separated(one: &Flat, other: &Flat) -> bool {
    let at = |[x, y]: [f64; 2]| Coord { x, y };
    (0..3).any(|k| other.iter().all(|&p| orient2d(at(one[k]), at(one[(k + 1) % 3]), at(p)) <= 0.0))
}

fn flat_triangles(surface: &Surface, patch: &Patch) -> Vec<Flat> {
    let uv = |v: u32| patch.uv[patch.vertices.binary_search(&v).unwrap()];
    patch.faces.iter().map(|&face| surface.faces()[face as usize].map(uv)).collect()
}
