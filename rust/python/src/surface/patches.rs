//! Quasi-isometric patches.

use numpy::IntoPyArray;
use pyo3::prelude::*;
use voxflat::atlas::glue::{self, Glued, Seams};
use voxflat::atlas::{self, Atlas, Limit, Patch, Seeds};

use super::Surface;
use crate::convert::{self, Dict, Given, GivenTable, dict};
use crate::work::{Progress, Threads};

#[pymethods]
impl Surface {
    /// Return certified flat patches, limited by "angle" (degrees), "bound" (on C) or "count" (their number).
    #[pyo3(signature = (limit, value, seeds, seed, threads=None, progress=None))]
    fn patches<'py>(
        &self, py: Python<'py>, limit: &str, value: f64, seeds: &str, seed: u64, threads: Threads,
        progress: Progress<'py>,
    ) -> PyResult<Dict<'py>> {
        let limits =
            [("angle", Limit::Angle(value)), ("bound", Limit::Bound(value)), ("count", Limit::Count(value as usize))];
        let limit = convert::one_of("limit", limit, &limits)?;
        let all_seeds =
            [("curvature", Seeds::Curvature), ("flattest", Seeds::Flattest), ("random", Seeds::Random(seed))];
        let seeds = convert::one_of("seeds", seeds, &all_seeds)?;
        let found = self
            .run(py, threads, &progress, move |inner, control| atlas::patches(&inner.surface, limit, seeds, control))?;
        atlas_dict(py, found)
    }

    /// Glue patches within a bound on C: `labels` of the faces; each row of `flat` holds u, v of a face's corners.
    #[pyo3(signature = (labels, flat, bound, threads=None, progress=None))]
    fn glue<'py>(
        &self, py: Python<'py>, labels: Given<'py, u32>, flat: GivenTable<'py, f64>, bound: f64, threads: Threads,
        progress: Progress<'py>,
    ) -> PyResult<Dict<'py>> {
        let labels = labels.as_array().to_vec();
        let flat: Vec<[f64; 6]> = convert::rows(&flat, "flat")?;
        let flat: Vec<[[f64; 2]; 3]> = flat.into_iter().map(|[a, b, c, d, e, f]| [[a, b], [c, d], [e, f]]).collect();
        let faces = self.0.surface.faces().len();
        convert::check_length(labels.len(), faces, "labels", "face")?;
        convert::check_length(flat.len(), faces, "flat", "face")?;
        let found = self.run(py, threads, &progress, move |inner, control| {
            glue::glue(&inner.surface, &labels, &flat, bound, control)
        })?;
        glued_dict(py, found)
    }
}

fn atlas_dict(py: Python<'_>, atlas: Atlas) -> PyResult<Dict<'_>> {
    let patches: Vec<_> = atlas.patches.into_iter().map(|patch| patch_dict(py, patch)).collect::<PyResult<_>>()?;
    Ok(dict!(
        py,
        "certificate" = (atlas.certificate.angle, atlas.certificate.c, atlas.certificate.k),
        "labels" = atlas.labels.into_pyarray(py),
        "stretch" = convert::array(py, &atlas.stretch)?,
        "patches" = patches
    ))
}

fn patch_dict(py: Python<'_>, patch: Patch) -> PyResult<Dict<'_>> {
    let plane = patch.plane;
    let frame: [[f64; 3]; 4] = [plane.origin, plane.normal, plane.axes[0], plane.axes[1]].map(Into::into);
    Ok(dict!(
        py,
        "vertices" = patch.vertices.into_pyarray(py),
        "uv" = convert::array(py, &patch.uv)?,
        "plane" = convert::array(py, &frame)?,
        "tilt" = patch.tilt,
        "area" = patch.area,
        "isometric" = patch.isometric,
        "quasi_conformal" = patch.quasi_conformal
    ))
}

/// The pieces of an atlas, concatenated into arrays.
struct Flattened {
    starts: Vec<u32>,
    vertices: Vec<u32>,
    uv: Vec<[f64; 2]>,
    corners: Vec<[u32; 3]>,
    measured: Vec<[f64; 3]>,
}

fn flattened(glued: &Glued) -> Flattened {
    let mut of = Flattened {
        starts: vec![0],
        vertices: Vec::new(),
        uv: Vec::new(),
        corners: vec![[0; 3]; glued.labels.len()],
        measured: glued.pieces.iter().map(|p| [p.area, p.isometric, p.quasi_conformal]).collect(),
    };
    for piece in &glued.pieces {
        let first = of.vertices.len() as u32;
        for (&face, rows) in piece.faces.iter().zip(&piece.corners) {
            of.corners[face as usize] = rows.map(|row| first + row);
        }
        of.vertices.extend_from_slice(&piece.vertices);
        of.uv.extend_from_slice(&piece.uv);
        of.starts.push(of.vertices.len() as u32);
    }
    of
}

fn glued_dict(py: Python<'_>, glued: Glued) -> PyResult<Dict<'_>> {
    let of = py.detach(|| flattened(&glued));
    Ok(dict!(
        py,
        "labels" = glued.labels.into_pyarray(py),
        "stretch" = convert::array(py, &glued.stretch)?,
        "starts" = of.starts.into_pyarray(py),
        "vertices" = of.vertices.into_pyarray(py),
        "uv" = convert::array(py, &of.uv)?,
        "corners" = convert::array(py, &of.corners)?,
        "measured" = convert::array(py, &of.measured)?,
        "seams" = seams_dict(py, &glued.seams)?,
        "patches" = glued.patches,
        "before" = glued.before
    ))
}

pub(super) fn seams_dict<'py>(py: Python<'py>, seams: &Seams) -> PyResult<Dict<'py>> {
    Ok(dict!(
        py,
        "length" = seams.length,
        "closed" = seams.closed,
        "holonomy" = seams.holonomy,
        "bound" = seams.bound,
        "overlap" = seams.overlap
    ))
}
