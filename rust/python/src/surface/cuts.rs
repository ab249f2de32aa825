//! The topology of a surface, and its cuts.

use numpy::IntoPyArray;
use pyo3::prelude::*;
use pyo3::types::IntoPyDict;
use voxflat::flatten::relaxation::{Relaxation, relax};
use voxflat::surface::cuts::cones::cone_points;
use voxflat::surface::cuts::holes::{fill_holes, small_holes};
use voxflat::surface::cuts::{self, Cut, Reason};
use voxflat::surface::topology::loops::{Handle, cut_handles, handles};
use voxflat::surface::topology::{Component, Loop, Topology, thin::thin_places};

use super::Surface;
use crate::convert::{self, Dict, List, dict};
use crate::work::{Progress, Threads};

#[pymethods]
impl Surface {
    /// Return the components (a record array, largest first), the boundary loops and the counts of the surface.
    #[pyo3(signature = (progress=None))]
    fn topology<'py>(&self, py: Python<'py>, progress: Progress<'py>) -> PyResult<Dict<'py>> {
        let (topology, boundary) = self.run(py, Some(1), &progress, move |inner, _| {
            let topology = Topology::of(&inner.surface);
            let boundary: Vec<_> = topology.loops.iter().map(|one| one.vertices(&inner.surface)).collect();
            Ok((topology, boundary))
        })?;
        let column =
            |of: fn(&Component) -> usize| topology.components.iter().map(of).collect::<Vec<_>>().into_pyarray(py);
        let columns = (
            topology.components.iter().map(|one| one.area).collect::<Vec<_>>().into_pyarray(py),
            column(|one| one.vertices),
            column(|one| one.faces),
            topology.components.iter().map(|one| one.euler).collect::<Vec<_>>().into_pyarray(py),
            column(|one| one.genus),
            column(|one| one.loops),
        );
        let names = [("names", "area,vertices,faces,euler,handles,loops")].into_py_dict(py)?;
        let components = py.import("numpy")?.getattr("rec")?.call_method("fromarrays", (columns,), Some(&names))?;
        let loops = topology.loops.iter().zip(boundary);
        let loop_dict = |(of, vertices): (&Loop, Vec<u32>)| Ok(dict!(py, "length" = of.length, "vertices" = vertices));
        let loops: List<'py> = loops.map(loop_dict).collect::<PyResult<_>>()?;
        Ok(dict!(
            py,
            "vertices" = topology.vertices,
            "edges" = topology.edges,
            "faces" = topology.faces,
            "euler" = topology.euler,
            "handles" = topology.genus,
            "components" = components,
            "loops" = loops
        ))
    }

    /// Return a short loop around each handle: its vertices, length (mm) and centre (mm).
    #[pyo3(signature = (threads=None, progress=None))]
    fn handles<'py>(&self, py: Python<'py>, threads: Threads, progress: Progress<'py>) -> PyResult<List<'py>> {
        let found = self.run(py, threads, &progress, move |inner, control| handles(&inner.surface, control))?;
        handle_list(py, &found)
    }

    /// Cut the surface open along a short loop around each handle; return it and the loops.
    #[pyo3(signature = (threads=None, progress=None))]
    fn cut_handles<'py>(
        &self, py: Python<'py>, threads: Threads, progress: Progress<'py>,
    ) -> PyResult<(Self, List<'py>)> {
        let (cut, found) =
            self.run(py, threads, &progress, move |inner, control| cut_handles(&inner.surface, control))?;
        Ok((cut.into(), handle_list(py, &found)?))
    }

    /// Cut the surface open along paths of neighbouring vertices.
    fn cut(&self, py: Python<'_>, paths: Vec<Vec<u32>>) -> PyResult<Self> {
        convert::check_vertices(paths.iter().flatten().copied(), self.0.surface.len())?;
        self.run(py, Some(1), &None, move |inner, _| Ok(cuts::cut(&inner.surface, &paths)?.into()))
    }

    /// Return the vertices that hold most of the curvature; none if they are many.
    fn cone_points(&self, py: Python<'_>) -> PyResult<Vec<u32>> {
        self.run(py, Some(1), &None, |inner, _| Ok(cone_points(&inner.surface)))
    }

    /// Cut the surface open to a disk with these vertices on its boundary; return it and the cuts: vertices, length
    /// (mm) and reason.
    #[pyo3(signature = (points, threads=None, progress=None))]
    fn open_to_disk<'py>(
        &self, py: Python<'py>, points: Vec<u32>, threads: Threads, progress: Progress<'py>,
    ) -> PyResult<(Self, List<'py>)> {
        convert::check_vertices(points.iter().copied(), self.0.surface.len())?;
        let opened = self.run(py, threads, &progress, move |inner, control| {
            cuts::open_to_disk_through(&inner.surface, &points, control)
        })?;
        Ok((opened.surface.into(), cut_list(py, opened.cuts)?))
    }

    /// Add relaxation cuts to a disk, of the given total length or as long as they pay. None are made if the distance
    /// error is at most `bearable`, or if they reduce it by less than `least_relief`. They stay within a distance (mm)
    /// of existing cuts. Also returns the cuts, and the error of a coarse map without and with them.
    #[pyo3(signature = (length=None, least_relief=0.0, bearable=0.0, within=None, threads=None, progress=None))]
    fn relax<'py>(
        &self, py: Python<'py>, length: Option<f64>, least_relief: f64, bearable: f64, within: Option<f64>,
        threads: Threads, progress: Progress<'py>,
    ) -> PyResult<(Self, List<'py>, [f64; 2])> {
        let relaxation = match length {
            None => Relaxation { least_relief, bearable, ..Relaxation::default() },
            Some(length) => Relaxation { length, least_gain: 0.0, least_relief, bearable, ..Relaxation::default() },
        };
        let relaxation = Relaxation { within: within.unwrap_or(f64::INFINITY), ..relaxation };
        let relaxed =
            self.run(py, threads, &progress, move |inner, control| relax(&inner.surface, relaxation, control))?;
        Ok((relaxed.surface.into(), cut_list(py, relaxed.cuts)?, relaxed.errors))
    }

    /// Fill the boundary loops up to a length (mm), except the longest one; return the surface and the numbers of loops
    /// that were filled and that could not be filled.
    #[pyo3(signature = (longest, progress=None))]
    fn fill_holes(&self, py: Python<'_>, longest: f64, progress: Progress<'_>) -> PyResult<(Self, usize, usize)> {
        let (filled, holes) = self.run(py, Some(1), &progress, move |inner, control| {
            let holes = small_holes(&inner.surface, longest);
            Ok((fill_holes(&inner.surface, &holes, control)?, holes.len()))
        })?;
        Ok((filled.surface.into(), holes - filled.left.len(), filled.left.len()))
    }

    /// Find parts thinner than `thickness` mm; return their number of vertices, and the thinnest vertex and its
    /// thickness.
    #[pyo3(signature = (thickness, threads=None, progress=None))]
    fn thin_places(
        &self, py: Python<'_>, thickness: f64, threads: Threads, progress: Progress<'_>,
    ) -> PyResult<(usize, Option<(u32, f64)>)> {
        let thin =
            self.run(py, threads, &progress, move |inner, control| thin_places(&inner.surface, thickness, control))?;
        Ok((thin.vertices.len(), thin.worst.map(|worst| (worst.vertices[0], worst.thickness))))
    }
}

fn handle_list<'py>(py: Python<'py>, handles: &[Handle]) -> PyResult<List<'py>> {
    let handle_dict = |handle: &Handle| {
        let centre: [f64; 3] = handle.centre.into();
        Ok(dict!(py, "vertices" = &handle.vertices, "length" = handle.length, "centre" = centre))
    };
    handles.iter().map(handle_dict).collect()
}

fn cut_list(py: Python<'_>, cuts: Vec<Cut>) -> PyResult<List<'_>> {
    let cut_dict = |cut: Cut| {
        let reason = match cut.reason {
            Reason::Handle => "handle",
            Reason::JoinBoundaries => "boundaries joined",
            Reason::ConePoint => "cone point",
            Reason::Sphere => "closed sphere",
            Reason::Relaxation => "relaxation",
        };
        Ok(dict!(py, "vertices" = cut.vertices.into_pyarray(py), "length" = cut.length, "reason" = reason))
    };
    cuts.into_iter().map(cut_dict).collect()
}
