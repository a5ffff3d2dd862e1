//! How the numbers of a text body (ascii PCD or PLY, or columns alone) are written. FORMAT.md 8.1 and 9.

use super::scalar::ScalarType;
use crate::ground::error::{Error, Result};
use crate::ground::varint::{read_unsigned, write_unsigned};

/// The largest number of digits in a rule: more than any program prints, and a bound on how far a malicious
/// stream can expand one value.
pub const MAX_DIGITS: u8 = 40;

/// How a value is written as text. The rule in C or Python is in brackets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NumberRule {
    /// A decimal integer (`%d`).
    Integer,
    /// This many digits after the decimal point (`%.Nf`).
    Fixed(u8),
    /// One digit before the decimal point, this many after it, and an exponent (`%.Ne`).
    Scientific(u8),
    /// At most this many significant digits, without trailing zeros (`%.Ng`, C++ streams).
    Significant(u8),
    /// The fewest digits from which the value can be restored (`repr`).
    Shortest {
        /// The value is first widened to double precision, as Python does with its floats.
        double: bool,
        /// A whole number ends in `.0`.
        point_zero: bool,
    },
    /// The character with this code (C++ streams); only for integers of one byte.
    Character,
}

impl NumberRule {
    /// The rule's number and its parameter.
    pub(super) fn to_bytes(self) -> (u8, u8) {
        match self {
            NumberRule::Integer => (0, 0),
            NumberRule::Fixed(digits) => (1, digits),
            NumberRule::Scientific(digits) => (2, digits),
            NumberRule::Significant(digits) => (3, digits),
            NumberRule::Shortest { double, point_zero } => (4, u8::from(double) | u8::from(point_zero) << 1),
            NumberRule::Character => (5, 0),
        }
    }

    pub(super) fn from_bytes(rule: u8, parameter: u8) -> Option<Self> {
        Some(match (rule, parameter) {
            (0, 0) => NumberRule::Integer,
            (1, digits) => NumberRule::Fixed(digits),
            (2, digits) => NumberRule::Scientific(digits),
            (3, digits) => NumberRule::Significant(digits),
            (4, flags @ 0..4) => NumberRule::Shortest { double: flags & 1 != 0, point_zero: flags & 2 != 0 },
            (5, 0) => NumberRule::Character,
            _ => return None,
        })
    }

    pub(super) fn suits(self, scalar: ScalarType) -> bool {
        match self {
            NumberRule::Integer => !scalar.is_float(),
            NumberRule::Fixed(digits) | NumberRule::Scientific(digits) => {
                scalar.is_float() && digits <= MAX_DIGITS
            }
            NumberRule::Significant(digits) => scalar.is_float() && (1..=MAX_DIGITS).contains(&digits),
            NumberRule::Shortest { .. } => scalar.is_float(),
            NumberRule::Character => scalar.size() == 1,
        }
    }
}

/// One column of a text body.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Column {
    /// The type of the values in a record.
    pub scalar: ScalarType,
    /// How they are written as text.
    pub rule: NumberRule,
}

/// The separator between two columns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Separator {
    /// A space.
    #[default]
    Space,
    /// A tab.
    Tab,
    /// A comma.
    Comma,
    /// A semicolon.
    Semicolon,
}

impl Separator {
    /// Its character.
    pub fn character(self) -> char {
        match self {
            Separator::Space => ' ',
            Separator::Tab => '\t',
            Separator::Comma => ',',
            Separator::Semicolon => ';',
        }
    }

    /// Its flag in the serialised form.
    fn flag(self) -> u64 {
        match self {
            Separator::Space => 0,
            Separator::Tab => TAB,
            Separator::Comma => COMMA,
            Separator::Semicolon => SEMICOLON,
        }
    }

    fn from_flag(flag: u64) -> Option<Self> {
        let all = [Separator::Space, Separator::Tab, Separator::Comma, Separator::Semicolon];
        all.into_iter().find(|separator| separator.flag() == flag)
    }
}

// The flags of a serialised format.
const CRLF: u64 = 1;
const TAB: u64 = 2;
const TRAILING_SEPARATOR: u64 = 4;
const COMMA: u64 = 8;
const SEMICOLON: u64 = 16;
const SPACE_AFTER: u64 = 32;
const OPEN_END: u64 = 64;
const TIES_AWAY: u64 = 128;
const LONG_EXPONENT: u64 = 256;
const PADDED: u64 = 512;

/// How a C library prints numbers of a given number of digits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Printf {
    /// A number midway between two texts is rounded away from zero if its last digit stands after the decimal
    /// point, instead of to even: Windows before 2020.
    pub ties_away: bool,
    /// Exponents have at least three digits instead of two: Visual C++ before 2015.
    pub long_exponent: bool,
}

/// How the records of a text body are written: one a line, with separators between the columns.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TextFormat {
    /// Lines end in `\r\n` instead of `\n`.
    pub crlf: bool,
    /// What separates columns.
    pub separator: Separator,
    /// A space follows each separator except one after the last column.
    pub space_after: bool,
    /// A separator follows the last column too.
    pub trailing_separator: bool,
    /// The last line has no line end.
    pub open_end: bool,
    /// How numbers are printed.
    pub printf: Printf,
    /// The columns, in the order of the file and of the record.
    pub columns: Vec<Column>,
    /// Spaces fill shorter numbers up to this width from the left, for each column (`%8.3f`); empty if no
    /// column has one.
    pub widths: Vec<u8>,
}

impl TextFormat {
    /// Bytes of a record with these columns.
    pub fn stride(&self) -> usize {
        self.columns.iter().map(|c| c.scalar.size() as usize).sum()
    }

    pub(super) fn validate(&self) -> Result<()> {
        let is_width = |width: &u8| *width <= MAX_DIGITS;
        if !self.columns.iter().all(|c| c.rule.suits(c.scalar)) {
            return Err(Error::corrupt("record layout: a number rule does not suit its column"));
        }
        let has_widths = self.widths.is_empty() || self.widths.len() == self.columns.len();
        match has_widths && self.widths.iter().all(is_width) {
            true => Ok(()),
            false => Err(Error::corrupt("record layout: widths of columns")),
        }
    }

    /// Flags, then two bytes for each column, then the widths; the number of columns follows from the fields.
    pub(super) fn write_to(&self, out: &mut Vec<u8>) {
        let flag = |flag: u64, is_set: bool| if is_set { flag } else { 0 };
        let flags = flag(CRLF, self.crlf)
            | self.separator.flag()
            | flag(SPACE_AFTER, self.space_after)
            | flag(TRAILING_SEPARATOR, self.trailing_separator)
            | flag(OPEN_END, self.open_end)
            | flag(TIES_AWAY, self.printf.ties_away)
            | flag(LONG_EXPONENT, self.printf.long_exponent)
            | flag(PADDED, !self.widths.is_empty());
        write_unsigned(out, flags);
        for column in &self.columns {
            let (rule, parameter) = column.rule.to_bytes();
            out.extend([column.scalar as u8 | rule << 4, parameter]);
        }
        out.extend_from_slice(&self.widths);
    }

    /// Reads `columns` columns.
    pub(super) fn read_from(input: &mut &[u8], columns: u64) -> Result<Self> {
        let damaged = || Error::corrupt("record layout: text format");
        let flags = read_unsigned(input, "record layout: text format")?;
        const OTHERS: u64 =
            CRLF | SPACE_AFTER | TRAILING_SEPARATOR | OPEN_END | TIES_AWAY | LONG_EXPONENT | PADDED;
        let mut format = TextFormat {
            crlf: flags & CRLF != 0,
            separator: Separator::from_flag(flags & !OTHERS).ok_or_else(damaged)?,
            space_after: flags & SPACE_AFTER != 0,
            trailing_separator: flags & TRAILING_SEPARATOR != 0,
            open_end: flags & OPEN_END != 0,
            printf: Printf { ties_away: flags & TIES_AWAY != 0, long_exponent: flags & LONG_EXPONENT != 0 },
            columns: Vec::new(),
            widths: Vec::new(),
        };
        // Not allocated up front: the list grows with the input.
        for _ in 0..columns {
            let (&[kind, parameter], rest) = input.split_first_chunk().ok_or_else(damaged)?;
            *input = rest;
            let scalar = ScalarType::from_number(kind & 15).ok_or_else(damaged)?;
            let rule = NumberRule::from_bytes(kind >> 4, parameter).ok_or_else(damaged)?;
            format.columns.push(Column { scalar, rule });
        }
        if flags & PADDED != 0 {
            let (widths, rest) = input.split_at_checked(format.columns.len()).ok_or_else(damaged)?;
            (format.widths, *input) = (widths.to_vec(), rest);
        }
        Ok(format)
    }
}
