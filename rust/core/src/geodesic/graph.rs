//! Geodesics over the triangles of a surface, as paths in a graph.
//!
//! Faces around a vertex are unfolded into its plane, one across the next (`view`). Another vertex that is then visible
//! through the edges in between is connected by a straight line across these faces: a true path on the surface, and the
//! shortest one through these faces. Such lines and the edges are the links, except those that others replace
//! (`pruning`). Therefore, distances are lengths of real paths, never too short, symmetric, and satisfy the triangle
//! inequality. They are too long where no chain of links is straight.

mod pruning;
mod view;

use rayon::prelude::*;

use crate::adjacency::{Arc, Links};
use crate::surface::mesh::Surface;
use crate::{Control, Result};
use pruning::Needed;
use view::View;
pub(super) use view::{Beyond, outgoing, unfold};

/// The number of links that one task measures.
const BATCH: usize = 1 << 16;

/// The number of layers of links, shorter ones first; links that one replaces are not evaluated again.
const LAYERS: usize = 8;

/// Returns how many edges a link may cross (docs/decisions/0007). Fewer save memory and time on large surfaces.
fn edges_crossed(vertices: usize) -> u32 {
    match vertices {
        0..=500_000 => 11,
        _ => 7,
    }
}

/// Straight links over a surface, stored at both ends in compressed rows; a vertex's arcs are ordered by neighbour.
#[derive(Debug, Clone)]
pub struct GeodesicGraph {
    starts: Vec<u32>,
    arcs: Vec<Arc>,
    most_links: usize,
    extremes: [f32; 2],
    /// Whether each vertex lies on the boundary of the surface.
    is_on_boundary: Vec<bool>,
}

impl GeodesicGraph {
    /// Returns the maximum memory in bytes of a graph, while its links are found: more than was measured
    /// (docs/decisions/0034).
    pub(crate) fn memory_need(vertices: usize) -> u64 {
        vertices as u64 * if edges_crossed(vertices) == 11 { 1800 } else { 1000 }
    }

    /// Returns the maximum memory in bytes of the finished graph, with about 94 links per vertex, or 50.
    pub(crate) fn size(vertices: usize) -> u64 {
        vertices as u64 * if edges_crossed(vertices) == 11 { 760 } else { 410 }
    }

    /// Creates the graph of a surface.
    ///
    /// # Errors
    /// [`Error::TooManyLinks`](crate::Error::TooManyLinks) if 32 bits cannot count the links, and
    /// [`Error::Cancelled`](crate::Error::Cancelled).
    pub fn new(surface: &Surface, control: &Control) -> Result<Self> {
        Self::in_layers(surface, edges_crossed(surface.len()), LAYERS, control)
    }

    /// Creates the graph whose links cross at most `crossed` edges, few enough to be evaluated without layers.
    pub(crate) fn crossing(surface: &Surface, crossed: u32, control: &Control) -> Result<Self> {
        Self::in_layers(surface, crossed, 1, control)
    }

    fn in_layers(surface: &Surface, crossed: u32, layers: usize, control: &Control) -> Result<Self> {
        control.begin("building the graph", surface.len() as u64);
        let needed = Needed::of(View::new(surface, crossed), surface.len(), layers, control)?;
        let (starts, arcs) = needed.joined()?;
        let most_links = starts.windows(2).map(|row| row[1] - row[0]).max().unwrap_or(0) as usize;
        let lengths = || arcs.par_iter().with_min_len(BATCH).map(|arc| arc.length);
        let longest = lengths().reduce(|| 0.0, f32::max);
        let extremes = [lengths().reduce(|| longest, f32::min), longest];
        let is_on_boundary = surface.is_on_boundary();
        Ok(Self { starts, arcs, most_links, extremes, is_on_boundary })
    }

    /// Returns whether a vertex lies on the boundary of the surface.
    pub(super) fn is_on_boundary(&self, vertex: u32) -> bool {
        self.is_on_boundary[vertex as usize]
    }

    fn links_of(&self, vertex: u32) -> &[Arc] {
        &self.arcs[self.starts[vertex as usize] as usize..self.starts[vertex as usize + 1] as usize]
    }
}

impl Links for GeodesicGraph {
    fn vertices(&self) -> usize {
        self.starts.len() - 1
    }

    #[inline]
    fn arcs(&self, vertex: u32) -> impl Iterator<Item = Arc> + '_ {
        self.links_of(vertex).iter().copied()
    }

    fn most_links(&self) -> usize {
        self.most_links
    }

    fn extremes(&self) -> [f32; 2] {
        self.extremes
    }

    fn are_straight(&self) -> bool {
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::mesh::shapes;
    use crate::tests::row;
    use nalgebra::Vector3;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Returns a surface, and a copy with random displacements, in which no two links are equally long.
    fn even_and_uneven(surface: &Surface) -> [Surface; 2] {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let by = 0.3 * surface.length(0);
        let elsewhere = |point: &Vector3<f64>| point + Vector3::from_fn(|_, _| rng.random_range(-by..by));
        let points = surface.points().iter().map(elsewhere).collect();
        [surface.clone(), surface.moved(points).unwrap()]
    }

    #[test]
    fn links_on_a_plane_are_straight() {
        let surface = shapes::surface(shapes::sheet(9, 7));
        for crossed in 0..6 {
            let graph = GeodesicGraph::crossing(&surface, crossed, &Control::default()).unwrap();
            for v in 0..surface.len() as u32 {
                for arc in graph.arcs(v) {
                    let apart = surface.points()[v as usize] - surface.points()[arc.to as usize];
                    assert!((f64::from(arc.length) - apart.norm()).abs() < 1e-5);
                    assert!(graph.arcs(arc.to).any(|back| back == Arc { to: v, ..arc }));
                }
            }
        }
    }

    #[test]
    fn a_link_over_the_edge_of_a_box_is_unfolded() {
        // two squares at a right angle: across the fold 2 x 1, unfolded
        let points =
            [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 1.0]];
        let faces = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [4, 3, 5]];
        let (surface, _) = Surface::from_triangles(&points, &faces).unwrap();
        let graph = GeodesicGraph::new(&surface, &Control::default()).unwrap();
        let found = graph.arcs(2).find(|arc| arc.to == 4).unwrap();
        assert!((f64::from(found.length) - 5f64.sqrt()).abs() < 1e-6);
    }

    #[test]
    fn distances_on_a_sphere_are_never_short_and_hardly_long() {
        let surface = shapes::surface(shapes::sphere(5));
        let graph = GeodesicGraph::new(&surface, &Control::default()).unwrap();
        let mut sum = 0.0;
        let row = row(&graph, 17);
        for (point, &distance) in surface.points().iter().zip(&row).filter(|&(_, &d)| d > 0.0) {
            let chord = (point - surface.points()[17]).norm();
            let arc = 2.0 * (chord / 2.0).asin();
            assert!(f64::from(distance) > chord - 1e-5 && f64::from(distance) > 0.998 * arc, "{distance} {arc}");
            sum += f64::from(distance) / arc - 1.0;
        }
        let mean = sum / (surface.len() - 1) as f64;
        assert!(mean < 0.006, "{mean}");
    }

    #[test]
    fn links_that_are_dropped_are_replaced_even_where_triangles_are_thin() {
        let (mut points, faces) = shapes::sheet(12, 40);
        points.iter_mut().for_each(|point| point[1] *= 1e-3); // edges of 1 and of 0.001 mm
        let surface = shapes::surface((points, faces));
        let graph = GeodesicGraph::new(&surface, &Control::default()).unwrap();
        assert_eq!(graph.components().sizes.len(), 1);
        let all = row(&graph, 5);
        for (point, &distance) in surface.points().iter().zip(&all) {
            let straight = (point - surface.points()[5]).norm();
            assert!(f64::from(distance) >= straight - 1e-5 && f64::from(distance) < 1.05 * straight + 1e-5);
        }
    }

    #[test]
    fn links_are_the_same_in_any_number_of_layers() {
        let surfaces = [shapes::sphere(4), shapes::torus(24, 13), shapes::sheet(19, 31)].map(shapes::surface);
        for surface in surfaces.iter().flat_map(even_and_uneven) {
            let graph = |layers| GeodesicGraph::in_layers(&surface, 9, layers, &Control::default()).unwrap();
            let once = graph(1);
            assert!(once.arcs.len() > 20 * surface.len());
            for layers in [2, 3, 8, 14] {
                assert_eq!((graph(layers).starts, graph(layers).arcs), (once.starts.clone(), once.arcs.clone()));
            }
        }
    }

    #[test]
    fn nothing_crosses_a_cut() {
        let graph = GeodesicGraph::new(&crate::tests::slit(4, 8, 4.0, 4.0), &Control::default()).unwrap();
        assert_eq!(graph.components().sizes.len(), 2);
    }
}
