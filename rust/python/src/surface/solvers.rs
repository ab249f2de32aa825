//! The solvers by name.

use pyo3::prelude::*;
use voxflat::geodesic::marching::Wave;

use crate::work::InputError;

/// The solvers of distances on a surface.
#[derive(Clone, Copy)]
pub(super) enum Geodesic {
    Graph,
    Marching(Wave),
    Exact,
}

impl Geodesic {
    pub(super) fn named(name: &str) -> PyResult<Self> {
        match name {
            "graph" => Ok(Self::Graph),
            "marching" => Ok(Self::Marching(Wave::Circle)),
            "marching-plane" => Ok(Self::Marching(Wave::Plane)),
            "exact" => Ok(Self::Exact),
            _ => Err(InputError::new_err(format!("geodesic is {name:?}. Pass 'graph', 'marching' or 'exact'"))),
        }
    }
}

/// Evaluates an expression with the solver of a [`Geodesic`].
macro_rules! with_solver {
    ($geodesic:expr, $inner:expr, $control:expr, |$solver:ident| $body:expr) => {
        match $geodesic {
            $crate::surface::solvers::Geodesic::Graph => {
                let $solver = &*$inner.graph($control)?;
                $body
            }
            $crate::surface::solvers::Geodesic::Marching(wave) => {
                let $solver = &voxflat::geodesic::marching::Marching::new(&$inner.surface, wave, $control)?;
                $body
            }
            $crate::surface::solvers::Geodesic::Exact => {
                let $solver = &voxflat::geodesic::exact::Exact::new(&$inner.surface);
                $body
            }
        }
    };
}

pub(super) use with_solver;
