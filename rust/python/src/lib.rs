//! The Python extension `voxflat._core`: borrow, check, release the GIL, call, wrap. It contains no algorithm.
//!
//! Arrays are copied with the GIL; everything else that takes time runs without it.

#![allow(clippy::too_many_arguments)] // keyword arguments in Python

mod convert;
mod nearest;
mod raster;
mod surface;
mod voxels;
mod work;

use std::path::PathBuf;

use numpy::{IntoPyArray, PyUntypedArrayMethods};
use pyo3::prelude::*;

/// Return the maximum memory in bytes for computing a store of this size, without the graph.
#[pyfunction]
fn store_memory_need(columns: usize, rows: usize, threads: usize) -> u64 {
    voxflat::store::memory_need(columns, rows, threads)
}

/// Return the rows of a store's table that do not match the given checksums.
#[pyfunction]
#[pyo3(signature = (directory, columns, checksums, progress=None))]
fn damaged_rows(
    py: Python<'_>, directory: PathBuf, columns: usize, checksums: Vec<Option<u32>>, progress: work::Progress<'_>,
) -> PyResult<Vec<usize>> {
    work::run(py, None, &progress, move |control| {
        voxflat::store::damaged_rows(&directory, columns, &checksums, control)
    })
}

/// Solve a symmetric positive definite system with the matrix (N, N) and the right-hand side (N,).
#[pyfunction]
fn solve<'py>(
    py: Python<'py>, matrix: convert::GivenTable<'py, f64>, right: convert::Given<'py, f64>,
) -> PyResult<convert::Values<'py, f64>> {
    let (matrix, shape) = (matrix.as_array(), matrix.shape());
    let right = convert::values(&right);
    convert::ensure!(
        shape == [right.len(); 2],
        "the matrix has shape {shape:?}, but the right-hand side has length {}. Pass a square matrix",
        right.len()
    );
    let matrix: Vec<f64> = matrix.iter().copied().collect();
    Ok(work::run(py, Some(1), &None, move |_| voxflat::dense::solve(&matrix, &right))?.into_pyarray(py))
}

/// The compiled core of voxflat.
#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("FARTHEST", voxflat::scales::FARTHEST)?;
    module.add("KEPT_BYTES", voxflat::distortion::evaluate::KEPT_BYTES)?;
    module.add("REFERENCE_SOURCES", voxflat::distortion::evaluate::REFERENCE_SOURCES)?;
    module.add("SMALLEST", voxflat::scales::SMALLEST)?;
    module.add_class::<nearest::NearestFinder>()?;
    module.add_class::<raster::TriangleFinder>()?;
    module.add_class::<surface::Surface>()?;
    module.add_class::<surface::maps::Group>()?;
    module.add_class::<voxels::VoxelSurface>()?;
    module.add_function(wrap_pyfunction!(nearest::ribbon_voxels, module)?)?;
    module.add_function(wrap_pyfunction!(nearest::connect_columns, module)?)?;
    module.add_function(wrap_pyfunction!(nearest::ways_pass, module)?)?;
    module.add_function(wrap_pyfunction!(raster::draw, module)?)?;
    module.add_function(wrap_pyfunction!(surface::component_sizes, module)?)?;
    module.add_function(wrap_pyfunction!(surface::defects, module)?)?;
    module.add_function(wrap_pyfunction!(surface::is_sheet, module)?)?;
    module.add_function(wrap_pyfunction!(surface::repair, module)?)?;
    module.add_function(wrap_pyfunction!(surface::maps::turn_onto, module)?)?;
    module.add_function(wrap_pyfunction!(surface::measure::reference_sources, module)?)?;
    module.add_function(wrap_pyfunction!(surface::spheres::locate_on_sphere, module)?)?;
    module.add_function(wrap_pyfunction!(surface::vertex_normals, module)?)?;
    module.add_function(wrap_pyfunction!(damaged_rows, module)?)?;
    module.add_function(wrap_pyfunction!(solve, module)?)?;
    module.add_function(wrap_pyfunction!(store_memory_need, module)?)?;
    module.add_function(wrap_pyfunction!(voxels::chain_weights, module)?)?;
    Ok(())
}
