//! The `lidarpc` program; see `lidarpc --help`.
fn main() {}
