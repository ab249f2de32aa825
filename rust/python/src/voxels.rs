//! Voxel surfaces and their methods.

use std::path::PathBuf;
use std::sync::Arc;

use numpy::IntoPyArray;
use pyo3::prelude::*;
use voxflat::Control;
use voxflat::adjacency::Links;
use voxflat::flatten::{check_flattenable, grossmann2002};
use voxflat::geodesic::Solver;
use voxflat::geodesic::chain::{ChainWeights, LinkLengths, chain_graph};
use voxflat::patch::{Disk, Selection, cut_out};
use voxflat::raster::map_faces;
use voxflat::rows::DistanceRows;
use voxflat::sources::Sources;
use voxflat::store::Store;
use voxflat::surface::VoxelSurface as CoreSurface;
use voxflat::surface::voxels::{cubes::CubeTopology, graph::VoxelGraph};
use voxflat::volume::Affine;

use crate::convert::{self, Dict, Given, GivenImage, GivenTable, Table, Values, dict, ensure};
use crate::surface::distances::shortest;
use crate::work::{Progress, Threads, run, run_on, to_python};

type Faces<'py> = (Table<'py, u32>, Values<'py, bool>);
type Csr<'py> = (Values<'py, u32>, Values<'py, u32>, Values<'py, f32>);

/// The surface voxels of a label volume with their 26-neighbour graph.
#[pyclass(frozen, module = "voxflat._core")]
pub struct VoxelSurface(Arc<Inner>);

struct Inner {
    surface: CoreSurface,
    graph: VoxelGraph,
    lengths: LinkLengths,
}

/// Return the lengths in mm of chain-code links by kind, the set of axes along which a link steps (bits 1, 2, 4).
#[pyfunction]
pub fn chain_weights(spacing: [f64; 3], link_lengths: &str) -> PyResult<[f64; 8]> {
    let spacing = Affine::from_spacing(spacing).map_err(to_python)?.spacing();
    Ok(ChainWeights::new(spacing, self::link_lengths(link_lengths)?).map_err(to_python)?.lengths())
}

#[pymethods]
impl VoxelSurface {
    /// Create a voxel surface from a boolean (I, J, K) array and a (4, 4) affine to RAS+ mm.
    #[staticmethod]
    #[pyo3(signature = (mask, affine, link_lengths, progress=None))]
    fn from_mask(
        py: Python<'_>, mask: GivenImage<'_, bool>, affine: [[f64; 4]; 4], link_lengths: &str, progress: Progress<'_>,
    ) -> PyResult<Self> {
        let lengths = self::link_lengths(link_lengths)?;
        let affine = Affine::new(affine).map_err(to_python)?;
        let mask = convert::mask(&mask)?;
        run(py, Some(1), &progress, move |control| {
            control.begin("finding the surface", 1);
            let surface = CoreSurface::from_mask(&mask, affine, control)?;
            let graph = chain_graph(&surface, lengths, control)?;
            Ok(Self(Arc::new(Inner { surface, graph, lengths })))
        })
    }

    /// Return the part to flatten: the voxels in a mask, a geodesic disk, or the largest component.
    #[pyo3(signature = (keep=None, seed_point=None, radius=None, progress=None))]
    fn cut_out(
        &self, py: Python<'_>, keep: Option<GivenImage<'_, bool>>, seed_point: Option<[i64; 3]>, radius: Option<f64>,
        progress: Progress<'_>,
    ) -> PyResult<Self> {
        let keep = keep.as_ref().map(convert::mask).transpose()?;
        let disk = seed_point.zip(radius).map(|(seed_point, radius)| Disk { seed_point, radius });
        self.run(py, Some(1), &progress, move |inner, control| {
            let selection = Selection { keep: keep.as_ref(), disk };
            let (surface, graph) = cut_out(&inner.surface, &selection, inner.lengths, control)?;
            Ok(Self(Arc::new(Inner { surface, graph, lengths: inner.lengths })))
        })
    }

    fn __len__(&self) -> usize {
        self.0.surface.len()
    }

    /// Voxel indices (N, 3).
    #[getter]
    fn voxels<'py>(&self, py: Python<'py>) -> PyResult<Table<'py, u32>> {
        convert::array(py, self.0.surface.voxels())
    }

    /// Points (N, 3) in RAS+ mm.
    #[getter]
    fn points<'py>(&self, py: Python<'py>) -> PyResult<Table<'py, f64>> {
        let points = py.detach(|| convert::plain(&self.0.surface.points()));
        convert::array(py, &points)
    }

    /// The graph in compressed rows: starts (N + 1), neighbours, lengths in mm.
    #[getter]
    fn csr<'py>(&self, py: Python<'py>) -> Csr<'py> {
        let graph = &self.0.graph;
        let arcs = || (0..graph.vertices() as u32).flat_map(|vertex| graph.arcs(vertex));
        let (neighbours, lengths): (Vec<u32>, Vec<f32>) = py.detach(|| arcs().map(|arc| (arc.to, arc.length)).unzip());
        (graph.starts().to_vec().into_pyarray(py), neighbours.into_pyarray(py), lengths.into_pyarray(py))
    }

    /// Return the numbers of voxels of the connected components, largest first.
    fn component_sizes(&self, py: Python<'_>) -> Vec<usize> {
        let mut sizes = py.detach(|| self.0.graph.components().sizes);
        sizes.sort_unstable_by(|a, b| b.cmp(a));
        sizes
    }

    /// Return the Euler characteristic, the cavities, and whether the surface is closed.
    #[pyo3(signature = (progress=None))]
    fn topology<'py>(&self, py: Python<'py>, progress: Progress<'py>) -> PyResult<Dict<'py>> {
        let topology =
            self.run(py, Some(1), &progress, move |inner, control| CubeTopology::of(&inner.surface, control))?;
        let CubeTopology { euler, cavities, .. } = topology;
        Ok(dict!(py, "euler_characteristic" = euler, "cavities" = cavities, "closed" = topology.is_closed()))
    }

    /// Raise InputError if the surface is closed or has too few points.
    #[pyo3(signature = (progress=None))]
    fn check_flattenable(&self, py: Python<'_>, progress: Progress<'_>) -> PyResult<()> {
        self.run(py, Some(1), &progress, move |inner, control| check_flattenable(&inner.surface, control)).map(|_| ())
    }

    /// Return the vertices at voxels (m, 3).
    fn find<'py>(&self, py: Python<'py>, voxels: GivenTable<'py, i64>) -> PyResult<Values<'py, u32>> {
        self.check_not_empty()?;
        let voxels = convert::rows::<_, 3>(&voxels, "voxel indices")?;
        let find = |voxel| self.0.surface.find(voxel).map(|vertex| vertex as u32);
        let found: voxflat::Result<Vec<u32>> = py.detach(|| voxels.into_iter().map(find).collect());
        Ok(found.map_err(to_python)?.into_pyarray(py))
    }

    /// Return the surface voxel nearest to a voxel, as a vertex, and its distance in mm.
    fn nearest(&self, py: Python<'_>, voxel: [i64; 3]) -> PyResult<(usize, f64)> {
        self.check_not_empty()?;
        Ok(py.detach(|| self.0.surface.nearest(voxel)))
    }

    /// Choose sources: "farthest" or "random".
    #[pyo3(signature = (sampling, count, seed, progress=None))]
    fn choose_sources<'py>(
        &self, py: Python<'py>, sampling: &str, count: usize, seed: u64, progress: Progress<'py>,
    ) -> PyResult<Values<'py, u32>> {
        let sources = convert::sources(sampling, count, seed, "'farthest' or 'random' for a voxel surface")?;
        let chosen = self.run(py, Some(1), &progress, move |inner, control| sources.choose(&inner.graph, control))?;
        Ok(chosen.into_pyarray(py))
    }

    /// Return distance rows (m, N) in mm from sources (vertices).
    #[pyo3(signature = (sources, threads=None, progress=None))]
    fn rows<'py>(
        &self, py: Python<'py>, sources: Given<'py, u32>, threads: Threads, progress: Progress<'py>,
    ) -> PyResult<Table<'py, f32>> {
        let sources = self.vertices(&sources)?;
        let rows = self.run(py, threads, &progress, move |inner, control| {
            DistanceRows::compute(&inner.graph, &sources, control)
        })?;
        convert::table(py, rows.into_data(), self.0.surface.len())
    }

    /// Return a hash of everything that distances depend on.
    #[pyo3(signature = (progress=None))]
    fn fingerprint(&self, py: Python<'_>, progress: Progress<'_>) -> PyResult<u64> {
        self.run(py, Some(1), &progress, move |inner, control| inner.graph.fingerprint(control))
    }

    /// Compute the missing rows of a store from sources (vertices); return the numbers of rows it had, and of damaged
    /// rows.
    #[pyo3(signature = (directory, identity, sources, threads=None, progress=None))]
    fn store_rows(
        &self, py: Python<'_>, directory: PathBuf, identity: String, sources: Given<'_, u32>, threads: Threads,
        progress: Progress<'_>,
    ) -> PyResult<(usize, usize)> {
        let sources = self.vertices(&sources)?;
        let found = self.run(py, threads, &progress, move |inner, control| {
            Ok(Store::compute(&directory, &identity, &inner.graph, &sources, control)?.found())
        })?;
        Ok((found.rows, found.damaged))
    }

    /// Return the vertices of a shortest path, including both ends, and its length in mm.
    fn path<'py>(&self, py: Python<'py>, source: u32, target: u32) -> PyResult<(Values<'py, u32>, f32)> {
        convert::check_vertices([source, target], self.0.surface.len())?;
        let (path, length) =
            self.run(py, Some(1), &None, move |inner, control| shortest(&inner.graph, source, target, control))?;
        Ok((path.into_pyarray(py), length))
    }

    /// Return the maximum memory in bytes for flattening.
    fn memory_need(&self, sources: usize, threads: usize) -> u64 {
        grossmann2002::memory_need(self.0.surface.len(), self.0.graph.links(), sources, threads)
    }

    /// Flatten by the method of Grossmann, Kiryati and Kimmel (2002) from sources (vertices).
    #[pyo3(signature = (sources, seed, bands, keep_rows=false, threads=None, progress=None))]
    fn grossmann2002<'py>(
        &self, py: Python<'py>, sources: Given<'py, u32>, seed: u64, bands: [f64; 4], keep_rows: bool,
        threads: Threads, progress: Progress<'py>,
    ) -> PyResult<Dict<'py>> {
        let given = Sources::Given(sources.as_array().iter().map(|&vertex| vertex as usize).collect());
        let map = self.run(py, threads, &progress, move |inner, control| {
            grossmann2002(&inner.surface, &inner.graph, &given, convert::evaluation(bands, seed), keep_rows, control)
        })?;
        convert::map_dict(py, map)
    }

    /// Return the faces (F, 3) that join the positions (N, 2) of a flat map, and which of them are torn (F).
    #[pyo3(signature = (uv, progress=None))]
    fn map_faces<'py>(
        &self, py: Python<'py>, uv: GivenTable<'py, f64>, progress: Progress<'py>,
    ) -> PyResult<Faces<'py>> {
        let uv = convert::rows::<_, 2>(&uv, "uv")?;
        convert::check_length(uv.len(), self.0.surface.len(), "uv", "point")?;
        let faces = self.run(py, Some(1), &progress, move |inner, control| map_faces(&uv, &inner.graph, control))?;
        Ok((convert::array(py, &faces.corners)?, faces.torn.into_pyarray(py)))
    }
}

impl VoxelSurface {
    fn vertices(&self, array: &Given<'_, u32>) -> PyResult<Vec<u32>> {
        convert::vertices(array, self.0.surface.len())
    }

    fn run<T: Send + 'static>(
        &self, py: Python<'_>, threads: Threads, progress: &Progress<'_>,
        work: impl FnOnce(&Inner, &Control) -> voxflat::Result<T> + Send + 'static,
    ) -> PyResult<T> {
        run_on(&self.0, py, threads, progress, work)
    }

    fn check_not_empty(&self) -> PyResult<()> {
        ensure!(!self.0.surface.is_empty(), "the surface has no points. Choose a larger patch");
        Ok(())
    }
}

fn link_lengths(name: &str) -> PyResult<LinkLengths> {
    let all = [("chain-code", LinkLengths::ChainCode), ("euclidean", LinkLengths::Euclidean)];
    convert::one_of("link_lengths", name, &all)
}
