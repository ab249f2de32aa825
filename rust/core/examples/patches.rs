//! Flatten a bowl in patches in which no length changes by more than a tenth.

use voxflat::atlas::{Limit, Seeds, patches};
use voxflat::surface::Surface;
use voxflat::{Control, Result};

fn main() -> Result<()> {
    let (count, bound) = (24, 1.1);
    let points: Vec<[f64; 3]> = (0..=count)
        .flat_map(|i| (0..=count).map(move |j| [f64::from(i), f64::from(j)]))
        .map(|[x, y]| [x, y, 0.05 * ((x - 12.0).powi(2) + (y - 12.0).powi(2))])
        .collect();
    let corner = |i: i32, j: i32| i64::from(i * (count + 1) + j);
    let square = |i, j| {
        let [a, b, c, d] = [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
        [[a, b, c], [a, c, d]]
    };
    let faces: Vec<[i64; 3]> = (0..count).flat_map(|i| (0..count).flat_map(move |j| square(i, j))).collect();
    let (surface, _) = Surface::from_triangles(&points, &faces)?;

    let atlas = patches(&surface, Limit::Bound(bound), Seeds::Curvature, &Control::default())?;
    for (number, patch) in atlas.patches.iter().enumerate() {
        println!("patch {number}: {:.0} mm², lengths change by a factor of {:.3}", patch.area, patch.isometric);
        assert!(patch.isometric <= bound + 1e-9);
    }
    assert!(atlas.labels.iter().all(|&label| (label as usize) < atlas.patches.len()));
    Ok(())
}
