//! Surfaces of triangles and their methods.

mod cuts;
pub mod distances;
pub mod maps;
pub mod measure;
mod patches;
mod solvers;
pub mod spheres;

use std::sync::{Arc, Mutex};

use ndarray::Array3;
use numpy::{IntoPyArray, PyArray3};
use pyo3::prelude::*;
use voxflat::geodesic::graph::GeodesicGraph;
use voxflat::surface::voxels::repair::{component_sizes as count_components, to_genus_zero};
use voxflat::surface::voxels::sheets;
use voxflat::surface::voxels::voxelmesh::{Kind, VoxelMesh};
use voxflat::surface::{Surface as CoreSurface, mesh};
use voxflat::volume::Affine;
use voxflat::{Control, patch};

use crate::convert::{self, Dict, Given, GivenImage, GivenTable, Table, Values, dict};
use crate::work::{InputError, Progress, Threads, run, run_on, to_python};

type Parts<'py> = (Table<'py, f64>, Table<'py, u32>, Table<'py, u32>, Values<'py, u32>);
type FromMask<'py> = (Surface, Table<'py, u32>, Dict<'py>);

/// A surface of triangles, with the graph for distances on it.
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
    /// Returns the graph, which is created when it is first needed.
    fn graph(&self, control: &Control) -> voxflat::Result<Arc<GeodesicGraph>> {
        let mut known = self.graph.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        if let Some(graph) = known.as_ref() {
            return Ok(Arc::clone(graph));
        }
        let graph = Arc::new(GeodesicGraph::new(&self.surface, control)?);
        *known = Some(Arc::clone(&graph));
        Ok(graph)
    }
}

#[pymethods]
impl Surface {
    /// Restore a surface from its points (N, 3), triangles (F, 3), the half-edges on the other side (F, 3) and ids (N).
    #[new]
    fn new(
        py: Python<'_>, points: GivenTable<'_, f64>, faces: GivenTable<'_, u32>, twins: GivenTable<'_, u32>,
        ids: Given<'_, u32>,
    ) -> PyResult<Self> {
        let points = convert::rows::<_, 3>(&points, "points")?;
        let faces = convert::rows::<_, 3>(&faces, "faces")?;
        let twins = convert::rows::<_, 3>(&twins, "twins")?.into_flattened();
        let ids = convert::values(&ids);
        run(py, Some(1), &None, move |_| {
            let points: Vec<_> = points.into_iter().map(Into::into).collect();
            Ok(CoreSurface::restored(&points, &faces, twins, &ids)?.into())
        })
    }

    /// The arguments with which a copy is made in another process.
    fn __getnewargs__<'py>(&self, py: Python<'py>) -> PyResult<Parts<'py>> {
        let surface = &self.0.surface;
        let twins = convert::table(py, surface.twins().to_vec(), 3)?;
        Ok((self.points(py)?, self.faces(py)?, twins, self.ids(py)))
    }

    /// Create a surface from points (N, 3) in mm and triangles (F, 3); also return its repairs. Defects are errors
    /// unless `mend` is true.
    #[staticmethod]
    #[pyo3(signature = (points, faces, mend=false))]
    fn from_triangles<'py>(
        py: Python<'py>, points: GivenTable<'py, f64>, faces: GivenTable<'py, i64>, mend: bool,
    ) -> PyResult<(Self, Dict<'py>)> {
        let points = convert::rows::<_, 3>(&points, "points")?;
        let faces = convert::rows::<_, 3>(&faces, "faces")?;
        let make = if mend { CoreSurface::repaired } else { CoreSurface::from_triangles };
        let (surface, repaired) = run(py, Some(1), &None, move |_| make(&points, &faces))?;
        let dict = dict!(
            py,
            "turned" = repaired.turned,
            "unused" = repaired.unused,
            "merged" = convert::array(py, &repaired.merged)?,
            "dropped" = repaired.dropped,
            "flipped" = repaired.flipped,
            "duplicates" = repaired.duplicates,
            "split" = repaired.split,
            "crowded_edges" = repaired.crowded_edges,
            "missing" = repaired.missing,
            "incomplete" = repaired.incomplete
        );
        Ok((surface.into(), dict))
    }

    /// Create a surface from a boolean (I, J, K) array and a (4, 4) affine to RAS+ mm. `level` is an image (I, J, K)
    /// and its value on the surface; `sheet` is whether the label is a voxel sheet. Also return the voxel of each vertex
    /// (N, 3) and details.
    #[staticmethod]
    #[pyo3(signature = (mask, affine, level=None, sheet=None, threads=None, progress=None))]
    fn from_mask<'py>(
        py: Python<'py>, mask: GivenImage<'py, bool>, affine: [[f64; 4]; 4],
        level: Option<(GivenImage<'py, f32>, f64)>, sheet: Option<bool>, threads: Threads, progress: Progress<'py>,
    ) -> PyResult<FromMask<'py>> {
        let affine = Affine::new(affine).map_err(to_python)?;
        let mask = convert::mask(&mask)?;
        let level = level.map(|(image, value)| convert::level(&image, value)).transpose()?;
        let kind = sheet.map(|is_sheet| if is_sheet { Kind::Sheet } else { Kind::Solid });
        let mesh = run(py, threads, &progress, move |control| {
            control.begin("finding the surface", 1);
            VoxelMesh::of(&mask, &affine, kind, level.as_ref(), control)
        })?;
        let made = dict!(
            py,
            "kind" = if mesh.kind == Kind::Sheet { "sheet" } else { "solid" },
            "split_vertices" = mesh.split,
            "conflicts" = mesh.conflicts
        );
        let voxels = convert::array(py, &mesh.voxels)?;
        Ok((mesh.surface.into(), voxels, made))
    }

    fn __len__(&self) -> usize {
        self.0.surface.len()
    }

    /// Points (N, 3) in RAS+ mm.
    #[getter]
    fn points<'py>(&self, py: Python<'py>) -> PyResult<Table<'py, f64>> {
        let points = py.detach(|| convert::plain(self.0.surface.points()));
        convert::array(py, &points)
    }

    /// Unit normals (N, 3) of the vertices: the means of the normals of their faces.
    #[getter]
    fn normals<'py>(&self, py: Python<'py>) -> PyResult<Table<'py, f64>> {
        let normals = self.run(py, Some(1), &None, move |inner, _| Ok(convert::plain(&inner.surface.normals())))?;
        convert::array(py, &normals)
    }

    /// Triangles (F, 3).
    #[getter]
    fn faces<'py>(&self, py: Python<'py>) -> PyResult<Table<'py, u32>> {
        convert::array(py, self.0.surface.faces())
    }

    /// The vertex of the input for each vertex (N).
    #[getter]
    fn ids<'py>(&self, py: Python<'py>) -> Values<'py, u32> {
        self.0.surface.ids().to_vec().into_pyarray(py)
    }

    /// Return the faces whose corners are all kept (N).
    fn part(&self, py: Python<'_>, keep: Given<'_, bool>) -> PyResult<Self> {
        let keep = convert::values(&keep);
        self.check_length(keep.len(), "keep")?;
        self.run(py, Some(1), &None, move |inner, _| Ok(inner.surface.part_of_vertices(&keep)?.into()))
    }

    /// Return the faces that are kept (F).
    fn part_of_faces(&self, py: Python<'_>, keep: Given<'_, bool>) -> PyResult<Self> {
        let keep = convert::values(&keep);
        convert::check_length(keep.len(), self.0.surface.faces().len(), "keep", "face")?;
        self.run(py, Some(1), &None, move |inner, _| Ok(inner.surface.part_of_faces(&keep)?.into()))
    }

    /// Return the geodesic disk around a vertex, and the number of enclosed faces that were filled in.
    #[pyo3(signature = (seed, radius, threads=None, progress=None))]
    fn disk(
        &self, py: Python<'_>, seed: u32, radius: f64, threads: Threads, progress: Progress<'_>,
    ) -> PyResult<(Self, usize)> {
        let (part, filled) = self.run(py, threads, &progress, move |inner, control| {
            let graph = inner.graph(control)?;
            patch::disk(&inner.surface, &*graph, seed, radius, control)
        })?;
        Ok((part.into(), filled))
    }

    /// Return the smaller side of the closed shortest path along edges through vertices, and the vertices of that path.
    #[pyo3(signature = (corners, progress=None))]
    fn polygon<'py>(
        &self, py: Python<'py>, corners: Given<'py, u32>, progress: Progress<'py>,
    ) -> PyResult<(Self, Values<'py, u32>)> {
        let corners = convert::values(&corners);
        let (part, path) =
            self.run(py, Some(1), &progress, move |inner, control| patch::polygon(&inner.surface, &corners, control))?;
        Ok((part.into(), path.into_pyarray(py)))
    }

    /// Return the largest component, the first of `topology`.
    #[pyo3(signature = (progress=None))]
    fn largest_piece(&self, py: Python<'_>, progress: Progress<'_>) -> PyResult<Self> {
        self.run(py, Some(1), &progress, move |inner, _| Ok(patch::largest_piece(&inner.surface).into()))
    }

    /// Return the same vertices at other points (N, 3) in mm.
    fn moved(&self, py: Python<'_>, points: GivenTable<'_, f64>) -> PyResult<Self> {
        let points = convert::rows::<_, 3>(&points, "points")?;
        self.check_length(points.len(), "points")?;
        self.run(py, Some(1), &None, move |inner, _| {
            let points = points.into_iter().map(Into::into).collect();
            Ok(inner.surface.moved(points)?.into())
        })
    }

    /// Return the same surface with other `ids` (N).
    fn with_ids(&self, py: Python<'_>, ids: Given<'_, u32>) -> PyResult<Self> {
        let ids = convert::values(&ids);
        self.run(py, Some(1), &None, move |inner, _| Ok(inner.surface.with_ids(ids)?.into()))
    }
}

impl Surface {
    fn check_length(&self, given: usize, name: &str) -> PyResult<()> {
        convert::check_length(given, self.0.surface.len(), name, "point")
    }

    fn vertices(&self, array: &Given<'_, u32>) -> PyResult<Vec<u32>> {
        convert::vertices(array, self.0.surface.len())
    }

    fn run<T: Send + 'static>(
        &self, py: Python<'_>, threads: Threads, progress: &Progress<'_>,
        work: impl FnOnce(&Inner, &Control) -> voxflat::Result<T> + Send + 'static,
    ) -> PyResult<T> {
        run_on(&self.0, py, threads, progress, work)
    }
}

/// Return area-weighted unit normals (N, 3) of the vertices of triangles (F, 3) at points (N, 3); NaN if undefined.
#[pyfunction]
pub fn vertex_normals<'py>(
    py: Python<'py>, points: GivenTable<'py, f64>, faces: GivenTable<'py, u32>,
) -> PyResult<Table<'py, f64>> {
    let points = convert::rows::<_, 3>(&points, "points")?;
    let faces = convert::rows::<_, 3>(&faces, "faces")?;
    let normals = run(py, Some(1), &None, move |_| {
        let points: Vec<_> = points.into_iter().map(Into::into).collect();
        let or_none = |normal: [f64; 3]| if normal == [0.0; 3] { [f64::NAN; 3] } else { normal };
        Ok(convert::plain(&mesh::vertex_normals(&points, &faces)?).into_iter().map(or_none).collect::<Vec<_>>())
    })?;
    convert::array(py, &normals)
}

/// Return the defects of a mesh: the places of each kind of defect.
#[pyfunction]
pub fn defects<'py>(py: Python<'py>, points: GivenTable<'py, f64>, faces: GivenTable<'py, i64>) -> PyResult<Dict<'py>> {
    let points = convert::rows::<_, 3>(&points, "points")?;
    let faces = convert::rows::<_, 3>(&faces, "faces")?;
    let found = run(py, Some(1), &None, move |_| CoreSurface::defects(&points, &faces))?;
    Ok(dict!(
        py,
        "vertices without a position" = found.missing,
        "triangles without area" = found.degenerate,
        "triangles given twice" = found.duplicate,
        "edges of more than two triangles" = found.crowded_edges,
        "vertices where sheets touch" = found.pinched,
        "one-sided components" = found.one_sided,
        "triangles turned over" = found.turned,
        "vertices at the same place as another" = found.coincident
    ))
}

/// Return the numbers of voxels of the components of a mask, in which voxels are connected through faces.
#[pyfunction]
#[pyo3(signature = (mask, progress=None))]
pub fn component_sizes<'py>(
    py: Python<'py>, mask: GivenImage<'py, bool>, progress: Progress<'py>,
) -> PyResult<Values<'py, usize>> {
    let mask = convert::mask(&mask)?;
    Ok(check(py, &progress, move |control| count_components(&mask, control))?.into_pyarray(py))
}

/// Return whether a mask is a voxel sheet (one voxel thick).
#[pyfunction]
#[pyo3(signature = (mask, progress=None))]
pub fn is_sheet<'py>(py: Python<'py>, mask: GivenImage<'py, bool>, progress: Progress<'py>) -> PyResult<bool> {
    let mask = convert::mask(&mask)?;
    check(py, &progress, move |control| sheets::is_sheet(&mask, control))
}

/// Repair a mask so that its surface is a sphere; return the mask and the changes.
#[pyfunction]
#[pyo3(signature = (mask, spacing, probability=None, progress=None))]
pub fn repair<'py>(
    py: Python<'py>, mask: GivenImage<'py, bool>, spacing: [f64; 3], probability: Option<GivenImage<'py, f32>>,
    progress: Progress<'py>,
) -> PyResult<(Bound<'py, PyArray3<bool>>, Dict<'py>)> {
    let mask = convert::mask(&mask)?;
    let shape = mask.shape();
    let probability = probability.map(|image| convert::voxels(&image));
    let repaired = check(py, &progress, move |control| to_genus_zero(&mask, spacing, probability.as_deref(), control))?;
    let inside = Array3::from_shape_vec(shape, repaired.mask.values().to_vec());
    let inside = inside.map_err(|error| InputError::new_err(error.to_string()))?;
    let dict = dict!(py, "handles" = repaired.handles, "considered" = repaired.considered);
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

/// Runs work on the foreground of a volume, whose first stage is its check.
fn check<T: Send + 'static>(
    py: Python<'_>, progress: &Progress<'_>, work: impl FnOnce(&Control) -> voxflat::Result<T> + Send + 'static,
) -> PyResult<T> {
    run(py, None, progress, move |control| {
        control.begin("checking the foreground", 1);
        work(control)
    })
}
