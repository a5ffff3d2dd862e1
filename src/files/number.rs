//! Numbers as text, by the rules of common programs. FORMAT.md 9, "Text".

use std::io::Write;

use byteorder::{ByteOrder, LittleEndian};

use crate::ground::decimal;
use crate::ground::error::Result;
use crate::scan::{Column, MAX_DIGITS, Number, NumberRule, Printf, ScalarType};

/// `%g` and `repr` write numbers with a smaller exponent than this in scientific notation.
const LEAST_PLAIN_EXPONENT: i32 = -4;
/// `repr` writes numbers from 1e16 on in scientific notation.
const REPR_EXPONENT: i32 = 16;

/// Parses `token` and appends the little-endian bytes of the value. `None` if it is not a number of this
/// type. Accepts more than is ever written: the caller must check that the text is restored.
pub(super) fn parse(token: &str, scalar: ScalarType, out: &mut Vec<u8>) -> Option<()> {
    match scalar {
        ScalarType::I8 => out.extend(token.parse::<i8>().ok()?.to_le_bytes()),
        ScalarType::U8 => out.extend(token.parse::<u8>().ok()?.to_le_bytes()),
        ScalarType::I16 => out.extend(token.parse::<i16>().ok()?.to_le_bytes()),
        ScalarType::U16 => out.extend(token.parse::<u16>().ok()?.to_le_bytes()),
        ScalarType::I32 => out.extend(token.parse::<i32>().ok()?.to_le_bytes()),
        ScalarType::U32 => out.extend(token.parse::<u32>().ok()?.to_le_bytes()),
        ScalarType::I64 => out.extend(token.parse::<i64>().ok()?.to_le_bytes()),
        ScalarType::U64 => out.extend(token.parse::<u64>().ok()?.to_le_bytes()),
        ScalarType::F32 => match token {
            "nan" => out.extend(f32::NAN.copysign(1.0).to_le_bytes()),
            "-nan" => out.extend(f32::NAN.copysign(-1.0).to_le_bytes()),
            _ => out.extend(token.parse::<f32>().ok()?.to_le_bytes()),
        },
        ScalarType::F64 => match token {
            "nan" => out.extend(f64::NAN.copysign(1.0).to_le_bytes()),
            "-nan" => out.extend(f64::NAN.copysign(-1.0).to_le_bytes()),
            _ => out.extend(token.parse::<f64>().ok()?.to_le_bytes()),
        },
    }
    Some(())
}

/// A number as it is usually written, without an exponent: digits, perhaps with a point between them and a
/// minus before them, and no needless zeros in front.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PlainNumber {
    is_negative: bool,
    /// All digits as one number.
    digits: u64,
    /// How many of them follow the point; 0 without one.
    decimals: u8,
}

impl PlainNumber {
    /// `None` if a text has another form, or more than 19 characters after the minus.
    #[inline]
    pub(super) fn of(text: &str) -> Option<Self> {
        /// A number of this many digits has 64 bits.
        const MOST: usize = 19;
        let text = text.as_bytes();
        let (is_negative, text) = match text.split_first() {
            Some((b'-', text)) => (true, text),
            _ => (false, text),
        };
        if !(1..=MOST).contains(&text.len()) {
            return None;
        }
        let (mut digits, mut point) = (0, None);
        for (at, byte) in text.iter().enumerate() {
            match byte.wrapping_sub(b'0') {
                digit @ 0..10 => digits = 10 * digits + u64::from(digit),
                _ if *byte == b'.' && point.is_none() => point = Some(at),
                _ => return None,
            }
        }
        let whole = point.unwrap_or(text.len());
        let decimals = text.len() - (whole + 1).min(text.len());
        let has_both = whole > 0 && (decimals > 0 || point.is_none());
        let is_short = whole == 1 || text[0] != b'0';
        (has_both && is_short).then_some(PlainNumber { is_negative, digits, decimals: decimals as u8 })
    }

    /// The value as a floating-point number; `None` if its text must be parsed to know it.
    fn float(self, is_single: bool) -> Option<f64> {
        let magnitude = match (self.digits, is_single) {
            (0, _) => 0.0,
            (digits, true) => decimal::single(digits, -i32::from(self.decimals))?.into(),
            (digits, false) => decimal::double(digits, self.decimals.into())?,
        };
        Some(if self.is_negative { -magnitude } else { magnitude })
    }

    /// The value as an integer; `None` if it has a point, or is written as -0.
    fn integer(self) -> Option<i128> {
        let magnitude = i128::from(self.digits);
        let is_whole = self.decimals == 0 && !(self.is_negative && magnitude == 0);
        is_whole.then_some(if self.is_negative { -magnitude } else { magnitude })
    }
}

/// As [`parse`], given the text as a plain number too, if it is one.
#[inline]
pub(super) fn parse_plain(
    text: &str,
    plain: Option<PlainNumber>,
    scalar: ScalarType,
    out: &mut Vec<u8>,
) -> Option<()> {
    match (scalar, plain.and_then(|plain| plain.float(scalar == ScalarType::F32))) {
        (ScalarType::F32, Some(value)) => out.extend((value as f32).to_le_bytes()),
        (ScalarType::F64, Some(value)) => out.extend(value.to_le_bytes()),
        _ => parse(text, scalar, out)?,
    }
    Some(())
}

/// Writes values as text; holds the buffers for the digits.
#[derive(Default)]
pub(super) struct NumberWriter {
    printf: Printf,
    digits: Vec<u8>,
    rounded: Vec<u8>,
    written: Vec<u8>,
}

impl NumberWriter {
    /// For texts as this C library prints them.
    pub(super) fn new(printf: Printf) -> Self {
        NumberWriter { printf, ..NumberWriter::default() }
    }

    /// Appends the text of the value whose little-endian bytes are `value`, `column.scalar.size()`
    /// of them. The rule must suit the type.
    pub(super) fn write(&mut self, value: &[u8], column: Column, out: &mut Vec<u8>) -> Result<()> {
        match column.scalar {
            _ if column.rule == NumberRule::Character => out.extend_from_slice(value),
            ScalarType::F32 => self.write_float(LittleEndian::read_f32(value).into(), column, out)?,
            ScalarType::F64 => self.write_float(LittleEndian::read_f64(value), column, out)?,
            ScalarType::U8 | ScalarType::U16 | ScalarType::U32 | ScalarType::U64 => {
                write_integer(LittleEndian::read_uint(value, value.len()), out);
            }
            ScalarType::I8 | ScalarType::I16 | ScalarType::I32 | ScalarType::I64 => {
                write_integer(LittleEndian::read_int(value, value.len()), out);
            }
        }
        Ok(())
    }

    /// Whether [`write`](Self::write) gives this text, which is also given as a plain number if it is one.
    pub(super) fn gives(
        &mut self,
        text: &str,
        plain: Option<PlainNumber>,
        value: &[u8],
        column: Column,
    ) -> Result<bool> {
        if let Some(is_same) = plain.and_then(|plain| self.gives_plain(plain, value, column)) {
            return Ok(is_same);
        }
        let mut written = std::mem::take(&mut self.written);
        written.clear();
        self.write(value, column, &mut written)?;
        self.written = written;
        Ok(self.written == text.as_bytes())
    }

    /// Whether [`write`](Self::write) gives this number, compared as integers; `None` if it must be written
    /// to know that.
    fn gives_plain(&self, plain: PlainNumber, bytes: &[u8], column: Column) -> Option<bool> {
        let value = match column.scalar {
            ScalarType::F32 => f64::from(LittleEndian::read_f32(bytes)),
            ScalarType::F64 => LittleEndian::read_f64(bytes),
            scalar => {
                let Some(Number::Integer(value)) = scalar.number(bytes) else { return None };
                return (column.rule == NumberRule::Integer).then_some(plain.integer() == Some(value));
            }
        };
        if !value.is_finite() || value.is_sign_negative() != plain.is_negative {
            return Some(false);
        }
        let value = value.abs();
        match column.rule {
            NumberRule::Fixed(decimals) => {
                let value = self.settled(value, |exact| exact == i32::from(decimals) + 1);
                let number = decimal::fixed(value, decimals.into())?;
                Some(plain.decimals == decimals && plain.digits == number)
            }
            NumberRule::Significant(digits) if !self.printf.ties_away => {
                let (number, exponent) = decimal::significant(value, digits.into())?;
                let is_plain = (LEAST_PLAIN_EXPONENT..i32::from(digits)).contains(&exponent);
                let is_short = plain.decimals == 0 || !plain.digits.is_multiple_of(10);
                // The number has zeros at the end that the text lacks.
                let zeros = i32::from(digits) - 1 - exponent - i32::from(plain.decimals);
                let all = u32::try_from(zeros).ok().and_then(|zeros| 10u64.checked_pow(zeros));
                let all = all.and_then(|power| plain.digits.checked_mul(power));
                Some(is_plain && is_short && all == Some(number))
            }
            _ => None,
        }
    }

    /// Appends the text of `value`. Single precision is widened without loss by the caller.
    fn write_float(&mut self, value: f64, column: Column, out: &mut Vec<u8>) -> Result<()> {
        if value.is_sign_negative() {
            out.push(b'-');
        }
        let value = value.abs();
        if !value.is_finite() {
            out.extend_from_slice(if value.is_nan() { b"nan" } else { b"inf" });
            return Ok(());
        }
        match column.rule {
            NumberRule::Fixed(decimals) => {
                let value = self.settled(value, |exact| exact == i32::from(decimals) + 1);
                if let Some(number) = decimal::fixed(value, decimals.into()) {
                    write_fixed(number, decimals.into(), out);
                } else {
                    let decimals = usize::from(decimals);
                    write!(out, "{value:.decimals$}")?;
                }
            }
            NumberRule::Scientific(digits) => {
                let exponent = self.take_digits(value, Some(digits.into()), false)?;
                self.write_scientific(exponent, out)?;
            }
            NumberRule::Significant(digits) => {
                if !self.printf.ties_away
                    && let Some((mut number, exponent)) = decimal::significant(value, digits.into())
                    && (LEAST_PLAIN_EXPONENT..i32::from(digits)).contains(&exponent)
                {
                    let mut decimals = (i32::from(digits) - 1 - exponent) as usize;
                    while decimals > 0 && number.is_multiple_of(10) {
                        (number, decimals) = (number / 10, decimals - 1);
                    }
                    write_fixed(number, decimals, out);
                    return Ok(());
                }
                let exponent = self.take_digits(value, Some(usize::from(digits).saturating_sub(1)), false)?;
                while self.digits.len() > 1 && self.digits.ends_with(b"0") {
                    self.digits.pop();
                }
                if exponent < LEAST_PLAIN_EXPONENT || exponent >= digits.into() {
                    self.write_scientific(exponent, out)?;
                } else {
                    write_plain(&self.digits, exponent, false, out);
                }
            }
            NumberRule::Shortest { double, point_zero } => {
                let single = column.scalar == ScalarType::F32 && !double;
                let exponent = self.take_digits(value, None, single)?;
                if !(LEAST_PLAIN_EXPONENT..REPR_EXPONENT).contains(&exponent) {
                    self.write_scientific(exponent, out)?;
                } else {
                    write_plain(&self.digits, exponent, point_zero, out);
                }
            }
            // Layout validation rejects these rules for floating-point types.
            NumberRule::Integer | NumberRule::Character => write!(out, "{value}")?,
        }
        Ok(())
    }

    /// The value as it is rounded to nearest, ties to even: a tie that is rounded away from zero is replaced
    /// by the next number. Of the number of decimals that write the value exactly, `is_tie` says whether the
    /// last is the only one that is rounded off; as the last decimal of a binary fraction is a 5, the value
    /// is then a tie.
    fn settled(&self, value: f64, is_tie: impl Fn(i32) -> bool) -> f64 {
        let is_away = self.printf.ties_away && is_tie(decimal::exact_decimals(value));
        if is_away { value.next_up() } else { value }
    }

    /// `d.ddde-05`: the digits with an exponent, which has a sign and at least two digits.
    fn write_scientific(&self, exponent: i32, out: &mut Vec<u8>) -> Result<()> {
        let (first, others) = self.digits.split_at(1.min(self.digits.len()));
        out.extend_from_slice(first);
        if !others.is_empty() {
            out.push(b'.');
            out.extend_from_slice(others);
        }
        let sign = if exponent < 0 { '-' } else { '+' };
        let width = if self.printf.long_exponent { 3 } else { 2 };
        write!(out, "e{sign}{:0width$}", exponent.unsigned_abs())?;
        Ok(())
    }

    /// Stores the significant digits of `value` in `self.digits`: `after_first` digits after the first, or
    /// the fewest digits from which the value can be restored (in single precision if `single`). Returns the
    /// decimal exponent of the first digit. `value` is finite and not negative.
    fn take_digits(&mut self, value: f64, after_first: Option<usize>, single: bool) -> Result<i32> {
        let value = match after_first {
            Some(count) if self.printf.ties_away => {
                self.settled(value, |exact| exact > 0 && exact == count as i32 - first_exponent(value) + 1)
            }
            _ => value,
        };
        let text = &mut self.digits;
        text.clear();
        let digits = after_first.and_then(|count| u32::try_from(count + 1).ok());
        if let Some((number, exponent)) = digits.and_then(|digits| decimal::significant(value, digits)) {
            write_integer(number, text);
            return Ok(exponent);
        }
        match after_first {
            Some(count) => write!(text, "{value:.count$e}")?,
            None if single => write!(text, "{:e}", value as f32)?,
            None => write!(text, "{value:e}")?,
        }
        let (mut mantissa, mut exponent) = split_exponent(&self.digits);
        if after_first.is_none() && is_tie(value, mantissa.saturating_sub(1).max(1), exponent) {
            self.settle_tie(value, single)?;
            (mantissa, exponent) = split_exponent(&self.digits);
        }
        self.digits.truncate(mantissa);
        self.digits.retain(|b| b.is_ascii_digit());
        Ok(exponent)
    }

    /// If two shortest texts are equally near to the value, the standard library takes the upper one, but
    /// `repr` and most other implementations the one with an even last digit, as correct rounding gives it.
    /// (A power of two need not be restored from its correctly rounded text; then the text is not changed.)
    fn settle_tie(&mut self, value: f64, single: bool) -> Result<()> {
        let (mantissa, _) = split_exponent(&self.digits);
        let after_first = mantissa.saturating_sub(2);
        self.rounded.clear();
        write!(self.rounded, "{value:.after_first$e}")?;
        if self.rounded != self.digits && gives_back(&self.rounded, value, single) {
            std::mem::swap(&mut self.rounded, &mut self.digits);
        }
        Ok(())
    }
}

/// Whether a number may be midway between two texts of this number of digits, the first of which stands for
/// this power of ten: then one more digit writes it exactly.
fn is_tie(value: f64, digits: usize, exponent: i32) -> bool {
    let decimals = digits as i32 - exponent;
    decimals <= 0 || decimals == decimal::exact_decimals(value)
}

fn write_integer(number: impl itoa::Integer, out: &mut Vec<u8>) {
    out.extend_from_slice(itoa::Buffer::new().format(number).as_bytes());
}

/// A number times 10^`decimals`, with a decimal point.
fn write_fixed(number: u64, decimals: usize, out: &mut Vec<u8>) {
    let mut buffer = itoa::Buffer::new();
    let digits = buffer.format(number).as_bytes();
    let (whole, fraction) = digits.split_at(digits.len().saturating_sub(decimals));
    out.extend_from_slice(if whole.is_empty() { b"0" } else { whole });
    if decimals > 0 {
        out.push(b'.');
        out.extend((fraction.len()..decimals).map(|_| b'0'));
        out.extend_from_slice(fraction);
    }
}

/// The length of the mantissa and the exponent of a text such as `1.25e-7`.
fn split_exponent(text: &[u8]) -> (usize, i32) {
    let mantissa = text.iter().position(|&b| b == b'e').unwrap_or(text.len());
    let exponent = text.get(mantissa + 1..).and_then(|x| std::str::from_utf8(x).ok()?.parse().ok());
    (mantissa, exponent.unwrap_or(0))
}

fn gives_back(text: &[u8], value: f64, single: bool) -> bool {
    std::str::from_utf8(text).is_ok_and(|text| match single {
        true => text.parse() == Ok(value as f32),
        false => text.parse() == Ok(value),
    })
}

/// The decimal exponent of the first digit of a number that is not negative.
fn first_exponent(value: f64) -> i32 {
    let mut text = Vec::new();
    // Writing to a vector does not fail.
    let _ = write!(text, "{value:e}");
    split_exponent(&text).1
}

/// Digits with a decimal point, and zeros up to it if necessary.
fn write_plain(digits: &[u8], exponent: i32, point_zero: bool, out: &mut Vec<u8>) {
    let Ok(exponent) = usize::try_from(exponent) else {
        out.extend_from_slice(b"0.");
        out.extend((exponent + 1..0).map(|_| b'0'));
        out.extend_from_slice(digits);
        return;
    };
    let (whole, fraction) = digits.split_at(digits.len().min(exponent + 1));
    out.extend_from_slice(whole);
    out.extend((whole.len()..exponent + 1).map(|_| b'0'));
    if !fraction.is_empty() {
        out.push(b'.');
        out.extend_from_slice(fraction);
    } else if point_zero {
        out.extend_from_slice(b".0");
    }
}

/// Properties of the texts in a column, from which its rule is guessed.
#[derive(Debug)]
pub(super) struct Survey {
    /// The most digits of a number, not counting leading zeros.
    significant: usize,
    /// The largest plain number, without its point.
    largest: u64,
    /// The fewest and the most digits after the decimal point.
    decimals: (usize, usize),
    /// Whether there are numbers with an exponent, and numbers without.
    with_exponent: bool,
    without_exponent: bool,
}

impl Survey {
    /// The survey of an empty column.
    pub(super) fn new() -> Self {
        Survey {
            significant: 1,
            largest: 0,
            decimals: (usize::MAX, 0),
            with_exponent: false,
            without_exponent: false,
        }
    }

    /// Takes one more text into account, which is also given as a plain number if it is one. NaN and infinity
    /// carry no information.
    #[inline]
    pub(super) fn add(&mut self, token: &str, plain: Option<PlainNumber>) {
        let Some(PlainNumber { digits, decimals, .. }) = plain else { return self.add_other(token) };
        self.largest = self.largest.max(digits);
        let decimals = usize::from(decimals);
        self.decimals = (self.decimals.0.min(decimals), self.decimals.1.max(decimals));
        self.without_exponent = true;
    }

    fn add_other(&mut self, token: &str) {
        let (mantissa, exponent) = match token.split_once('e') {
            Some((mantissa, _)) => (mantissa, true),
            None => (token, false),
        };
        if !mantissa.ends_with(|c: char| c.is_ascii_digit()) {
            return;
        }
        let mantissa = mantissa.trim_start_matches('-');
        let (whole, fraction) = mantissa.split_once('.').unwrap_or((mantissa, ""));
        let digits = whole.bytes().chain(fraction.bytes());
        self.significant = self.significant.max(digits.skip_while(|&b| b == b'0').count());
        self.decimals = (self.decimals.0.min(fraction.len()), self.decimals.1.max(fraction.len()));
        if exponent {
            self.with_exponent = true;
        } else {
            self.without_exponent = true;
        }
    }

    /// The rules by which these texts may have been written, the likeliest first. A rule of N significant
    /// digits gives the same texts with any larger N as long as no number has more digits (those before the
    /// decimal point count, because they determine where exponents begin), so the least N suffices.
    pub(super) fn candidates(&self, scalar: ScalarType) -> Vec<NumberRule> {
        if !scalar.is_float() {
            return vec![NumberRule::Integer];
        }
        let mut rules = Vec::new();
        let within = |digits: usize| u8::try_from(digits).ok().filter(|&d| d <= MAX_DIGITS);
        if self.decimals.0 >= self.decimals.1 {
            match (self.with_exponent, within(self.decimals.1)) {
                (false, Some(digits)) => rules.push(NumberRule::Fixed(digits)),
                (true, Some(digits)) if !self.without_exponent => rules.push(NumberRule::Scientific(digits)),
                _ => {}
            }
        }
        let most = self.largest.checked_ilog10().map_or(0, |below| below as usize + 1);
        let significant = within(self.significant.max(most));
        rules.extend(significant.map(NumberRule::Significant));
        for (double, point_zero) in [(false, true), (true, true), (false, false), (true, false)] {
            rules.push(NumberRule::Shortest { double, point_zero });
        }
        rules
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ground::random::Rng;

    fn text(value: f64, scalar: ScalarType, rule: NumberRule) -> String {
        let bytes = match scalar {
            ScalarType::F32 => (value as f32).to_le_bytes().to_vec(),
            _ => value.to_le_bytes().to_vec(),
        };
        let mut out = Vec::new();
        NumberWriter::default().write(&bytes, Column { scalar, rule }, &mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn ties_and_exponents_are_those_of_windows() {
        let old = Printf { ties_away: true, long_exponent: true };
        let text = |value: f64, rule: NumberRule| {
            let mut out = Vec::new();
            let column = Column { scalar: ScalarType::F64, rule };
            NumberWriter::new(old).write(&value.to_le_bytes(), column, &mut out).unwrap();
            String::from_utf8(out).unwrap()
        };
        for (value, rule, expected) in [
            (-21.1640625, NumberRule::Significant(8), "-21.164063"),
            (131072.125, NumberRule::Significant(8), "131072.13"),
            (131072.375, NumberRule::Significant(8), "131072.38"),
            (0.125, NumberRule::Fixed(2), "0.13"),
            (0.375, NumberRule::Fixed(2), "0.38"),
            (0.124, NumberRule::Fixed(2), "0.12"),
            (0.126, NumberRule::Fixed(2), "0.13"),
            (2.5, NumberRule::Fixed(0), "3"),
            (9.5, NumberRule::Significant(1), "1e+001"),
            (0.5, NumberRule::Significant(1), "0.5"),
            (0.0, NumberRule::Significant(3), "0"),
            (0.0, NumberRule::Fixed(2), "0.00"),
            (2f64.powi(-20), NumberRule::Scientific(12), "9.536743164063e-007"),
            (1.5e-100, NumberRule::Scientific(1), "1.5e-100"),
            // What lies next to a tie is none.
            (0.125f64.next_up(), NumberRule::Fixed(2), "0.13"),
            (0.125f64.next_down(), NumberRule::Fixed(2), "0.12"),
        ] {
            assert_eq!(text(value, rule), expected, "{value}");
        }
    }

    /// The expected texts are those of C's printf.
    #[test]
    fn significant_digits_are_those_of_printf() {
        for (value, digits, expected) in [
            (0.0, 8, "0"),
            (-0.0, 8, "-0"),
            (1.0, 8, "1"),
            (100.0, 8, "100"),
            (f64::from(0.1f32), 8, "0.1"),
            (f64::from(0.1f32), 10, "0.1000000015"),
            (f64::from(-25.467f32), 8, "-25.466999"),
            (0.0001, 6, "0.0001"),
            (0.00001234, 8, "1.234e-05"),
            (123456789.0, 8, "1.2345679e+08"),
            (99999999.9, 8, "1e+08"),
            (1e100, 3, "1e+100"),
            (131072.125, 8, "131072.12"),
            (f64::INFINITY, 8, "inf"),
            (-f64::NAN, 8, "-nan"),
        ] {
            assert_eq!(text(value, ScalarType::F64, NumberRule::Significant(digits)), expected);
        }
    }

    #[test]
    fn decimals_are_those_of_printf() {
        assert_eq!(text(-0.001, ScalarType::F64, NumberRule::Fixed(2)), "-0.00");
        assert_eq!(text(0.125, ScalarType::F64, NumberRule::Fixed(2)), "0.12");
        assert_eq!(text(2.5, ScalarType::F64, NumberRule::Fixed(0)), "2");
        assert_eq!(text(0.1, ScalarType::F32, NumberRule::Fixed(10)), "0.1000000015");
        assert_eq!(text(0.5, ScalarType::F64, NumberRule::Scientific(18)), "5.000000000000000000e-01");
        assert_eq!(text(0.0, ScalarType::F64, NumberRule::Scientific(0)), "0e+00");
    }

    #[test]
    fn shortest_digits_are_those_of_repr() {
        let rule = |double, point_zero| NumberRule::Shortest { double, point_zero };
        assert_eq!(text(0.1, ScalarType::F32, rule(false, true)), "0.1");
        assert_eq!(text(0.1, ScalarType::F32, rule(true, true)), "0.10000000149011612");
        assert_eq!(text(-3.0, ScalarType::F32, rule(false, true)), "-3.0");
        assert_eq!(text(-3.0, ScalarType::F32, rule(false, false)), "-3");
        assert_eq!(text(1e-5, ScalarType::F64, rule(true, true)), "1e-05");
        // Two shortest texts are equally near.
        assert_eq!(text(4.78515625, ScalarType::F32, rule(false, true)), "4.7851562");
        assert_eq!(text(4.78515625, ScalarType::F64, rule(false, true)), "4.78515625");
        assert_eq!(text(f64::from(23.959f32), ScalarType::F32, rule(true, true)), "23.958999633789062");
        // The smallest numbers, and a power of two whose shortest text is not the nearest one.
        assert_eq!(text(f64::from_bits(1), ScalarType::F64, rule(true, true)), "5e-324");
        assert_eq!(text(f64::from(f32::from_bits(1)), ScalarType::F32, rule(false, true)), "1e-45");
        assert_eq!(text(2f64.powi(-44), ScalarType::F64, rule(true, true)), "5.684341886080802e-14");
        assert_eq!(text(1.5e16, ScalarType::F64, rule(true, true)), "1.5e+16");
        assert_eq!(text(12e14, ScalarType::F64, rule(true, true)), "1200000000000000.0");
    }

    /// Comparing the digits as integers gives the same answers as writing the number and comparing texts.
    #[test]
    fn plain_numbers_stand_for_their_texts() {
        let mut random = Rng::keyed(7, &[]);
        let rules = [NumberRule::Fixed(0), NumberRule::Fixed(3), NumberRule::Significant(5)];
        let rules = rules.into_iter().chain([NumberRule::Significant(9), NumberRule::Scientific(2)]);
        let rules: Vec<_> = rules.chain([NumberRule::Shortest { double: false, point_zero: true }]).collect();
        let (mut same, mut different) = (0, 0);
        for number in 0..60_000 {
            let mut below = |most: usize| random.below(most);
            let value = match number % 3 {
                0 => below(400_000) as f64 / 1000.0 - 200.0,
                1 => f64::from(f32::from_bits(below(1 << 32) as u32)),
                _ => below(1000) as f64 / 2f64.powi(below(20) as i32),
            };
            let (scalar, rule) = ([ScalarType::F32, ScalarType::F64][below(2)], rules[below(rules.len())]);
            let column = Column { scalar, rule };
            let bytes = match scalar {
                ScalarType::F32 => (value as f32).to_le_bytes().to_vec(),
                _ => value.to_le_bytes().to_vec(),
            };
            let mut writer = NumberWriter::new(Printf { ties_away: below(4) == 0, long_exponent: false });
            let mut written = Vec::new();
            writer.write(&bytes, column, &mut written).unwrap();
            let mut text = String::from_utf8(written.clone()).unwrap();
            match below(6) {
                0 => text.push('0'),
                1 => text.insert(0, ['-', '0', '1'][below(3)]),
                2 => drop(text.pop()),
                3 => text.push_str(".0"),
                _ => {}
            }
            let gives = writer.gives(&text, PlainNumber::of(&text), &bytes, column).unwrap();
            assert_eq!(gives, text.as_bytes() == written, "{text} and {rule:?} of {value}");
            (same, different) = (same + u32::from(gives), different + u32::from(!gives));
            let (mut plain, mut parsed) = (Vec::new(), Vec::new());
            let is_number = parse_plain(&text, PlainNumber::of(&text), scalar, &mut plain);
            assert_eq!(is_number, parse(&text, scalar, &mut parsed), "{text}");
            assert_eq!(plain, parsed, "{text}");
        }
        assert!(same > 10_000 && different > 10_000, "{same} and {different}");
    }

    #[test]
    fn integers_of_all_sizes_come_back() {
        for (scalar, token) in [
            (ScalarType::I8, "-128"),
            (ScalarType::U8, "255"),
            (ScalarType::I16, "-32768"),
            (ScalarType::U16, "65535"),
            (ScalarType::I32, "-2147483648"),
            (ScalarType::U32, "4294967295"),
            (ScalarType::I64, "-9223372036854775808"),
            (ScalarType::U64, "18446744073709551615"),
        ] {
            let mut bytes = Vec::new();
            parse(token, scalar, &mut bytes).unwrap();
            assert_eq!(bytes.len() as u32, scalar.size());
            let mut out = Vec::new();
            let column = Column { scalar, rule: NumberRule::Integer };
            NumberWriter::default().write(&bytes, column, &mut out).unwrap();
            assert_eq!(out, token.as_bytes());
            assert!(parse(&format!("{token}0"), scalar, &mut bytes).is_none());
        }
    }
}
