//! Records whose doubles are made from float32 or from few digits, as written by programs that compute in
//! double precision, and records with half-precision numbers, or with 16-bit integers in place of
//! coordinates. FORMAT.md 9.

use std::fmt::Write;

use super::field::{is_coordinate, is_intensity, layout_of};
use super::number::{self, NumberWriter};
use super::records::Parts;
use crate::ground::error::{Error, Result};
use crate::ground::floats::round_ties_even;
use crate::scan::{Axis, Column, Field, Layout, NumberRule, ScalarType, ScanFile, Widening, Wrapping};

/// Splits a file as [`plain_file`](super::records::plain_file) does, but doubles that float32 determines
/// become float32: x, y and z only all three. So do the `u16` of fields that `halves` says are half-precision
/// numbers.
pub(super) fn parse(
    layout: Layout,
    halves: &[bool],
    bytes: &[u8],
    start: usize,
    count: u64,
) -> Option<ScanFile> {
    layout.validate().ok()?;
    let parts = Parts::of(bytes, start, layout.stride(), count)?;
    let Some(Narrowed { fields, widenings, body }) = narrowed(&layout.fields, halves, parts.body) else {
        return Some(parts.file(layout, parts.body));
    };
    Some(parts.file(layout_of(fields, Wrapping::Widened(widenings))?, &body))
}

/// Splits a file of records with these fields, of which the first three are coordinates as 16-bit integers.
pub(super) fn parse_steps(axis: Axis, others: &[Field], bytes: &[u8]) -> Option<ScanFile> {
    let coordinates = ["x", "y", "z"].map(|name| Field::new(name, ScalarType::F32));
    let fields = [&coordinates[..], others].concat();
    let width: usize = others.iter().map(Field::width).sum();
    let parts = Parts::of(bytes, 0, 6 + width, u64::MAX)?;
    let mut body = Vec::with_capacity(parts.records * (12 + width));
    for record in parts.body.chunks_exact(6 + width) {
        let (steps, rest) = record.split_at(6);
        for value in steps.as_chunks().0 {
            body.extend(axis.metres(u16::from_le_bytes(*value).into()).to_le_bytes());
        }
        body.extend_from_slice(rest);
    }
    let mut widenings = vec![Widening::Steps(axis); 3];
    widenings.resize(fields.len(), Widening::None);
    Some(parts.file(layout_of(fields, Wrapping::Widened(widenings))?, &body))
}

/// Records with float32 in place of doubles and halves.
pub(super) struct Narrowed {
    /// The fields of the records.
    pub fields: Vec<Field>,
    /// For each field, whether and how the file has others instead.
    pub widenings: Vec<Widening>,
    /// The records.
    pub body: Vec<u8>,
}

/// Complete records with float32 in place of doubles that float32 determines, and of the `u16` of `halves`;
/// `None` if there are none. The layout of the fields must be valid.
pub(super) fn narrowed(fields: &[Field], halves: &[bool], body: &[u8]) -> Option<Narrowed> {
    let mut widenings = widenings(fields, body);
    widenings
        .iter_mut()
        .zip(halves)
        .filter(|(_, is_half)| **is_half)
        .for_each(|(to, _)| *to = Widening::Half);
    if body.is_empty() || widenings.iter().all(|widening| *widening == Widening::None) {
        return None;
    }
    let scalar = |(field, widening): (&Field, &Widening)| match widening {
        Widening::None => field.clone(),
        Widening::Exact | Widening::Half | Widening::Decimal(_) | Widening::Steps(_) => {
            Field { scalar: ScalarType::F32, ..field.clone() }
        }
    };
    let mut narrowed = Vec::with_capacity(body.len());
    for record in body.chunks_exact(fields.iter().map(Field::width).sum()) {
        let mut rest = record;
        for (field, widening) in fields.iter().zip(&widenings) {
            let (own, after) = rest.split_at(field.width());
            rest = after;
            match widening {
                Widening::None => narrowed.extend_from_slice(own),
                Widening::Half => own.as_chunks().0.iter().for_each(|half| narrowed.extend(single(half))),
                // Doubles never become steps.
                Widening::Exact | Widening::Decimal(_) | Widening::Steps(_) => {
                    own.as_chunks().0.iter().for_each(|value| narrowed.extend(narrow(value)));
                }
            }
        }
    }
    Some(Narrowed { fields: fields.iter().zip(&widenings).map(scalar).collect(), widenings, body: narrowed })
}

/// How the doubles of each field are made from float32.
fn widenings(fields: &[Field], body: &[u8]) -> Vec<Widening> {
    let stride = fields.iter().map(Field::width).sum::<usize>().max(1);
    let mut at = 0;
    let mut found: Vec<Widening> = fields
        .iter()
        .map(|field| {
            let own = at..at + field.width();
            at = own.end;
            let values = body.chunks_exact(stride).flat_map(|record| record[own.clone()].as_chunks().0);
            if field.scalar != ScalarType::F64 {
                Widening::None
            } else if values.clone().all(|value| widen(&narrow(value)) == *value) {
                Widening::Exact
            } else if is_coordinate(&field.name) || is_intensity(&field.name) {
                decimal_of(values)
            } else {
                // Times and other numbers of few digits are on grids of doubles.
                Widening::None
            }
        })
        .collect();
    let is_double =
        |(field, found): (&Field, &Widening)| is_coordinate(&field.name) && *found == Widening::None;
    if fields.iter().zip(&found).any(is_double) {
        let coordinates = fields.iter().zip(&mut found).filter(|(field, _)| is_coordinate(&field.name));
        coordinates.for_each(|(_, found)| *found = Widening::None);
    }
    found
}

/// The rule by whose texts float32 become these doubles, if there is one.
fn decimal_of<'b>(values: impl Iterator<Item = &'b [u8; 8]> + Clone) -> Widening {
    let mut decimals = Decimals::default();
    let is_made_by = |rule: &NumberRule| {
        values.clone().all(|value| decimals.widen(&narrow(value), *rule).is_ok_and(|wide| wide == *value))
    };
    rules(values.clone()).into_iter().find(is_made_by).map_or(Widening::None, Widening::Decimal)
}

/// The rules by which numbers may have been written that are read as these doubles, the likeliest first; none
/// if some double has more digits than a float32.
fn rules<'b>(values: impl Iterator<Item = &'b [u8; 8]>) -> Vec<NumberRule> {
    /// The most digits that a float32 needs.
    const MOST: usize = 9;
    let (mut significant, mut decimals) = (1, 0);
    let mut text = String::new();
    for value in values.map(|value| f64::from_le_bytes(*value)).filter(|value| value.is_finite()) {
        text.clear();
        // Writing to a string does not fail.
        let _ = write!(text, "{:e}", value.abs());
        let (digits, exponent) = text.split_once('e').unwrap_or((&text, "0"));
        let digits = digits.len() - usize::from(digits.contains('.'));
        if digits > MOST {
            return Vec::new();
        }
        significant = significant.max(digits);
        decimals = decimals.max(digits as i32 - 1 - exponent.parse().unwrap_or(0));
    }
    let fixed = u8::try_from(decimals).ok().filter(|&decimals| usize::from(decimals) <= MOST);
    let shortest = NumberRule::Shortest { double: false, point_zero: false };
    [Some(NumberRule::Significant(significant as u8)), fixed.map(NumberRule::Fixed), Some(shortest)]
        .into_iter()
        .flatten()
        .collect()
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

/// The float32 equal to a half-precision number, with the same payload if it is NaN.
fn single(half: &[u8; 2]) -> [u8; 4] {
    let bits = u32::from(u16::from_le_bytes(*half));
    let (sign, exponent, fraction) = (bits >> 15 << 31, bits >> 10 & 31, bits & 0x3ff);
    let magnitude = match exponent {
        0 => (fraction as f32 / 16_777_216.0).to_bits(),
        31 => 0xff << 23 | fraction << 13,
        _ => exponent + 112 << 23 | fraction << 13,
    };
    (sign | magnitude).to_le_bytes()
}

/// The half-precision number nearest to a float32; of two that are as near, the even one.
fn half(value: &[u8; 4]) -> [u8; 2] {
    /// From here on, numbers are rounded to infinity.
    const INFINITE: f32 = 65520.0;
    let bits = u32::from_le_bytes(*value);
    let (sign, magnitude) = (bits >> 31 << 15, f32::from_bits(bits & !(1 << 31)));
    let half = if magnitude.is_nan() {
        let fraction = bits >> 13 & 0x3ff;
        0x7c00 | if fraction == 0 { 0x200 } else { fraction }
    } else if magnitude >= INFINITE {
        0x7c00
    } else if magnitude < 1.0 / 16384.0 {
        // All numbers are multiples of 2^-24. The largest rounds to the first that is not subnormal, as it
        // should.
        round_ties_even((magnitude * 16_777_216.0).into()) as u32
    } else {
        let bits = magnitude.to_bits();
        let odd = bits >> 13 & 1;
        (bits + 0xfff + odd >> 13) - (112 << 10)
    };
    ((sign | half) as u16).to_le_bytes()
}

/// Widens float32 by way of text; holds the buffers.
#[derive(Default)]
struct Decimals {
    writer: NumberWriter,
    text: Vec<u8>,
    wide: Vec<u8>,
}

impl Decimals {
    /// The double nearest to the text of a float32 by this rule.
    ///
    /// # Errors
    /// [`Error::Corrupt`] if the rule is not for floating-point numbers.
    fn widen(&mut self, value: &[u8; 4], rule: NumberRule) -> Result<[u8; 8]> {
        self.text.clear();
        self.wide.clear();
        self.writer.write(value, Column { scalar: ScalarType::F32, rule }, &mut self.text)?;
        let text = std::str::from_utf8(&self.text).ok();
        let parsed = text.and_then(|text| number::parse(text, ScalarType::F64, &mut self.wide));
        let wide = parsed.and_then(|()| self.wide.first_chunk());
        wide.copied().ok_or_else(|| Error::corrupt("the text of a widened number is not a number"))
    }
}

/// Complete records as the file has them, from records with float32 fields.
///
/// # Errors
/// [`Error::Corrupt`] if a rule is not for floating-point numbers.
pub(super) fn write(body: &[u8], layout: &Layout, widenings: &[Widening]) -> Result<Vec<u8>> {
    let mut out = Vec::with_capacity(2 * body.len());
    let mut decimals = Decimals::default();
    for record in body.chunks_exact(layout.stride().max(1)) {
        let mut rest = record;
        for (field, widening) in layout.fields.iter().zip(widenings) {
            let (own, after) = rest.split_at(field.width());
            rest = after;
            match widening {
                Widening::None => out.extend_from_slice(own),
                Widening::Exact => own.as_chunks().0.iter().for_each(|value| out.extend(widen(value))),
                Widening::Half => own.as_chunks().0.iter().for_each(|value| out.extend(half(value))),
                Widening::Decimal(rule) => {
                    for value in own.as_chunks().0 {
                        out.extend(decimals.widen(value, *rule)?);
                    }
                }
                Widening::Steps(axis) => {
                    for value in own.as_chunks().0 {
                        let steps = axis.steps(f32::from_le_bytes(*value), [0, u16::MAX.into()]);
                        out.extend((steps as u16).to_le_bytes());
                    }
                }
            }
        }
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use crate::files::tests::{comes_back, pcd};
    use crate::scan::{NumberRule, ScalarType, ScanFile, Widening, Wrapping};

    fn exact(is_widened: [bool; 5]) -> Vec<Widening> {
        is_widened.map(|is| if is { Widening::Exact } else { Widening::None }).to_vec()
    }

    /// Two points of doubles: x, y, z, a pair and a time.
    fn file(points: &[[f64; 6]], end: &[u8]) -> ScanFile {
        let header = pcd("x y z pair time", "8 8 8 8 8", "F F F F F", "1 1 1 2 1", 2, "binary");
        let body: Vec<u8> = points.iter().flatten().flat_map(|value| value.to_le_bytes()).collect();
        comes_back("a.pcd", [header, body, end.to_vec()].concat())
    }

    #[test]
    fn coordinates_read_from_text_are_single() {
        let close = f64::from_bits(12.345f64.to_bits() + 1);
        for (values, rule) in [
            ([12.345, -0.001], Some(NumberRule::Significant(5))),
            // Of float32 by `%.8g` and by `%f`, and the shortest text of a float32.
            ([-14.646725, 4.3874693], Some(NumberRule::Significant(8))),
            ([100.123459, 4.387469], Some(NumberRule::Fixed(6))),
            ([12.4706955, 14.646725], Some(NumberRule::Shortest { double: false, point_zero: false })),
            ([0.100000001, -1.17549435e-38], Some(NumberRule::Significant(9))),
            ([f64::NAN, 0.1], Some(NumberRule::Significant(1))),
            ([f64::NEG_INFINITY, -0.3], Some(NumberRule::Significant(1))),
            ([close, 1.0], None),
            ([1.0 / 3.0, 1.0], None),
            ([1e300, 1.0], None),
        ] {
            let scan = file(&values.map(|value| [value, value, value, 0.1, 0.2, value]), b"");
            let Some(rule) = rule else {
                assert_eq!(scan.layout.wrapping, Wrapping::Plain, "{values:?}");
                continue;
            };
            let decimal = Widening::Decimal(rule);
            let widenings = vec![decimal, decimal, decimal, Widening::None, Widening::None];
            assert_eq!(scan.layout.wrapping, Wrapping::Widened(widenings), "{values:?}");
            assert_eq!(scan.cloud.positions[1], [values[1] as f32; 3], "{values:?}");
        }
    }

    #[test]
    fn doubles_that_are_singles_are_kept_so() {
        // A signalling NaN with a payload.
        let odd = f64::from_bits(0xfff0_1230 << 32 | 0x2000_0000);
        let points =
            [[1.5, -0.0, f64::INFINITY, 0.25, odd, 0.1], [0.0, 1e-40_f32.into(), 2.0, 1.0, -2.0, 0.2]];
        let scan = file(&points, b"more");
        assert_eq!(scan.layout.wrapping, Wrapping::Widened(exact([true, true, true, true, false])));
        assert_eq!((scan.records, scan.layout.stride(), scan.suffix.len()), (2, 3 * 4 + 2 * 4 + 8, 4));
        assert_eq!(scan.cloud.positions[0], [1.5, -0.0, f32::INFINITY]);
        assert_eq!(scan.cloud.channel("time").unwrap().field.scalar, ScalarType::F64);
    }

    #[test]
    fn every_half_is_a_single() {
        use super::{half, single};
        for bits in 0..=u16::MAX {
            let wide = single(&bits.to_le_bytes());
            assert_eq!(half(&wide), bits.to_le_bytes(), "{bits:#x}");
        }
        let value = |bits: u16| f32::from_le_bytes(single(&bits.to_le_bytes()));
        assert_eq!([0x3c00, 0xc500, 0x7bff, 1].map(value), [1.0, -5.0, 65504.0, 2f32.powi(-24)]);
        assert_eq!([0x0400, 0x03ff, 0x8000].map(value), [2f32.powi(-14), 1023.0 * 2f32.powi(-24), 0.0]);
        assert!(value(0x7c00).is_infinite() && value(0x7e01).is_nan());
        // Between two halves, the nearest, and midway the even one.
        for bits in 0..0x7bff {
            let middle = (value(bits) + value(bits + 1)) / 2.0;
            let even = bits + bits % 2;
            let nearest = [middle.next_down(), middle, middle.next_up()].map(|v| half(&v.to_le_bytes()));
            assert_eq!(nearest, [bits, even, bits + 1].map(u16::to_le_bytes), "{bits:#x}");
        }
        let rounded =
            [65519.99, 65520.0, 1e9, -1e9, 1e-9].map(|v: f32| u16::from_le_bytes(half(&v.to_le_bytes())));
        assert_eq!(rounded, [0x7bff, 0x7c00, 0x7c00, 0xfc00, 0]);
        // A NaN stays one, even if half precision has no room for its payload.
        assert_eq!(half(&0xff80_0001u32.to_le_bytes()), 0xfe00u16.to_le_bytes());
    }

    #[test]
    fn coordinates_are_narrow_together() {
        let scan = file(&[[1.0, 2.0, 1.0 / 3.0, 0.5, 0.5, 0.1], [1.0; 6]], b"");
        assert_eq!(scan.layout.wrapping, Wrapping::Widened(exact([false, false, false, true, false])));
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
