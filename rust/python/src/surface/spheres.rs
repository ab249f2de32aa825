//! Spherical maps of surfaces.

use numpy::IntoPyArray;
use pyo3::prelude::*;
use voxflat::sphere::pattern::pattern;
use voxflat::sphere::register::{Alignment, Template, register};
use voxflat::sphere::{locate::Locator, map::flipped};
use voxflat::surface::Surface as CoreSurface;

use super::Surface;
use crate::convert::{self, Dict, Given, GivenTable, List, Table, Values, dict, ensure};
use crate::work::{Progress, Threads, to_python};

/// The depths (K, N), positions (N, 3) and weights (N,) of a template.
type TemplateValues<'py> = (GivenTable<'py, f64>, GivenTable<'py, f64>, Given<'py, f64>);
type Pattern<'py> = (Table<'py, f64>, Table<'py, f64>, Values<'py, f64>);
type Located<'py> = (Values<'py, u32>, Table<'py, f64>);

#[pymethods]
impl Surface {
    /// Return the pattern of folds: depths (K, N) per scale, positions (N, 3) on the smoothed surface, areas (N,).
    #[pyo3(signature = (progress=None))]
    fn pattern<'py>(&self, py: Python<'py>, progress: Progress<'py>) -> PyResult<Pattern<'py>> {
        let of = self.run(py, Some(1), &progress, |inner, control| pattern(&inner.surface, control))?;
        let depths = convert::table(py, of.depths.concat(), self.0.surface.len())?;
        Ok((depths, convert::array(py, &convert::plain(&of.places))?, of.areas.into_pyarray(py)))
    }

    /// Register the vertices to one of several templates, which share a sphere of points (N, 3) and faces (F, 3).
    #[pyo3(signature = (points, faces, templates, named=None, threads=None, progress=None))]
    fn register<'py>(
        &self, py: Python<'py>, points: GivenTable<'py, f64>, faces: GivenTable<'py, i64>,
        templates: Vec<TemplateValues<'py>>, named: Option<usize>, threads: Threads, progress: Progress<'py>,
    ) -> PyResult<Dict<'py>> {
        let sphere = sphere(&points, &faces)?;
        let mut made = Vec::new();
        for (depths, places, weights) in &templates {
            let depths: Vec<Vec<f64>> = depths.as_array().rows().into_iter().map(|row| row.to_vec()).collect();
            let places = convert::rows::<_, 3>(places, "places")?;
            let (places, weights) = (places.into_iter().map(Into::into).collect(), weights.as_array().to_vec());
            made.push(Template::new(sphere.clone(), depths, places, weights).map_err(to_python)?);
        }
        let found =
            self.run(py, threads, &progress, move |inner, control| register(&inner.surface, &made, named, control))?;
        let alignment_dict = |alignment: Alignment| {
            let Alignment { correlations, rigid, score, .. } = alignment;
            Ok(dict!(py, "correlations" = correlations, "rigid" = rigid, "score" = score))
        };
        let alignments: List<'py> = found.alignments.into_iter().map(alignment_dict).collect::<PyResult<_>>()?;
        Ok(dict!(
            py,
            "turned_over" = flipped(self.0.surface.faces(), &found.points).map_err(to_python)?,
            "points" = convert::array(py, &convert::plain(&found.points))?,
            "template" = found.template,
            "alignments" = alignments,
            "correlations" = found.correlations,
            "affine" = found.affine
        ))
    }
}

/// Return the triangle (M,) at each position (M, 3) on a sphere of points (N, 3) and faces (F, 3), and its weights (M,
/// 3).
#[pyfunction]
pub fn locate_on_sphere<'py>(
    py: Python<'py>, points: GivenTable<'py, f64>, faces: GivenTable<'py, i64>, places: GivenTable<'py, f64>,
) -> PyResult<Located<'py>> {
    let sphere = sphere(&points, &faces)?;
    let places = convert::rows::<_, 3>(&places, "places")?;
    let found: voxflat::Result<Vec<_>> = py.detach(|| {
        let locator = Locator::new(&sphere)?;
        Ok(places.into_iter().map(|place| locator.locate(&place.into())).collect())
    });
    let found = found.map_err(to_python)?;
    let weights: Vec<[f64; 3]> = found.iter().map(|one| one.weights).collect();
    Ok((found.iter().map(|one| one.face).collect::<Vec<_>>().into_pyarray(py), convert::array(py, &weights)?))
}

fn sphere(points: &GivenTable<'_, f64>, faces: &GivenTable<'_, i64>) -> PyResult<CoreSurface> {
    let points = convert::rows::<_, 3>(points, "points")?;
    let faces = convert::rows::<_, 3>(faces, "faces")?;
    let (sphere, repaired) = CoreSurface::from_triangles(&points, &faces).map_err(to_python)?;
    let triangles = flipped(sphere.faces(), sphere.points()).map_err(to_python)?;
    let is_whole = repaired.turned == 0 && repaired.unused == 0 && sphere.boundary().is_empty();
    ensure!(
        is_whole && triangles == 0,
        "the sphere has holes or {triangles} flipped triangles. Pass triangles that cover the sphere once"
    );
    Ok(sphere)
}
