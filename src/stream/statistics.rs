//! Statistics of what was encoded.

use crate::container::{CodedFrame, FrameHeader, FrameKind, SectionKind};
use crate::frame::parameters::{FrameParameters, OriginalFile};
use crate::frame::stages::StageReport;
use crate::ground::error::Result;

/// Statistics of an encoded stream.
#[derive(Clone, Debug, Default)]
pub struct EncodeStatistics {
    /// The headers of the frames, in order.
    pub frames: Vec<FrameHeader>,
    /// Time and size of each stage; where several predictions were tried, those of the chosen one.
    pub stages: StageReport,
    /// Time and size of each stage, frame by frame.
    pub frame_stages: Vec<StageReport>,
    /// Number of points in all original files.
    pub points: u64,
    /// Points removed by the outlier filter.
    pub outliers: u64,
    /// Points lost because the range image had no separate cell for them.
    pub lost: u64,
    /// Number of files beside the scans, which are included in `frames`.
    pub beside: u64,
    /// Bytes of the files beside the scans.
    pub beside_bytes: u64,
    /// Coded bytes of the files beside the scans.
    pub beside_coded: u64,
    /// Frames that no model fits, so that their files' bytes were coded by a general-purpose compressor.
    pub unmodelled: u64,
    /// Scans that are restored exactly.
    pub exact: u64,
    /// Frames kept from an interrupted run. Their stages have no times.
    pub resumed_frames: u64,
    /// Bytes of the stream.
    pub stream_bytes: u64,
}

impl EncodeStatistics {
    /// Bytes of all original files.
    pub fn file_bytes(&self) -> u64 {
        self.stages.original
    }

    /// Adds the next frame.
    pub(crate) fn add(&mut self, frame: FrameStatistics) {
        self.stages.add(&frame.stages);
        self.frame_stages.push(frame.stages);
        // A resumed stream tells these numbers of its frames, and anything may stand there.
        self.points = self.points.saturating_add(frame.source.points);
        self.outliers = self.outliers.saturating_add(frame.source.outliers);
        self.lost = self.lost.saturating_add(frame.source.lost);
        self.unmodelled += u64::from(!frame.is_modelled);
        self.exact += u64::from(frame.is_exact && frame.header.stamp.kind != FrameKind::Beside);
        if frame.header.stamp.kind == FrameKind::Beside {
            self.beside += 1;
            self.beside_bytes += frame.header.file_size;
            self.beside_coded += frame.stages.coded();
        }
        self.frames.push(frame.header);
    }
}

/// A frame of the stream.
pub(crate) struct FrameStatistics {
    /// The frame header.
    pub header: FrameHeader,
    pub stages: StageReport,
    /// The original file.
    pub source: OriginalFile,
    pub is_modelled: bool,
    /// Whether it is restored exactly.
    pub is_exact: bool,
}

impl FrameStatistics {
    /// The frame that was coded as this one.
    ///
    /// # Errors
    /// If the frame's parameters are damaged.
    pub(crate) fn of(frame: &CodedFrame, stages: StageReport) -> Result<Self> {
        let is_modelled = frame.header.stamp.kind == FrameKind::Beside
            || frame.sections.iter().all(|section| section.kind != SectionKind::Bytes);
        let parameters = FrameParameters::of(frame)?;
        let (is_exact, source) = (parameters.source.is_none(), parameters.original_of(&frame.header));
        let header = frame.header.clone();
        Ok(FrameStatistics { header, stages, source, is_modelled, is_exact })
    }
}
