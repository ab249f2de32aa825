//! A coarse preview map, on which cuts are tried.

use nalgebra::Vector2;

use crate::distortion::{Evaluation, measure};
use crate::embed::classical::classical_scaling;
use crate::embed::stress::descent::{Until, descend};
use crate::embed::stress::levels::{self, Dials, FINAL, Levels};
use crate::embed::stress::pairs::{Bands, Pairs};
use crate::embed::stress::triangles::{Shape, TriangleEnergy};
use crate::embed::stress::{MapEnergy, springs::Springs};
use crate::geodesic::{bend::Marking, graph::GeodesicGraph};
use crate::rows::{DistanceRows, Rows};
use crate::sources::Sources;
use crate::surface::Surface;
use crate::{Control, Result};

/// The number of points from which distances are kept.
pub const LANDMARKS: usize = 48;

/// The number of edges that a link crosses on such a small surface; larger than usual.
const CROSSED: u32 = 5;

/// The weights of a preview. Unlike in the final map, no triangle counts as an outlier, because a cut should help the
/// most distorted triangles. Far distances become outliers sooner, as no cut may reduce them.
const WORTH: Dials = Dials {
    bands: Bands { outliers: [0.3, 0.05], ..FINAL.bands },
    shape: Shape { barrier: 0.05, area: 1.0, outlier: f64::INFINITY },
    stiffness: 0.08,
    patience: 1,
};

/// When the optimisation ends after a trial cut: most of the gain is achieved at once.
const TRIED: Until = Until { steps: 25, gain: 1e-3, enough: f64::NEG_INFINITY };

/// When the optimisation ends after a permanent cut.
const SETTLED: Until = Until { steps: 80, gain: 3e-4, enough: f64::NEG_INFINITY };

/// A surface and a map of it without folds.
#[derive(Debug)]
pub struct Preview {
    pub surface: Surface,
    uv: Vec<Vector2<f64>>,
    landmarks: Vec<u32>,
    measured: Measured,
    /// The energy of the map, with the distances of this surface.
    pub energy: f64,
}

#[derive(Debug)]
struct Measured {
    rows: DistanceRows,
    pairs: Pairs,
    triangles: TriangleEnergy,
    springs: Springs,
}

impl Measured {
    fn new(surface: &Surface, graph: &GeodesicGraph, landmarks: &[u32], control: &Control) -> Result<Self> {
        let rows = DistanceRows::compute(&Marking::new(graph), landmarks, control)?;
        let all: Vec<u32> = (0..surface.len() as u32).collect();
        let pairs = Pairs::new(&rows, &all, surface.area(), control)?;
        let triangles = TriangleEnergy::new(surface);
        let springs = Springs::new(triangles.corners().collect(), surface.len(), control)?;
        Ok(Self { rows, pairs, triangles, springs })
    }
}

impl Preview {
    pub fn new(surface: Surface, control: &Control) -> Result<Self> {
        let quiet = control.part();
        let graph = GeodesicGraph::crossing(&surface, CROSSED, &quiet)?;
        let landmarks = Sources::Farthest { count: LANDMARKS.min(surface.len()), seed: 0 }.choose(&graph, &quiet)?;
        let measured = Measured::new(&surface, &graph, &landmarks, &quiet)?;
        let places = classical_scaling(&measured.rows.among(&quiet)?)?.places;
        let mut levels = Levels::new(&surface, &landmarks, &quiet)?;
        let (uv, _) = levels::unfold(&mut levels, &measured.rows, &places, WORTH, &quiet)?;
        let uv = uv.into_iter().map(Into::into).collect();
        let mut preview = Self { surface, uv, landmarks, measured, energy: f64::NAN };
        preview.settle(control)?;
        Ok(preview)
    }

    /// Returns the preview after a cut along half-edges. The two sides of the cut coincide at first.
    pub fn with(&self, cut: &[u32], control: &Control) -> Result<Self> {
        let surface = self.surface.cut_open(cut.iter().copied());
        let mut uv = vec![Vector2::zeros(); surface.len()];
        let mut number = vec![0; self.surface.len()]; // one of the two on a cut
        for (&old, &new) in self.surface.faces().as_flattened().iter().zip(surface.faces().as_flattened()) {
            uv[new as usize] = self.uv[old as usize];
            number[old as usize] = new;
        }
        let landmarks: Vec<u32> = self.landmarks.iter().map(|&landmark| number[landmark as usize]).collect();
        let quiet = control.part();
        let graph = GeodesicGraph::crossing(&surface, CROSSED, &quiet)?;
        let measured = Measured::new(&surface, &graph, &landmarks, &quiet)?;
        let mut preview = Self { surface, uv, landmarks, measured, energy: f64::NAN };
        preview.descend(TRIED, control)?;
        Ok(preview)
    }

    pub fn settle(&mut self, control: &Control) -> Result<()> {
        self.descend(SETTLED, control)
    }

    /// Returns the mean relative error of the distances of interior pairs at the best scale, compared with this surface.
    pub fn error(&self, control: &Control) -> Result<f64> {
        let uv: Vec<[f64; 2]> = self.uv.iter().map(|&place| place.into()).collect();
        let found = measure(&[&uv], None, &self.measured.rows, true, Evaluation::default(), &control.part())?.remove(0);
        Ok(found.interior.relative_error)
    }

    fn descend(&mut self, until: Until, control: &Control) -> Result<()> {
        let Measured { pairs, triangles, springs, .. } = &self.measured;
        let Dials { bands, shape, stiffness, .. } = WORTH;
        let energy = MapEnergy { pairs, bands, triangles, shape, stiffness, springs, outline: None };
        let energies = descend(&energy, &mut self.uv, until, &control.part())?.energies;
        self.energy = energies[energies.len() - 1];
        Ok(())
    }
}
