//! The syntax of a frame: the sections and their order. It is written once, for both directions: the encoder
//! processes a complete frame, the decoder fills an empty one. There is one file for each part of a frame,
//! with the coders of that part at every level. FORMAT.md 4.2.

mod corrections;
mod echoes;
mod file;
mod image;
mod intensities;
mod ranges;
mod records;
mod reference;
mod returns;
mod strays;

use super::parameters::FrameParameters;
use super::parts::FrameParts;
use super::sections::SectionCoder;
use super::whole::WholeFile;
use crate::container::SectionKind;
use crate::ground::clock::Instant;
use crate::ground::error::{Error, Result};
use crate::ground::varint::{read_unsigned, saturated, write_unsigned};
use crate::inter::Past;
use crate::scanner::Scanner;
use crate::scanner::motion::{Compensation, Stamped, Turn, World};
use corrections::CorrectionModels;
use echoes::EchoModels;
use file::FileModels;
use image::ImageModels;
use ranges::ResidualModels;
use records::RecordModels;
use reference::PastFrame;
use returns::ReturnModels;
use strays::StrayModels;

/// The models of all parts of a frame, which persist for the frames of a track.
#[derive(Clone, Default)]
pub struct Models {
    file: FileModels,
    image: ImageModels,
    past: PastFrame,
    strays: StrayModels,
    returns: ReturnModels,
    residuals: ResidualModels,
    echoes: EchoModels,
    corrections: CorrectionModels,
    records: RecordModels,
}

impl Models {
    /// Codes a frame. The decoder's frame is initially empty except for the number of records, and is filled;
    /// it also gets the returns in file order, which both sides derive from the range image.
    ///
    /// # Errors
    /// If the sections do not make a frame, or make one that exceeds the limits.
    pub fn code_frame<S: SectionCoder>(
        &mut self,
        sections: &mut S,
        scanner: Option<&Scanner>,
        frame: &mut FrameParts,
    ) -> Result<()> {
        let (start, before) = (Instant::now(), sections.report().total_time());
        self.code_sections(sections, scanner, frame)?;
        sections.report().took_rest(start, before);
        Ok(())
    }

    #[rustfmt::skip]
    fn code_sections<S: SectionCoder>(&mut self, s: &mut S, scanner: Option<&Scanner>, frame: &mut FrameParts) -> Result<()> {
        code_parameters(s, frame)?;                                                 // FORMAT 8.10
        if code_whole(s, frame)? { return Ok(()) }                                  // FORMAT 8.18
        self.file.code(s, frame)?;                                                  // FORMAT 8.1
        let scanner = frame.scanner_of_image(scanner)?;
        self.image.code_columns(s, scanner, frame)?;                                // FORMAT 8.2
        let reference = self.past.reference(scanner, frame)?;                       // FORMAT 4.3, equation 9
        self.image.code_occupancy(s, reference.as_ref(), frame)?;                   // FORMAT 8.3, 8.16
        self.strays.code(s, frame)?;                                                // FORMAT 8.4
        let levels = self.returns.code(s, scanner, reference.as_ref(), frame)?;     // FORMAT 8.5, 8.6, 8.16
        self.residuals.code(s, scanner, reference.as_ref(), frame)?;                // FORMAT 8.11 to 8.14
        self.echoes.code(s, frame)?;                                                // FORMAT 8.20
        self.past.remember(scanner, levels, frame);                                 // FORMAT 4.3
        frame.arrange(scanner);                                                     // FORMAT 4.2
        self.corrections.code(s, scanner, frame)?;                                  // FORMAT 8.7, 8.16, 8.19
        self.records.code_order(s, frame)?;                                         // FORMAT 8.8
        self.records.code_channels(s, scanner, frame)?;                             // FORMAT 8.9
        code_compensation(s, frame)?;                                               // FORMAT 8.15
        code_sorted(s, frame)                                                       // FORMAT 8.21
    }

    /// The frame before, if it has a range image.
    pub(crate) fn past(&self) -> Option<&Past> {
        self.past.get()
    }
}

/// The parameters: how the frame is coded.
fn code_parameters<S: SectionCoder>(sections: &mut S, frame: &mut FrameParts) -> Result<()> {
    let mut payload = frame.parameters.to_payload();
    sections.payload(SectionKind::Parameters, &mut payload);
    frame.parameters =
        FrameParameters::from_payload(&payload).map_err(|e| e.within_section(SectionKind::Parameters))?;
    Ok(())
}

/// The frame as the bytes of its file, if it is coded that way; then nothing else follows.
fn code_whole<S: SectionCoder>(sections: &mut S, frame: &mut FrameParts) -> Result<bool> {
    let mut payload = frame.whole.as_ref().map_or_else(Vec::new, |whole| whole.payload().to_vec());
    sections.payload(SectionKind::Bytes, &mut payload);
    if !S::ENCODES && !payload.is_empty() {
        let whole = WholeFile::from_payload(&payload, sections.limits());
        frame.whole = Some(whole.map_err(|e| e.within_section(SectionKind::Bytes))?);
    }
    Ok(!payload.is_empty())
}

/// How the points were moved after they were measured.
fn code_compensation<S: SectionCoder>(sections: &mut S, frame: &mut FrameParts) -> Result<()> {
    frame.find_misses()?;
    let (mut of_turn, mut of_world, mut of_stamps) = (Vec::new(), Vec::new(), Vec::new());
    match &frame.compensation {
        Some(Compensation::Turn(turn)) => turn.write_to(&mut of_turn),
        Some(Compensation::World(world)) => of_world = world.to_payload(&frame.positions_in_order()?),
        Some(Compensation::Stamped(stamped)) => {
            of_stamps = stamped.to_payload(&frame.positions_in_order()?, &frame.channels);
        }
        None => {}
    }
    sections.payload(SectionKind::Compensation, &mut of_turn);
    sections.payload(SectionKind::World, &mut of_world);
    sections.payload(SectionKind::Stamped, &mut of_stamps);
    frame.compensation = match (of_turn.is_empty(), of_world.is_empty(), of_stamps.is_empty()) {
        (true, true, true) => None,
        (false, true, true) => {
            let turn = Turn::from_payload(&of_turn, frame.records);
            Some(Compensation::Turn(turn.map_err(|e| e.within_section(SectionKind::Compensation))?))
        }
        (true, false, true) => {
            let world = World::from_payload(&of_world, &frame.positions_in_order()?);
            Some(Compensation::World(world.map_err(|e| e.within_section(SectionKind::World))?))
        }
        (true, true, false) => {
            let measured = frame.positions_in_order()?;
            let stamped = Stamped::from_payload(&of_stamps, &measured, &frame.channels);
            Some(Compensation::Stamped(stamped.map_err(|e| e.within_section(SectionKind::Stamped))?))
        }
        _ => return Err(Error::corrupt("more than one of the sections compensation, world and stamped")),
    };
    Ok(())
}

/// The channel by which the records were sorted.
fn code_sorted<S: SectionCoder>(sections: &mut S, frame: &mut FrameParts) -> Result<()> {
    const WHAT: &str = "sorted";
    let mut payload = Vec::new();
    frame.sorted.into_iter().for_each(|channel| write_unsigned(&mut payload, channel as u64));
    sections.payload(SectionKind::Sorted, &mut payload);
    if S::ENCODES || payload.is_empty() {
        return Ok(());
    }
    let mut input = &payload[..];
    let channel = read_unsigned(&mut input, WHAT).and_then(|channel| {
        let channel = saturated(channel);
        let is_one = channel < frame.channels.len() && input.is_empty();
        is_one.then_some(channel).ok_or_else(|| Error::corrupt("sorted: no channel of the frame"))
    });
    frame.sorted = Some(channel.map_err(|e| e.within_section(SectionKind::Sorted))?);
    Ok(())
}

impl FrameParts {
    /// The scanner, if the frame has a range image.
    fn scanner_of_image<'s>(&self, scanner: Option<&'s Scanner>) -> Result<Option<&'s Scanner>> {
        match scanner {
            _ if self.strays.count == self.records => Ok(None),
            Some(scanner) => Ok(Some(scanner)),
            None => Err(Error::corrupt("a range image without a scanner")),
        }
    }
}
