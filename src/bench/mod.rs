//! The article's experiments on anyone's frames.

mod figure_13;

pub use figure_13::{Figure13, Figure13Bench, Sizes};
