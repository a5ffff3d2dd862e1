//! Lengths with their units on the command line.

use std::str::FromStr;

/// A length, in micrometres.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Length(pub u32);

impl Length {
    /// The length in metres.
    pub fn metres(self) -> f64 {
        f64::from(self.0) * 1e-6
    }
}

impl FromStr for Length {
    type Err = String;

    /// Reads `2mm`, `1.5 cm` or `0.38m`.
    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("'{text}' is not a length; give one as 2mm, 1.5cm or 0.38m");
        let (number, unit_um) = [("um", 1.0), ("mm", 1e3), ("cm", 1e4), ("m", 1e6)]
            .into_iter()
            .find_map(|(unit, um)| Some((text.strip_suffix(unit)?, um)))
            .ok_or_else(wrong)?;
        let micrometres = number.trim().parse::<f64>().map_err(|_| wrong())? * unit_um;
        let whole = micrometres.round();
        if !(1.0..=1e9).contains(&whole) {
            return Err(format!("'{text}' is not from 1um to 1000m"));
        }
        if (micrometres - whole).abs() > 1e-6 * whole {
            return Err(format!("'{text}' is not a whole number of micrometres"));
        }
        Ok(Length(whole as u32))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_read() {
        let read = |text: &str| text.parse::<Length>().ok().map(|length| length.0);
        assert_eq!(read("2mm"), Some(2000));
        assert_eq!(read("1.5 cm"), Some(15_000));
        assert_eq!(read("0.38m"), Some(380_000));
        assert_eq!(read("7um"), Some(7));
        for wrong in ["", "2", "mm", "-1mm", "0mm", "1.5um", "nanm", "infm", "2000m", "1e3", "1 km"] {
            assert_eq!(read(wrong), None, "{wrong:?}");
        }
    }
}
