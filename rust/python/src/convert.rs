//! Between numpy arrays and the core's values.

use ndarray::Array2;
use numpy::{IntoPyArray, PyArray2, PyArrayMethods, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;
use voxflat::volume::Mask;

use crate::work::{InputError, to_python};

/// A mask from a boolean array of any strides.
pub fn mask(array: &PyReadonlyArray3<'_, bool>) -> PyResult<Mask> {
    let [i, j, k] = [0, 1, 2].map(|axis| array.shape()[axis]);
    Mask::new([i, j, k], array.as_array().iter().copied().collect()).map_err(to_python)
}

/// Rows of a fixed width from a two-dimensional array.
pub fn rows<T: numpy::Element + Copy, const W: usize>(
    array: &PyReadonlyArray2<'_, T>,
    name: &str,
) -> PyResult<Vec<[T; W]>> {
    let view = array.as_array();
    if view.ncols() != W {
        return Err(InputError::new_err(format!("{name} has shape {:?}; it needs {W} columns", view.shape())));
    }
    Ok(view.rows().into_iter().map(|row| std::array::from_fn(|column| row[column])).collect())
}

/// A two-dimensional array from rows of a fixed width.
pub fn array<'py, T: numpy::Element + Copy, const W: usize>(
    py: Python<'py>,
    rows: &[[T; W]],
) -> PyResult<Bound<'py, PyArray2<T>>> {
    table(py, rows.as_flattened().to_vec(), W)
}

/// A two-dimensional array from its values, row by row.
pub fn table<T: numpy::Element>(py: Python<'_>, values: Vec<T>, width: usize) -> PyResult<Bound<'_, PyArray2<T>>> {
    let height = values.len().checked_div(width).unwrap_or(0);
    let array = Array2::from_shape_vec((height, width), values);
    Ok(array.map_err(|error| InputError::new_err(error.to_string()))?.into_pyarray(py))
}

/// Fails where a vertex is not below `points`.
pub fn check_vertices(vertices: impl IntoIterator<Item = u32>, points: usize) -> PyResult<()> {
    match vertices.into_iter().find(|&vertex| vertex as usize >= points) {
        Some(vertex) => Err(to_python(voxflat::Error::NoSuchPoint { vertex: vertex as usize, points })),
        None => Ok(()),
    }
}

/// Three-dimensional view of a table.
pub fn image<'py, T: numpy::Element>(
    table: Bound<'py, PyArray2<T>>,
    height: usize,
    width: usize,
) -> PyResult<Bound<'py, numpy::PyArray3<T>>> {
    let depth = table.shape()[1];
    table.reshape([height, width, depth])
}
