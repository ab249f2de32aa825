use std::collections::BTreeSet;

use super::*;
use crate::surface::mesh::shapes;
use crate::tests::{both, moved, row};

fn torus() -> Surface {
    shapes::surface(shapes::torus(18, 11))
}

/// Returns the vertices within a number of rings of each vertex, by repeated passes over all faces.
fn by_brute_force(surface: &Surface, rings: u32) -> Vec<BTreeSet<u32>> {
    let grown = |inside: &BTreeSet<u32>| {
        let touching = surface.faces().iter().filter(|face| face.iter().any(|v| inside.contains(v)));
        touching.flatten().copied().collect::<BTreeSet<u32>>()
    };
    let around = |vertex: u32| (0..rings).fold(BTreeSet::from([vertex]), |inside, _| grown(&inside));
    (0..surface.len() as u32).map(around).collect()
}

#[test]
fn neighbours_are_those_within_so_many_rings() {
    for surface in [torus(), shapes::surface(shapes::sheet(9, 6))] {
        for rings in [1, 2, 4] {
            let found = Neighbourhoods::measure(&surface, Some(rings), &[], false, &Control::default()).unwrap().0;
            let expected = by_brute_force(&surface, rings);
            for (vertex, mut expected) in expected.into_iter().enumerate() {
                expected.remove(&(vertex as u32));
                let found: Vec<u32> = found.of_vertex(vertex).iter().map(|near| near.vertex).collect();
                assert_eq!(found, expected.into_iter().collect::<Vec<_>>(), "vertex {vertex}, {rings} rings");
            }
        }
    }
}

#[test]
fn neighbourhoods_have_the_sizes_that_are_told() {
    for surface in [torus(), shapes::surface(shapes::sheet(9, 6))] {
        let control = Control::default();
        let sizes = sizes_of_rings(&surface, None, &control).unwrap();
        for rings in 1..=sizes.len() as u32 {
            let sum: usize = by_brute_force(&surface, rings).iter().map(BTreeSet::len).sum();
            assert_eq!(sizes[rings as usize - 1], sum as f64 / surface.len() as f64);
        }
        assert_eq!(sizes[sizes.len() - 1], surface.len() as f64);
        assert_eq!(sizes_of_rings(&surface, Some(3), &control).unwrap(), sizes[..3]);
    }
}

/// Returns the shorter of the exact distances in both directions.
fn exact(surface: &Surface) -> Vec<Vec<f32>> {
    let rows: Vec<_> = (0..surface.len() as u32).map(|vertex| row(&Exact::new(surface), vertex)).collect();
    let count = surface.len();
    (0..count).map(|a| (0..count).map(|b| rows[a][b].min(rows[b][a])).collect()).collect()
}

#[test]
fn all_pairs_and_those_of_sources_are_exact() {
    let surface = torus();
    let expected = exact(&surface);
    let control = Control::default();
    let all = Neighbourhoods::measure(&surface, None, &[], false, &control).unwrap().0;
    assert_eq!(all.pairs(), surface.len() * (surface.len() - 1) / 2);
    let sources = [150, 3, 60];
    let some = Neighbourhoods::measure(&surface, Some(2), &sources, false, &control).unwrap().0;
    let mut total = 0.0;
    for vertex in 0..surface.len() {
        for near in all.of_vertex(vertex) {
            assert_eq!(near.distance, expected[vertex][near.vertex as usize]);
        }
        let row = some.of_vertex(vertex);
        assert!(row.windows(2).all(|two| two[0].vertex < two[1].vertex));
        for &Near { vertex: other, distance } in row {
            let is_source = sources.contains(&(vertex as u32)) || sources.contains(&other);
            let exact = expected[vertex][other as usize];
            assert!(if is_source { distance == exact } else { distance >= exact && distance < 1.5 * exact });
            let back = some.of_vertex(other as usize);
            let at = back.binary_search_by_key(&(vertex as u32), |near| near.vertex).unwrap();
            assert_eq!(back[at].distance, distance);
            total += f64::from(distance);
        }
        for source in sources.iter().filter(|&&source| source as usize != vertex) {
            assert!(row.iter().any(|near| near.vertex == *source));
        }
    }
    assert!((some.total() / total - 1.0).abs() < 1e-12);
}

#[test]
fn on_a_plane_distances_within_rings_are_straight() {
    let surface = shapes::surface(shapes::sheet(12, 9));
    let found = Neighbourhoods::measure(&surface, Some(4), &[], false, &Control::default()).unwrap().0;
    let off = |vertex: usize, near: &Near| {
        let straight = (surface.points()[vertex] - surface.points()[near.vertex as usize]).norm();
        f64::from(near.distance) / straight - 1.0
    };
    for vertex in 0..surface.len() {
        assert!(found.of_vertex(vertex).iter().all(|near| off(vertex, near) > -1e-6));
        // the nearer ones are visible across the faces of the rings
        let near = found.of_vertex(vertex).iter().filter(|near| near.distance <= 2.0);
        assert!(near.into_iter().all(|near| off(vertex, near) < 1e-6));
    }
}

#[test]
fn what_cannot_be_reached_is_refused() {
    let sheet = shapes::sheet(3, 3);
    let surface = shapes::surface(both(&sheet, &moved(&sheet, |[x, y, z]| [x + 9.0, *y, *z])));
    let control = Control::default();
    let found = Neighbourhoods::measure(&surface, Some(2), &[3], false, &control).unwrap_err();
    assert_eq!(found, Error::Unreachable { source_vertex: 3, vertex: 16 });
}
