//! The body of a `binary_compressed` PCD: u32 compressed size, u32 uncompressed size, and the
//! records field by field (all x, then all y, ...), compressed with LZF.

use byteorder::{ByteOrder, LittleEndian};

use super::{lzf, records};
use crate::error::{Error, Result};
use crate::scan::{Layout, LzfDialect, ScanFile, Wrapping};

/// Bytes before the compressed ones.
const SIZES: usize = 8;

/// Takes a file apart whose body starts at byte `start`. `None` if the body is damaged or none of
/// the known compressors writes it.
pub(super) fn parse(layout: Layout, fields: Vec<u32>, bytes: &[u8], start: usize) -> Option<ScanFile> {
    let (sizes, rest) = bytes.get(start..)?.split_at_checked(SIZES)?;
    let packed_size = LittleEndian::read_u32(sizes) as usize;
    let size = LittleEndian::read_u32(&sizes[4..]) as usize;
    let (packed, suffix) = rest.split_at_checked(packed_size)?;
    let planes = lzf::decompress(packed, size)?;
    let stride = layout.stride as usize;
    if planes.len() % stride != 0 {
        return None;
    }
    let lzf = LzfDialect::ALL.into_iter().find(|&dialect| lzf::compress(&planes, dialect) == packed)?;
    let mut body = vec![0; planes.len()];
    for_each_value(&fields, planes.len() / stride, |in_planes, in_records| {
        body[in_records].copy_from_slice(&planes[in_planes]);
    });
    let cloud = records::split(&layout, &body);
    Some(ScanFile {
        name: String::new(),
        layout: Layout { wrapping: Wrapping::PcdCompressed { fields, lzf }, ..layout },
        prefix: bytes[..start].to_vec(),
        records: planes.len() / stride,
        cloud,
        suffix: suffix.to_vec(),
    })
}

/// Appends the body that holds these records.
///
/// # Errors
/// [`Error::Corrupt`] if the records take more than the 4 GiB that the format has room for.
pub(super) fn write(body: &[u8], fields: &[u32], dialect: LzfDialect, out: &mut Vec<u8>) -> Result<()> {
    let too_long = |_| Error::corrupt("records too long for a compressed PCD file");
    let stride: usize = fields.iter().map(|&width| width as usize).sum();
    let size = u32::try_from(body.len()).map_err(too_long)?;
    let mut planes = vec![0; body.len()];
    for_each_value(fields, body.len() / stride.max(1), |in_planes, in_records| {
        planes[in_planes].copy_from_slice(&body[in_records]);
    });
    let packed = lzf::compress(&planes, dialect);
    let packed_size = u32::try_from(packed.len()).map_err(too_long)?;
    out.extend(packed_size.to_le_bytes());
    out.extend(size.to_le_bytes());
    out.extend(packed);
    Ok(())
}

/// Calls `visit` with the place of each value field by field, and its place record by record.
fn for_each_value(
    fields: &[u32],
    records: usize,
    mut visit: impl FnMut(std::ops::Range<usize>, std::ops::Range<usize>),
) {
    let stride: usize = fields.iter().map(|&width| width as usize).sum();
    let mut in_planes = 0;
    let mut in_record = 0;
    for &width in fields {
        let width = width as usize;
        for record in 0..records {
            let at = record * stride + in_record;
            visit(in_planes..in_planes + width, at..at + width);
            in_planes += width;
        }
        in_record += width;
    }
}
