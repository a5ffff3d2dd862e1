//! What stands in for the image coders where they are not built.

use super::ImageCodec;
use crate::ground::error::{Error, Result};
use crate::ground::grid::Grid;

/// Encodes nothing.
///
/// # Errors
/// [`Error::Unsupported`].
pub fn encode(codec: ImageCodec, _: Grid<i32>, _: &Grid<bool>, _: u8, _: Option<usize>) -> Result<Vec<u8>> {
    Err(not_built(codec))
}

/// Decodes nothing.
///
/// # Errors
/// [`Error::Unsupported`].
pub fn decode(codec: ImageCodec, _: &[u8], _: usize, _: usize) -> Result<Grid<i32>> {
    Err(not_built(codec))
}

fn not_built(codec: ImageCodec) -> Error {
    Error::not_built(format!("ranges coded by {}", codec.name()), "article")
}
