//! Replaces the image coders in builds without them.

use super::ImageCodec;
use crate::ground::error::{Error, Result};
use crate::ground::grid::Grid;

/// Always fails.
///
/// # Errors
/// [`Error::Unsupported`].
pub fn encode(codec: ImageCodec, _: Grid<i32>, _: &Grid<bool>, _: u8, _: Option<usize>) -> Result<Vec<u8>> {
    Err(not_built(codec))
}

/// Always fails.
///
/// # Errors
/// [`Error::Unsupported`].
pub fn decode(codec: ImageCodec, _: &[u8], _: usize, _: usize) -> Result<Grid<i32>> {
    Err(not_built(codec))
}

fn not_built(codec: ImageCodec) -> Error {
    Error::not_built(format!("ranges coded by {}", codec.name()), "article")
}
