//! No compression.

use super::{Backend, Level};
use crate::ground::error::Result;

/// Stores bytes as they are.
pub struct Store;

impl Backend for Store {
    fn id(&self) -> u8 {
        0
    }

    fn name(&self) -> &'static str {
        "store"
    }

    #[cfg(not(target_family = "wasm"))]
    fn compress(&self, input: &[u8], _level: Level) -> Result<Vec<u8>> {
        Ok(input.to_vec())
    }

    fn decompress_unchecked(&self, input: &[u8], _length: usize) -> Result<Vec<u8>> {
        Ok(input.to_vec())
    }
}
