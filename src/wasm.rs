//! The WebAssembly module of the npm package: the decoder behind functions called from JavaScript.
//! `js/index.js` is the other half and its only caller; the public interface and its documentation are there.
//!
//! One instance of the module decodes one stream. It does not read any input: a call that lacks bytes of the
//! stream returns [`WANTS`], and is repeated after [`lidarpc_supply`] has supplied
//! [them](lidarpc_wanted_start). The answer of a call is JSON text, and so is an error; arrays are given in
//! it as addresses in the module's memory, which are valid until the next call.

// Exported functions are unsafe to declare, as their names may clash. Nothing else here is unsafe.
#![allow(unsafe_code)]

use std::cell::RefCell;
use std::io::{self, Read, Seek, SeekFrom};
use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard};

use serde::Serialize;

use crate::ground::error::{Error, Result};
use crate::ground::team::locked;
use crate::library::{ChannelValues, Decoder, Scan};

/// The call succeeded; there is an answer.
const DONE: u32 = 0;
/// The call lacks bytes.
const WANTS: u32 = 1;
/// The call failed; the answer says why.
const FAILED: u32 = 2;

/// The state shared by the calls.
#[derive(Default)]
struct Module {
    /// The buffer to which JavaScript writes.
    inbox: Vec<u8>,
    input: Input,
    decoder: Option<Decoder<Input>>,
    /// The answer in JSON.
    answer: String,
    wanted: Range<u64>,
    /// The arrays to which the answer refers.
    given: Given,
}

/// Arrays that JavaScript copies.
#[derive(Default)]
struct Given {
    scan: Scan,
    cells: Vec<i32>,
    file: Vec<u8>,
}

thread_local! {
    static MODULE: RefCell<Module> = RefCell::default();
}

/// The bytes of a stream that were supplied.
#[derive(Default)]
struct SuppliedBytes {
    size: u64,
    /// The offset and the bytes of each piece.
    pieces: Vec<(u64, Vec<u8>)>,
    /// The range that the first failed read lacked.
    wanted: Option<Range<u64>>,
}

/// A position in the stream.
#[derive(Clone, Default)]
struct Input {
    pieces: Arc<Mutex<SuppliedBytes>>,
    place: u64,
}

impl Input {
    fn pieces(&self) -> MutexGuard<'_, SuppliedBytes> {
        locked(&self.pieces)
    }
}

impl Read for Input {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let mut pieces = self.pieces();
        let end = self.place.saturating_add(buffer.len() as u64).min(pieces.size);
        if self.place >= end {
            return Ok(0);
        }
        let here = pieces.pieces.iter().find_map(|(start, bytes)| {
            let place = usize::try_from(self.place.checked_sub(*start)?).ok()?;
            bytes.get(place..).filter(|bytes| !bytes.is_empty())
        });
        let Some(mut here) = here else {
            let wanted = self.place..end;
            pieces.wanted.get_or_insert(wanted);
            return Err(io::Error::other("bytes of the stream are not here yet"));
        };
        let count = here.read(buffer)?;
        drop(pieces);
        self.place += count as u64;
        Ok(count)
    }
}

impl Seek for Input {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let place = match to {
            SeekFrom::Start(place) => Some(place),
            SeekFrom::End(offset) => self.pieces().size.checked_add_signed(offset),
            SeekFrom::Current(offset) => self.place.checked_add_signed(offset),
        };
        self.place = place.ok_or(io::ErrorKind::InvalidInput)?;
        Ok(self.place)
    }
}

/// A failed call.
#[derive(Serialize)]
struct Failure {
    message: String,
    frame: Option<u64>,
}

impl Failure {
    /// An error message, which names the frame if it is known.
    fn new(error: &Error, frame: Option<u64>) -> Self {
        let (frame, message) = error.about_frame(frame);
        Failure { message, frame }
    }
}

/// The contents of the index.
#[derive(Serialize)]
struct Opened {
    frames: Vec<IndexedFrame>,
    /// The first frame of each group, and the number of frames.
    groups: Vec<u64>,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct IndexedFrame {
    number: u64,
    kind: &'static str,
    track: u8,
    /// Nanoseconds since 1970. As text, because JavaScript's numbers have 53 bits.
    time: Option<String>,
    coded_bytes: u64,
}

#[derive(Serialize)]
struct Details {
    number: u64,
    name: String,
    points: u64,
    bytes: u64,
}

/// An array in the module's memory.
#[derive(Serialize)]
struct Array {
    address: usize,
    bytes: usize,
}

impl Array {
    fn of<T>(values: &[T]) -> Self {
        Array { address: values.as_ptr().addr(), bytes: size_of_val(values) }
    }

    fn of_channel(values: &ChannelValues) -> Self {
        match values {
            ChannelValues::I8(values) => Array::of(values),
            ChannelValues::U8(values) => Array::of(values),
            ChannelValues::I16(values) => Array::of(values),
            ChannelValues::U16(values) => Array::of(values),
            ChannelValues::I32(values) => Array::of(values),
            ChannelValues::U32(values) => Array::of(values),
            ChannelValues::I64(values) => Array::of(values),
            ChannelValues::U64(values) => Array::of(values),
            ChannelValues::F32(values) => Array::of(values),
            ChannelValues::F64(values) => Array::of(values),
        }
    }
}

#[derive(Serialize)]
struct DecodedFrame<'s> {
    number: u64,
    name: &'s str,
    kind: &'static str,
    track: u8,
    /// As in [`IndexedFrame`].
    time: Option<String>,
    points: usize,
    /// x, y and z of each point, float32; empty if they are channels.
    positions: Array,
    fields: Vec<DecodedField<'s>>,
    image: Option<DecodedImage>,
    file: Option<Array>,
}

#[derive(Serialize)]
struct DecodedField<'s> {
    name: &'s str,
    scalar: &'static str,
    count: u32,
    values: Array,
}

#[derive(Serialize)]
struct DecodedImage {
    rows: usize,
    columns: usize,
    /// Ranges in metres, float32.
    ranges: Array,
    /// Points of the cells, int32.
    points: Array,
}

impl Module {
    /// Runs a call: returns its answer or its error, unless it lacks bytes.
    fn call(&mut self, frame: Option<u64>, work: impl FnOnce(&mut Self) -> Result<String>) -> u32 {
        self.given = Given::default();
        let worked = work(self);
        // The result of a call that lacked bytes is discarded.
        if let Some(wanted) = self.input.pieces().wanted.take() {
            self.wanted = wanted;
            return WANTS;
        }
        self.input.pieces().pieces.clear();
        let (answer, status) = match worked {
            Ok(answer) => (answer, DONE),
            Err(error) => (json(&Failure::new(&error, frame)), FAILED),
        };
        self.answer = answer;
        status
    }

    fn decoder(&mut self) -> Result<&mut Decoder<Input>> {
        self.decoder.as_mut().ok_or_else(|| Error::Usage("the stream is not open".to_owned()))
    }

    fn open(&mut self, size: u64, range_images: bool) -> Result<String> {
        self.input.pieces().size = size;
        let decoder = Decoder::open(self.input.clone())?.with_range_images(range_images);
        let frames = decoder.frames().map(|frame| IndexedFrame {
            number: frame.number,
            kind: frame.kind.name(),
            track: frame.track,
            time: frame.time.map(|time| time.to_string()),
            coded_bytes: frame.coded_bytes,
        });
        let opened = json(&Opened { frames: frames.collect(), groups: decoder.group_borders() });
        self.decoder = Some(decoder);
        Ok(opened)
    }

    fn details(&mut self, frames: Range<u64>) -> Result<String> {
        let details = self.decoder()?.details(frames)?.into_iter();
        let details: Vec<_> = details
            .map(|frame| Details {
                number: frame.number,
                name: frame.name,
                points: frame.points,
                bytes: frame.bytes,
            })
            .collect();
        Ok(json(&details))
    }

    fn frame(&mut self, number: u64, with_file: bool) -> Result<String> {
        let scan = self.decoder()?.scan(number)?;
        let file = if with_file { scan.file_bytes()? } else { None };
        let has_file = file.is_some();
        let cells = scan.range_image().map_or_else(Vec::new, |image| {
            image.points().iter().map(|point| point.map_or(-1, |point| point as i32)).collect()
        });
        self.given = Given { scan, cells, file: file.unwrap_or_default() };
        let Given { scan, cells, file } = &self.given;
        let fields = scan.channels().map(|channel| {
            Ok(DecodedField {
                name: channel.name,
                scalar: channel.scalar.name(),
                count: channel.count,
                values: Array::of_channel(scan.values(channel.name)?),
            })
        });
        let frame = DecodedFrame {
            number,
            name: scan.name(),
            kind: scan.kind().name(),
            track: scan.track(),
            time: scan.time().map(|time| time.to_string()),
            points: scan.len(),
            positions: Array::of(scan.positions()),
            fields: fields.collect::<Result<_>>()?,
            image: scan.range_image().map(|image| DecodedImage {
                rows: image.rows(),
                columns: image.columns(),
                ranges: Array::of(image.ranges()),
                points: Array::of(cells),
            }),
            file: has_file.then(|| Array::of(file)),
        };
        Ok(json(&frame))
    }

    fn scanners(&mut self) -> Result<String> {
        Ok(json(&self.decoder()?.scanners()?))
    }
}

/// Serialising numbers and names cannot fail.
fn json(value: &impl Serialize) -> String {
    serde_json::to_string(value).unwrap_or_default()
}

fn with_module<T>(work: impl FnOnce(&mut Module) -> T) -> T {
    MODULE.with_borrow_mut(work)
}

/// A buffer of `bytes` bytes, from which the next call of [`lidarpc_supply`] takes its bytes. Returns its
/// address.
#[unsafe(no_mangle)]
pub extern "C" fn lidarpc_room(bytes: usize) -> usize {
    with_module(|module| {
        module.inbox = vec![0; bytes];
        module.inbox.as_mut_ptr().expose_provenance()
    })
}

/// The bytes in the buffer are those of the stream from `start` on. They are kept until a call has all the
/// bytes that it wants.
#[unsafe(no_mangle)]
pub extern "C" fn lidarpc_supply(start: f64) {
    with_module(|module| {
        let bytes = std::mem::take(&mut module.inbox);
        module.input.pieces().pieces.push((start as u64, bytes));
    });
}

/// Offset of the first byte that the last call lacks.
#[unsafe(no_mangle)]
pub extern "C" fn lidarpc_wanted_start() -> f64 {
    with_module(|module| module.wanted.start as f64)
}

/// Offset after the last byte that it lacks.
#[unsafe(no_mangle)]
pub extern "C" fn lidarpc_wanted_end() -> f64 {
    with_module(|module| module.wanted.end as f64)
}

/// Address of the last answer, UTF-8.
#[unsafe(no_mangle)]
pub extern "C" fn lidarpc_answer() -> usize {
    with_module(|module| module.answer.as_ptr().addr())
}

/// Length of the last answer in bytes.
#[unsafe(no_mangle)]
pub extern "C" fn lidarpc_answer_bytes() -> usize {
    with_module(|module| module.answer.len())
}

/// Opens a stream of `size` bytes; with range images if `range_images` is not 0. The answer is [`Opened`].
#[unsafe(no_mangle)]
pub extern "C" fn lidarpc_open(size: f64, range_images: u32) -> u32 {
    with_module(|module| module.call(None, |module| module.open(size as u64, range_images != 0)))
}

/// The properties of the frames from `start` up to `end`; the answer is a list of [`Details`].
#[unsafe(no_mangle)]
pub extern "C" fn lidarpc_details(start: f64, end: f64) -> u32 {
    with_module(|module| module.call(None, |module| module.details(start as u64..end as u64)))
}

/// A description of each scanner; the answer is a list.
#[unsafe(no_mangle)]
pub extern "C" fn lidarpc_scanners() -> u32 {
    with_module(|module| module.call(None, Module::scanners))
}

/// Decodes a frame; the answer is a [`DecodedFrame`], with the bytes of its file if `with_file` is not 0.
#[unsafe(no_mangle)]
pub extern "C" fn lidarpc_frame(number: f64, with_file: u32) -> u32 {
    let number = number as u64;
    with_module(|module| module.call(Some(number), |module| module.frame(number, with_file != 0)))
}
