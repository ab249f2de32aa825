//! Neighbours on a surface, and the distances between them.

/// A link to a neighbour.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arc {
    /// The neighbour.
    pub to: u32,
    /// Length of the link, in mm.
    pub length: f32,
}

/// A sparse symmetric graph with edge lengths. Shortest paths need no other information about a surface.
pub trait Links: Sync {
    /// Returns the number of vertices.
    fn vertices(&self) -> usize;

    /// Returns the links of a vertex, ordered by neighbour.
    fn arcs(&self, vertex: u32) -> impl Iterator<Item = Arc> + '_;

    /// Returns the largest number of links of any vertex.
    fn most_links(&self) -> usize;

    /// Returns the lengths of the shortest and of the longest link, in mm.
    fn extremes(&self) -> [f32; 2];

    /// Returns whether the links are straight lines across the triangles of a surface.
    fn are_straight(&self) -> bool {
        false
    }

    /// Returns the connected components.
    fn components(&self) -> Components {
        Components::of(self.vertices(), |vertex| self.arcs(vertex).map(|arc| arc.to), |_| true)
    }
}

/// Connected components of the vertices of a graph, or of the faces of a surface.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Components {
    /// The component of each member, numbered by their first members; [`NONE`](Self::NONE) for members of none.
    pub labels: Vec<u32>,
    /// The number of members of each component.
    pub sizes: Vec<usize>,
}

impl Components {
    /// The label of members that belong to no component.
    pub const NONE: u32 = u32::MAX;

    /// Finds the components among the allowed ones of `count` members by flood fills from members not yet reached.
    pub(crate) fn of<I: Iterator<Item = u32>>(
        count: usize, neighbours: impl Fn(u32) -> I, is_allowed: impl Fn(u32) -> bool,
    ) -> Self {
        let mut labels = vec![Self::NONE; count];
        let mut sizes = Vec::new();
        let mut stack = Vec::new();
        for start in 0..count as u32 {
            if labels[start as usize] != Self::NONE || !is_allowed(start) {
                continue;
            }
            let label = sizes.len() as u32;
            labels[start as usize] = label;
            let mut size = 0;
            stack.push(start);
            while let Some(member) = stack.pop() {
                size += 1;
                for next in neighbours(member) {
                    if labels[next as usize] == Self::NONE && is_allowed(next) {
                        labels[next as usize] = label;
                        stack.push(next);
                    }
                }
            }
            sizes.push(size);
        }
        Self { labels, sizes }
    }

    /// Returns the number of components.
    pub(crate) fn count(&self) -> usize {
        self.sizes.len()
    }

    /// Returns the component with the most members, and the first of several equally large ones.
    pub(crate) fn largest(&self) -> Option<u32> {
        (0..self.sizes.len()).rev().max_by_key(|&c| self.sizes[c]).map(|c| c as u32)
    }

    /// Returns the sizes as text, largest first.
    pub(crate) fn describe(&self) -> String {
        let mut sizes = self.sizes.clone();
        sizes.sort_unstable_by(|a, b| b.cmp(a));
        let shown: Vec<String> = sizes.iter().take(5).map(usize::to_string).collect();
        if sizes.len() > 5 { format!("{}, ...", shown.join(", ")) } else { shown.join(", ") }
    }
}

/// Returns the items in ascending order, without duplicates.
pub(crate) fn distinct<T: Ord>(items: impl IntoIterator<Item = T>) -> Vec<T> {
    let mut items: Vec<T> = items.into_iter().collect();
    items.sort_unstable();
    items.dedup();
    items
}

/// Returns, for each number below `count`, whether it occurs in `some`.
pub(crate) fn marked<'a>(count: usize, some: impl IntoIterator<Item = &'a u32>) -> Vec<bool> {
    let mut marked = vec![false; count];
    some.into_iter().for_each(|&one| marked[one as usize] = true);
    marked
}

/// Returns where each row of a compressed table begins and the last one ends, given the row of each entry.
pub(crate) fn starts_of(rows: usize, of_entries: impl Iterator<Item = u32>) -> Vec<u32> {
    let mut starts = vec![0; rows + 1];
    of_entries.for_each(|row| starts[row as usize + 1] += 1);
    (0..rows).for_each(|row| starts[row + 1] += starts[row]);
    starts
}

/// Numbers in groups, stored as compressed rows.
#[derive(Debug, Clone)]
pub(crate) struct Groups {
    starts: Vec<u32>,
    members: Vec<u32>,
}

impl Groups {
    /// Groups members by their group number, for the groups from 0 to `count` - 1.
    pub(crate) fn new(count: usize, of_members: impl Iterator<Item = u32> + Clone) -> Self {
        let starts = starts_of(count, of_members.clone());
        let (mut free, mut members) = (starts.clone(), vec![0; starts[count] as usize]);
        for (member, group) in (0..).zip(of_members) {
            members[free[group as usize] as usize] = member;
            free[group as usize] += 1;
        }
        Self { starts, members }
    }

    /// Returns the members of a group in ascending order.
    pub(crate) fn of(&self, group: u32) -> &[u32] {
        &self.members[self.starts[group as usize] as usize..self.starts[group as usize + 1] as usize]
    }
}

/// Disjoint sets (Tarjan 1975).
#[derive(Debug)]
pub(crate) struct Sets(Vec<u32>);

impl Sets {
    pub(crate) fn new(count: usize) -> Self {
        Self((0..count as u32).collect())
    }

    pub(crate) fn find(&mut self, mut member: u32) -> u32 {
        while self.0[member as usize] != member {
            let above = self.0[self.0[member as usize] as usize];
            self.0[member as usize] = above; // path halving
            member = above;
        }
        member
    }

    /// Joins two sets, and returns whether they were different.
    pub(crate) fn join(&mut self, a: u32, b: u32) -> bool {
        let (a, b) = (self.find(a), self.find(b));
        self.0[a.max(b) as usize] = a.min(b);
        a != b
    }
}

/// An arbitrary graph for tests: the links of each vertex.
#[cfg(test)]
pub(crate) struct Listed(pub Vec<Vec<Arc>>);

#[cfg(test)]
impl Listed {
    /// Creates a graph of undirected links, without links from a vertex to itself.
    pub(crate) fn new(vertices: usize, links: &[(u32, u32, f32)]) -> Self {
        let mut arcs = vec![Vec::new(); vertices];
        for &(a, b, length) in links.iter().filter(|link| link.0 != link.1) {
            arcs[a as usize].push(Arc { to: b, length });
            arcs[b as usize].push(Arc { to: a, length });
        }
        arcs.iter_mut().for_each(|of| of.sort_by_key(|arc: &Arc| arc.to));
        Self(arcs)
    }
}

#[cfg(test)]
impl Links for Listed {
    fn vertices(&self) -> usize {
        self.0.len()
    }

    fn arcs(&self, vertex: u32) -> impl Iterator<Item = Arc> + '_ {
        self.0[vertex as usize].iter().copied()
    }

    fn most_links(&self) -> usize {
        self.0.iter().map(Vec::len).max().unwrap_or(0)
    }

    fn extremes(&self) -> [f32; 2] {
        let lengths = || self.0.iter().flatten().map(|arc| arc.length);
        [lengths().fold(f32::INFINITY, f32::min).min(1e6), lengths().fold(0.0, f32::max)]
    }
}
