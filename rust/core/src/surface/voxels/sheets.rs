//! Voxel sheets, which are one voxel thick: a curled sheet of paper, a layer of cortex, a traced membrane.
//!
//! Such a label has background on both sides, so that its boundary consists of two parallel surfaces that meet at the
//! rim. One of them is used, and moved to the middle of the sheet.
//!
//! 1. Surfels are glued so that voxels that touch along an edge are connected
//!    (`Touching::Joined`), because a thin slanted sheet often consists of such
//!    voxels.
//! 2. The normal of each voxel is the direction in which the surrounding voxels, reached over the sheet, vary least.
//!    Normals are oriented consistently along a spanning tree that prefers similar neighbours.
//! 3. A surfel is on the upper side if it faces along its voxel's normal, and on the lower side if it faces against it.
//!    The steps of a slanted sheet and the rim face sideways; they belong to the side that is closer along the surface.

use std::collections::{BinaryHeap, VecDeque};

use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use crate::adjacency::Links;
use crate::surface::voxels::graph::VoxelGraph;
use crate::surface::voxels::surfels::{Surfels, moved};
use crate::surface::voxels::{VoxelSurface, neighbours};
use crate::volume::Mask;
use crate::{Control, Result};

/// The largest share of a sheet's foreground voxels without background neighbours. Ball-like labels of more than a few
/// voxels have more, and real solids more than half.
const MOST_INNER: f64 = 0.05;

/// The number of steps within which other voxels contribute to a voxel's normal.
const STEPS: usize = 3;

/// The product of a surfel's direction and the normal above which its side is certain. It separates the steps of a
/// slanted sheet from its treads.
const DECIDED: f64 = 0.5;

/// The longest run of foreground that is followed through the sheet.
const LONGEST_RUN: usize = 16;

/// Returns whether the foreground is a voxel sheet: (almost) no voxel has 26 foreground neighbours.
///
/// # Errors
/// [`Error::Cancelled`](crate::Error::Cancelled).
pub fn is_sheet(mask: &Mask, control: &Control) -> Result<bool> {
    let most = MOST_INNER * mask.values().iter().filter(|&&inside| inside).count() as f64;
    let mut left = most.ceil() as usize; // a solid is recognised after a few of its voxels
    for (count, voxel) in mask.foreground().enumerate() {
        if count.is_multiple_of(1024) {
            control.check()?;
        }
        left -= usize::from(neighbours().all(|offset| mask.is_inside(moved(voxel, offset))));
        if left == 0 {
            return Ok(false);
        }
    }
    Ok(true)
}

/// One side of a sheet's surfels, and where the normals of neighbours are opposite: where the sheet has only one side,
/// like a Möbius strip, or touches itself.
#[derive(Debug, Clone)]
pub(crate) struct Side {
    /// Which surfels are on it.
    pub surfels: Vec<bool>,
    /// The number of pairs of neighbouring voxels whose normals disagree.
    pub conflicts: usize,
}

/// Returns the side of a sheet with more surfels, which is the outer side of a closed shell.
pub(crate) fn side(voxels: &VoxelSurface, surfels: &Surfels, control: &Control) -> Result<Side> {
    let graph = VoxelGraph::of(voxels, [1.0; 8], control)?;
    let mut normals = spread_least(voxels, &graph, control)?;
    agree(&graph, &mut normals, control)?;
    let spacing = voxels.affine().spacing();
    let looks_up = |surfel: u32| {
        let direction = surfels.direction(surfel);
        let outward = Vector3::from_fn(|a, _| direction[a] as f64); // of unit length along an axis
        outward.dot(&normals[surfels.voxel(surfel) as usize])
    };
    let mut decided = vec![None; surfels.len()];
    let mut queue = VecDeque::new();
    for surfel in 0..surfels.len() as u32 {
        let up = looks_up(surfel);
        if up.abs() > DECIDED {
            decided[surfel as usize] = Some(up > 0.0);
            queue.push_back(surfel);
        }
    }
    control.check()?;
    while let Some(surfel) = queue.pop_front() {
        for next in surfels.neighbours(surfel).into_iter().flatten() {
            if decided[next as usize].is_none() {
                decided[next as usize] = decided[surfel as usize];
                queue.push_back(next);
            }
        }
    }
    let components = graph.components();
    let mut more_up = vec![0i64; components.sizes.len()];
    let component = |surfel: usize| components.labels[surfels.voxel(surfel as u32) as usize] as usize;
    for (surfel, &is_up) in decided.iter().enumerate() {
        let direction = surfels.direction(surfel as u32);
        let axis = direction.iter().position(|&x| x != 0).unwrap_or(0);
        let area = spacing.iter().product::<f64>() / spacing[axis] / spacing.iter().product::<f64>().cbrt().powi(2);
        more_up[component(surfel)] += if is_up == Some(true) { 1 } else { -1 } * (1e6 * area) as i64;
    }
    let is_chosen = |(surfel, &is_up): (usize, &Option<bool>)| is_up == Some(more_up[component(surfel)] >= 0);
    let opposite = |v: u32| graph.arcs(v).filter(move |arc| arc.to > v).map(move |arc| (v, arc.to));
    let conflicts = (0..voxels.len() as u32).flat_map(opposite);
    let conflicts = conflicts.filter(|&(a, b)| normals[a as usize].dot(&normals[b as usize]) < -DECIDED).count();
    Ok(Side { surfels: decided.iter().enumerate().map(is_chosen).collect(), conflicts })
}

/// Returns, for each voxel, the direction in which the surrounding voxels vary least, with arbitrary sign.
fn spread_least(voxels: &VoxelSurface, graph: &VoxelGraph, control: &Control) -> Result<Vec<Vector3<f64>>> {
    let spacing = voxels.affine().spacing();
    let place = |v: u32| Vector3::from_fn(|a, _| f64::from(voxels.voxels()[v as usize][a]) * spacing[a]);
    let normal = |(seen, around): &mut (Vec<u32>, Vec<u32>), v: u32| {
        if v.is_multiple_of(1024) {
            control.check()?;
        }
        around.clear();
        around.push(v);
        seen[v as usize] = v;
        let mut done = 0;
        for _ in 0..STEPS {
            let end = around.len();
            for at in done..end {
                for arc in graph.arcs(around[at]) {
                    if seen[arc.to as usize] != v {
                        seen[arc.to as usize] = v;
                        around.push(arc.to);
                    }
                }
            }
            done = end;
        }
        let middle = around.iter().map(|&n| place(n)).sum::<Vector3<f64>>() / around.len() as f64;
        let covariance: Matrix3<f64> =
            around.iter().map(|&n| (place(n) - middle) * (place(n) - middle).transpose()).sum();
        let eigen = covariance.symmetric_eigen();
        let least = eigen.eigenvalues.imin();
        Ok(eigen.eigenvectors.column(least).into_owned())
    };
    let scratch = || (vec![u32::MAX; voxels.len()], Vec::new());
    (0..voxels.len() as u32).into_par_iter().map_init(scratch, normal).collect()
}

/// Orients normals so that neighbours agree, the most similar ones first.
fn agree(graph: &VoxelGraph, normals: &mut [Vector3<f64>], control: &Control) -> Result<()> {
    let mut is_done = vec![false; normals.len()];
    let mut heap = BinaryHeap::new(); // by similarity, then the lowest vertices first
    for start in 0..normals.len() as u32 {
        if is_done[start as usize] {
            continue;
        }
        let first = normals[start as usize];
        if first[first.iamax()] < 0.0 {
            normals[start as usize] = -first;
        }
        heap.push((u32::MAX, std::cmp::Reverse((start, start))));
        while let Some((_, std::cmp::Reverse((vertex, from)))) = heap.pop() {
            if is_done[vertex as usize] {
                continue;
            }
            is_done[vertex as usize] = true;
            if vertex.is_multiple_of(1024) {
                control.check()?;
            }
            if normals[vertex as usize].dot(&normals[from as usize]) < 0.0 {
                normals[vertex as usize] = -normals[vertex as usize];
            }
            for arc in graph.arcs(vertex).filter(|arc| !is_done[arc.to as usize]) {
                let alike = normals[vertex as usize].dot(&normals[arc.to as usize]).abs();
                heap.push(((alike * 1e9) as u32, std::cmp::Reverse((arc.to, vertex))));
            }
        }
    }
    Ok(())
}

/// Returns the distance in voxels from each surfel's voxel centre inwards to the middle of the sheet.
pub(crate) fn depths(mask: &Mask, voxels: &VoxelSurface, surfels: &Surfels) -> Vec<f64> {
    let depth = |surfel: u32| {
        let inward = surfels.direction(surfel).map(|x| -x);
        let mut voxel = voxels.voxels()[surfels.voxel(surfel) as usize].map(i64::from);
        let mut run = 1;
        while run < LONGEST_RUN && mask.is_inside(moved(voxel, inward)) {
            voxel = moved(voxel, inward);
            run += 1;
        }
        0.5 * (run - 1) as f64
    };
    (0..surfels.len() as u32).map(depth).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geodesic::graph::GeodesicGraph;
    use crate::patch::largest_piece;
    use crate::surface::voxels::voxelmesh::{Kind, VoxelMesh};
    use crate::surface::{Surface, topology::Topology};
    use crate::tests::assert_sound;
    use crate::tests::{masks, row};
    use crate::volume::Affine;
    use nalgebra::Rotation3;
    use proptest::prelude::*;

    fn mesh(mask: &Mask, spacing: [f64; 3]) -> VoxelMesh {
        let mesh =
            VoxelMesh::of(mask, &Affine::from_spacing(spacing).unwrap(), None, None, &Control::default()).unwrap();
        assert_eq!(mesh.kind, Kind::Sheet);
        assert_sound(&mesh.surface);
        mesh
    }

    fn turned(angles: [f64; 3]) -> Rotation3<f64> {
        Rotation3::from_euler_angles(angles[0], angles[1], angles[2])
    }

    /// Returns a square of this side, digitised with one voxel in each column along the axis nearest to its normal.
    fn plane(side: f64, rotation: &Rotation3<f64>, thick: f64) -> Mask {
        let size = (1.8 * side) as usize;
        let middle = Vector3::repeat(size as f64 / 2.0 + 0.137);
        let normal = rotation * Vector3::z();
        Mask::from_fn([size; 3], |v| {
            let p = rotation.inverse() * (Vector3::from(v.map(|x| x as f64)) - middle);
            p.x.abs() < side / 2.0 && p.y.abs() < side / 2.0 && p.z.abs() <= thick * normal.amax() / 2.0
        })
        .unwrap()
    }

    /// Returns the mean relative error of distances on a surface from three of its vertices, compared with a plane.
    fn error(surface: &Surface, unrolled: impl Fn(&Vector3<f64>) -> [f64; 2]) -> f64 {
        let graph = GeodesicGraph::new(surface, &Control::default()).unwrap();
        let flat: Vec<[f64; 2]> = surface.points().iter().map(unrolled).collect();
        let (mut sum, mut count) = (0.0, 0.0);
        for part in 1..6 {
            let source = part * surface.len() / 6;
            let row = row(&graph, source as u32);
            for (place, &distance) in flat.iter().zip(&row) {
                let truth = (place[0] - flat[source][0]).hypot(place[1] - flat[source][1]);
                if truth > 5.0 {
                    sum += (f64::from(distance) / truth - 1.0).abs();
                    count += 1.0;
                }
            }
        }
        sum / count
    }

    #[test]
    fn solids_are_no_sheets() {
        let cube = |n: usize| Mask::from_fn([n; 3], |_| true).unwrap();
        let is_sheet = |mask: &Mask| is_sheet(mask, &Control::default()).unwrap();
        assert!(!is_sheet(&cube(4)) && !is_sheet(&cube(12)));
        assert!(is_sheet(&Mask::from_fn([20, 20, 2], |_| true).unwrap()));
    }

    #[test]
    fn a_level_sheet_is_a_disk_of_its_voxels() {
        for spacing in [[1.0; 3], [1.0, 1.0, 5.0], [0.5, 2.5, 1.0]] {
            let mesh = mesh(&Mask::from_fn([12, 15, 3], |v| v[2] == 1).unwrap(), spacing);
            let topology = Topology::of(&mesh.surface);
            assert!(topology.is_disk());
            assert_eq!((mesh.surface.len(), mesh.conflicts, mesh.split), (12 * 15, 0, 0));
            assert!(mesh.surface.points().iter().all(|p| (p.z - spacing[2]).abs() < 1e-9));
        }
        let ring = mesh(
            &Mask::from_fn([16, 16, 3], |v| v[2] == 1 && !(v[0].abs_diff(8) < 4 && v[1].abs_diff(8) < 4)).unwrap(),
            [1.0; 3],
        );
        assert_eq!((Topology::of(&ring.surface).euler, ring.surface.boundary().len()), (0, 2));
    }

    #[test]
    fn slanted_planes_are_disks_with_their_distances() {
        let mut sum = 0.0;
        for seed in 0..24 {
            let angles = [0, 1, 2].map(|axis| f64::from(seed * 3 + axis).sin() * 43.7);
            let rotation = turned(angles);
            let mesh = mesh(&plane(26.0, &rotation, 1.0), [1.0; 3]);
            let surface = largest_piece(&mesh.surface);
            assert!(surface.faces().len() as f64 > 0.98 * mesh.surface.faces().len() as f64, "{angles:?}");
            assert!(Topology::of(&surface).is_disk(), "{angles:?} {:?}", Topology::of(&surface).euler);
            let wrong = error(&surface, |p| {
                let p = rotation.inverse() * p;
                [p.x, p.y]
            });
            assert!(wrong < 0.018, "{angles:?} {wrong}");
            sum += wrong;
        }
        assert!(sum / 24.0 < 0.008, "{sum}");
    }

    #[test]
    fn a_curled_sheet_is_a_disk_with_its_distances() {
        let (length, width, turns) = (70.0, 30.0, 0.9);
        let radius = length / (std::f64::consts::TAU * turns);
        let mut wrong = Vec::new();
        for seed in 0..6 {
            let angles = [0, 1, 2].map(|axis| f64::from(seed * 5 + axis).cos() * 37.1);
            let rotation = turned(angles);
            let middle = Vector3::repeat(27.3);
            let local = |p: &Vector3<f64>| rotation.inverse() * (p - middle);
            let mask = Mask::from_fn([55; 3], |v| {
                let p = local(&Vector3::from(v.map(|x| x as f64)));
                let angle = p.y.atan2(p.x);
                let normal = rotation * Vector3::new(angle.cos(), angle.sin(), 0.0);
                let inside = angle.abs() < std::f64::consts::PI * turns && p.z.abs() < width / 2.0;
                inside && (p.x.hypot(p.y) - radius).abs() <= 0.5 * normal.amax()
            })
            .unwrap();
            let mesh = mesh(&mask, [1.0; 3]);
            let surface = largest_piece(&mesh.surface);
            // where the sheet is steep in all axes a pinhole may be left, which the patch closes
            let topology = Topology::of(&surface);
            let holes = &topology.loops[1..];
            assert!(topology.genus == 0 && holes.iter().all(|hole| hole.half_edges.len() <= 12), "{angles:?}");
            assert!(surface.faces().len() as f64 > 0.98 * mesh.surface.faces().len() as f64, "{angles:?}");
            wrong.push(error(&surface, |p| {
                let p = local(p);
                [p.y.atan2(p.x) * radius, p.z]
            }));
        }
        let mean = wrong.iter().sum::<f64>() / wrong.len() as f64;
        assert!(mean < 0.007, "{wrong:?}");
    }

    #[test]
    fn a_closed_shell_is_a_sphere() {
        let away = |v: [usize; 3]| v.iter().map(|&x| (x as f64 - 12.0).powi(2)).sum::<f64>().sqrt();
        let mesh = mesh(&Mask::from_fn([25; 3], |v| (away(v) - 9.0).abs() < 0.6).unwrap(), [1.0; 3]);
        let topology = Topology::of(&largest_piece(&mesh.surface));
        assert_eq!((topology.euler, topology.loops.len()), (2, 0));
        let normals = mesh.surface.normals();
        let outward =
            mesh.surface.points().iter().zip(&normals).filter(|(p, n)| (*p - Vector3::repeat(12.0)).dot(n) > 0.0);
        assert_eq!(outward.count(), mesh.surface.len());
    }

    /// Returns a threshold of smoothed noise, similar to masks of thin structures.
    fn smooth(size: [usize; 3], noise: &[f64], times: usize, share: f64) -> Option<Mask> {
        let at = |[i, j, k]: [usize; 3]| (i * size[1] + j) * size[2] + k;
        let count = size.iter().product();
        let mut values: Vec<f64> = noise.iter().copied().cycle().take(count).collect();
        for axis in (0..3).cycle().take(3 * times) {
            let old = values.clone();
            for n in 0..count {
                let place = [n / (size[1] * size[2]), n / size[2] % size[1], n % size[2]];
                let mut beside = [place; 2];
                beside[0][axis] = place[axis].saturating_sub(1);
                beside[1][axis] = (place[axis] + 1).min(size[axis] - 1);
                values[n] = 0.5 * old[n] + 0.25 * (old[at(beside[0])] + old[at(beside[1])]);
            }
        }
        let mut sorted = values.clone();
        sorted.sort_unstable_by(f64::total_cmp);
        let level = sorted[(share * count as f64) as usize];
        Mask::from_fn(size, |place| values[at(place)] > level).ok()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(150))]
        #[test]
        fn no_two_neighbours_share_a_place(
            noise in prop::collection::vec(-1.0..1.0f64, 1031),
            size in prop::array::uniform3(4..12usize),
            (times, share) in (1..4usize, 0.3..0.95f64),
            spacing in prop::array::uniform3(0.5..2.0f64),
            is_sheet in prop::option::weighted(0.7, Just(Kind::Sheet)),
        ) {
            let Some(mask) = smooth(size, &noise, times, share) else { return Ok(()) };
            let affine = Affine::from_spacing(spacing).unwrap();
            if let Ok(mesh) = VoxelMesh::of(&mask, &affine, is_sheet, None, &Control::default()) {
                let finest = spacing.into_iter().fold(f64::INFINITY, f64::min);
                let shortest = mesh.surface.edges().map(|h| mesh.surface.length(h)).fold(f64::INFINITY, f64::min);
                prop_assert!(shortest > 0.005 * finest, "{:?} {shortest}", mesh.kind);
            }
        }
    }

    proptest! {
        #[test]
        fn whatever_is_called_a_sheet_is_a_surface_or_refused(mask in (2..7usize).prop_flat_map(|size| masks([size; 3], 0.05..0.95))) {
            let affine = Affine::from_spacing([1.0, 0.8, 3.0]).unwrap();
            if let Ok(mesh) = VoxelMesh::of_sheet(&mask, &affine, &Control::default()) {
                assert_sound(&mesh.surface);
                prop_assert_eq!(mesh.voxels.len(), mesh.surface.len());
            }
        }
    }
}
