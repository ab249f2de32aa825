//! The unit sphere: closed surfaces laid out on it, and registered to a template's.
//!
//! | module | concept |
//! |---|---|
//! | [`map`] | a closed surface without handles onto the unit sphere, one to one |
//! | [`locate`] | which triangle on the sphere holds a place |
//! | [`pattern`] | folds at several scales, for any mesh alike |
//! | [`register`] | a sphere rotated and warped until its pattern is the template's |

pub mod locate;
pub mod map;
pub mod pattern;
pub mod register;

#[cfg(test)]
mod tests;
