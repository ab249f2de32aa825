//! Voxel surfaces and what is done with them.

use std::path::PathBuf;
use std::sync::Arc;

use numpy::{IntoPyArray, PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use voxflat::adjacency::Links;
use voxflat::flatten::{check_flattenable, grossmann2002};
use voxflat::geodesic::Solver;
use voxflat::geodesic::chain::{ChainWeights, LinkLengths, chain_graph};
use voxflat::geodesic::shortest::trace_path;
use voxflat::patch::{Disk, Selection, cut_out};
use voxflat::raster::map_faces;
use voxflat::rows::DistanceRows;
use voxflat::sources::Sources;
use voxflat::store::Store;
use voxflat::surface::VoxelSurface as CoreSurface;
use voxflat::surface::voxels::cubes::CubeTopology;
use voxflat::surface::voxels::graph::VoxelGraph;
use voxflat::volume::Affine;

use crate::convert;
use crate::work::{InputError, run, to_python};

type Faces<'py> = (Bound<'py, PyArray2<u32>>, Bound<'py, PyArray1<bool>>);
type Csr<'py> = (Bound<'py, PyArray1<u32>>, Bound<'py, PyArray1<u32>>, Bound<'py, PyArray1<f32>>);

/// The surface voxels of a label volume with their 26-neighbour graph.
#[pyclass(frozen, module = "voxflat._core")]
pub struct VoxelSurface(Arc<Inner>);

struct Inner {
    surface: CoreSurface,
    graph: VoxelGraph,
    lengths: LinkLengths,
}

/// The lengths in mm of the links of a chain code by kind, the set of axes along which a link steps (bits 1, 2, 4).
#[pyfunction]
pub fn chain_weights(spacing: [f64; 3], link_lengths: &str) -> PyResult<[f64; 8]> {
    let spacing = Affine::from_spacing(spacing).map_err(to_python)?.spacing();
    Ok(ChainWeights::new(spacing, self::link_lengths(link_lengths)?).map_err(to_python)?.lengths())
}

#[pymethods]
impl VoxelSurface {
    /// From a boolean (I, J, K) array and a (4, 4) affine to RAS+ mm.
    #[staticmethod]
    #[pyo3(signature = (mask, affine, link_lengths, progress=None))]
    fn from_mask(
        py: Python<'_>,
        mask: PyReadonlyArray3<'_, bool>,
        affine: [[f64; 4]; 4],
        link_lengths: &str,
        progress: Option<Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let lengths = self::link_lengths(link_lengths)?;
        let affine = Affine::new(affine).map_err(to_python)?;
        let mask = convert::mask(&mask)?;
        run(py, Some(1), progress.as_ref(), move |control| {
            control.begin("finding the surface", 1);
            let surface = CoreSurface::from_mask(&mask, affine, control)?;
            let graph = chain_graph(&surface, lengths, control)?;
            Ok(Self(Arc::new(Inner { surface, graph, lengths })))
        })
    }

    /// The part to flatten: a mask's, a geodesic disk's, or the largest component.
    #[pyo3(signature = (keep=None, seed_point=None, radius=None, progress=None))]
    fn cut_out(
        &self,
        py: Python<'_>,
        keep: Option<PyReadonlyArray3<'_, bool>>,
        seed_point: Option<[i64; 3]>,
        radius: Option<f64>,
        progress: Option<Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let keep = keep.as_ref().map(convert::mask).transpose()?;
        let disk = seed_point.zip(radius).map(|(seed_point, radius)| Disk { seed_point, radius });
        let inner = Arc::clone(&self.0);
        run(py, Some(1), progress.as_ref(), move |control| {
            let selection = Selection { keep: keep.as_ref(), disk };
            let (surface, graph) = cut_out(&inner.surface, &selection, inner.lengths, control)?;
            Ok(Self(Arc::new(Inner { surface, graph, lengths: inner.lengths })))
        })
    }

    fn __len__(&self) -> usize {
        self.0.surface.len()
    }

    /// Number of links of the graph, each counted from both ends.
    #[getter]
    fn links(&self) -> usize {
        self.0.graph.links()
    }

    /// Voxel indices (N, 3).
    #[getter]
    fn voxels<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<u32>>> {
        convert::array(py, self.0.surface.voxels())
    }

    /// RAS+ mm (N, 3).
    #[getter]
    fn points<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let points = py.detach(|| convert::plain(&self.0.surface.points()));
        convert::array(py, &points)
    }

    /// The graph in compressed rows: starts (N + 1), neighbours, lengths in mm.
    #[getter]
    fn csr<'py>(&self, py: Python<'py>) -> Csr<'py> {
        let graph = &self.0.graph;
        let arcs = || (0..graph.len() as u32).flat_map(|vertex| graph.arcs(vertex));
        let (neighbours, lengths): (Vec<u32>, Vec<f32>) = py.detach(|| arcs().map(|arc| (arc.to, arc.length)).unzip());
        (graph.starts().to_vec().into_pyarray(py), neighbours.into_pyarray(py), lengths.into_pyarray(py))
    }

    /// Numbers of voxels of the connected components, largest first.
    fn component_sizes(&self, py: Python<'_>) -> Vec<usize> {
        let mut sizes = py.detach(|| self.0.graph.components().sizes);
        sizes.sort_unstable_by(|a, b| b.cmp(a));
        sizes
    }

    /// Euler characteristic, cavities, and whether the surface is closed.
    #[pyo3(signature = (progress=None))]
    fn topology<'py>(&self, py: Python<'py>, progress: Option<Bound<'py, PyAny>>) -> PyResult<Bound<'py, PyDict>> {
        let inner = Arc::clone(&self.0);
        let topology = run(py, Some(1), progress.as_ref(), move |control| CubeTopology::of(&inner.surface, control))?;
        topology_dict(py, &topology)
    }

    /// Raises InputError if the surface is closed or has too few points.
    #[pyo3(signature = (progress=None))]
    fn check_flattenable(&self, py: Python<'_>, progress: Option<Bound<'_, PyAny>>) -> PyResult<()> {
        let inner = Arc::clone(&self.0);
        run(py, Some(1), progress.as_ref(), move |control| check_flattenable(&inner.surface, control)).map(|_| ())
    }

    /// The vertices at voxels (m, 3).
    fn find<'py>(&self, py: Python<'py>, voxels: PyReadonlyArray2<'py, i64>) -> PyResult<Bound<'py, PyArray1<u32>>> {
        self.check_not_empty()?;
        let voxels = convert::rows::<_, 3>(&voxels, "voxel indices")?;
        let find = |voxel| self.0.surface.find(voxel).map(|vertex| vertex as u32);
        let found: voxflat::Result<Vec<u32>> = py.detach(|| voxels.into_iter().map(find).collect());
        Ok(found.map_err(to_python)?.into_pyarray(py))
    }

    /// The surface voxel nearest to a voxel, as a vertex, and its distance in mm.
    fn nearest(&self, py: Python<'_>, voxel: [i64; 3]) -> PyResult<(usize, f64)> {
        self.check_not_empty()?;
        Ok(py.detach(|| self.0.surface.nearest(voxel)))
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
        let sources =
            convert::sources(sampling, count, seed, "'farthest' or 'random', which are all that voxels have")?;
        let inner = Arc::clone(&self.0);
        let chosen = run(py, Some(1), progress.as_ref(), move |control| sources.choose(&inner.graph, control))?;
        Ok(chosen.into_pyarray(py))
    }

    /// Distance rows (m, N) in mm from sources (vertices).
    #[pyo3(signature = (sources, threads=None, progress=None))]
    fn rows<'py>(
        &self,
        py: Python<'py>,
        sources: PyReadonlyArray1<'py, u32>,
        threads: Option<usize>,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let sources: Vec<u32> = sources.as_array().iter().copied().collect();
        convert::check_vertices(sources.iter().copied(), self.0.surface.len())?;
        let inner = Arc::clone(&self.0);
        let rows =
            run(py, threads, progress.as_ref(), move |control| DistanceRows::compute(&inner.graph, &sources, control))?;
        convert::table(py, rows.into_data(), self.0.surface.len())
    }

    /// A hash of what distances depend on.
    #[pyo3(signature = (progress=None))]
    fn fingerprint(&self, py: Python<'_>, progress: Option<Bound<'_, PyAny>>) -> PyResult<u64> {
        let inner = Arc::clone(&self.0);
        run(py, Some(1), progress.as_ref(), move |control| inner.graph.fingerprint(control))
    }

    /// Computes what a store lacks of the rows from sources (vertices): how many rows it had, and how many were damaged.
    #[pyo3(signature = (directory, identity, sources, threads=None, progress=None))]
    fn store_rows(
        &self,
        py: Python<'_>,
        directory: PathBuf,
        identity: String,
        sources: PyReadonlyArray1<'_, u32>,
        threads: Option<usize>,
        progress: Option<Bound<'_, PyAny>>,
    ) -> PyResult<(usize, usize)> {
        let sources: Vec<u32> = sources.as_array().iter().copied().collect();
        convert::check_vertices(sources.iter().copied(), self.0.surface.len())?;
        let inner = Arc::clone(&self.0);
        let found = run(py, threads, progress.as_ref(), move |control| {
            Ok(Store::compute(&directory, &identity, &inner.graph, &sources, control)?.found())
        })?;
        Ok((found.rows, found.damaged))
    }

    /// The vertices of a shortest path, both ends included, and its length in mm.
    fn path<'py>(&self, py: Python<'py>, source: u32, target: u32) -> PyResult<(Bound<'py, PyArray1<u32>>, f32)> {
        convert::check_vertices([source, target], self.0.surface.len())?;
        let inner = Arc::clone(&self.0);
        let (path, length) = run(py, Some(1), None, move |control| {
            let graph = &inner.graph;
            let mut row = vec![0.0; graph.len()];
            graph.row(source, &mut row, &mut graph.scratch(), control)?;
            Ok((trace_path(graph, &row, source, target, control)?, row[target as usize]))
        })?;
        Ok((path.into_pyarray(py), length))
    }

    /// The memory in bytes that flattening needs at most.
    fn memory_need(&self, sources: usize, threads: usize) -> u64 {
        grossmann2002::memory_need(self.0.surface.len(), self.0.graph.links(), sources, threads)
    }

    /// Flattens after Grossmann, Kiryati and Kimmel (2002) from sources (vertices).
    #[pyo3(signature = (sources, seed, keep_rows=false, threads=None, progress=None))]
    fn grossmann2002<'py>(
        &self,
        py: Python<'py>,
        sources: PyReadonlyArray1<'py, u32>,
        seed: u64,
        keep_rows: bool,
        threads: Option<usize>,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let given = Sources::Given(sources.as_array().iter().map(|&vertex| vertex as usize).collect());
        let inner = Arc::clone(&self.0);
        let map = run(py, threads, progress.as_ref(), move |control| {
            grossmann2002(&inner.surface, &inner.graph, &given, seed, keep_rows, control)
        })?;
        convert::map_dict(py, map)
    }

    /// The faces (F, 3) that join the places (N, 2) of a flat map of this surface, and which of them are torn (F).
    #[pyo3(signature = (uv, progress=None))]
    fn map_faces<'py>(
        &self,
        py: Python<'py>,
        uv: PyReadonlyArray2<'py, f64>,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Faces<'py>> {
        let uv = convert::rows::<_, 2>(&uv, "uv")?;
        if uv.len() != self.0.surface.len() {
            let message = format!("uv has {} rows; the surface has {} points", uv.len(), self.0.surface.len());
            return Err(InputError::new_err(message));
        }
        let inner = Arc::clone(&self.0);
        let faces = run(py, Some(1), progress.as_ref(), move |control| map_faces(&uv, &inner.graph, control))?;
        Ok((convert::array(py, &faces.corners)?, faces.torn.into_pyarray(py)))
    }
}

impl VoxelSurface {
    fn check_not_empty(&self) -> PyResult<()> {
        if self.0.surface.is_empty() { Err(InputError::new_err("the surface has no points")) } else { Ok(()) }
    }
}

fn link_lengths(name: &str) -> PyResult<LinkLengths> {
    match name {
        "chain-code" => Ok(LinkLengths::ChainCode),
        "euclidean" => Ok(LinkLengths::Euclidean),
        _ => Err(InputError::new_err(format!("link_lengths is {name:?}; give 'chain-code' or 'euclidean'"))),
    }
}

fn topology_dict<'py>(py: Python<'py>, topology: &CubeTopology) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("euler_characteristic", topology.euler)?;
    dict.set_item("cavities", topology.cavities)?;
    dict.set_item("closed", topology.is_closed())?;
    Ok(dict)
}
