//! Extraction of the surface of a label volume: surfels, nodes, positions.

use nalgebra::Vector3;

use crate::surface::mesh::Surface;
use crate::surface::voxels::positions::{self, Neighbours, Places};
use crate::surface::voxels::surfels::{Surfels, Touching, moved};
use crate::surface::voxels::{VoxelSurface, level::Level, nodes::Nodes, sheets};
use crate::volume::{Affine, Mask};
use crate::{Control, Error, Result};

/// The number of fits of a solid's surface; each one smooths the steps between voxels further (docs/decisions/0006).
const SOLID_FITS: usize = 2;

/// The number of fits of a voxel sheet, whose voxel centres scatter on both sides of it.
const SHEET_FITS: usize = 4;

/// How far fitted nodes are moved away from the mean of their neighbours ([`Places::sharpen`]).
const SHARPENING: f64 = 0.65;

/// How far nodes that were placed by an image with a level are moved in this way.
const LEVEL_SHARPENING: f64 = 0.25;

/// The kind of a label.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// The label has an interior, whose boundary is the surface.
    Solid,
    /// The label has background on both sides, and is itself the surface.
    Sheet,
}

/// The surface of a label volume. Its vertices are surface voxels, each seen from one side.
#[derive(Debug, Clone)]
pub struct VoxelMesh {
    /// The kind of the label.
    pub kind: Kind,
    /// The surface.
    pub surface: Surface,
    /// The voxel of each vertex.
    pub voxels: Vec<[u32; 3]>,
    /// The number of vertices that were added because a voxel carries several layers.
    pub split: usize,
    /// χ of a solid's surfels, which equals that of the surface.
    pub euler: i64,
    /// The number of pairs of neighbouring voxels of a sheet whose sides disagree: it is one-sided, or touches itself.
    pub conflicts: usize,
}

impl VoxelMesh {
    /// Extracts the surface of a label of the given kind, or of the kind that is detected.
    ///
    /// # Errors
    /// [`Error::ShapeMismatch`] of the level, [`Error::VoxelTooFar`], [`Error::GraphTooLarge`], [`Error::NoFaces`] if
    /// no triangle remains, and [`Error::Cancelled`].
    pub fn of(
        mask: &Mask, affine: &Affine, kind: Option<Kind>, level: Option<&Level>, control: &Control,
    ) -> Result<Self> {
        let kind = match kind {
            Some(kind) => kind,
            None if sheets::is_sheet(mask, control)? => Kind::Sheet,
            None => Kind::Solid,
        };
        match kind {
            Kind::Solid => Self::of_solid(mask, affine, level, control),
            Kind::Sheet => Self::of_sheet(mask, affine, control),
        }
    }

    /// Extracts one surface with a boundary through the middle of a sheet, including all components. In a sheet thicker
    /// than a voxel, the voxels that are visible only from the other side are not vertices. Errors: [`Error::NoFaces`]
    /// if the sheet is nowhere wide enough for a face, [`Error::GraphTooLarge`], [`Error::Cancelled`].
    pub(crate) fn of_sheet(mask: &Mask, affine: &Affine, control: &Control) -> Result<Self> {
        let voxels = VoxelSurface::from_mask(mask, *affine, control)?;
        let both = Surfels::new(mask, &voxels, Touching::Joined, control)?;
        let side = sheets::side(&voxels, &both, control)?;
        let surfels = both.restricted(&side.surfels);
        let depths = sheets::depths(mask, &voxels, &surfels);
        let spacing = affine.spacing();
        let along = |surfel: u32, outward: f64| {
            let voxel = voxels.voxels()[surfels.voxel(surfel) as usize];
            let direction = surfels.direction(surfel);
            Vector3::from_fn(|a, _| spacing[a] * (f64::from(voxel[a]) + outward * direction[a] as f64))
        };
        let middles: Vec<Vector3<f64>> = (0..).zip(&depths).map(|(surfel, &depth)| along(surfel, -depth)).collect();
        let centres: Vec<Vector3<f64>> = (0..surfels.len() as u32).map(|surfel| along(surfel, 0.5)).collect();
        let place = |nodes: &Nodes| {
            let mut thinnest = vec![f64::INFINITY; nodes.voxel.len()];
            for (&node, &depth) in nodes.of_surfel.iter().zip(&depths) {
                thinnest[node as usize] = depth.min(thinnest[node as usize]);
            }
            let counts = |surfel: usize| depths[surfel] == thinnest[nodes.of_surfel[surfel] as usize];
            let mut base = vec![(Vector3::zeros(), 0.0); nodes.voxel.len()];
            for surfel in (0..middles.len()).filter(|&surfel| counts(surfel)) {
                let (sum, count) = &mut base[nodes.of_surfel[surfel] as usize];
                *sum += middles[surfel];
                *count += 1.0;
            }
            let base: Vec<Vector3<f64>> = base.into_iter().map(|(sum, count)| sum / count).collect();
            let fitting = Fitting::new(&surfels, nodes, spacing);
            let mut places = fitting.fit(base, SHEET_FITS, control)?;
            places.set_apart(&nodes.means(&centres), &fitting.neighbours, spacing);
            Ok(places.points)
        };
        let (nodes, surface) = Nodes::triangulate(&surfels, &middles, place, control)?;
        let mesh = Self::in_space(&surface, &nodes, &surfels, &voxels)?;
        Ok(Self { kind: Kind::Sheet, conflicts: side.conflicts, ..mesh })
    }

    /// Extracts the boundary of a solid, including all components. With a level, its points lie where the image has
    /// that value, if it has it near the mask's border.
    pub(crate) fn of_solid(mask: &Mask, affine: &Affine, level: Option<&Level>, control: &Control) -> Result<Self> {
        if let Some(level) = level.filter(|level| level.shape() != mask.shape()) {
            let [given, needed] = [level.shape(), mask.shape()].map(|shape| shape.iter().product());
            return Err(Error::ShapeMismatch { shape: mask.shape(), given, needed });
        }
        let voxels = VoxelSurface::from_mask(mask, *affine, control)?;
        let surfels = Surfels::new(mask, &voxels, Touching::Apart, control)?;
        let spacing = affine.spacing();
        let mm = |place: Vector3<f64>| Vector3::from_fn(|a, _| spacing[a] * place[a]);
        let centre = |surfel: u32| {
            let voxel = voxels.voxels()[surfels.voxel(surfel) as usize].map(i64::from);
            let direction = surfels.direction(surfel);
            let share = level.and_then(|level| level.between(voxel, moved(voxel, direction))).unwrap_or(0.5);
            mm(Vector3::from_fn(|a, _| voxel[a] as f64 + share * direction[a] as f64))
        };
        let centres: Vec<Vector3<f64>> = (0..surfels.len() as u32).map(centre).collect();
        let place = |nodes: &Nodes| {
            let fitting = Fitting::new(&surfels, nodes, spacing);
            let base = nodes.means(&centres);
            let mut places = fitting.fit(base.clone(), SOLID_FITS, control)?;
            let Some(level) = level else {
                places.sharpen(SHARPENING, &fitting.neighbours, spacing);
                places.within_half_a_voxel(&base, spacing);
                return Ok(places.points);
            };
            places.within_half_a_voxel(&base, spacing);
            for (point, normal) in places.points.iter_mut().zip(&places.normals) {
                let [at, along] = [*point, *normal].map(|v| Vector3::from_fn(|a, _| v[a] / spacing[a]));
                let width = positions::width(normal, spacing);
                *point += normal * (width * level.along(at, along * width).unwrap_or(0.0));
            }
            places.sharpen(LEVEL_SHARPENING, &fitting.neighbours, spacing);
            Ok(places.points)
        };
        let (nodes, surface) = Nodes::triangulate(&surfels, &centres, place, control)?;
        Self::in_space(&surface, &nodes, &surfels, &voxels)
    }

    /// Transforms the surface of nodes, in mm along the volume's axes, into space.
    fn in_space(surface: &Surface, nodes: &Nodes, surfels: &Surfels, voxels: &VoxelSurface) -> Result<Self> {
        let affine = voxels.affine();
        let to_mm = |p: &Vector3<f64>| affine.to_mm([0, 1, 2].map(|a| p[a] / affine.spacing()[a]));
        let points = surface.points().iter().map(to_mm).collect();
        let of_vertex = |&id: &u32| voxels.voxels()[nodes.voxel[id as usize] as usize];
        let mirrored = affine.linear().determinant() < 0.0;
        Ok(Self {
            voxels: surface.ids().iter().map(of_vertex).collect(),
            surface: surface.moved(points)?.into_input(mirrored),
            kind: Kind::Solid,
            split: nodes.split,
            euler: surfels.euler(),
            conflicts: 0,
        })
    }
}

/// The common data of fits through nodes.
struct Fitting {
    outward: Vec<Vector3<f64>>,
    neighbours: Neighbours,
    spacing: [f64; 3],
}

impl Fitting {
    fn new(surfels: &Surfels, nodes: &Nodes, spacing: [f64; 3]) -> Self {
        let area = |surfel: u32| Vector3::from_fn(|a, _| surfels.direction(surfel)[a] as f64 / spacing[a]);
        let areas: Vec<Vector3<f64>> = (0..surfels.len() as u32).map(area).collect();
        let outward = nodes.means(&areas).into_iter().map(|n| n.try_normalize(1e-12).unwrap_or_default()).collect();
        Self { outward, neighbours: neighbours(surfels, nodes), spacing }
    }

    /// Fits the surface through the nodes' bases, and then repeatedly through the previous fit, `times` fits in total.
    fn fit(&self, base: Vec<Vector3<f64>>, times: usize, control: &Control) -> Result<Places> {
        control.begin("placing the vertices", times as u64 * positions::steps(base.len()));
        let mut places = Places { points: base, normals: Vec::new() };
        for _ in 0..times {
            places = positions::fit(&places.points, self.outward.clone(), &self.neighbours, self.spacing, control)?;
        }
        Ok(places)
    }
}

/// Returns the pairs of nodes that meet at a point.
fn neighbours(surfels: &Surfels, nodes: &Nodes) -> Neighbours {
    let mut pairs = Vec::new();
    let mut ring = Vec::new();
    surfels.around_points(|around| {
        ring.clear();
        ring.extend(around.iter().map(|&s| nodes.of_surfel[s as usize]));
        ring.dedup();
        for (n, &a) in ring.iter().enumerate() {
            pairs.extend(ring[..n].iter().map(|&b| [a, b]));
        }
    });
    Neighbours::from_pairs(nodes.voxel.len(), &pairs)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::adjacency::distinct;
    use crate::surface::topology::Topology;
    use crate::tests::{masks, voxels};
    use proptest::prelude::*;

    fn mesh_of(mask: &Mask) -> VoxelMesh {
        VoxelMesh::of_solid(mask, &Affine::from_spacing([1.0; 3]).unwrap(), None, &Control::default()).unwrap()
    }

    /// Checks that a mesh is a closed manifold with the surfels' χ, whose vertices are the surface voxels.
    fn assert_sound(mask: &Mask, mesh: &VoxelMesh) {
        crate::tests::assert_sound(&mesh.surface);
        let half_edges = 0..3 * mesh.surface.faces().len() as u32;
        let edges = distinct(half_edges.clone().map(|h| [mesh.surface.origin(h), mesh.surface.target(h)]));
        assert_eq!(edges.len(), half_edges.len(), "a simplicial complex");
        assert!(edges.iter().all(|[a, b]| a != b));
        let topology = Topology::of(&mesh.surface);
        assert_eq!((topology.euler, topology.loops.len()), (mesh.euler, 0));
        let expected = voxels(mask, [1.0; 3]).voxels().to_vec();
        assert_eq!(distinct(mesh.voxels.clone()), distinct(expected));
    }

    #[test]
    fn a_ball_keeps_its_voxels_and_comes_near_the_sphere() {
        let radius = 9.3;
        let mask =
            Mask::from_fn([24; 3], |v| v.iter().map(|&x| (x as f64 - 11.5).powi(2)).sum::<f64>() < radius * radius)
                .unwrap();
        let mesh = mesh_of(&mask);
        assert_sound(&mask, &mesh);
        assert_eq!((mesh.euler, mesh.split), (2, 0));
        let off = |p: &Vector3<f64>| (p - Vector3::repeat(11.5)).norm() - radius;
        let worst = mesh.surface.points().iter().map(|p| off(p).abs()).fold(0.0, f64::max);
        assert!(worst < 0.5, "{worst}");
        let normals = mesh.surface.face_normals();
        let outward = |(face, n): (&[u32; 3], &Vector3<f64>)| {
            (mesh.surface.points()[face[0] as usize] - Vector3::repeat(11.5)).dot(n) > 0.0
        };
        assert!(mesh.surface.faces().iter().zip(&normals).all(outward));
    }

    #[test]
    fn a_level_puts_the_points_onto_the_surface() {
        let radius = 9.3;
        for spacing in [[1.0; 3], [1.0, 1.0, 5.0], [0.4, 2.0, 0.7]] {
            let affine = Affine::from_spacing(spacing).unwrap();
            let shape = spacing.map(|h| (24.0 / h).ceil() as usize);
            let inside = |v: [usize; 3]| radius - (affine.to_mm(v.map(|x| x as f64)) - Vector3::repeat(11.5)).norm();
            let mask = Mask::from_fn(shape, |v| inside(v) > 0.0).unwrap();
            let voxels =
                (0..shape.iter().product()).map(|n| [n / (shape[1] * shape[2]), n / shape[2] % shape[1], n % shape[2]]);
            let level = Level::new(shape, voxels.map(|v| inside(v) as f32).collect(), 0.0).unwrap();
            let off = |mesh: &VoxelMesh| {
                let off = |p: &Vector3<f64>| ((p - Vector3::repeat(11.5)).norm() - radius).abs();
                mesh.surface.points().iter().map(off).sum::<f64>() / mesh.surface.len() as f64
            };
            let fitted = VoxelMesh::of_solid(&mask, &affine, None, &Control::default()).unwrap();
            let levelled = VoxelMesh::of_solid(&mask, &affine, Some(&level), &Control::default()).unwrap();
            let coarsest = spacing.into_iter().fold(0.0, f64::max);
            assert!(off(&fitted) < 0.2 * coarsest, "{spacing:?} {}", off(&fitted));
            assert!(off(&levelled) < 0.06 * coarsest * coarsest, "{spacing:?} {}", off(&levelled));
            assert_sound(&mask, &levelled);
        }
    }

    #[test]
    fn a_mirrored_volume_has_its_outside_outside() {
        let mask = Mask::from_fn([9; 3], |v| v.iter().all(|&x| (2..7).contains(&x))).unwrap();
        for sign in [1.0, -1.0] {
            let matrix = [[sign, 0.0, 0.0, 3.0], [0.0, 2.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
            let mesh = VoxelMesh::of_solid(&mask, &Affine::new(matrix).unwrap(), None, &Control::default()).unwrap();
            let middle = mesh.surface.points().iter().sum::<Vector3<f64>>() / mesh.surface.len() as f64;
            assert!(mesh.surface.points().iter().zip(mesh.surface.normals()).all(|(p, n)| (p - middle).dot(&n) > 0.0));
        }
    }

    #[test]
    fn all_patterns_of_eight_voxels() {
        for pattern in 1..256u32 {
            let mask = Mask::from_fn([2; 3], |[i, j, k]| pattern >> (4 * i + 2 * j + k) & 1 == 1).unwrap();
            assert_sound(&mask, &mesh_of(&mask));
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(1000))]
        #[test]
        fn any_volume_is_a_manifold(mask in (3..7usize).prop_flat_map(|size| masks([size; 3], 0.05..0.95))) {
            assert_sound(&mask, &mesh_of(&mask));
        }
    }
}
