//! A frame coded as the bytes of its file by a general-purpose compressor: the fallback if no model pays.
//! FORMAT.md 8.18.

use crate::backend::{self, Compressors, STORE, Verdict, may_lzma_pay};
use crate::files::{parse, plain_file};
use crate::ground::error::{Error, Limits, Result};
use crate::ground::varint::{read_unsigned, write_unsigned};
use crate::scan::{Layout, ScanFile, Wrapping};

/// The bytes of a file, and their structure.
#[derive(Clone, Debug, Default)]
pub struct WholeFile {
    bytes: Vec<u8>,
    /// The layout of its records and the number of bytes before them, if they do not follow from its name.
    records: Option<(Layout, usize)>,
    /// The coded bytes.
    payload: Vec<u8>,
}

impl WholeFile {
    /// A file coded by a general-purpose compressor, if that takes fewer than `most` bytes. A slow one is
    /// tried only if it may, also judging by `verdict`: what that showed in an earlier frame, and then in this
    /// one.
    ///
    /// # Errors
    /// If the compressor's library fails.
    pub fn shorter(
        scan: &ScanFile,
        compressors: Compressors,
        most: usize,
        verdict: &mut Verdict,
    ) -> Result<Option<Self>> {
        /// Bytes of a sample. Less than four times as many are not sampled.
        const SAMPLE: usize = 64 << 10;
        let bytes = scan.to_bytes()?;
        let likeness = || Verdict::likeness(&bytes, scan.records);
        if verdict.has_lost(likeness) {
            return Ok(None);
        }
        let records = (scan.layout.wrapping == Wrapping::Plain && !scan.is_opaque())
            .then(|| (scan.layout.clone(), scan.prefix.len()));
        let sample = || {
            let is_large = bytes.len() >= 4 * SAMPLE;
            is_large.then(|| bytes[(bytes.len() - SAMPLE) / 2..][..SAMPLE].to_vec())
        };
        let coded = backend::shortest(&bytes, compressors, |quick| may_lzma_pay(quick, most, sample))?;
        // Files without points tell nothing about scans.
        if scan.records > 0 {
            *verdict = Verdict::of(coded.1.len(), most, likeness());
        }
        Ok(Some(WholeFile::coded(bytes, records, coded)).filter(|whole| whole.payload.len() < most))
    }

    /// A file that is not a scan. If a fast compressor cannot shorten it, as with pictures, it is stored.
    ///
    /// # Errors
    /// If the compressor's library fails.
    pub fn of_any_file(file: &ScanFile, compressors: Compressors) -> Result<Self> {
        /// The compression ratio of the fast compressor from which on no compressor is expected to help much.
        const COMPRESSED: f64 = 0.98;
        let bytes = file.to_bytes()?;
        let mut coded =
            backend::shortest(&bytes, compressors, |size| (size as f64) < COMPRESSED * bytes.len() as f64)?;
        if coded.1.len() >= bytes.len() {
            coded = (STORE, bytes.clone());
        }
        Ok(WholeFile::coded(bytes, None, coded))
    }

    /// A file coded by the back-end with this number.
    fn coded(bytes: Vec<u8>, records: Option<(Layout, usize)>, (backend, coded): (u8, Vec<u8>)) -> Self {
        let mut payload = vec![backend];
        let mut layout = Vec::new();
        records.iter().for_each(|(records, _)| records.write_to(&mut layout));
        write_unsigned(&mut payload, layout.len() as u64);
        payload.extend(layout);
        let prefix = records.as_ref().map_or(0, |(_, prefix)| *prefix);
        write_unsigned(&mut payload, prefix as u64);
        write_unsigned(&mut payload, bytes.len() as u64);
        payload.extend(coded);
        WholeFile { bytes, records, payload }
    }

    /// The payload of the section.
    pub fn payload(&self) -> &[u8] {
        &self.payload
    }

    /// Reads the payload of the section.
    ///
    /// # Errors
    /// If it is damaged, or the file exceeds the limits.
    pub fn from_payload(mut input: &[u8], limits: &Limits) -> Result<Self> {
        let damaged = || Error::corrupt("bytes: cut short");
        let payload = input.to_vec();
        let (&id, rest) = input.split_first().ok_or_else(damaged)?;
        input = rest;
        let layout_length = read_length(&mut input)?;
        let mut layout = input.split_off(..layout_length).ok_or_else(damaged)?;
        let records = if layout.is_empty() { None } else { Some(Layout::read_from(&mut layout)?) };
        if !layout.is_empty() {
            return Err(Error::corrupt("bytes: bytes left over behind the layout"));
        }
        let layout = records;
        if layout.as_ref().is_some_and(|layout| layout.wrapping != Wrapping::Plain) {
            return Err(Error::corrupt("bytes: the layout is not that of a plain file"));
        }
        let prefix = read_length(&mut input)?;
        let length = read_length(&mut input)?;
        Error::check_limit("bytes of the frame", length as u64, limits.file_bytes)?;
        let bytes = backend::decompress(backend::by_id(id)?, input, length)?;
        Ok(WholeFile { bytes, records: layout.map(|layout| (layout, prefix)), payload })
    }

    /// The scan in these bytes, with `records` records. If the file does not parse to that many, it is
    /// restored as plain bytes.
    ///
    /// # Errors
    /// If records with a stored layout are fewer.
    pub fn into_scan(self, name: &str, records: usize) -> Result<ScanFile> {
        let scan = match self.records {
            None => {
                let scan = parse(name, self.bytes);
                if scan.records == records { scan } else { ScanFile::opaque(name, scan.to_bytes()?) }
            }
            Some((layout, prefix)) => {
                let scan = plain_file(layout, &self.bytes, prefix, records as u64);
                let scan = scan.filter(|scan| scan.records == records);
                scan.ok_or_else(|| Error::corrupt("bytes: fewer points than the frame's header says"))?
            }
        };
        Ok(ScanFile { name: name.to_owned(), ..scan })
    }
}

fn read_length(input: &mut &[u8]) -> Result<usize> {
    let length = read_unsigned(input, "bytes")?;
    usize::try_from(length).map_err(|_| Error::corrupt("bytes: number too large"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn comes_back(name: &str, bytes: &[u8]) {
        let scan = parse(name, bytes.to_vec());
        for compressors in [Compressors::Fast, Compressors::Slow, Compressors::All] {
            let whole =
                WholeFile::shorter(&scan, compressors, usize::MAX, &mut Verdict::Open).unwrap().unwrap();
            let (payload, limits) = (whole.payload().to_vec(), Limits::default());
            let decoded = WholeFile::from_payload(&payload, &limits).unwrap();
            let decoded = decoded.into_scan(name, scan.records).unwrap();
            assert_eq!(
                (&decoded.name, decoded.records, &decoded.layout),
                (&scan.name, scan.records, &scan.layout)
            );
            assert_eq!(decoded.to_bytes().unwrap(), bytes);
            let small = Limits { file_bytes: bytes.len() as u64 - 1, ..limits };
            assert!(WholeFile::from_payload(&payload, &small).is_err());
            for cut in 0..payload.len() {
                let cut = WholeFile::from_payload(&payload[..cut], &limits);
                assert!(cut.and_then(|whole| whole.into_scan(name, scan.records)).is_err());
            }
        }
    }

    #[test]
    fn files_of_all_kinds_come_back() {
        comes_back("1.bin", &[7; 70]);
        comes_back("1.txt", b"a b a b a b a b a b");
        let header = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 2\nHEIGHT 1\nPOINTS 2\n";
        comes_back("1.pcd", format!("{header}DATA ascii\n1 2 3\n4 5 6\n# more\n").as_bytes());
        comes_back("1.pcd", &[header.as_bytes(), b"DATA binary\n", &[1; 30]].concat());
    }
}
