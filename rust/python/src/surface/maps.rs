//! The flat maps of a surface.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use pyo3::prelude::*;
use voxflat::distortion::Bands;
use voxflat::embed::stress::{group, group::Group as CoreGroup, levels::Levels, periodic::Tube, start::Start};
use voxflat::flatten::saucan2006::{self, Whole};
use voxflat::flatten::schwartz1989::{Mapped, Options};
use voxflat::flatten::voxflat::{AfterPlacing, Options as MapOptions, Scale};
use voxflat::flatten::zigelman2002::Sampling;
use voxflat::geodesic::bend::Marking;
use voxflat::geodesic::marching::Wave;
use voxflat::rows::DistanceRows;
use voxflat::store::Store;
use voxflat::{flatten, orient};

use super::Surface;
use super::patches::seams_dict;
use super::solvers::{Geodesic, with_solver};
use crate::convert::{self, Dict, Given, GivenTable, Table, ensure};
use crate::work::{Progress, Threads, to_python};

const SCALES: [(&str, Scale); 2] = [("distances", Scale::Distances), ("areas", Scale::Areas)];

/// Sums over the distances and shapes of surfaces with the same triangles.
#[pyclass(frozen, module = "voxflat._core")]
pub struct Group(Arc<Mutex<CoreGroup>>);

#[pymethods]
impl Group {
    /// Create an empty group for the map of a surface from sources (vertices).
    #[new]
    #[pyo3(signature = (surface, sources, progress=None))]
    fn new(
        py: Python<'_>, surface: PyRef<'_, Surface>, sources: Given<'_, u32>, progress: Progress<'_>,
    ) -> PyResult<Self> {
        let sources = surface.vertices(&sources)?;
        let group = surface.run(py, None, &progress, move |inner, control| {
            Ok(CoreGroup::new(&Levels::new(&inner.surface, &sources, control)?))
        })?;
        Ok(Self(Arc::new(Mutex::new(group))))
    }

    /// Return the memory in bytes that a group needs beside the map of its mean surface.
    #[staticmethod]
    fn memory_need(points: usize, sources: usize) -> u64 {
        group::memory_need(points, sources)
    }

    /// Add a surface with the same triangles, and its distances by a solver.
    #[pyo3(signature = (surface, weight, geodesic="graph", threads=None, progress=None))]
    fn add(
        &self, py: Python<'_>, surface: PyRef<'_, Surface>, weight: f64, geodesic: &str, threads: Threads,
        progress: Progress<'_>,
    ) -> PyResult<()> {
        let (geodesic, group) = (Geodesic::named(geodesic)?, Arc::clone(&self.0));
        surface.run(py, threads, &progress, move |inner, control| {
            let graph = &*inner.graph(control)?;
            let mut group = group.lock().unwrap_or_else(PoisonError::into_inner);
            with_solver!(geodesic, inner, control, |solver| {
                group.add(&inner.surface, &Marking::of(solver, graph), weight, control)
            })
        })
    }
}

#[pymethods]
impl Surface {
    /// Return the maximum memory in bytes for flattening; `rows` are "dropped", "kept" or "stored" afterwards.
    #[pyo3(signature = (sources, threads, rows="dropped"))]
    fn memory_need(&self, sources: usize, threads: usize, rows: &str) -> PyResult<u64> {
        let all = [("dropped", AfterPlacing::Dropped), ("kept", AfterPlacing::Kept), ("stored", AfterPlacing::Stored)];
        let rows = convert::one_of("rows", rows, &all)?;
        Ok(flatten::voxflat::memory_need(self.0.surface.len(), sources, threads, rows))
    }

    /// Flatten from sources (vertices), by rows of a solver in memory, which may be kept, or in a store (directory and
    /// identity). `scale` preserves "distances" or "areas". The optimisation can start from a position of each vertex
    /// (`start`), for `patience` times as many steps as usual. `max_area` is the maximum factor of area changes, if
    /// possible. The distances and shapes can be those of a group that was made for this surface and these sources.
    #[pyo3(signature = (sources, seed, bands, geodesic="graph", weighting=0.5, scale="distances", keep_rows=false, threads=None, progress=None, store=None, start=None, patience=1, max_area=None, group=None))]
    fn voxflat<'py>(
        &self, py: Python<'py>, sources: Given<'py, u32>, seed: u64, bands: [f64; 4], geodesic: &str, weighting: f64,
        scale: &str, keep_rows: bool, threads: Threads, progress: Progress<'py>, store: Option<(PathBuf, String)>,
        start: Option<GivenTable<'py, f64>>, patience: u32, max_area: Option<f64>, group: Option<PyRef<'py, Group>>,
    ) -> PyResult<Dict<'py>> {
        ensure!(patience > 0, "patience is 0. Pass at least 1");
        let start = start.map(|places| convert::rows::<_, 2>(&places, "start")).transpose()?;
        let (geodesic, evaluation) = (Geodesic::named(geodesic)?, convert::evaluation(bands, seed));
        let scale = convert::one_of("scale", scale, &SCALES)?;
        let sources = self.vertices(&sources)?;
        let group = group.map(|group| Arc::clone(&group.0));
        let (map, found) = self.run(py, threads, &progress, move |inner, control| {
            let surface = &inner.surface;
            flatten::check_domain(surface)?;
            let graph = &*inner.graph(control)?;
            let start = start.as_ref().map(|places| Start { places, patience });
            let options = MapOptions { weighting, start, max_area, scale };
            let mut levels = Levels::new(surface, &sources, control)?;
            if let Some(group) = group {
                let rows = group.lock().unwrap_or_else(PoisonError::into_inner).combine(&mut levels)?;
                return Ok((flatten::voxflat(levels, rows, &options, graph, evaluation, control)?, None));
            }
            let (rows, kept, found) = with_solver!(geodesic, inner, control, |solver| {
                let marking = Marking::of(solver, graph);
                if let Some((directory, identity)) = store {
                    let store = Store::compute(&directory, &identity, solver, &sources, control)?;
                    (levels.take(&store, &marking, control)?, None, Some(store.found()))
                } else if keep_rows {
                    let rows = DistanceRows::compute(solver, &sources, control)?;
                    (levels.take(&rows, &marking, control)?, Some(rows), None)
                } else {
                    (levels.measure(&marking, control)?, None, None)
                }
            });
            let mut map = flatten::voxflat(levels, rows, &options, graph, evaluation, control)?;
            map.rows = kept;
            Ok((map, found))
        })?;
        let dict = convert::map_dict(py, map)?;
        dict.set_item("found", found.map(|found| (found.rows, found.damaged)))?;
        Ok(dict)
    }

    /// Flatten a tube that repeats: `opened` has the same triangles, cut open along the seam (vertices from end to end).
    /// Distances are measured on this surface. The other arguments are as in `voxflat`; the dictionary also contains the
    /// period.
    #[pyo3(signature = (opened, seam, sources, seed, bands, geodesic="graph", weighting=0.5, scale="distances", threads=None, progress=None))]
    fn periodic<'py>(
        &self, py: Python<'py>, opened: PyRef<'py, Self>, seam: Given<'py, u32>, sources: Given<'py, u32>, seed: u64,
        bands: [f64; 4], geodesic: &str, weighting: f64, scale: &str, threads: Threads, progress: Progress<'py>,
    ) -> PyResult<Dict<'py>> {
        let (geodesic, evaluation) = (Geodesic::named(geodesic)?, convert::evaluation(bands, seed));
        let scale = convert::one_of("scale", scale, &SCALES)?;
        let (seam, sources) = (self.vertices(&seam)?, self.vertices(&sources)?);
        let opened = Arc::clone(&opened.0);
        let (map, period) = self.run(py, threads, &progress, move |inner, control| {
            let (tube, graph) = (Tube::new(&inner.surface, &opened.surface, &seam)?, &*inner.graph(control)?);
            let options = flatten::periodic::Options { weighting, scale };
            with_solver!(geodesic, inner, control, |solver| {
                flatten::periodic(&tube, &sources, solver, &options, graph, evaluation, control)
            })
        })?;
        let dict = convert::map_dict(py, map)?;
        dict.set_item("period", period)?;
        Ok(dict)
    }

    /// Flatten by the method of Zigelman et al. The sources remain after decimation to `count` vertices, are given
    /// vertices, or about `count` pixels of a grid: the pixel (N, 2) of each vertex and the distance of rows and
    /// columns in mm. `wave` is "circle" or "plane".
    #[pyo3(signature = (count, seed, bands, vertices=None, grid=None, wave="circle", keep_rows=false, threads=None, progress=None))]
    fn zigelman2002<'py>(
        &self, py: Python<'py>, count: usize, seed: u64, bands: [f64; 4], vertices: Option<Given<'py, u32>>,
        grid: Option<(GivenTable<'py, u32>, [f64; 2])>, wave: &str, keep_rows: bool, threads: Threads,
        progress: Progress<'py>,
    ) -> PyResult<Dict<'py>> {
        let evaluation = convert::evaluation(bands, seed);
        let wave = convert::one_of("wave", wave, &[("circle", Wave::Circle), ("plane", Wave::Plane)])?;
        let vertices: Option<Vec<u32>> = vertices.map(|array| array.as_array().iter().copied().collect());
        let grid =
            grid.map(|(pixels, spacing)| Ok::<_, PyErr>((convert::rows::<_, 2>(&pixels, "the pixels")?, spacing)));
        let grid = grid.transpose()?;
        if let Some((pixels, _)) = &grid {
            self.check_length(pixels.len(), "the pixels")?;
        }
        let map = self.run(py, threads, &progress, move |inner, control| {
            let sampling = match (&vertices, &grid) {
                (Some(vertices), _) => Sampling::Vertices(vertices),
                (None, Some((pixels, spacing))) => Sampling::Grid { pixels, spacing: *spacing, count },
                (None, None) => Sampling::Decimation { count },
            };
            flatten::zigelman2002(
                &inner.surface,
                &*inner.graph(control)?,
                &sampling,
                wave,
                evaluation,
                keep_rows,
                control,
            )
        })?;
        convert::map_dict(py, map)
    }

    /// Return the maximum memory in bytes for flattening by the method of Zigelman et al.
    fn zigelman2002_memory_need(&self, sources: usize, threads: usize) -> u64 {
        flatten::zigelman2002::memory_need(self.0.surface.len(), sources, threads)
    }

    /// Flatten by the method of Schwartz et al., with exact distances within `rings` (None: of all pairs) and from
    /// sources (vertices), from several random starts.
    #[pyo3(signature = (rings, sources, starts, seed, bands, keep_rows=false, threads=None, progress=None))]
    fn schwartz1989<'py>(
        &self, py: Python<'py>, rings: Option<u32>, sources: Given<'py, u32>, starts: u32, seed: u64, bands: [f64; 4],
        keep_rows: bool, threads: Threads, progress: Progress<'py>,
    ) -> PyResult<Dict<'py>> {
        ensure!(starts > 0, "starts is 0. Pass at least 1");
        let sources = convert::values(&sources);
        let Mapped { map, stresses, pairs } = self.run(py, threads, &progress, move |inner, control| {
            let options = Options { rings, sources: &sources, starts, seed, bands: Bands(bands), keep_rows };
            flatten::schwartz1989(&inner.surface, &*inner.graph(control)?, &options, control)
        })?;
        let dict = convert::map_dict(py, map)?;
        dict.set_item("stresses", stresses)?;
        dict.set_item("pairs", pairs)?;
        Ok(dict)
    }

    /// Return the rings of a neighbourhood for flattening by the method of Schwartz et al., as in the paper.
    #[pyo3(signature = (progress=None))]
    fn schwartz1989_rings(&self, py: Python<'_>, progress: Progress<'_>) -> PyResult<u32> {
        self.run(py, None, &progress, move |inner, control| flatten::schwartz1989::usual_rings(&inner.surface, control))
    }

    /// Return the maximum memory in bytes for flattening by the method of Schwartz et al.
    #[pyo3(signature = (rings, sources, threads, progress=None))]
    fn schwartz1989_memory_need(
        &self, py: Python<'_>, rings: Option<u32>, sources: usize, threads: usize, progress: Progress<'_>,
    ) -> PyResult<u64> {
        self.run(py, None, &progress, move |inner, control| {
            flatten::schwartz1989::memory_need(&inner.surface, rings, sources, threads, control)
        })
    }

    /// Flatten by the method of Appleboim, Saucan and Zeevi: patches are glued into one piece within a bound on C. Also
    /// returns the surface as it is cut open, to which the map belongs, and the outcome of gluing.
    #[pyo3(signature = (bound, seed, bands, threads=None, progress=None))]
    fn saucan2006<'py>(
        &self, py: Python<'py>, bound: f64, seed: u64, bands: [f64; 4], threads: Threads, progress: Progress<'py>,
    ) -> PyResult<Dict<'py>> {
        let found = self.run(py, threads, &progress, move |inner, control| {
            saucan2006::saucan2006(&inner.surface, bound, convert::evaluation(bands, seed), control)
        })?;
        let Whole { surface, map, seams, patches, certified, before, stretch } = found;
        let dict = convert::map_dict(py, map)?;
        dict.set_item("surface", Self::from(surface))?;
        dict.set_item("seams", seams_dict(py, &seams)?)?;
        dict.set_item("patches", patches)?;
        dict.set_item("certified", certified)?;
        dict.set_item("before", before)?;
        dict.set_item("stretch", convert::array(py, &stretch)?)?;
        Ok(dict)
    }

    /// Return the maximum memory in bytes for flattening by the method of Appleboim, Saucan and Zeevi.
    fn saucan2006_memory_need(&self, threads: usize) -> u64 {
        saucan2006::memory_need(self.0.surface.len(), threads)
    }
}

/// Rotate and translate positions `uv` (N, 2) rigidly such that `places` (k, 2) among them come closest to `onto` (k,
/// 2); also return the angle in radians.
#[pyfunction]
pub fn turn_onto<'py>(
    py: Python<'py>, uv: GivenTable<'py, f64>, places: GivenTable<'py, f64>, onto: GivenTable<'py, f64>,
) -> PyResult<(Table<'py, f64>, f64)> {
    let mut uv = convert::rows::<_, 2>(&uv, "uv")?;
    let (places, onto) = (convert::rows::<_, 2>(&places, "places")?, convert::rows::<_, 2>(&onto, "onto")?);
    let counts = [places.len(), onto.len()];
    ensure!(counts[0] == counts[1], "places and onto have {counts:?} rows. Pass the same number of rows in both");
    let turn = orient::turn_onto(&places, &onto, &mut uv).map_err(to_python)?;
    Ok((convert::array(py, &uv)?, turn))
}
