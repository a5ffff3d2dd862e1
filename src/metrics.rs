//! Fit of decoded data to the original.
