//! Complete methods, composed of the stages: one file per method, and their common parts.

mod check;
pub mod grossmann2002;
mod map;
pub mod periodic;
pub mod relaxation;
pub mod saucan2006;
pub mod schwartz1989;
pub mod voxflat;
pub mod zigelman2002;

pub use check::{check_disk, check_domain, check_flattenable};
pub use grossmann2002::grossmann2002;
pub use map::FlatMap;
pub use periodic::periodic;
pub use relaxation::relax;
pub use saucan2006::saucan2006;
pub use schwartz1989::schwartz1989;
pub use voxflat::voxflat;
pub use zigelman2002::zigelman2002;
