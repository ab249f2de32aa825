//! Figures of the distortion of distances.

/// The figures of a map at one scale. Names of bands are those of human hemispheres ([`Bands`](super::Bands)).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Figures {
    /// The factor by which flat distances were multiplied.
    pub scale: f64,
    /// Mean of |d − δ|/δ (ε̄_r of Grossmann et al.).
    pub relative_error: f64,
    /// The same over pairs with δ in the first band; on a human hemisphere δ ≤ 5 mm.
    pub relative_error_0_5mm: f64,
    /// The same over the second and third band; 5 mm < δ ≤ 15 mm.
    pub relative_error_5_15mm: f64,
    /// The same over the fourth band; 15 mm < δ ≤ 30 mm.
    pub relative_error_15_30mm: f64,
    /// The same up to the second band; δ ≤ 10 mm.
    pub relative_error_10mm: f64,
    /// The same over all bands; δ ≤ 30 mm.
    pub relative_error_30mm: f64,
    /// Mean of |d − δ| in mm (ε̄ of Grossmann et al.).
    pub absolute_error: f64,
    /// √(Σ(d − δ)² / Σδ²), the stress-1 of Kruskal.
    pub stress_1: f64,
    /// (1/Σδ) Σ (d − δ)²/δ, Sammon's stress (Schwartz et al., equation 1.0).
    pub sammon_stress: f64,
}

impl Figures {
    /// Returns all figures with their names.
    pub fn named(&self) -> [(&'static str, f64); 10] {
        [
            ("scale", self.scale),
            ("relative_error", self.relative_error),
            ("relative_error_0_5mm", self.relative_error_0_5mm),
            ("relative_error_5_15mm", self.relative_error_5_15mm),
            ("relative_error_15_30mm", self.relative_error_15_30mm),
            ("relative_error_10mm", self.relative_error_10mm),
            ("relative_error_30mm", self.relative_error_30mm),
            ("absolute_error", self.absolute_error),
            ("stress_1", self.stress_1),
            ("sammon_stress", self.sammon_stress),
        ]
    }
}
