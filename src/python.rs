//! The extension module `lidarpc._native`: a thin layer over the library. Its public interface and
//! documentation are in `python/lidarpc`.
//!
//! Points are coded without the interpreter's lock. Returned arrays are owned by the caller: their memory is
//! filled once, and handed over.

use std::ffi::OsString;
use std::fs::File;
use std::io::{self, Cursor, Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard};

use numpy::{Element, IntoPyArray, PyArray1, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::{PyException, PyKeyError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;
use pyo3::types::PyBytes;

use crate::files::POSITION;
use crate::ground::team::locked;
use crate::library::{Decoder, Encoder, FrameInfo, MessageEncoder, Scalar, Scan, Scans, Settings};
use crate::{Error, ScalarType, cli};

/// The module.
#[pymodule(name = "_native")]
mod native {
    #[pymodule_export]
    use super::{Frame, FrameEncoder, FrameIterator, StreamReader, StreamWriter, decode_frame, main};
}

/// The error as a Python exception: its class tells whether the file or its contents are to blame, and its
/// message names the file and, if known, the frame. What a file object raised that is not about the file, such
/// as `KeyboardInterrupt`, is returned as it is.
fn raise(error: Error, file: &str, frame: Option<u64>) -> PyErr {
    let (frame, what) = error.about_frame(frame);
    let message = if file.is_empty() { what } else { format!("{file}: {what}") };
    Python::attach(|py| {
        let (class, cause) = match error {
            Error::Io(error) => ("InputError", Some(PyErr::from(error))),
            _ => ("Error", None),
        };
        if let Some(cause) = cause.as_ref().filter(|cause| !cause.is_instance_of::<PyException>(py)) {
            return cause.clone_ref(py);
        }
        let raised = (|| -> PyResult<PyErr> {
            let class = py.import("lidarpc._errors")?.getattr(class)?;
            let file = (!file.is_empty()).then_some(file);
            Ok(PyErr::from_value(class.call1((message, file, frame))?))
        })();
        let raised = raised.unwrap_or_else(|error| error);
        raised.set_cause(py, cause);
        raised
    })
}

/// A value that may have threads of its own, which a forked process lacks. There it is neither used nor dropped:
/// both could wait forever for such a thread, or for a lock that one held.
struct OfProcess<T> {
    /// None only while it is dropped.
    value: Option<Mutex<T>>,
    process: u32,
}

impl<T> OfProcess<T> {
    fn new(value: T) -> Self {
        OfProcess { value: Some(Mutex::new(value)), process: std::process::id() }
    }

    fn is_inherited(&self) -> bool {
        self.process != std::process::id()
    }

    /// The value; an error about `what` in a forked process.
    fn lock(&self, what: &str) -> Result<MutexGuard<'_, T>, Error> {
        let value = self.value.as_ref().filter(|_| !self.is_inherited());
        let inherited = || {
            Error::Usage(format!("{what} before this process was forked: begin a new one in this process"))
        };
        value.map(locked).ok_or_else(inherited)
    }
}

impl<T> Drop for OfProcess<T> {
    fn drop(&mut self) {
        if self.is_inherited() {
            std::mem::forget(self.value.take());
        }
    }
}

/// The source of a stream's bytes.
enum Source {
    File(File),
    Bytes(PyBackedBytes),
    /// An object with a method `read_at(start, length)`, which returns that many bytes, or fewer at the end.
    Object(Py<PyAny>),
}

impl Source {
    fn read_at(&self, start: u64, buffer: &mut [u8]) -> io::Result<usize> {
        match self {
            // Read at an explicit offset, not at the file's position, so that threads and forked processes
            // may share the file.
            #[cfg(unix)]
            Source::File(file) => std::os::unix::fs::FileExt::read_at(file, buffer, start),
            #[cfg(windows)]
            Source::File(file) => std::os::windows::fs::FileExt::seek_read(file, buffer, start),
            #[cfg(not(any(unix, windows)))]
            Source::File(mut file) => file.seek(SeekFrom::Start(start)).and_then(|_| file.read(buffer)),
            Source::Bytes(bytes) => {
                let place = usize::try_from(start).unwrap_or(usize::MAX).min(bytes.len());
                (&bytes[place..]).read(buffer)
            }
            Source::Object(object) => Ok(Python::attach(|py| -> PyResult<usize> {
                let piece = object.bind(py).call_method1("read_at", (start, buffer.len()))?;
                let piece: PyBackedBytes = piece.extract()?;
                let too_long = || PyValueError::new_err("read_at gave more than was asked for");
                buffer.get_mut(..piece.len()).ok_or_else(too_long)?.copy_from_slice(&piece);
                Ok(piece.len())
            })?),
        }
    }
}

/// A position in a source, which other positions share.
#[derive(Clone)]
struct Input {
    source: Arc<Source>,
    size: u64,
    place: u64,
}

impl Read for Input {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.source.read_at(self.place, buffer)?;
        self.place += count as u64;
        Ok(count)
    }
}

impl Seek for Input {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let place = match to {
            SeekFrom::Start(place) => Some(place),
            SeekFrom::End(offset) => self.size.checked_add_signed(offset),
            SeekFrom::Current(offset) => self.place.checked_add_signed(offset),
        };
        self.place = place.ok_or(io::ErrorKind::InvalidInput)?;
        Ok(self.place)
    }
}

/// A stream that is open for reading.
#[pyclass(frozen, module = "lidarpc._native")]
struct StreamReader {
    /// Is only cloned: it has no threads. As it is locked only with the interpreter's lock held, as forking does,
    /// it is free in a forked process.
    index: Mutex<Decoder<Input>>,
    /// Decodes frames by number, in the process that used it last; locked as `index` is.
    decoder: Mutex<Arc<OfProcess<Decoder<Input>>>>,
    /// Its name in errors.
    name: String,
    len: u64,
}

#[pymethods]
impl StreamReader {
    /// Opens a file at a path, bytes, or an object with `size` and `read_at(start, length)`.
    #[new]
    #[pyo3(signature = (source, name, threads, range_images))]
    fn new(
        py: Python<'_>,
        source: &Bound<'_, PyAny>,
        name: String,
        threads: usize,
        range_images: bool,
    ) -> PyResult<Self> {
        let (source, size) = if let Ok(path) = source.extract::<std::path::PathBuf>() {
            // Python's own exception names the path.
            let file = File::open(&path).map_err(|error| match error.raw_os_error() {
                Some(number) => pyo3::exceptions::PyOSError::new_err((number, error.to_string(), path)),
                None => error.into(),
            })?;
            let size = file.metadata()?.len();
            (Source::File(file), size)
        } else if let Ok(bytes) = source.extract::<PyBackedBytes>() {
            let size = bytes.len() as u64;
            (Source::Bytes(bytes), size)
        } else {
            (Source::Object(source.clone().unbind()), source.getattr("size")?.extract()?)
        };
        let input = Input { source: Arc::new(source), size, place: 0 };
        let decoder = py.detach(|| Decoder::open(input)).map_err(|error| raise(error, &name, None))?;
        let decoder = decoder.with_threads(threads).with_range_images(range_images);
        let len = decoder.len();
        let by_number = Mutex::new(Arc::new(OfProcess::new(decoder.clone())));
        Ok(StreamReader { index: Mutex::new(decoder), decoder: by_number, name, len })
    }

    fn __len__(&self) -> usize {
        self.len as usize
    }

    /// The time of each frame in nanoseconds since 1970; the smallest int64 if it has none.
    fn times<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<i64>> {
        let decoder = self.clone_decoder(py);
        let time = |frame: FrameInfo| frame.time.unwrap_or(i64::MIN);
        let times: Vec<i64> = py.detach(|| decoder.frames().map(time).collect());
        times.into_pyarray(py)
    }

    /// The first frame of each group, and the number of frames.
    fn groups(&self, py: Python<'_>) -> Vec<u64> {
        let decoder = self.clone_decoder(py);
        py.detach(|| decoder.group_borders())
    }

    /// The name of each frame; empty for frames of damaged groups. Reads the whole stream, but decodes nothing.
    fn names(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        let mut decoder = self.clone_decoder(py);
        let names = py.detach(|| match names_of(&mut decoder, 0..self.len) {
            Err(error) if !matches!(error, Error::Io(_)) => {
                // Group by group, as only some are damaged. This takes more requests.
                let borders = decoder.group_borders();
                let mut names = Vec::new();
                for (&start, &end) in borders.iter().zip(&borders[1..]) {
                    match names_of(&mut decoder, start..end) {
                        Err(error @ Error::Io(_)) => return Err(error),
                        Err(_) => names.extend((start..end).map(|_| String::new())),
                        Ok(group) => names.extend(group),
                    }
                }
                Ok(names)
            }
            whole => whole,
        });
        names.map_err(|error| raise(error, &self.name, None))
    }

    /// The frame with this number.
    fn frame(&self, py: Python<'_>, number: u64) -> PyResult<Frame> {
        let decoder = {
            let mut decoder = locked(&self.decoder);
            if decoder.is_inherited() {
                *decoder = Arc::new(OfProcess::new(self.clone_decoder(py)));
            }
            Arc::clone(&decoder)
        };
        let scan = py.detach(|| decoder.lock("the drive was opened")?.scan(number));
        let scan = scan.map_err(|error| raise(error, &self.name, Some(number)))?;
        Ok(Frame { scan, number })
    }

    /// These frames in order, decoded ahead.
    fn frames(&self, py: Python<'_>, start: u64, end: u64) -> FrameIterator {
        let decoder = self.clone_decoder(py);
        let scans = py.detach(|| decoder.into_scans(start..end));
        FrameIterator { state: OfProcess::new((scans, start)), name: self.name.clone() }
    }
}

impl StreamReader {
    /// A decoder without threads; `_py` shows that the interpreter's lock is held.
    fn clone_decoder(&self, _py: Python<'_>) -> Decoder<Input> {
        locked(&self.index).clone()
    }
}

fn names_of(decoder: &mut Decoder<Input>, frames: Range<u64>) -> Result<Vec<String>, Error> {
    Ok(decoder.details(frames)?.into_iter().map(|frame| frame.name).collect())
}

/// Frames in order.
#[pyclass(frozen, module = "lidarpc._native")]
struct FrameIterator {
    /// The scans, and the number of the next.
    state: OfProcess<(Scans<'static>, u64)>,
    name: String,
}

#[pymethods]
impl FrameIterator {
    fn __iter__(this: PyRef<'_, Self>) -> PyRef<'_, Self> {
        this
    }

    fn __next__(&self, py: Python<'_>) -> PyResult<Option<Frame>> {
        let next = py.detach(|| {
            let (scans, next) = &mut *self.state.lock("the iteration was begun")?;
            let number = *next;
            *next += 1;
            Ok((scans.next(), number))
        });
        let (scan, number) = next.map_err(|error| raise(error, &self.name, None))?;
        let scan = scan.transpose().map_err(|error| raise(error, &self.name, Some(number)))?;
        Ok(scan.map(|scan| Frame { scan, number }))
    }
}

/// A decoded frame.
#[pyclass(frozen, module = "lidarpc._native")]
struct Frame {
    scan: Scan,
    number: u64,
}

/// Calls a function with the Rust type of a channel's values.
macro_rules! with_type {
    ($scalar:expr, $call:ident ( $($argument:expr),* )) => {
        match $scalar {
            ScalarType::I8 => $call::<i8>($($argument),*),
            ScalarType::U8 => $call::<u8>($($argument),*),
            ScalarType::I16 => $call::<i16>($($argument),*),
            ScalarType::U16 => $call::<u16>($($argument),*),
            ScalarType::I32 => $call::<i32>($($argument),*),
            ScalarType::U32 => $call::<u32>($($argument),*),
            ScalarType::I64 => $call::<i64>($($argument),*),
            ScalarType::U64 => $call::<u64>($($argument),*),
            ScalarType::F32 => $call::<f32>($($argument),*),
            ScalarType::F64 => $call::<f64>($($argument),*),
        }
    };
}

/// The values of a channel: (points,), or (points, count) if there are several for each.
fn array_of<'py, T: Scalar + Element>(
    py: Python<'py>,
    scan: &Scan,
    name: &str,
    count: usize,
) -> PyResult<Bound<'py, PyAny>> {
    let values = scan.channel::<T>(name).map_err(|error| raise(error, "", None))?;
    let array = values.to_vec().into_pyarray(py);
    if count == 1 { Ok(array.into_any()) } else { Ok(array.reshape([scan.len(), count])?.into_any()) }
}

#[pymethods]
impl Frame {
    #[getter]
    fn number(&self) -> u64 {
        self.number
    }

    #[getter]
    fn name(&self) -> &str {
        self.scan.name()
    }

    #[getter]
    fn time(&self) -> Option<i64> {
        self.scan.time()
    }

    #[getter]
    fn track(&self) -> u8 {
        self.scan.track()
    }

    fn __len__(&self) -> usize {
        self.scan.len()
    }

    #[getter]
    fn fields(&self) -> Vec<String> {
        let position = POSITION.into_iter().filter(|_| self.scan.has_positions());
        // A file may have a second field named x, which `[]` does not return.
        let is_other = |name: &&str| !(self.scan.has_positions() && POSITION.contains(name));
        let others = self.scan.channels().map(|channel| channel.name).filter(is_other);
        position.chain(others).map(str::to_owned).collect()
    }

    fn __contains__(&self, name: &str) -> bool {
        self.fields().iter().any(|field| field == name)
    }

    /// None if the file does not store x, y and z as float32.
    fn positions<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        if !self.scan.has_positions() {
            return Ok(None);
        }
        let positions = self.scan.positions().as_flattened().to_vec();
        Ok(Some(positions.into_pyarray(py).reshape([self.scan.len(), 3])?.into_any()))
    }

    fn __getitem__<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        let axis = POSITION.into_iter().position(|axis| axis == name);
        if let Some(axis) = axis.filter(|_| self.scan.has_positions()) {
            let column: Vec<f32> = self.scan.positions().iter().map(|position| position[axis]).collect();
            return Ok(column.into_pyarray(py).into_any());
        }
        let channel = self.scan.channels().find(|channel| channel.name == name).ok_or_else(|| {
            PyKeyError::new_err(format!("no field {name:?}; there are {}", self.fields().join(", ")))
        })?;
        with_type!(channel.scalar, array_of(py, &self.scan, name, channel.count as usize))
    }

    #[getter]
    fn data<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyBytes>>> {
        let bytes =
            py.detach(|| self.scan.file_bytes()).map_err(|error| raise(error, "", Some(self.number)))?;
        Ok(bytes.map(|bytes| PyBytes::new(py, &bytes)))
    }

    /// Ranges in metres, or None.
    fn ranges<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let image = self.scan.range_image();
        let array = |image: &crate::RangeImage| {
            image.ranges().to_vec().into_pyarray(py).reshape([image.rows(), image.columns()])
        };
        Ok(image.map(array).transpose()?.map(Bound::into_any))
    }

    /// The point of each cell, -1 for cells without one; or None.
    fn cells<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let image = self.scan.range_image();
        let array = |image: &crate::RangeImage| {
            let points: Vec<i32> =
                image.points().iter().map(|point| point.map_or(-1, |point| point as i32)).collect();
            points.into_pyarray(py).reshape([image.rows(), image.columns()])
        };
        Ok(image.map(array).transpose()?.map(Bound::into_any))
    }

    fn __repr__(&self) -> String {
        let (name, number, points) = (self.scan.name(), self.number, self.scan.len());
        format!("<lidarpc.Frame {number} {name:?}: {points} points, fields {}>", self.fields().join(" "))
    }
}

/// A scan from arrays: positions (n, 3), and fields of n values.
fn scan_of(
    positions: &PyReadonlyArray2<'_, f32>,
    fields: &[(String, Bound<'_, PyAny>)],
    name: &str,
    time: Option<i64>,
    track: u8,
) -> PyResult<Scan> {
    let (positions, rest) = positions.as_slice()?.as_chunks::<3>();
    if !rest.is_empty() {
        return Err(PyValueError::new_err("xyz must have 3 columns"));
    }
    let mut scan = Scan::from_positions(positions).with_name(name).with_track(track);
    if let Some(time) = time {
        scan = scan.with_time(time);
    }
    fields.iter().try_fold(scan, |scan, (name, values)| with_field(scan, name, values))
}

/// The scan with an additional channel.
fn with_field(scan: Scan, name: &str, values: &Bound<'_, PyAny>) -> PyResult<Scan> {
    macro_rules! first_of {
        ($($scalar:ident)*) => {
            $(if let Ok(values) = values.extract::<PyReadonlyArray1<'_, $scalar>>() {
                return scan.with_channel(name, values.as_slice()?).map_err(|error| raise(error, "", None));
            })*
        };
    }
    first_of!(f32 u8 u16 f64 i8 i16 i32 u32 i64 u64);
    let kind = values.getattr("dtype")?;
    let known = "integers of 8 to 64 bits, float32 and float64";
    Err(PyTypeError::new_err(format!("field {name:?} is {kind}: fields are {known}")))
}

/// The settings with these values.
fn settings(
    level: u8,
    max_error: Option<f64>,
    intensity_step: Option<f64>,
    threads: usize,
    group: Option<usize>,
) -> Settings {
    let mut settings =
        max_error.map_or_else(Settings::exact, Settings::bounded).with_level(level).with_threads(threads);
    if let Some(step) = intensity_step {
        settings = settings.with_intensity_step(step);
    }
    match group {
        Some(group) => settings.with_group_of_pictures(group),
        None => settings,
    }
}

/// An output that calls a Python function.
struct Output(Py<PyAny>);

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        Python::attach(|py| self.0.call1(py, (PyBytes::new(py, bytes),)).map(drop))?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A stream that is being written.
#[pyclass(frozen, module = "lidarpc._native")]
struct StreamWriter {
    /// None once it is finished.
    encoder: OfProcess<Option<Encoder<Output>>>,
    name: String,
}

#[pymethods]
impl StreamWriter {
    /// Writes to a function that takes bytes.
    #[new]
    #[pyo3(signature = (write, name, level, max_error, intensity_step, threads, group))]
    fn new(
        write: Py<PyAny>,
        name: String,
        level: u8,
        max_error: Option<f64>,
        intensity_step: Option<f64>,
        threads: usize,
        group: Option<usize>,
    ) -> PyResult<Self> {
        let settings = settings(level, max_error, intensity_step, threads, group);
        let encoder = Encoder::new(Output(write), settings).map_err(|error| raise(error, &name, None))?;
        Ok(StreamWriter { encoder: OfProcess::new(Some(encoder)), name })
    }

    fn push(
        &self,
        py: Python<'_>,
        positions: PyReadonlyArray2<'_, f32>,
        fields: Vec<(String, Bound<'_, PyAny>)>,
        name: &str,
        time: Option<i64>,
        track: u8,
    ) -> PyResult<()> {
        self.push_scan(py, scan_of(&positions, &fields, name, time, track)?)
    }

    fn push_file(
        &self,
        py: Python<'_>,
        name: &str,
        data: Vec<u8>,
        time: Option<i64>,
        track: u8,
    ) -> PyResult<()> {
        let scan = Scan::from_file(name, data).with_track(track);
        self.push_scan(py, if let Some(time) = time { scan.with_time(time) } else { scan })
    }

    /// Number of scans and of points, bytes of the scans, bytes of the stream.
    fn finish(&self, py: Python<'_>) -> PyResult<(u64, u64, u64, u64)> {
        let summary = py.detach(|| self.encoder.lock(OPENED)?.take().ok_or_else(finished)?.finish());
        let summary = summary.map_err(|error| raise(error, &self.name, None))?;
        Ok((summary.scans, summary.points, summary.scan_bytes, summary.stream_bytes))
    }
}

/// What is inherited, if an encoder is.
const OPENED: &str = "the encoder was opened";

impl StreamWriter {
    fn push_scan(&self, py: Python<'_>, scan: Scan) -> PyResult<()> {
        let pushed = py.detach(|| self.encoder.lock(OPENED)?.as_mut().ok_or_else(finished)?.push(scan));
        pushed.map_err(|error| raise(error, &self.name, None))
    }
}

fn finished() -> Error {
    Error::Usage("the encoder is closed".to_owned())
}

/// Encodes each frame as a stream of its own.
#[pyclass(frozen, module = "lidarpc._native")]
struct FrameEncoder {
    encoder: Mutex<MessageEncoder>,
}

#[pymethods]
impl FrameEncoder {
    #[new]
    #[pyo3(signature = (level, max_error, intensity_step))]
    fn new(level: u8, max_error: Option<f64>, intensity_step: Option<f64>) -> PyResult<Self> {
        let settings = settings(level, max_error, intensity_step, 1, Some(1));
        let encoder = MessageEncoder::new(settings).map_err(|error| raise(error, "", None))?;
        Ok(FrameEncoder { encoder: Mutex::new(encoder) })
    }

    fn encode<'py>(
        &self,
        py: Python<'py>,
        positions: PyReadonlyArray2<'_, f32>,
        fields: Vec<(String, Bound<'_, PyAny>)>,
        time: Option<i64>,
    ) -> PyResult<Bound<'py, PyBytes>> {
        let scan = scan_of(&positions, &fields, "", time, 0)?;
        let encoded = py.detach(|| locked(&self.encoder).encode(scan));
        encoded.map(|stream| PyBytes::new(py, &stream)).map_err(|error| raise(error, "", None))
    }
}

/// The frame in such a stream.
#[pyfunction]
fn decode_frame(py: Python<'_>, payload: PyBackedBytes, range_images: bool) -> PyResult<Frame> {
    let scan = py.detach(|| {
        let mut decoder = Decoder::open(Cursor::new(&payload[..]))?.with_range_images(range_images);
        match decoder.len() {
            1 => decoder.scan(0),
            count => Err(Error::Usage(format!("a message holds one frame, and here are {count}"))),
        }
    });
    let scan = scan.map_err(|error| raise(error, "", None))?;
    Ok(Frame { scan, number: 0 })
}

/// The program: takes the arguments, starting with its name, and returns the exit code.
#[pyfunction]
fn main(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    py.detach(|| cli::main_of(arguments))
}
