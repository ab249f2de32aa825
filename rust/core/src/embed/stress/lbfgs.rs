//! L-BFGS (Nocedal 1980) over a factored matrix of springs.
//!
//! The two loops of L-BFGS visit the steps one by one. If the products of all stored steps and gradient changes are
//! known, the loops become sums over a few numbers. Each step is then read four times instead of eight, together with
//! the others, by all threads. Steps have 32 bits; sums have 64 bits, and are the same for any number of threads.

use crate::embed::Place;
use std::collections::VecDeque;

use nalgebra::Vector2;
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::springs::Factor;

/// The number of stored steps.
const MEMORY: usize = 20;

/// The number of vertices that are visited together.
const BATCH: usize = 2048;

/// The number of vectors whose products are computed together.
const TOGETHER: usize = 4;

#[derive(Debug, Default)]
pub(super) struct History {
    /// The moves of the map.
    moved: VecDeque<Vec<Vector2<f32>>>,
    /// The changes of the gradient over them.
    bent: VecDeque<Vec<Vector2<f32>>>,
    /// The products of each change with the moves up to its own.
    products: VecDeque<VecDeque<f64>>,
}

impl History {
    pub fn is_empty(&self) -> bool {
        self.moved.is_empty()
    }

    pub fn clear(&mut self) {
        *self = Self::default();
    }

    /// Stores a step, and drops the oldest one if there are too many. The gradient must have changed along the move.
    pub fn push(&mut self, moved: &[Place], bent: &[Place]) {
        if self.moved.len() == MEMORY {
            self.moved.pop_front();
            self.bent.pop_front();
            self.products.pop_front();
            for products in &mut self.products {
                products.pop_front();
            }
        }
        let short = |long: &[Place]| long.par_iter().with_min_len(BATCH).map(|value| value.cast()).collect();
        self.moved.push_back(short(moved));
        self.bent.push_back(short(bent));
        self.products.push_back(products(&self.moved, bent).into());
    }

    /// Returns the direction of descent: minus the gradient times an inverse Hessian from springs and past steps.
    pub fn direction(&self, gradient: &[Place], factor: &Factor) -> Vec<Place> {
        let steps = self.moved.len();
        let mut shares = products(&self.moved, gradient);
        for n in (0..steps).rev() {
            // first loop: α_n = s_nᵀ(g − Σ α y)/(y_nᵀs_n) over later steps, from the newest
            let later: f64 = (n + 1..steps).map(|later| shares[later] * self.products[later][n]).sum();
            shares[n] = (shares[n] - later) / self.products[n][n];
        }
        let mut turned = gradient.to_vec();
        add(&mut turned, &self.bent, &shares.iter().map(|share| -share).collect::<Vec<_>>());
        // H₀ is the inverse of the springs, not a multiple of the identity
        let mut turned = factor.solve(&turned);
        let mut times = products(&self.bent, &turned);
        for n in 0..steps {
            // second loop: r += s_n (α_n − y_nᵀr/(y_nᵀs_n)), from the oldest
            let earlier: f64 = (0..n).map(|earlier| times[earlier] * self.products[n][earlier]).sum();
            times[n] = shares[n] - (times[n] + earlier) / self.products[n][n];
        }
        add(&mut turned, &self.moved, &times);
        turned.iter_mut().for_each(|value| *value = -*value);
        turned
    }
}

fn products(of: &VecDeque<Vec<Vector2<f32>>>, by: &[Place]) -> Vec<f64> {
    let of_batch = |(n, by): (usize, &[Place])| {
        let vectors: Vec<&[Vector2<f32>]> = of.iter().map(|one| &one[n * BATCH..]).collect();
        let (together, rest) = vectors.as_chunks();
        let together = together.iter().flat_map(|&of| Arch::new().dispatch(Products { of, by }));
        together.chain(rest.iter().map(|one| product(one, by))).collect()
    };
    let parts: Vec<Vec<f64>> = by.par_chunks(BATCH).enumerate().map(of_batch).collect();
    (0..of.len()).map(|n| parts.iter().map(|part| part[n]).sum()).collect()
}

fn product(one: &[Vector2<f32>], by: &[Place]) -> f64 {
    one.iter().zip(by).map(|(one, by)| one.cast::<f64>().component_mul(by)).sum::<Place>().sum()
}

/// Some of these products, interleaved, because each sum waits for its previous term.
struct Products<'a> {
    of: [&'a [Vector2<f32>]; TOGETHER],
    by: &'a [Place],
}

impl WithSimd for Products<'_> {
    type Output = [f64; TOGETHER];

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Self::Output {
        let [a, b, c, d] = self.of;
        let [mut x, mut y] = [[0.0; TOGETHER]; 2];
        for ((((by, a), b), c), d) in self.by.iter().zip(a).zip(b).zip(c).zip(d) {
            let (all_x, all_y) = ([a.x, b.x, c.x, d.x], [a.y, b.y, c.y, d.y]);
            for n in 0..TOGETHER {
                x[n] += f64::from(all_x[n]) * by.x;
                y[n] += f64::from(all_y[n]) * by.y;
            }
        }
        [0, 1, 2, 3].map(|n| Vector2::new(x[n], y[n]).sum())
    }
}

fn add(to: &mut [Place], vectors: &VecDeque<Vec<Vector2<f32>>>, times: &[f64]) {
    to.par_chunks_mut(BATCH).enumerate().for_each(|(n, to)| {
        for (vector, times) in vectors.iter().zip(times) {
            to.iter_mut().zip(&vector[n * BATCH..]).for_each(|(to, by)| *to += by.cast::<f64>() * *times);
        }
    });
}

#[cfg(test)]
mod tests {
    use super::super::springs::Springs;
    use super::*;
    use crate::Control;
    use proptest::prelude::*;

    type Vectors = Vec<Vector2<f64>>;

    #[test]
    fn products_have_the_same_bits_together_and_alone() {
        let by: Vectors = (1..300).map(|n| Vector2::new(f64::from(n).sin(), f64::from(n).ln())).collect();
        let vector = |k: usize| (1..300).map(|n| Vector2::new((n as f32).cos() / k as f32, (n * k) as f32)).collect();
        let of: VecDeque<Vec<Vector2<f32>>> = (1..12).map(vector).collect();
        let alone: Vec<u64> = of.iter().map(|one| product(one, &by).to_bits()).collect();
        assert_eq!(products(&of, &by).into_iter().map(f64::to_bits).collect::<Vec<_>>(), alone);
    }

    fn dot(a: &Vectors, b: &Vectors) -> f64 {
        a.iter().zip(b).map(|(a, b)| a.dot(b)).sum()
    }

    /// Computes the published recursion (Nocedal, Wright, algorithm 7.4).
    fn two_loops(gradient: &Vectors, steps: &[(Vectors, Vectors)], factor: &Factor) -> Vectors {
        let mut turned = gradient.clone();
        let mut shares = Vec::new();
        for (moved, bent) in steps.iter().rev() {
            let share = dot(moved, &turned) / dot(moved, bent);
            turned.iter_mut().zip(bent).for_each(|(to, by)| *to -= by * share);
            shares.push(share);
        }
        let mut turned = factor.solve(&turned);
        for ((moved, bent), share) in steps.iter().zip(shares.into_iter().rev()) {
            let other = dot(bent, &turned) / dot(moved, bent);
            turned.iter_mut().zip(moved).for_each(|(to, by)| *to += by * (share - other));
        }
        turned.iter().map(|value| -value).collect()
    }

    fn vectors(numbers: &[i32]) -> Vectors {
        numbers.chunks_exact(2).map(|pair| Vector2::new(f64::from(pair[0]), f64::from(pair[1])) / 64.0).collect()
    }

    proptest! {
        #[test]
        fn directions_are_those_of_the_two_loops(
            gradient in prop::collection::vec(-500..500, 10),
            steps in prop::collection::vec((prop::collection::vec(-500..500, 10), prop::collection::vec(-500..500, 10)), 0..3 * MEMORY),
        ) {
            let springs = Springs::new(vec![[0, 1, 2], [1, 3, 2], [2, 3, 4]], 5, &Control::default()).unwrap();
            let factor = springs.factor(&[[-1.0, -2.0, -0.5]; 3], &[1.0, 2.0, 3.0, 0.5, 1.5]).unwrap();
            let known = |(moved, other): &(Vec<i32>, Vec<i32>)| {
                let (moved, other) = (vectors(moved), vectors(other));
                let bent: Vectors = moved.iter().zip(&other).map(|(moved, other)| 2.0 * moved + 0.25 * other).collect();
                (moved, bent)
            };
            let is_curved = |(moved, bent): &(Vectors, Vectors)| dot(moved, bent) > dot(moved, moved) + 1.0;
            let steps: Vec<_> = steps.iter().map(known).filter(is_curved).collect();
            let mut history = History::default();
            steps.iter().for_each(|(moved, bent)| history.push(moved, bent));
            let found = history.direction(&vectors(&gradient), &factor);
            let expected = two_loops(&vectors(&gradient), &steps[steps.len().saturating_sub(MEMORY)..], &factor);
            let scale = 1.0 + expected.iter().map(Vector2::norm).fold(0.0, f64::max);
            for (found, expected) in found.iter().zip(&expected) {
                prop_assert!((found - expected).norm() < 1e-6 * scale, "{found} {expected}");
            }
        }
    }
}
