//! Distances on a surface, and paths.

use std::path::PathBuf;

use numpy::IntoPyArray;
use pyo3::prelude::*;
use voxflat::adjacency::Links;
use voxflat::control::Control;
use voxflat::distortion::distances::error_of_distances;
use voxflat::geodesic::Solver;
use voxflat::geodesic::exact::Exact;
use voxflat::geodesic::marching::{Marching, Wave};
use voxflat::geodesic::path::{PathPoint, Site, length};
use voxflat::geodesic::shortest::trace_path;
use voxflat::rows::DistanceRows;
use voxflat::sources::{Sources, by_curvature};
use voxflat::store::Store;
use voxflat::surface::mesh::paths::{path_to_any, shortest_path};

use super::Surface;
use super::solvers::{Geodesic, with_solver};
use crate::convert::{self, Given, Table, Values};
use crate::work::{Progress, Threads, run};

/// The points (k, 3) of a path in mm, the vertices they lie at, or -1 for those on edges, and its length in mm.
type LinePath<'py> = (Table<'py, f64>, Values<'py, i64>, f64);

#[pymethods]
impl Surface {
    /// A hash of what distances depend on.
    #[pyo3(signature = (geodesic, progress=None))]
    fn fingerprint(&self, py: Python<'_>, geodesic: &str, progress: Progress<'_>) -> PyResult<u64> {
        let geodesic = Geodesic::named(geodesic)?;
        self.run(py, None, &progress, move |inner, control| {
            with_solver!(geodesic, inner, control, |solver| solver.fingerprint(control))
        })
    }

    /// Computes what a store lacks of the rows from sources (vertices): how many rows it had, and how many were damaged.
    #[pyo3(signature = (directory, identity, sources, geodesic="graph", threads=None, progress=None))]
    #[allow(clippy::too_many_arguments)] // Python's, by name
    fn store_rows(
        &self,
        py: Python<'_>,
        directory: PathBuf,
        identity: String,
        sources: Given<'_, u32>,
        geodesic: &str,
        threads: Threads,
        progress: Progress<'_>,
    ) -> PyResult<(usize, usize)> {
        let geodesic = Geodesic::named(geodesic)?;
        let sources = self.vertices(&sources)?;
        let found = self.run(py, threads, &progress, move |inner, control| {
            with_solver!(geodesic, inner, control, |solver| {
                Ok(Store::compute(&directory, &identity, solver, &sources, control)?.found())
            })
        })?;
        Ok((found.rows, found.damaged))
    }

    /// Makes a store of so many rows that others compute: how many it had, and how many were damaged.
    #[pyo3(signature = (directory, identity, rows, progress=None))]
    fn lay_out_store(
        &self,
        py: Python<'_>,
        directory: PathBuf,
        identity: String,
        rows: usize,
        progress: Progress<'_>,
    ) -> PyResult<(usize, usize)> {
        let columns = self.0.surface.len();
        let found =
            run(py, None, &progress, move |control| Store::lay_out(&directory, &identity, rows, columns, control))?;
        Ok((found.rows, found.damaged))
    }

    /// Computes those of some rows, by their numbers, that a part of a store lacks: a directory with a journal of its own.
    #[pyo3(signature = (directory, part, identity, sources, rows, geodesic="graph", threads=None, progress=None))]
    #[allow(clippy::too_many_arguments)] // Python's, by name
    fn store_part(
        &self,
        py: Python<'_>,
        directory: PathBuf,
        part: PathBuf,
        identity: String,
        sources: Given<'_, u32>,
        rows: Given<'_, u32>,
        geodesic: &str,
        threads: Threads,
        progress: Progress<'_>,
    ) -> PyResult<()> {
        let geodesic = Geodesic::named(geodesic)?;
        let sources = self.vertices(&sources)?;
        let rows = convert::values(&rows);
        convert::check_vertices(rows.iter().copied(), sources.len())?;
        self.run(py, threads, &progress, move |inner, control| {
            with_solver!(geodesic, inner, control, |solver| Store::compute_part(
                &directory, &part, &identity, solver, &sources, &rows, control
            ))
        })
    }

    /// Number of links of the graph, each counted from both ends.
    #[pyo3(signature = (progress=None))]
    fn links(&self, py: Python<'_>, progress: Progress<'_>) -> PyResult<usize> {
        self.run(py, None, &progress, move |inner, control| Ok(inner.graph(control)?.links()))
    }

    /// Chooses sources: "farthest", "curvature" or "random".
    #[pyo3(signature = (sampling, count, seed, progress=None))]
    fn choose_sources<'py>(
        &self,
        py: Python<'py>,
        sampling: &str,
        count: usize,
        seed: u64,
        progress: Progress<'py>,
    ) -> PyResult<Values<'py, u32>> {
        let named = match sampling {
            "curvature" => None,
            _ => Some(convert::sources(sampling, count, seed, "'farthest', 'curvature' or 'random'")?),
        };
        let chosen = self.run(py, None, &progress, move |inner, control| {
            let by_curvature = || Sources::Weighted { count, seed, weights: by_curvature(&inner.surface, count) };
            let sources = named.unwrap_or_else(by_curvature);
            sources.choose(&*inner.graph(control)?, control)
        })?;
        Ok(chosen.into_pyarray(py))
    }

    /// Distance rows (m, N) in mm from sources (vertices).
    #[pyo3(signature = (sources, geodesic="graph", threads=None, progress=None))]
    fn rows<'py>(
        &self,
        py: Python<'py>,
        sources: Given<'py, u32>,
        geodesic: &str,
        threads: Threads,
        progress: Progress<'py>,
    ) -> PyResult<Table<'py, f32>> {
        let geodesic = Geodesic::named(geodesic)?;
        let sources = self.vertices(&sources)?;
        let rows = self.run(py, threads, &progress, move |inner, control| {
            with_solver!(geodesic, inner, control, |solver| DistanceRows::compute(solver, &sources, control))
        })?;
        convert::table(py, rows.into_data(), self.0.surface.len())
    }

    /// By which part of themselves a solver's distances from random vertices are off from exact ones, on average.
    #[pyo3(signature = (seed, geodesic="graph", threads=None, progress=None))]
    fn error_of_distances(
        &self,
        py: Python<'_>,
        seed: u64,
        geodesic: &str,
        threads: Threads,
        progress: Progress<'_>,
    ) -> PyResult<f64> {
        let geodesic = Geodesic::named(geodesic)?;
        self.run(py, threads, &progress, move |inner, control| {
            with_solver!(geodesic, inner, control, |solver| error_of_distances(&inner.surface, solver, seed, control))
        })
    }

    /// The vertices of a shortest path, both ends included, and its length in mm.
    fn path<'py>(&self, py: Python<'py>, source: u32, target: u32) -> PyResult<(Values<'py, u32>, f32)> {
        convert::check_vertices([source, target], self.0.surface.len())?;
        let (path, length) = self.run(py, Some(1), &None, move |inner, control| {
            shortest(&*inner.graph(control)?, source, target, control)
        })?;
        Ok((path.into_pyarray(py), length))
    }

    /// The exact shortest path: its points (k, 3) in mm, the vertices they lie at, or -1 for those on edges, and its length
    /// in mm.
    fn exact_path<'py>(&self, py: Python<'py>, source: u32, target: u32) -> PyResult<LinePath<'py>> {
        convert::check_vertices([source, target], self.0.surface.len())?;
        let (path, length) = self.run(py, Some(1), &None, move |inner, control| {
            let exact = Exact::new(&inner.surface);
            let (mut wave, mut row) = (exact.scratch(), vec![0.0; inner.surface.len()]);
            exact.distances(source, &mut row, &mut wave, control)?;
            let mut path = exact.path(&wave, target, control)?;
            path.reverse();
            Ok((path, row[target as usize]))
        })?;
        line_path(py, &path, length)
    }

    /// A path traced back on the distances of fast marching, and the length of that line: the same values as an exact path.
    fn marching_path<'py>(&self, py: Python<'py>, source: u32, target: u32) -> PyResult<LinePath<'py>> {
        convert::check_vertices([source, target], self.0.surface.len())?;
        let path = self.run(py, Some(1), &None, move |inner, control| {
            let marching = Marching::new(&inner.surface, Wave::Circle, control)?;
            let mut path = marching.march(source, control)?.path(target, control)?;
            path.reverse();
            Ok(path)
        })?;
        line_path(py, &path, length(&path))
    }

    /// The vertices of a shortest path along edges, both ends included, and its length in mm.
    fn edge_path<'py>(&self, py: Python<'py>, source: u32, target: u32) -> PyResult<(Values<'py, u32>, f64)> {
        convert::check_vertices([source, target], self.0.surface.len())?;
        let (path, length) = self.run(py, Some(1), &None, move |inner, control| {
            let path = shortest_path(&inner.surface, &[source, target], None, control)?;
            let points = inner.surface.points();
            let steps = path.windows(2).map(|two| (points[two[0] as usize] - points[two[1] as usize]).norm());
            let length = steps.sum::<f64>();
            Ok((path, length))
        })?;
        Ok((path.into_pyarray(py), length))
    }

    /// The cheapest path along edges from a vertex to any of those `to` (N), through those that `may_pass` (N); an edge costs its
    /// length times the mean of its ends' `factors` (N).
    #[pyo3(signature = (source, to, may_pass, factors, progress=None))]
    fn edge_path_to_any<'py>(
        &self,
        py: Python<'py>,
        source: u32,
        to: Given<'py, bool>,
        may_pass: Given<'py, bool>,
        factors: Given<'py, f64>,
        progress: Progress<'py>,
    ) -> PyResult<Values<'py, u32>> {
        let to = convert::values(&to);
        let may_pass = convert::values(&may_pass);
        let factors = convert::values(&factors);
        for (given, name) in [(to.len(), "to"), (may_pass.len(), "may_pass"), (factors.len(), "factors")] {
            self.check_length(given, name)?;
        }
        let path = self.run(py, Some(1), &progress, move |inner, control| {
            path_to_any(&inner.surface, source, &to, &may_pass, &factors, control)
        })?;
        Ok(path.into_pyarray(py))
    }
}

fn line_path<'py>(py: Python<'py>, path: &[PathPoint], length: f64) -> PyResult<LinePath<'py>> {
    let points: Vec<[f64; 3]> = path.iter().map(|passed| passed.point.into()).collect();
    let vertex = |site| if let Site::Vertex(vertex) = site { i64::from(vertex) } else { -1 };
    let vertices: Vec<i64> = path.iter().map(|passed| vertex(passed.site)).collect();
    Ok((convert::array(py, &points)?, vertices.into_pyarray(py), length))
}

/// The vertices of a shortest path along links, and its length in mm.
pub fn shortest<G: Links + Solver>(
    graph: &G,
    source: u32,
    target: u32,
    control: &Control,
) -> voxflat::Result<(Vec<u32>, f32)> {
    let mut row = vec![0.0; graph.vertices()];
    graph.row(source, &mut row, &mut graph.scratch(), control)?;
    Ok((trace_path(graph, &row, source, target, control)?, row[target as usize]))
}
