//! The header of a baseline JPEG image of one component (ITU-T T.81, annex B). It follows from data that the
//! decoder has, so it is not in the stream and cannot be damaged: the tables of annex K, with the
//! quantisation tables scaled by the quality as the Independent JPEG Group does. FORMAT.md 8.14.

/// The end marker of the image.
pub const END: [u8; 2] = [0xff, 0xd9];

/// The last segment of the header: the only component, with the first tables and all frequencies.
pub const SCAN_HEADER: [u8; 10] = [0xff, 0xda, 0, 8, 1, 1, 0, 0, 63, 0];

/// Table K.1, row by row.
#[rustfmt::skip]
const QUANTISATION: [u8; 64] = [
    16, 11, 10, 16, 24, 40, 51, 61,
    12, 12, 14, 19, 26, 58, 60, 55,
    14, 13, 16, 24, 40, 57, 69, 56,
    14, 17, 22, 29, 51, 87, 80, 62,
    18, 22, 37, 56, 68, 109, 103, 77,
    24, 35, 55, 64, 81, 104, 113, 92,
    49, 64, 78, 87, 103, 121, 120, 101,
    72, 92, 95, 98, 112, 100, 103, 99,
];

/// Table K.3: the number of codes of each length, from 1 bit on, and their values.
pub const DC_LENGTHS: [u8; 16] = [0, 1, 5, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0];
pub const DC_VALUES: [u8; 12] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11];

/// Table K.5.
pub const AC_LENGTHS: [u8; 16] = [0, 2, 1, 3, 3, 2, 4, 3, 5, 5, 4, 4, 0, 0, 1, 0x7d];
#[rustfmt::skip]
pub const AC_VALUES: [u8; 162] = [
    0x01, 0x02, 0x03, 0x00, 0x04, 0x11, 0x05, 0x12, 0x21, 0x31, 0x41, 0x06, 0x13, 0x51, 0x61, 0x07,
    0x22, 0x71, 0x14, 0x32, 0x81, 0x91, 0xa1, 0x08, 0x23, 0x42, 0xb1, 0xc1, 0x15, 0x52, 0xd1, 0xf0,
    0x24, 0x33, 0x62, 0x72, 0x82, 0x09, 0x0a, 0x16, 0x17, 0x18, 0x19, 0x1a, 0x25, 0x26, 0x27, 0x28,
    0x29, 0x2a, 0x34, 0x35, 0x36, 0x37, 0x38, 0x39, 0x3a, 0x43, 0x44, 0x45, 0x46, 0x47, 0x48, 0x49,
    0x4a, 0x53, 0x54, 0x55, 0x56, 0x57, 0x58, 0x59, 0x5a, 0x63, 0x64, 0x65, 0x66, 0x67, 0x68, 0x69,
    0x6a, 0x73, 0x74, 0x75, 0x76, 0x77, 0x78, 0x79, 0x7a, 0x83, 0x84, 0x85, 0x86, 0x87, 0x88, 0x89,
    0x8a, 0x92, 0x93, 0x94, 0x95, 0x96, 0x97, 0x98, 0x99, 0x9a, 0xa2, 0xa3, 0xa4, 0xa5, 0xa6, 0xa7,
    0xa8, 0xa9, 0xaa, 0xb2, 0xb3, 0xb4, 0xb5, 0xb6, 0xb7, 0xb8, 0xb9, 0xba, 0xc2, 0xc3, 0xc4, 0xc5,
    0xc6, 0xc7, 0xc8, 0xc9, 0xca, 0xd2, 0xd3, 0xd4, 0xd5, 0xd6, 0xd7, 0xd8, 0xd9, 0xda, 0xe1, 0xe2,
    0xe3, 0xe4, 0xe5, 0xe6, 0xe7, 0xe8, 0xe9, 0xea, 0xf1, 0xf2, 0xf3, 0xf4, 0xf5, 0xf6, 0xf7, 0xf8,
    0xf9, 0xfa,
];

/// All bytes before the scan data, for a quality from 1 to 100.
pub fn header(rows: u16, columns: u16, quality: u8) -> Vec<u8> {
    let mut out = vec![0xff, 0xd8]; // SOI
    segment(&mut out, 0xdb, &[&[0], &quantisation(quality)]);
    let (rows, columns) = (rows.to_be_bytes(), columns.to_be_bytes());
    // Eight bits, one component, sampled once, by quantisation table 0.
    segment(&mut out, 0xc0, &[&[8], &rows, &columns, &[1, 1, 0x11, 0]]);
    segment(&mut out, 0xc4, &[&[0x00], &DC_LENGTHS, &DC_VALUES]);
    segment(&mut out, 0xc4, &[&[0x10], &AC_LENGTHS, &AC_VALUES]);
    out.extend(SCAN_HEADER);
    out
}

/// The quantisation table for a quality, in zigzag order.
pub fn quantisation(quality: u8) -> [u8; 64] {
    let quality = u32::from(quality.clamp(1, 100));
    let scale = if quality < 50 { 5000 / quality } else { 200 - 2 * quality };
    zigzag().map(|place| ((u32::from(QUANTISATION[place]) * scale + 50) / 100).clamp(1, 255) as u8)
}

/// The positions in a block of 8 x 8 in ascending order of frequency: along the diagonals, alternately up and
/// down.
pub fn zigzag() -> [usize; 64] {
    let mut places: [usize; 64] = std::array::from_fn(|place| place);
    places.sort_by_key(|place| {
        let (row, column) = (place / 8, place % 8);
        (row + column, if (row + column) % 2 == 0 { column } else { row })
    });
    places
}

fn segment(out: &mut Vec<u8>, marker: u8, parts: &[&[u8]]) {
    let length: usize = 2 + parts.iter().map(|part| part.len()).sum::<usize>();
    out.extend([0xff, marker]);
    out.extend((length as u16).to_be_bytes());
    parts.iter().for_each(|part| out.extend_from_slice(part));
}

#[cfg(test)]
mod tests {
    use image::ExtendedColorType;
    use image::codecs::jpeg::JpegEncoder;

    use super::*;

    /// The library's own header also contains a format name, and has another order; both headers must decode
    /// to the same samples.
    #[test]
    fn the_header_is_as_good_as_the_librarys() {
        let (rows, columns) = (17, 30);
        let samples: Vec<u8> = (0..rows * columns).map(|i| (i * i / 7 + i % 30 * 6) as u8).collect();
        for quality in [1, 20, 50, 77, 100] {
            let mut stream = Vec::new();
            let mut encoder = JpegEncoder::new_with_quality(&mut stream, quality);
            encoder.encode(&samples, columns, rows, ExtendedColorType::L8).unwrap();
            let scan = stream.windows(10).position(|bytes| bytes == SCAN_HEADER).unwrap() + 10;
            let own = [&header(rows as u16, columns as u16, quality)[..], &stream[scan..]].concat();
            let [theirs, own] = [stream, own].map(|stream| image::load_from_memory(&stream).unwrap());
            assert!(theirs == own && theirs.to_luma8().as_raw() != &samples, "quality {quality}");
        }
    }
}
