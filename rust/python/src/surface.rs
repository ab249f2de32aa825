//! Surfaces of triangles and what is done with them.

use std::path::PathBuf;
use std::sync::{Arc, Mutex};

use ndarray::Array3;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use voxflat::adjacency::Links;
use voxflat::control::Control;
use voxflat::distortion::faces::measure_faces;
use voxflat::distortion::overlap::overlaps;
use voxflat::flatten;
use voxflat::geodesic::Solver;
use voxflat::geodesic::engine::Engine;
use voxflat::geodesic::exact::{Exact, Site};
use voxflat::geodesic::graph::GeodesicGraph;
use voxflat::geodesic::marching::{Marching, Wave};
use voxflat::geodesic::shortest::trace_path;
use voxflat::patch;
use voxflat::rows::DistanceRows;
use voxflat::sources::Sources;
use voxflat::store::Store;
use voxflat::surface::Surface as CoreSurface;
use voxflat::surface::cuts::{self, Reason};
use voxflat::surface::holes::{fill_holes, small_holes};
use voxflat::surface::loops::{Handle, cut_handles, handles};
use voxflat::surface::repair::to_genus_zero;
use voxflat::surface::thin::thin_places;
use voxflat::surface::topology::Topology;
use voxflat::surface::voxelmesh::{Kind, VoxelMesh};
use voxflat::volume::Affine;

use crate::convert;
use crate::work::{InputError, run, to_python};

type ExactPath<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<i64>>, f64);
type FromMask<'py> = (Surface, Bound<'py, PyArray2<u32>>, Bound<'py, PyDict>);

/// The solvers that measure distances on a surface.
#[derive(Clone, Copy)]
enum Geodesic {
    Graph,
    Marching(Wave),
    Exact,
}

impl Geodesic {
    fn named(name: &str) -> PyResult<Self> {
        match name {
            "graph" => Ok(Self::Graph),
            "marching" => Ok(Self::Marching(Wave::Circle)),
            "marching-plane" => Ok(Self::Marching(Wave::Plane)),
            "exact" => Ok(Self::Exact),
            _ => Err(InputError::new_err(format!("geodesic is {name:?}; give 'graph', 'marching' or 'exact'"))),
        }
    }
}

/// Evaluates an expression with the solver that a [`Geodesic`] names.
macro_rules! with_solver {
    ($geodesic:expr, $inner:expr, $control:expr, |$solver:ident| $body:expr) => {
        match $geodesic {
            Geodesic::Graph => {
                let $solver = &*$inner.graph($control)?;
                $body
            }
            Geodesic::Marching(wave) => {
                let $solver = &Marching::new(&$inner.surface, wave, $control)?;
                $body
            }
            Geodesic::Exact => {
                let $solver = &Exact::new(&$inner.surface);
                $body
            }
        }
    };
}

/// A surface of triangles with the graph that measures distances on it.
#[pyclass(frozen, module = "voxflat._core")]
pub struct Surface(Arc<Inner>);

struct Inner {
    surface: CoreSurface,
    graph: Mutex<Option<Arc<GeodesicGraph>>>,
}

impl From<CoreSurface> for Surface {
    fn from(surface: CoreSurface) -> Self {
        Self(Arc::new(Inner { surface, graph: Mutex::new(None) }))
    }
}

impl Inner {
    /// The graph, made when it is first needed.
    fn graph(&self, control: &Control) -> voxflat::Result<Arc<GeodesicGraph>> {
        let mut known = self.graph.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        if let Some(graph) = known.as_ref() {
            return Ok(Arc::clone(graph));
        }
        control.begin("joining neighbours", 1);
        let graph = Arc::new(GeodesicGraph::new(&self.surface, control)?);
        *known = Some(Arc::clone(&graph));
        Ok(graph)
    }
}

#[pymethods]
impl Surface {
    /// From points (N, 3) in mm and triangles (F, 3); with the numbers of turned faces and of unused vertices.
    #[staticmethod]
    fn from_triangles(
        py: Python<'_>,
        points: PyReadonlyArray2<'_, f64>,
        faces: PyReadonlyArray2<'_, i64>,
    ) -> PyResult<(Self, usize, usize)> {
        let points = convert::rows::<_, 3>(&points, "points")?;
        let faces = convert::rows::<_, 3>(&faces, "faces")?;
        let (surface, mended) = run(py, Some(1), None, move |_| CoreSurface::from_triangles(&points, &faces))?;
        Ok((surface.into(), mended.turned, mended.unused))
    }

    /// From a boolean (I, J, K) array and a (4, 4) affine to RAS+ mm; `level` is an image (I, J, K) and its value on the surface,
    /// `sheet` says whether it is one. With the voxel of each vertex (N, 3) and how it was made.
    #[staticmethod]
    #[pyo3(signature = (mask, affine, level=None, sheet=None, threads=None, progress=None))]
    fn from_mask<'py>(
        py: Python<'py>,
        mask: PyReadonlyArray3<'py, bool>,
        affine: [[f64; 4]; 4],
        level: Option<(PyReadonlyArray3<'py, f32>, f64)>,
        sheet: Option<bool>,
        threads: Option<usize>,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<FromMask<'py>> {
        let affine = Affine::new(affine).map_err(to_python)?;
        let mask = convert::mask(&mask)?;
        let level = level.map(|(image, value)| convert::level(&image, value)).transpose()?;
        let kind = sheet.map(|is_sheet| if is_sheet { Kind::Sheet } else { Kind::Solid });
        let mesh = run(py, threads, progress.as_ref(), move |control| {
            control.begin("finding the surface", 1);
            VoxelMesh::of(&mask, &affine, kind, level.as_ref(), control)
        })?;
        let made = PyDict::new(py);
        made.set_item("kind", if mesh.kind == Kind::Sheet { "sheet" } else { "solid" })?;
        made.set_item("split_vertices", mesh.split)?;
        made.set_item("conflicts", mesh.conflicts)?;
        let voxels = convert::array(py, &mesh.voxels)?;
        Ok((mesh.surface.into(), voxels, made))
    }

    fn __len__(&self) -> usize {
        self.0.surface.len()
    }

    /// RAS+ mm (N, 3).
    #[getter]
    fn points<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let points: Vec<[f64; 3]> = self.0.surface.points().iter().map(|&p| p.into()).collect();
        convert::array(py, &points)
    }

    /// Triangles (F, 3).
    #[getter]
    fn faces<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<u32>>> {
        convert::array(py, self.0.surface.faces())
    }

    /// The vertex of the input that each vertex is (N).
    #[getter]
    fn ids<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<u32>> {
        self.0.surface.ids().to_vec().into_pyarray(py)
    }

    /// The part of the faces whose corners are all kept (N).
    fn part(&self, keep: PyReadonlyArray1<'_, bool>) -> PyResult<Self> {
        let keep: Vec<bool> = keep.as_array().iter().copied().collect();
        if keep.len() != self.0.surface.len() {
            let message = format!("keep has {} values; the surface has {} points", keep.len(), self.0.surface.len());
            return Err(InputError::new_err(message));
        }
        Ok(self.0.surface.part_of_vertices(&keep).into())
    }

    /// The part of the faces that are kept (F).
    fn part_of_faces(&self, keep: PyReadonlyArray1<'_, bool>) -> PyResult<Self> {
        let keep: Vec<bool> = keep.as_array().iter().copied().collect();
        let faces = self.0.surface.faces().len();
        if keep.len() != faces {
            return Err(InputError::new_err(format!("keep has {} values; the surface has {faces} faces", keep.len())));
        }
        Ok(self.0.surface.part(&keep).into())
    }

    /// The geodesic disk around a vertex, and how many faces were taken in because it encloses them.
    #[pyo3(signature = (seed, radius, progress=None))]
    fn disk(
        &self,
        py: Python<'_>,
        seed: u32,
        radius: f64,
        progress: Option<Bound<'_, PyAny>>,
    ) -> PyResult<(Self, usize)> {
        let inner = Arc::clone(&self.0);
        let (part, filled) = run(py, None, progress.as_ref(), move |control| {
            let graph = inner.graph(control)?;
            patch::disk(&inner.surface, &*graph, seed, radius, control)
        })?;
        Ok((part.into(), filled))
    }

    /// The smaller side of the closed shortest path along edges through vertices, and the vertices of that path.
    #[pyo3(signature = (corners, progress=None))]
    fn polygon<'py>(
        &self,
        py: Python<'py>,
        corners: PyReadonlyArray1<'py, u32>,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<(Self, Bound<'py, PyArray1<u32>>)> {
        let corners: Vec<u32> = corners.as_array().iter().copied().collect();
        let inner = Arc::clone(&self.0);
        let polygon = move |control: &Control| patch::polygon(&inner.surface, &corners, control);
        let (part, path) = run(py, Some(1), progress.as_ref(), polygon)?;
        Ok((part.into(), path.into_pyarray(py)))
    }

    /// The component with the most faces.
    fn largest_piece(&self) -> Self {
        patch::largest_piece(&self.0.surface).into()
    }

    /// The same vertices at other points (N, 3) in mm.
    fn moved(&self, points: PyReadonlyArray2<'_, f64>) -> PyResult<Self> {
        let points = convert::rows::<_, 3>(&points, "points")?;
        self.check_length(points.len(), "points")?;
        let points = points.into_iter().map(Into::into).collect();
        Ok(self.0.surface.moved(points).map_err(to_python)?.into())
    }

    /// Components (largest first), boundary loops and what else counts the surface.
    fn topology<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let inner = Arc::clone(&self.0);
        let topology = run(py, Some(1), None, move |_| Ok(Topology::of(&inner.surface)))?;
        let dict = PyDict::new(py);
        dict.set_item("vertices", topology.vertices)?;
        dict.set_item("edges", topology.edges)?;
        dict.set_item("faces", topology.faces)?;
        dict.set_item("euler", topology.euler)?;
        dict.set_item("handles", topology.genus)?;
        let components = PyList::empty(py);
        for component in &topology.components {
            let entry = PyDict::new(py);
            entry.set_item("vertices", component.vertices)?;
            entry.set_item("faces", component.faces)?;
            entry.set_item("euler", component.euler)?;
            entry.set_item("handles", component.genus)?;
            entry.set_item("loops", component.loops)?;
            components.append(entry)?;
        }
        dict.set_item("components", components)?;
        let loops = PyList::empty(py);
        for boundary in &topology.loops {
            let entry = PyDict::new(py);
            entry.set_item("length", boundary.length)?;
            entry.set_item("vertices", boundary.vertices(&self.0.surface))?;
            loops.append(entry)?;
        }
        dict.set_item("loops", loops)?;
        Ok(dict)
    }

    /// A short loop around each handle: its vertices, length (mm) and centre (mm).
    #[pyo3(signature = (progress=None))]
    fn handles<'py>(&self, py: Python<'py>, progress: Option<Bound<'py, PyAny>>) -> PyResult<Bound<'py, PyList>> {
        let inner = Arc::clone(&self.0);
        let found = run(py, None, progress.as_ref(), move |control| handles(&inner.surface, control))?;
        handle_list(py, &found)
    }

    /// The surface cut open along a short loop around each handle, and these.
    #[pyo3(signature = (progress=None))]
    fn cut_handles<'py>(
        &self,
        py: Python<'py>,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<(Self, Bound<'py, PyList>)> {
        let inner = Arc::clone(&self.0);
        let (cut, found) = run(py, None, progress.as_ref(), move |control| cut_handles(&inner.surface, control))?;
        Ok((cut.into(), handle_list(py, &found)?))
    }

    /// The surface cut open along paths of neighbouring vertices.
    fn cut(&self, paths: Vec<Vec<u32>>) -> PyResult<Self> {
        convert::check_vertices(paths.iter().flatten().copied(), self.0.surface.len())?;
        Ok(cuts::cut(&self.0.surface, &paths).map_err(to_python)?.into())
    }

    /// The surface cut open to a disk, and the cuts: vertices, length (mm) and reason.
    #[pyo3(signature = (progress=None))]
    fn open_to_disk<'py>(
        &self,
        py: Python<'py>,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<(Self, Bound<'py, PyList>)> {
        let inner = Arc::clone(&self.0);
        let opened = run(py, None, progress.as_ref(), move |control| cuts::open_to_disk(&inner.surface, control))?;
        let list = PyList::empty(py);
        for cut in opened.cuts {
            let entry = PyDict::new(py);
            entry.set_item("vertices", cut.vertices.into_pyarray(py))?;
            entry.set_item("length", cut.length)?;
            entry.set_item(
                "reason",
                match cut.reason {
                    Reason::Handle => "handle",
                    Reason::JoinBoundaries => "boundaries joined",
                    Reason::Sphere => "closed sphere",
                },
            )?;
            list.append(entry)?;
        }
        Ok((opened.surface.into(), list))
    }

    /// The surface with its boundary loops up to a length (mm) filled, all but the longest; with the numbers of loops that
    /// were filled and that could not be.
    #[pyo3(signature = (longest, progress=None))]
    fn fill_holes(
        &self,
        py: Python<'_>,
        longest: f64,
        progress: Option<Bound<'_, PyAny>>,
    ) -> PyResult<(Self, usize, usize)> {
        let inner = Arc::clone(&self.0);
        let (filled, holes) = run(py, Some(1), progress.as_ref(), move |control| {
            let holes = small_holes(&inner.surface, longest);
            Ok((fill_holes(&inner.surface, &holes, control)?, holes.len()))
        })?;
        Ok((filled.surface.into(), holes - filled.left.len(), filled.left.len()))
    }

    /// Places where the solid is thinner than `thickness` mm: number of vertices, and of the worst its vertex and thickness.
    #[pyo3(signature = (thickness, progress=None))]
    fn thin_places(
        &self,
        py: Python<'_>,
        thickness: f64,
        progress: Option<Bound<'_, PyAny>>,
    ) -> PyResult<(usize, Option<(u32, f64)>)> {
        let inner = Arc::clone(&self.0);
        let thin = run(py, None, progress.as_ref(), move |control| thin_places(&inner.surface, thickness, control))?;
        Ok((thin.vertices.len(), thin.worst.map(|worst| (worst.vertices[0], worst.thickness))))
    }

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

    /// The memory in bytes that flattening needs at most, with rows in memory or in a store.
    #[pyo3(signature = (sources, threads, stored=false))]
    fn memory_need(&self, sources: usize, threads: usize, stored: bool) -> u64 {
        flatten::surface_memory_need(self.0.surface.len(), sources, threads, stored)
    }

    /// A hash of what distances depend on.
    #[pyo3(signature = (geodesic, progress=None))]
    fn fingerprint(&self, py: Python<'_>, geodesic: &str, progress: Option<Bound<'_, PyAny>>) -> PyResult<u64> {
        let geodesic = Geodesic::named(geodesic)?;
        let inner = Arc::clone(&self.0);
        run(py, None, progress.as_ref(), move |control| {
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
        sources: PyReadonlyArray1<'_, u32>,
        geodesic: &str,
        threads: Option<usize>,
        progress: Option<Bound<'_, PyAny>>,
    ) -> PyResult<(usize, usize)> {
        let geodesic = Geodesic::named(geodesic)?;
        let sources: Vec<u32> = sources.as_array().iter().copied().collect();
        convert::check_vertices(sources.iter().copied(), self.0.surface.len())?;
        let inner = Arc::clone(&self.0);
        let found = run(py, threads, progress.as_ref(), move |control| {
            with_solver!(geodesic, inner, control, |solver| {
                Ok(Store::compute(&directory, &identity, solver, &sources, control)?.found())
            })
        })?;
        Ok((found.rows, found.damaged))
    }

    /// Number of links of the graph, each counted from both ends.
    #[pyo3(signature = (progress=None))]
    fn links(&self, py: Python<'_>, progress: Option<Bound<'_, PyAny>>) -> PyResult<usize> {
        let inner = Arc::clone(&self.0);
        run(py, None, progress.as_ref(), move |control| Ok(inner.graph(control)?.links()))
    }

    /// Chooses sources: "farthest" or "random".
    #[pyo3(signature = (sampling, count, seed, progress=None))]
    fn choose_sources<'py>(
        &self,
        py: Python<'py>,
        sampling: &str,
        count: usize,
        seed: u64,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyArray1<u32>>> {
        let sources = convert::sources(sampling, count, seed)?;
        let inner = Arc::clone(&self.0);
        let chosen = run(py, None, progress.as_ref(), move |control| sources.choose(&*inner.graph(control)?, control))?;
        Ok(chosen.into_pyarray(py))
    }

    /// Distance rows (m, N) in mm from sources (vertices).
    #[pyo3(signature = (sources, geodesic="graph", threads=None, progress=None))]
    fn rows<'py>(
        &self,
        py: Python<'py>,
        sources: PyReadonlyArray1<'py, u32>,
        geodesic: &str,
        threads: Option<usize>,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let geodesic = Geodesic::named(geodesic)?;
        let sources: Vec<u32> = sources.as_array().iter().copied().collect();
        convert::check_vertices(sources.iter().copied(), self.0.surface.len())?;
        let inner = Arc::clone(&self.0);
        let rows = run(py, threads, progress.as_ref(), move |control| {
            with_solver!(geodesic, inner, control, |solver| DistanceRows::compute(solver, &sources, control))
        })?;
        convert::table(py, rows.into_data(), self.0.surface.len())
    }

    /// The vertices of a shortest path, both ends included, and its length in mm.
    fn path<'py>(&self, py: Python<'py>, source: u32, target: u32) -> PyResult<(Bound<'py, PyArray1<u32>>, f32)> {
        convert::check_vertices([source, target], self.0.surface.len())?;
        let inner = Arc::clone(&self.0);
        let (path, length) = run(py, Some(1), None, move |control| {
            let graph = &*inner.graph(control)?;
            let mut row = vec![0.0; graph.vertices()];
            graph.row(source, &mut row, &mut graph.scratch(), control)?;
            Ok((trace_path(graph, &row, source, target)?, row[target as usize]))
        })?;
        Ok((path.into_pyarray(py), length))
    }

    /// The exact shortest path: its points (k, 3) in mm, the vertices they lie at, or -1 for those on edges, and its length
    /// in mm.
    fn exact_path<'py>(&self, py: Python<'py>, source: u32, target: u32) -> PyResult<ExactPath<'py>> {
        convert::check_vertices([source, target], self.0.surface.len())?;
        let inner = Arc::clone(&self.0);
        let (path, length) = run(py, Some(1), None, move |control| {
            let exact = Exact::new(&inner.surface);
            let (mut wave, mut row) = (exact.scratch(), vec![0.0; inner.surface.len()]);
            exact.distances(source, &mut row, &mut wave, control)?;
            let mut path = exact.path(&wave, target)?;
            path.reverse();
            Ok((path, row[target as usize]))
        })?;
        let points: Vec<[f64; 3]> = path.iter().map(|passed| passed.point.into()).collect();
        let vertex = |site| if let Site::Vertex(vertex) = site { i64::from(vertex) } else { -1 };
        let vertices: Vec<i64> = path.iter().map(|passed| vertex(passed.site)).collect();
        Ok((convert::array(py, &points)?, vertices.into_pyarray(py), length))
    }

    /// The vertices of a shortest path along edges, both ends included, and its length in mm.
    fn edge_path<'py>(&self, py: Python<'py>, source: u32, target: u32) -> PyResult<(Bound<'py, PyArray1<u32>>, f64)> {
        convert::check_vertices([source, target], self.0.surface.len())?;
        let inner = Arc::clone(&self.0);
        let (path, length) = run(py, Some(1), None, move |control| {
            let path = cuts::shortest_path(&inner.surface, &[source, target], None, control)?;
            let points = inner.surface.points();
            let steps = path.windows(2).map(|two| (points[two[0] as usize] - points[two[1] as usize]).norm());
            let length = steps.sum::<f64>();
            Ok((path, length))
        })?;
        Ok((path.into_pyarray(py), length))
    }

    /// Flattens from sources (vertices), by rows in memory or in a store: its directory and identity.
    #[pyo3(signature = (sources, seed, threads=None, progress=None, store=None))]
    fn voxflat<'py>(
        &self,
        py: Python<'py>,
        sources: PyReadonlyArray1<'py, u32>,
        seed: u64,
        threads: Option<usize>,
        progress: Option<Bound<'py, PyAny>>,
        store: Option<(PathBuf, String)>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let given = Sources::Given(sources.as_array().iter().map(|&vertex| vertex as usize).collect());
        let inner = Arc::clone(&self.0);
        let (map, found) = run(py, threads, progress.as_ref(), move |control| {
            let (surface, graph) = (&inner.surface, &*inner.graph(control)?);
            let Some((directory, identity)) = store else {
                return Ok((flatten::voxflat(surface, graph, &given, seed, control)?, None));
            };
            let store = (directory.as_path(), identity.as_str());
            let (map, found) = flatten::voxflat_stored(surface, graph, &given, store, seed, control)?;
            Ok((map, Some(found)))
        })?;
        let dict = convert::map_dict(py, map)?;
        dict.set_item("found", found.map(|found| (found.rows, found.damaged)))?;
        Ok(dict)
    }
}

impl Surface {
    fn check_length(&self, given: usize, name: &str) -> PyResult<()> {
        let points = self.0.surface.len();
        if given == points {
            return Ok(());
        }
        Err(InputError::new_err(format!("{name} has {given} rows; the surface has {points} points")))
    }
}

fn handle_list<'py>(py: Python<'py>, handles: &[Handle]) -> PyResult<Bound<'py, PyList>> {
    let list = PyList::empty(py);
    for handle in handles {
        let entry = PyDict::new(py);
        entry.set_item("vertices", &handle.vertices)?;
        entry.set_item("length", handle.length)?;
        entry.set_item("centre", [handle.centre.x, handle.centre.y, handle.centre.z])?;
        list.append(entry)?;
    }
    Ok(list)
}

/// What is wrong with a mesh: for each defect where it is.
#[pyfunction]
pub fn defects<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f64>,
    faces: PyReadonlyArray2<'py, i64>,
) -> PyResult<Bound<'py, PyDict>> {
    let points = convert::rows::<_, 3>(&points, "points")?;
    let faces = convert::rows::<_, 3>(&faces, "faces")?;
    let found = run(py, Some(1), None, move |_| CoreSurface::defects(&points, &faces))?;
    let dict = PyDict::new(py);
    dict.set_item("triangles without area", found.degenerate)?;
    dict.set_item("triangles given twice", found.duplicate)?;
    dict.set_item("edges of more than two triangles", found.crowded_edges)?;
    dict.set_item("vertices where sheets touch", found.pinched)?;
    dict.set_item("one-sided components", found.one_sided)?;
    dict.set_item("triangles turned over", found.turned)?;
    dict.set_item("vertices at the same place as another", found.coincident)?;
    Ok(dict)
}

/// Makes a mask's surface a sphere: the mask, and what was changed.
#[pyfunction]
#[pyo3(signature = (mask, spacing, probability=None, progress=None))]
pub fn repair<'py>(
    py: Python<'py>,
    mask: PyReadonlyArray3<'py, bool>,
    spacing: [f64; 3],
    probability: Option<PyReadonlyArray3<'py, f32>>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<(Bound<'py, PyArray3<bool>>, Bound<'py, PyDict>)> {
    let mask = convert::mask(&mask)?;
    let shape = mask.shape();
    let probability: Option<Vec<f32>> = probability.map(|image| image.as_array().iter().copied().collect());
    let repaired = run(py, None, progress.as_ref(), move |control| {
        to_genus_zero(&mask, spacing, probability.as_deref(), control)
    })?;
    let inside = Array3::from_shape_vec(shape, repaired.mask.values().to_vec());
    let inside = inside.map_err(|error| InputError::new_err(error.to_string()))?;
    let dict = PyDict::new(py);
    dict.set_item("handles", repaired.handles)?;
    dict.set_item("considered", repaired.considered)?;
    for (name, voxels) in [
        ("cut", &repaired.cut),
        ("filled", &repaired.filled),
        ("dropped", &repaired.dropped),
        ("cavities", &repaired.cavities),
    ] {
        dict.set_item(name, convert::array(py, voxels)?)?;
    }
    Ok((inside.into_pyarray(py), dict))
}
