//! The errors of this crate. Every message names the value and tells the user what to do.

use std::io;
use std::path::Path;

use crate::scales::{FARTHEST, SHORTEST_EDGE, SMALLEST};

/// The result of every operation of this crate that can fail.
pub type Result<T> = std::result::Result<T, Error>;

/// The reason why an input is refused or a computation stopped.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs)] // the message of each variant is its description
#[non_exhaustive]
pub enum Error {
    #[error(
        "the graph needs {links} links between {vertices} vertices, more than a 32-bit index allows. Flatten a smaller \
         patch, or use a coarser surface"
    )]
    TooManyLinks { links: usize, vertices: usize },

    #[error("the matrix for {vertices} vertices is too large. Flatten a smaller patch, or use a coarser surface")]
    TooManySprings { vertices: usize },

    #[error("the edge lengths vary too much to compute a map. Remesh the surface, or flatten a smaller patch")]
    Uneven,

    #[error(
        "{triangles} triangles are too thin, or the boundary around them is too short, for a map without folds. Remesh \
         the surface, cut it open further, or flatten a smaller patch"
    )]
    Folded { triangles: usize },

    #[error(
        "the surface has {loops} boundary loops, or its seam does not open it, but a periodic map requires a tube with \
         two ends. Cut the ends off, or flatten it without a period"
    )]
    NotATube { loops: usize },

    #[error("the start has {places} positions, but the surface has {points} vertices. Pass one position per vertex")]
    StartMismatch { places: usize, points: usize },

    #[error("vertex {vertex} of the start has no finite position. Pass a finite position for every vertex")]
    StartNotFinite { vertex: usize },

    #[error("the start has {triangles} flipped triangles that cannot be unfolded. Pass another map, or omit the start")]
    StartFolded { triangles: usize },

    #[error(
        "the boundary of the start crosses or touches itself {crossings} times. Pass a map that does not overlap \
         itself, or omit the start"
    )]
    StartCrosses { crossings: usize },

    #[error("the start has almost no area, so it cannot be improved. Pass another map, or omit the start")]
    StartStuck,

    #[error("the volume has {given} values, but its shape {shape:?} requires {needed}. Pass one value per voxel")]
    ShapeMismatch { shape: [usize; 3], given: usize, needed: usize },

    #[error(
        "the volume of shape {shape:?} is too large: an axis can have at most 2097152 voxels. Crop or downsample the \
         volume"
    )]
    VolumeTooLarge { shape: [usize; 3] },

    #[error(
        "the voxels are {longest} mm long and {shortest} mm wide. Above a ratio of {most} to 1, lengths of digital \
         paths cannot be measured. Resample the volume to more isotropic voxels"
    )]
    TooAnisotropic { longest: f64, shortest: f64, most: f64 },

    #[error("the volume (shape {shape:?}) has no foreground voxels. Choose another label or threshold")]
    EmptyForeground { shape: [usize; 3] },

    #[error("the affine contains {value} at row {row}, column {column}. Pass a finite affine or spacing")]
    AffineNotFinite { row: usize, column: usize, value: f64 },

    #[error("the last row of the affine is {row:?}, not [0, 0, 0, 1]. Pass an affine that maps voxel indices to mm")]
    AffineNotAffine { row: [f64; 4] },

    #[error("the spacing of axis {axis} is {spacing} mm. Pass a positive spacing")]
    SpacingNotPositive { axis: usize, spacing: f64 },

    #[error(
        "the affine contains {value} at row {row}, column {column}, which exceeds {FARTHEST:e} mm. Pass the affine in \
         mm, or repair the header"
    )]
    AffineTooFar { row: usize, column: usize, value: f64 },

    #[error(
        "the spacing of axis {axis} is {spacing:e} mm, which is less than {SMALLEST:e} mm. Repair the header, or pass \
         the spacing in mm"
    )]
    SpacingTooSmall { axis: usize, spacing: f64 },

    #[error(
        "voxel {voxel:?} of the volume is at {at:?} mm, more than {FARTHEST:e} mm from the origin. Pass the affine in \
         mm, or crop the volume"
    )]
    VoxelTooFar { voxel: [usize; 3], at: [f64; 3] },

    #[error(
        "the affine is sheared: the cosine of the angle between axes {first} and {second} is {cosine:.4}. Resample the \
         volume to an orthogonal grid"
    )]
    AffineSheared { first: usize, second: usize, cosine: f64 },

    #[error(
        "the surface has only {points} points, but flattening needs at least {needed}. Choose a larger patch or \
         another label"
    )]
    TooFewPoints { points: usize, needed: usize },

    #[error("{sources} sources are too few. Pass at least {needed}")]
    TooFewSources { sources: usize, needed: usize },

    #[error("{sources} sources are given, but the surface has only {points} points. Pass at most {points} sources")]
    TooManySources { sources: usize, points: usize },

    #[error("voxel {voxel:?} is not on the surface. Pass a surface voxel; the nearest one is {nearest:?}")]
    NotOnSurface { voxel: [i64; 3], nearest: [u32; 3] },

    #[error(
        "point {vertex} does not exist: the surface has {points} points, counted from 0. Pass the number of a point"
    )]
    NoSuchPoint { vertex: usize, points: usize },

    #[error("point {vertex} appears more than once among the sources. Pass each source once")]
    DuplicateSource { vertex: usize },

    #[error(
        "the seed point {voxel:?} is {distance:.1} mm away from the surface (nearest surface voxel {nearest:?}), which \
         is farther than the patch radius of {radius} mm. Choose a seed point on the surface"
    )]
    SeedOffSurface { voxel: [i64; 3], nearest: [u32; 3], distance: f64, radius: f64 },

    #[error("the patch radius is {radius} mm. Pass a positive, finite radius")]
    RadiusNotPositive { radius: f64 },

    #[error(
        "the patch mask contains none of the {points} surface voxels. Check that the mask overlaps the border of the \
         label"
    )]
    EmptyPatch { points: usize },

    #[error(
        "point {vertex} cannot be reached from source {source_vertex}, because they lie in different components. Keep \
         one component, or flatten a patch around a seed point"
    )]
    Unreachable { source_vertex: usize, vertex: usize },

    #[error(
        "the patch has {count} separate pieces ({sizes} voxels). Keep one piece, or pass a seed point and a radius"
    )]
    Disconnected { count: usize, sizes: String },

    #[error(
        "the surface is closed: {touching} of its {points} surface voxels enclose an interior (Euler characteristic \
         {euler}), so it cannot be flattened without a cut. Flatten a patch: pass a seed point and a radius in mm, or \
         a mask of the region to keep"
    )]
    Closed { points: usize, touching: usize, euler: i64 },

    #[error(
        "the distances do not describe a surface: only {positive} eigenvalue(s) of the scaling are positive, but two \
         are needed. The patch is a line or a point. Choose a wider patch"
    )]
    NotPlanar { positive: usize },

    #[error("the eigenvalue solver did not converge for {sources} sources. Try another number of sources")]
    EigenNotConverged { sources: usize },

    #[error("the radial functions of {sources} sources are singular. Try another number of sources, or another seed")]
    RadialSingular { sources: usize },

    #[error("the pixel size is {pixel_size} mm. Pass a positive, finite size")]
    PixelSizeNotPositive { pixel_size: f64 },

    #[error("the flat image would have {width} x {height} pixels. Pass a pixel size above {pixel_size} mm")]
    RasterTooLarge { width: f64, height: f64, pixel_size: f64 },

    #[error("a surface with {points} points is too large for this graph (at most {most}). Flatten a smaller patch")]
    GraphTooLarge { points: usize, most: usize },

    #[error(
        "the surface is not a disk: it has {components} component(s), {loops} boundary loop(s), {handles} handle(s) \
         and Euler characteristic {euler} instead of 1. Choose a patch, cut the surface open, or repair it; voxflat \
         check reports the effect of each remedy"
    )]
    NotADisk { components: usize, loops: usize, handles: usize, euler: i64 },

    #[error(
        "the surface is not a sphere: it has {components} component(s), {loops} boundary loop(s) and {handles} \
         handle(s). Keep one component, repair its handles, and close its holes"
    )]
    NotASphere { components: usize, loops: usize, handles: usize },

    #[error("no triangle around vertex {vertex} lies within {radius} mm of it. Pass a larger radius")]
    EmptyDisk { vertex: usize, radius: f64 },

    #[error(
        "the disk of {radius} mm ({own:.0} mm²) encloses a region of {area:.0} mm² around ({:.0}, {:.0}, {:.0}) mm \
         that extends beyond the radius, such as a gyrus with a narrow neck. Choose another seed point or another \
         radius",
        at[0], at[1], at[2]
    )]
    DiskEncloses { radius: f64, area: f64, own: f64, at: [f64; 3] },

    #[error("the decimation option {name} is {value}. Pass a positive number (evenness may be 0)")]
    DecimationOption { name: &'static str, value: f64 },

    #[error(
        "no grid cell has a point at each of its four corners ({sources} sources lie on the grid). Pass more sources, \
         or let decimation choose them"
    )]
    NoCell { sources: usize },

    #[error("the angle is {angle}°. Pass an angle from {least}° to {most}°")]
    AngleOutOfRange { angle: f64, least: f64, most: f64 },

    #[error(
        "the bound C is {bound}. Pass a bound from {least} (an angle of 0.01°) to {most} (80°); a bound of 1 means an \
         isometry"
    )]
    BoundOutOfRange { bound: f64, least: f64, most: f64 },

    #[error("patches cannot be glued within a bound of {bound} on C. Pass a bound from {least} to {most}, such as 1.5")]
    GlueBoundOutOfRange { bound: f64, least: f64, most: f64 },

    #[error(
        "the patches already change lengths by a factor of up to {before:.6}, so they cannot be glued within a bound \
         of {bound}. Pass a greater bound, or make the patches with an angle of at most {angle:.4}°"
    )]
    PatchesBeyondBound { bound: f64, before: f64, angle: f64 },

    #[error(
        "the patches cannot be glued into one piece within C ≤ {bound}: {pieces} pieces remain. Pass a greater bound, \
         flatten a smaller patch, or keep the pieces with Surface.patches(...).glue(...)"
    )]
    NotOnePiece { bound: f64, pieces: usize },

    #[error(
        "{count} patches are too few for this surface: even at an angle of {most}°, {least} patches are needed. Pass \
         at least {least} patches"
    )]
    TooFewPatches { count: usize, least: usize, most: f64 },

    #[error("the polygon has {corners} corners, but at least 3 are needed. Pass more corners")]
    FewCorners { corners: usize },

    #[error(
        "the shortest paths between the {corners} corners of the polygon do not enclose a region, because they run \
         around a handle or along one line. Choose other or additional corners"
    )]
    NotEnclosing { corners: usize },

    #[error("the mesh has {points} points but no triangles. Pass triangles of three vertex indices each")]
    NoFaces { points: usize },

    #[error(
        "point {vertex} of the mesh is not finite (NaN or infinite). Correct its coordinates, or remove the point and \
         its triangles"
    )]
    PointNotFinite { vertex: usize },

    #[error(
        "point {vertex} of the mesh is at {at:?} mm, more than {FARTHEST:e} mm from the origin. Check the coordinates, \
         and pass them in mm"
    )]
    PointTooFar { vertex: usize, at: [f64; 3] },

    #[error(
        "the surface is {size:e} mm across, which is less than the minimum of {SMALLEST:e} mm. Scale its coordinates, \
         or pass them in mm"
    )]
    SurfaceTooSmall { size: f64 },

    #[error(
        "the edge between vertices {a} and {b} is {length:e} mm long, on a surface that is {size:e} mm across. An edge \
         must be at least {SHORTEST_EDGE:e} times the size of the surface. Merge its two vertices, or use a smaller \
         part"
    )]
    EdgeTooShort { a: usize, b: usize, length: f64, size: f64 },

    #[error(
        "triangle {face} refers to vertex {corner}, but the mesh has {points} vertices, counted from 0. Correct the \
         triangle"
    )]
    CornerOutOfRange { face: usize, corner: i64, points: usize },

    #[error(
        "triangle {face} has no area ({count} such triangles): two of its corners coincide, or all three lie on a \
         line. Remove these triangles and merge their vertices, for example with PyVista's mesh.clean()"
    )]
    DegenerateFace { face: usize, count: usize },

    #[error("triangle {face} has the same corners as another one ({count} such triangles). Pass each triangle once")]
    DuplicateFace { face: usize, count: usize },

    #[error(
        "more than two triangles meet at {}, between the vertices {}. Remove the additional triangles, so that \
         the surface has at most two at each edge",
        if edges.len() == 1 { "an edge".into() } else { format!("{} edges", edges.len()) }, pairs(edges)
    )]
    CrowdedEdges { edges: Vec<[u32; 2]> },

    #[error(
        "the surface touches itself at vertex {vertex} ({count} such vertices). Give each part of the surface its own \
         vertex there, or remove one part"
    )]
    PinchedVertex { vertex: usize, count: usize },

    #[error(
        "the component of triangle {face} has only one side, like a Möbius strip, so it has no outside and cannot be \
         flattened. Cut the component first"
    )]
    OneSided { face: usize },

    #[error(
        "the vertices {a} and {b} of the path are not connected by an edge. List every vertex along the path, or let a \
         shortest path connect the chosen ones"
    )]
    NotAnEdge { a: usize, b: usize },

    #[error(
        "the factor of vertex {vertex} is {factor}. Pass a positive, finite factor of at most 1e100 for each vertex"
    )]
    FactorNotPositive { vertex: usize, factor: f64 },

    #[error("the relaxation option {name} is {value}. Pass a non-negative number")]
    RelaxationOption { name: &'static str, value: f64 },

    #[error(
        "the surface has {count} components ({sizes} triangles). Open one component at a time, such as the largest"
    )]
    SeveralComponents { count: usize, sizes: String },

    #[error(
        "cannot {doing} {path}: {reason}. Finished rows are kept. Make sure that the directory is writable and has \
         free space, then run the same command again"
    )]
    StoreFailed { doing: &'static str, path: String, reason: String, code: Option<i32> },

    #[error("the store {path} is in use by {holder}. Wait until that process ends, or choose another directory")]
    StoreInUse { path: String, holder: String },

    #[error(
        "{path} is not a journal of these distance rows: it is damaged, or it belongs to a different surface, \
         different sources or a different version. Choose another directory, or delete this store"
    )]
    StoreForeign { path: String },

    #[error("row {row} of {path} does not match its checksum. Measure again with the same store to recompute the row")]
    StoreDamaged { path: String, row: usize },

    #[error("there are {given} {values}, but {needed} {items}. Pass one for each")]
    WrongLength { values: &'static str, given: usize, items: &'static str, needed: usize },

    #[error("half-edge {half_edge} is not on the other side of its twin. Create the surface from its triangles")]
    TwinsDisagree { half_edge: usize },

    #[error("there are no random starts. Pass at least one")]
    NoStarts,

    #[error("the distance rows are not those of the levels. Measure them with the same levels")]
    ForeignRows,

    #[error("template {template} does not exist: there are {templates}. Pass the index of one of the templates")]
    NoSuchTemplate { template: usize, templates: usize },

    #[error("cancelled")]
    Cancelled,
}

/// Returns edges as text: all of up to ten, or the first ones.
fn pairs(edges: &[[u32; 2]]) -> String {
    let shown: Vec<String> = edges.iter().take(10).map(|[a, b]| format!("{a} and {b}")).collect();
    if edges.len() > 10 { format!("{}, ...", shown.join(", ")) } else { shown.join(", ") }
}

/// Checks that every vertex is less than the number of points.
///
/// # Errors
/// [`Error::NoSuchPoint`] for the first vertex that does not exist.
pub fn check_points(vertices: impl IntoIterator<Item = u32>, points: usize) -> Result<()> {
    match vertices.into_iter().find(|&vertex| vertex as usize >= points) {
        Some(vertex) => Err(Error::NoSuchPoint { vertex: vertex as usize, points }),
        None => Ok(()),
    }
}

/// Checks that there is one value for each item.
pub(crate) fn check_length(values: &'static str, given: usize, items: &'static str, needed: usize) -> Result<()> {
    if given == needed { Ok(()) } else { Err(Error::WrongLength { values, given, items, needed }) }
}

impl Error {
    /// Turns an error of the operating system about a file of a store into one that names the file.
    pub(crate) fn of_store(doing: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self {
        move |error| Self::StoreFailed {
            doing,
            path: path.display().to_string(),
            reason: error.to_string(),
            code: error.raw_os_error(),
        }
    }
}
