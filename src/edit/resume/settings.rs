//! Everything that determines a stream besides the contents and order of the files, as text for comparison.

use crate::frame::PositionFidelity;
use crate::frame::settings::EncoderConfig;

/// Names and values, in the order in which they are compared.
pub type Settings = Vec<(String, String)>;

/// The settings of an encode: the program's version, and all choices except the number of threads, which has
/// no effect. The number of frames is included, because scanners are fitted to a sample of all frames.
pub fn list(config: &EncoderConfig, frames: usize) -> Settings {
    // Every field is named, so that new ones cannot be forgotten here.
    let EncoderConfig {
        gop,
        threads: _,
        outliers,
        headerless,
        projection,
        positions,
        intensity,
        prediction,
        order,
        registration,
        snake,
        halved_from,
        segmentation,
        intra,
        coder,
        level,
        packing,
        image,
    } = config;
    let settings = [
        ("lidarpc", env!("CARGO_PKG_VERSION").to_owned()),
        ("frames", frames.to_string()),
        ("gop", gop.to_string()),
        ("largest error", largest_error(*positions)),
        ("intensity", format!("{intensity:?}")),
        ("projection", format!("{projection:?}")),
        ("layout", format!("{headerless:?}")),
        ("outliers", format!("{outliers:?}")),
        ("backend", format!("{coder:?}")),
        ("level", level.number().to_string()),
        ("packing", format!("{packing:?}")),
        ("snake", format!("{snake:?}")),
        ("halved from", format!("{halved_from:?}")),
        ("image", format!("{image:?}")),
        ("predict", format!("{prediction:?}")),
        ("order", format!("{order:?}")),
        ("registration", format!("{registration:?}")),
        ("segmentation", format!("{segmentation:?}")),
        ("regions", format!("{intra:?}")),
    ];
    settings.map(|(name, value)| (name.to_owned(), value)).into()
}

/// The largest error of positions, in words.
fn largest_error(positions: PositionFidelity) -> String {
    match positions {
        PositionFidelity::Exact => "none".to_owned(),
        PositionFidelity::Formula => "that of paper mode".to_owned(),
        PositionFidelity::Bounded { max_error_um, on_grid } => {
            let grid = if on_grid { " on the file's grid" } else { "" };
            format!("{} mm{grid}", f64::from(max_error_um) / 1000.0)
        }
    }
}

/// The first difference, if there is any.
pub fn difference(before: &Settings, now: &Settings) -> Option<String> {
    let differs = before.iter().zip(now).find(|(before, now)| before != now);
    match differs {
        Some(((name, before), (other, now))) if name == other => Some(format!("{name}: {before}, now {now}")),
        None if before.len() == now.len() => None,
        _ => Some("of another program".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::Level;
    use crate::frame::settings::Mode;

    #[test]
    fn what_differs_is_named_and_threads_do_not() {
        let exact = EncoderConfig::default();
        let before = list(&exact, 3);
        assert_eq!(difference(&before, &list(&EncoderConfig { threads: 7, ..exact.clone() }, 3)), None);
        assert_eq!(difference(&before, &list(&exact, 4)).unwrap(), "frames: 3, now 4");
        assert_eq!(
            difference(&before, &list(&EncoderConfig { gop: 2, ..exact }, 3)).unwrap(),
            "gop: 10, now 2"
        );
        let bounded = |max_error_um| list(&EncoderConfig::preset(Mode::Bounded { max_error_um }), 3);
        let what = difference(&bounded(10_000), &bounded(10_001)).unwrap();
        assert_eq!(what, "largest error: 10 mm, now 10.001 mm");
        assert!(difference(&before[..5].to_vec(), &before).is_some());
        let level = |number| EncoderConfig { level: Level::new(number).unwrap(), ..EncoderConfig::default() };
        assert_eq!(difference(&list(&level(6), 3), &list(&level(9), 3)).unwrap(), "level: 6, now 9");
    }
}
