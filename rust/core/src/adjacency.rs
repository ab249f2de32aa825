//! Who is next to whom on a surface, and how far.

use crate::control::Control;
use crate::error::{Error, Result};
use crate::surface::voxels::{VertexGrid, VoxelSurface, neighbours};

/// A link to a neighbour.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arc {
    /// The neighbour.
    pub to: u32,
    /// Length of the link, in mm.
    pub length: f32,
}

/// A sparse symmetric graph with lengths: all that shortest paths need to know of a surface.
pub trait Links: Sync {
    /// Number of vertices.
    fn vertices(&self) -> usize;

    /// The links of a vertex, ordered by neighbour.
    fn arcs(&self, vertex: u32) -> impl Iterator<Item = Arc> + '_;

    /// Most links of a vertex.
    fn most_links(&self) -> usize;

    /// The lengths of the shortest and of the longest link, mm.
    fn extremes(&self) -> [f32; 2];

    /// The connected components.
    fn components(&self) -> Components {
        let mut labels = vec![u32::MAX; self.vertices()];
        let mut sizes = Vec::new();
        let mut stack = Vec::new();
        for start in 0..self.vertices() {
            if labels[start] != u32::MAX {
                continue;
            }
            let label = sizes.len() as u32;
            labels[start] = label;
            let mut size = 0;
            stack.push(start as u32);
            while let Some(vertex) = stack.pop() {
                size += 1;
                for arc in self.arcs(vertex) {
                    if labels[arc.to as usize] == u32::MAX {
                        labels[arc.to as usize] = label;
                        stack.push(arc.to);
                    }
                }
            }
            sizes.push(size);
        }
        Components { labels, sizes }
    }
}

/// An arc as it is stored: 29 bits for the neighbour, 3 for the kind of link. A row of distances is bound by memory, and
/// half the bytes an arc make it about half again as fast.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct PackedArc(u32);

const NEIGHBOUR_BITS: u32 = 29;
const NEIGHBOUR: u32 = (1 << NEIGHBOUR_BITS) - 1;

/// The paper's graph in compressed rows, whose links are of seven kinds, each of one length. A vertex's arcs are
/// ordered by neighbour.
#[derive(Debug, Clone)]
pub struct Graph {
    starts: Vec<u32>,
    arcs: Vec<PackedArc>,
    lengths: [f32; 8],
}

impl Graph {
    /// The 26-neighbour graph of surface voxels. `lengths[kind]` is a link's length in mm; the kind is the set of axes along
    /// which it steps (bit 0 for the first axis, bit 1 for the second, bit 2 for the third).
    ///
    /// # Errors
    /// [`Error::GraphTooLarge`], [`Error::Cancelled`].
    pub fn of_voxels(surface: &VoxelSurface, lengths: [f64; 8], control: &Control) -> Result<Self> {
        let most = (u32::MAX / 26).min(NEIGHBOUR) as usize;
        if surface.len() > most {
            return Err(Error::GraphTooLarge { points: surface.len(), most });
        }
        let lengths = lengths.map(|length| length as f32);
        let mut graph = Self { starts: Vec::with_capacity(surface.len() + 1), arcs: Vec::new(), lengths };
        if surface.is_empty() {
            graph.starts.push(0);
            return Ok(graph);
        }
        let grid = VertexGrid::new(surface);
        let links: Vec<(isize, u32)> = neighbours().map(|offset| (grid.step(offset), kind(offset))).collect();
        for (vertex, voxel) in surface.voxels().iter().enumerate() {
            if vertex % (1 << 16) == 0 {
                control.check()?;
            }
            let first = graph.arcs.len();
            graph.starts.push(first as u32);
            let cell = grid.cell(voxel.map(i64::from));
            let arc = |&(step, kind): &(isize, u32)| {
                let to = grid.cells()[cell.wrapping_add_signed(step)];
                (to != VertexGrid::NONE).then_some(PackedArc(kind << NEIGHBOUR_BITS | to))
            };
            graph.arcs.extend(links.iter().filter_map(arc));
            graph.arcs[first..].sort_unstable_by_key(|arc| arc.0 & NEIGHBOUR);
        }
        graph.starts.push(graph.arcs.len() as u32);
        graph.arcs.shrink_to_fit();
        Ok(graph)
    }

    /// Number of vertices.
    pub fn len(&self) -> usize {
        self.starts.len() - 1
    }

    /// Is there no vertex?
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of links, each counted from both of its ends.
    pub fn links(&self) -> usize {
        self.arcs.len()
    }

    /// Where each vertex's links begin, and the end of the last one's.
    pub fn starts(&self) -> &[u32] {
        &self.starts
    }
}

impl Links for Graph {
    fn vertices(&self) -> usize {
        self.len()
    }

    #[inline]
    fn arcs(&self, vertex: u32) -> impl Iterator<Item = Arc> + '_ {
        let range = self.starts[vertex as usize] as usize..self.starts[vertex as usize + 1] as usize;
        let unpack = |&PackedArc(bits): &PackedArc| Arc {
            to: bits & NEIGHBOUR,
            length: self.lengths[(bits >> NEIGHBOUR_BITS) as usize],
        };
        self.arcs[range].iter().map(unpack)
    }

    fn most_links(&self) -> usize {
        26
    }

    fn extremes(&self) -> [f32; 2] {
        let lengths = &self.lengths[1..]; // those of the kinds of links that a voxel can have
        let longest = lengths.iter().copied().fold(0.0, f32::max);
        [lengths.iter().copied().fold(longest, f32::min), longest]
    }
}

/// The axes along which a link steps, as bits.
fn kind(offset: [i64; 3]) -> u32 {
    (0..3).filter(|&axis| offset[axis] != 0).map(|axis| 1 << axis).sum()
}

/// The connected components of a graph.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Components {
    /// The component of each vertex, named in the order of their first vertices.
    pub labels: Vec<u32>,
    /// Number of vertices of each component.
    pub sizes: Vec<usize>,
}

impl Components {
    /// The component with the most vertices; of equal ones the first.
    pub fn largest(&self) -> Option<u32> {
        (0..self.sizes.len()).rev().max_by_key(|&c| self.sizes[c]).map(|c| c as u32)
    }

    /// The sizes, largest first, as text.
    pub fn describe(&self) -> String {
        let mut sizes = self.sizes.clone();
        sizes.sort_unstable_by(|a, b| b.cmp(a));
        let shown: Vec<String> = sizes.iter().take(5).map(usize::to_string).collect();
        if sizes.len() > 5 { format!("{}, ...", shown.join(", ")) } else { shown.join(", ") }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::{Affine, Mask};
    use proptest::prelude::*;

    fn graph_of(mask: &Mask) -> (VoxelSurface, Graph) {
        let control = Control::default();
        let surface = VoxelSurface::from_mask(mask, Affine::from_spacing([1.0; 3]).unwrap(), &control).unwrap();
        let lengths = std::array::from_fn(|kind: usize| f64::from(kind.count_ones()).sqrt());
        let graph = Graph::of_voxels(&surface, lengths, &control).unwrap();
        (surface, graph)
    }

    proptest! {
        #[test]
        fn arcs_join_exactly_the_26_neighbours(bits in prop::collection::vec(any::<bool>(), 120)) {
            prop_assume!(bits.contains(&true));
            let (surface, graph) = graph_of(&Mask::new([4, 5, 6], bits).unwrap());
            for a in 0..surface.len() {
                for b in 0..surface.len() {
                    let (p, q) = (surface.voxels()[a], surface.voxels()[b]);
                    let apart: Vec<i64> = (0..3).map(|x| (i64::from(p[x]) - i64::from(q[x])).abs()).collect();
                    let near = a != b && apart.iter().all(|&x| x <= 1);
                    let arc = graph.arcs(a as u32).find(|arc| arc.to as usize == b);
                    prop_assert_eq!(arc.is_some(), near);
                    if let Some(arc) = arc {
                        prop_assert_eq!(arc.length, (apart.iter().sum::<i64>() as f32).sqrt());
                    }
                }
            }
        }
    }

    #[test]
    fn components_are_counted_and_the_largest_is_found() {
        let (_, graph) = graph_of(&Mask::from_fn([9, 4, 1], |[i, _, _]| i < 2 || (4..8).contains(&i)).unwrap());
        let components = graph.components();
        assert_eq!(components.sizes, vec![8, 16]);
        assert_eq!(components.largest(), Some(1));
        assert_eq!(components.describe(), "16, 8");
    }
}
