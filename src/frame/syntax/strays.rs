//! Points outside any range image. FORMAT.md 8.4.

use std::cell::LazyCell;

use byteorder::{ByteOrder, LittleEndian};

use crate::backend::{Compressors, Verdict};
use crate::container::SectionKind;
use crate::entropy::{AdaptiveBit, BitCoder};
use crate::frame::parts::FrameParts;
use crate::frame::sections::SectionCoder;
use crate::ground::error::Result;
use crate::models::channels::{Compressed, code_compressed};
use crate::models::{Analysis, PointModel, PointTrail, TrailSizes};
use crate::scan::{Channel, ScalarType};
use crate::scanner::CoordinateGrid;

/// The models of strays.
#[derive(Clone, Default)]
pub struct StrayModels {
    points: PointModel,
    are_compressed: AdaptiveBit,
    /// Of compression in place of the model.
    verdict: Verdict,
    /// Of channels, in place of the order of the points, to tell their trails.
    channel_verdict: Verdict,
}

impl StrayModels {
    /// Codes the positions of the strays.
    ///
    /// # Errors
    /// If the section is damaged.
    pub fn code<S: SectionCoder>(&mut self, sections: &mut S, frame: &mut FrameParts) -> Result<()> {
        let has_points = frame.layout.position.is_some();
        frame.strays.positions.resize(if has_points { frame.strays.count } else { 0 }, [0.0; 3]);
        let lattice = frame.parameters.positions.lattice();
        let compressors = sections.effort().compressors;
        sections.section(SectionKind::Strays, !frame.strays.positions.is_empty(), |coder| {
            // The records of a frame without an image are its strays.
            let channels = if frame.strays.count == frame.records { frame.channels.as_slice() } else { &[] };
            let positions = &mut frame.strays.positions;
            frame.strays.trails =
                self.code_strays(coder, (lattice, compressors), frame.records, positions, channels)?;
            Ok(())
        })
    }

    /// Points outside any range image: by the model of points, or, if most points are outside, by a
    /// general-purpose compressor where that is shorter; nothing is known of their trails then.
    fn code_strays<C: BitCoder>(
        &mut self,
        coder: &mut C,
        (lattice, compressors): (Option<CoordinateGrid>, Compressors),
        records: usize,
        positions: &mut [[f32; 3]],
        channels: &[Channel],
    ) -> Result<Vec<PointTrail>> {
        const WIDTH: usize = 12;
        let mut compressed = None;
        let mut analysis = Analysis::default();
        if C::ENCODES {
            let may_compress = lattice.is_none() && 2 * positions.len() > records;
            let bytes: Vec<u8> = match may_compress {
                true => positions.iter().flatten().flat_map(|value| value.to_le_bytes()).collect(),
                false => Vec::new(),
            };
            let likeness = LazyCell::new(|| Verdict::likeness(&bytes, positions.len()));
            let compress = |most| Compressed::shortest(&bytes, ScalarType::F32, WIDTH, compressors, most);
            if may_compress && self.verdict.has_won(|| *likeness) {
                compressed = compress(usize::MAX);
            }
            if compressed.is_none() {
                let tell_nothing = may_compress && self.channel_verdict.has_lost(|| *likeness);
                let channels = if tell_nothing { &[] } else { channels };
                analysis = self.points.analyse(lattice, positions, channels);
                if let Some(TrailSizes { channel, order }) = analysis.sizes_by.filter(|_| may_compress) {
                    self.channel_verdict = Verdict::of(channel, order, *likeness);
                }
            }
            if may_compress && compressed.is_none() && !self.verdict.has_lost(|| *likeness) {
                let own = self.points.size_of(positions, &analysis);
                compressed = compress(own);
                let size = compressed.as_ref().map(Compressed::size);
                self.verdict = size.map_or(Verdict::Open, |size| Verdict::of(size, own, *likeness));
                compressed.take_if(|found| found.size() >= own);
            }
        }
        if !self.are_compressed.code(coder, compressed.is_some()) {
            return Ok(self.points.code(coder, lattice, positions, &analysis));
        }
        let mut bytes = vec![0; WIDTH * positions.len()];
        code_compressed(coder, compressed, ScalarType::F32, WIDTH, &mut bytes)?;
        if !C::ENCODES {
            for (position, values) in positions.iter_mut().zip(bytes.chunks_exact(WIDTH)) {
                *position = std::array::from_fn(|axis| LittleEndian::read_f32(&values[4 * axis..]));
            }
        }
        Ok(Vec::new())
    }
}
