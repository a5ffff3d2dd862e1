//! Reads a tar archive from a pipe: POSIX ustar and pax, and GNU's long names and large numbers. An archive
//! reader need be no more than this, but it must neither seek nor read ahead.

use std::io::{Read, copy, sink};

use super::arrival::{ArrivedFile, cut_short, read_file, refuse};
use crate::ground::error::Result;

/// Headers and files are padded to blocks of this many bytes.
const BLOCK: usize = 512;

/// The most bytes of a long name or of a pax header.
const MAX_EXTENSION: u64 = 1 << 20;

/// The name of the archive in errors.
const ARCHIVE: &str = "the archive";

/// Returns the regular files of an archive, one after the other.
pub(super) struct TarReader<R> {
    input: R,
    /// Bytes of padding that follow the file before.
    padding: u64,
}

/// What precedes a file's header and applies to it.
#[derive(Default)]
struct Extension {
    path: Option<String>,
    size: Option<u64>,
}

impl<R: Read> TarReader<R> {
    pub fn new(input: R) -> Self {
        TarReader { input, padding: 0 }
    }

    /// The next regular file, under its name without folders; `None` after the last.
    ///
    /// # Errors
    /// If the input fails, is cut short, or is no tar archive.
    pub fn next_file(&mut self) -> Result<Option<ArrivedFile>> {
        let mut extension = Extension::default();
        loop {
            let Some(header) = self.header()? else { return Ok(None) };
            let size = number(&header[124..136]).ok_or_else(damaged)?;
            match header[156] {
                b'L' => extension.path = Some(text(&self.extension(size)?)?),
                b'x' => extension.read_pax(&self.extension(size)?)?,
                b'0' | b'7' | 0 => {
                    let path = match extension.path.take() {
                        Some(path) => path,
                        None => ustar_path(&header)?,
                    };
                    let size = extension.size.take().unwrap_or(size);
                    // Before POSIX, a folder was a file whose name ended in a slash.
                    let name = path.rsplit('/').next().unwrap_or_default();
                    if !name.is_empty() {
                        let bytes = read_file(&mut self.input, name, size)?;
                        self.pad(size);
                        return Ok(Some(ArrivedFile { name: name.to_owned(), bytes }));
                    }
                    self.skip(size)?;
                    extension = Extension::default();
                }
                b'S' => return Err(refuse(ARCHIVE, "holds sparse files; make it without --sparse")),
                _ => {
                    self.skip(extension.size.take().unwrap_or(size))?;
                    if !matches!(header[156], b'g' | b'K') {
                        extension = Extension::default();
                    }
                }
            }
        }
    }

    /// The next header; `None` at the end, after which the rest is read, so that the writing program does not
    /// fail.
    fn header(&mut self) -> Result<Option<[u8; BLOCK]>> {
        self.discard(self.padding)?;
        self.padding = 0;
        let mut block = [0; BLOCK];
        self.input.read_exact(&mut block).map_err(|error| match error.kind() {
            std::io::ErrorKind::UnexpectedEof => cut_short(ARCHIVE),
            _ => error.into(),
        })?;
        if block == [0; BLOCK] {
            copy(&mut self.input, &mut sink())?;
            return Ok(None);
        }
        // The sum of all bytes, with those of the checksum itself counted as spaces.
        let sum = |bytes: &[u8]| bytes.iter().map(|byte| u64::from(*byte)).sum::<u64>();
        let computed = sum(&block[..148]) + 8 * u64::from(b' ') + sum(&block[156..]);
        if number(&block[148..156]) != Some(computed) {
            return Err(damaged());
        }
        Ok(Some(block))
    }

    /// The contents of a long name or a pax header.
    fn extension(&mut self, size: u64) -> Result<Vec<u8>> {
        if size > MAX_EXTENSION {
            return Err(damaged());
        }
        let bytes = read_file(&mut self.input, ARCHIVE, size)?;
        self.pad(size);
        Ok(bytes)
    }

    fn skip(&mut self, size: u64) -> Result<()> {
        self.pad(size);
        self.discard(size)
    }

    /// The padding is read together with the next header, as it may arrive only then.
    fn pad(&mut self, size: u64) {
        self.padding = size.wrapping_neg() % BLOCK as u64;
    }

    fn discard(&mut self, size: u64) -> Result<()> {
        match copy(&mut self.input.by_ref().take(size), &mut sink())? {
            skipped if skipped == size => Ok(()),
            _ => Err(cut_short(ARCHIVE)),
        }
    }
}

impl Extension {
    /// Reads records `LENGTH KEY=VALUE\n`, of which the path and the size are used.
    fn read_pax(&mut self, mut bytes: &[u8]) -> Result<()> {
        while !bytes.is_empty() {
            let space = bytes.iter().position(|&byte| byte == b' ').ok_or_else(damaged)?;
            let length = str::from_utf8(&bytes[..space]).ok().and_then(|text| text.parse().ok());
            let split = length.and_then(|length| bytes.split_at_checked(length)).ok_or_else(damaged)?;
            let record = split.0.get(space + 1..).and_then(|record| record.strip_suffix(b"\n"));
            let record = record.ok_or_else(damaged)?;
            if let Some(path) = record.strip_prefix(b"path=") {
                self.path = Some(text(path)?);
            } else if let Some(size) = record.strip_prefix(b"size=") {
                self.size = Some(text(size)?.parse().map_err(|_| damaged())?);
            }
            bytes = split.1;
        }
        Ok(())
    }
}

/// A number in octal digits or, if the top bit is set, in bytes, highest first.
fn number(field: &[u8]) -> Option<u64> {
    if let [0x80, bytes @ ..] = field {
        return bytes.iter().try_fold(0u64, |value, byte| Some(value.checked_mul(256)? + u64::from(*byte)));
    }
    let digits = str::from_utf8(field).ok()?.trim_matches(['\0', ' ']);
    if digits.is_empty() { Some(0) } else { u64::from_str_radix(digits, 8).ok() }
}

/// The path in a header, with ustar's prefix.
fn ustar_path(header: &[u8; BLOCK]) -> Result<String> {
    let name = text(&header[..100])?;
    match &header[257..265] {
        b"ustar\x0000" if header[345] != 0 => Ok(format!("{}/{name}", text(&header[345..500])?)),
        _ => Ok(name),
    }
}

/// Text up to the first zero byte.
fn text(bytes: &[u8]) -> Result<String> {
    let end = bytes.iter().position(|&byte| byte == 0).unwrap_or(bytes.len());
    let text = str::from_utf8(&bytes[..end]).map_err(|_| refuse(ARCHIVE, "holds a name that is not UTF-8"));
    Ok(text?.to_owned())
}

fn damaged() -> crate::ground::error::Error {
    refuse(ARCHIVE, "is damaged, or is no tar archive")
}
