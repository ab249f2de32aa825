//! One-to-one maps of closed surfaces without handles onto the unit sphere.
//!
//! From coarse to fine (Praun, Hoppe 2003): the surface is decimated to a tetrahedron, which is mapped to a regular
//! one. Its vertices are then re-inserted in reverse order, each into the kernel of the spherical polygon of its
//! neighbours, from which all of it is visible. On every level, vertices move one after the other to where the
//! distortion of the triangles around them is smallest. No step flips a triangle, so that the map remains one to one:
//! with all triangles counterclockwise as seen from outside, their areas sum to 4π.
//!
//! Distortion is the symmetric Dirichlet energy (Smith, Schaefer 2015), ½ Σ cot |e|² · (1 + 1/d²) over triangles, where
//! d is the determinant of the corners divided by twice the surface's area. For small triangles, this is the ratio of
//! areas. It becomes zero, and the energy infinite, where a triangle is about to flip.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap, HashSet};

use nalgebra::{Matrix2, Vector2, Vector3};

use crate::adjacency::Groups;
use crate::error::check_points;
use crate::surface::decimate::{self, Decimation, decimate};
use crate::surface::mesh::{BORDER, next};
use crate::surface::{Surface, cuts::holes::fill_holes, topology::Topology};
use crate::{Control, Error, Result};

/// The ratio of the numbers of vertices of successive levels; and the number of vertices below which space gets narrow.
const FALL: f64 = 2.0;
const SMALL_FALL: f64 = 1.25;
const SMALL: usize = 1000;

/// The number of vertices below which decimation only preserves topology.
const COARSE: usize = 200;

/// The number of vertices of the tetrahedron.
const LEAST: usize = 4;

/// The maximum number of sweeps over the vertices of a level, and of the finest level.
const SWEEPS: usize = 60;
const LAST_SWEEPS: usize = 20;

/// A sweep with a smaller relative decrease in energy is the last one of its level.
const GAIN: f64 = 1e-4;

/// The minimum area of a triangle relative to an equilateral one on its longest edge, which thinner ones get.
const THINNEST: f64 = 0.05;

/// No determinant falls below this share of itself in one step.
const LEAST_LEFT: f64 = 0.1;

/// Returns the vertices' positions on the unit sphere: triangles run counterclockwise from outside, and cover it once.
///
/// The rotation is arbitrary; the result for a surface is deterministic, bit by bit.
///
/// # Errors
/// [`Error::NotASphere`] if the surface is not closed, not connected, or has handles; [`Error::Folded`] if triangles
/// are too thin for their areas to differ from zero; and [`Error::Cancelled`].
pub fn spherical_map(surface: &Surface, control: &Control) -> Result<Vec<Vector3<f64>>> {
    let closed = closed(surface, control)?;
    let levels = levels(&closed, control)?;
    let mut places = map_of_level(&closed, &levels, 0, control)?;
    places.truncate(surface.len());
    Ok(places)
}

/// Returns the map of a level by way of all coarser ones: of the surface (level 0), or of the n-th decimation.
pub(crate) fn map_of_level(
    surface: &Surface, levels: &[Decimation], depth: usize, control: &Control,
) -> Result<Vec<Vector3<f64>>> {
    let coarsest = levels.last().map_or(surface, |level| &level.surface);
    let mut places = tetrahedron(coarsest);
    for n in (depth..levels.len()).rev() {
        let finer = if n == 0 { surface } else { &levels[n - 1].surface };
        places = refined(&levels[n], finer, &places, false, control)?;
        let sweeps = if n == 0 { LAST_SWEEPS } else { SWEEPS };
        control.begin("mapping the surface to a sphere", sweeps as u64);
        Metric::new(finer).relax(finer, &mut places, sweeps, |_| true, control)?;
    }
    Ok(places)
}

/// Returns the number of triangles that are flipped or have no area on the sphere, which is 0 if the map is one to one.
///
/// # Errors
/// [`Error::NoSuchPoint`] if a corner has no position.
pub fn flipped(faces: &[[u32; 3]], places: &[Vector3<f64>]) -> Result<usize> {
    check_points(faces.iter().flatten().copied(), places.len())?;
    Ok(turned_over(faces, places))
}

/// Returns the number of [`flipped`] triangles of valid faces.
pub(crate) fn turned_over(faces: &[[u32; 3]], places: &[Vector3<f64>]) -> usize {
    faces.iter().filter(|face| determinant(face.map(|v| places[v as usize])) <= 0.0).count()
}

pub(crate) fn determinant([a, b, c]: [Vector3<f64>; 3]) -> f64 {
    (b - a).cross(&(c - a)).dot(&a) // the same as a · (b × c), with smaller terms
}

/// Returns the surface with its holes closed; its own vertices come first.
///
/// Holes are filled by triangles of minimal area. Holes with too many edges for this, such as opened cuts, are closed
/// ear by ear, the narrowest first, which joins the two sides of cuts, or else by a fan around their centre.
pub(crate) fn closed(surface: &Surface, control: &Control) -> Result<Surface> {
    let loops = Topology::of(surface).loops;
    if loops.is_empty() {
        check_closed(surface)?;
        return Ok(surface.clone());
    }
    let filled = fill_holes(surface, &loops, control)?;
    let mut points = filled.surface.points().to_vec();
    let mut faces = filled.surface.faces().to_vec();
    let edge = |a: u32, b: u32| (a.min(b), a.max(b));
    let mut edges: HashSet<(u32, u32)> = match filled.left.is_empty() {
        true => HashSet::new(),
        false => filled.surface.edges().map(|h| edge(filled.surface.origin(h), filled.surface.target(h))).collect(),
    };
    for &n in &filled.left {
        control.check()?;
        let around = loops[n].vertices(surface);
        let mut left = ears(&around, surface, &mut edges, &mut faces);
        if left.len() == 3 {
            faces.push([left[2], left[1], left[0]]);
            left.clear();
        }
        if !left.is_empty() {
            let centre = left.iter().map(|&v| surface.points()[v as usize]).sum::<Vector3<f64>>() / left.len() as f64;
            let ends = left.iter().cycle().skip(1);
            faces.extend(left.iter().zip(ends).map(|(&a, &b)| [b, a, points.len() as u32]));
            points.push(centre);
        }
    }
    let closed = joined(&filled.surface, &points, &faces);
    check_closed(&closed)?;
    Ok(closed)
}

/// Returns a surface with additional points and faces, which may have no area, joined to it and to each other.
fn joined(surface: &Surface, points: &[Vector3<f64>], faces: &[[u32; 3]]) -> Surface {
    let mut twins = surface.twins().to_vec();
    twins.resize(3 * faces.len(), BORDER);
    let ends = |h: u32| [h, next(h)].map(|h| faces.as_flattened()[h as usize]);
    let open: Vec<u32> = (0..twins.len() as u32).filter(|&h| twins[h as usize] == BORDER).collect();
    let by_ends: HashMap<[u32; 2], u32> = open.iter().map(|&h| (ends(h), h)).collect();
    for h in open {
        let [a, b] = ends(h);
        twins[h as usize] = by_ends.get(&[b, a]).copied().unwrap_or(BORDER);
    }
    Surface::assemble(points, &(0..points.len() as u32).collect::<Vec<_>>(), faces, twins)
}

/// Clips ears off a boundary loop, the narrowest first, and returns the rest of the loop.
fn ears(around: &[u32], surface: &Surface, edges: &mut HashSet<(u32, u32)>, faces: &mut Vec<[u32; 3]>) -> Vec<u32> {
    let count = around.len();
    let mut following: Vec<usize> = (0..count).map(|n| (n + 1) % count).collect();
    let mut previous: Vec<usize> = (0..count).map(|n| (n + count - 1) % count).collect();
    let width = |a: usize, c: usize| {
        let [a, c] = [a, c].map(|n| surface.points()[around[n] as usize]);
        (a - c).norm_squared().to_bits() // positive floats sort as their bits
    };
    let mut queue: BinaryHeap<Reverse<(u64, usize)>> =
        (0..count).map(|n| Reverse((width(previous[n], following[n]), n))).collect();
    let (mut is_clipped, mut left) = (vec![false; count], count);
    while left > 3
        && let Some(Reverse((wide, n))) = queue.pop()
    {
        let (a, c) = (previous[n], following[n]);
        let ends = (around[a].min(around[c]), around[a].max(around[c]));
        if is_clipped[n] || wide != width(a, c) || edges.contains(&ends) {
            continue;
        }
        edges.insert(ends);
        faces.push([around[c], around[n], around[a]]);
        (is_clipped[n], following[a], previous[c]) = (true, c, a);
        left -= 1;
        [a, c].iter().for_each(|&m| queue.push(Reverse((width(previous[m], following[m]), m))));
    }
    (0..count).filter(|&n| !is_clipped[n]).map(|n| around[n]).collect()
}

pub(crate) fn check_closed(surface: &Surface) -> Result<()> {
    let topology = Topology::of(surface);
    let (components, loops, handles) = (topology.components.len(), topology.loops.len(), topology.genus);
    let is_sphere = components == 1 && loops == 0 && handles == 0;
    if is_sphere { Ok(()) } else { Err(Error::NotASphere { components, loops, handles }) }
}

/// Returns coarser and coarser surfaces, the last one a tetrahedron.
pub(crate) fn levels(surface: &Surface, control: &Control) -> Result<Vec<Decimation>> {
    let mut levels: Vec<Decimation> = Vec::new();
    loop {
        let finer = levels.last().map_or(surface, |level| &level.surface);
        if finer.len() == LEAST {
            return Ok(levels);
        }
        let fall = if finer.len() > SMALL { FALL } else { SMALL_FALL };
        let vertices = ((finer.len() as f64 / fall) as usize).max(LEAST);
        let options = decimate::Options { vertices, any_shape: vertices < COARSE, ..Default::default() };
        let mut level = decimate(finer, &[], &options, control)?;
        if 2 * level.survivors.len() > finer.len() + vertices {
            level = decimate(finer, &[], &decimate::Options { any_shape: true, ..options }, control)?;
        }
        if level.survivors.len() == finer.len() {
            return Err(Error::Folded { triangles: finer.faces().len() });
        }
        levels.push(level);
    }
}

/// Returns the corners of a regular tetrahedron such that the faces run counterclockwise.
fn tetrahedron(surface: &Surface) -> Vec<Vector3<f64>> {
    let corners = [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]];
    let mut places: Vec<Vector3<f64>> = corners.iter().map(|&c| Vector3::from(c).normalize()).collect();
    if turned_over(surface.faces(), &places) > 0 {
        places.swap(0, 1);
    }
    places
}

/// Returns the positions of a finer surface's vertices, given those of a coarser one: in the middle of their permitted
/// region, or, with `follow`, as close as possible to where they lie between their neighbours on the surface.
pub(crate) fn refined(
    level: &Decimation, finer: &Surface, places: &[Vector3<f64>], follow: bool, control: &Control,
) -> Result<Vec<Vector3<f64>>> {
    let mut found = vec![Vector3::zeros(); finer.len()];
    level.survivors.iter().zip(places).for_each(|(&vertex, &place)| found[vertex as usize] = place);
    let mut ring = Vec::new();
    for (n, removal) in level.removals.iter().rev().enumerate() {
        if n % 512 == 0 {
            control.check()?;
        }
        ring.clear();
        ring.extend(removal.neighbours.iter().map(|&v| found[v as usize]));
        let centre = kernel_centre(&ring).ok_or(Error::Folded { triangles: ring.len() })?;
        found[removal.vertex as usize] = if follow {
            let wish: Vector3<f64> = ring.iter().zip(removal.weights).map(|(place, weight)| place * weight[0]).sum();
            sees_all(&ring, centre, wish)
        } else {
            centre
        };
    }
    let triangles = turned_over(finer.faces(), &found);
    if triangles > 0 { Err(Error::Folded { triangles }) } else { Ok(found) }
}

/// Returns a position in the middle of those from which all of a counterclockwise spherical polygon is visible, if any.
///
/// In a projection from the sphere's centre onto a tangent plane, great circles are lines, and the kernel is a convex
/// polygon. It is found by clipping a large square along the sides. The plane touches at the middle of the polygon, or,
/// if the polygon is too large for that, at a corner from which all of it is visible: one exists, from which the
/// coarser surface's triangles fan out.
pub(crate) fn kernel_centre(ring: &[Vector3<f64>]) -> Option<Vector3<f64>> {
    let sides: Vec<Vector3<f64>> =
        (0..ring.len()).map(|k| ring[k].cross(&(ring[(k + 1) % ring.len()] - ring[k]))).collect();
    let middle = ring.iter().sum::<Vector3<f64>>().try_normalize(0.0);
    // gnomonic projection: lines are great circles only on the half of the sphere that the plane faces
    let (up, size) = match middle.filter(|middle| ring.iter().all(|p| p.dot(middle) > 0.2)) {
        // as large as the polygon, so that no digits are lost
        Some(middle) => (middle, 6.0 * ring.iter().map(|p| (p - middle).norm()).fold(0.0, f64::max)),
        None => {
            let of = |k: usize| move |n: usize| ring[(k + n) % ring.len()];
            let sees_all = |k: &usize| (1..ring.len() - 1).all(|n| determinant([0, n, n + 1].map(of(*k))) > 0.0);
            (ring[(0..ring.len()).find(sees_all)?], 50.0)
        }
    };
    let [east, north] = tangents(up);
    let mut kernel: Vec<Vector2<f64>> =
        [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(|c| Vector2::from(c) * size).into();
    let mut cut = Vec::new();
    for side in sides {
        // side · (up + x east + y north) ≥ 0 is a half-plane in (x, y)
        let line = Vector2::new(side.dot(&east), side.dot(&north));
        let height = |p: &Vector2<f64>| line.dot(p) + side.dot(&up);
        cut.clear();
        for k in 0..kernel.len() {
            let [a, b] = [kernel[k], kernel[(k + 1) % kernel.len()]];
            let [at_a, at_b] = [height(&a), height(&b)];
            if at_a >= 0.0 {
                cut.push(a);
            }
            if (at_a >= 0.0) != (at_b >= 0.0) {
                cut.push(a + (b - a) * (at_a / (at_a - at_b)));
            }
        }
        std::mem::swap(&mut kernel, &mut cut);
    }
    if kernel.len() < 3 {
        return None;
    }
    let (mut sum, mut area) = (Vector2::zeros(), 0.0);
    for k in 1..kernel.len() - 1 {
        let [a, b, c] = [kernel[0], kernel[k], kernel[k + 1]];
        let part = (b - a).perp(&(c - a));
        sum += (a + b + c) * (part / 3.0);
        area += part;
    }
    let centre = if area > 0.0 { sum / area } else { kernel.iter().sum::<Vector2<f64>>() / kernel.len() as f64 };
    let place = (up + east * centre.x + north * centre.y).normalize();
    let is_inside = (0..ring.len()).all(|k| determinant([place, ring[k], ring[(k + 1) % ring.len()]]) > 0.0);
    is_inside.then_some(place)
}

/// Returns the position closest to a wish, on a line from the kernel's centre, that sees the polygon well.
fn sees_all(ring: &[Vector3<f64>], centre: Vector3<f64>, wish: Vector3<f64>) -> Vector3<f64> {
    let sides = |p: Vector3<f64>| (0..ring.len()).map(move |k| determinant([p, ring[k], ring[(k + 1) % ring.len()]]));
    let towards = |share: f64| (centre + (wish - centre) * share).normalize();
    let is_good = |share: &f64| sides(towards(*share)).zip(sides(centre)).all(|(now, then)| now > 0.1 * then);
    [1.0, 0.7, 0.5, 0.3, 0.1].into_iter().find(is_good).map_or(centre, towards)
}

/// Returns two unit vectors perpendicular to a third and to each other, counterclockwise around it.
pub(crate) fn tangents(up: Vector3<f64>) -> [Vector3<f64>; 2] {
    let axis = if up.x.abs() < 0.6 { Vector3::x() } else { Vector3::y() };
    let east = axis.cross(&up).normalize();
    [east, up.cross(&east)]
}

/// The reference for distortion: for each triangle, the cotangents of its angles and twice its area, with the total
/// area scaled to 4π; and the corners around each vertex.
#[derive(Debug, Clone)]
pub(crate) struct Metric {
    cotangents: Vec<[f64; 3]>,
    doubles: Vec<f64>,
    around: Groups,
}

impl Metric {
    pub(crate) fn new(surface: &Surface) -> Self {
        let total: f64 = surface.areas().iter().sum();
        let scale = 4.0 * std::f64::consts::PI / total;
        let least = 1e-9 * total / surface.faces().len() as f64; // the minimum for triangles without area
        let (mut cotangents, mut doubles) = (Vec::new(), Vec::new());
        for face in surface.faces() {
            let [a, b, c] = face.map(|v| surface.points()[v as usize]);
            let squares = [(c - b).norm_squared(), (a - c).norm_squared(), (b - a).norm_squared()];
            let longest = squares.iter().copied().fold(least, f64::max);
            let double = (b - a).cross(&(c - a)).norm().max(THINNEST * 3f64.sqrt() / 2.0 * longest);
            let [x, y, z] = squares;
            // cot α = (b² + c² − a²)/(4 A)
            cotangents.push([y + z - x, z + x - y, x + y - z].map(|w| w / (2.0 * double)));
            doubles.push(double * scale);
        }
        let around = Groups::new(surface.len(), surface.faces().as_flattened().iter().copied());
        Self { cotangents, doubles, around }
    }

    pub(crate) fn corners(&self, vertex: usize) -> &[u32] {
        self.around.of(vertex as u32)
    }

    /// Moves a vertex towards a position, as far as no triangle around it is nearly flipped.
    pub(crate) fn shift(&self, surface: &Surface, vertex: usize, to: Vector3<f64>, places: &mut [Vector3<f64>]) {
        let from = places[vertex];
        let normal = |corner: u32| {
            let (face, k) = (corner as usize / 3, corner as usize % 3);
            let [b, c] = [1, 2].map(|n| places[surface.faces()[face][(k + n) % 3] as usize]);
            b.cross(&(c - b))
        };
        let is_sound = |place: &Vector3<f64>| {
            self.corners(vertex).iter().all(|&corner| {
                let m = normal(corner);
                m.dot(place) > LEAST_LEFT * m.dot(&from)
            })
        };
        let on_the_way = [1.0, 0.5, 0.2].map(|share| (from + (to - from) * share).normalize());
        if let Some(&place) = on_the_way.iter().find(|place| is_sound(place)) {
            places[vertex] = place;
        }
    }

    /// Sweeps over all vertices until the energy hardly decreases.
    pub(crate) fn relax(
        &self, surface: &Surface, places: &mut [Vector3<f64>], sweeps: usize, may_move: impl Fn(usize) -> bool,
        control: &Control,
    ) -> Result<()> {
        let mut ring = Vec::new();
        let mut before = f64::INFINITY;
        for _ in 0..sweeps {
            let mut energy = 0.0;
            for vertex in 0..places.len() {
                if vertex % 4096 == 0 {
                    control.check()?;
                }
                if may_move(vertex) {
                    energy += self.ease(surface, vertex, places, &mut ring);
                }
            }
            control.advance();
            if before - energy < GAIN * energy {
                break;
            }
            before = energy;
        }
        Ok(())
    }

    /// Moves a vertex by a Newton step that reduces the energy of its triangles; returns their previous energy.
    pub(crate) fn ease(
        &self, surface: &Surface, vertex: usize, places: &mut [Vector3<f64>], ring: &mut Vec<Term>,
    ) -> f64 {
        ring.clear();
        for &corner in self.corners(vertex) {
            let (face, k) = (corner as usize / 3, corner as usize % 3);
            let [b, c] = [1, 2].map(|n| places[surface.faces()[face][(k + n) % 3] as usize]);
            let [x, y, z] = [0, 1, 2].map(|n| self.cotangents[face][(k + n) % 3]);
            ring.push(Term::new(b, c, [x, y, z], self.doubles[face]));
        }
        let at = places[vertex];
        let energy = |p: &Vector3<f64>| ring.iter().map(|term| term.energy(p)).sum::<f64>();
        let before = energy(&at);
        let [east, north] = tangents(at);
        let (mut gradient, mut hessian, mut along) = (Vector2::zeros(), Matrix2::zeros(), 0.0);
        for term in ring.iter() {
            let slopes = term.slopes(&at);
            let g = Vector2::new(term.g.dot(&east), term.g.dot(&north));
            let m = Vector2::new(term.m.dot(&east), term.m.dot(&north));
            gradient += g * slopes.g + m * slopes.m;
            along += term.g.dot(&at) * slopes.g + term.m.dot(&at) * slopes.m;
            hessian += (g * m.transpose() + m * g.transpose()) * slopes.gm + m * m.transpose() * slopes.mm;
        }
        // the sphere bends away from its tangent: x(t) ≈ x + t v − ½ t² |v|² x, so the slope along x counts too
        hessian -= Matrix2::identity() * along;
        let step = downhill(&hessian, &gradient);
        let mut size = 1.0;
        for _ in 0..12 {
            let moved = (at + (east * step.x + north * step.y) * size).normalize();
            let is_sound = ring.iter().all(|term| term.m.dot(&moved) > LEAST_LEFT * term.m.dot(&at));
            if is_sound && energy(&moved) < before {
                places[vertex] = moved;
                break;
            }
            size *= 0.4;
        }
        before
    }
}

/// The energy of a triangle as a function of the position x of one corner: (k − x·g) (1 + s / (x·m)²).
pub(crate) struct Term {
    k: f64,
    g: Vector3<f64>,
    m: Vector3<f64>,
    s: f64,
}

/// Factors of its derivatives.
struct Slopes {
    g: f64,
    m: f64,
    gm: f64,
    mm: f64,
}

impl Term {
    fn new(b: Vector3<f64>, c: Vector3<f64>, [x, y, z]: [f64; 3], double: f64) -> Self {
        // |c − x|² = 2 − 2 c·x on the unit sphere, so that ½ Σ cot |e|² is linear in x
        Self { k: 0.5 * x * (c - b).norm_squared() + y + z, g: c * y + b * z, m: b.cross(&(c - b)), s: double * double }
    }

    fn energy(&self, x: &Vector3<f64>) -> f64 {
        (self.k - x.dot(&self.g)) * (1.0 + self.s / x.dot(&self.m).powi(2))
    }

    fn slopes(&self, x: &Vector3<f64>) -> Slopes {
        let (f, d) = (self.k - x.dot(&self.g), x.dot(&self.m));
        // product rule on (k − x·g)(1 + s/d²), d = x·m
        let part = self.s / (d * d);
        Slopes { g: -(1.0 + part), m: -2.0 * f * part / d, gm: 2.0 * part / d, mm: 6.0 * f * part / (d * d) }
    }
}

/// Returns the Newton step with a Hessian that is made positive.
fn downhill(hessian: &Matrix2<f64>, gradient: &Vector2<f64>) -> Vector2<f64> {
    let eigen = hessian.symmetric_eigen();
    let largest = eigen.eigenvalues.abs().max();
    if !(largest > 0.0 && largest.is_finite()) {
        return Vector2::zeros();
    }
    let q = eigen.eigenvectors;
    let components = q.transpose() * gradient;
    // magnitudes of eigenvalues, at least a millionth of the largest: a descent direction at saddles too
    let scaled = Vector2::from_fn(|n, _| -components[n] / eigen.eigenvalues[n].abs().max(1e-6 * largest));
    q * scaled
}
