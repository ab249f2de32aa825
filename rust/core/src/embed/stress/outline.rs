//! The outline of a map, which prevents its boundary from crossing itself.
//!
//! A map that folds no triangle and whose boundary does not cross itself does not overlap itself. Therefore, only the
//! boundary is controlled: its vertices are pushed away from its edges where they come close, by
//!
//!   Σ max(0, g/d − 1)²
//!
//! with d the distance of a vertex from an edge and g the gap at which it begins. No step goes beyond the point where
//! the first vertex meets an edge (Smith, Schaefer 2015).

use robust::Coord;

use super::triangles::roots;
use crate::boxes::{Bounds, Tree};
use crate::distortion::overlap::count_crossings;
use crate::embed::Place;
use crate::surface::Surface;
use crate::{Control, Result};

/// The gap as a share of the smallest height of a triangle at the boundary: in a map that preserves shapes, no vertex
/// is that close to an edge of its own triangles.
const GAP: f64 = 0.5;

/// The tolerance, as a share of an edge, within which a vertex that meets its line beyond its end counts as meeting it.
const BESIDE: f64 = 1e-6;

/// The boundary of a surface, which is prevented from crossing itself in the plane.
#[derive(Debug)]
pub struct Outline {
    /// Edges with the surface on their left; every vertex of the boundary begins one.
    edges: Vec<[u32; 2]>,
    /// The gap of each edge and its first vertex in mm.
    gaps: Vec<f64>,
}

struct Contact {
    vertex: u32,
    edge: [u32; 2],
    /// The nearest point on the edge, as a share of its length.
    along: f64,
    /// The vector from there to the vertex in mm.
    apart: Place,
    gap: f64,
}

impl Contact {
    /// Returns the energy, and its first and second derivatives with respect to the distance.
    fn push(&self) -> [f64; 3] {
        let distance = self.apart.norm();
        let near = self.gap / distance;
        // d/dd (g/d − 1)² with near = g/d, whose derivative is −near/d
        let slope = -2.0 * (near - 1.0) * near / distance;
        [(near - 1.0).powi(2), slope, 2.0 * near * (3.0 * near - 2.0) / distance.powi(2)]
    }
}

impl Outline {
    /// Iterates over the vertices of the boundary.
    pub fn vertices(&self) -> impl Iterator<Item = u32> + '_ {
        self.edges.iter().map(|edge| edge[0])
    }

    /// Returns, for each of `vertices` vertices, whether it is not on the boundary.
    pub fn inside(&self, vertices: usize) -> Vec<bool> {
        let mut inside = vec![true; vertices];
        self.vertices().for_each(|vertex| inside[vertex as usize] = false);
        inside
    }

    /// Creates the outline of the complete boundary.
    pub fn new(surface: &Surface) -> Self {
        Self::of(surface, surface.boundary().into_iter().flatten())
    }

    /// Creates the outline of some half-edges of the boundary.
    pub fn of(surface: &Surface, boundary: impl Iterator<Item = u32>) -> Self {
        let points = surface.points();
        let mut heights = vec![f64::INFINITY; surface.len()];
        for face in surface.faces() {
            let [a, b, c] = face.map(|vertex| points[vertex as usize]);
            let longest = (b - a).norm().max((c - b).norm()).max((a - c).norm());
            let height = (b - a).cross(&(c - a)).norm() / longest;
            face.iter().for_each(|&vertex| heights[vertex as usize] = heights[vertex as usize].min(height));
        }
        let ends = |half_edge: u32| [surface.origin(half_edge), surface.target(half_edge)];
        let edges: Vec<[u32; 2]> = boundary.map(ends).collect();
        let gaps = edges.iter().map(|edge| GAP * heights[edge[0] as usize].min(heights[edge[1] as usize])).collect();
        Self { edges, gaps }
    }

    /// Returns the edges, which have the surface on their left.
    pub fn edges(&self) -> &[[u32; 2]] {
        &self.edges
    }

    /// Adds copies of all original edges, in their order.
    pub fn extend(&mut self, copies: impl ExactSizeIterator<Item = [u32; 2]>) {
        self.gaps.extend_from_within(..copies.len());
        self.edges.extend(copies);
    }

    fn ends(&self, edge: usize, uv: &[Place]) -> [Place; 2] {
        self.edges[edge].map(|vertex| uv[vertex as usize])
    }

    /// Adds the energy's gradient times `weight` to `gradient`, and returns the energy times `weight`.
    pub fn add(&self, uv: &[Place], weight: f64, gradient: &mut [Place]) -> f64 {
        let weight = weight / self.edges.len() as f64;
        let mut energy = 0.0;
        for contact in self.contacts(uv) {
            let [height, slope, _] = contact.push();
            let force = contact.apart.normalize() * (weight * slope);
            energy += weight * height;
            gradient[contact.vertex as usize] += force;
            gradient[contact.edge[0] as usize] -= force * (1.0 - contact.along);
            gradient[contact.edge[1] as usize] -= force * contact.along;
        }
        energy
    }

    /// Adds the stiffness of the energy times `weight` at each vertex.
    pub fn add_curvature(&self, uv: &[Place], weight: f64, ground: &mut [f64]) {
        let weight = weight / self.edges.len() as f64;
        for contact in self.contacts(uv) {
            let stiff = weight * contact.push()[2];
            ground[contact.vertex as usize] += stiff;
            ground[contact.edge[0] as usize] += stiff * (1.0 - contact.along).powi(2);
            ground[contact.edge[1] as usize] += stiff * contact.along.powi(2);
        }
    }

    /// Returns how far the boundary may move along `direction`, as a share, until a vertex meets an edge, or `most`.
    pub fn farthest_step(&self, uv: &[Place], direction: &[Place], most: f64) -> f64 {
        let swept = |edge: usize| {
            let [a, b] = self.ends(edge, uv);
            let [along_a, along_b] = self.ends(edge, direction);
            Bounds::of(&[a, b, a + along_a * most, b + along_b * most], self.gaps[edge])
        };
        let mut farthest = most;
        self.visit_near(swept, |first, edge| {
            let corners = [self.edges[first][0], self.edges[edge][0], self.edges[edge][1]];
            let [at, way] = [uv, direction].map(|values| corners.map(|vertex| values[vertex as usize]));
            farthest = farthest.min(meeting(at, way));
        });
        farthest
    }

    /// Returns, for each boundary vertex that shares its position with another one, a vector into its own triangles
    /// along the bisector of its angle, half as long as its gap, so that both of its edges move inwards; else zero.
    pub fn inwards(&self, uv: &[Place]) -> Vec<Place> {
        let mut ways = vec![Place::zeros(); uv.len()];
        let key = |vertex: u32| uv[vertex as usize].map(|x| (x + 0.0).to_bits()); // + 0.0, so that −0 is 0
        let mut places: Vec<[u64; 2]> = self.vertices().map(|vertex| key(vertex).into()).collect();
        places.sort_unstable();
        let is_shared = |vertex: u32| {
            let place: [u64; 2] = key(vertex).into();
            let first = places.partition_point(|other| *other < place);
            places.get(first + 1) == Some(&place)
        };
        let mut before: Vec<[u32; 2]> = self.edges.iter().map(|&[from, to]| [to, from]).collect();
        before.sort_unstable();
        for (edge, &[vertex, after]) in self.edges.iter().enumerate().filter(|(_, edge)| is_shared(edge[0])) {
            let n = before.partition_point(|other| other[0] < vertex);
            let at = uv[vertex as usize];
            let (onwards, back) = (uv[after as usize] - at, uv[before[n][1] as usize] - at);
            let angle = onwards.perp(&back).atan2(onwards.dot(&back)).rem_euclid(std::f64::consts::TAU);
            let way = nalgebra::Rotation2::new(0.5 * angle) * onwards;
            ways[vertex as usize] = way.try_normalize(0.0).unwrap_or_default() * (0.5 * self.gaps[edge]);
        }
        ways
    }

    /// Returns the number of boundary vertices that lie on another edge or vertex.
    pub fn touches(&self, uv: &[Place]) -> usize {
        self.contacts(uv).iter().filter(|contact| !contact.push()[0].is_finite()).count()
    }

    pub fn crossings(&self, uv: &[Place], control: &Control) -> Result<usize> {
        let place = |end: Place| Coord { x: end.x, y: end.y };
        let segments: Vec<_> = (0..self.edges.len()).map(|edge| self.ends(edge, uv).map(place)).collect();
        count_crossings(&segments, control)
    }

    fn contacts(&self, uv: &[Place]) -> Vec<Contact> {
        let mut contacts = Vec::new();
        self.visit_near(
            |edge| Bounds::of(&self.ends(edge, uv), self.gaps[edge]),
            |first, edge| {
                let ([p, _], [a, b]) = (self.ends(first, uv), self.ends(edge, uv));
                let along = ((p - a).dot(&(b - a)) / (b - a).norm_squared()).clamp(0.0, 1.0);
                let apart = p - (a + (b - a) * along);
                let gap = self.gaps[first].min(self.gaps[edge]);
                if apart.norm_squared() < gap * gap {
                    contacts.push(Contact { vertex: self.edges[first][0], edge: self.edges[edge], along, apart, gap });
                }
            },
        );
        contacts
    }

    /// Visits the pairs of edges whose boxes meet, if the first vertex of the first edge is not on the second.
    fn visit_near(&self, bounds: impl Fn(usize) -> Bounds, mut visit: impl FnMut(usize, usize)) {
        let tree = Tree::over((0..self.edges.len()).map(bounds).collect());
        for (position, &first) in tree.order.iter().enumerate() {
            let vertex = self.edges[first as usize][0];
            tree.any_other(position, &mut |edge| {
                if !self.edges[edge as usize].contains(&vertex) {
                    visit(first as usize, edge as usize);
                }
                false
            });
        }
    }
}

/// Returns when a moving point first meets a moving segment, if ever. `at` are the point and the segment's ends.
fn meeting(at: [Place; 3], way: [Place; 3]) -> f64 {
    let [p0, b0] = [at[0] - at[1], at[2] - at[1]];
    let [p1, b1] = [way[0] - way[1], way[2] - way[1]];
    let meets = |time: f64| {
        let (p, b) = (p0 + p1 * time, b0 + b1 * time);
        let along = p.dot(&b) / b.norm_squared();
        time > 0.0 && (-BESIDE..=1.0 + BESIDE).contains(&along)
    };
    // the point is on the line of the segment where p × b = 0, quadratic in time
    let times = roots(b1.perp(&p1), b0.perp(&p1) + b1.perp(&p0), b0.perp(&p0));
    times.into_iter().filter(|&time| meets(time)).fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::mesh::shapes;

    #[test]
    fn gaps_are_half_the_least_height_of_the_triangles_there() {
        let sheet = shapes::surface(shapes::sheet(3, 3));
        let thin =
            sheet.moved(sheet.points().iter().map(|p| [p.x, if p.y < 1.0 { 0.9 } else { p.y }, 0.0].into()).collect());
        let thin = thin.unwrap();
        assert!(Outline::new(&sheet).gaps.iter().all(|gap| (gap - 0.5 * 0.5f64.sqrt()).abs() < 1e-12));
        let least = 0.1 / 1.01f64.sqrt(); // of the triangles with sides of 1, 0.1 and their diagonal
        let outline = Outline::new(&thin);
        for (edge, gap) in outline.edges.iter().zip(&outline.gaps) {
            let is_thin = edge.iter().any(|&vertex| thin.points()[vertex as usize].y <= 1.0);
            assert!((gap - 0.5 * if is_thin { least } else { 0.5f64.sqrt() }).abs() < 1e-12, "{edge:?} {gap}");
        }
    }
}
