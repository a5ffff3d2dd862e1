//! Instruments: the article's experiments, measures of error, pictures, and simulated drives.

pub mod bench;
pub mod metrics;
pub mod picture;
pub mod synth;
