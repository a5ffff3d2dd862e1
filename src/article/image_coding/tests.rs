use super::plane::Plane;
use super::recurrent::Pass;
use super::*;
use crate::ground::grid::Grid;
use crate::ground::random::Rng;

/// Typical residuals: a surface with steps, noise, a few outliers, and gaps.
fn residuals(rows: usize, columns: usize, scale: f64) -> (Grid<i32>, Grid<bool>) {
    let mut random = Rng::keyed(3, &[rows as u64, columns as u64]);
    let mut values = Grid::new(rows, columns);
    let mut returns = Grid::new(rows, columns);
    for row in 0..rows {
        for column in 0..columns {
            let surface = 0.2 * (column as f64 * 0.11).sin() + 0.3 * f64::from(u8::from(column % 37 < 9));
            let far = if random.chance(0.02) { random.between(-3.0, 3.0) } else { 0.0 };
            values[(row, column)] = (scale * (surface + far + 0.01 * random.normal())) as i32;
            returns[(row, column)] = random.chance(0.8) && row != 2;
        }
    }
    (values, returns)
}

/// Encodes and decodes; returns the payload and the remaining error, on which encoder and decoder must agree.
fn round_trip(
    codec: ImageCodec,
    (values, returns): &(Grid<i32>, Grid<bool>),
    config: ImageConfig,
) -> (Vec<u8>, Grid<i32>, f64) {
    let plane = Plane { values: values.clone(), returns };
    let bytes = config.rate.bytes(plane.of_returns().count());
    let payload = encode(codec, values.clone(), returns, config.passes, bytes).unwrap();
    assert!(bytes.is_none_or(|bytes| payload.len() <= bytes.max(1)), "{} of {bytes:?} bytes", payload.len());
    let decoded = decode(codec, &payload, values.rows(), values.columns()).unwrap();
    let error = (plane.without(&decoded).energy() / plane.of_returns().count().max(1) as f64).sqrt();
    (payload, decoded, error)
}

fn bits(passes: u8, bits: f64) -> ImageConfig {
    ImageConfig { passes, rate: Rate::Bits(bits) }
}

const LOSSLESS: ImageConfig = ImageConfig { passes: 1, rate: Rate::Lossless };

#[test]
fn lossless_is_exact() {
    let codec = ImageCodec::Jpeg2000;
    // The largest values take more bits than a pass has.
    for scale in [0.0, 3.0, 1000.0, 1e6, 6e8] {
        for (rows, columns) in [(1, 1), (1, 50), (50, 1), (3, 3), (20, 90), (64, 70)] {
            let case = residuals(rows, columns, scale);
            assert_eq!(round_trip(codec, &case, LOSSLESS).2, 0.0, "{rows} x {columns} at {scale}");
        }
    }
}

#[test]
fn the_extreme_values_are_exact() {
    let mut values = residuals(10, 20, 100.0).0;
    (values[(3, 4)], values[(5, 6)], values[(7, 7)]) = (i32::MIN, i32::MAX, 0);
    let returns = values.map(|_| true);
    assert_eq!(round_trip(ImageCodec::Jpeg2000, &(values, returns), LOSSLESS).2, 0.0);
}

#[test]
fn jpeg_does_not_claim_to_lose_nothing() {
    let (values, returns) = residuals(10, 20, 1000.0);
    assert!(encode(ImageCodec::Jpeg, values, &returns, 2, None).is_err());
}

#[test]
fn more_bits_leave_less_error() {
    let case = residuals(32, 256, 5000.0);
    for codec in ImageCodec::ALL {
        for passes in [1, 2, 4] {
            let rates = [0.05, 0.3, 1.0, 2.0, 4.0, 6.0];
            let errors = rates.map(|rate| round_trip(codec, &case, bits(passes, rate)).2);
            assert!(errors.is_sorted_by(|less, more| less > more), "{codec:?} {passes} {errors:?}");
            assert!(errors[5] < 0.1 * errors[0], "{codec:?} {passes} {errors:?}");
        }
    }
}

#[test]
fn more_passes_leave_no_more_error() {
    let case = residuals(32, 256, 5000.0);
    for (codec, rate) in [(ImageCodec::Jpeg, 10.0), (ImageCodec::Jpeg2000, 1.0)] {
        let errors = [1, 2, 3].map(|passes| round_trip(codec, &case, bits(passes, rate)).2);
        assert!(errors[1] < 0.9 * errors[0] && errors[2] <= errors[1], "{codec:?} {errors:?}");
    }
}

#[test]
fn results_repeat() {
    let case = residuals(20, 90, 3000.0);
    for codec in ImageCodec::ALL {
        let [once, again] = [(), ()].map(|()| round_trip(codec, &case, bits(3, 3.0)));
        assert!(once.0 == again.0 && once.1 == again.1);
    }
}

#[test]
fn every_size_is_coded() {
    for codec in ImageCodec::ALL {
        for (rows, columns) in [(1, 1), (1, 9), (7, 2), (8, 8), (9, 17), (64, 65)] {
            let (values, returns) = residuals(rows, columns, 400.0);
            let payload = encode(codec, values.clone(), &returns, 2, Some(100_000)).unwrap();
            let left = Plane { values, returns: &returns };
            let left = left.without(&decode(codec, &payload, rows, columns).unwrap());
            let (least, greatest) = left.extremes();
            assert!(least > -20 && greatest < 20, "{codec:?} {rows} x {columns}: {least} to {greatest}");
        }
    }
}

#[test]
fn no_room_is_no_image() {
    let case = residuals(20, 90, 3000.0);
    for codec in ImageCodec::ALL {
        for few in [1e-9, 0.01, 0.02] {
            round_trip(codec, &case, bits(2, few));
        }
        assert_eq!(round_trip(codec, &case, bits(2, 1e-9)).0, [0]);
    }
}

#[test]
fn damaged_images_are_an_error_or_a_result() {
    let mut random = Rng::keyed(8, &[]);
    let case = residuals(16, 60, 3000.0);
    for codec in ImageCodec::ALL {
        let (payload, ..) = round_trip(codec, &case, bits(3, 4.0));
        for length in (0..payload.len()).step_by(7) {
            assert!(decode(codec, &payload[..length], 16, 60).is_err(), "cut to {length}");
        }
        for _ in 0..600 {
            let mut damaged = payload.clone();
            for _ in 0..=random.below(3) {
                let place = random.below(damaged.len());
                damaged[place] ^= 1 << random.below(8);
            }
            let _ = decode(codec, &damaged, 16, 60);
            let _ = decode(codec, &payload, 1 + random.below(70), 1 + random.below(70));
        }
    }
}

#[test]
fn impossible_passes_are_an_error() {
    let pass = |image: &[u8]| Pass { centre: 0, step: 1, image: image.to_vec() };
    for codec in ImageCodec::ALL {
        // A quality or precision of 0 or 255, more resolutions than 5, markers.
        for image in [&[0][..], &[0, 1, 5, 5], &[255, 1, 5, 5], &[16, 6, 0xff, 0xd9]] {
            assert!(pass(image).decode(codec, (16, 60)).is_err(), "{codec:?} {image:?}");
        }
        assert!(decode(codec, &[9, 0, 0, 0], 16, 60).is_err(), "nine passes");
        assert!(decode(codec, &[0, 0], 16, 60).is_err(), "bytes left over");
        assert!(decode(codec, &[1, 0, 1, 200, 1, 5], 16, 60).is_err(), "an image longer than the payload");
        assert_eq!(decode(codec, &[0], 16, 60).unwrap(), Grid::new(16, 60), "no pass is no difference");
    }
}

#[test]
fn settings_out_of_range_are_refused() {
    assert!(ImageConfig::default().check().is_ok() && LOSSLESS.check().is_ok());
    for wrong in [bits(0, 1.0), bits(9, 1.0), bits(2, 0.0), bits(2, -1.0), bits(2, f64::NAN), bits(2, 1e9)] {
        assert!(wrong.check().is_err(), "{wrong:?}");
    }
}
