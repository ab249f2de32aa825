//! Maps of tubes that repeat in the second direction.

use super::map::FlatMap;
use super::voxflat::Scale;
use crate::distortion::evaluate::{REFERENCE_SOURCES, evaluate_all, reference_sources};
use crate::distortion::{Evaluation, best_scale, faces::equal_area_scale};
use crate::embed::stress::levels::MOST_EVALUATED;
use crate::embed::stress::periodic::{Tube, flatten_tube};
use crate::geodesic::bend::{MarkedRows, Marking};
use crate::geodesic::{Solver, graph::GeodesicGraph};
use crate::sources::check_enough;
use crate::{Control, Result};

/// Options of a periodic map, as those of the [default method](super::voxflat::Options).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// From 0, which favours near distances and shapes, to 1, which favours far distances.
    pub weighting: f64,
    /// The scale of the map.
    pub scale: Scale,
}

/// Flattens a tube that is cut open along a seam from its first end to its second; distances are measured on the closed
/// tube from sources among its vertices. Returns the map of the opened tube and its period: positions of the two sides
/// of the seam differ by exactly one period in the second direction. No triangle is flipped. The distances of the map's
/// distortion are those around the closed tube, and to the nearest copy in the plane.
///
/// # Errors
/// [`Error::TooFewSources`](crate::Error::TooFewSources), [`Error::Folded`](crate::Error::Folded) or
/// [`Error::Uneven`](crate::Error::Uneven) if triangles are too thin or too uneven for a map, and errors of the solver.
pub fn periodic<S: Solver>(
    tube: &Tube, sources: &[u32], solver: &S, &Options { weighting, scale }: &Options, graph: &GeodesicGraph,
    evaluation: Evaluation, control: &Control,
) -> Result<(FlatMap, f64)> {
    check_enough(sources.len())?;
    let (closed, opened) = (tube.closed, tube.opened);
    let evaluated = tube.evaluated(sources, MOST_EVALUATED);
    let number = |vertex: &u32| evaluated.partition_point(|other| other < vertex) as u32;
    let rows = MarkedRows::compute_to(&Marking::of(solver, graph), sources, &evaluated, control)?;
    let rows = rows.renamed(sources.iter().map(number).collect()).into_rows();
    let (mut uv, mut period, convergence) = flatten_tube(tube, &rows, &evaluated, weighting, control)?;
    let first = tube.first_copies();
    let of_closed = |uv: &[[f64; 2]]| first.iter().map(|&copy| uv[copy as usize]).collect::<Vec<_>>();
    let factor = match scale {
        Scale::Distances => {
            let all = of_closed(&uv);
            let compared: Vec<[f64; 2]> = evaluated.iter().map(|&vertex| all[vertex as usize]).collect();
            best_scale(&compared, Some(period), &rows, control)?
        }
        Scale::Areas => equal_area_scale(opened.points(), opened.faces(), &uv),
    };
    if factor.is_finite() && factor > 0.0 {
        period *= factor;
        uv.iter_mut().flatten().for_each(|coordinate| *coordinate *= factor);
    }
    drop(rows);
    let (reference, all) = (reference_sources(closed.len(), REFERENCE_SOURCES, evaluation.seed), of_closed(&uv));
    let mut found =
        evaluate_all(&Marking::new(graph), &[&all], Some(period), &reference, u64::MAX, evaluation, control)?;
    let mut distortion = found.remove(0);
    distortion.per_point = tube.vertices().iter().map(|&vertex| distortion.per_point[vertex as usize]).collect();
    let normals = closed.normals();
    let normals = tube.vertices().iter().map(|&vertex| normals[vertex as usize]).collect();
    let map = FlatMap {
        uv,
        normals,
        sources: sources.iter().map(|&vertex| first[vertex as usize]).collect(),
        eigenvalues: Vec::new(), // distances around a tube have no classical scaling in the plane
        planarity: f64::NAN,
        distortion,
        convergence: Some(convergence),
        rows: None,
    };
    Ok((map, period))
}
