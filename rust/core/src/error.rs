//! What can go wrong: every message names the value and says what to do.

use std::io;
use std::path::Path;

use crate::scales::{FARTHEST, SHORTEST_EDGE, SMALLEST};

/// The result of everything in this crate that can fail.
pub type Result<T> = std::result::Result<T, Error>;

/// Why an input is refused or a computation stopped.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs)] // the message of each variant is its description
pub enum Error {
    #[error(
        "there are {links} links between {vertices} vertices, more than 32 bits count; take a smaller patch, or fewer vertices"
    )]
    TooManyLinks { links: usize, vertices: usize },

    #[error(
        "there are too many springs between {vertices} vertices for this machine; take a smaller patch, or fewer vertices"
    )]
    TooManySprings { vertices: usize },

    #[error("edges are too uneven in length for the map to be computed; remesh the surface, or take a smaller patch")]
    Uneven,

    #[error(
        "{triangles} triangles are too thin, or enclosed by too short a boundary, for a map without folds; remesh the \
         surface, cut it open further, or take a smaller patch"
    )]
    Folded { triangles: usize },

    #[error("the start has {places} places, the surface {points} vertices; give one place a vertex")]
    StartMismatch { places: usize, points: usize },

    #[error("the start has no finite place for vertex {vertex}; give one for every vertex that is flattened")]
    StartNotFinite { vertex: usize },

    #[error(
        "the start turns {triangles} triangles over in places that cannot be mended: give a map with fewer folds, or leave the \
         start out"
    )]
    StartFolded { triangles: usize },

    #[error(
        "the start lies on itself (its boundary crosses or touches itself {crossings} times): give a map that does not, or leave \
         the start out"
    )]
    StartCrosses { crossings: usize },

    #[error("the start has hardly any area, so that descent cannot leave it: give another map, or leave the start out")]
    StartStuck,

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
        "the affine is {value} at row {row}, column {column}, beyond {FARTHEST:e} mm: give it in mm, or repair the header"
    )]
    AffineTooFar { row: usize, column: usize, value: f64 },

    #[error(
        "the spacing of axis {axis} is {spacing:e} mm; voxels from {SMALLEST:e} mm on are taken: repair the header, or \
         give it in mm"
    )]
    SpacingTooSmall { axis: usize, spacing: f64 },

    #[error(
        "voxel {voxel:?} of the volume lies at {at:?} mm, beyond {FARTHEST:e} mm: give the affine in mm, or crop the volume"
    )]
    VoxelTooFar { voxel: [usize; 3], at: [f64; 3] },

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

    #[error(
        "the surface is no disk: it has {components} component(s), {loops} boundary loop(s), {handles} handle(s), Euler \
         characteristic {euler} instead of 1. Cut out a patch, cut it open, or repair it; voxflat check tells what each changes"
    )]
    NotADisk { components: usize, loops: usize, handles: usize, euler: i64 },

    #[error(
        "the surface is no sphere: it has {components} component(s), {loops} boundary loop(s), {handles} handle(s). Keep one \
         component, repair its handles, and close its holes"
    )]
    NotASphere { components: usize, loops: usize, handles: usize },

    #[error("no triangle around vertex {vertex} lies within {radius} mm: give a larger radius")]
    EmptyDisk { vertex: usize, radius: f64 },

    #[error(
        "the disk of {radius} mm ({own:.0} mm²) encloses a piece of {area:.0} mm² around ({:.0}, {:.0}, {:.0}) mm that \
         reaches farther, such as a gyrus with a narrow neck: choose another seed point, or another radius",
        at[0], at[1], at[2]
    )]
    DiskEncloses { radius: f64, area: f64, own: f64, at: [f64; 3] },

    #[error("the decimation's {name} is {value}: give a positive number (evenness may be 0, but is finite)")]
    DecimationOption { name: &'static str, value: f64 },

    #[error(
        "no cell of the grid has a point at all of its four corners ({sources} sources lie on the grid): give more sources, \
         or let decimation choose them"
    )]
    NoCell { sources: usize },

    #[error("the angle is {angle}°: give one from {least}° to {most}°")]
    AngleOutOfRange { angle: f64, least: f64, most: f64 },

    #[error("the bound C is {bound}: give one from {least} (an angle of 0.01°) to {most} (80°); 1 is an isometry")]
    BoundOutOfRange { bound: f64, least: f64, most: f64 },

    #[error("patches cannot be glued within a bound of {bound} on C; give one from {least} to {most}, such as 1.5")]
    GlueBoundOutOfRange { bound: f64, least: f64, most: f64 },

    #[error(
        "patches that change lengths by a factor of up to {before:.6} cannot be glued within a bound of {bound}; give a \
         greater bound, or make the patches with an angle of at most {angle:.4}°"
    )]
    PatchesBeyondBound { bound: f64, before: f64, angle: f64 },

    #[error(
        "the patches cannot be glued to one piece within C ≤ {bound}: {pieces} remain. Give a greater bound, take a smaller \
         patch, or keep the pieces: voxflat.patches(...).glue(...)"
    )]
    NotOnePiece { bound: f64, pieces: usize },

    #[error("{count} patches are too few for this surface: even where they may be tilted by {most}° it takes {least}")]
    TooFewPatches { count: usize, least: usize, most: f64 },

    #[error("a polygon has at least 3 corners; {corners} are given")]
    FewCorners { corners: usize },

    #[error(
        "the shortest paths between the {corners} corners of the polygon enclose nothing: they do not cut the surface in two, \
         because they run around a handle or along one line; choose other corners, or more of them"
    )]
    NotEnclosing { corners: usize },

    #[error("the mesh has no triangle ({points} points): give triangles of three vertex indices each")]
    NoFaces { points: usize },

    #[error(
        "point {vertex} of the mesh is not finite (NaN or infinite): remove it with its triangles, or give its place"
    )]
    PointNotFinite { vertex: usize },

    #[error(
        "point {vertex} of the mesh lies at {at:?} mm, beyond {FARTHEST:e} mm: is it right? give coordinates in mm"
    )]
    PointTooFar { vertex: usize, at: [f64; 3] },

    #[error(
        "the surface is {size:e} mm across; from {SMALLEST:e} mm on it can be measured: multiply its coordinates, or give \
         them in mm"
    )]
    SurfaceTooSmall { size: f64 },

    #[error(
        "the edge of vertices {a} and {b} is {length:e} mm long, and the surface {size:e} mm across: an edge is to have \
         {SHORTEST_EDGE:e} of that at least; merge its ends, or take a smaller part"
    )]
    EdgeTooShort { a: usize, b: usize, length: f64, size: f64 },

    #[error("triangle {face} names vertex {corner}, but the mesh has {points} vertices, counted from 0")]
    CornerOutOfRange { face: usize, corner: i64, points: usize },

    #[error(
        "triangle {face} has no area ({count} such): two of its corners coincide or all lie on a line; remove them and merge \
         the vertices, by PyVista's mesh.clean() for example"
    )]
    DegenerateFace { face: usize, count: usize },

    #[error("triangle {face} has the same corners as another ({count} such): give each triangle once")]
    DuplicateFace { face: usize, count: usize },

    #[error(
        "more than two triangles meet at the edge of vertices {a} and {b} ({count} such edges): a surface has two sides at \
         most there; remove the extra sheets"
    )]
    CrowdedEdge { a: usize, b: usize, count: usize },

    #[error(
        "the surface touches itself at vertex {vertex} ({count} such vertices): give each sheet a vertex of its own there, or \
         remove one of them"
    )]
    PinchedVertex { vertex: usize, count: usize },

    #[error(
        "the component of triangle {face} has only one side, like a Möbius strip: it has no outside and cannot be flattened; \
         cut it first"
    )]
    OneSided { face: usize },

    #[error(
        "no edge joins the vertices {a} and {b} of the path: name every vertex along it, or let a shortest path between the \
         chosen ones fill in the rest"
    )]
    NotAnEdge { a: usize, b: usize },

    #[error(
        "the factor of vertex {vertex} is {factor}: give a positive, finite factor, at most 1e100, for each vertex"
    )]
    FactorNotPositive { vertex: usize, factor: f64 },

    #[error("the relaxation option {name} is {value}: give a number that is not negative")]
    RelaxationOption { name: &'static str, value: f64 },

    #[error(
        "the surface falls into {count} components (of {sizes} triangles): open one at a time, the largest for example"
    )]
    SeveralComponents { count: usize, sizes: String },

    #[error(
        "cannot {doing} {path}: {reason}; finished rows are kept: see that the place is writable and has room, then run the \
         same again"
    )]
    StoreFailed { doing: &'static str, path: String, reason: String, code: Option<i32> },

    #[error("the store {path} is in use by {holder}: wait until that ends, or choose another directory")]
    StoreInUse { path: String, holder: String },

    #[error(
        "{path} is no journal of these rows: it is damaged, or of another surface, other sources or another version; choose \
         another directory, or delete this store"
    )]
    StoreForeign { path: String },

    #[error(
        "row {row} of {path} does not agree with its checksum: measure again with the same store, and it is computed anew"
    )]
    StoreDamaged { path: String, row: usize },

    #[error("cancelled")]
    Cancelled,
}

/// Are all of these among so many points?
pub fn check_points(vertices: impl IntoIterator<Item = u32>, points: usize) -> Result<()> {
    match vertices.into_iter().find(|&vertex| vertex as usize >= points) {
        Some(vertex) => Err(Error::NoSuchPoint { vertex: vertex as usize, points }),
        None => Ok(()),
    }
}

impl Error {
    /// Turns what the system says of a store's file into an error that names it.
    pub(crate) fn of_store(doing: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self {
        move |error| Self::StoreFailed {
            doing,
            path: path.display().to_string(),
            reason: error.to_string(),
            code: error.raw_os_error(),
        }
    }
}
