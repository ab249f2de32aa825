//! The unit sphere: maps of closed surfaces, and their registration to a template.
//!
//! | module | contents |
//! |---|---|
//! | [`map`] | one-to-one maps of closed surfaces without handles onto the unit sphere |
//! | [`locate`] | the triangle on the sphere at a position |
//! | [`pattern`] | the pattern of folds at several scales, comparable between meshes |
//! | [`register`] | rotation and warp of a sphere to match a template's pattern |

pub mod locate;
pub mod map;
pub mod pattern;
pub mod register;

#[cfg(test)]
mod tests;
