//! The pixels of a flat image, and the inverse lookup.

use std::sync::Arc;

use numpy::{IntoPyArray, PyArray3};
use pyo3::prelude::*;
use voxflat::lookup::TriangleFinder as CoreFinder;
use voxflat::raster::{Faces, Raster};

use crate::convert::{self, Given, GivenImage, GivenTable, Table, Values};
use crate::work::{Progress, run};

type Found<'py> = (Values<'py, i64>, Table<'py, f64>);
type Pixels<'py> = (Bound<'py, PyArray3<u32>>, Bound<'py, PyArray3<f32>>, [f64; 2]);

/// Draw faces (F, 3) in the plane; pixels of a torn face show its nearest corner.
///
/// Returns the corners of the pixels (H, W, 3), their barycentric weights (H, W, 3), and (u, v) in mm of the centre of
/// pixel (0, 0). Outside the map, corners are 2³² − 1 and weights NaN.
#[pyfunction]
#[pyo3(signature = (uv, faces, torn, pixel_size, progress=None))]
pub fn draw<'py>(
    py: Python<'py>, uv: GivenTable<'py, f64>, faces: GivenTable<'py, u32>, torn: Given<'py, bool>, pixel_size: f64,
    progress: Progress<'py>,
) -> PyResult<Pixels<'py>> {
    let uv = convert::rows::<_, 2>(&uv, "uv")?;
    let corners = convert::rows::<_, 3>(&faces, "faces")?;
    convert::check_vertices(corners.iter().flatten().copied(), uv.len())?;
    let torn = convert::values(&torn);
    convert::check_length(torn.len(), corners.len(), "torn", "face")?;
    let faces = Faces { corners, torn };
    let raster = run(py, Some(1), &progress, move |control| Raster::draw(&uv, &faces, pixel_size, control))?;
    let corners = convert::image(convert::array(py, &raster.corners)?, raster.height, raster.width)?;
    let weights = convert::image(convert::array(py, &raster.weights)?, raster.height, raster.width)?;
    Ok((corners, weights, raster.origin))
}

/// Finds the triangles at positions in the plane.
#[pyclass(frozen, module = "voxflat._core")]
pub struct TriangleFinder(Arc<CoreFinder>);

#[pymethods]
impl TriangleFinder {
    /// Create a finder from the corners of triangles (F, 3, 2) in mm.
    #[new]
    fn new(py: Python<'_>, corners: GivenImage<'_, f64>) -> PyResult<Self> {
        let corners = convert::triangles(&corners, "corners")?;
        run(py, Some(1), &None, move |_| Ok(Self(Arc::new(CoreFinder::new(&corners)))))
    }

    /// Return the first triangle at each position (P, 2), -1 if none, and barycentric coordinates (P, 3), NaN if none.
    fn find<'py>(&self, py: Python<'py>, places: GivenTable<'py, f64>) -> PyResult<Found<'py>> {
        let places = convert::rows::<_, 2>(&places, "places")?;
        let finder = Arc::clone(&self.0);
        let (triangles, weights): (Vec<i64>, Vec<[f64; 3]>) = run(py, None, &None, move |control| {
            let found = finder.find_all(&places, control)?.into_iter();
            Ok(found.map(|found| found.map_or((-1, [f64::NAN; 3]), |(at, weights)| (i64::from(at), weights))).unzip())
        })?;
        Ok((triangles.into_pyarray(py), convert::array(py, &weights)?))
    }
}
