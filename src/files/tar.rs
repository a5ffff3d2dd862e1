//! Reads the scans of a tar archive from a pipe.

use std::io::{ErrorKind, Read, Take, copy, sink};

use tar::{Archive, EntryType};

use super::arrival::{ArrivedFile, cut_short, read_file, refuse};
use super::sequence::{LeftOut, LeftOutKind};
use super::{SNIFFED_BYTES, is_scan_by_name, starts_as_scan_of_folder};
use crate::ground::error::{Error, Result};

/// Headers and files are padded to multiples of this many bytes.
const BLOCK: u64 = 512;

/// The largest size of a file's header together with its long name and pax records, in bytes.
const MAX_HEADER: u64 = 1 << 20;

/// The name of the archive in errors.
const ARCHIVE: &str = "the archive";

/// Returns the scans of an archive, one after the other.
pub(super) struct TarReader<R> {
    input: R,
    /// Bytes before the next header: the rest of the previous file's last block. They are read together with
    /// that header, as they may not arrive earlier.
    padding: u64,
    /// The folder of the first scan.
    folder: Option<String>,
    pub left_out: LeftOut,
}

/// The properties of a file that the archive gives before its bytes.
struct Header {
    path: String,
    kind: EntryType,
    size: u64,
}

impl<R: Read> TarReader<R> {
    pub fn new(input: R) -> Self {
        TarReader { input, padding: 0, folder: None, left_out: LeftOut::default() }
    }

    /// The next scan; `None` after the last. Scans of the first folder are named without it, others by their
    /// paths, so that drives in several folders do not collide. Hidden files, files not recognised as scans,
    /// and symbolic links are left out, like those of a folder.
    ///
    /// # Errors
    /// If the input fails, is cut short, or is not a tar archive; also if a scan is a hard link, since the
    /// bytes that it shares with an earlier file have gone by.
    pub fn next_scan(&mut self) -> Result<Option<ArrivedFile>> {
        while let Some(Header { path, kind, size }) = self.next_header()? {
            self.padding = size.wrapping_neg() % BLOCK;
            // Before POSIX, a folder was stored as a file whose name ended in a slash.
            let (folder, name) = path.rsplit_once('/').unwrap_or(("", &path));
            let is_file = matches!(kind, EntryType::Regular | EntryType::Continuous);
            let is_hidden = name.starts_with('.');
            let mut start = Vec::new();
            let is_scan = match is_scan_by_name(name).filter(|_| !is_hidden) {
                Some(is_scan) => is_scan,
                None if is_hidden || !is_file => false,
                None => {
                    self.input.by_ref().take(size.min(SNIFFED_BYTES)).read_to_end(&mut start)?;
                    starts_as_scan_of_folder(name, &start)
                }
            };
            match kind {
                EntryType::Regular | EntryType::Continuous if is_scan => {
                    let mut whole = start.as_slice().chain(&mut self.input);
                    let bytes = read_file(&mut whole, name, size)?;
                    let is_in_first = self.folder.get_or_insert_with(|| folder.to_owned()) == folder;
                    let name = if is_in_first { name } else { path.trim_start_matches("./") };
                    return Ok(Some(ArrivedFile { name: name.to_owned(), bytes }));
                }
                EntryType::Link if is_scan => {
                    let what = "is a hard link in the archive; make that with tar's --hard-dereference";
                    return Err(refuse(&path, what));
                }
                EntryType::Directory | EntryType::XGlobalHeader => {}
                _ if name.is_empty() => {}
                _ if name.starts_with('.') => self.left_out.add(LeftOutKind::Hidden, path, size),
                EntryType::Symlink => self.left_out.add(LeftOutKind::Link, path, 0),
                EntryType::Fifo | EntryType::Char | EntryType::Block => {
                    self.left_out.add(LeftOutKind::Special, path, 0);
                }
                _ => self.left_out.add(LeftOutKind::File, path, size),
            }
            self.discard(size - start.len() as u64)?;
        }
        Ok(None)
    }

    /// The next header; `None` at the end of the archive. Then the rest of the input is read too, so that the
    /// program that writes it does not fail.
    fn next_header(&mut self) -> Result<Option<Header>> {
        self.discard(self.padding)?;
        self.padding = 0;
        // The crate's archive reads a header with its extensions, and no byte more. A new one for each file
        // keeps the input under the control of this reader, which can limit the size of each header.
        let mut input = HeaderInput { input: self.input.by_ref().take(MAX_HEADER), is_cut_short: false };
        let header = read_header(&mut input);
        match header {
            Ok(None) if !input.is_cut_short => {
                copy(&mut self.input, &mut sink())?;
                Ok(None)
            }
            _ if input.is_cut_short => Err(cut_short(ARCHIVE)),
            header => header,
        }
    }

    fn discard(&mut self, size: u64) -> Result<()> {
        match copy(&mut self.input.by_ref().take(size), &mut sink())? {
            skipped if skipped == size => Ok(()),
            _ => Err(cut_short(ARCHIVE)),
        }
    }
}

fn read_header(input: impl Read) -> Result<Option<Header>> {
    let mut archive = Archive::new(input);
    let entry = archive.entries().and_then(|mut entries| entries.next().transpose());
    let Some(mut entry) = entry.map_err(damaged)? else { return Ok(None) };
    let (kind, size) = (entry.header().entry_type(), entry.size());
    let path = String::from_utf8(entry.path_bytes().into_owned());
    let path = path.map_err(|_| refuse(ARCHIVE, "holds a name that is not UTF-8"))?;
    let mut is_sparse = kind.is_gnu_sparse();
    if matches!(kind, EntryType::Regular | EntryType::Continuous)
        && let Some(records) = entry.pax_extensions().map_err(damaged)?
    {
        for record in records {
            // Otherwise the crate would use the header's own name or size.
            let record =
                record.map_err(|_| refuse(ARCHIVE, format!("holds odd pax records for {path:?}")))?;
            is_sparse |= record.key_bytes().starts_with(b"GNU.sparse.");
        }
    }
    if is_sparse {
        return Err(refuse(ARCHIVE, "holds sparse files; make it without --sparse"));
    }
    Ok(Some(Header { path, kind, size }))
}

/// The input of one header. It records whether it ends too early, for which the crate has no error.
struct HeaderInput<R> {
    input: Take<R>,
    is_cut_short: bool,
}

impl<R: Read> Read for HeaderInput<R> {
    fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
        let length = self.input.read(out)?;
        self.is_cut_short |= length == 0 && !out.is_empty() && self.input.limit() > 0;
        Ok(length)
    }
}

/// The crate's own errors are of kind `Other`.
fn damaged(error: std::io::Error) -> Error {
    match error.kind() {
        ErrorKind::Other => refuse(ARCHIVE, "is damaged, or is no tar archive"),
        _ => error.into(),
    }
}
