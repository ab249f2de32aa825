//! A sketch: the map of a coarse surface, on which cuts are tried.

use nalgebra::Vector2;

use crate::control::Control;
use crate::embed::classical::classical_scaling;
use crate::embed::stress::MapEnergy;
use crate::embed::stress::descent::{Until, descend};
use crate::embed::stress::levels;
use crate::embed::stress::pairs::{Bands, Pairs};
use crate::embed::stress::springs::Springs;
use crate::embed::stress::triangles::{Shape, Triangles};
use crate::error::Result;
use crate::geodesic::graph::GeodesicGraph;
use crate::rows::{DistanceRows, Rows};
use crate::sources::Sources;
use crate::surface::Surface;

/// Points from which distances are kept.
const LANDMARKS: usize = 64;

const BANDS: Bands = Bands { weights: [1.0, 4.0, 0.5], outliers: [0.3, 0.05] };
const AREA: f64 = 6.0;
const STIFFNESS: f64 = 0.08;

#[derive(Debug)]
pub struct Slit {
    /// The id of the vertex where it ends.
    pub tip: u32,
    pub half_edges: Vec<u32>,
    /// mm.
    pub length: f64,
}

#[derive(Debug)]
pub struct Sketch {
    pub surface: Surface,
    uv: Vec<Vector2<f64>>,
    landmarks: Vec<u32>,
    pub energy: f64,
}

impl Sketch {
    pub fn new(surface: Surface, control: &Control) -> Result<Self> {
        let graph = GeodesicGraph::new(&surface, control)?;
        let sources = Sources::Farthest { count: LANDMARKS.min(surface.len()), seed: 0 };
        let landmarks = sources.choose(&graph, control)?;
        let rows = DistanceRows::compute(&graph, &landmarks, control)?;
        let scaling = classical_scaling(&rows.among(control)?)?;
        let (uv, _) = levels::flatten(&surface, &rows, &scaling.places, control)?;
        let mut sketch = Self { surface, uv: uv.into_iter().map(Into::into).collect(), landmarks, energy: f64::NAN };
        sketch.settle(control)?;
        Ok(sketch)
    }

    pub fn with(&self, slit: &Slit, control: &Control) -> Result<Self> {
        let surface = self.surface.cut_open(slit.half_edges.iter().copied());
        let mut uv = vec![Vector2::zeros(); surface.len()];
        let mut landmarks = self.landmarks.clone();
        for (old, new) in self.surface.faces().as_flattened().iter().zip(surface.faces().as_flattened()).rev() {
            uv[*new as usize] = self.uv[*old as usize];
            self.landmarks.iter().zip(&mut landmarks).filter(|(landmark, _)| *landmark == old).for_each(|(_, l)| *l = *new);
        }
        let mut sketch = Self { surface, uv, landmarks, energy: f64::NAN };
        sketch.descend(Until { steps: 40, gain: 1e-3 }, control)?;
        Ok(sketch)
    }

    pub fn settle(&mut self, control: &Control) -> Result<()> {
        self.descend(Until { steps: 200, gain: 1e-4 }, control)
    }

    fn descend(&mut self, until: Until, control: &Control) -> Result<()> {
        let quiet = Control::default();
        let t0 = std::time::Instant::now();
        let graph = GeodesicGraph::new(&self.surface, &quiet)?;
        let rows = DistanceRows::compute(&graph, &self.landmarks, &quiet)?;
        let t1 = t0.elapsed();
        let all: Vec<u32> = (0..self.surface.len() as u32).collect();
        let pairs = Pairs::new(&rows, &all, control)?;
        let triangles = Triangles::new(&self.surface);
        let springs = Springs::new(triangles.corners().collect(), self.surface.len(), control)?;
        let shape = Shape { area: AREA, scale: triangles.best_scale(&self.uv) };
        let energy = MapEnergy { pairs: &pairs, bands: BANDS, triangles: &triangles, shape, stiffness: STIFFNESS, springs: &springs };
        let t2 = t0.elapsed();
        let went = descend(&energy, &mut self.uv, until, control)?;
        if std::env::var("RELAX").is_ok() {
            eprintln!("   n {} rows {:?} prep {:?} all {:?} steps {}", self.surface.len(), t1, t2, t0.elapsed(), went.energies.len());
        }
        self.energy = went.energies[went.energies.len() - 1];
        Ok(())
    }
}
