//! Arrow files, which pandas and pyarrow write as Feather, version 2 (`.feather`, `.arrow`): batches of
//! records stored field by field, as they are or compressed with LZ4. FORMAT.md 9.
//!
//! Source: Apache Arrow, "Arrow Columnar Format", IPC file format, with `Message.fbs`, `Schema.fbs` and
//! `File.fbs`.

use byteorder::{ByteOrder, LittleEndian};

use super::field::{layout_of, name_of, names_coordinates, with_underscores};
use super::{by_field, lz4, records};
use crate::ground::error::{Error, Result};
use crate::scan::{Field, ScalarType, ScanFile, Widening, Wrapping};

const MAGIC: &[u8] = b"ARROW1";
/// Bytes before the first message: the magic, and two zeros.
const START: usize = 8;
/// Bytes after the footer: its size, and the magic.
const END: usize = 4 + MAGIC.len();

/// The columns of a file, according to the schema at its beginning.
pub(super) struct Header {
    columns: Vec<Column>,
}

struct Column {
    /// Half-precision numbers are of type `u16` here.
    field: Field,
    is_half: bool,
}

impl Header {
    /// Reads the schema of the file that `bytes` begin with; `None` if it is damaged, or if some column does
    /// not hold little-endian numbers.
    pub(super) fn parse(bytes: &[u8]) -> Option<Self> {
        const BIG_ENDIAN: [u8; 2] = [1, 0];
        let schema = bytes.strip_prefix(MAGIC).and(Message::at(bytes, START))?.header(Message::SCHEMA)?;
        if schema.number(0) == Some(BIG_ENDIAN) {
            return None;
        }
        let columns = schema.tables(1)?.map(|table| Column::read(table?)).collect::<Option<_>>()?;
        Some(Header { columns })
    }

    /// Whether a file that was not named explicitly looks like points.
    pub(super) fn looks_like_points(&self) -> bool {
        names_coordinates(self.columns.iter().map(|column| &column.field.name[..]))
    }
}

impl Column {
    fn read(table: Table) -> Option<Self> {
        const INTEGER: u8 = 2;
        const FLOAT: u8 = 3;
        const TIMESTAMP: u8 = 10;
        const DURATION: u8 = 18;
        const DICTIONARY: usize = 4;
        let ([kind], properties) = (table.number(2)?, table.table(3)?);
        let scalar = match kind {
            _ if table.place(DICTIONARY).is_some() => return None,
            INTEGER => {
                let is_signed = properties.number(1) == Some([1]);
                match (i32::from_le_bytes(properties.number(0)?), is_signed) {
                    (8, false) => ScalarType::U8,
                    (8, true) => ScalarType::I8,
                    (16, false) => ScalarType::U16,
                    (16, true) => ScalarType::I16,
                    (32, false) => ScalarType::U32,
                    (32, true) => ScalarType::I32,
                    (64, false) => ScalarType::U64,
                    (64, true) => ScalarType::I64,
                    _ => return None,
                }
            }
            FLOAT => match properties.number(0).map_or(0, i16::from_le_bytes) {
                0 => ScalarType::U16,
                1 => ScalarType::F32,
                2 => ScalarType::F64,
                _ => return None,
            },
            TIMESTAMP | DURATION => ScalarType::I64,
            _ => return None,
        };
        let name = name_of(&with_underscores(table.text(0).unwrap_or_default()));
        let is_half = kind == FLOAT && scalar == ScalarType::U16;
        Some(Column { field: Field { name, scalar, count: 1 }, is_half })
    }
}

/// Splits a file. Its prefix is the file without the bodies of the record batches, with zeros in place of the
/// numbers that follow from them. `None` if the file has other parts, missing values, or another compression,
/// or if it unfolds to far more than a scan does.
pub(super) fn parse(bytes: &[u8]) -> Option<ScanFile> {
    /// The bytes of all values are at most this, and this multiple of the file's: scans take about twice as
    /// many.
    const FREE: usize = 1 << 20;
    const MOST_UNFOLDED: usize = 32;
    let most = bytes.len().checked_mul(MOST_UNFOLDED)?.checked_add(FREE)?;
    let columns = Header::parse(bytes)?.columns;
    let batches = batches(bytes, columns.len())?;
    let mut planes = vec![Vec::new(); columns.len()];
    let mut is_wide = true;
    let (mut records, mut unfolded) = (0, 0usize);
    for batch in &batches {
        let body = &bytes[batch.body..][..batch.length];
        for (number, (column, plane)) in columns.iter().zip(&mut planes).enumerate() {
            let place = batch.buffer(number);
            let [offset, length] = [place, place + 8].map(|place| size(bytes, place));
            let values = body.get(offset?..)?.get(..length?)?;
            let size = batch.records.checked_mul(column.field.width())?;
            unfolded = unfolded.checked_add(size).filter(|&size| size <= most)?;
            match batch.is_compressed && size > 0 {
                true => {
                    let frame = values.strip_prefix(&(size as u64).to_le_bytes())?;
                    plane.extend(lz4::decompress(frame, size)?);
                }
                false if values.len() == size => plane.extend_from_slice(values),
                false => return None,
            }
            is_wide &= offset?.is_multiple_of(alignment(true));
        }
        is_wide &= body.len().is_multiple_of(alignment(true));
        // A file without columns may claim any number.
        records = batch.records.checked_add(records)?;
    }
    let mut blank = bytes.to_vec();
    for place in batches.iter().flat_map(Batch::numbers) {
        blank[place..place + 8].fill(0);
    }
    let (mut prefix, mut taken) = (Vec::new(), 0);
    for batch in &batches {
        prefix.extend_from_slice(&blank[taken..batch.body]);
        taken = batch.body + batch.length;
    }
    prefix.extend_from_slice(&blank[taken..]);
    let fields: Vec<Field> = columns.iter().map(|column| column.field.clone()).collect();
    let halves: Vec<bool> = columns.iter().map(|column| column.is_half).collect();
    let (fields, widenings, body) = by_field::narrowed(&fields, &halves, &planes.concat())?;
    let layout = layout_of(fields, Wrapping::Arrow { is_wide, widenings })?;
    let (layout, cloud) = records::split(layout, &body);
    Some(ScanFile { layout, prefix, records, cloud, ..ScanFile::default() })
}

/// The file: its prefix, with the bodies of the batches and the numbers that follow from them.
///
/// # Errors
/// [`Error::Corrupt`] if the prefix is not that of such a file, which a damaged stream can cause.
pub(super) fn write(file: &ScanFile, is_wide: bool, widenings: &[Widening]) -> Result<Vec<u8>> {
    let wrong = || Error::corrupt("the messages of an Arrow file do not match its records");
    let widths = by_field::stored(&file.layout, widenings).map(|field| field.width()).collect::<Vec<_>>();
    let batches = batches(&file.prefix, widths.len()).ok_or_else(wrong)?;
    let values = by_field::write(&records::join(file)?, &file.layout, widenings)?;
    let mut prefix = file.prefix.clone();
    let mut put = |place: usize, number: usize| {
        LittleEndian::write_u64(&mut prefix[place..place + 8], number as u64);
    };
    let (mut bodies, mut before, mut first) = (Vec::new(), 0, 0usize);
    for batch in &batches {
        let end = first.checked_add(batch.records).filter(|&end| end <= file.records);
        let records = first..end.ok_or_else(wrong)?;
        let (mut body, mut rest) = (Vec::new(), &values[..]);
        for (number, width) in widths.iter().enumerate() {
            let (column, after) = rest.split_at(file.records * width);
            rest = after;
            let values = &column[records.start * width..records.end * width];
            let (offset, place) = (body.len(), batch.buffer(number));
            match batch.is_compressed && !values.is_empty() {
                true => {
                    body.extend((values.len() as u64).to_le_bytes());
                    body.extend(lz4::compress(values));
                }
                false => body.extend_from_slice(values),
            }
            let length = body.len() - offset;
            body.resize(body.len().next_multiple_of(alignment(is_wide)), 0);
            // Before the values, the bits that say which are missing: none.
            let numbers =
                [(place - PAIR, offset), (place - PAIR + 8, 0), (place, offset), (place + 8, length)];
            numbers.into_iter().for_each(|(place, number)| put(place, number));
            put(batch.nodes + PAIR * number, batch.records);
        }
        batch.body_length.into_iter().for_each(|place| put(place, body.len()));
        put(batch.block, batch.message + before);
        put(batch.block + BLOCK_LENGTH, body.len());
        before += body.len();
        first = records.end;
        bodies.push(body);
    }
    if first != file.records {
        return Err(wrong());
    }
    let mut out = Vec::with_capacity(prefix.len() + before);
    let mut taken = 0;
    for (batch, body) in batches.iter().zip(bodies) {
        out.extend_from_slice(&prefix[taken..batch.body]);
        out.extend(body);
        taken = batch.body;
    }
    out.extend_from_slice(&prefix[taken..]);
    Ok(out)
}

/// A prefix with another number of points; `None` if it is not the prefix of such a file.
pub(super) fn with_point_count(prefix: &[u8], points: usize) -> Option<Vec<u8>> {
    let batches = batches(prefix, Header::parse(prefix)?.columns.len())?;
    let mut out = prefix.to_vec();
    let mut rest = points;
    for (number, batch) in batches.iter().enumerate() {
        let is_last = number + 1 == batches.len();
        let records = if is_last { rest } else { rest.min(batch.records) };
        match batch.count {
            Some(place) => LittleEndian::write_u64(&mut out[place..place + 8], records as u64),
            None if records > 0 => return None,
            None => {}
        }
        rest -= records;
    }
    (rest == 0).then_some(out)
}

fn alignment(is_wide: bool) -> usize {
    if is_wide { 64 } else { 8 }
}

/// Bytes of two numbers: a node, which is the number of records and that of missing values; or a buffer,
/// which is an offset and a length.
const PAIR: usize = 16;
/// Bytes of a block, the footer's entry for a batch: the offset of its message, the size of the metadata and,
/// from this byte on, the length of the body.
const BLOCK: usize = BLOCK_LENGTH + 8;
const BLOCK_LENGTH: usize = 16;

/// A record batch: what its message says, and where the file has the numbers that follow from its body.
struct Batch {
    records: usize,
    is_compressed: bool,
    /// Offset of the message.
    message: usize,
    /// Offset of the body, and its length.
    body: usize,
    length: usize,
    /// The place of the number of records, if there is one.
    count: Option<usize>,
    /// The place of the body's length, if there is one.
    body_length: Option<usize>,
    /// The places of the first node and of the first buffer.
    nodes: usize,
    buffers: usize,
    columns: usize,
    /// The place of the block.
    block: usize,
}

/// The record batches of a file, or of its prefix; `None` if it has other messages but the schema, or missing
/// values.
fn batches(bytes: &[u8], columns: usize) -> Option<Vec<Batch>> {
    const BATCHES: usize = 3;
    let end = bytes.len().checked_sub(END)?;
    let footer = end.checked_sub(read_u32(bytes, end)? as usize)?;
    if bytes[end + 4..] != *MAGIC {
        return None;
    }
    let blocks = Table::root(bytes, footer)?.structs(BATCHES, BLOCK);
    let (blocks, count) = blocks.unwrap_or_default();
    let (mut batches, mut at) = (Vec::new(), START);
    while at < footer {
        let Some(message) = Message::at(bytes, at) else { break };
        let Some(table) = message.header(Message::BATCH) else {
            message.header(Message::SCHEMA)?;
            at = message.body;
            continue;
        };
        let block = blocks + BLOCK * batches.len();
        let batch = message.batch(table, columns, at, block)?;
        at = batch.body + batch.length;
        batches.push(batch);
    }
    let is_end = bytes.get(at..footer) == Some(&[CONTINUATION, [0; 4]].concat());
    (is_end && batches.len() == count).then_some(batches)
}

impl Batch {
    /// The place of the buffer with the values of a column; that of the bits which tell missing ones comes
    /// before.
    fn buffer(&self, column: usize) -> usize {
        self.buffers + PAIR * (2 * column + 1)
    }

    /// The places of the numbers that follow from the values: of 8 bytes each.
    fn numbers(&self) -> impl Iterator<Item = usize> {
        let nodes = (0..self.columns).map(|column| self.nodes + PAIR * column);
        let buffers = (0..4 * self.columns).map(|number| self.buffers + 8 * number);
        let blocks = [self.block, self.block + BLOCK_LENGTH];
        nodes.chain(buffers).chain(blocks).chain(self.body_length)
    }
}

/// Begins each message.
const CONTINUATION: [u8; 4] = [0xff; 4];

/// A message: its metadata, and the place of what follows them.
struct Message<'b> {
    metadata: Table<'b>,
    body: usize,
}

impl<'b> Message<'b> {
    // Kinds of messages.
    const SCHEMA: u8 = 1;
    const BATCH: u8 = 3;

    /// The message at this place; `None` if there is none, as at the end of all messages.
    fn at(bytes: &'b [u8], at: usize) -> Option<Self> {
        let rest = bytes.get(at..)?.strip_prefix(&CONTINUATION)?;
        let size = u32::from_le_bytes(*rest.first_chunk()?) as usize;
        let start = at + 8;
        let metadata = Table::root(bytes, start).filter(|_| (1..=rest.len() - 4).contains(&size))?;
        Some(Message { metadata, body: start + size })
    }

    /// What a message of this kind is about.
    fn header(&self, kind: u8) -> Option<Table<'b>> {
        self.metadata.table(2).filter(|_| self.metadata.number(1) == Some([kind]))
    }

    /// The batch that the message at `message` is about, given its table and the place of its block.
    fn batch(&self, table: Table, columns: usize, message: usize, block: usize) -> Option<Batch> {
        const LZ4: [u8; 1] = [0];
        let bytes = self.metadata.bytes;
        let (count, body_length) = (table.place(0), self.metadata.place(3));
        let number = |place: Option<usize>| place.map_or(Some(0), |place| size(bytes, place));
        let (records, length) = (number(count)?, number(body_length)?);
        let (nodes, buffers) = (table.structs(1, PAIR)?, table.structs(2, PAIR)?);
        let compression = table.table(3);
        let is_known = compression.is_none_or(|compression| compression.number(0).unwrap_or(LZ4) == LZ4);
        let is_none_missing = (0..columns).all(|column| {
            let missing = nodes.0 + PAIR * column + 8;
            let bits = buffers.0 + PAIR * 2 * column + 8;
            [missing, bits].iter().all(|&place| size(bytes, place) == Some(0))
        });
        bytes.get(self.body..)?.get(..length)?;
        bytes.get(block..block + BLOCK)?;
        let fits = nodes.1 == columns && buffers.1 == 2 * columns && is_known && is_none_missing;
        fits.then_some(Batch {
            records,
            is_compressed: compression.is_some(),
            message,
            body: self.body,
            length,
            count,
            body_length,
            nodes: nodes.0,
            buffers: buffers.0,
            columns,
            block,
        })
    }
}

/// A table of a FlatBuffer, at this place of the file. Fields are known by their numbers; one that has its
/// usual value may be left out.
#[derive(Clone, Copy)]
struct Table<'b> {
    bytes: &'b [u8],
    at: usize,
}

impl<'b> Table<'b> {
    /// The table that a FlatBuffer at this place begins with.
    fn root(bytes: &'b [u8], start: usize) -> Option<Self> {
        Table { bytes, at: start }.at_offset(start)
    }

    /// The table to which an offset at this place refers.
    fn at_offset(self, place: usize) -> Option<Self> {
        Some(Table { at: place.checked_add(read_u32(self.bytes, place)? as usize)?, ..self })
    }

    /// The place of a field; `None` if it is left out.
    fn place(&self, field: usize) -> Option<usize> {
        let offset = read_u32(self.bytes, self.at)? as i32;
        let fields = usize::try_from(i64::try_from(self.at).ok()? - i64::from(offset)).ok()?;
        let read_u16 = |place: usize| self.bytes.get(place..place + 2).map(LittleEndian::read_u16);
        let entry = 4 + 2 * field;
        let offset = read_u16(fields + entry).filter(|_| Some(entry) < read_u16(fields).map(usize::from))?;
        (offset > 0).then(|| self.at + usize::from(offset))
    }

    fn number<const SIZE: usize>(&self, field: usize) -> Option<[u8; SIZE]> {
        self.bytes.get(self.place(field)?..)?.first_chunk().copied()
    }

    fn table(&self, field: usize) -> Option<Self> {
        self.at_offset(self.place(field)?)
    }

    /// The place of the first of a list of items of this size, and their number.
    fn structs(&self, field: usize, item: usize) -> Option<(usize, usize)> {
        let list = self.table(field)?.at;
        let count = read_u32(self.bytes, list)? as usize;
        let first = list + 4;
        self.bytes.get(first..)?.get(..count.checked_mul(item)?)?;
        Some((first, count))
    }

    /// The tables of a list.
    fn tables(&self, field: usize) -> Option<impl Iterator<Item = Option<Self>>> {
        const OFFSET: usize = 4;
        let (first, count) = self.structs(field, OFFSET)?;
        let table = *self;
        Some((0..count).map(move |number| table.at_offset(first + OFFSET * number)))
    }

    fn text(&self, field: usize) -> Option<&'b str> {
        let (first, length) = self.structs(field, 1)?;
        std::str::from_utf8(&self.bytes[first..first + length]).ok()
    }
}

fn read_u32(bytes: &[u8], place: usize) -> Option<u32> {
    bytes.get(place..)?.first_chunk().map(|number| u32::from_le_bytes(*number))
}

/// A number of 64 bits that is a size.
fn size(bytes: &[u8], place: usize) -> Option<usize> {
    bytes.get(place..)?.first_chunk().and_then(|number| usize::try_from(u64::from_le_bytes(*number)).ok())
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::files::tests::comes_back;
    use crate::files::{parse, starts_as_scan_of_folder};

    /// 700 points in half precision, in batches of 400 and 300, compressed; as pyarrow writes them.
    const COMPRESSED: &[u8] = include_bytes!("../../testdata/vectors/pyarrow.lz4.feather");
    /// 50 points as doubles, and their times.
    const PLAIN: &[u8] = include_bytes!("../../testdata/vectors/pyarrow.plain.feather");

    /// The position of a point of either file.
    fn position(point: usize) -> [f32; 3] {
        let [x, y, z] = [point * 7919 % 1000, point * point % 500, point % 32].map(|v| v as f32);
        [x * 0.125, -y * 0.25, -1.5 + z * 0.0625]
    }

    /// A file of two batches, if there are more than three values, with these values.
    pub fn file_of(values: &[(f32, u16)]) -> Vec<u8> {
        let mut scan = parse("a.feather", COMPRESSED.to_vec());
        let fewer = with_point_count(&scan.prefix, 0).unwrap();
        let batches = batches(&fewer, 6).unwrap();
        scan.prefix = fewer;
        let first = values.len().min(3);
        for (batch, count) in batches.iter().zip([first, values.len() - first]) {
            let place = batch.count.unwrap();
            LittleEndian::write_u64(&mut scan.prefix[place..place + 8], count as u64);
        }
        let points: Vec<u32> = (0..values.len() as u32).collect();
        scan.cloud = scan.cloud.select(&points);
        scan.records = points.len();
        for ((position, intensity), (value, ring)) in
            scan.cloud.positions.iter_mut().zip(&mut scan.cloud.intensity).zip(values)
        {
            (*position, *intensity) = ([*value; 3], f32::from(ring % 256));
        }
        scan.to_bytes().unwrap()
    }

    #[test]
    fn batches_are_one_scan() {
        let scan = comes_back("315.feather", COMPRESSED.to_vec());
        assert_eq!((scan.records, scan.layout.position), (700, Some([0, 1, 2])));
        let half_or_not = [vec![Widening::Half; 3], vec![Widening::None; 3]].concat();
        assert_eq!(scan.layout.wrapping, Wrapping::Arrow { is_wide: false, widenings: half_or_not });
        for point in [0, 1, 399, 400, 699] {
            assert_eq!(scan.cloud.positions[point], position(point), "{point}");
            assert_eq!(scan.cloud.intensity[point], (point / 9 % 200) as f32);
            assert_eq!(scan.cloud.channel("laser_number").unwrap().value(point), [(point % 32) as u8]);
            let time = (point / 32 * 55296) as i32;
            assert_eq!(scan.cloud.channel("offset_ns").unwrap().value(point), time.to_le_bytes());
        }
        let scan = comes_back("315.arrow", PLAIN.to_vec());
        assert_eq!((scan.records, scan.cloud.positions[49]), (50, position(49)));
        let Wrapping::Arrow { widenings, .. } = &scan.layout.wrapping else { panic!("{scan:?}") };
        assert_eq!(widenings[..3], [Widening::Exact; 3]);
        assert_eq!(scan.cloud.channel("time").unwrap().field.scalar, ScalarType::I64);
        assert_eq!(scan.cloud.intensity[49], 147.0);
    }

    #[test]
    fn what_follows_from_the_values_is_not_in_the_prefix() {
        let [scan, same] = [0, 1].map(|n| {
            let values: Vec<_> = (0..20).map(|at| (at as f32, at * n)).collect();
            parse("a.feather", file_of(&values))
        });
        assert_eq!((scan.records, &scan.prefix), (20, &same.prefix));
        assert!(scan.prefix.len() + 700 < COMPRESSED.len());
    }

    #[test]
    fn points_may_be_fewer_or_more() {
        for points in [0, 1, 399, 400, 401, 699, 700] {
            let mut scan = parse("a.feather", COMPRESSED.to_vec());
            scan.cloud = scan.cloud.select(&(0..points).collect::<Vec<u32>>());
            scan.records = points as usize;
            assert!(points == 700 || scan.to_bytes().is_err(), "{points}");
            scan.prefix = crate::files::with_point_count(&scan.prefix, scan.records);
            let back = comes_back("a.feather", scan.to_bytes().unwrap());
            assert_eq!(back.records, scan.records);
            assert_eq!(back.cloud.positions, scan.cloud.positions);
        }
    }

    #[test]
    fn what_unfolds_to_far_more_than_a_scan_is_opaque() {
        let zeros = |count: usize| {
            let mut scan = parse("a.feather", COMPRESSED.to_vec());
            scan.prefix = crate::files::with_point_count(&scan.prefix, count);
            scan.records = count;
            scan.cloud.positions = vec![[0.0; 3]; count];
            scan.cloud.intensity = vec![0.0; count];
            scan.cloud
                .channels
                .iter_mut()
                .for_each(|channel| channel.bytes = vec![0; count * channel.field.width()]);
            comes_back("a.feather", scan.to_bytes().unwrap())
        };
        assert_eq!(zeros(5000).records, 5000);
        assert!(zeros(200_000).is_opaque());
    }

    #[test]
    fn only_tables_with_coordinates_are_scans_of_a_folder() {
        assert!(starts_as_scan_of_folder("1.feather", &COMPRESSED[..600]));
        let at = COMPRESSED.windows(2).position(|bytes| bytes == [b'x', 0]).unwrap();
        let other = [&COMPRESSED[..at], b"t", &COMPRESSED[at + 1..]].concat();
        assert!(!starts_as_scan_of_folder("1.feather", &other));
        assert_eq!(comes_back("1.feather", other).layout.position, None);
        assert!(!starts_as_scan_of_folder("1.feather", b"FEA1"));
    }

    #[test]
    fn other_files_are_opaque() {
        for bytes in [COMPRESSED, PLAIN] {
            for end in (0..bytes.len()).step_by(7) {
                assert!(comes_back("a.feather", bytes[..end].to_vec()).is_opaque(), "{end}");
            }
            assert!(comes_back("a.feather", [bytes, &[0]].concat()).is_opaque());
        }
        // Whatever byte is another one, the file comes back; and no damage of a prefix makes a writer panic.
        let scan = parse("a.feather", COMPRESSED.to_vec());
        for at in 0..COMPRESSED.len() {
            for bit in [0, 3, 7] {
                let mut other = COMPRESSED.to_vec();
                other[at] ^= 1 << bit;
                comes_back("a.feather", other);
                let mut damaged = scan.clone();
                if let Some(byte) = damaged.prefix.get_mut(at) {
                    *byte ^= 1 << bit;
                    drop(damaged.to_bytes());
                    drop(with_point_count(&damaged.prefix, 5));
                }
            }
        }
    }
}
