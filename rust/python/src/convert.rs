//! Between numpy arrays and the core's values.

use ndarray::Array2;
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use voxflat::distortion::faces::FaceDistortion;
use voxflat::distortion::overlap::Overlap;
use voxflat::distortion::{Distortion, Figures};
use voxflat::flatten::FlatMap;
use voxflat::geodesic::marching::Wave;
use voxflat::sources::Sources;
use voxflat::surface::voxels::level::Level;
use voxflat::volume::Mask;

use crate::work::{InputError, to_python};

pub type Values<'py, T> = Bound<'py, PyArray1<T>>;
pub type Table<'py, T> = Bound<'py, PyArray2<T>>;
pub type Dict<'py> = Bound<'py, PyDict>;
pub type List<'py> = Bound<'py, PyList>;

/// A dictionary of values by their names.
macro_rules! dict {
    ($py:expr, $($name:literal = $value:expr),* $(,)?) => {{
        let dict = pyo3::types::PyDict::new($py);
        $(dict.set_item($name, $value)?;)*
        dict
    }};
}

pub(crate) use dict;

/// A mask from a boolean array of any strides.
pub fn mask(array: &PyReadonlyArray3<'_, bool>) -> PyResult<Mask> {
    let [i, j, k] = [0, 1, 2].map(|axis| array.shape()[axis]);
    Mask::new([i, j, k], array.as_array().iter().copied().collect()).map_err(to_python)
}

/// An image and its value on the surface.
pub fn level(array: &PyReadonlyArray3<'_, f32>, value: f64) -> PyResult<Level> {
    let [i, j, k] = [0, 1, 2].map(|axis| array.shape()[axis]);
    Level::new([i, j, k], array.as_array().iter().copied().collect(), value).map_err(to_python)
}

/// The values of an array.
pub fn values<T: numpy::Element + Copy>(array: &PyReadonlyArray1<'_, T>) -> Vec<T> {
    array.as_array().to_vec()
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

/// Triangles in the plane from an array of their corners.
pub fn triangles(array: &PyReadonlyArray3<'_, f64>, name: &str) -> PyResult<Vec<[[f64; 2]; 3]>> {
    let view = array.as_array();
    if view.shape()[1..] != [3, 2] {
        return Err(InputError::new_err(format!("{name} has shape {:?}; it needs (F, 3, 2)", view.shape())));
    }
    Ok(view.outer_iter().map(|of| std::array::from_fn(|k| std::array::from_fn(|axis| of[[k, axis]]))).collect())
}

/// Vectors as rows.
pub fn plain<V: Copy + Into<[f64; 3]>>(vectors: &[V]) -> Vec<[f64; 3]> {
    vectors.iter().map(|&vector| vector.into()).collect()
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

/// Fails where there are not as many values or rows as the surface has points.
pub fn check_length(given: usize, points: usize, name: &str) -> PyResult<()> {
    if given == points {
        return Ok(());
    }
    Err(InputError::new_err(format!("{name} has {given} rows; the surface has {points} points")))
}

/// The numbers of vertices, of which there are `points`.
pub fn vertices(array: &PyReadonlyArray1<'_, u32>, points: usize) -> PyResult<Vec<u32>> {
    let vertices = values(array);
    check_vertices(vertices.iter().copied(), points)?;
    Ok(vertices)
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

/// How sources are chosen: "farthest" or "random"; `choices` names all that there are, for who gives something else.
pub fn sources(sampling: &str, count: usize, seed: u64, choices: &str) -> PyResult<Sources> {
    match sampling {
        "farthest" => Ok(Sources::Farthest { count, seed }),
        "random" => Ok(Sources::Random { count, seed }),
        _ => Err(InputError::new_err(format!("sampling is {sampling:?}; give {choices}"))),
    }
}

/// What a front is taken for: "circle" or "plane".
pub fn wave(name: &str) -> PyResult<Wave> {
    match name {
        "circle" => Ok(Wave::Circle),
        "plane" => Ok(Wave::Plane),
        _ => Err(InputError::new_err(format!("wave is {name:?}; give 'circle' or 'plane'"))),
    }
}

fn figures_dict<'py>(py: Python<'py>, figures: &Figures) -> PyResult<Bound<'py, PyDict>> {
    Ok(dict!(
        py,
        "scale" = figures.scale,
        "relative_error" = figures.relative_error,
        "relative_error_0_5mm" = figures.relative_error_0_5mm,
        "relative_error_5_15mm" = figures.relative_error_5_15mm,
        "relative_error_15_30mm" = figures.relative_error_15_30mm,
        "relative_error_10mm" = figures.relative_error_10mm,
        "relative_error_30mm" = figures.relative_error_30mm,
        "absolute_error" = figures.absolute_error,
        "stress_1" = figures.stress_1,
        "sammon_stress" = figures.sammon_stress
    ))
}

/// The figures of distances by their names.
pub fn distortion_dict(py: Python<'_>, measured: Distortion) -> PyResult<Bound<'_, PyDict>> {
    let distortion = dict!(
        py,
        "raw" = figures_dict(py, &measured.raw)?,
        "best_scale" = figures_dict(py, &measured.best_scale)?,
        "pearson_r" = measured.pearson_r,
        "mean_geodesic" = measured.mean_geodesic
    );
    let errors = dict!(
        py,
        "raw" = figures_dict(py, &measured.standard_error.raw)?,
        "best_scale" = figures_dict(py, &measured.standard_error.best_scale)?,
        "pearson_r" = measured.standard_error.pearson_r,
        "mean_geodesic" = measured.standard_error.mean_geodesic
    );
    distortion.set_item("standard_error", errors)?;
    distortion.set_item("sources", measured.sources)?;
    distortion.set_item("pairs", measured.pairs)?;
    distortion.set_item("per_point", measured.per_point.into_pyarray(py))?;
    distortion.set_item("scatter", array(py, &measured.scatter)?)?;
    Ok(distortion)
}

/// The figures of triangles by their names.
pub fn triangles_dict<'py>(
    py: Python<'py>,
    measured: FaceDistortion,
    overlap: &Overlap,
) -> PyResult<Bound<'py, PyDict>> {
    let dict = dict!(
        py,
        "areal_median" = measured.areal.summary.median,
        "areal_p95" = measured.areal.summary.p95,
        "equal_area_scale" = measured.equal_area_scale,
        "equal_area_median" = measured.equal_area.median,
        "equal_area_p95" = measured.equal_area.p95
    );
    for (name, share) in ["area_beyond_1_25", "area_beyond_1_5", "area_beyond_2"].into_iter().zip(measured.area_beyond)
    {
        dict.set_item(name, share)?;
    }
    dict.set_item("edge", measured.edge.mean)?;
    dict.set_item("angle", measured.angle.summary.mean)?;
    dict.set_item("quasi_conformal", measured.quasi_conformal.summary.median)?;
    dict.set_item("isometric", measured.isometric.summary.median)?;
    dict.set_item("symmetric_dirichlet", measured.symmetric_dirichlet.summary.median)?;
    dict.set_item("flipped", measured.flipped.count)?;
    dict.set_item("flipped_share", measured.flipped.area_share)?;
    dict.set_item("collapsed", measured.flipped.collapsed)?;
    dict.set_item("crossings", overlap.crossings)?;
    dict.set_item("covering", overlap.covering)?;
    dict.set_item("areal", measured.areal.values.into_pyarray(py))?;
    dict.set_item("is_flipped", measured.flipped.per_face.into_pyarray(py))?;
    Ok(dict)
}

/// A flat map's values by their names.
pub fn map_dict(py: Python<'_>, map: FlatMap) -> PyResult<Bound<'_, PyDict>> {
    let dict = dict!(
        py,
        "uv" = array(py, &map.uv)?,
        "normals" = array(py, &plain(&map.normals))?,
        "sources" = map.sources.into_pyarray(py)
    );
    let rows = map.rows.map(|rows| (rows.columns(), rows.into_data()));
    dict.set_item("rows", rows.map(|(columns, rows)| table(py, rows, columns)).transpose()?)?;
    dict.set_item("eigenvalues", map.eigenvalues.into_pyarray(py))?;
    dict.set_item("planarity", map.planarity)?;
    dict.set_item("distortion", distortion_dict(py, map.distortion)?)?;
    let convergence = map.convergence.map(|convergence| (convergence.energies, convergence.converged));
    dict.set_item("convergence", convergence)?;
    Ok(dict)
}
