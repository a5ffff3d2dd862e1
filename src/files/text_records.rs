//! Records as text, in an ascii PCD or PLY or in columns without a header: one record per line, values
//! between single separators, perhaps filled up with spaces. FORMAT.md 9.
//!
//! Texts are converted to values only if the values restore the texts. Programs print numbers in different
//! ways, so the rule of each column is found by trial, and its type too unless it is declared.

use super::field::{Declared, layout_of, name_of};
use super::number::{self, NumberWriter, PlainNumber, Survey};
use super::records;
use crate::ground::error::Result;
use crate::scan::{
    Column, Field, Layout, MAX_DIGITS, NumberRule, Printf, ScalarType, ScanFile, Separator, TextFormat,
    Wrapping,
};

/// Splits a file whose body starts at byte `start` and has at most `points` records of these fields, which
/// must make a valid layout. The first line that does not look like those before it begins the `suffix`.
/// `None` if there is no record, or if no rule restores the texts of a column.
pub(super) fn parse(fields: &[Declared], bytes: &[u8], start: usize, points: u64) -> Option<ScanFile> {
    let body = bytes.get(start..)?;
    // A header can claim any number of values, but each takes at least one byte of the line.
    let values: u64 = fields.iter().map(|field| u64::from(field.count())).sum();
    let line = body.iter().position(|&byte| byte == b'\n').unwrap_or(body.len()) as u64 + 1;
    if !(1..=line).contains(&values) {
        return None;
    }
    let scalars: Vec<Option<ScalarType>> =
        fields.iter().flat_map(|field| (0..field.count()).map(|_| field.scalar)).collect();
    let is_whole = |found: &Body| found.records as u64 == points || found.rest.is_empty();
    let numbers = |is_padded| Body::of_numbers(body, &scalars, points, is_padded);
    let found = match numbers(false) {
        Some(found) if is_whole(&found) => found,
        found => {
            let others = [Body::with_characters(body, &scalars, points), numbers(true), found];
            // The last one wins ties.
            others.into_iter().flatten().max_by_key(|found| found.records)?
        }
    };
    let fields = as_stored(fields, &found.format.columns);
    let records = side_by_side(&found.values, &found.format.columns, found.records);
    let (layout, cloud) = records::split(valid(layout_of(fields, Wrapping::Text(found.format))?)?, &records);
    Some(ScanFile {
        name: String::new(),
        cloud,
        layout,
        prefix: bytes[..start].to_vec(),
        records: found.records,
        suffix: found.rest.to_vec(),
    })
}

/// A body as values.
struct Body<'a> {
    format: TextFormat,
    records: usize,
    /// Those of each column.
    values: Vec<Vec<u8>>,
    /// What follows the last record.
    rest: &'a [u8],
}

impl<'a> Body<'a> {
    /// A body in which all values are written as numbers, which spaces may fill up to a width.
    fn of_numbers(
        body: &'a [u8],
        scalars: &[Option<ScalarType>],
        points: u64,
        is_padded: bool,
    ) -> Option<Self> {
        let mut format = TextFormat::of_line(first_line(body)?);
        if is_padded {
            (format.widths, format.space_after) = (vec![0; scalars.len()], false);
        } else if format.is_padded() {
            return None;
        }
        let mut numbers = Numbers::new(scalars.len());
        let mut rest = body;
        let mut lines = 0u64;
        while lines < points
            && let Some(line) = first_line(rest)
            // The width of a number that was cut short says nothing.
            && (line.ends_with('\n') || !is_padded)
            && format.read_line(line, scalars, &mut numbers).is_some()
        {
            rest = &rest[line.len()..];
            lines += 1;
            format.open_end = !line.ends_with('\n');
        }
        if is_padded {
            format.widths = widths(scalars.len(), &numbers.texts)?;
            numbers.texts.iter_mut().for_each(|text| *text = text.trim_start_matches(' '));
        }
        let found = find_format(scalars, &numbers).or_else(|| {
            // If the file was cut short, the last number may be incomplete too.
            numbers.truncate(numbers.lines().checked_sub(1).filter(|_| format.open_end)?);
            format.open_end = false;
            let end = body.iter().rposition(|&byte| byte == b'\n').map_or(0, |at| at + 1);
            rest = &body[end..];
            find_format(scalars, &numbers)
        });
        let values;
        (format.printf, format.columns, values) = found?;
        Some(Body { format, records: numbers.lines(), values, rest })
    }

    /// A body in which the values of one byte are written as such, as C++ streams write characters and old
    /// versions of PCL wrote their fields: any byte, even one that separates values elsewhere.
    fn with_characters(body: &'a [u8], scalars: &[Option<ScalarType>], points: u64) -> Option<Self> {
        let of_numbers: Vec<Option<ScalarType>> =
            scalars.iter().copied().filter(|scalar| !is_character(*scalar)).collect();
        let count = scalars.len() - of_numbers.len();
        if count == 0 {
            return None;
        }
        let mut lines =
            Characters { format: None, numbers: Numbers::new(of_numbers.len()), bytes: Vec::new() };
        let mut rest = body;
        let mut records = 0;
        while (records as u64) < points
            && let Some(after) = lines.read_line(rest, scalars)
        {
            rest = after;
            records += 1;
        }
        // A line that was read in part.
        lines.numbers.truncate(records);
        let (printf, columns, values) = find_format(&of_numbers, &lines.numbers)?;
        let mut of_numbers = columns.into_iter().zip(values);
        let mut of_bytes = 0..;
        let columns = scalars.iter().map(|scalar| match *scalar {
            Some(scalar) if is_character(Some(scalar)) => {
                let bytes = lines.bytes.iter().copied().skip(of_bytes.next()?).step_by(count);
                Some((Column { scalar, rule: NumberRule::Character }, bytes.take(records).collect()))
            }
            _ => of_numbers.next(),
        });
        let (columns, values) = columns.collect::<Option<Vec<_>>>()?.into_iter().unzip();
        let format = TextFormat { printf, columns, ..lines.format? };
        Some(Body { format, records, values, rest })
    }
}

/// Whether a column may be written as characters.
fn is_character(scalar: Option<ScalarType>) -> bool {
    scalar.is_some_and(|scalar| scalar.size() == 1)
}

/// Lines whose values of one byte are written as such, separated by spaces.
struct Characters<'a> {
    /// That of the first line, without columns.
    format: Option<TextFormat>,
    numbers: Numbers<'a>,
    bytes: Vec<u8>,
}

impl<'a> Characters<'a> {
    /// Takes the values out of the next line. Returns what follows it; `None` if it is not like the lines
    /// before.
    fn read_line(&mut self, mut rest: &'a [u8], scalars: &[Option<ScalarType>]) -> Option<&'a [u8]> {
        let mut column = 0;
        for (at, &scalar) in scalars.iter().enumerate() {
            if at > 0 {
                rest = rest.strip_prefix(b" ")?;
            }
            if is_character(scalar) {
                let (&byte, after) = rest.split_first()?;
                self.bytes.push(byte);
                rest = after;
                continue;
            }
            let end = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
            let (token, after) = rest.split_at(end);
            let token = std::str::from_utf8(token).ok()?;
            self.numbers.push(column, token, token, scalar)?;
            column += 1;
            rest = after;
        }
        let format = self.format.get_or_insert_with(|| {
            let trailing_separator = rest.starts_with(b" ");
            let end = &rest[usize::from(trailing_separator)..];
            TextFormat {
                trailing_separator,
                crlf: end.starts_with(b"\r\n"),
                open_end: end.is_empty(),
                ..TextFormat::default()
            }
        });
        if format.trailing_separator {
            rest = rest.strip_prefix(b" ")?;
        }
        if rest.is_empty() {
            format.open_end = true;
            return Some(rest);
        }
        rest.strip_prefix(format.line_end().as_bytes())
    }
}

/// The numbers of some lines.
struct Numbers<'a> {
    /// The texts, line by line, with the spaces that fill them up.
    texts: Vec<&'a str>,
    /// The same numbers as plain numbers, column by column; `None` for numbers in other forms.
    plain: Vec<Vec<Option<PlainNumber>>>,
    scratch: Vec<u8>,
}

impl<'a> Numbers<'a> {
    fn new(columns: usize) -> Self {
        Numbers { texts: Vec::new(), plain: vec![Vec::new(); columns], scratch: Vec::new() }
    }

    /// The number of whole lines.
    fn lines(&self) -> usize {
        self.texts.len() / self.plain.len().max(1)
    }

    /// Adds the next number, of this column; `None` if it is not one, or not of this type. `number` is its
    /// text without the spaces that fill it up.
    #[inline]
    fn push(&mut self, column: usize, text: &'a str, number: &str, scalar: Option<ScalarType>) -> Option<()> {
        let plain = PlainNumber::of(number);
        let scalar = scalar.unwrap_or(ScalarType::F64);
        if plain.is_none() || !scalar.is_float() {
            self.scratch.clear();
            number::parse(number, scalar, &mut self.scratch)?;
        }
        self.plain.get_mut(column)?.push(plain);
        self.texts.push(text);
        Some(())
    }

    /// Keeps the first lines only.
    fn truncate(&mut self, lines: usize) {
        self.texts.truncate(lines * self.plain.len());
        self.plain.iter_mut().for_each(|plain| plain.truncate(lines));
    }

    /// The numbers of a column, as texts and as plain numbers.
    fn column(&self, at: usize) -> impl Iterator<Item = (&'a str, Option<PlainNumber>)> + Clone {
        let texts = self.texts.iter().skip(at).step_by(self.plain.len());
        texts.copied().zip(self.plain[at].iter().copied())
    }

    /// The texts of those that are not plain numbers.
    fn others(&self) -> impl Iterator<Item = &'a str> {
        let all = (0..self.plain.len()).flat_map(|at| self.column(at));
        all.filter(|(_, plain)| plain.is_none()).map(|(text, _)| text)
    }
}

/// How numbers are printed, and the columns with the values of each. `None` if there are no columns, or if no
/// rule restores the texts of one.
fn find_format(
    scalars: &[Option<ScalarType>],
    numbers: &Numbers,
) -> Option<(Printf, Vec<Column>, Vec<Vec<u8>>)> {
    let is_long = |text: &str| {
        let exponent =
            text.split_once('e').map_or("", |(_, exponent)| exponent.trim_start_matches(['+', '-']));
        exponent.len() > 2 && exponent.starts_with('0')
    };
    let long_exponent = numbers.others().any(is_long);
    [false, true].into_iter().find_map(|ties_away| {
        let printf = Printf { ties_away, long_exponent };
        let (columns, values) = find_columns(scalars, numbers, printf)?;
        Some((printf, columns, values))
    })
}

/// The columns, with the values of each.
fn find_columns(
    scalars: &[Option<ScalarType>],
    numbers: &Numbers,
    printf: Printf,
) -> Option<(Vec<Column>, Vec<Vec<u8>>)> {
    let columns =
        scalars.iter().enumerate().map(|(at, &scalar)| find_column(scalar, numbers.column(at), printf));
    columns.collect::<Option<_>>().filter(|_| numbers.lines() > 0)
}

/// The width up to which spaces fill each column's texts, or 0; `None` if they are filled up in another way,
/// or none is.
fn widths(columns: usize, tokens: &[&str]) -> Option<Vec<u8>> {
    let is_filled = |text: &&str| text.starts_with(' ');
    let width = |at: usize| {
        let mut texts = tokens.iter().copied().skip(at).step_by(columns);
        let width = texts.clone().find(is_filled).map_or(0, str::len);
        let is_as_wide = |text: &str| text.len() == width || text.len() > width && !is_filled(&text);
        texts.all(is_as_wide).then(|| u8::try_from(width).ok())?.filter(|width| *width <= MAX_DIGITS)
    };
    let widths: Vec<u8> = (0..columns).map(width).collect::<Option<_>>()?;
    widths.iter().any(|width| *width > 0).then_some(widths)
}

/// The fields as these columns store them: a field whose values have different types becomes several fields.
fn as_stored(fields: &[Declared], columns: &[Column]) -> Vec<Field> {
    let mut rest = columns;
    let mut stored = Vec::with_capacity(fields.len());
    for declared in fields {
        let (own, after) = rest.split_at((declared.count() as usize).min(rest.len()));
        rest = after;
        match own {
            [] => {}
            [first, others @ ..] if others.iter().all(|column| column.scalar == first.scalar) => {
                let count = own.len() as u32;
                stored.push(Field { name: name_of(declared.name), scalar: first.scalar, count });
            }
            _ => stored.extend((0..).zip(own).map(|(value, column): (u32, _)| {
                Field::new(&name_of(&format!("{}_{value}", declared.name)), column.scalar)
            })),
        }
    }
    stored
}

fn valid(layout: Layout) -> Option<Layout> {
    layout.validate().ok().map(|()| layout)
}

/// Joins the values of the columns into records.
fn side_by_side(values: &[Vec<u8>], columns: &[Column], records: usize) -> Vec<u8> {
    let mut body = Vec::with_capacity(values.iter().map(Vec::len).sum());
    for record in 0..records {
        for (values, column) in values.iter().zip(columns) {
            let size = column.scalar.size() as usize;
            body.extend_from_slice(&values[record * size..(record + 1) * size]);
        }
    }
    body
}

/// Writes records as lines of text, some at a time.
pub(super) struct TextWriter<'f> {
    format: &'f TextFormat,
    numbers: NumberWriter,
    /// Whether there were records before.
    has_lines: bool,
    out: Vec<u8>,
}

impl<'f> TextWriter<'f> {
    pub fn new(format: &'f TextFormat) -> Self {
        TextWriter { format, numbers: NumberWriter::new(format.printf), has_lines: false, out: Vec::new() }
    }

    /// The text of the next records, each as long as the columns together.
    ///
    /// # Errors
    /// None, if the layout is valid.
    pub fn lines(&mut self, records: &[u8]) -> Result<&[u8]> {
        let TextWriter { format, numbers, has_lines, out } = self;
        let (separator, end) = (format.separator.character() as u8, format.line_end().as_bytes());
        out.clear();
        for record in records.chunks_exact(format.stride().max(1)) {
            // With an open end, nothing ends the last line.
            if format.open_end && std::mem::replace(has_lines, true) {
                out.extend_from_slice(end);
            }
            let mut rest = record;
            for (at, &column) in format.columns.iter().enumerate() {
                if at > 0 {
                    out.push(separator);
                    if format.space_after {
                        out.push(b' ');
                    }
                }
                let (value, after) = rest.split_at(column.scalar.size() as usize);
                let start = out.len();
                numbers.write(value, column, out)?;
                let width = format.widths.get(at).copied().unwrap_or(0);
                let missing = usize::from(width).saturating_sub(out.len() - start);
                if missing > 0 {
                    out.splice(start..start, std::iter::repeat_n(b' ', missing));
                }
                rest = after;
            }
            if format.trailing_separator {
                out.push(separator);
            }
            if !format.open_end {
                out.extend_from_slice(end);
            }
        }
        Ok(out)
    }
}

/// The types that an undeclared column may have: the shortest that represents all its numbers is used.
const ANY: [ScalarType; 10] = {
    use ScalarType::*;
    [U8, I8, U16, I16, U32, I32, U64, I64, F32, F64]
};

/// The type and rule that restore all these texts, and the values. Doubles of which single precision
/// preserves every digit are stored as float32: many programs print float32 values as doubles.
fn find_column<'a>(
    declared: Option<ScalarType>,
    numbers: impl Iterator<Item = (&'a str, Option<PlainNumber>)> + Clone,
    printf: Printf,
) -> Option<(Column, Vec<u8>)> {
    let candidates = match &declared {
        None => &ANY[..],
        Some(ScalarType::F64) => &[ScalarType::F32, ScalarType::F64],
        Some(scalar) => std::slice::from_ref(scalar),
    };
    candidates.iter().find_map(|&scalar| {
        let mut values = Vec::new();
        numbers
            .clone()
            .try_for_each(|(text, plain)| number::parse_plain(text, plain, scalar, &mut values))?;
        let pairs = numbers.clone().zip(values.chunks_exact(scalar.size() as usize));
        let column = find_rule(scalar, pairs, printf)?;
        Some((column, values))
    })
}

/// The first rule that restores all these texts from these values.
fn find_rule<'t, 'v>(
    scalar: ScalarType,
    pairs: impl Iterator<Item = ((&'t str, Option<PlainNumber>), &'v [u8])> + Clone,
    printf: Printf,
) -> Option<Column> {
    let mut survey = Survey::new();
    pairs.clone().for_each(|((text, plain), _)| survey.add(text, plain));
    let mut writer = NumberWriter::new(printf);
    survey.candidates(scalar).into_iter().map(|rule| Column { scalar, rule }).find(|&column| {
        let mut gives = |text, plain, value| writer.gives(text, plain, value, column).is_ok_and(|same| same);
        pairs.clone().all(|((text, plain), value)| gives(text, plain, value))
    })
}

/// The first line, including its line end if it has one; `None` if there is none, or if it is not text.
pub(super) fn first_line(bytes: &[u8]) -> Option<&str> {
    let end = bytes.iter().position(|&b| b == b'\n').map_or(bytes.len(), |at| at + 1);
    std::str::from_utf8(&bytes[..end]).ok().filter(|line| !line.is_empty())
}

impl TextFormat {
    /// The format of a line, without columns. If spaces fill numbers up, their widths are not known yet,
    /// and 0.
    pub(super) fn of_line(line: &str) -> Self {
        let text = line.trim_end_matches(['\r', '\n']);
        let separator = [Separator::Tab, Separator::Semicolon, Separator::Comma]
            .into_iter()
            .find(|separator| text.contains(separator.character()))
            .unwrap_or_default();
        let character = separator.character();
        // The first kind of separator that occurs in the line separates the numbers.
        let after = text.split_once(character).map_or("", |(_, after)| after);
        // One space may follow a separator.
        let twice = if separator == Separator::Space { "  ".to_owned() } else { format!("{character}  ") };
        let is_padded = text.starts_with(' ') || text.contains(&twice[..]);
        TextFormat {
            crlf: line.ends_with("\r\n"),
            separator,
            space_after: after.starts_with(' ') && separator != Separator::Space && !is_padded,
            trailing_separator: text.ends_with(character),
            widths: if is_padded { vec![0; text.split(character).count()] } else { Vec::new() },
            ..TextFormat::default()
        }
    }

    /// Whether spaces fill numbers up to a width.
    fn is_padded(&self) -> bool {
        !self.widths.is_empty()
    }

    fn line_end(&self) -> &'static str {
        if self.crlf { "\r\n" } else { "\n" }
    }

    /// The texts between the separators of a line, with the spaces that fill them up; the line end may be
    /// missing. `None` if the line does not have this format.
    pub(super) fn texts<'a>(&self, line: &'a str) -> Option<impl Iterator<Item = &'a str>> {
        let separator = self.separator.character();
        let mut text = line.strip_suffix(self.line_end()).unwrap_or(line);
        if self.trailing_separator {
            text = text.strip_suffix(separator)?;
        }
        let (is_spaced, is_padded) = (self.space_after, self.is_padded());
        let mut rest = Some(text);
        let texts = std::iter::from_fn(move || {
            let text = rest?;
            // Those that fill a number up are not separators.
            let filled = if is_padded { text.len() - text.trim_start_matches(' ').len() } else { 0 };
            let (own, after) = match text.bytes().skip(filled).position(|byte| byte == separator as u8) {
                Some(length) => (&text[..filled + length], Some(&text[filled + length + 1..])),
                None => (text, None),
            };
            rest = after;
            Some(own)
        });
        // A missing space shows as a text that is not a number.
        Some(texts.enumerate().map(move |(at, text)| match at > 0 && is_spaced {
            true => text.strip_prefix(' ').unwrap_or(""),
            false => text,
        }))
    }

    /// A text without the spaces that fill it up.
    fn without_padding<'a>(&self, text: &'a str) -> &'a str {
        if self.is_padded() { text.trim_start_matches(' ') } else { text }
    }

    /// The number of columns of the line, if all of them are numbers.
    pub(super) fn count_numbers(&self, line: &str) -> Option<usize> {
        let mut value = Vec::new();
        self.texts(line)?.try_fold(0, |count, text| {
            value.clear();
            number::parse(self.without_padding(text), ScalarType::F64, &mut value).map(|()| count + 1)
        })
    }

    /// Takes the numbers out of a line; `None`, with nothing taken, if the line does not have this format.
    fn read_line<'a>(
        &self,
        line: &'a str,
        scalars: &[Option<ScalarType>],
        numbers: &mut Numbers<'a>,
    ) -> Option<()> {
        let before = numbers.lines();
        let mut scalars_left = scalars.iter().enumerate();
        let complete = self.texts(line)?.try_for_each(|text| {
            let (column, &scalar) = scalars_left.next()?;
            numbers.push(column, text, self.without_padding(text), scalar)
        });
        if complete.is_none() || scalars_left.next().is_some() {
            numbers.truncate(before);
            return None;
        }
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::files::tests::{comes_back, pcd};
    use crate::scan::{Channel, PointCloud};

    fn file(body: &str) -> Vec<u8> {
        let header = pcd("x y z intensity ring", "4 4 4 4 2", "F F F F U", "1 1 1 1 1", 3, "ascii");
        [&header, body.as_bytes()].concat()
    }

    fn rules(scan: &ScanFile) -> Vec<NumberRule> {
        match &scan.layout.wrapping {
            Wrapping::Text(format) => format.columns.iter().map(|c| c.rule).collect(),
            other => panic!("not text: {other:?}"),
        }
    }

    #[test]
    fn the_text_of_pcl_is_values() {
        // %.8g of float32 values
        let body =
            "11.375 -0.34999999 1e-05 0 1\nnan nan nan 0.25999999 22\n-120000 1.0471976 7.7510004 1 3\n";
        let scan = comes_back("a.pcd", file(body));
        assert_eq!((scan.records, scan.suffix.len()), (3, 0));
        assert_eq!(scan.cloud.positions[0], [11.375, -0.35, 1e-5]);
        assert!(scan.cloud.positions[1][0].is_nan());
        assert_eq!(scan.cloud.intensity[1], 0.26);
        assert_eq!(scan.cloud.channels[0].bytes, [1, 0, 22, 0, 3, 0]);
    }

    #[test]
    fn each_column_has_its_rule() {
        // %.10g, %.3f, repr in single and in double precision
        let body =
            "0.1000000015 1.500 0.1 0.10000000149011612 1\n2 0.100 2.0 2.0 22\n0.25 -0.000 3.25 1e-05 3\n";
        let scan = comes_back("a.pcd", file(&body.replace("1e-05", "9.999999747378752e-06")));
        assert_eq!(
            rules(&scan),
            [
                NumberRule::Significant(10),
                NumberRule::Fixed(3),
                NumberRule::Shortest { double: false, point_zero: true },
                NumberRule::Shortest { double: true, point_zero: true },
                NumberRule::Integer,
            ]
        );
        // Few digits, but so large a number that `%g` with two significant digits would write an exponent.
        let scan = comes_back("a.pcd", file("120000 1 1 1 1\n2.5 1 1 1 1\n"));
        assert_eq!(rules(&scan)[0], NumberRule::Significant(6));
        let scan = comes_back("a.pcd", file("1.50e+00 1 1 1 1\n2.25e-07 1 1 1 1\n"));
        assert_eq!(rules(&scan)[..2], [NumberRule::Scientific(2), NumberRule::Fixed(0)]);
    }

    #[test]
    fn doubles_that_are_singles_are_kept_so() {
        let header = pcd("x y z intensity t", "8 8 8 8 8", "F F F F F", "1 1 1 1 1", 2, "ascii");
        let body = "22.719 0.031 1 0.1 1300000000.5\n18.052 0.076 -2 0.123456789012 1300000000.75\n";
        let scan = comes_back("a.pcd", [&header, body.as_bytes()].concat());
        assert_eq!(scan.cloud.positions, [[22.719, 0.031, 1.0], [18.052, 0.076, -2.0]]);
        assert_eq!((scan.layout.stride(), scan.layout.intensity), (3 * 4 + 2 * 8, None));
    }

    #[test]
    fn fields_with_a_count_of_0_are_in_no_line() {
        let header = pcd("x y z _ intensity _", "4 4 4 1 4 1", "F F F U F U", "1 1 1 0 1 0", 2, "ascii");
        let scan = comes_back("a.pcd", [&header, &b"1.5 2 3 7\n4 5.25 6 8\n"[..]].concat());
        assert_eq!((scan.records, scan.suffix.len()), (2, 0));
        assert_eq!(scan.cloud.positions, [[1.5, 2.0, 3.0], [4.0, 5.25, 6.0]]);
        assert_eq!(scan.cloud.intensity, [7.0, 8.0]);
    }

    #[test]
    fn lines_may_end_and_be_parted_otherwise() {
        for body in ["1 2 3 4 5 \n1 2 3 4 5 \n", "1\t2\t3\t4\t5\r\n", "1 2 3 4 5 \r\n1 2 3 4 5 \r\n"] {
            assert!(comes_back("a.pcd", file(body)).records > 0, "{body:?}");
        }
    }

    #[test]
    fn what_is_not_like_the_first_line_is_suffix() {
        for (body, records, suffix) in [
            ("1 2 3 4 5\n1 2 3 4 5", 2, ""),
            ("1.50 2 3 4 5\n1.5", 1, "1.5"),
            ("1.50 2 3 4 5\n1.5 2 3 4 5", 1, "1.5 2 3 4 5"),
            ("1 2 3 4 5\n1 2 3 4\n1 2 3 4 5\n", 1, "1 2 3 4\n1 2 3 4 5\n"),
            ("1 2 3 4 5\n1 2 3 4 5 6\n", 1, "1 2 3 4 5 6\n"),
            ("1 2 3 4 5\n1 2 3 4  5\n", 1, "1 2 3 4  5\n"),
            ("1 2 3 4 5\n1 2 3 4 70000\n", 1, "1 2 3 4 70000\n"),
            ("1 2 3 4 5\r\n1 2 3 4 5\n", 1, "1 2 3 4 5\n"),
            ("1 2 3 4 5\n1 2 3 4 5\n1 2 3 4 5\n1 2 3 4 5\n", 3, "1 2 3 4 5\n"),
        ] {
            let scan = comes_back("a.pcd", file(body));
            assert_eq!((scan.records, &scan.suffix[..]), (records, suffix.as_bytes()), "{body:?}");
        }
    }

    #[test]
    fn texts_that_no_rule_gives_are_opaque() {
        for body in [
            "",
            "1 2 3 4",
            "01 2 3 4 5\n",
            "+1 2 3 4 5\n",
            "1. 2 3 4 5\n",
            "1.5 2 3 4 5\n1.50 2 3 4 5\n",
            "0.123456789012 2 3 4 5\n",
            "NaN 2 3 4 5\n",
            "1 2 3 4 05\n",
            "1E5 2 3 4 5\n",
        ] {
            assert!(comes_back("a.pcd", file(body)).is_opaque(), "{body:?}");
        }
    }

    #[test]
    fn spaces_may_fill_numbers_up() {
        for (body, widths) in [
            // %8.3f and so on; numbers that need more are as long as they must be
            (
                "   1.500   -2.25 1 2  10\n1234.000 1234.75 1 2 300\n  -0.125 -999.00 3 4 255\n",
                &[8, 7, 0, 0, 3][..],
            ),
            ("12345.000 1 1 1 1\n    1.500 1 1 1 1\n-99999.000 1 1 1 1\n", &[9, 0, 0, 0, 0]),
            ("  1.50,  2.00,1,1,1\r\n-11.50, 12.25,1,1,1\r\n", &[6, 6, 0, 0, 0]),
            (" 1.5  2  3  4  5\n-1.5 -2 -3 -4 99\n", &[4, 2, 2, 2, 2]),
        ] {
            let scan = comes_back("a.pcd", file(body));
            let Wrapping::Text(format) = &scan.layout.wrapping else { panic!("{body:?}") };
            assert_eq!(format.widths, widths, "{body:?}");
            assert_eq!((scan.records, scan.suffix.len()), (body.lines().count(), 0), "{body:?}");
        }
        // An incomplete last line, and numbers that are filled up in no known way.
        let scan = comes_back("a.pcd", file("  1.5 1 1 1 1\n 22.5 1 1 1 1\n  1."));
        assert_eq!((scan.records, &scan.suffix[..]), (2, &b"  1."[..]));
        for body in ["  1.5 1 1 1 1\n   1.5 1 1 1 1\n", "1.5   1 1 1 1\n1.5 1 1 1 1\n", "1.5  1 1 1\n"] {
            assert!(comes_back("a.pcd", file(body)).is_opaque(), "{body:?}");
        }
    }

    #[test]
    fn values_of_a_byte_may_be_characters() {
        let file = |points, body: &[u8]| {
            let header = pcd("x tag y line", "4 1 4 1", "F U F I", "1 1 1 1", points, "ascii");
            [&header, body].concat()
        };
        // Every byte, those that separate and end lines and the digits too.
        let mut body = Vec::new();
        for byte in 0..=255u8 {
            body.extend_from_slice(format!("{}.500000 ", u32::from(byte) * 7).as_bytes());
            body.extend_from_slice(&[byte, b' ', b'1', b'.', b'2', b'5', b' ', byte ^ 10, b'\n']);
        }
        let scan = comes_back("a.pcd", file(256, &body));
        let [fixed, character] = [NumberRule::Fixed(6), NumberRule::Character];
        assert_eq!(rules(&scan), [fixed, character, NumberRule::Fixed(2), character]);
        assert_eq!((scan.records, scan.suffix.len()), (256, 0));
        assert_eq!(scan.cloud.channels[1].bytes, (0..=255).collect::<Vec<u8>>());
        for (body, records, suffix) in [
            (&b"1.5 \n 2 \x80"[..], 1, &b""[..]),
            (b"1.5 \xff 2 \r\r\n2.5 \0 2  \r\n", 2, b""),
            (b"1.5 \x01 2 \x02 \n2.5 \x03 4 \x05 \n", 2, b""),
            (b"1.5 1 2 \x02\n2.5 10 4 \x05\n", 1, b"2.5 10 4 \x05\n"),
            (b"1.5 \x01 2 \x02\n2.5 \x03 4", 1, b"2.5 \x03 4"),
            // Numbers, of which more lines can be read than of characters.
            (b"1.5 1 2 3\n2.5 10 4 5\n3.5 1", 2, b"3.5 1"),
        ] {
            let scan = comes_back("a.pcd", file(3, body));
            assert_eq!((scan.records, &scan.suffix[..]), (records, suffix), "{body:?}");
        }
    }

    #[test]
    fn texts_of_windows_are_numbers() {
        let header = pcd("x y z", "4 4 4", "F F F", "1 1 1", 2, "ascii");
        let lines = b"-21.164063 11.238921 1.2558537\r\n0.125 1e-005 -5.2e-006\r\n".to_vec();
        let scan = comes_back("a.pcd", [header, lines].concat());
        assert_eq!(scan.cloud.positions[0], [-21.164_063, 11.238_921, 1.255_853_7]);
        let Wrapping::Text(format) = &scan.layout.wrapping else { panic!("{:?}", scan.layout) };
        assert_eq!(format.printf, Printf { ties_away: true, long_exponent: true });
    }

    /// All rules for floating point, with up to as many digits as programs use.
    fn any_rule() -> impl Strategy<Value = NumberRule> {
        prop_oneof![
            (0u8..20).prop_map(NumberRule::Fixed),
            (0u8..20).prop_map(NumberRule::Scientific),
            (1u8..20).prop_map(NumberRule::Significant),
            any::<(bool, bool)>()
                .prop_map(|(double, point_zero)| NumberRule::Shortest { double, point_zero }),
        ]
    }

    /// Any number except the largest, which few digits round to more than the maximum: this reads as
    /// infinity.
    fn any_number() -> impl Strategy<Value = f64> {
        any::<f64>().prop_filter("too large", |number| !number.is_finite() || number.abs() < 9e307)
    }

    /// The text of the values with this type and rule, as a C library prints it.
    fn text_of(scalar: ScalarType, rule: NumberRule, printf: Printf, bytes: Vec<u8>) -> Vec<u8> {
        let size = scalar.size();
        let records = bytes.len() / size as usize;
        let columns = vec![Column { scalar, rule }];
        let format = TextFormat { printf, columns, ..TextFormat::default() };
        let wrapping = Wrapping::Text(format);
        let prefix = pcd("v", &size.to_string(), "F", "1", records as u64, "ascii");
        let field = Field::new("v", scalar);
        let layout = Layout { wrapping, fields: vec![field.clone()], ..Layout::default() };
        let cloud = PointCloud { channels: vec![Channel { field, bytes }], ..PointCloud::default() };
        ScanFile { layout, prefix, records, cloud, ..ScanFile::default() }.to_bytes().unwrap()
    }

    proptest! {
        /// A text written by any rule is recognised, whatever the values.
        #[test]
        fn every_rule_is_found_again(
            any in prop::collection::vec(any_number(), 0..20),
            tame in prop::collection::vec(-99999i32..99999, 1..20),
            rule in any_rule(),
            (ties_away, long_exponent) in any::<(bool, bool)>(),
        ) {
            let printf = Printf { ties_away, long_exponent };
            let values = any.into_iter().chain(tame.into_iter().map(|n| f64::from(n) / 64.0));
            let doubles: Vec<u8> = values.clone().flat_map(f64::to_le_bytes).collect();
            let singles: Vec<u8> = values.flat_map(|v| (v as f32).to_le_bytes()).collect();
            for (scalar, bytes) in [(ScalarType::F64, doubles), (ScalarType::F32, singles)] {
                let scan = comes_back("a.pcd", text_of(scalar, rule, printf, bytes));
                prop_assert!(!scan.is_opaque(), "{:?} {}", rule, String::from_utf8_lossy(&scan.prefix));
            }
        }
    }
}
