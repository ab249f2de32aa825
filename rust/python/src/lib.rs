//! The Python extension `voxflat._core`: borrow, check, release the GIL, call, wrap. No algorithm lives here.

mod convert;
mod raster;
mod surface;
mod voxels;
mod work;

use pyo3::prelude::*;

/// The compiled core of voxflat.
#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<surface::Surface>()?;
    module.add_class::<voxels::VoxelSurface>()?;
    module.add_function(wrap_pyfunction!(raster::draw, module)?)?;
    module.add_function(wrap_pyfunction!(surface::defects, module)?)?;
    module.add_function(wrap_pyfunction!(surface::repair, module)?)?;
    module.add_function(wrap_pyfunction!(voxels::chain_weights, module)?)?;
    Ok(())
}
