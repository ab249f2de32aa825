//! Distances and paths on a surface.

use std::path::PathBuf;

use numpy::IntoPyArray;
use pyo3::prelude::*;
use voxflat::Control;
use voxflat::adjacency::Links;
use voxflat::distortion::distances::error_of_distances;
use voxflat::geodesic::marching::{Marching, Wave};
use voxflat::geodesic::path::{PathPoint, Site, length};
use voxflat::geodesic::{Solver, exact::Exact, shortest::trace_path};
use voxflat::groups::{Linkage, between};
use voxflat::rows::DistanceRows;
use voxflat::sources::{Sources, by_curvature, cells};
use voxflat::store::Store;
use voxflat::surface::mesh::paths::{path_to_any, shortest_path};

use super::Surface;
use super::solvers::{Geodesic, with_solver};
use crate::convert::{self, Given, Table, Values};
use crate::work::{InputError, Progress, Threads, run};

/// The points (k, 3) of a path in mm, their vertices, or -1 for points on edges, and its length in mm.
type LinePath<'py> = (Table<'py, f64>, Values<'py, i64>, f64);

#[pymethods]
impl Surface {
    /// Return a hash of everything that distances depend on.
    #[pyo3(signature = (geodesic, progress=None))]
    fn fingerprint(&self, py: Python<'_>, geodesic: &str, progress: Progress<'_>) -> PyResult<u64> {
        let geodesic = Geodesic::named(geodesic)?;
        self.run(py, None, &progress, move |inner, control| {
            with_solver!(geodesic, inner, control, |solver| solver.fingerprint(control))
        })
    }

    /// Compute the missing rows of a store from sources (vertices); return the numbers of rows it had, and of damaged
    /// rows.
    #[pyo3(signature = (directory, identity, sources, geodesic="graph", threads=None, progress=None))]
    fn store_rows(
        &self, py: Python<'_>, directory: PathBuf, identity: String, sources: Given<'_, u32>, geodesic: &str,
        threads: Threads, progress: Progress<'_>,
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

    /// Create a store whose rows other processes compute; return how many rows it had, and how many were damaged.
    #[pyo3(signature = (directory, identity, rows, progress=None))]
    fn lay_out_store(
        &self, py: Python<'_>, directory: PathBuf, identity: String, rows: usize, progress: Progress<'_>,
    ) -> PyResult<(usize, usize)> {
        let columns = self.0.surface.len();
        let found =
            run(py, None, &progress, move |control| Store::create(&directory, &identity, rows, columns, control))?;
        Ok((found.rows, found.damaged))
    }

    /// Compute missing rows, by their numbers, of a part of a store: a directory with its own journal.
    #[pyo3(signature = (directory, part, identity, sources, rows, geodesic="graph", threads=None, progress=None))]
    fn store_part(
        &self, py: Python<'_>, directory: PathBuf, part: PathBuf, identity: String, sources: Given<'_, u32>,
        rows: Given<'_, u32>, geodesic: &str, threads: Threads, progress: Progress<'_>,
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

    /// Choose sources: "farthest", "curvature" or "random".
    #[pyo3(signature = (sampling, count, seed, progress=None))]
    fn choose_sources<'py>(
        &self, py: Python<'py>, sampling: &str, count: usize, seed: u64, progress: Progress<'py>,
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

    /// Divide the surface into the geodesic Voronoi cells of evenly spread sources, chosen from some points: the sources
    /// (count,), and for each point the number of its cell from 1, or 0 if no path leads to a source (N,).
    #[pyo3(signature = (points, count, seed, progress=None))]
    fn cells<'py>(
        &self, py: Python<'py>, points: Given<'py, u32>, count: usize, seed: u64, progress: Progress<'py>,
    ) -> PyResult<(Values<'py, u32>, Values<'py, u32>)> {
        let from = convert::values(&points);
        convert::check_vertices(from.iter().copied(), self.0.surface.len())?;
        let (sources, cells) = self.run(py, None, &progress, move |inner, control| {
            cells(&*inner.graph(control)?, &from, count, seed, control)
        })?;
        let cells: Vec<u32> = cells.into_iter().map(|cell| cell.wrapping_add(1)).collect();
        Ok((sources.into_pyarray(py), cells.into_pyarray(py)))
    }

    /// Return the distances (P, P) in mm between groups of vertices: "mean" or "min" over all pairs of their vertices.
    /// `members` are the vertices of all groups, and `sizes` (P,) says how many belong to each group in turn.
    #[pyo3(signature = (members, sizes, linkage, geodesic="graph", threads=None, progress=None))]
    fn distances_between<'py>(
        &self, py: Python<'py>, members: Given<'py, u32>, sizes: Given<'py, u32>, linkage: &str, geodesic: &str,
        threads: Threads, progress: Progress<'py>,
    ) -> PyResult<Table<'py, f64>> {
        let geodesic = Geodesic::named(geodesic)?;
        let linkage = match linkage {
            "mean" => Linkage::Mean,
            "min" => Linkage::Least,
            _ => return Err(InputError::new_err(format!("linkage is {linkage:?}. Pass 'mean' or 'min'"))),
        };
        let members = self.vertices(&members)?;
        let sizes = convert::values(&sizes);
        let total: usize = sizes.iter().map(|&size| size as usize).sum();
        convert::check_length(total, members.len(), "sizes", "member")?;
        let mut rest = members.into_iter();
        let groups: Vec<Vec<u32>> = sizes.iter().map(|&size| rest.by_ref().take(size as usize).collect()).collect();
        let count = groups.len();
        let found = self.run(py, threads, &progress, move |inner, control| {
            with_solver!(geodesic, inner, control, |solver| between(solver, &groups, linkage, control))
        })?;
        convert::table(py, found, count)
    }

    /// Return distance rows (m, N) in mm from sources (vertices).
    #[pyo3(signature = (sources, geodesic="graph", threads=None, progress=None))]
    fn rows<'py>(
        &self, py: Python<'py>, sources: Given<'py, u32>, geodesic: &str, threads: Threads, progress: Progress<'py>,
    ) -> PyResult<Table<'py, f32>> {
        let geodesic = Geodesic::named(geodesic)?;
        let sources = self.vertices(&sources)?;
        let rows = self.run(py, threads, &progress, move |inner, control| {
            with_solver!(geodesic, inner, control, |solver| DistanceRows::compute(solver, &sources, control))
        })?;
        convert::table(py, rows.into_data(), self.0.surface.len())
    }

    /// Return the mean relative error of a solver's distances from random vertices, compared with exact ones.
    #[pyo3(signature = (seed, geodesic="graph", threads=None, progress=None))]
    fn error_of_distances(
        &self, py: Python<'_>, seed: u64, geodesic: &str, threads: Threads, progress: Progress<'_>,
    ) -> PyResult<f64> {
        let geodesic = Geodesic::named(geodesic)?;
        self.run(py, threads, &progress, move |inner, control| {
            with_solver!(geodesic, inner, control, |solver| error_of_distances(&inner.surface, solver, seed, control))
        })
    }

    /// Return the vertices of a shortest path, including both ends, and its length in mm.
    fn path<'py>(&self, py: Python<'py>, source: u32, target: u32) -> PyResult<(Values<'py, u32>, f32)> {
        convert::check_vertices([source, target], self.0.surface.len())?;
        let (path, length) = self.run(py, Some(1), &None, move |inner, control| {
            shortest(&*inner.graph(control)?, source, target, control)
        })?;
        Ok((path.into_pyarray(py), length))
    }

    /// Return the exact shortest path: points (k, 3) in mm, their vertices, or -1 on edges, and its length in mm.
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

    /// Return a path traced back on the distances of fast marching: the same values as for an exact path.
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

    /// Return the vertices of a shortest path along edges, including both ends, and its length in mm.
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

    /// Return the cheapest path along edges from a vertex to any vertex of `to` (N), through those that `may_pass` (N).
    /// The cost of an edge is its length times the mean of the `factors` (N) of its ends.
    #[pyo3(signature = (source, to, may_pass, factors, progress=None))]
    fn edge_path_to_any<'py>(
        &self, py: Python<'py>, source: u32, to: Given<'py, bool>, may_pass: Given<'py, bool>,
        factors: Given<'py, f64>, progress: Progress<'py>,
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

/// Returns the vertices of a shortest path along links, and its length in mm.
pub fn shortest<G: Links + Solver>(
    graph: &G, source: u32, target: u32, control: &Control,
) -> voxflat::Result<(Vec<u32>, f32)> {
    let mut row = vec![0.0; graph.vertices()];
    graph.row(source, &mut row, &mut graph.scratch(), control)?;
    Ok((trace_path(graph, &row, source, target, control)?, row[target as usize]))
}
