use proptest::prelude::*;

use crate::Error;
use crate::surface::mesh::shapes;
use crate::surface::{Surface, mesh::triangles::Repairs};
use crate::tests::assert_sound;

type Mesh = (Vec<[f64; 3]>, Vec<[i64; 3]>);

fn repaired(mesh: &Mesh) -> (Surface, Repairs) {
    let (surface, repaired) = Surface::repaired(&mesh.0, &mesh.1).unwrap();
    assert_sound(&surface);
    (surface, repaired)
}

/// Returns the triangles with the original numbers of their corners, the lowest first, in sorted order.
fn by_numbers(surface: &Surface) -> Vec<[u32; 3]> {
    let turned = |face: &[u32; 3]| {
        let [a, b, c] = face.map(|v| surface.ids()[v as usize]);
        [[a, b, c], [b, c, a], [c, a, b]].into_iter().min().unwrap()
    };
    let mut faces: Vec<[u32; 3]> = surface.faces().iter().map(turned).collect();
    faces.sort_unstable();
    faces
}

/// Splits an inner vertex: from one neighbour to another, counted around it, its triangles get a second vertex at the
/// same place, and two triangles without area lie between.
fn split(mesh: &mut Mesh, vertex: i64, from: usize, to: usize) {
    let ring = ring(&mesh.1, vertex);
    let (m, n) = (from % ring.len(), to % ring.len());
    if m == n {
        return;
    }
    let twin = mesh.0.len() as i64;
    mesh.0.push(mesh.0[vertex as usize]);
    let mut at = m;
    while at != n {
        let corners = [vertex, ring[at], ring[(at + 1) % ring.len()]];
        let face = mesh.1.iter_mut().find(|face| corners.iter().all(|v| face.contains(v))).unwrap();
        *face = face.map(|v| if v == vertex { twin } else { v });
        at = (at + 1) % ring.len();
    }
    mesh.1.extend([[vertex, twin, ring[n]], [twin, vertex, ring[m]]]);
}

fn ring(faces: &[[i64; 3]], vertex: i64) -> Vec<i64> {
    let after = |v: i64| {
        let turned = |face: &[i64; 3]| {
            let k = face.iter().position(|&w| w == vertex)?;
            (face[(k + 1) % 3] == v).then_some(face[(k + 2) % 3])
        };
        faces.iter().find_map(turned).unwrap()
    };
    let first = *faces.iter().find(|face| face.contains(&vertex)).unwrap().iter().find(|&&v| v != vertex).unwrap();
    let mut ring = vec![first];
    while after(ring[ring.len() - 1]) != first {
        ring.push(after(ring[ring.len() - 1]));
    }
    ring
}

/// Puts a vertex into the middle of an edge, for the triangle on one side alone; the gap is closed without area.
fn refine_one_side(mesh: &mut Mesh, face: usize) {
    let [a, b, c] = mesh.1[face];
    let middle = mesh.0.len() as i64;
    let half = |k: usize| 0.5 * (mesh.0[a as usize][k] + mesh.0[b as usize][k]);
    mesh.0.push([half(0), half(1), half(2)]);
    mesh.1[face] = [a, middle, c];
    mesh.1.extend([[middle, b, c], [a, b, middle]]);
}

#[test]
fn what_is_good_is_not_touched() {
    for mesh in [shapes::sheet(5, 4), shapes::torus(12, 7), shapes::sphere(2)] {
        let (strict, first) = Surface::from_triangles(&mesh.0, &mesh.1).unwrap();
        assert_eq!(repaired(&mesh), (strict, first));
    }
    // coincident vertices belong to the two sides of a cut, or to banks that touch
    let sheet = shapes::surface(shapes::sheet(4, 4));
    let open = crate::surface::cuts::cut(&sheet, &[vec![2, 7, 12]]).unwrap();
    let points: Vec<[f64; 3]> = open.points().iter().map(|&p| p.into()).collect();
    let faces: Vec<[i64; 3]> = open.faces().iter().map(|face| face.map(i64::from)).collect();
    let (same, repairs) = repaired(&(points, faces));
    assert_eq!((same.faces(), repairs), (open.faces(), Repairs::default()));
}

#[test]
fn duplicates_and_a_corner_twice_are_dropped() {
    let (points, faces) = shapes::sheet(3, 3);
    let whole = shapes::surface((points.clone(), faces.clone()));
    let mut more = faces.clone();
    more.extend([faces[4], [faces[2][1], faces[2][0], faces[2][2]], [0, 1, 1], [5, 5, 5]]);
    let (surface, repairs) = repaired(&(points, more));
    assert_eq!(surface, whole);
    assert_eq!((repairs.duplicates, repairs.dropped), (2, 2));
}

#[test]
fn an_edge_of_rounding_goes_where_there_is_something_to_mend() {
    let mut mesh = shapes::sphere(2);
    split(&mut mesh, 20, 1, 3);
    mesh.0.last_mut().unwrap()[0] += 2e-7; // what f32 may make of a coordinate of 1
    let as_given = repaired(&mesh).0;
    assert_eq!((as_given.len(), as_given.faces().len()), (67, 130)); // a valid surface is not changed
    split(&mut mesh, 40, 0, 2);
    let (surface, repairs) = repaired(&mesh);
    assert_eq!((surface.len(), surface.faces().len()), (66, 128));
    assert_eq!(repairs.merged, [[66, 20], [67, 40]]);
    assert_eq!(by_numbers(&surface), by_numbers(&shapes::surface(shapes::sphere(2))));
}

#[test]
fn a_soup_becomes_a_surface() {
    let (points, faces) = shapes::sphere(2);
    let soup: Mesh = (
        faces.iter().flatten().map(|&v| points[v as usize]).collect(),
        (0..faces.len() as i64).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect(),
    );
    let (surface, repairs) = repaired(&soup);
    assert_eq!((surface.len(), surface.boundary().len()), (points.len(), 0));
    assert_eq!(surface.len() + repairs.merged.len(), soup.0.len());
    assert!(repairs.merged.iter().all(|&[v, of]| of < v && soup.0[v as usize] == soup.0[of as usize]));
}

#[test]
fn each_fan_gets_its_vertex() {
    let (points, _) = shapes::sheet(2, 2);
    let (surface, repairs) = repaired(&(points, vec![[0, 3, 4], [4, 8, 5]]));
    assert_eq!((surface.ids(), repairs.split, repairs.unused), (&[0, 3, 4, 4, 5, 8][..], vec![4], 4));
}

#[test]
fn components_without_area_are_left_out_and_nothing_else() {
    let (mut points, mut faces) = shapes::sheet(2, 2);
    points.extend([[7.0; 3], [8.0; 3], [9.0; 3], [9.0; 3]]);
    faces.extend([[9, 10, 11], [9, 12, 10]]);
    let (surface, repairs) = repaired(&(points.clone(), faces));
    assert_eq!((surface.len(), repairs.dropped), (9, 2));
    assert!(repairs.unused + repairs.merged.len() == 4);
    assert_eq!(Surface::repaired(&points, &[[9, 10, 11]]).unwrap_err(), Error::DegenerateFace { face: 0, count: 1 });
    assert_eq!(Surface::repaired(&points, &[[0, 1, 1]]).unwrap_err(), Error::DegenerateFace { face: 0, count: 1 });
}

#[test]
fn what_has_several_answers_is_refused_with_its_place() {
    let (mut points, whole) = shapes::sheet(2, 2);
    points.push([0.2, 0.2, 3.0]);
    // a strip that has no width in its middle: one vertex there would tear it in two
    let strip = [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.5, 0.0], [1.0, 0.5, 0.0], [2.0, 0.0, 0.0], [2.0, 1.0, 0.0]];
    let faces = [[0, 2, 1], [1, 2, 3], [3, 2, 4], [3, 4, 5]];
    assert_eq!(Surface::repaired(&strip, &faces).unwrap_err(), Error::DegenerateFace { face: 1, count: 2 });
    // numbers are those of the input
    let mut twice = vec![whole[0]];
    twice.extend(whole.iter().copied());
    points.extend(strip);
    twice.extend(faces.map(|face| face.map(|v| v + 10)));
    assert_eq!(Surface::repaired(&points, &twice).unwrap_err(), Error::DegenerateFace { face: 10, count: 2 });
}

#[test]
fn a_fin_becomes_a_sheet_of_its_own_and_leaves_the_surface_closed() {
    let (mut points, mut faces) = shapes::sphere(2);
    let closed = shapes::surface((points.clone(), faces.clone()));
    points.extend([[3.0, 3.0, 3.0], [3.0, 4.0, 3.0]]);
    let [a, b, _] = faces[7];
    faces.insert(0, [a, b, 66]);
    faces.push([66, a, 67]);
    let (surface, repairs) = repaired(&(points.clone(), faces.clone()));
    let edge = [a.min(b) as u32, a.max(b) as u32];
    assert_eq!(repairs.crowded_edges, [edge]);
    assert_eq!(Surface::from_triangles(&points, &faces).unwrap_err(), Error::CrowdedEdges { edges: vec![edge] });
    assert_eq!(crate::patch::largest_piece(&surface).points(), closed.points());
    assert_eq!(crate::patch::largest_piece(&surface).boundary().len(), 0);
    assert_eq!(surface.components().sizes.len(), 2);
}

#[test]
fn closed_surfaces_with_a_common_edge_stay_closed_and_three_sheets_end_there() {
    let (mut points, mut faces) = shapes::sphere(1);
    let [a, b, _] = faces[3];
    let count = points.len() as i64;
    let mirrored: Vec<[f64; 3]> = points.iter().map(|p| [p[0] + 9.0, p[1], p[2]]).collect();
    points.extend(mirrored);
    let other = |v: i64| if v == a || v == b { v } else { v + count };
    faces.extend(faces.clone().iter().map(|face| face.map(other)));
    let (surface, repairs) = repaired(&(points, faces));
    assert_eq!((repairs.crowded_edges.len(), surface.boundary().len(), surface.components().sizes.len()), (1, 0, 2));
    let points = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]];
    let (surface, _) = repaired(&(points.to_vec(), vec![[0, 1, 2], [0, 1, 3], [0, 1, 4]]));
    assert_eq!((surface.len(), surface.components().sizes.len()), (9, 3));
}

#[test]
fn faces_of_vertices_without_a_position_are_dropped_and_numbers_kept() {
    let (mut points, mut faces) = shapes::sheet(3, 3);
    points[5] = [f64::NAN; 3];
    points.push([f64::NAN, 0.0, 1.0]); // no face uses it
    points.push([1.0, 1.0, 1.0]);
    faces.push([0, 1, 1]);
    let (surface, repairs) = repaired(&(points.clone(), faces.clone()));
    assert_eq!((repairs.missing, repairs.incomplete, repairs.unused, repairs.dropped), (vec![5], 6, 2, 1));
    let expected: Vec<u32> = (1..16).filter(|&v| v != 5).collect();
    assert_eq!(surface.ids(), expected);
    assert_eq!(Surface::from_triangles(&points, &faces).unwrap_err(), Error::PointNotFinite { vertex: 5 });
    assert_eq!(Surface::repaired(&points, &[[4, 5, 6]]).unwrap_err(), Error::PointNotFinite { vertex: 5 });
    let closed = shapes::sphere(2);
    let first = std::iter::once([f64::NAN; 3]).chain(closed.0).collect();
    let (surface, repairs) = repaired(&(first, closed.1.iter().map(|face| face.map(|v| v + 1)).collect()));
    assert_eq!((repairs, surface.len()), (Repairs::default(), 66));
}

#[test]
fn hostile_meshes_end() {
    // everything at one place; a star; a fan whose corners all lie on a line
    let (points, faces) = shapes::sheet(60, 60);
    assert!(Surface::repaired(&vec![[1.0; 3]; points.len()], &faces).is_err());
    let n = 20_000;
    let star: Vec<[i64; 3]> = (1..=n).map(|i| [0, i, i % n + 1]).collect();
    assert!(Surface::repaired(&vec![[1.0; 3]; n as usize + 1], &star).is_err());
    let line: Vec<[f64; 3]> = (0..=n).map(|i| [i as f64, 0.0, 0.0]).collect();
    assert!(Surface::repaired(&line, &star).is_err());
}

proptest! {
    #[test]
    fn a_sphere_with_defects_is_mended_to_the_same_sphere(
        splits in prop::collection::vec((0..66usize, 0..9usize, 0..9usize), 0..9),
        halves in prop::collection::vec(0..128usize, 0..5),
        twice in prop::collection::vec(0..128usize, 0..5),
        turned in prop::collection::vec(any::<bool>(), 400),
    ) {
        let clean = shapes::sphere(2);
        let mut mesh = clean.clone();
        let mut refined = clean.clone();
        let mut is_near = vec![false; clean.0.len()];
        for &face in &halves { // the refined sphere with the vertex on both sides of the edge
            let [a, b, _] = clean.1[face];
            let other = (0..128).find(|&f| f != face && clean.1[f].contains(&a) && clean.1[f].contains(&b)).unwrap();
            let here: Vec<usize> = clean.1[face].into_iter().chain(clean.1[other]).map(|v| v as usize).collect();
            if here.iter().any(|&v| is_near[v]) {
                continue;
            }
            here.iter().for_each(|&v| is_near[v] = true);
            refine_one_side(&mut mesh, face);
            refine_one_side(&mut refined, face);
            refined.1.pop();
            let middle = refined.0.len() as i64 - 1;
            let corners = refined.1[other];
            refined.1[other] = corners.map(|v| if v == b { middle } else { v });
            refined.1.push(corners.map(|v| if v == a { middle } else { v }));
        }
        let count = refined.0.len();
        for &(vertex, from, to) in &splits {
            split(&mut mesh, vertex as i64, from, to);
        }
        for &face in &twice {
            let again = mesh.1[face];
            mesh.1.push([again[1], again[0], again[2]]);
        }
        for (face, &turn) in mesh.1.iter_mut().zip(&turned) {
            if turn {
                face.swap(0, 1);
            }
        }
        let expected = shapes::surface(refined);
        let (surface, repairs) = repaired(&mesh);
        prop_assert_eq!(by_numbers(&surface), by_numbers(&expected));
        prop_assert_eq!(surface.points(), expected.points());
        // every number is kept, or merged with one at the same position
        prop_assert_eq!((repairs.merged.len(), repairs.unused), (mesh.0.len() - count, 0));
        for &[vertex, of] in &repairs.merged {
            prop_assert!(surface.ids().binary_search(&of).is_ok() && mesh.0[vertex as usize] == mesh.0[of as usize]);
        }
    }

    #[test]
    fn whatever_is_given_is_a_surface_or_refused(
        coordinates in prop::collection::vec(0..3u8, 36),
        corners in prop::collection::vec(0..12i64, 3..90),
    ) {
        let points: Vec<[f64; 3]> = coordinates.chunks_exact(3).map(|p| [0, 1, 2].map(|k| f64::from(p[k]))).collect();
        let faces: Vec<[i64; 3]> = corners.chunks_exact(3).map(|f| [f[0], f[1], f[2]]).collect();
        if let Ok((surface, repairs)) = Surface::repaired(&points, &faces) {
            assert_sound(&surface);
            prop_assert!(surface.areas().iter().all(|&area| area > 0.0));
            let mut known: Vec<u32> = surface.ids().to_vec();
            known.dedup();
            known.extend(repairs.merged.iter().map(|m| m[0]));
            known.sort_unstable();
            prop_assert!(known.windows(2).all(|two| two[0] < two[1]));
            prop_assert_eq!(known.len() + repairs.unused, points.len());
        }
    }
}
