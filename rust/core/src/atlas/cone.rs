//! The narrowest cone around directions.

use nalgebra::Vector3;

/// The rounding error of a cosine.
const ROUNDING: f64 = 1e-14;

/// Returns the axis, a unit vector, of the narrowest cone that contains all of these unit vectors, which must lie in an
/// open half-space; without vectors, the first axis of space. Directions are added one by one: one that the cone does
/// not contain lies on the boundary of the next cone (Welzl 1991).
pub(super) fn narrowest(directions: &[Vector3<f64>]) -> Vector3<f64> {
    let Some(&first) = directions.first() else { return Vector3::x() };
    let mut cone = Cone { axis: first, cosine: 1.0 };
    for (i, a) in directions.iter().enumerate() {
        if cone.holds(a) {
            continue;
        }
        cone = Cone { axis: *a, cosine: 1.0 };
        for (j, b) in directions[..i].iter().enumerate() {
            if cone.holds(b) {
                continue;
            }
            cone = Cone::through((a + b).normalize(), a);
            for c in &directions[..j] {
                if !cone.holds(c) {
                    // the axis at equal angles to three directions is normal to the plane of their tips
                    let axis = (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or(cone.axis);
                    cone = Cone::through(axis * axis.dot(a).signum(), a);
                }
            }
        }
    }
    cone.axis
}

struct Cone {
    axis: Vector3<f64>,
    cosine: f64,
}

impl Cone {
    fn through(axis: Vector3<f64>, border: &Vector3<f64>) -> Self {
        Self { axis, cosine: axis.dot(border) }
    }

    fn holds(&self, direction: &Vector3<f64>) -> bool {
        self.axis.dot(direction) >= self.cosine - ROUNDING
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// No cone through two or three of the directions that contains all of them is narrower.
        #[test]
        fn it_is_as_by_brute_force(
            places in prop::collection::vec(prop::array::uniform2(-0.9..0.9f64), 2..9),
            twice in any::<bool>(),
        ) {
            let mut directions: Vec<Vector3<f64>> = places.iter().map(|p| Vector3::new(p[0], p[1], 1.0).normalize()).collect();
            if twice {
                directions.extend(directions.clone());
            }
            let least = |axis: &Vector3<f64>| directions.iter().map(|d| d.dot(axis)).fold(1.0, f64::min);
            let mut best = -1.0f64;
            for a in &directions {
                for b in &directions {
                    best = best.max(least(&(a + b).normalize()));
                    for c in &directions {
                        if let Some(axis) = (b - a).cross(&(c - a)).try_normalize(1e-9) {
                            best = best.max(least(&axis));
                        }
                    }
                }
            }
            prop_assert!((least(&narrowest(&directions)) - best).abs() < 1e-9);
        }
    }

    #[test]
    fn few_directions() {
        assert_eq!(narrowest(&[]), Vector3::x());
        assert_eq!(narrowest(&[Vector3::z(); 3]), Vector3::z());
        let [a, b] = [0.1f64, 0.5].map(|t| Vector3::new(t.sin(), 0.0, t.cos()));
        assert!((narrowest(&[a, b, a]) - Vector3::new(0.3f64.sin(), 0.0, 0.3f64.cos())).norm() < 1e-14);
    }
}
