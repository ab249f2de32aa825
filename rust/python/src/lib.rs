//! The Python extension `voxflat._core`: borrow, check, release the GIL, call, wrap. No algorithm lives here.

mod convert;
mod raster;
mod surface;
mod work;

use pyo3::prelude::*;

/// The compiled core of voxflat.
#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<surface::VoxelSurface>()?;
    module.add_function(wrap_pyfunction!(raster::draw, module)?)?;
    module.add_function(wrap_pyfunction!(surface::chain_weights, module)?)?;
    Ok(())
}
