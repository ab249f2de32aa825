//! Columns of voxels, each of which is made connected.

use crate::error::check_length;
use crate::{Control, Result};

/// The offsets to the 26 neighbours that come later in the order of the volume, in lexicographic order.
const LATER: [[i64; 3]; 13] = [
    [0, 0, 1],
    [0, 1, -1],
    [0, 1, 0],
    [0, 1, 1],
    [1, -1, -1],
    [1, -1, 0],
    [1, -1, 1],
    [1, 0, -1],
    [1, 0, 0],
    [1, 0, 1],
    [1, 1, -1],
    [1, 1, 0],
    [1, 1, 1],
];

/// The number of voxels between two checks for cancellation.
const CHUNK: usize = 1 << 16;

/// No voxel.
const NONE: u32 = u32::MAX;

/// Makes columns connected (26 neighbours). Each column keeps its largest part, and the first of several. A voxel of
/// another part joins the column of the neighbour whose point on the middle surface is nearest to its own, from the kept
/// parts outwards. Voxels that no kept part reaches belong to no column (0).
///
/// # Arguments
/// - `voxels`: The voxels, in the order of the volume.
/// - `columns`: The column of each voxel, or 0.
/// - `halfway`: The point of the middle surface that belongs to each voxel, in mm.
///
/// # Errors
/// [`Error::WrongLength`](crate::Error::WrongLength) if there is not one column and one point per voxel, and
/// [`Error::Cancelled`](crate::Error::Cancelled).
pub fn connect(voxels: &[[u32; 3]], columns: &[u32], halfway: &[[f64; 3]], control: &Control) -> Result<Vec<u32>> {
    check_length("columns", columns.len(), "voxels", voxels.len())?;
    check_length("halfway points", halfway.len(), "voxels", voxels.len())?;
    control.begin("connecting columns", 2);
    let grid = Grid::new(voxels);
    let is_kept = largest_parts(&grid, voxels, columns, control)?;
    control.advance();
    let mut joined: Vec<u32> = columns.iter().zip(&is_kept).map(|(&c, &kept)| if kept { c } else { 0 }).collect();
    let mut loose: Vec<u32> =
        (0..voxels.len() as u32).filter(|&v| !is_kept[v as usize] && columns[v as usize] != 0).collect();
    loop {
        control.check()?;
        let apart = |a: u32, b: u32| {
            let [a, b] = [a, b].map(|v| halfway[v as usize]);
            (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>()
        };
        let nearest = |&voxel: &u32| {
            let beside = grid.around(voxels[voxel as usize]).filter(|&other| joined[other as usize] != 0);
            beside.min_by(|&a, &b| apart(a, voxel).total_cmp(&apart(b, voxel)).then(a.cmp(&b)))
        };
        let found: Vec<(u32, u32)> =
            loose.iter().filter_map(|v| nearest(v).map(|other| (*v, joined[other as usize]))).collect();
        if found.is_empty() {
            break;
        }
        for &(voxel, column) in &found {
            joined[voxel as usize] = column;
        }
        loose.retain(|&voxel| joined[voxel as usize] == 0);
    }
    control.advance();
    Ok(joined)
}

/// Returns whether each voxel belongs to the largest part of its column.
fn largest_parts(grid: &Grid, voxels: &[[u32; 3]], columns: &[u32], control: &Control) -> Result<Vec<bool>> {
    let mut parts = Parts((0..voxels.len() as u32).collect());
    for (n, &voxel) in voxels.iter().enumerate() {
        if n % CHUNK == 0 {
            control.check()?;
        }
        for other in LATER.iter().filter_map(|&offset| grid.at(voxel, offset)) {
            if columns[other as usize] == columns[n] {
                parts.join(n as u32, other);
            }
        }
    }
    let roots: Vec<u32> = (0..voxels.len() as u32).map(|voxel| parts.root(voxel)).collect();
    let mut sizes = vec![0u32; voxels.len()];
    roots.iter().for_each(|&root| sizes[root as usize] += 1);
    let most = columns.iter().max().map_or(0, |&column| column as usize + 1);
    let mut largest = vec![NONE; most];
    for &root in &roots {
        let best = &mut largest[columns[root as usize] as usize];
        if *best == NONE || sizes[root as usize] > sizes[*best as usize] {
            *best = root;
        }
    }
    Ok((0..voxels.len()).map(|n| columns[n] != 0 && largest[columns[n] as usize] == roots[n]).collect())
}

/// Disjoint sets of voxels; the root of each is its first voxel.
struct Parts(Vec<u32>);

impl Parts {
    fn root(&mut self, mut voxel: u32) -> u32 {
        while self.0[voxel as usize] != voxel {
            let above = self.0[voxel as usize];
            self.0[voxel as usize] = self.0[above as usize];
            voxel = above;
        }
        voxel
    }

    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b) as usize] = a.min(b);
    }
}

/// The number of the voxel at each place of a box.
struct Grid {
    low: [i64; 3],
    shape: [i64; 3],
    numbers: Vec<u32>,
}

impl Grid {
    fn new(voxels: &[[u32; 3]]) -> Self {
        let bound = |axis: usize, most: fn(u32, u32) -> u32| voxels.iter().map(|v| v[axis]).reduce(most).unwrap_or(0);
        let low = [0, 1, 2].map(|axis| i64::from(bound(axis, u32::min)));
        let shape = [0, 1, 2].map(|axis| i64::from(bound(axis, u32::max)) - low[axis] + 1);
        let mut grid = Self { low, shape, numbers: vec![NONE; shape.iter().product::<i64>() as usize] };
        for (n, &voxel) in (0..).zip(voxels) {
            if let Some(place) = grid.place(voxel, [0; 3]) {
                grid.numbers[place] = n;
            }
        }
        grid
    }

    fn place(&self, voxel: [u32; 3], offset: [i64; 3]) -> Option<usize> {
        let at: [i64; 3] = std::array::from_fn(|axis| i64::from(voxel[axis]) + offset[axis] - self.low[axis]);
        let is_inside = (0..3).all(|axis| (0..self.shape[axis]).contains(&at[axis]));
        is_inside.then(|| ((at[0] * self.shape[1] + at[1]) * self.shape[2] + at[2]) as usize)
    }

    fn at(&self, voxel: [u32; 3], offset: [i64; 3]) -> Option<u32> {
        self.place(voxel, offset).map(|place| self.numbers[place]).filter(|&number| number != NONE)
    }

    fn around(&self, voxel: [u32; 3]) -> impl Iterator<Item = u32> + '_ {
        let both = LATER.into_iter().flat_map(|offset| [offset.map(|x| -x), offset]);
        both.filter_map(move |offset| self.at(voxel, offset))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::Error;

    fn parts_of(voxels: &[[u32; 3]], columns: &[u32], column: u32) -> Vec<usize> {
        let mut left: Vec<[u32; 3]> =
            voxels.iter().zip(columns).filter(|of| *of.1 == column).map(|(&voxel, _)| voxel).collect();
        let mut sizes = Vec::new();
        while let Some(first) = left.pop() {
            let mut part = vec![first];
            let mut next = 0;
            while next < part.len() {
                let at = part[next];
                let touches = |voxel: &[u32; 3]| (0..3).all(|axis| voxel[axis].abs_diff(at[axis]) <= 1);
                part.extend(left.extract_if(.., |voxel| touches(voxel)));
                next += 1;
            }
            sizes.push(part.len());
        }
        sizes
    }

    proptest! {
        #[test]
        fn columns_are_connected_and_keep_their_largest_part(
            labels in prop::collection::vec(0..5u32, 5 * 5 * 5),
        ) {
            let all: Vec<[u32; 3]> = (0..125).map(|n| [n / 25, n / 5 % 5, n % 5]).collect();
            let is_grey = |n: usize| n % 7 != 3;
            let voxels: Vec<[u32; 3]> = (0..125).filter(|&n| is_grey(n)).map(|n| all[n]).collect();
            let columns: Vec<u32> = (0..125).filter(|&n| is_grey(n)).map(|n| labels[n]).collect();
            let halfway: Vec<[f64; 3]> = voxels.iter().map(|voxel| voxel.map(f64::from)).collect();
            let joined = connect(&voxels, &columns, &halfway, &Control::default()).unwrap();
            for column in 1..5 {
                let (before, after) = (parts_of(&voxels, &columns, column), parts_of(&voxels, &joined, column));
                prop_assert_eq!(after.len(), before.len().min(1));
                prop_assert!(after.first() >= before.iter().max());
            }
            for n in 0..voxels.len() {
                prop_assert!(columns[n] != 0 || joined[n] == 0);
            }
        }
    }

    #[test]
    fn a_loose_voxel_joins_the_column_of_its_own_bank() {
        // a row of voxels; the fourth is cut off from its column 1, and lies between columns 2 and 3
        let voxels: Vec<[u32; 3]> = (0..6).map(|k| [4, 4, k]).collect();
        let columns = [1, 1, 2, 1, 3, 3];
        let halfway = [0.0, 1.0, 9.0, 20.0, 21.0, 22.0].map(|x| [x, 0.0, 0.0]);
        let control = Control::default();
        assert_eq!(connect(&voxels, &columns, &halfway, &control).unwrap(), [1, 1, 2, 3, 3, 3]);
        assert_eq!(connect(&voxels[..3], &[1, 2, 1], &halfway[..3], &control).unwrap(), [1, 2, 2]); // of two, the first
        let apart = [[0, 0, 0], [0, 0, 1], [0, 0, 5]]; // unreachable
        assert_eq!(connect(&apart, &[7, 7, 7], &halfway[..3], &control).unwrap(), [7, 7, 0]);
        assert_eq!(connect(&[], &[], &[], &control).unwrap(), []);
        control.cancel();
        assert_eq!(connect(&voxels, &columns, &halfway, &control), Err(Error::Cancelled));
    }
}
