//! The body of a `binary_compressed` PCD: u32 compressed size, u32 uncompressed size, and the
//! records field by field (all x, then all y, ...), compressed with LZF. FORMAT.md 9.

use byteorder::{ByteOrder, LittleEndian};

use super::{by_field, lzf, records};
use crate::ground::error::{Error, Result};
use crate::scan::{Layout, LzfDialect, ScanFile, Wrapping};

/// Bytes before the compressed data: the two sizes.
const SIZES: usize = 8;

/// Splits a file whose body starts at byte `start`. `None` if the body is damaged, or if none of the known
/// compressors would write it.
pub(super) fn parse(layout: Layout, bytes: &[u8], start: usize) -> Option<ScanFile> {
    let (sizes, rest) = bytes.get(start..)?.split_at_checked(SIZES)?;
    let packed_size = LittleEndian::read_u32(sizes) as usize;
    let size = LittleEndian::read_u32(&sizes[4..]) as usize;
    let (packed, suffix) = rest.split_at_checked(packed_size)?;
    let planes = lzf::decompress(packed, size)?;
    let stride = layout.stride();
    if planes.len() % stride != 0 {
        return None;
    }
    let lzf = LzfDialect::ALL.into_iter().find(|&dialect| lzf::compress(&planes, dialect) == packed)?;
    let body = by_field::to_records(&planes, &layout.fields);
    let (layout, cloud) = records::split(layout, &body);
    Some(ScanFile {
        name: String::new(),
        layout: Layout { wrapping: Wrapping::PcdCompressed { lzf }, ..layout },
        prefix: bytes[..start].to_vec(),
        records: planes.len() / stride,
        cloud,
        suffix: suffix.to_vec(),
    })
}

/// The body with these records.
///
/// # Errors
/// [`Error::Corrupt`] if the records take more than the 4 GiB that the format allows.
pub(super) fn write(body: &[u8], layout: &Layout, dialect: LzfDialect) -> Result<Vec<u8>> {
    let too_long = |_| Error::corrupt("records too long for a compressed PCD file");
    let size = u32::try_from(body.len()).map_err(too_long)?;
    let packed = lzf::compress(&by_field::from_records(body, &layout.fields), dialect);
    let packed_size = u32::try_from(packed.len()).map_err(too_long)?;
    Ok([&packed_size.to_le_bytes()[..], &size.to_le_bytes(), &packed].concat())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::tests::{comes_back, floats, pcd};

    /// 200 points whose y is constant, so that there is something to compress.
    fn planes() -> Vec<u8> {
        let x: Vec<f32> = (0..200).map(|i| i as f32 * 0.25).collect();
        [floats(&x), floats(&[1.5; 200]), floats(&x), (0..200).collect()].concat()
    }

    fn file(packed: &[u8], size: usize) -> Vec<u8> {
        let header = pcd("x y z ring", "4 4 4 1", "F F F U", "1 1 1 1", 200, "binary_compressed");
        let sizes = [(packed.len() as u32).to_le_bytes(), (size as u32).to_le_bytes()].concat();
        [header, sizes, packed.to_vec()].concat()
    }

    #[test]
    fn fields_are_gathered_into_records() {
        for dialect in LzfDialect::ALL {
            let mut bytes = file(&lzf::compress(&planes(), dialect), 2600);
            bytes.extend(b"more");
            let scan = comes_back("a.pcd", bytes);
            assert_eq!(scan.records, 200);
            assert_eq!(scan.cloud.positions[3], [0.75, 1.5, 0.75]);
            assert_eq!(scan.cloud.channels[0].bytes[199], 199);
            assert_eq!(scan.suffix, b"more");
        }
    }

    #[test]
    fn bytes_of_another_compressor_are_opaque() {
        let stored: Vec<u8> = planes().chunks(10).flat_map(|c| [&[9], c].concat()).collect();
        assert_eq!(lzf::decompress(&stored, 2600).unwrap(), planes());
        assert!(comes_back("a.pcd", file(&stored, 2600)).is_opaque());
    }

    #[test]
    fn damaged_sizes_are_opaque() {
        let packed = lzf::compress(&planes(), LzfDialect::Ultra13);
        for size in [0, 2599, 2601, u32::MAX as usize] {
            assert!(comes_back("a.pcd", file(&packed, size)).is_opaque(), "{size}");
        }
        let whole = file(&packed, 2600);
        assert!(comes_back("a.pcd", whole[..whole.len() - 1].to_vec()).is_opaque());
    }

    #[test]
    fn no_points_are_no_records() {
        let scan = comes_back("a.pcd", file(&[], 0));
        assert_eq!((scan.records, scan.is_opaque()), (0, false));
    }
}
