//! Basics that all other modules use: errors, limits, tables, variable-length integers, rounding, random
//! numbers, fast angles, the order of floats, short decimals, the clock, thread pools, and the helper for
//! vector units.

pub mod error;
pub mod grid;
pub mod random;
pub mod rounding;
pub mod varint;

mod section_kind;

pub(crate) mod angle;
pub(crate) mod clock;
pub(crate) mod decimal;
pub(crate) mod float_order;
pub(crate) mod lanes;
pub(crate) mod lazy_table;
pub(crate) mod team;

pub(crate) use section_kind::SKIPPABLE;
pub use section_kind::SectionKind;
