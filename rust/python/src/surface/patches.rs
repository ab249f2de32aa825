//! Quasi-isometric patches.

use std::sync::Arc;

use numpy::IntoPyArray;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use voxflat::flatten::saucan::{self, Atlas, Limit, Patch, Seeds};

use super::Surface;
use crate::convert;
use crate::work::{InputError, run};

#[pymethods]
impl Surface {
    /// Certified flat patches, limited by an angle ("angle", degrees), a bound of C ("bound") or their number ("count").
    #[pyo3(signature = (limit, value, seeds, seed, threads=None, progress=None))]
    #[allow(clippy::too_many_arguments)]
    fn patches<'py>(
        &self,
        py: Python<'py>,
        limit: &str,
        value: f64,
        seeds: &str,
        seed: u64,
        threads: Option<usize>,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let limit = match limit {
            "angle" => Limit::Angle(value),
            "bound" => Limit::Bound(value),
            "count" => Limit::Count(value as usize),
            _ => return Err(InputError::new_err(format!("limit is {limit:?}; give 'angle', 'bound' or 'count'"))),
        };
        let seeds = match seeds {
            "curvature" => Seeds::Curvature,
            "flattest" => Seeds::Flattest,
            "random" => Seeds::Random(seed),
            _ => {
                let message = format!("seeds is {seeds:?}; give 'curvature', 'flattest' or 'random'");
                return Err(InputError::new_err(message));
            }
        };
        let inner = Arc::clone(&self.0);
        let found =
            run(py, threads, progress.as_ref(), move |control| saucan::patches(&inner.surface, limit, seeds, control))?;
        atlas_dict(py, found)
    }
}

fn atlas_dict(py: Python<'_>, atlas: Atlas) -> PyResult<Bound<'_, PyDict>> {
    let dict = PyDict::new(py);
    let certificate = (atlas.certificate.angle, atlas.certificate.c, atlas.certificate.k);
    dict.set_item("certificate", certificate)?;
    dict.set_item("labels", atlas.labels.into_pyarray(py))?;
    dict.set_item("stretch", convert::array(py, &atlas.stretch)?)?;
    let patches = PyList::empty(py);
    for patch in atlas.patches {
        patches.append(patch_dict(py, patch)?)?;
    }
    dict.set_item("patches", patches)?;
    Ok(dict)
}

fn patch_dict(py: Python<'_>, patch: Patch) -> PyResult<Bound<'_, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("vertices", patch.vertices.into_pyarray(py))?;
    dict.set_item("uv", convert::array(py, &patch.uv)?)?;
    let plane = patch.plane;
    let frame: [[f64; 3]; 4] = [plane.origin, plane.normal, plane.axes[0], plane.axes[1]].map(Into::into);
    dict.set_item("plane", convert::array(py, &frame)?)?;
    dict.set_item("tilt", patch.tilt)?;
    dict.set_item("area", patch.area)?;
    dict.set_item("isometric", patch.isometric)?;
    dict.set_item("quasi_conformal", patch.quasi_conformal)?;
    Ok(dict)
}
