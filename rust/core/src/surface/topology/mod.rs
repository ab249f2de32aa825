//! The topology of a surface: its components, their handles, and their boundary.
//!
//! For each component, χ = vertices − edges + faces = 2 − 2 genus − boundary loops. A surface can be flattened without
//! a cut if it is a disk (one component, no handle, one boundary loop) or a disk with holes (more loops). All functions here take linear time.

pub(crate) mod homology;
pub mod loops;
pub mod thin;

use crate::surface::mesh::Surface;

/// The topological properties of a surface.
#[derive(Debug, Clone, PartialEq)]
pub struct Topology {
    /// The number of vertices.
    pub vertices: usize,
    /// The number of edges.
    pub edges: usize,
    /// The number of faces.
    pub faces: usize,
    /// The Euler characteristic χ, summed over the components.
    pub euler: i64,
    /// The number of handles, summed over the components.
    pub genus: usize,
    /// The connected components: first the largest one, see [`Topology::of`].
    pub components: Vec<Component>,
    /// The boundary loops by decreasing length.
    pub loops: Vec<Loop>,
}

/// A connected component of a surface.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Component {
    /// Its number in [`Surface::components`].
    pub label: u32,
    /// Its area in mm².
    pub area: f64,
    /// The number of faces.
    pub faces: usize,
    /// The number of vertices.
    pub vertices: usize,
    /// The number of edges.
    pub edges: usize,
    /// The Euler characteristic χ.
    pub euler: i64,
    /// The number of handles.
    pub genus: usize,
    /// The number of boundary loops.
    pub loops: usize,
}

/// A boundary loop.
#[derive(Debug, Clone, PartialEq)]
pub struct Loop {
    /// Its half-edges in order, with the surface on their left.
    pub half_edges: Vec<u32>,
    /// Its length in mm.
    pub length: f64,
    /// The number of its component in [`Surface::components`].
    pub component: u32,
}

impl Loop {
    /// Returns its vertices in order.
    pub fn vertices(&self, surface: &Surface) -> Vec<u32> {
        self.half_edges.iter().map(|&h| surface.origin(h)).collect()
    }
}

/// The least number of faces of a component that counts as large, relative to the component with the most faces. A
/// stray triangle with a corner far away may have a larger area than the rest of the surface.
const LEAST_FACES: f64 = 0.01;

impl Topology {
    /// Computes the topology of a surface. Its components are sorted by decreasing area; those with less than 1 % as
    /// many faces as another component come last.
    pub fn of(surface: &Surface) -> Self {
        let pieces = surface.components();
        let label = &pieces.labels;
        let mut components = vec![Component::default(); pieces.count()];
        (0..).zip(&mut components).for_each(|(label, component)| component.label = label);
        let mut seen = vec![false; surface.len()];
        for ((face, &label), area) in surface.faces().iter().zip(label).zip(surface.areas()) {
            let component = &mut components[label as usize];
            component.area += area;
            component.faces += 1;
            component.vertices += face.iter().filter(|&&v| !std::mem::replace(&mut seen[v as usize], true)).count();
        }
        surface.edges().for_each(|h| components[label[h as usize / 3] as usize].edges += 1);
        let mut loops = loops_of(surface, label);
        loops.iter().for_each(|border| components[border.component as usize].loops += 1);
        for component in &mut components {
            component.euler = (component.vertices + component.faces) as i64 - component.edges as i64;
            component.genus = (2 - component.euler - component.loops as i64).max(0) as usize / 2;
        }
        let least = LEAST_FACES * components.iter().map(|component| component.faces).max().unwrap_or(0) as f64;
        let is_stray = |component: &Component| (component.faces as f64) < least;
        // stable: of equal ones, the one with the first face
        components.sort_by(|a, b| is_stray(a).cmp(&is_stray(b)).then(b.area.total_cmp(&a.area)));
        loops.sort_by(|a, b| b.length.total_cmp(&a.length));
        Self {
            vertices: surface.len(),
            edges: components.iter().map(|component| component.edges).sum(),
            faces: surface.faces().len(),
            euler: components.iter().map(|component| component.euler).sum(),
            genus: components.iter().map(|component| component.genus).sum(),
            components,
            loops,
        }
    }

    /// Returns whether the surface is a single disk, which can be flattened without a cut.
    pub(crate) fn is_disk(&self) -> bool {
        self.components.len() == 1 && self.genus == 0 && self.loops.len() == 1
    }
}

/// Returns the boundary loops in the order of their first half-edges; `label` is the component of each face.
fn loops_of(surface: &Surface, label: &[u32]) -> Vec<Loop> {
    let measured = |half_edges: Vec<u32>| Loop {
        length: half_edges.iter().map(|&h| surface.length(h)).sum(),
        component: label[half_edges[0] as usize / 3],
        half_edges,
    };
    surface.boundary().into_iter().map(measured).collect()
}

/// Returns, for each vertex, the first vertex of its boundary loop, or itself inside the surface. This contracts every
/// boundary loop to a point, so that the surface is closed.
pub(crate) fn shrunk(surface: &Surface) -> Vec<u32> {
    let mut node: Vec<u32> = (0..surface.len() as u32).collect();
    for border in surface.boundary() {
        border.iter().for_each(|&h| node[surface.origin(h) as usize] = surface.origin(border[0]));
    }
    node
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::mesh::shapes;
    use crate::tests::{both, moved};
    use proptest::prelude::*;

    #[test]
    fn known_shapes() {
        for (shape, euler, genus, loops) in
            [(shapes::sheet(5, 4), 1, 0, 1), (shapes::torus(12, 7), 0, 1, 0), (shapes::sphere(2), 2, 0, 0)]
        {
            let topology = Topology::of(&shapes::surface(shape));
            assert_eq!((topology.euler, topology.genus, topology.loops.len()), (euler, genus, loops));
            assert_eq!(topology.is_disk(), loops == 1);
        }
    }

    #[test]
    fn components_come_by_area_and_loops_by_length() {
        let sheet = shapes::surface(shapes::sheet(9, 9));
        // a corner square, a frame with a hole of two by two squares, nothing of the rest
        let keep = |f: usize| {
            let (i, j) = (f / 2 / 9, f / 2 % 9);
            (i, j) == (0, 0) || (i > 1 && j > 1 && !((4..6).contains(&i) && (4..6).contains(&j)))
        };
        let part = sheet.part(&(0..sheet.faces().len()).map(keep).collect::<Vec<_>>());
        let topology = Topology::of(&part);
        let kinds: Vec<_> = topology.components.iter().map(|c| (c.label, c.faces, c.euler, c.genus, c.loops)).collect();
        assert_eq!(kinds, [(1, 90, 0, 0, 2), (0, 2, 1, 0, 1)]);
        assert_eq!(topology.components.iter().map(|c| c.area).collect::<Vec<_>>(), [45.0, 1.0]);
        let loops: Vec<_> = topology.loops.iter().map(|l| (l.component, l.length, l.half_edges.len())).collect();
        assert_eq!(loops, [(1, 28.0, 28), (1, 8.0, 8), (0, 4.0, 4)]);
        assert!(!topology.is_disk());
        assert_eq!(topology.loops[1].vertices(&part).len(), 8);
    }

    #[test]
    fn a_component_of_few_faces_comes_last_however_large_its_area() {
        // 198 faces of a sheet, and one or two triangles with a corner far away
        for (count, first) in [(1, 198), (2, 2)] {
            let (mut points, mut faces) = shapes::sheet(11, 9);
            let start = points.len() as i64;
            points.extend(&[[0.0, 0.0, 9.0], [1.0, 0.0, 9.0], [1e6, 1e6, 9.0], [1e6, -1e6, 9.0]][..count + 2]);
            faces.extend(&[[0, 1, 2], [0, 3, 1]].map(|face| face.map(|corner| start + corner))[..count]);
            let components = Topology::of(&shapes::surface((points, faces))).components;
            assert_eq!(components.iter().map(|one| one.faces).collect::<Vec<_>>(), [first, 198 + count - first]);
        }
    }

    #[test]
    fn nothing_is_no_disk() {
        let nothing = shapes::surface(shapes::sheet(1, 1)).part(&[false, false]);
        let topology = Topology::of(&nothing);
        assert!(!topology.is_disk());
        assert_eq!((topology.euler, topology.components.len()), (0, 0));
    }

    proptest! {
        #[test]
        fn the_formula_holds_for_any_part(keep in prop::collection::vec(any::<bool>(), 168)) {
            let part = shapes::surface(shapes::torus(12, 7)).part(&keep);
            let topology = Topology::of(&part);
            for component in &topology.components {
                prop_assert_eq!(component.euler, 2 - 2 * component.genus as i64 - component.loops as i64);
                prop_assert!(component.genus <= 1);
            }
            prop_assert_eq!(topology.vertices, topology.components.iter().map(|c| c.vertices).sum::<usize>());
            prop_assert_eq!(topology.edges, part.edges().count());
            prop_assert_eq!(topology.loops.len(), topology.components.iter().map(|c| c.loops).sum::<usize>());
        }
    }

    #[test]
    fn loops_come_by_length_and_not_by_the_number_of_edges() {
        let large = moved(&shapes::sheet(2, 2), |p| p.map(|x| 10.0 * x - 90.0));
        let topology = Topology::of(&shapes::surface(both(&shapes::sheet(5, 5), &large)));
        let loops: Vec<_> = topology.loops.iter().map(|l| (l.length, l.half_edges.len())).collect();
        assert_eq!(loops, [(80.0, 8), (20.0, 20)]);
    }
}
