use super::*;
use crate::range_image::RangeImage;
use crate::sensor::ideal;

/// The image of a scene: for each beam and azimuth (radians) the range in metres, if any.
fn image(range: impl Fn(f64, f64) -> Option<f64>) -> (RangeImage, SensorModel) {
    let sensor = ideal(360, 10_000);
    let mut image = RangeImage::new(sensor.rows(), (0..360).collect());
    for row in 0..sensor.rows() {
        for column in 0..360 {
            let azimuth = f64::from(column).to_radians();
            if let Some(metres) = range(sensor.elevation(row), azimuth) {
                image.steps[(row, column as usize)] = sensor.steps(metres).unwrap();
            }
        }
    }
    (image, sensor)
}

/// Flat ground 1.7 m below the scanner, up to 40 m.
fn ground(elevation: f64) -> Option<f64> {
    (elevation < -0.0425).then(|| 1.7 / -elevation.sin())
}

fn labels_of(image: &RangeImage, sensor: &SensorModel) -> Segmentation {
    segment(&image.steps, &image.columns, sensor, &SegmentationConfig::default())
}

#[test]
fn flat_ground_is_all_ground() {
    let (image, sensor) = image(|elevation, _| ground(elevation));
    let found = labels_of(&image, &sensor);
    assert_eq!(found.end, FIRST_OBJECT);
    let as_expected = |(label, steps): (&u32, &u32)| *label == if *steps > 0 { GROUND } else { NO_RETURN };
    assert!(found.labels.cells().iter().zip(image.steps.cells()).all(as_expected));
}

#[test]
fn posts_are_objects_even_across_the_seam() {
    // Two posts 8 m away, one of them straight ahead, where the image begins and ends.
    let on_post =
        |azimuth: f64, at: f64| ((azimuth - at + 3.0).rem_euclid(std::f64::consts::TAU) - 3.0).abs() < 0.1;
    let (image, sensor) = image(|elevation, azimuth| {
        let post = on_post(azimuth, 0.0) || on_post(azimuth, 2.0);
        let floor = ground(elevation);
        if post && floor.is_none_or(|range| range * elevation.cos() > 8.0) {
            Some(8.0 / elevation.cos())
        } else {
            floor
        }
    });
    let found = labels_of(&image, &sensor);
    assert_eq!(found.end, FIRST_OBJECT + 2);
    assert_eq!(found.labels[(10, 0)], found.labels[(10, 358)]);
    assert_ne!(found.labels[(10, 0)], found.labels[(10, 115)]);
    assert_eq!(found.labels[(60, 0)], GROUND);
}

#[test]
fn roofs_are_no_ground() {
    // A box 6 m away: its front, then its flat roof 0.3 m below the scanner.
    let (image, sensor) = image(|elevation, azimuth| {
        let box_ahead = (azimuth - 1.0).abs() < 0.3;
        let front = 6.0 * elevation.tan();
        match () {
            () if box_ahead && (-1.7..-0.3).contains(&front) => Some(6.0 / elevation.cos()),
            () if box_ahead && front > -0.3 && front < -0.15 => Some(0.3 / -elevation.sin()),
            () => ground(elevation),
        }
    });
    let found = labels_of(&image, &sensor);
    let column = 57;
    let roof = (0..64).find(|&row| image.steps[(row, column)] > 0).unwrap();
    assert_ne!(found.labels[(roof, column)], GROUND);
    assert_eq!(found.labels[(63, column)], GROUND);
}

#[test]
fn odd_images_are_segmented() {
    let sensor = ideal(16, 10_000);
    let mut image = RangeImage::new(64, (0..16).collect());
    assert_eq!(labels_of(&image, &sensor).labels, Grid::new(64, 16));
    image.steps[(5, 5)] = 700;
    assert_eq!(labels_of(&image, &sensor).labels[(5, 5)], UNASSIGNED);
    let none = RangeImage::new(64, Vec::new());
    assert_eq!(labels_of(&none, &sensor).end, FIRST_OBJECT);
}

#[test]
fn every_return_may_be_an_object_of_its_own() {
    let (mut image, sensor) = image(|_, _| None);
    for row in 0..64 {
        for column in 0..360 {
            image.steps[(row, column)] = 500 + 700 * ((row * 7 + column * 5) % 11) as u32;
        }
    }
    let config =
        SegmentationConfig { smallest_cluster: 1, ground_angle: 0.0, ..SegmentationConfig::default() };
    assert_eq!(segment(&image.steps, &image.columns, &sensor, &config).end, FIRST_OBJECT + 64 * 360);
}
