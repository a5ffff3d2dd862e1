//! Files: scans in memory and back, and the frames of an input.

mod lzf;
