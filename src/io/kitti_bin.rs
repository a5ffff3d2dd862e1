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

#[cfg(test)]
mod tests {
    use crate::io::tests::{comes_back, floats};

    #[test]
    fn kitti_records_are_four_values() {
        let scan =
            comes_back("0.bin", [floats(&[1.0, 2.0, 3.0, 0.5, -0.0, 5.0, 6.0, 0.25]), vec![9; 15]].concat());
        assert_eq!(scan.cloud.positions, [[1.0, 2.0, 3.0], [-0.0, 5.0, 6.0]]);
        assert!(scan.cloud.positions[1][0].is_sign_negative());
        assert_eq!(scan.cloud.intensity, [0.5, 0.25]);
        assert_eq!(scan.suffix, [9; 15]);
    }

    #[test]
    fn nuscenes_records_have_a_ring_too() {
        let scan = comes_back("0.pcd.bin", [floats(&[1.0, 2.0, 3.0, 40.0, 31.0]), vec![9]].concat());
        assert_eq!((scan.records, scan.cloud.intensity[0]), (1, 40.0));
        assert_eq!(scan.cloud.extra, floats(&[31.0]));
        assert_eq!(scan.suffix, [9]);
    }

    #[test]
    fn every_bit_of_nan_is_kept() {
        let payloads = [0x7f80_0001u32, 0xffc1_2345, 0x7fc0_0000, 0x8000_0000];
        let scan = comes_back("0.bin", payloads.iter().flat_map(|p| p.to_le_bytes()).collect());
        assert_eq!(scan.records, 1);
    }

    #[test]
    fn an_empty_file_has_no_records() {
        let scan = comes_back("0.bin", vec![]);
        assert_eq!((scan.records, scan.is_opaque()), (0, false));
    }
}
