//! The nearest point on a surface, and the columns that contain voxels.

use std::sync::Arc;

use numpy::IntoPyArray;
use pyo3::prelude::*;
use voxflat::nearest::NearestFinder as CoreFinder;
use voxflat::ways::Ways;
use voxflat::{columns, ribbon};

use crate::convert::{self, Given, GivenImage, GivenTable, Table, Values, ensure};
use crate::work::{Progress, Threads, run};

type Found<'py> = (Values<'py, i64>, Table<'py, f64>, Values<'py, f64>);
type Sides<'py> = (Table<'py, f64>, Values<'py, f64>);
type Columns<'py> = (Values<'py, u64>, Values<'py, u32>, Table<'py, f64>, Values<'py, f64>);

/// Finds the nearest point on a surface.
#[pyclass(frozen, module = "voxflat._core")]
pub struct NearestFinder(Arc<CoreFinder>);

#[pymethods]
impl NearestFinder {
    /// Create a finder from points (N, 3) in mm and faces (F, 3).
    #[new]
    fn new(py: Python<'_>, points: GivenTable<'_, f64>, faces: GivenTable<'_, u32>) -> PyResult<Self> {
        let points = convert::rows::<_, 3>(&points, "points")?;
        let faces = convert::rows::<_, 3>(&faces, "faces")?;
        convert::check_vertices(faces.iter().flatten().copied(), points.len())?;
        run(py, None, &None, move |_| {
            let corners: Vec<[[f64; 3]; 3]> =
                faces.iter().map(|face| face.map(|vertex| points[vertex as usize])).collect();
            Ok(Self(Arc::new(CoreFinder::new(&corners))))
        })
    }

    /// Return the triangle nearest to each point (P, 3), -1 if none is within the limit; its barycentric coordinates
    /// (P, 3) and distance (P,) in mm, NaN if there is none.
    fn find<'py>(&self, py: Python<'py>, points: GivenTable<'py, f64>, limit: f64) -> PyResult<Found<'py>> {
        let points = convert::rows::<_, 3>(&points, "points")?;
        let finder = Arc::clone(&self.0);
        let found = run(py, None, &None, move |control| finder.find_all(&points, limit, control))?;
        let triangles: Vec<i64> = found.iter().map(|near| near.map_or(-1, |near| i64::from(near.triangle))).collect();
        let weights: Vec<[f64; 3]> = found.iter().map(|near| near.map_or([f64::NAN; 3], |near| near.weights)).collect();
        let distances: Vec<f64> = found.iter().map(|near| near.map_or(f64::NAN, |near| near.distance)).collect();
        Ok((triangles.into_pyarray(py), convert::array(py, &weights)?, distances.into_pyarray(py)))
    }

    /// Return the nearest point of the surface for each point (P, 3), and its distance (P,) in mm, which is negative on
    /// the side to which the normals do not point. `normals` (N, 3) are those of vertices, and `faces` (F, 3) are those
    /// of the finder.
    #[pyo3(signature = (points, normals, faces, threads=None, progress=None))]
    fn sides<'py>(
        &self, py: Python<'py>, points: GivenTable<'py, f64>, normals: GivenTable<'py, f64>,
        faces: GivenTable<'py, u32>, threads: Threads, progress: Progress<'py>,
    ) -> PyResult<Sides<'py>> {
        let points = convert::rows::<_, 3>(&points, "points")?;
        let normals = convert::rows::<_, 3>(&normals, "normals")?;
        let faces = convert::rows::<_, 3>(&faces, "faces")?;
        convert::check_vertices(faces.iter().flatten().copied(), normals.len())?;
        let finder = Arc::clone(&self.0);
        let (feet, distances) = run(py, threads, &progress, move |control| {
            let of_corners: Vec<[[f64; 3]; 3]> =
                faces.iter().map(|face| face.map(|vertex| normals[vertex as usize])).collect();
            finder.sides(&points, &of_corners, control)
        })?;
        Ok((convert::array(py, &feet)?, distances.into_pyarray(py)))
    }
}

/// Find the voxels whose centres lie between two surfaces with the same faces (F, 3), ascending by number (C order):
/// numbers (P,), triangles (P,), barycentric coordinates (P, 3), and depths (P,) from 0 to 1.
///
/// `inner`, `outer` (N, 3) are in voxel indices; `numbers` (N,) identify vertices. A voxel in several columns is
/// assigned to the one in which its depth is closest to `middle`.
#[pyfunction]
#[pyo3(signature = (inner, outer, faces, numbers, shape, middle, progress=None))]
pub fn ribbon_voxels<'py>(
    py: Python<'py>, inner: GivenTable<'py, f64>, outer: GivenTable<'py, f64>, faces: GivenTable<'py, u32>,
    numbers: Given<'py, i64>, shape: [usize; 3], middle: f64, progress: Progress<'py>,
) -> PyResult<Columns<'py>> {
    let inner = convert::rows::<_, 3>(&inner, "inner")?;
    let outer = convert::rows::<_, 3>(&outer, "outer")?;
    let faces = convert::rows::<_, 3>(&faces, "faces")?;
    let numbers = convert::values(&numbers);
    let counts = [inner.len(), outer.len(), numbers.len()];
    ensure!(
        counts == [inner.len(); 3],
        "inner, outer and numbers have {counts:?} rows. Pass the same number of rows in each, one per vertex"
    );
    convert::check_vertices(faces.iter().flatten().copied(), inner.len())?;
    let found = run(py, None, &progress, move |control| {
        ribbon::voxels(&inner, &outer, &faces, &numbers, shape, middle, control)
    })?;
    let weights: Vec<[f64; 3]> = found.iter().map(|of| of.weights).collect();
    Ok((
        found.iter().map(|of| of.voxel).collect::<Vec<_>>().into_pyarray(py),
        found.iter().map(|of| of.triangle).collect::<Vec<_>>().into_pyarray(py),
        convert::array(py, &weights)?,
        found.iter().map(|of| of.fraction).collect::<Vec<_>>().into_pyarray(py),
    ))
}

/// Make columns of voxels connected: `voxels` (P, 3) in C order, the column of each voxel (P,) or 0, and `halfway` (P, 3),
/// its point on the middle surface in mm. Returns the columns (P,).
#[pyfunction]
#[pyo3(signature = (voxels, columns, halfway, progress=None))]
pub fn connect_columns<'py>(
    py: Python<'py>, voxels: GivenTable<'py, u32>, columns: Given<'py, u32>, halfway: GivenTable<'py, f64>,
    progress: Progress<'py>,
) -> PyResult<Values<'py, u32>> {
    let voxels = convert::rows::<_, 3>(&voxels, "voxels")?;
    let halfway = convert::rows::<_, 3>(&halfway, "halfway")?;
    let given = convert::values(&columns);
    let counts = [voxels.len(), given.len(), halfway.len()];
    ensure!(
        counts == [voxels.len(); 3],
        "voxels, columns and halfway have {counts:?} rows. Pass the same number of rows in each, one per voxel"
    );
    let joined = run(py, Some(1), &progress, move |control| columns::connect(&voxels, &given, &halfway, control))?;
    Ok(joined.into_pyarray(py))
}

/// Return which straight ways from `starts` (P, 3) to `ends` (P, 3), in mm, pass a voxel of a mask. They are read at
/// multiples of `step` beyond the distances `clear` (P,). `to_voxels` is the affine matrix from mm to voxels.
#[pyfunction]
#[pyo3(signature = (mask, to_voxels, starts, ends, clear, step, threads=None))]
pub fn ways_pass<'py>(
    py: Python<'py>, mask: GivenImage<'py, bool>, to_voxels: [[f64; 4]; 4], starts: GivenTable<'py, f64>,
    ends: GivenTable<'py, f64>, clear: Given<'py, f64>, step: f64, threads: Threads,
) -> PyResult<Values<'py, bool>> {
    let mask = convert::mask(&mask)?;
    let starts = convert::rows::<_, 3>(&starts, "starts")?;
    let ends = convert::rows::<_, 3>(&ends, "ends")?;
    let clear = convert::values(&clear);
    ensure!(step.is_normal() && step.is_sign_positive(), "step is {step}. Pass a positive length in mm");
    let passed = run(py, threads, &None, move |control| {
        Ways { starts: &starts, ends: &ends, clear: &clear, step }.pass(&mask, &to_voxels, control)
    })?;
    Ok(passed.into_pyarray(py))
}
