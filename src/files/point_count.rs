//! Headers with another number of points.

use super::{arrow, las, numpy};

/// The header of a file, with everything before its points, changed to `points` points. Bytes that are not a
/// header, or a header without a number of points, are returned unchanged.
pub fn with_point_count(header: &[u8], points: usize) -> Vec<u8> {
    let in_place = las::with_point_count(header, points)
        .or_else(|| numpy::with_point_count(header, points))
        .or_else(|| arrow::with_point_count(header, points));
    in_place.unwrap_or_else(|| with_count_in_lines(header, points))
}

/// As [`with_point_count`], for PCD and PLY.
fn with_count_in_lines(header: &[u8], points: usize) -> Vec<u8> {
    let is_ply = header.starts_with(b"ply");
    let mut out = Vec::with_capacity(header.len());
    let mut is_over = false;
    for line in header.split_inclusive(|&byte| byte == b'\n') {
        let words: Vec<&[u8]> = line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty()).collect();
        is_over |= matches!(words[..], [b"end_header"] | [b"DATA", _]);
        let (count, number) = match words[..] {
            _ if is_over => {
                out.extend_from_slice(line);
                continue;
            }
            [b"element", b"vertex", number] if is_ply => (points, number),
            [b"WIDTH" | b"POINTS", number] if !is_ply => (points, number),
            // One row, because the remaining points of an organised cloud are no longer a table.
            [b"HEIGHT", number] if !is_ply => (1, number),
            _ => {
                out.extend_from_slice(line);
                continue;
            }
        };
        let start = number.as_ptr() as usize - line.as_ptr() as usize;
        out.extend_from_slice(&line[..start]);
        out.extend_from_slice(count.to_string().as_bytes());
        out.extend_from_slice(&line[start + number.len()..]);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_replaced_and_the_rest_stays() {
        let pcd = b"# .PCD\nFIELDS x\nWIDTH 100\nHEIGHT 2\r\nPOINTS  200\nDATA binary\n";
        let fewer = b"# .PCD\nFIELDS x\nWIDTH 7\nHEIGHT 1\r\nPOINTS  7\nDATA binary\n";
        assert_eq!(with_point_count(pcd, 7), fewer);
        let ply = b"ply\ncomment POINTS 3\nelement vertex 20\nelement face 3\nPOINTS 3\n";
        let fewer = b"ply\ncomment POINTS 3\nelement vertex 7\nelement face 3\nPOINTS 3\n";
        assert_eq!(with_point_count(ply, 7), fewer);
        assert_eq!(with_point_count(b"", 7), b"");
    }
}
