//! Dense systems of linear equations, solved without threads, so that results do not depend on their number.

use faer::{MatRef, Side, linalg::solvers::Solve};

use crate::error::check_length;
use crate::{Error, Result};

/// Solves a symmetric positive definite system. `matrix` contains the rows of the matrix one after the other.
///
/// # Errors
/// [`Error::Uneven`] if the matrix is not positive definite or not finite, and [`Error::WrongLength`] if it is not
/// square, or its side is not the length of `right`.
///
/// # Examples
/// ```
/// let x = voxflat::dense::solve(&[4.0, 1.0, 1.0, 3.0], &[1.0, 2.0])?;
/// assert!((4.0 * x[0] + x[1] - 1.0).abs() < 1e-14 && (x[0] + 3.0 * x[1] - 2.0).abs() < 1e-14);
/// # Ok::<(), voxflat::Error>(())
/// ```
pub fn solve(matrix: &[f64], right: &[f64]) -> Result<Vec<f64>> {
    let side = right.len();
    check_length("values of the matrix", matrix.len(), "pairs of a row and a column", side * side)?;
    let factor = MatRef::from_row_major_slice(matrix, side, side).llt(Side::Lower).map_err(|_| Error::Uneven)?;
    let solution = factor.solve(MatRef::from_column_major_slice(right, side, 1));
    let found: Vec<f64> = solution.col(0).iter().copied().collect();
    if found.iter().all(|value| value.is_finite()) { Ok(found) } else { Err(Error::Uneven) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn systems_without_a_solution_are_errors() {
        for matrix in [[1.0, 2.0, 2.0, 1.0], [0.0; 4], [f64::NAN, 0.0, 0.0, 1.0]] {
            assert!(matches!(solve(&matrix, &[1.0, 1.0]), Err(Error::Uneven)));
        }
        assert!(matches!(solve(&[1.0, 0.0, 0.0, 1.0], &[f64::INFINITY, 0.0]), Err(Error::Uneven)));
        assert_eq!(solve(&[], &[]).ok(), Some(vec![]));
    }
}
