//! Records whose doubles all have float32 precision, as written by programs that compute in double precision.
//! FORMAT.md 9.

use super::field::{POSITION, layout_of};
use super::records::Parts;
use crate::scan::{Field, Layout, Scalar, ScanFile, Wrapping};

/// Splits a file as [`plain_file`](super::records::plain_file) does, but doubles of which float32 preserves
/// every bit become float32: x, y and z only all three.
pub(super) fn parse(layout: Layout, bytes: &[u8], start: usize, count: u64) -> Option<ScanFile> {
    layout.validate().ok()?;
    let parts = Parts::of(bytes, start, layout.stride(), count)?;
    let Some(Narrowed { fields, is_widened, body }) = narrowed(&layout.fields, parts.body) else {
        return Some(parts.file(layout, parts.body));
    };
    Some(parts.file(layout_of(fields, Wrapping::Widened(is_widened))?, &body))
}

/// Records with float32 in place of doubles.
pub(super) struct Narrowed {
    /// The fields of the records.
    pub fields: Vec<Field>,
    /// For each field, whether the file has doubles instead.
    pub is_widened: Vec<bool>,
    /// The records.
    pub body: Vec<u8>,
}

/// Complete records with float32 in place of doubles of which float32 preserves every bit; `None` if there are
/// none. The layout of the fields must be valid.
pub(super) fn narrowed(fields: &[Field], body: &[u8]) -> Option<Narrowed> {
    let is_widened = narrow_fields(fields, body);
    if body.is_empty() || !is_widened.contains(&true) {
        return None;
    }
    let scalar = |(field, is_widened): (&Field, &bool)| match is_widened {
        true => Field { scalar: Scalar::F32, ..field.clone() },
        false => field.clone(),
    };
    let mut narrowed = Vec::with_capacity(body.len());
    for record in body.chunks_exact(fields.iter().map(Field::width).sum()) {
        let mut rest = record;
        for (field, is_widened) in fields.iter().zip(&is_widened) {
            let (own, after) = rest.split_at(field.width());
            rest = after;
            match is_widened {
                true => own.as_chunks().0.iter().for_each(|value| narrowed.extend(narrow(value))),
                false => narrowed.extend_from_slice(own),
            }
        }
    }
    Some(Narrowed {
        fields: fields.iter().zip(&is_widened).map(scalar).collect(),
        is_widened,
        body: narrowed,
    })
}

/// Which fields are doubles that float32 preserves.
fn narrow_fields(fields: &[Field], body: &[u8]) -> Vec<bool> {
    let stride = fields.iter().map(Field::width).sum::<usize>().max(1);
    let mut at = 0;
    let mut are_narrow: Vec<bool> = fields
        .iter()
        .map(|field| {
            let own = at..at + field.width();
            at = own.end;
            field.scalar == Scalar::F64
                && body.chunks_exact(stride).all(|record| {
                    let values = record[own.clone()].as_chunks().0.iter();
                    { values }.all(|value| widen(&narrow(value)) == *value)
                })
        })
        .collect();
    let is_coordinate = |field: &Field| POSITION.iter().any(|name| field.name.eq_ignore_ascii_case(name));
    let all_coordinates = fields.iter().zip(&are_narrow).all(|(field, is)| *is || !is_coordinate(field));
    for (field, is_narrow) in fields.iter().zip(&mut are_narrow) {
        *is_narrow &= all_coordinates || !is_coordinate(field);
    }
    are_narrow
}

/// The float32 nearest to a double. Done on the bits, as not all processors keep the payload of a NaN when
/// they convert it.
fn narrow(value: &[u8; 8]) -> [u8; 4] {
    let bits = u64::from_le_bytes(*value);
    let narrow = match f64::from_bits(bits) {
        value if value.is_nan() => {
            (bits >> 32) as u32 & 1 << 31 | 0xff << 23 | (bits >> 29) as u32 & 0x7f_ffff
        }
        value => (value as f32).to_bits(),
    };
    narrow.to_le_bytes()
}

/// The double equal to a float32, with the same payload if it is NaN.
fn widen(value: &[u8; 4]) -> [u8; 8] {
    let bits = u32::from_le_bytes(*value);
    let wide = match f32::from_bits(bits) {
        value if value.is_nan() => {
            u64::from(bits >> 31) << 63 | 0x7ff << 52 | u64::from(bits & 0x7f_ffff) << 29
        }
        value => f64::from(value).to_bits(),
    };
    wide.to_le_bytes()
}

/// Complete records as the file has them, from records with float32 fields.
pub(super) fn write(body: &[u8], layout: &Layout, widened: &[bool]) -> Vec<u8> {
    let mut out = Vec::with_capacity(2 * body.len());
    for record in body.chunks_exact(layout.stride().max(1)) {
        let mut rest = record;
        for (field, is_widened) in layout.fields.iter().zip(widened) {
            let (own, after) = rest.split_at(field.width());
            rest = after;
            match is_widened {
                true => own.as_chunks().0.iter().for_each(|value| out.extend(widen(value))),
                false => out.extend_from_slice(own),
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use crate::files::tests::{comes_back, pcd};
    use crate::scan::{Scalar, ScanFile, Wrapping};

    /// Two points of doubles: x, y, z, a pair and a time.
    fn file(points: &[[f64; 6]], end: &[u8]) -> ScanFile {
        let header = pcd("x y z pair time", "8 8 8 8 8", "F F F F F", "1 1 1 2 1", 2, "binary");
        let body: Vec<u8> = points.iter().flatten().flat_map(|value| value.to_le_bytes()).collect();
        comes_back("a.pcd", [header, body, end.to_vec()].concat())
    }

    #[test]
    fn doubles_that_are_singles_are_kept_so() {
        // A signalling NaN with a payload.
        let odd = f64::from_bits(0xfff0_1230 << 32 | 0x2000_0000);
        let points =
            [[1.5, -0.0, f64::INFINITY, 0.25, odd, 0.1], [0.0, 1e-40_f32.into(), 2.0, 1.0, -2.0, 0.2]];
        let scan = file(&points, b"more");
        assert_eq!(scan.layout.wrapping, Wrapping::Widened(vec![true, true, true, true, false]));
        assert_eq!((scan.records, scan.layout.stride(), scan.suffix.len()), (2, 3 * 4 + 2 * 4 + 8, 4));
        assert_eq!(scan.cloud.positions[0], [1.5, -0.0, f32::INFINITY]);
        assert_eq!(scan.cloud.channel("time").unwrap().field.scalar, Scalar::F64);
    }

    #[test]
    fn coordinates_are_narrow_together() {
        let scan = file(&[[1.0, 2.0, 0.1, 0.5, 0.5, 0.1], [1.0; 6]], b"");
        assert_eq!(scan.layout.wrapping, Wrapping::Widened(vec![false, false, false, true, false]));
        assert_eq!(scan.layout.position, None);
        // A NaN that float32 does not have, and a number too large for it.
        for odd in [f64::from_bits(0x7ff0_0000_0000_0001), 1e300] {
            let scan = file(&[[odd; 6], [1.0; 6]], b"");
            assert_eq!(scan.layout.wrapping, Wrapping::Plain);
        }
        let scan = file(&[], b"");
        assert_eq!((scan.records, scan.layout.wrapping), (0, Wrapping::Plain));
    }
}
