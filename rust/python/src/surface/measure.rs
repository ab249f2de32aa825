//! Measures of a surface, and the distortion of its maps.

use numpy::IntoPyArray;
use pyo3::prelude::*;
use voxflat::distortion::{evaluate, faces::measure_faces, lower_bound, overlap::overlaps};
use voxflat::geodesic::bend::Marking;
use voxflat::surface::mesh::{curvature::smooth_mean_curvature, diffusion::smooth_values};
use voxflat::surface::sulcal_depth::sulcal_depth;

use super::solvers::{Geodesic, with_solver};
use super::{Inner, Surface};
use crate::convert::{self, Dict, Given, GivenTable, Table, Values};
use crate::work::{Progress, Threads};

#[pymethods]
impl Surface {
    /// Return the mean curvature (N) in 1/mm, averaged over `smoothing` mm.
    #[pyo3(signature = (smoothing, threads=None, progress=None))]
    fn mean_curvature<'py>(
        &self, py: Python<'py>, smoothing: f64, threads: Threads, progress: Progress<'py>,
    ) -> PyResult<Values<'py, f64>> {
        let work = move |inner: &Inner, control: &_| smooth_mean_curvature(&inner.surface, smoothing, control);
        Ok(self.run(py, threads, &progress, work)?.into_pyarray(py))
    }

    /// Return values (N, C), smoothed along the surface by a Gaussian of this standard deviation in mm.
    #[pyo3(signature = (values, deviation, threads=None, progress=None))]
    fn smooth_values<'py>(
        &self, py: Python<'py>, values: GivenTable<'py, f64>, deviation: f64, threads: Threads, progress: Progress<'py>,
    ) -> PyResult<Table<'py, f64>> {
        let columns: Vec<Vec<f64>> = values.as_array().columns().into_iter().map(|column| column.to_vec()).collect();
        let work = move |inner: &Inner, control: &_| smooth_values(&inner.surface, &columns, deviation, control);
        let smooth = self.run(py, threads, &progress, work)?;
        let count = self.0.surface.len();
        let rows = (0..count).flat_map(|v| smooth.iter().map(move |column| column[v])).collect();
        convert::table(py, rows, smooth.len())
    }

    /// Return the sulcal depth (N) in mm, by a flow of this number of mm².
    #[pyo3(signature = (flow, threads=None, progress=None))]
    fn sulcal_depth<'py>(
        &self, py: Python<'py>, flow: f64, threads: Threads, progress: Progress<'py>,
    ) -> PyResult<Values<'py, f64>> {
        let work = move |inner: &Inner, control: &_| sulcal_depth(&inner.surface, flow, control);
        Ok(self.run(py, threads, &progress, work)?.into_pyarray(py))
    }

    /// The area.
    #[getter]
    fn area(&self) -> f64 {
        self.0.surface.area()
    }

    /// Return the distortion of the triangles in a map (N, 2).
    #[pyo3(signature = (uv, progress=None))]
    fn measure<'py>(&self, py: Python<'py>, uv: GivenTable<'py, f64>, progress: Progress<'py>) -> PyResult<Dict<'py>> {
        let uv = convert::rows::<_, 2>(&uv, "uv")?;
        self.check_length(uv.len(), "uv")?;
        let (of_faces, overlap) = self.run(py, None, &progress, move |inner, control| {
            let (points, faces) = (inner.surface.points(), inner.surface.faces());
            Ok((measure_faces(points, faces, &uv, control)?, overlaps(faces, &uv, control)?))
        })?;
        convert::triangles_dict(py, of_faces, &overlap)
    }

    /// Return the distance errors of maps (N, 2) from sources (vertices). Rows above `kept` bytes are computed twice.
    /// `bands` are the upper ends of the four distance bands. The maps may repeat in the second direction, with a period.
    #[pyo3(signature = (maps, sources, geodesic, kept, seed, bands, threads=None, progress=None, period=None))]
    fn judge<'py>(
        &self, py: Python<'py>, maps: Vec<GivenTable<'py, f64>>, sources: Given<'py, u32>, geodesic: &str, kept: u64,
        seed: u64, bands: [f64; 4], threads: Threads, progress: Progress<'py>, period: Option<f64>,
    ) -> PyResult<Vec<Dict<'py>>> {
        let geodesic = Geodesic::named(geodesic)?;
        let maps: Vec<Vec<[f64; 2]>> = maps.iter().map(|uv| convert::rows(uv, "uv")).collect::<PyResult<_>>()?;
        maps.iter().try_for_each(|uv| self.check_length(uv.len(), "uv"))?;
        let (sources, evaluation) = (self.vertices(&sources)?, convert::evaluation(bands, seed));
        let evaluated = self.run(py, threads, &progress, move |inner, control| {
            let maps: Vec<&[[f64; 2]]> = maps.iter().map(Vec::as_slice).collect();
            let graph = &*inner.graph(control)?;
            with_solver!(geodesic, inner, control, |solver| {
                evaluate::evaluate_all(&Marking::of(solver, graph), &maps, period, &sources, kept, evaluation, control)
            })
        })?;
        evaluated.into_iter().map(|distortion| convert::distortion_dict(py, distortion)).collect()
    }

    /// Return the maximum memory in bytes of a lower bound.
    fn lower_bound_memory_need(&self, threads: usize) -> u64 {
        lower_bound::memory_need(self.0.surface.len(), threads)
    }

    /// Return a mean relative error of distances that no map has.
    #[pyo3(signature = (geodesic, seed, threads=None, progress=None))]
    fn lower_bound<'py>(
        &self, py: Python<'py>, geodesic: &str, seed: u64, threads: Threads, progress: Progress<'py>,
    ) -> PyResult<f64> {
        let geodesic = Geodesic::named(geodesic)?;
        self.run(py, threads, &progress, move |inner, control| {
            with_solver!(geodesic, inner, control, |solver| lower_bound::lower_bound(
                solver,
                Default::default(),
                seed,
                control
            ))
        })
    }
}

/// Return the reference sources among `points` points, as used for flattening.
#[pyfunction]
pub fn reference_sources(py: Python<'_>, points: usize, count: usize, seed: u64) -> Values<'_, u32> {
    py.detach(|| evaluate::reference_sources(points, count, seed)).into_pyarray(py)
}
