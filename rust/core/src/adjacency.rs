//! Who is next to whom on a surface, and how far.

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
        Components::of(self.vertices(), |vertex| self.arcs(vertex).map(|arc| arc.to), |_| true)
    }
}

/// What hangs together: vertices of a graph, or faces of a surface.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Components {
    /// The component of each member, named in the order of their first members; [`NONE`](Self::NONE) for those that belong to none.
    pub labels: Vec<u32>,
    /// Number of members of each component.
    pub sizes: Vec<usize>,
}

impl Components {
    /// Stands for the component of what belongs to none.
    pub const NONE: u32 = u32::MAX;

    /// Those of `count` members, by who is next to whom, among the allowed ones: a flood fill from each that was not reached.
    pub(crate) fn of<I: Iterator<Item = u32>>(
        count: usize,
        neighbours: impl Fn(u32) -> I,
        is_allowed: impl Fn(u32) -> bool,
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

    /// How many there are.
    pub fn count(&self) -> usize {
        self.sizes.len()
    }

    /// The component with the most members; of equal ones the first.
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

/// Items in ascending order, each once.
pub(crate) fn distinct<T: Ord>(items: impl IntoIterator<Item = T>) -> Vec<T> {
    let mut items: Vec<T> = items.into_iter().collect();
    items.sort_unstable();
    items.dedup();
    items
}

/// Of each of so many things, is it one of some?
pub(crate) fn marked<'a>(count: usize, some: impl IntoIterator<Item = &'a u32>) -> Vec<bool> {
    let mut marked = vec![false; count];
    some.into_iter().for_each(|&one| marked[one as usize] = true);
    marked
}

/// Where the rows of a compressed table begin, and where the last one ends, by the row of each entry.
pub(crate) fn starts_of(rows: usize, of_entries: impl Iterator<Item = u32>) -> Vec<u32> {
    let mut starts = vec![0; rows + 1];
    of_entries.for_each(|row| starts[row as usize + 1] += 1);
    (0..rows).for_each(|row| starts[row + 1] += starts[row]);
    starts
}

/// Numbers in groups, in compressed rows.
#[derive(Debug, Clone)]
pub(crate) struct Groups {
    starts: Vec<u32>,
    members: Vec<u32>,
}

impl Groups {
    /// The group of 0, of 1, and so on.
    pub fn new(count: usize, of_members: impl Iterator<Item = u32> + Clone) -> Self {
        let starts = starts_of(count, of_members.clone());
        let (mut free, mut members) = (starts.clone(), vec![0; starts[count] as usize]);
        for (member, group) in (0..).zip(of_members) {
            members[free[group as usize] as usize] = member;
            free[group as usize] += 1;
        }
        Self { starts, members }
    }

    /// Its members, ascending.
    pub fn of(&self, group: u32) -> &[u32] {
        &self.members[self.starts[group as usize] as usize..self.starts[group as usize + 1] as usize]
    }
}

/// Disjoint sets (Tarjan 1975).
#[derive(Debug)]
pub(crate) struct Sets(Vec<u32>);

impl Sets {
    pub fn new(count: usize) -> Self {
        Self((0..count as u32).collect())
    }

    pub fn find(&mut self, mut member: u32) -> u32 {
        while self.0[member as usize] != member {
            let above = self.0[self.0[member as usize] as usize];
            self.0[member as usize] = above; // halves the path
            member = above;
        }
        member
    }

    /// Makes two sets one; were they two?
    pub fn join(&mut self, a: u32, b: u32) -> bool {
        let (a, b) = (self.find(a), self.find(b));
        self.0[a.max(b) as usize] = a.min(b);
        a != b
    }
}

/// Any graph, for tests: the links of each vertex.
#[cfg(test)]
pub(crate) struct Listed(pub Vec<Vec<Arc>>);

#[cfg(test)]
impl Listed {
    /// A graph of links that lead both ways; those from a vertex to itself are left out.
    pub fn new(vertices: usize, links: &[(u32, u32, f32)]) -> Self {
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
