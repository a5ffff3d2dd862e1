//! Mapping of values to an axis of a plot, and its ticks.

use super::number::significant;
use super::{Axis, Scale};

/// Pixels between 0 and the rest of a logarithmic axis.
const ZERO_GAP: f64 = 36.0;
/// The largest number of ticks on a linear axis.
const MOST_TICKS: f64 = 8.0;
/// A logarithmic axis of at most this many decades is also labelled at 2 and 5.
const FEW_DECADES: f64 = 3.5;

/// An axis with its position in the picture.
pub struct Placed {
    scale: Scale,
    /// Values at its ends; the smaller one of a logarithmic axis is not 0.
    ends: [f64; 2],
    /// The positions of these values, in pixels.
    pixels: [f64; 2],
    /// The position of 0 on a logarithmic axis, if 0 is on it.
    pub zero: Option<f64>,
}

/// A tick: its position and its label.
#[derive(Clone, Debug, PartialEq)]
pub struct Tick {
    /// Position in pixels.
    pub at: f64,
    /// The label; may be empty.
    pub label: String,
}

impl Placed {
    /// An axis for these values, from one pixel to another.
    pub fn new(axis: &Axis, values: impl Iterator<Item = f64> + Clone, mut pixels: [f64; 2]) -> Self {
        let finite = values.filter(|value| value.is_finite());
        let largest = finite.clone().fold(0.0, f64::max);
        let mut zero = None;
        let ends = match &axis.scale {
            Scale::Linear => {
                let step = linear_step(largest);
                [0.0, (largest / step).ceil().max(1.0) * step]
            }
            Scale::Log => {
                if finite.clone().any(|value| value <= 0.0) {
                    zero = Some(pixels[0]);
                    pixels[0] += ZERO_GAP * (pixels[1] - pixels[0]).signum();
                }
                let smallest = finite.filter(|value| *value > 0.0).fold(f64::INFINITY, f64::min);
                round_outwards(smallest, largest)
            }
            Scale::Categories(names) => [-0.5, names.len() as f64 - 0.5],
        };
        Placed { scale: axis.scale.clone(), ends, pixels, zero }
    }

    /// The position of a value, in pixels.
    pub fn place(&self, value: f64) -> f64 {
        let [low, high] = self.ends;
        let part = match (&self.scale, self.zero) {
            (Scale::Log, Some(zero)) if value <= 0.0 => return zero,
            (Scale::Log, _) => (value / low).ln() / (high / low).ln(),
            _ => (value - low) / (high - low),
        };
        self.pixels[0] + part.clamp(0.0, 1.0) * (self.pixels[1] - self.pixels[0])
    }

    /// Its ticks, in ascending order.
    pub fn ticks(&self) -> Vec<Tick> {
        let [low, high] = self.ends;
        let tick = |value: f64, label: String| Tick { at: self.place(value), label };
        match &self.scale {
            Scale::Categories(names) => {
                names.iter().enumerate().map(|(place, name)| tick(place as f64, name.clone())).collect()
            }
            Scale::Linear => {
                let step = linear_step(high);
                let count = (high / step).round() as usize;
                (0..=count).map(|i| i as f64 * step).map(|value| tick(value, significant(value))).collect()
            }
            Scale::Log => {
                let has_few = (high / low).log10() <= FEW_DECADES;
                let at = |value: f64| {
                    let is_decade = (value.log10() - value.log10().round()).abs() < 1e-9;
                    tick(value, if has_few || is_decade { significant(value) } else { String::new() })
                };
                let zero = self.zero.map(|at| Tick { at, label: "0".to_owned() });
                let values = one_two_fives(low, high).filter(|value| {
                    let (least, most) = (low * (1.0 - 1e-9), high * (1.0 + 1e-9));
                    (least..=most).contains(value)
                });
                zero.into_iter().chain(values.map(at)).collect()
            }
        }
    }
}

/// The distance of the ticks of an axis from 0 to `largest`: 1, 2 or 5 times a power of ten.
fn linear_step(largest: f64) -> f64 {
    if largest <= 0.0 {
        return 1.0;
    }
    let least = largest / MOST_TICKS;
    one_two_fives(least, 10.0 * least).find(|step| *step >= least * (1.0 - 1e-9)).unwrap_or(least)
}

/// The numbers 1, 2 and 5 times powers of ten, from below `low` to above `high`.
fn one_two_fives(low: f64, high: f64) -> impl DoubleEndedIterator<Item = f64> {
    let decades = low.log10().floor() as i32..=high.log10().ceil() as i32;
    decades.flat_map(|decade| [1.0, 2.0, 5.0].map(|digit| digit * 10f64.powi(decade)))
}

/// The closest two of the numbers 1, 2 and 5 times powers of ten between which all values lie.
fn round_outwards(smallest: f64, largest: f64) -> [f64; 2] {
    if !(smallest.is_finite() && largest > 0.0) {
        return [0.1, 1.0];
    }
    let low = one_two_fives(smallest, largest).rfind(|value| *value <= smallest * (1.0 + 1e-9));
    let high = one_two_fives(smallest, largest).find(|value| *value >= largest * (1.0 - 1e-9));
    let (low, high) = (low.unwrap_or(smallest), high.unwrap_or(largest));
    if high > low { [low, high] } else { [low / 2.0, high * 2.0] }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn placed(scale: Scale, values: &[f64], pixels: [f64; 2]) -> Placed {
        let axis = Axis { name: String::new(), unit: String::new(), scale };
        Placed::new(&axis, values.iter().copied(), pixels)
    }

    fn labels(axis: &Placed) -> Vec<String> {
        axis.ticks().into_iter().map(|tick| tick.label).collect()
    }

    #[test]
    fn linear_axes_begin_at_0_and_have_round_ticks() {
        let axis = placed(Scale::Linear, &[3.16, 10.56], [100.0, 700.0]);
        assert_eq!(labels(&axis), ["0", "2", "4", "6", "8", "10", "12"]);
        assert_eq!([0.0, 6.0, 12.0].map(|value| axis.place(value)), [100.0, 400.0, 700.0]);
        assert_eq!(labels(&placed(Scale::Linear, &[0.7], [0.0, 1.0])).last().unwrap(), "0.7");
        assert_eq!(labels(&placed(Scale::Linear, &[], [0.0, 1.0])).last().unwrap(), "1");
    }

    #[test]
    fn logarithmic_axes_have_a_place_for_0() {
        let axis = placed(Scale::Log, &[0.0003, 0.03, 0.0], [500.0, 20.0]);
        assert_eq!(
            labels(&axis),
            ["0", "0.0002", "0.0005", "0.001", "0.002", "0.005", "0.01", "0.02", "0.05"]
        );
        assert_eq!(axis.place(0.0), 500.0);
        assert_eq!((axis.place(0.0002), axis.place(0.05)), (500.0 - ZERO_GAP, 20.0));
        let ticks = axis.ticks();
        assert!(ticks.is_sorted_by(|a, b| a.at > b.at), "{ticks:?}");
    }

    #[test]
    fn long_logarithmic_axes_have_numbers_at_decades_only() {
        let axis = placed(Scale::Log, &[1e-6, 3.0], [0.0, 600.0]);
        let labels = labels(&axis);
        assert_eq!(labels.iter().filter(|label| !label.is_empty()).count(), 7);
        assert_eq!(labels.iter().filter(|label| label.is_empty()).count(), 14);
        assert_eq!(axis.zero, None);
    }

    #[test]
    fn any_values_have_an_axis() {
        for values in [&[][..], &[0.0], &[1.0], &[f64::NAN, f64::INFINITY], &[5.0, 5.0]] {
            for scale in [Scale::Linear, Scale::Log, Scale::Categories(vec!["a".into()])] {
                let axis = placed(scale, values, [0.0, 100.0]);
                assert!(values.iter().all(|value| !value.is_finite() || axis.place(*value).is_finite()));
                assert!(!axis.ticks().is_empty());
            }
        }
    }
}
