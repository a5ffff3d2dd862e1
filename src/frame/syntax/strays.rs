//! Points outside any range image.

use byteorder::{ByteOrder, LittleEndian};

use crate::backend::{Level, Trial};
use crate::container::SectionKind;
use crate::entropy::{AdaptiveBit, ArithmeticEncoder, BitCoder};
use crate::frame::parts::FrameParts;
use crate::frame::sections::SectionCoder;
use crate::ground::error::Result;
use crate::models::PointModel;
use crate::models::channels::{Compressed, code_compressed};
use crate::scan::Scalar;
use crate::scanner::Coordinates;

/// The models of strays.
#[derive(Clone, Default)]
pub struct StrayModels {
    points: PointModel,
    are_compressed: AdaptiveBit,
    /// Of compression in place of the model.
    trial: Trial,
}

impl StrayModels {
    /// Codes the positions of the strays.
    ///
    /// # Errors
    /// If the section is damaged.
    pub fn code<S: SectionCoder>(&mut self, sections: &mut S, frame: &mut FrameParts) -> Result<()> {
        let has_points = frame.layout.position.is_some();
        frame.stray_positions.resize(if has_points { frame.strays } else { 0 }, [0.0; 3]);
        let (lattice, level) = (frame.parameters.positions.lattice(), sections.effort().level);
        sections.section(SectionKind::Points, !frame.stray_positions.is_empty(), |coder| {
            self.code_strays(coder, (lattice, level), frame.records, &mut frame.stray_positions)
        })
    }

    /// Points outside any range image: by the model of points, or, if most points are outside, by a
    /// general-purpose compressor where that is shorter.
    fn code_strays<C: BitCoder>(
        &mut self,
        coder: &mut C,
        (lattice, level): (Option<Coordinates>, Level),
        records: usize,
        positions: &mut [[f32; 3]],
    ) -> Result<()> {
        const WIDTH: usize = 12;
        let mut compressed = None;
        if C::ENCODES && lattice.is_none() && 2 * positions.len() > records && self.trial != Trial::Lost {
            let own = if self.trial == Trial::Won { usize::MAX } else { self.size_as_points(positions) };
            let bytes: Vec<u8> = positions.iter().flatten().flat_map(|value| value.to_le_bytes()).collect();
            compressed = Compressed::shortest(&bytes, Scalar::F32, WIDTH, level, own);
            self.trial = compressed.as_ref().map_or(Trial::Open, |found| Trial::of(found.size(), own));
            compressed.take_if(|found| found.size() >= own);
        }
        if !self.are_compressed.code(coder, compressed.is_some()) {
            self.points.code(coder, lattice, positions);
            return Ok(());
        }
        let mut bytes = vec![0; WIDTH * positions.len()];
        code_compressed(coder, compressed, Scalar::F32, WIDTH, &mut bytes)?;
        if !C::ENCODES {
            for (position, values) in positions.iter_mut().zip(bytes.chunks_exact(WIDTH)) {
                *position = std::array::from_fn(|axis| LittleEndian::read_f32(&values[4 * axis..]));
            }
        }
        Ok(())
    }

    /// Size of the positions coded by the model of points, in bytes.
    fn size_as_points(&self, positions: &[[f32; 3]]) -> usize {
        let mut encoder = ArithmeticEncoder::default();
        self.points.clone().code(&mut encoder, None, &mut positions.to_vec());
        encoder.finish().len()
    }
}
