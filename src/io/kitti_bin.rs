//! Headerless float32 records: KITTI's `.bin` and nuScenes' `.pcd.bin`.
//!
//! Sources: A. Geiger et al., "Vision meets Robotics: The KITTI Dataset" (raw data development
//! kit); nuScenes devkit, `LidarPointCloud.from_file`.

use super::records::plain_file;
use crate::scan::{Layout, ScanFile, Wrapping};

/// KITTI: little-endian float32 x, y, z (metres), intensity. What is left over is `suffix`.
pub(super) fn parse_kitti(bytes: &[u8]) -> Option<ScanFile> {
    plain_file(layout(16), bytes, 0, u64::MAX)
}

/// nuScenes: little-endian float32 x, y, z (metres), intensity, ring. What is left over is `suffix`.
pub(super) fn parse_nuscenes(bytes: &[u8]) -> Option<ScanFile> {
    plain_file(layout(20), bytes, 0, u64::MAX)
}

fn layout(stride: u32) -> Layout {
    Layout { wrapping: Wrapping::Plain, stride, position: Some([0, 4, 8]), intensity: Some(12) }
}
