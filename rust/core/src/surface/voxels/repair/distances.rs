//! Euclidean distance transform of a grid.

use super::grid::Grid;
use crate::{Control, Result};

/// Returns the Euclidean distance of every cell to the nearest site, by squared distances along one axis after the
/// other (Felzenszwalb, Huttenlocher 2012, Distance transforms of sampled functions). `scale` separates neighbours.
pub(super) fn distances(
    grid: &Grid, scale: [f64; 3], is_site: impl Fn(usize) -> bool, control: &Control,
) -> Result<Vec<f32>> {
    let mut squared: Vec<f32> = (0..grid.len()).map(|cell| if is_site(cell) { 0.0 } else { f32::INFINITY }).collect();
    let mut envelope = Vec::new();
    for axis in 0..3 {
        let (stride, length) = (grid.strides()[axis], grid.shape[axis]);
        for first in (0..grid.len()).filter(|cell| cell / stride % length == 0) {
            control.check()?;
            let line = (first..).step_by(stride).take(length);
            lower_envelope(line.clone().map(|cell| f64::from(squared[cell])), scale[axis], &mut envelope);
            let mut lowest = 0;
            for (place, cell) in line.enumerate().take(if envelope.is_empty() { 0 } else { length }) {
                while envelope.get(lowest + 1).is_some_and(|next| next.from <= place as f64) {
                    lowest += 1;
                }
                squared[cell] = envelope[lowest].at(place, scale[axis]) as f32;
            }
        }
    }
    squared.iter_mut().for_each(|value| *value = value.sqrt());
    Ok(squared)
}

/// A parabola over a position on a line, and where it begins to be the lowest one.
struct Parabola {
    place: usize,
    height: f64,
    from: f64,
}

impl Parabola {
    fn at(&self, place: usize, scale: f64) -> f64 {
        ((place as f64 - self.place as f64) * scale).powi(2) + self.height
    }
}

/// Returns the parabolas of the lower envelope in order; infinite heights have none.
fn lower_envelope(heights: impl Iterator<Item = f64>, scale: f64, envelope: &mut Vec<Parabola>) {
    envelope.clear();
    for (place, height) in heights.enumerate().filter(|(_, height)| height.is_finite()) {
        let from = loop {
            let Some(last) = envelope.last() else { break f64::NEG_INFINITY };
            let (middle, apart) = ((place + last.place) as f64 / 2.0, (place - last.place) as f64);
            let crossing = middle + (height - last.height) / (2.0 * apart * scale * scale);
            if crossing > last.from {
                break crossing;
            }
            envelope.pop();
        };
        envelope.push(Parabola { place, height, from });
    }
}
