//! The sections of a frame, processed one after the other in the same order on both sides. FORMAT.md 2.6.

use super::stages::StageReport;
use crate::article::image_coding::ImageConfig;
use crate::backend::{Compressors, Level};
use crate::container::{Section, SectionKind, payload_bytes};
use crate::entropy::{
    ArithmeticDecoder, ArithmeticEncoder, BitCoder, TokenCoder, TokenReader, TokenTables, TokenWriter,
};
use crate::ground::clock::Instant;
use crate::ground::error::{Error, Limits, Result};
use crate::ground::team;

/// The effort of the coders of ranges, and their bit rate; unused by the decoder.
#[derive(Clone, Copy, Debug, Default)]
pub struct Effort {
    /// The effort of a general-purpose back-end.
    pub level: Level,
    /// The general-purpose compressors that may be tried in place of models.
    pub compressors: Compressors,
    /// The settings of an image coder.
    pub image: ImageConfig,
}

/// Processes the sections of a frame one after the other, for writing or for reading.
pub trait SectionCoder {
    /// True if the frame is complete and sections are written; false if sections are read and fill the frame.
    const ENCODES: bool;

    /// Codes the bits of a section.
    type Coder<'a>: BitCoder
    where
        Self: 'a;

    /// Codes one section with `code`. The section is left out if `present` is false.
    fn section<T: Default>(
        &mut self,
        kind: SectionKind,
        present: bool,
        code: impl FnOnce(&mut Self::Coder<'_>) -> Result<T>,
    ) -> Result<T>;

    /// Codes the tokens of a section.
    type Tokens<'a>: TokenCoder
    where
        Self: 'a;

    /// Codes one section as tokens in `contexts` contexts, with `code`.
    fn tokens<T>(
        &mut self,
        kind: SectionKind,
        contexts: usize,
        tables: &mut TokenTables,
        code: impl FnOnce(&mut Self::Tokens<'_>) -> T,
    ) -> Result<T>;

    /// Codes two consecutive parts of a frame, in parallel if a thread is free. The last section of the first
    /// part is of kind `last`.
    ///
    /// # Errors
    /// That of the first part, or else of the second.
    fn both<A: Send, B: Send>(
        &mut self,
        last: SectionKind,
        first: impl FnOnce(&mut Self) -> Result<A> + Send,
        second: impl FnOnce(&mut Self) -> Result<B> + Send,
    ) -> Result<(A, B)>;

    /// Codes a section whose payload is produced elsewhere. An absent section has an empty payload.
    fn payload(&mut self, kind: SectionKind, payload: &mut Vec<u8>);

    /// The largest sizes that this side allocates.
    fn limits(&self) -> &Limits;

    /// The effort; unused by the decoder.
    fn effort(&self) -> Effort;

    /// Time and size of each stage. The time of a section is added when it ends.
    fn report(&mut self) -> &mut StageReport;

    /// Bytes of the sections written so far; unused by the decoder.
    fn bytes_written(&self) -> usize;
}

/// Collects the sections of a frame.
pub struct SectionWriter {
    /// The sections so far.
    pub sections: Vec<Section>,
    limits: Limits,
    effort: Effort,
    /// Time and size of each stage.
    pub report: StageReport,
}

impl SectionWriter {
    /// A writer without any sections yet.
    pub fn new(effort: Effort) -> Self {
        SectionWriter {
            sections: Vec::new(),
            limits: Limits::default(),
            effort,
            report: StageReport::default(),
        }
    }
}

impl SectionCoder for SectionWriter {
    const ENCODES: bool = true;

    type Coder<'a> = ArithmeticEncoder;

    fn section<T: Default>(
        &mut self,
        kind: SectionKind,
        present: bool,
        code: impl FnOnce(&mut ArithmeticEncoder) -> Result<T>,
    ) -> Result<T> {
        if !present {
            return Ok(T::default());
        }
        let start = Instant::now();
        let mut coder = ArithmeticEncoder::default();
        let result = code(&mut coder)?;
        self.sections.push(Section { kind, payload: coder.finish() });
        self.report.took_section(kind, start);
        Ok(result)
    }

    type Tokens<'a> = TokenWriter;

    fn tokens<T>(
        &mut self,
        kind: SectionKind,
        contexts: usize,
        tables: &mut TokenTables,
        code: impl FnOnce(&mut TokenWriter) -> T,
    ) -> Result<T> {
        let start = Instant::now();
        let mut writer = TokenWriter::new(contexts);
        let result = code(&mut writer);
        self.sections.push(Section { kind, payload: writer.finish(tables)? });
        self.report.took_section(kind, start);
        Ok(result)
    }

    fn both<A: Send, B: Send>(
        &mut self,
        _last: SectionKind,
        first: impl FnOnce(&mut Self) -> Result<A> + Send,
        second: impl FnOnce(&mut Self) -> Result<B> + Send,
    ) -> Result<(A, B)> {
        let mut other = SectionWriter { limits: self.limits, ..SectionWriter::new(self.effort) };
        let (a, b) = team::both(|| first(self), || second(&mut other));
        self.sections.append(&mut other.sections);
        self.report.add(&other.report);
        Ok((a?, b?))
    }

    fn payload(&mut self, kind: SectionKind, payload: &mut Vec<u8>) {
        if !payload.is_empty() {
            self.sections.push(Section { kind, payload: payload.clone() });
        }
    }

    fn limits(&self) -> &Limits {
        &self.limits
    }

    fn effort(&self) -> Effort {
        self.effort
    }

    fn report(&mut self) -> &mut StageReport {
        &mut self.report
    }

    fn bytes_written(&self) -> usize {
        payload_bytes(&self.sections)
    }
}

/// Reads the sections of a frame one by one.
pub struct SectionReader<'s> {
    /// The remaining sections.
    sections: &'s [Section],
    limits: &'s Limits,
    report: StageReport,
}

impl<'s> SectionReader<'s> {
    /// Starts with the first section.
    pub fn new(sections: &'s [Section], limits: &'s Limits) -> Self {
        SectionReader { sections, limits, report: StageReport::default() }
    }

    /// The next section, after skipping skippable ones.
    fn peek(&mut self) -> Option<&'s Section> {
        while let [first, rest @ ..] = self.sections {
            if !first.kind.is_skippable() {
                return Some(first);
            }
            self.sections = rest;
        }
        None
    }

    /// The payload of the next section, if that is of this kind.
    fn next_if(&mut self, kind: SectionKind) -> Option<&'s [u8]> {
        let section = self.peek().filter(|section| section.kind == kind)?;
        self.sections = &self.sections[1..];
        Some(&section.payload)
    }

    /// The payload of the next section.
    fn next_payload(&mut self, kind: SectionKind) -> Result<&'s [u8]> {
        let missing = || Error::corrupt(format!("{kind} section is missing")).within_section(kind);
        self.next_if(kind).ok_or_else(missing)
    }

    /// The time of each stage.
    ///
    /// # Errors
    /// If sections are left over.
    pub fn finish(mut self) -> Result<StageReport> {
        match self.peek() {
            None => Ok(self.report),
            Some(Section { kind, .. }) => {
                Err(Error::corrupt(format!("{kind} section out of place")).within_section(*kind))
            }
        }
    }
}

fn ends_too_early(kind: SectionKind) -> Error {
    Error::corrupt(format!("{kind} section ends too early")).within_section(kind)
}

impl SectionCoder for SectionReader<'_> {
    const ENCODES: bool = false;

    type Coder<'a>
        = ArithmeticDecoder<'a>
    where
        Self: 'a;

    fn section<T: Default>(
        &mut self,
        kind: SectionKind,
        present: bool,
        code: impl FnOnce(&mut ArithmeticDecoder<'_>) -> Result<T>,
    ) -> Result<T> {
        if !present {
            return Ok(T::default());
        }
        let start = Instant::now();
        let mut decoder = ArithmeticDecoder::new(self.next_payload(kind)?);
        let decoded = code(&mut decoder).map_err(|e| e.within_section(kind))?;
        if decoder.is_exhausted() {
            return Err(ends_too_early(kind));
        }
        self.report.took_section(kind, start);
        Ok(decoded)
    }

    type Tokens<'a>
        = TokenReader<'a>
    where
        Self: 'a;

    fn tokens<T>(
        &mut self,
        kind: SectionKind,
        contexts: usize,
        tables: &mut TokenTables,
        code: impl FnOnce(&mut TokenReader<'_>) -> T,
    ) -> Result<T> {
        let start = Instant::now();
        let reader = TokenReader::new(self.next_payload(kind)?, contexts, tables);
        let mut reader = reader.map_err(|e| e.within_section(kind))?;
        let decoded = code(&mut reader);
        if reader.is_exhausted() {
            return Err(ends_too_early(kind));
        }
        let counts = reader.into_counts();
        if tables.lack_one(&counts) {
            return Err(Error::corrupt("a token in a context without a table").within_section(kind));
        }
        tables.learn(&counts);
        self.report.took_section(kind, start);
        Ok(decoded)
    }

    fn both<A: Send, B: Send>(
        &mut self,
        last: SectionKind,
        first: impl FnOnce(&mut Self) -> Result<A> + Send,
        second: impl FnOnce(&mut Self) -> Result<B> + Send,
    ) -> Result<(A, B)> {
        let own = self.sections.iter().take_while(|section| section.kind != last).count();
        let (own, rest) = self.sections.split_at((own + 1).min(self.sections.len()));
        let mut reader = SectionReader::new(own, self.limits);
        let mut other = SectionReader::new(rest, self.limits);
        let (a, b) = team::both(|| first(&mut reader), || second(&mut other));
        let a = a?;
        self.report.add(&reader.finish()?);
        self.report.add(&other.report);
        self.sections = other.sections;
        Ok((a, b?))
    }

    fn payload(&mut self, kind: SectionKind, payload: &mut Vec<u8>) {
        payload.clear();
        payload.extend_from_slice(self.next_if(kind).unwrap_or_default());
    }

    fn limits(&self) -> &Limits {
        self.limits
    }

    fn effort(&self) -> Effort {
        Effort::default()
    }

    fn report(&mut self) -> &mut StageReport {
        &mut self.report
    }

    fn bytes_written(&self) -> usize {
        0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ground::team::pool;

    #[test]
    fn two_parts_at_once_are_written_and_read_in_their_order() {
        const LAST: SectionKind = SectionKind::Range;
        fn code<S: SectionCoder>(sections: &mut S, kinds: &[SectionKind], value: u64) -> Result<u64> {
            let values = kinds
                .iter()
                .map(|kind| sections.section(*kind, true, |coder| Ok(coder.code_plain(value, 32))));
            values.sum()
        }
        let [first, second] = [[SectionKind::Intensity, LAST], [LAST, SectionKind::Order]];
        let mut writer = SectionWriter::new(Effort::default());
        let both = |writer: &mut SectionWriter| {
            writer.both(
                LAST,
                |sections| code(sections, &first, 1 << 30),
                |sections| code(sections, &second, 3 << 30),
            )
        };
        pool(2).unwrap().install(|| both(&mut writer)).unwrap();
        let kinds: Vec<_> = writer.sections.iter().map(|section| section.kind).collect();
        assert_eq!(kinds, [first, second].concat());
        let limits = Limits::default();
        for threads in [1, 2] {
            let pool = pool(threads).unwrap();
            let mut reader = SectionReader::new(&writer.sections, &limits);
            let both = || {
                reader.both(LAST, |sections| code(sections, &first, 0), |sections| code(sections, &second, 0))
            };
            assert_eq!(pool.install(both).unwrap(), (2 << 30, 6 << 30));
            reader.finish().unwrap();
            // It is an error if the first part leaves a section over, or lacks one.
            let mut reader = SectionReader::new(&writer.sections, &limits);
            let left = reader.both(LAST, |sections| code(sections, &first[..1], 0), |_| Ok(()));
            assert!(left.unwrap_err().to_string().contains("range"));
            let mut reader = SectionReader::new(&writer.sections[1..], &limits);
            let missing = reader.both(LAST, |sections| code(sections, &first, 0), |_| Ok(()));
            assert!(missing.unwrap_err().to_string().contains("intensity"));
        }
    }
}
