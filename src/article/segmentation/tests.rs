use super::*;
use crate::scanner::hdl64::BeamConstants;
use crate::scanner::{CoordinateGrid, RangeImage, ideal};

/// The image of a scene: `range` returns the range in metres, if any, for the elevation and the azimuth
/// (radians) of a beam.
fn image(range: impl Fn(f64, f64) -> Option<f64>) -> (RangeImage, Hdl64) {
    let scanner = ideal(360, 10_000);
    (image_of(&scanner, range), scanner)
}

/// As [`image`], for a scanner with 360 ticks.
fn image_of(scanner: &Hdl64, range: impl Fn(f64, f64) -> Option<f64>) -> RangeImage {
    let mut image = RangeImage::new(scanner.rows(), (0..360).collect());
    for row in 0..scanner.rows() {
        for column in 0..360 {
            let azimuth = f64::from(scanner.tick_of_column(row, column)).to_radians();
            if let Some(metres) = range(scanner.elevation(row), azimuth) {
                image.steps[(row, column as usize)] = scanner.steps(metres).unwrap();
            }
        }
    }
    image
}

/// Flat ground 1.7 m below the scanner, up to 40 m away.
fn ground(elevation: f64) -> Option<f64> {
    (elevation < -0.0425).then(|| 1.7 / -elevation.sin())
}

fn labels_of(image: &RangeImage, scanner: &Hdl64) -> Segmentation {
    segment(&image.steps, &image.columns, scanner, &SegmentationConfig::default())
}

#[test]
fn flat_ground_is_all_ground() {
    let (image, scanner) = image(|elevation, _| ground(elevation));
    let found = labels_of(&image, &scanner);
    assert_eq!(found.end, FIRST_OBJECT);
    let as_expected = |(label, steps): (&u32, &u32)| *label == if *steps > 0 { GROUND } else { NO_RETURN };
    assert!(found.labels.cells().iter().zip(image.steps.cells()).all(as_expected));
}

/// Two posts 8 m away on that ground, one of them straight ahead, where the image begins and ends.
fn two_posts(elevation: f64, azimuth: f64) -> Option<f64> {
    let on_post = |at: f64| ((azimuth - at + 3.0).rem_euclid(std::f64::consts::TAU) - 3.0).abs() < 0.1;
    let post = on_post(0.0) || on_post(2.0);
    let floor = ground(elevation);
    if post && floor.is_none_or(|range| range * elevation.cos() > 8.0) {
        Some(8.0 / elevation.cos())
    } else {
        floor
    }
}

#[test]
fn posts_are_objects_even_across_the_seam() {
    let (image, scanner) = image(two_posts);
    let found = labels_of(&image, &scanner);
    assert_eq!(found.end, FIRST_OBJECT + 2);
    assert_eq!(found.labels[(10, 0)], found.labels[(10, 358)]);
    assert_ne!(found.labels[(10, 0)], found.labels[(10, 115)]);
    assert_eq!(found.labels[(60, 0)], GROUND);
}

#[test]
fn beams_that_point_aside_see_the_same() {
    let beam = |row: usize| BeamConstants {
        column_shift: (row as i64 * 25) % 90 - 45,
        ..BeamConstants::quantise([ideal(360, 10_000).elevation(row), 0.0, 0.0, 0.0, 0.0])
    };
    let beams = (0..64).map(beam).collect();
    let scanner = Hdl64::new(CoordinateGrid::Float32, 360, 10_000, beams);
    let found = labels_of(&image_of(&scanner, two_posts), &scanner);
    let (straight, straight_scanner) = image(two_posts);
    let expected = labels_of(&straight, &straight_scanner);
    assert_eq!(found.end, expected.end);
    let same = |row: usize, column: u32| {
        let tick = scanner.tick_of_column(row, column) as usize;
        found.labels[(row, column as usize)] == expected.labels[(row, tick)]
    };
    assert!((0..64).all(|row| (0..360).all(|column| same(row, column))));
}

/// The percentage of the ground in an image.
fn ground_share(image: &RangeImage, scanner: &Hdl64, config: &SegmentationConfig) -> usize {
    let found = segment(&image.steps, &image.columns, scanner, config);
    found.labels.cells().iter().filter(|label| **label == GROUND).count() * 100 / image.returns()
}

#[test]
fn ground_is_found_where_elevations_are_off_by_a_tenth_of_a_degree() {
    let off = |elevation: f64| (elevation * 5000.0).sin().signum() * 0.002;
    let (image, scanner) = image(|elevation, _| ground(elevation + off(elevation)));
    let config = SegmentationConfig::default();
    assert!(ground_share(&image, &scanner, &config) >= 90);
    assert!(ground_share(&image, &scanner, &SegmentationConfig { ground_reach_m: 0.0, ..config }) < 50);
}

#[test]
fn ground_goes_on_behind_rows_without_returns() {
    // Eight rows have no returns.
    let (mut image, scanner) = image(|elevation, _| ground(elevation));
    (40..48).for_each(|row| image.steps.row_mut(row).fill(0));
    assert_eq!(ground_share(&image, &scanner, &SegmentationConfig::default()), 100);
}

#[test]
fn ground_behind_an_object_does_not_lead_onto_it() {
    // A flat top 0.9 m below the scanner, 5 to 6 m away: from its far edge to the ground that is seen
    // behind it, the line falls by 8 degrees.
    let (image, scanner) = image(|elevation, azimuth| {
        let ahead = (azimuth - 1.0).abs() < 0.2;
        let top = 0.9 / -elevation.tan();
        match () {
            () if ahead && (5.0..6.0).contains(&top) => Some(top / elevation.cos()),
            () if ahead && (0.0..5.0).contains(&top) && 5.0 * elevation.tan() > -1.7 => {
                Some(5.0 / elevation.cos())
            }
            () => ground(elevation),
        }
    });
    let config = SegmentationConfig::default();
    let top = (0..64).find(|&row| image.steps[(row, 57)] < 700 && image.steps[(row, 57)] > 0).unwrap();
    assert!(image.steps[(top - 1, 57)] > 1000);
    let label = |config| segment(&image.steps, &image.columns, &scanner, &config).labels[(top, 57)];
    assert!(label(config) >= FIRST_OBJECT);
    assert_eq!(label(SegmentationConfig { ground_rise_m: 10.0, ..config }), GROUND);
}

#[test]
fn roofs_are_no_ground() {
    // A box 6 m away: its front, then its flat roof 0.3 m below the scanner.
    let (image, scanner) = image(|elevation, azimuth| {
        let box_ahead = (azimuth - 1.0).abs() < 0.3;
        let front = 6.0 * elevation.tan();
        match () {
            () if box_ahead && (-1.7..-0.3).contains(&front) => Some(6.0 / elevation.cos()),
            () if box_ahead && front > -0.3 && front < -0.15 => Some(0.3 / -elevation.sin()),
            () => ground(elevation),
        }
    });
    let found = labels_of(&image, &scanner);
    let column = 57;
    let roof = (0..64).find(|&row| image.steps[(row, column)] > 0).unwrap();
    assert_ne!(found.labels[(roof, column)], GROUND);
    assert_eq!(found.labels[(63, column)], GROUND);
}

#[test]
fn odd_images_are_segmented() {
    let scanner = ideal(16, 10_000);
    let mut image = RangeImage::new(64, (0..16).collect());
    assert_eq!(labels_of(&image, &scanner).labels, Grid::new(64, 16));
    image.steps[(5, 5)] = 700;
    assert_eq!(labels_of(&image, &scanner).labels[(5, 5)], UNASSIGNED);
    let none = RangeImage::new(64, Vec::new());
    assert_eq!(labels_of(&none, &scanner).end, FIRST_OBJECT);
}

#[test]
fn every_return_may_be_an_object_of_its_own() {
    let (mut image, scanner) = image(|_, _| None);
    for row in 0..64 {
        for column in 0..360 {
            image.steps[(row, column)] = 500 + 700 * ((row * 7 + column * 5) % 11) as u32;
        }
    }
    let config =
        SegmentationConfig { smallest_cluster: 1, ground_angle: 0.0, ..SegmentationConfig::default() };
    assert_eq!(segment(&image.steps, &image.columns, &scanner, &config).end, FIRST_OBJECT + 64 * 360);
}
