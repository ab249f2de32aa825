//! What can go wrong: every message names the value and says what to do.

/// The result of everything in this crate that can fail.
pub type Result<T> = std::result::Result<T, Error>;

/// Why an input is refused or a computation stopped.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs)] // the message of each variant is its description
pub enum Error {
    #[error("the volume has {given} values, but its shape {shape:?} needs {needed}")]
    ShapeMismatch { shape: [usize; 3], given: usize, needed: usize },

    #[error("the volume's shape {shape:?} is too large: an axis can have at most 2097152 voxels")]
    VolumeTooLarge { shape: [usize; 3] },

    #[error(
        "the voxels are {longest} mm long and {shortest} mm wide: above a ratio of {most} to 1 no link lengths measure a \
         digital path; resample the volume to more even voxels"
    )]
    TooAnisotropic { longest: f64, shortest: f64, most: f64 },

    #[error("no voxel of the volume (shape {shape:?}) is foreground: choose another label or threshold")]
    EmptyForeground { shape: [usize; 3] },

    #[error("the affine is {value} at row {row}, column {column}: give a finite affine or spacing")]
    AffineNotFinite { row: usize, column: usize, value: f64 },

    #[error("the last row of the affine is {row:?}, not [0, 0, 0, 1]: give an affine from voxel indices to mm")]
    AffineNotAffine { row: [f64; 4] },

    #[error("the spacing of axis {axis} is {spacing} mm: give a positive spacing")]
    SpacingNotPositive { axis: usize, spacing: f64 },

    #[error(
        "the affine is sheared: axes {first} and {second} have cosine {cosine:.4}; resample the volume to an \
         orthogonal grid"
    )]
    AffineSheared { first: usize, second: usize, cosine: f64 },

    #[error(
        "the surface has only {points} points; at least {needed} are needed to flatten: take a larger patch or label"
    )]
    TooFewPoints { points: usize, needed: usize },

    #[error("{sources} sources are too few to flatten; give at least {needed}")]
    TooFewSources { sources: usize, needed: usize },

    #[error("{sources} sources are more than the {points} points of the surface; give at most {points}")]
    TooManySources { sources: usize, points: usize },

    #[error("voxel {voxel:?} is not on the surface; the nearest surface voxel is {nearest:?}")]
    NotOnSurface { voxel: [i64; 3], nearest: [u32; 3] },

    #[error("point {vertex} does not exist: the surface has {points} points, counted from 0")]
    NoSuchPoint { vertex: usize, points: usize },

    #[error("point {vertex} is given twice among the sources; give each once")]
    DuplicateSource { vertex: usize },

    #[error(
        "the seed point {voxel:?} is {distance:.1} mm away from the surface (nearest surface voxel {nearest:?}), farther \
         than the patch radius {radius} mm: choose a seed point on the surface"
    )]
    SeedOffSurface { voxel: [i64; 3], nearest: [u32; 3], distance: f64, radius: f64 },

    #[error("the patch radius is {radius} mm: give a positive, finite radius")]
    RadiusNotPositive { radius: f64 },

    #[error(
        "the patch mask keeps no voxel of the surface ({points} surface voxels): check that it overlaps the label's border"
    )]
    EmptyPatch { points: usize },

    #[error(
        "point {vertex} cannot be reached from source {source_vertex}: they lie in different components; keep one \
         component, or cut out a patch with a seed point and a radius"
    )]
    Unreachable { source_vertex: usize, vertex: usize },

    #[error(
        "the patch falls into {count} pieces that do not touch (of {sizes} voxels): keep one piece, or give a seed point \
         and a radius"
    )]
    Disconnected { count: usize, sizes: String },

    #[error(
        "the surface is closed, like a sphere's: {touching} of its {points} surface voxels enclose an interior (Euler \
         characteristic {euler}); it cannot be flattened without a cut. Cut out a patch: give a seed point and a radius in \
         mm, or a mask of what to keep"
    )]
    Closed { points: usize, touching: usize, euler: i64 },

    #[error(
        "the distances are not those of a surface: only {positive} eigenvalue(s) of the scaling are positive, two are \
         needed; the patch is a line or a point, take a wider one"
    )]
    NotPlanar { positive: usize },

    #[error("the eigenvalue solver did not converge for {sources} sources; try another number of sources")]
    EigenNotConverged { sources: usize },

    #[error("the radial functions' system is singular for {sources} sources; try another number of sources or seed")]
    RadialSingular { sources: usize },

    #[error("the pixel size is {pixel_size} mm: give a positive, finite size")]
    PixelSizeNotPositive { pixel_size: f64 },

    #[error("the flat image would have {width} x {height} pixels; give a pixel size above {pixel_size} mm")]
    RasterTooLarge { width: f64, height: f64, pixel_size: f64 },

    #[error("a surface of {points} points is too large for this graph: at most {most} are possible")]
    GraphTooLarge { points: usize, most: usize },

    #[error("cancelled")]
    Cancelled,
}
