//! Basics that all other modules use: errors, limits, tables, variable-length integers, floats (their
//! rounding and order), random numbers, fast angles, short decimals, the clock, thread pools, and what computes
//! on several values at once.

pub mod error;
pub mod grid;
pub mod random;
pub mod varint;

mod section_kind;

pub(crate) mod angle;
pub(crate) mod clock;
pub(crate) mod decimal;
pub(crate) mod doubles;
pub(crate) mod floats;
pub(crate) mod lanes;
pub(crate) mod lazy_table;
pub(crate) mod team;

pub(crate) use section_kind::SKIPPABLE;
pub use section_kind::SectionKind;
