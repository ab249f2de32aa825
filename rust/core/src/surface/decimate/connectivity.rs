//! The faces that remain while vertices are removed.

use crate::surface::mesh::{BORDER, Surface, next, previous};

/// Half-edges as in [`Surface`]; a removed face has no corners.
#[derive(Debug, Clone)]
pub(super) struct Connectivity {
    origins: Vec<u32>,
    twins: Vec<u32>,
    leaving: Vec<u32>,
    valence: Vec<u32>,
}

/// The half-edges that begin at a vertex, and the vertices at their ends, counterclockwise. For a vertex on the
/// boundary, there is one more vertex than half-edges, and the boundary runs through the first and the last.
#[derive(Debug, Clone, Default)]
pub(super) struct Ring {
    pub(super) spokes: Vec<u32>,
    pub(super) vertices: Vec<u32>,
}

impl Ring {
    pub(super) fn is_closed(&self) -> bool {
        self.spokes.len() == self.vertices.len()
    }

    /// Iterates over the sides of the ring opposite the vertex, as pairs of positions in the ring.
    pub(super) fn sides(&self) -> impl Iterator<Item = [usize; 2]> + '_ {
        (0..self.spokes.len()).map(|k| [k, (k + 1) % self.vertices.len()])
    }
}

impl Connectivity {
    pub(super) fn of(surface: &Surface) -> Self {
        let mut leaving = vec![BORDER; surface.len()];
        let mut valence = vec![0; surface.len()];
        for half_edge in 0..surface.twins().len() as u32 {
            let origin = surface.origin(half_edge) as usize;
            leaving[origin] = half_edge;
            valence[origin] += 1;
            if surface.twins()[half_edge as usize] == BORDER {
                valence[surface.target(half_edge) as usize] += 1; // the boundary edge that does not begin at it
            }
        }
        Self { origins: surface.faces().as_flattened().to_vec(), twins: surface.twins().to_vec(), leaving, valence }
    }

    pub(super) fn valence(&self, vertex: u32) -> usize {
        self.valence[vertex as usize] as usize
    }

    pub(super) fn is_gone(&self, vertex: u32) -> bool {
        self.leaving[vertex as usize] == BORDER
    }

    /// Returns the remaining faces, and the twin of each of their half-edges.
    pub(super) fn faces(&self) -> (Vec<[u32; 3]>, Vec<u32>) {
        let left: Vec<u32> =
            (0..self.origins.len() as u32).step_by(3).filter(|&h| self.origins[h as usize] != BORDER).collect();
        let mut number = vec![BORDER; self.origins.len() / 3];
        left.iter().enumerate().for_each(|(n, &h)| number[h as usize / 3] = n as u32);
        let twin = |h: u32| match self.twins[h as usize] {
            BORDER => BORDER,
            twin => 3 * number[twin as usize / 3] + twin % 3,
        };
        let faces = left.iter().map(|&h| [h, h + 1, h + 2].map(|h| self.origins[h as usize])).collect();
        (faces, left.iter().flat_map(|&h| [h, h + 1, h + 2]).map(twin).collect())
    }

    pub(super) fn ring(&self, vertex: u32, ring: &mut Ring) {
        ring.spokes.clear();
        ring.vertices.clear();
        let start = self.leaving[vertex as usize];
        let mut first = start; // clockwise to the boundary, if there is one
        while self.twins[first as usize] != BORDER {
            first = next(self.twins[first as usize]);
            if first == start {
                break;
            }
        }
        let mut spoke = first;
        loop {
            ring.spokes.push(spoke);
            ring.vertices.push(self.origins[next(spoke) as usize]);
            match self.twins[previous(spoke) as usize] {
                BORDER => return ring.vertices.push(self.origins[previous(spoke) as usize]),
                twin if twin == first => return,
                twin => spoke = twin,
            }
        }
    }

    /// Returns whether the topology is kept if a vertex with this ring moves onto the `k`-th vertex of the ring.
    ///
    /// The link condition (Dey et al. 1999): the two have no common neighbours except across the faces between them,
    /// and a vertex of the boundary moves only along the boundary.
    pub(super) fn is_allowed(&self, ring: &Ring, k: usize, beyond: &mut Ring) -> bool {
        let (count, last) = (ring.vertices.len(), ring.vertices.len() - 1);
        let is_closed = ring.is_closed();
        if !is_closed && k != 0 && k != last {
            return false;
        }
        let outer = |spoke: u32| self.twins[next(spoke) as usize];
        if !is_closed && count == 2 && outer(ring.spokes[0]) == BORDER {
            return false; // a single triangle
        }
        if is_closed && count == 3 {
            let opposite = outer(ring.spokes[(k + 1) % 3]);
            if opposite != BORDER && self.origins[previous(opposite) as usize] == ring.vertices[k] {
                return false; // a tetrahedron
            }
        }
        self.ring(ring.vertices[k], beyond);
        let common = beyond.vertices.iter().filter(|v| ring.vertices.contains(v)).count();
        common == if is_closed { 2 } else { 1 }
    }

    /// Moves a vertex onto the `k`-th vertex of its ring, where this [is allowed](Self::is_allowed).
    pub(super) fn collapse(&mut self, vertex: u32, ring: &Ring, k: usize) {
        let onto = ring.vertices[k];
        let count = ring.vertices.len();
        ring.spokes.iter().for_each(|&spoke| self.origins[spoke as usize] = onto);
        if let Some(&spoke) = ring.spokes.get(k) {
            self.close(next(spoke), previous(spoke), onto);
        }
        if ring.is_closed() || k > 0 {
            let spoke = ring.spokes[(k + ring.spokes.len() - 1) % ring.spokes.len()];
            self.close(spoke, next(spoke), onto);
        }
        self.leaving[vertex as usize] = BORDER;
        self.valence[onto as usize] += count as u32;
        self.valence[onto as usize] -= if ring.is_closed() { 4 } else { 3 };
    }

    /// Removes a face whose half-edges `first` and then `second` now coincide, with `onto` at their outer ends.
    fn close(&mut self, first: u32, second: u32, onto: u32) {
        let middle = self.origins[second as usize];
        let [a, b] = [first, second].map(|h| self.twins[h as usize]);
        if a != BORDER {
            self.twins[a as usize] = b;
        }
        if b != BORDER {
            self.twins[b as usize] = a;
        }
        // `a` begins at the middle and `b` ends at it
        self.leaving[middle as usize] = if a == BORDER { next(b) } else { a };
        self.leaving[onto as usize] = if b == BORDER { next(a) } else { b };
        self.valence[middle as usize] -= 1;
        let face = first as usize / 3;
        self.origins[3 * face..3 * face + 3].fill(BORDER);
    }
}
