use nalgebra::Vector3;
use proptest::prelude::*;

use super::*;
use crate::surface::mesh::{BORDER, shapes};

fn opened(surface: &Surface) -> Opened {
    open_to_disk(surface, &Control::default()).unwrap()
}

/// Checks that it is a disk of the same faces, and that the cuts are edge paths that produce it together.
fn assert_opened(surface: &Surface, opened: &Opened) {
    assert!(Topology::of(&opened.surface).is_disk());
    let before = |v: u32| surface.ids()[v as usize];
    let after = |v: u32| opened.surface.ids()[v as usize];
    assert_eq!(surface.faces().len(), opened.surface.faces().len());
    for (a, b) in surface.faces().iter().zip(opened.surface.faces()) {
        assert_eq!(a.map(before), b.map(after));
    }
    for cut in &opened.cuts {
        let ends = cut.vertices.windows(2).map(|pair| [pair[0], pair[1]].map(|v| surface.points()[v as usize]));
        let length: f64 = ends.map(|[a, b]| (a - b).norm()).sum();
        assert!((cut.length - length).abs() < 1e-9 * length.max(1.0));
        assert!(cut.vertices.len() > 1);
    }
    let seam = surface.twins().iter().zip(opened.surface.twins()).filter(|(a, b)| a != b).count() / 2;
    assert_eq!(seam, opened.cuts.iter().map(|cut| cut.vertices.len() - 1).sum::<usize>(), "each edge is cut once");
    let paths: Vec<Vec<u32>> = opened.cuts.iter().map(|cut| cut.vertices.clone()).collect();
    assert_eq!(cut(surface, &paths).unwrap(), opened.surface);
}

fn count(opened: &Opened, reason: Reason) -> usize {
    opened.cuts.iter().filter(|cut| cut.reason == reason).count()
}

#[test]
fn a_sphere_gets_one_seam_and_a_disk_none() {
    for times in 0..4 {
        let sphere = shapes::surface(shapes::sphere(times));
        let open = opened(&sphere);
        assert_opened(&sphere, &open);
        assert_eq!((open.cuts.len(), count(&open, Reason::Sphere)), (1, 1));
        assert_eq!(open, opened(&sphere));
    }
    let sheet = shapes::surface(shapes::sheet(4, 4));
    assert_eq!(opened(&sheet), Opened { surface: sheet, cuts: vec![] });
}

#[test]
fn a_tetrahedron_is_opened() {
    let points = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let faces = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]];
    let tetrahedron = shapes::surface((points.to_vec(), faces.to_vec()));
    let open = opened(&tetrahedron);
    assert_opened(&tetrahedron, &open);
    assert_eq!((open.cuts[0].vertices.len(), open.surface.boundary()[0].len()), (3, 4));
}

#[test]
fn a_seam_stays_in_a_furrow() {
    // a ball with a furrow from pole to pole, at y = 0, x > 0
    let sphere = shapes::surface(shapes::sphere(5));
    let furrow = |p: &nalgebra::Vector3<f64>| {
        let depth = if p.x > 0.0 { 0.4 * (-(p.y / 0.08).powi(2)).exp() } else { 0.0 };
        [p.x * 10.0 * (1.0 - depth), p.y * 10.0 * (1.0 - depth), p.z * 20.0].into()
    };
    let ball = sphere.moved(sphere.points().iter().map(furrow).collect()).unwrap();
    let open = opened(&ball);
    assert_opened(&ball, &open);
    let middle = open.cuts[0].vertices.iter().map(|&v| sphere.points()[v as usize]).filter(|p| p.z.abs() < 0.8);
    let (inside, all) = middle.fold((0, 0), |(n, all), p| (n + usize::from(p.x > 0.0 && p.y.abs() < 0.12), all + 1));
    assert!(3 * inside > 2 * all, "{inside} of {all}");
}

#[test]
fn a_ball_with_a_small_handle_gets_a_seam_too() {
    let mask = crate::volume::Mask::from_fn([25; 3], |v| {
        let ball = v.iter().map(|&x| (x as f64 - 12.0).powi(2)).sum::<f64>() < 121.0;
        let is_cut_away = v[2] == 22 && !(v[0] == 12 && (10..15).contains(&v[1]));
        (ball && !is_cut_away && !(v[2] == 21 && (11..14).contains(&v[1])))
            || (v[2] == 22 && v[0] == 12 && (9..16).contains(&v[1]))
    });
    let solid = crate::tests::solid(&mask.unwrap(), [1.0; 3]);
    assert_eq!(Topology::of(&solid).genus, 1);
    let open = opened(&solid);
    assert_opened(&solid, &open);
    assert_eq!(count(&open, Reason::Handle), 1);
    assert!((1..3).contains(&count(&open, Reason::Sphere)), "{:?}", open.cuts);
}

#[test]
fn a_sphere_with_two_small_holes_gets_a_seam_if_they_are_near() {
    // the boundary, with both sides of the cut between the holes, compared with the side of a square of the same area
    let sphere = shapes::surface(shapes::sphere(5));
    for (apart, is_near) in [(1.3f64, true), (1.5, true), (2.1, false), (3.1, false)] {
        let holes = [Vector3::x(), Vector3::new(apart.cos(), apart.sin(), 0.0)].map(|at| {
            let middle =
                |f: usize| sphere.faces()[f].iter().map(|&v| sphere.points()[v as usize]).sum::<Vector3<f64>>();
            (0..sphere.faces().len()).max_by(|&f, &g| middle(f).dot(&at).total_cmp(&middle(g).dot(&at))).unwrap()
        });
        let part = sphere.part(&(0..sphere.faces().len()).map(|f| !holes.contains(&f)).collect::<Vec<_>>());
        let open = opened(&part);
        assert_opened(&part, &open);
        let mut joined = open.cuts.iter().filter(|cut| cut.reason == Reason::JoinBoundaries);
        let is_right = |cut: &Cut| (apart - 0.1..1.2 * apart).contains(&cut.length);
        assert!(is_near || joined.all(is_right), "{apart}");
        assert_eq!(count(&open, Reason::Sphere) > 0, is_near, "{apart}");
    }
}

#[test]
fn a_torus_gets_two_cuts() {
    let torus = shapes::surface(shapes::torus(60, 20));
    let open = opened(&torus);
    assert_opened(&torus, &open);
    assert_eq!((count(&open, Reason::Handle), count(&open, Reason::JoinBoundaries)), (1, 1));
    let tau = std::f64::consts::TAU;
    assert!(open.cuts[0].length < 1.2 * tau && open.cuts[1].length < 2.3 * tau, "{:?}", open.cuts);
}

#[test]
fn boundaries_are_joined_by_the_shortest_tree() {
    let sheet = shapes::surface(shapes::sheet(20, 9));
    let is_hole = |i: usize, j: usize| j == 4 && [3, 7, 15].contains(&i);
    let part = sheet.part(&(0..360).map(|f| !is_hole(f / 18, f / 2 % 9)).collect::<Vec<_>>());
    let open = opened(&part);
    assert_opened(&part, &open);
    let mut lengths: Vec<f64> = open.cuts.iter().map(|cut| cut.length).collect();
    lengths.sort_by(f64::total_cmp);
    assert_eq!((lengths, count(&open, Reason::JoinBoundaries)), (vec![3.0, 3.0, 4.0], 3));
}

#[test]
fn a_cube_is_cut_along_a_tree_of_its_edges_and_a_cone_to_its_apex() {
    let (n, control) = (3i64, Control::default());
    let mut points: Vec<[f64; 3]> = Vec::new();
    let mut number = |point: [i64; 3]| {
        let point = point.map(|x| x as f64);
        points.iter().position(|other| *other == point).unwrap_or_else(|| {
            points.push(point);
            points.len() - 1
        }) as i64
    };
    let mut faces = Vec::new();
    for (axis, side, i, j) in (0..3 * 2 * n * n).map(|k| (k as usize % 3, k / 3 % 2, k / 6 % n, k / 6 / n)) {
        let mut corner = |i: i64, j: i64| {
            let mut point = [n * side; 3];
            (point[(axis + 1) % 3], point[(axis + 2) % 3]) = (i, j);
            number(point)
        };
        let mut square = [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
        if side == 0 {
            square.reverse();
        }
        faces.extend([[square[0], square[1], square[2]], [square[0], square[2], square[3]]]);
    }
    let cube = shapes::surface((points, faces));
    let corners = cones::cone_points(&cube);
    assert!(corners.iter().all(|&v| cube.points()[v as usize].iter().all(|x| x % n as f64 == 0.0)));
    let open = open_to_disk_through(&cube, &corners, &control).unwrap();
    assert_opened(&cube, &open);
    assert_eq!((corners.len(), count(&open, Reason::ConePoint)), (8, 7));
    assert!(open.cuts.iter().all(|cut| cut.length == n as f64));

    let sheet = shapes::surface(shapes::sheet(6, 6));
    let height = |x: f64, y: f64| -x.abs().max(y.abs()).max((x - y).abs()); // its ridges are edges of the sheet
    let tent = |p: &Vector3<f64>| Vector3::new(p.x, p.y, height(p.x - 3.0, p.y - 3.0));
    let roof = sheet.moved(sheet.points().iter().map(tent).collect()).unwrap();
    let open = open_to_disk_through(&roof, &cones::cone_points(&roof), &control).unwrap();
    assert_opened(&roof, &open);
    assert_eq!((open.cuts.len(), open.cuts[0].reason), (1, Reason::ConePoint));
    assert!(open.cuts[0].vertices.contains(&24));
    assert!(cones::cone_points(&sheet).is_empty());
    assert!(cones::cone_points(&shapes::surface(shapes::sphere(3))).is_empty());
}

#[test]
fn several_components_and_none_are_refused() {
    let sheet = shapes::surface(shapes::sheet(3, 3));
    let two = sheet.part(&(0..18).map(|f| !(2..14).contains(&f)).collect::<Vec<_>>());
    let control = Control::default();
    let refused = open_to_disk(&two, &control).unwrap_err();
    assert_eq!(refused, Error::SeveralComponents { count: 2, sizes: "4, 2".to_owned() });
    assert_eq!(open_to_disk(&sheet.part(&[false; 18]), &control).unwrap_err(), Error::NoFaces { points: 0 });
}

#[test]
fn a_chosen_path_is_cut() {
    let sheet = shapes::surface(shapes::sheet(4, 4));
    let open = cut(&sheet, &[vec![2, 7, 12], vec![22, 17]]).unwrap();
    assert_eq!(open.len(), sheet.len() + 3);
    assert!(Topology::of(&open).is_disk());
    assert_eq!(cut(&sheet, &[vec![2, 12]]), Err(Error::NotAnEdge { a: 2, b: 12 }));
    assert_eq!(cut(&sheet, &[vec![0, 1, 2]]).unwrap(), sheet); // along the boundary
    assert_eq!(cut(&sheet, &[vec![], vec![3]]).unwrap(), sheet);
}

proptest! {
    #[test]
    fn any_piece_of_a_torus_opens(keep in prop::collection::vec(prop::bool::weighted(0.75), 168), all in 0..3usize) {
        let torus = shapes::surface(shapes::torus(12, 7));
        let keep: Vec<bool> = keep.iter().enumerate().map(|(n, &kept)| kept || (n % 12 < 4 * all)).collect();
        let part = torus.part(&keep);
        let components = part.components();
        for component in 0..components.count() as u32 {
            let piece = part.part(&components.labels.iter().map(|&l| l == component).collect::<Vec<_>>());
            let open = opened(&piece);
            assert_opened(&piece, &open);
            let topology = Topology::of(&piece);
            prop_assert_eq!(open.cuts.is_empty(), topology.is_disk());
            prop_assert!(open.surface.twins().iter().filter(|&&t| t == BORDER).count() >= 3);
        }
    }
}
