//! The graph of Grossmann et al. (2002): surface voxels and their 26 neighbours.

use super::{VertexGrid, VoxelSurface, neighbours};
use crate::adjacency::{Arc, Links};
use crate::{Control, Error, Result};

/// A stored arc: 29 bits for the neighbour, 3 for the kind of link. Distance rows are memory-bound; half the bytes make
/// them about half again as fast.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct PackedArc(u32);

const NEIGHBOUR_BITS: u32 = 29;
const NEIGHBOUR: u32 = (1 << NEIGHBOUR_BITS) - 1;

/// The graph in compressed rows. Links are of seven kinds with one length each. Arcs are ordered by neighbour.
#[derive(Debug, Clone)]
pub struct VoxelGraph {
    starts: Vec<u32>,
    arcs: Vec<PackedArc>,
    lengths: [f32; 8],
}

impl VoxelGraph {
    /// Creates the 26-neighbour graph of surface voxels. `lengths[kind]` is the length of a link in mm. The kind is the
    /// set of axes along which the link steps (bit 0 for the first axis, bit 1 for the second, bit 2 for the third).
    pub(crate) fn of(surface: &VoxelSurface, lengths: [f64; 8], control: &Control) -> Result<Self> {
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

    /// Returns the memory of a graph in bytes: four per link and end, and four per vertex for the start of its links.
    pub(crate) const fn memory_need(vertices: usize, links: usize) -> u64 {
        4 * links as u64 + 4 * vertices as u64
    }

    /// Returns the number of links, counted from both of their ends.
    pub fn links(&self) -> usize {
        self.arcs.len()
    }

    /// Returns where the links of each vertex begin, and where the last ones end.
    pub fn starts(&self) -> &[u32] {
        &self.starts
    }
}

impl Links for VoxelGraph {
    fn vertices(&self) -> usize {
        self.starts.len() - 1
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
        let lengths = &self.lengths[1..]; // the kinds of links that a voxel can have
        let longest = lengths.iter().copied().fold(0.0, f32::max);
        [lengths.iter().copied().fold(longest, f32::min), longest]
    }
}

/// Returns the axes along which a link steps, as bits.
fn kind(offset: [i64; 3]) -> u32 {
    (0..3).filter(|&axis| offset[axis] != 0).map(|axis| 1 << axis).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::{masks, voxels};
    use crate::volume::Mask;
    use proptest::prelude::*;

    fn graph_of(mask: &Mask) -> (VoxelSurface, VoxelGraph) {
        let surface = voxels(mask, [1.0; 3]);
        let lengths = std::array::from_fn(|kind: usize| f64::from(kind.count_ones()).sqrt());
        let graph = VoxelGraph::of(&surface, lengths, &Control::default()).unwrap();
        (surface, graph)
    }

    proptest! {
        #[test]
        fn arcs_join_exactly_the_26_neighbours(mask in masks([4, 5, 6], 0.2..0.8)) {
            let (surface, graph) = graph_of(&mask);
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
