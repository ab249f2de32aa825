//! Measure distances along a mesh of a half pipe, and compare them with those of the unrolled pipe.

use std::f64::consts::PI;

use voxflat::geodesic::exact::Exact;
use voxflat::geodesic::graph::GeodesicGraph;
use voxflat::rows::DistanceRows;
use voxflat::surface::Surface;
use voxflat::{Control, Result};

const ALONG: i64 = 20;
const AROUND: i64 = 60;
const RADIUS: f64 = 10.0; // mm

fn main() -> Result<()> {
    let control = Control::default();
    let places = || (0..=ALONG).flat_map(|i| (0..=AROUND).map(move |j| (i as f64, PI * j as f64 / AROUND as f64)));
    let points: Vec<[f64; 3]> = places().map(|(x, turn)| [x, RADIUS * turn.cos(), RADIUS * turn.sin()]).collect();
    let corner = |i: i64, j: i64| i * (AROUND + 1) + j;
    let square = |i, j| {
        let [a, b, c, d] = [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
        [[a, b, c], [a, c, d]]
    };
    let faces: Vec<[i64; 3]> = (0..ALONG).flat_map(|i| (0..AROUND).flat_map(move |j| square(i, j))).collect();
    let (surface, _) = Surface::from_triangles(&points, &faces)?;

    let graph = DistanceRows::compute(&GeodesicGraph::new(&surface, &control)?, &[0], &control)?;
    let exact = DistanceRows::compute(&Exact::new(&surface), &[0], &control)?;
    for (name, rows) in [("graph", graph), ("exact", exact)] {
        let errors = places().zip(rows.row(0)).skip(1).map(|((x, turn), &distance)| {
            let unrolled = x.hypot(RADIUS * turn);
            (f64::from(distance) - unrolled).abs() / unrolled
        });
        let error = errors.fold(0.0, f64::max);
        println!("{name}: distances are at most {:.2} % wrong", 100.0 * error);
        assert!(error < 0.02);
    }
    Ok(())
}
