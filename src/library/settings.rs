//! The user's settings for encoding.

use crate::backend::Level;
use crate::frame::IntensityFidelity;
use crate::frame::settings::{EncoderConfig, Mode};
use crate::ground::error::{Error, Result};

/// Settings of an [`Encoder`](crate::Encoder): a mode, and further options.
///
/// ```
/// let settings = lidarpc::Settings::bounded(0.01).with_level(9).with_threads(2);
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    config: EncoderConfig,
    level: Option<u8>,
    group_of_pictures: Option<usize>,
    /// The intensity step, in the unit of the file.
    intensity_step: Option<f64>,
}

impl Default for Settings {
    /// [`exact`](Self::exact).
    fn default() -> Self {
        Settings::exact()
    }
}

impl Settings {
    /// Everything is restored: files byte for byte, points in memory with every bit.
    pub fn exact() -> Self {
        Settings::of_mode(Mode::Exact)
    }

    /// Every point is restored, at its index, within `max_error_m` of its original position (3-D distance in
    /// metres, from a micrometre to 10 m); everything else with every bit.
    pub fn bounded(max_error_m: f64) -> Self {
        // Rounded down, so as not to exceed the request; the small addition preserves whole numbers of
        // micrometres, which may be off by a rounding error.
        let max_error_um = (max_error_m * 1e6 + 1e-6).floor() as u32;
        Settings::of_mode(Mode::Bounded { max_error_um })
    }

    /// The article's codec: outliers are removed, and the ideal scanner's range image is coded.
    #[cfg(feature = "article")]
    pub fn paper() -> Self {
        Settings::of_mode(Mode::Paper)
    }

    /// Settings with this configuration of the encoder.
    #[cfg(feature = "cli")]
    pub(crate) fn of_config(config: EncoderConfig) -> Self {
        let group_of_pictures = Some(config.gop);
        Settings { config, level: None, group_of_pictures, intensity_step: None }
    }

    fn of_mode(mode: Mode) -> Self {
        let config = EncoderConfig::preset(mode);
        Settings { config, level: None, group_of_pictures: None, intensity_step: None }
    }

    /// The effort, from 1 (fastest) to 9 (smallest); there are no levels 4 and 5. Default: 6.
    #[must_use]
    pub fn with_level(self, level: u8) -> Self {
        Settings { level: Some(level), ..self }
    }

    /// Number of threads that code groups in addition to the caller's; 0, the default, means one per
    /// processor. With 1 there are none: groups are coded as they fill up, by the thread that pushes scans.
    /// The stream does not depend on the number.
    #[must_use]
    pub fn with_threads(mut self, threads: usize) -> Self {
        self.config.threads = threads;
        self
    }

    /// Scans per group: with more, compression is better; with fewer, seeking and recovery are finer, and an
    /// encoder writes sooner and holds fewer scans in memory. From 1 to 100,000; default: 10, or 30 at level 9.
    #[must_use]
    pub fn with_group_of_pictures(self, scans: usize) -> Self {
        Settings { group_of_pictures: Some(scans), ..self }
    }

    /// Allows intensities to be rounded to multiples of this, from 0.000001 to 1000, in bounded mode.
    /// Default: they are exact.
    #[must_use]
    pub fn with_intensity_step(self, step: f64) -> Self {
        Settings { intensity_step: Some(step), ..self }
    }

    /// The configuration of the encoder.
    ///
    /// # Errors
    /// [`Error::InvalidSettings`] if the settings are out of range or do not fit together.
    pub(crate) fn config(&self) -> Result<EncoderConfig> {
        let mut config = self.config.clone();
        if let Some(level) = self.level {
            let unknown = || Error::InvalidSettings(format!("level {level} is not from 1 to 9"));
            config.level = Level::new(level).ok_or_else(unknown)?;
        }
        config.gop = self.group_of_pictures.unwrap_or(config.default_gop());
        if let Some(step) = self.intensity_step {
            // NaN becomes 0, and what is too large the largest integer, both of which are rejected.
            config.intensity = IntensityFidelity::Rounded { step_millionths: (step * 1e6).round() as u32 };
        }
        config.check()?;
        Ok(config)
    }
}
