//! Surfels: the faces between foreground and background voxels, glued along their edges into closed surfaces.
//!
//! Four surfels meet at a voxel edge where the two foreground voxels around it touch only along that edge. How they are
//! paired determines the surface there (`Touching`). Corners are only united across glued edges, so the result is
//! always a closed, oriented, abstract surface: χ = corners − surfels.

use crate::surface::mesh::BORDER;
use crate::surface::voxels::{DIRECT, VertexGrid, VoxelSurface};
use crate::volume::Mask;
use crate::{Control, Error, Result};

/// How foreground voxels that touch only along an edge are connected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Touching {
    /// They are not connected, so that touching banks of a fold stay apart.
    Apart,
    /// They are connected, so that a thin slanted sheet holds together.
    Joined,
}

/// The surfels of a label volume. Surfel `s` has four edges `4 s + q`, which run counterclockwise as seen from outside.
/// Corner `4 s + q` lies between the edges `q` and `q + 1`.
#[derive(Debug, Clone)]
pub(crate) struct Surfels {
    /// The voxel of each surfel, as an index into the surface voxels.
    voxel: Vec<u32>,
    /// The direction that it faces, as an index into the six direct ones.
    direction: Vec<u8>,
    /// The edge to which each edge is glued.
    glue: Vec<u32>,
    /// The first surfel of each voxel, and the end of the last one's.
    first: Vec<u32>,
}

/// Returns the directions of a surfel's four edges, counterclockwise as seen from outside.
fn edges_of(direction: usize) -> [usize; 4] {
    let axis = DIRECT[direction].iter().position(|&x| x != 0).expect("a direction is along an axis");
    let towards = |axis: usize, sign: i64| {
        DIRECT.iter().position(|d| d[axis % 3] == sign).expect("both directions of an axis exist")
    };
    if DIRECT[direction][axis] > 0 {
        [towards(axis + 1, 1), towards(axis + 2, 1), towards(axis + 1, -1), towards(axis + 2, -1)]
    } else {
        [towards(axis + 2, 1), towards(axis + 1, 1), towards(axis + 2, -1), towards(axis + 1, -1)]
    }
}

const fn opposite(direction: usize) -> usize {
    5 - direction
}

/// Returns a later edge or corner of the same surfel, counterclockwise.
const fn turn(edge: u32, by: u32) -> u32 {
    edge - edge % 4 + (edge + by) % 4
}

impl Surfels {
    /// Creates the surfels of the mask's surface voxels.
    pub(crate) fn new(mask: &Mask, surface: &VoxelSurface, touching: Touching, control: &Control) -> Result<Self> {
        let most = (u32::MAX / 32) as usize;
        if surface.len() > most {
            return Err(Error::GraphTooLarge { points: surface.len(), most });
        }
        let mut surfels = Self { voxel: Vec::new(), direction: Vec::new(), glue: Vec::new(), first: Vec::new() };
        let mut open = Vec::with_capacity(surface.len()); // the directions in which each voxel has a surfel, as bits
        for (v, voxel) in surface.voxels().iter().enumerate() {
            surfels.first.push(surfels.voxel.len() as u32);
            let mut bits = 0u8;
            for (d, &step) in DIRECT.iter().enumerate() {
                if !mask.is_inside(moved(voxel.map(i64::from), step)) {
                    bits |= 1 << d;
                    surfels.voxel.push(v as u32);
                    surfels.direction.push(d as u8);
                }
            }
            open.push(bits);
        }
        surfels.first.push(surfels.voxel.len() as u32);
        control.check()?;
        let grid = VertexGrid::new(surface);
        let edges: [[usize; 4]; 6] = std::array::from_fn(edges_of);
        let slot = |d: usize, t: usize| edges[d].iter().position(|&e| e == t).expect("an edge of this surfel") as u32;
        let first = &surfels.first;
        // the edge towards t of the surfel of voxel v that faces direction d
        let edge = |v: u32, d: usize, t: usize| {
            let before = open[v as usize] & ((1 << d) - 1);
            4 * (first[v as usize] + before.count_ones()) + slot(d, t)
        };
        for s in 0..surfels.voxel.len() {
            if s % (1 << 14) == 0 {
                control.check()?;
            }
            let (v, d) = (surfels.voxel[s], usize::from(surfels.direction[s]));
            let place = surface.voxels()[v as usize].map(i64::from);
            for &t in &edges[d] {
                let beside = moved(place, DIRECT[t]);
                let ahead = moved(beside, DIRECT[d]);
                let vertex = |voxel: [i64; 3]| grid.cells()[grid.cell(voxel)];
                surfels.glue.push(match (mask.is_inside(beside), mask.is_inside(ahead)) {
                    (true, false) => edge(vertex(beside), d, opposite(t)),
                    (true, true) => edge(vertex(ahead), opposite(t), opposite(d)),
                    (false, true) if touching == Touching::Joined => edge(vertex(ahead), opposite(t), opposite(d)),
                    (false, _) => edge(v, t, d),
                });
            }
        }
        Ok(surfels)
    }

    /// Returns the number of surfels.
    pub(crate) fn len(&self) -> usize {
        self.voxel.len()
    }

    /// Returns the surface voxel of a surfel.
    pub(crate) fn voxel(&self, surfel: u32) -> u32 {
        self.voxel[surfel as usize]
    }

    /// Returns the direction that a surfel faces.
    pub(crate) fn direction(&self, surfel: u32) -> [i64; 3] {
        DIRECT[usize::from(self.direction[surfel as usize])]
    }

    /// Returns the surfels of a surface voxel.
    pub(crate) fn of_voxel(&self, voxel: u32) -> std::ops::Range<u32> {
        self.first[voxel as usize]..self.first[voxel as usize + 1]
    }

    /// Returns the neighbour across each of a surfel's edges; `None` at the boundary.
    pub(crate) fn neighbours(&self, surfel: u32) -> [Option<u32>; 4] {
        std::array::from_fn(|q| match self.glue[4 * surfel as usize + q] {
            BORDER => None,
            edge => Some(edge / 4),
        })
    }

    /// Returns the surfels for which `keep` is true; the surface ends where they do.
    /// Panics if the number of values differs from the number of surfels.
    pub(crate) fn restricted(&self, keep: &[bool]) -> Self {
        assert_eq!(keep.len(), self.len(), "one value per surfel");
        let kept: Vec<u32> = (0..keep.len() as u32).filter(|&s| keep[s as usize]).collect();
        let mut number = vec![BORDER; keep.len()];
        kept.iter().enumerate().for_each(|(n, &s)| number[s as usize] = n as u32);
        let renamed = |edge: u32| match self.glue[edge as usize] {
            BORDER => BORDER,
            other if number[other as usize / 4] == BORDER => BORDER,
            other => 4 * number[other as usize / 4] + other % 4,
        };
        Self {
            voxel: kept.iter().map(|&s| self.voxel[s as usize]).collect(),
            direction: kept.iter().map(|&s| self.direction[s as usize]).collect(),
            glue: kept.iter().flat_map(|&s| 4 * s..4 * s + 4).map(renamed).collect(),
            first: self.first.iter().map(|&first| kept.partition_point(|&s| s < first) as u32).collect(),
        }
    }

    /// Returns the next corner around the same point, counterclockwise: in the surfel across the edge that ends there.
    fn around(&self, corner: u32) -> Option<u32> {
        match self.glue[corner as usize] {
            BORDER => None,
            edge => Some(turn(edge, 3)),
        }
    }

    /// Calls `visit` with the surfels around each inner point of the surface, counterclockwise.
    pub(crate) fn around_points(&self, mut visit: impl FnMut(&[u32])) {
        let mut seen = vec![false; self.glue.len()];
        let mut ring = Vec::new();
        for start in 0..self.glue.len() as u32 {
            if seen[start as usize] {
                continue;
            }
            ring.clear();
            let mut corner = start;
            let is_closed = loop {
                seen[corner as usize] = true;
                ring.push(corner / 4);
                match self.around(corner) {
                    None => break false, // the corners before `start` come later, and end here too
                    Some(next) if next == start => break true,
                    Some(next) if seen[next as usize] => break false,
                    Some(next) => corner = next,
                }
            };
            if is_closed {
                visit(&ring);
            }
        }
    }

    /// Returns the Euler characteristic of the glued surface, if it is closed.
    pub(crate) fn euler(&self) -> i64 {
        let mut corners = 0;
        self.around_points(|_| corners += 1);
        corners - self.len() as i64
    }
}

pub(crate) fn moved(a: [i64; 3], b: [i64; 3]) -> [i64; 3] {
    std::array::from_fn(|axis| a[axis] + b[axis])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::{masks, voxels};
    use proptest::prelude::*;

    fn surfels_of(mask: &Mask, touching: Touching) -> (VoxelSurface, Surfels) {
        let surface = voxels(mask, [1.0; 3]);
        let surfels = Surfels::new(mask, &surface, touching, &Control::default()).unwrap();
        (surface, surfels)
    }

    /// Returns the ends of an edge in doubled coordinates, from corner q − 1 to corner q.
    fn ends(surface: &VoxelSurface, surfels: &Surfels, edge: u32) -> [[i64; 3]; 2] {
        let s = edge / 4;
        let d = usize::from(surfels.direction[s as usize]);
        let centre = moved(surface.voxels()[surfels.voxel(s) as usize].map(|x| 2 * i64::from(x)), DIRECT[d]);
        let corner = |q: u32| {
            let (t, u) = (edges_of(d)[q as usize % 4], edges_of(d)[(q as usize + 1) % 4]);
            moved(moved(centre, DIRECT[t]), DIRECT[u])
        };
        [corner((edge + 3) % 4), corner(edge % 4)]
    }

    #[test]
    fn a_voxel_is_a_cube() {
        let (_, surfels) = surfels_of(&Mask::new([1, 1, 1], vec![true]).unwrap(), Touching::Apart);
        assert_eq!((surfels.len(), surfels.euler()), (6, 2));
    }

    #[test]
    fn two_voxels_that_touch_along_an_edge() {
        let mask = Mask::new([2, 2, 1], vec![true, false, false, true]).unwrap();
        assert_eq!(surfels_of(&mask, Touching::Apart).1.euler(), 4); // two cubes
        assert_eq!(surfels_of(&mask, Touching::Joined).1.euler(), 2);
    }

    proptest! {
        #[test]
        fn edges_are_glued_in_pairs_that_lie_on_each_other(mask in masks([4; 3], 0.2..0.8)) {
            for touching in [Touching::Apart, Touching::Joined] {
                let (surface, surfels) = surfels_of(&mask, touching);
                for edge in 0..surfels.glue.len() as u32 {
                    let other = surfels.glue[edge as usize];
                    prop_assert_eq!(surfels.glue[other as usize], edge);
                    prop_assert!(other != edge);
                    let [a, b] = ends(&surface, &surfels, edge);
                    prop_assert_eq!(ends(&surface, &surfels, other), [b, a]); // the other way: both see the same outside
                }
                let mut around = 0;
                surfels.around_points(|ring| around += ring.len());
                prop_assert_eq!(around, 4 * surfels.len());
                prop_assert!(surfels.euler() % 2 == 0);
            }
        }
    }
}
