//! Conversion between numpy arrays and the core's values.

use ndarray::Array2;
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::types::{IntoPyDict, PyDict};
use voxflat::distortion::{Bands, Distortion, Evaluation, Figures, faces::FaceDistortion, overlap::Overlap};
use voxflat::flatten::FlatMap;
use voxflat::sources::Sources;
use voxflat::surface::voxels::level::Level;
use voxflat::volume::Mask;

use crate::work::{InputError, to_python};

pub type Given<'py, T> = PyReadonlyArray1<'py, T>;
pub type GivenTable<'py, T> = PyReadonlyArray2<'py, T>;
pub type GivenImage<'py, T> = PyReadonlyArray3<'py, T>;
pub type Values<'py, T> = Bound<'py, PyArray1<T>>;
pub type Table<'py, T> = Bound<'py, PyArray2<T>>;
pub type Dict<'py> = Bound<'py, PyDict>;
pub type List<'py> = Vec<Dict<'py>>;

/// Creates a dictionary of named values.
macro_rules! dict {
    ($py:expr, $($name:literal = $value:expr),* $(,)?) => {{
        let dict = pyo3::types::PyDict::new($py);
        $(dict.set_item($name, $value)?;)*
        dict
    }};
}

/// Returns an InputError with a formatted message unless a condition holds.
macro_rules! ensure {
    ($condition:expr, $($message:tt)+) => {
        if !$condition {
            return Err($crate::work::InputError::new_err(format!($($message)+)));
        }
    };
}

pub(crate) use {dict, ensure};

/// Returns the values of an image of any strides in C order.
pub fn voxels<T: numpy::Element + Copy>(image: &GivenImage<'_, T>) -> Vec<T> {
    let view = image.as_array();
    view.to_slice().map_or_else(|| view.iter().copied().collect(), <[T]>::to_vec) // of a slice, ten times as fast
}

/// Creates a mask from a boolean array of any strides.
pub fn mask(array: &GivenImage<'_, bool>) -> PyResult<Mask> {
    let [i, j, k] = [0, 1, 2].map(|axis| array.shape()[axis]);
    Mask::new([i, j, k], voxels(array)).map_err(to_python)
}

/// Creates a level from an image and its value on the surface.
pub fn level(array: &GivenImage<'_, f32>, value: f64) -> PyResult<Level> {
    let [i, j, k] = [0, 1, 2].map(|axis| array.shape()[axis]);
    Level::new([i, j, k], voxels(array), value).map_err(to_python)
}

/// Returns the values of an array.
pub fn values<T: numpy::Element + Copy>(array: &Given<'_, T>) -> Vec<T> {
    array.as_array().to_vec()
}

/// Returns rows of a fixed width from a two-dimensional array.
pub fn rows<T: numpy::Element + Copy, const W: usize>(array: &GivenTable<'_, T>, name: &str) -> PyResult<Vec<[T; W]>> {
    let view = array.as_array();
    ensure!(view.ncols() == W, "{name} has shape {:?}. Pass an array with {W} columns", view.shape());
    Ok(view.rows().into_iter().map(|row| std::array::from_fn(|column| row[column])).collect())
}

/// Returns triangles in the plane from an array of their corners.
pub fn triangles(array: &GivenImage<'_, f64>, name: &str) -> PyResult<Vec<[[f64; 2]; 3]>> {
    let view = array.as_array();
    ensure!(view.shape()[1..] == [3, 2], "{name} has shape {:?}. Pass an array of shape (F, 3, 2)", view.shape());
    Ok(view.outer_iter().map(|of| std::array::from_fn(|k| std::array::from_fn(|axis| of[[k, axis]]))).collect())
}

/// Returns vectors as rows.
pub fn plain<V: Copy + Into<[f64; 3]>>(vectors: &[V]) -> Vec<[f64; 3]> {
    vectors.iter().map(|&vector| vector.into()).collect()
}

/// Creates a two-dimensional array from rows of a fixed width.
pub fn array<'py, T: numpy::Element + Copy, const W: usize>(
    py: Python<'py>, rows: &[[T; W]],
) -> PyResult<Table<'py, T>> {
    table(py, rows.as_flattened().to_vec(), W)
}

/// Creates a two-dimensional array from its values, row by row.
pub fn table<T: numpy::Element>(py: Python<'_>, values: Vec<T>, width: usize) -> PyResult<Table<'_, T>> {
    let height = values.len().checked_div(width).unwrap_or(0);
    let array = Array2::from_shape_vec((height, width), values);
    Ok(array.map_err(|error| InputError::new_err(error.to_string()))?.into_pyarray(py))
}

/// Checks that all vertices are below `points`.
pub fn check_vertices(vertices: impl IntoIterator<Item = u32>, points: usize) -> PyResult<()> {
    voxflat::error::check_points(vertices, points).map_err(to_python)
}

/// Checks that an array has one entry per `item` of the surface, "point" or "face".
pub fn check_length(given: usize, items: usize, name: &str, item: &str) -> PyResult<()> {
    ensure!(
        given == items,
        "{name} has length {given}, but the surface has {items} {item}s. Pass one entry per {item}"
    );
    Ok(())
}

/// Returns the numbers of vertices of a surface with `points` vertices.
pub fn vertices(array: &Given<'_, u32>, points: usize) -> PyResult<Vec<u32>> {
    let vertices = values(array);
    check_vertices(vertices.iter().copied(), points)?;
    Ok(vertices)
}

/// Returns a three-dimensional view of a table.
pub fn image<'py, T: numpy::Element>(
    table: Table<'py, T>, height: usize, width: usize,
) -> PyResult<Bound<'py, numpy::PyArray3<T>>> {
    let depth = table.shape()[1];
    table.reshape([height, width, depth])
}

/// Returns how sources are chosen: "farthest" or "random"; the error message lists all `choices`.
pub fn sources(sampling: &str, count: usize, seed: u64, choices: &str) -> PyResult<Sources> {
    match sampling {
        "farthest" => Ok(Sources::Farthest { count, seed }),
        "random" => Ok(Sources::Random { count, seed }),
        _ => Err(InputError::new_err(format!("sampling is {sampling:?}. Pass {choices}"))),
    }
}

/// Returns the value of a name, given all choices of an argument.
pub fn one_of<T: Copy>(argument: &str, given: &str, choices: &[(&str, T)]) -> PyResult<T> {
    if let Some((_, found)) = choices.iter().find(|(name, _)| *name == given) {
        return Ok(*found);
    }
    let names: Vec<String> = choices.iter().map(|(name, _)| format!("'{name}'")).collect();
    let (last, others) = names.split_last().expect("there are some");
    Err(InputError::new_err(format!("{argument} is {given:?}. Pass {} or {last}", others.join(", "))))
}

/// Returns how maps are evaluated, given the upper ends of the distance bands.
pub fn evaluation(bands: [f64; 4], seed: u64) -> Evaluation {
    Evaluation { bands: Bands(bands), seed }
}

/// Returns the figures of distances by their names.
pub fn distortion_dict(py: Python<'_>, measured: Distortion) -> PyResult<Dict<'_>> {
    let figures = |of: &Figures| of.named().into_py_dict(py);
    let errors = measured.standard_error;
    Ok(dict!(
        py,
        "raw" = figures(&measured.raw)?,
        "best_scale" = figures(&measured.best_scale)?,
        "interior" = figures(&measured.interior)?,
        "interior_share" = measured.interior_share,
        "pearson_r" = measured.pearson_r,
        "mean_geodesic" = measured.mean_geodesic,
        "standard_error" = dict!(
            py,
            "raw" = figures(&errors.raw)?,
            "best_scale" = figures(&errors.best_scale)?,
            "pearson_r" = errors.pearson_r,
            "mean_geodesic" = errors.mean_geodesic
        ),
        "sources" = measured.sources,
        "pairs" = measured.pairs,
        "per_point" = measured.per_point.into_pyarray(py),
        "scatter" = array(py, &measured.scatter)?
    ))
}

/// Returns the figures of triangles by their names.
pub fn triangles_dict<'py>(py: Python<'py>, measured: FaceDistortion, overlap: &Overlap) -> PyResult<Dict<'py>> {
    Ok(dict!(
        py,
        "areal_median" = measured.areal.summary.median,
        "areal_p95" = measured.areal.summary.p95,
        "equal_area_scale" = measured.equal_area_scale,
        "equal_area_median" = measured.equal_area.median,
        "equal_area_p95" = measured.equal_area.p95,
        "area_beyond_1_25" = measured.area_beyond[0],
        "area_beyond_1_5" = measured.area_beyond[1],
        "area_beyond_2" = measured.area_beyond[2],
        "edge" = measured.edge.mean,
        "angle" = measured.angle.summary.mean,
        "quasi_conformal" = measured.quasi_conformal.summary.median,
        "isometric" = measured.isometric.summary.median,
        "symmetric_dirichlet" = measured.symmetric_dirichlet.summary.median,
        "flipped" = measured.flipped.count,
        "flipped_share" = measured.flipped.area_share,
        "collapsed" = measured.flipped.collapsed,
        "crossings" = overlap.crossings,
        "covering" = overlap.covering,
        "areal" = measured.areal.values.into_pyarray(py),
        "is_flipped" = measured.flipped.per_face.into_pyarray(py)
    ))
}

/// Returns the values of a flat map by their names.
pub fn map_dict(py: Python<'_>, map: FlatMap) -> PyResult<Dict<'_>> {
    let rows = map.rows.map(|rows| (rows.columns(), rows.into_data()));
    Ok(dict!(
        py,
        "uv" = array(py, &map.uv)?,
        "normals" = array(py, &plain(&map.normals))?,
        "sources" = map.sources.into_pyarray(py),
        "rows" = rows.map(|(columns, rows)| table(py, rows, columns)).transpose()?,
        "eigenvalues" = map.eigenvalues.into_pyarray(py),
        "planarity" = map.planarity,
        "distortion" = distortion_dict(py, map.distortion)?,
        "convergence" = map.convergence.map(|convergence| (convergence.energies, convergence.converged))
    ))
}
