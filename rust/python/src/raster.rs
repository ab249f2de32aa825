//! The flat image's pixels.

use numpy::{PyArray3, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use voxflat::raster::{Faces, Raster};

use crate::convert;
use crate::work::{InputError, run};

type Pixels<'py> = (Bound<'py, PyArray3<u32>>, Bound<'py, PyArray3<f32>>, [f64; 2]);

/// Draws faces (F, 3) over the plane; pixels of a torn face show its nearest corner.
///
/// Returns the pixels' corners (H, W, 3), their barycentric weights (H, W, 3), and (u, v) in mm of the centre of pixel
/// (0, 0). Outside the map a corner is 2³² − 1 and a weight NaN.
#[pyfunction]
#[pyo3(signature = (uv, faces, torn, pixel_size, progress=None))]
pub fn draw<'py>(
    py: Python<'py>,
    uv: PyReadonlyArray2<'py, f64>,
    faces: PyReadonlyArray2<'py, u32>,
    torn: PyReadonlyArray1<'py, bool>,
    pixel_size: f64,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Pixels<'py>> {
    let uv = convert::rows::<_, 2>(&uv, "uv")?;
    let corners = convert::rows::<_, 3>(&faces, "faces")?;
    convert::check_vertices(corners.iter().flatten().copied(), uv.len())?;
    let torn: Vec<bool> = torn.as_array().iter().copied().collect();
    if torn.len() != corners.len() {
        return Err(InputError::new_err(format!("torn has {} values; there are {} faces", torn.len(), corners.len())));
    }
    let faces = Faces { corners, torn };
    let raster = run(py, Some(1), progress.as_ref(), move |control| Raster::draw(&uv, &faces, pixel_size, control))?;
    let corners = convert::image(convert::array(py, &raster.corners)?, raster.height, raster.width)?;
    let weights = convert::image(convert::array(py, &raster.weights)?, raster.height, raster.width)?;
    Ok((corners, weights, raster.origin))
}
