//! The unit sphere: closed surfaces laid out on it, and what is found there.
//!
//! | module | concept |
//! |---|---|
//! | [`map`] | a closed surface without handles onto the unit sphere, one to one |

pub mod map;
