//! What a map does to a surface.

use std::sync::Arc;

use numpy::PyReadonlyArray2;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use voxflat::distortion::faces::measure_faces;
use voxflat::distortion::overlap::overlaps;
use voxflat::flatten;
use voxflat::geodesic::engine::Engine;

use super::Surface;
use crate::convert;
use crate::work::run;

#[pymethods]
impl Surface {
    /// What a map (N, 2) does to the triangles.
    #[pyo3(signature = (uv, progress=None))]
    fn measure<'py>(
        &self,
        py: Python<'py>,
        uv: PyReadonlyArray2<'py, f64>,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let uv = convert::rows::<_, 2>(&uv, "uv")?;
        self.check_length(uv.len(), "uv")?;
        let inner = Arc::clone(&self.0);
        let (of_faces, overlap) = run(py, None, progress.as_ref(), move |control| {
            let (points, faces) = (inner.surface.points(), inner.surface.faces());
            Ok((measure_faces(points, faces, &uv, control)?, overlaps(faces, &uv, control)?))
        })?;
        convert::triangles_dict(py, of_faces, &overlap)
    }

    /// What a map (N, 2) does to the distances from random sources.
    #[pyo3(signature = (uv, sources, seed, threads=None, progress=None))]
    fn judge<'py>(
        &self,
        py: Python<'py>,
        uv: PyReadonlyArray2<'py, f64>,
        sources: usize,
        seed: u64,
        threads: Option<usize>,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let uv = convert::rows::<_, 2>(&uv, "uv")?;
        self.check_length(uv.len(), "uv")?;
        let inner = Arc::clone(&self.0);
        let distortion = run(py, threads, progress.as_ref(), move |control| {
            let graph = &*inner.graph(control)?;
            flatten::judge(&Engine::new(graph, sources, control)?, &uv, sources, seed, control)
        })?;
        convert::distortion_dict(py, distortion)
    }
}
