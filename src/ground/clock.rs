//! The clock that steps are timed by.

#[cfg(not(all(target_family = "wasm", target_os = "unknown")))]
pub(crate) use std::time::Instant;

/// Stands still: a WebAssembly module has no clock unless its host lends it one, and `std`'s panics.
#[cfg(all(target_family = "wasm", target_os = "unknown"))]
#[derive(Clone, Copy)]
pub(crate) struct Instant;

#[cfg(all(target_family = "wasm", target_os = "unknown"))]
impl Instant {
    pub fn now() -> Self {
        Instant
    }

    pub fn elapsed(self) -> std::time::Duration {
        std::time::Duration::ZERO
    }
}
