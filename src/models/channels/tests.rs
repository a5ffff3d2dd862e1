//! Channels of every kind are restored, and those that follow from others take next to no bytes.

use proptest::prelude::*;

use super::column::ColumnModel;
use super::integers::Site;
use super::plan::{Image, Integers, Levels, Plan};
use super::rules::{Rule, RuleModel};
use super::*;
use crate::entropy::{ArithmeticDecoder, ArithmeticEncoder};
use crate::models::numbers::Scale;

/// Codes channels in two frames, checks that they are restored, and returns the bytes of the second frame.
fn round_trip(channels: &[Channel], context: &RecordContext) -> usize {
    frames_round_trip(&[(channels, context); 2])[1]
}

/// Codes frames with the same models, checks that they are restored, and returns the bytes of each.
fn frames_round_trip(frames: &[(&[Channel], &RecordContext)]) -> Vec<usize> {
    let (mut writer, mut reader) = (ChannelsModel::default(), ChannelsModel::default());
    let sizes = frames.iter().map(|&(channels, context)| {
        let mut encoder = ArithmeticEncoder::default();
        writer.code(&mut encoder, &mut channels.to_vec(), context, Compressors::default(), u64::MAX).unwrap();
        let bytes = encoder.finish();
        let mut decoded = empty(channels);
        reader
            .code(
                &mut ArithmeticDecoder::new(&bytes),
                &mut decoded,
                context,
                Compressors::default(),
                u64::MAX,
            )
            .unwrap();
        assert_eq!(decoded, channels);
        bytes.len()
    });
    sizes.collect()
}

/// The same channels, all zeros.
fn empty(channels: &[Channel]) -> Vec<Channel> {
    let empty = |channel: &Channel| Channel { bytes: vec![0; channel.bytes.len()], ..channel.clone() };
    channels.iter().map(empty).collect()
}

fn channel<const N: usize>(name: &str, scalar: ScalarType, values: impl Iterator<Item = [u8; N]>) -> Channel {
    Channel { field: Field::new(name, scalar), bytes: values.flatten().collect() }
}

/// A pseudo-random number.
fn noise(n: u32) -> u32 {
    (n.wrapping_mul(2_654_435_761) ^ n >> 3).wrapping_mul(0x9e37_79b1) >> 8
}

const RECORDS: u32 = 4000;

/// Records of a scanner of 16 beams, with some returns missing.
fn returns() -> Vec<u32> {
    (0..RECORDS * 2).filter(|&n| !noise(n).is_multiple_of(5)).take(RECORDS as usize).collect()
}

#[test]
fn what_follows_from_the_beam_costs_next_to_nothing() {
    let returns = returns();
    let rows = returns.iter().map(|n| n % 16 + 1).collect();
    let context = RecordContext { rows, ..RecordContext::default() };
    let ring =
        channel("ring", ScalarType::U16, returns.iter().map(|n| ((n % 16 * 7 % 16) as u16).to_le_bytes()));
    let size = round_trip(&[ring], &context);
    assert!(size < 60, "{size} bytes");
}

#[test]
fn few_values_on_no_grid_are_coded_by_their_numbers() {
    let level = |n: u32| (n % 1180).min(1180 - n % 1180) + noise(n) % 16;
    let values: Vec<f64> = (0..3 * RECORDS).map(|n| (f64::from(level(n)) / 641.0).sqrt()).collect();
    let single = channel("intensity", ScalarType::F32, values.iter().map(|v| (*v as f32).to_le_bytes()));
    let double = channel("reflectivity", ScalarType::F64, values.iter().rev().map(|v| v.to_le_bytes()));
    for channel in [single, double] {
        let (channels, none) = ([channel], RecordContext::default());
        let sizes = frames_round_trip(&[(&channels[..], &none); 3]);
        let bits = 8.0 * sizes[0] as f64 / values.len() as f64;
        // The noise takes 4 bits, and each of some 600 values a few bytes. They are too many for levels.
        assert!(bits < 7.0, "{bits} bits a value");
        assert!(sizes.is_sorted_by(|before, after| before >= after), "{sizes:?}");
    }
}

#[test]
fn times_of_firings_are_explained_by_the_ring() {
    let returns = returns();
    let ring = channel("ring", ScalarType::U16, returns.iter().map(|n| ((n % 16) as u16).to_le_bytes()));
    let time = |n: &u32| {
        ((1_600_000_000_000_000u64 + u64::from(n / 16 * 55 + n % 16 * 2)) as f64 / 1e6).to_le_bytes()
    };
    let time = channel("time", ScalarType::F64, returns.iter().map(time));
    let rings = round_trip(std::slice::from_ref(&ring), &RecordContext::default());
    let both = round_trip(&[time, ring], &RecordContext::default());
    assert!(both - rings < RECORDS as usize / 40, "{both} bytes, {rings} of rings");
}

/// The context of returns of a scanner of 16 beams whose ticks are hundredths of degrees.
fn context_of_firings(returns: &[u32]) -> RecordContext {
    RecordContext {
        rows: returns.iter().map(|n| n % 16 + 1).collect(),
        columns: returns.iter().map(|n| n / 16 + 1).collect(),
        steps: returns.iter().map(|&n| 500 + noise(n) % 30_000).collect(),
        ticks: returns.iter().map(|n| n / 16 * 20 % 36_000).collect(),
        range_step_m: 0.002,
        tick_degrees: 0.01,
        ..RecordContext::default()
    }
}

#[test]
fn what_follows_from_range_and_tick_costs_next_to_nothing() {
    let returns = returns();
    let context = context_of_firings(&returns);
    let steps = || context.steps.iter();
    let turned = |row: u32, tick: u32| tick as i32 + (row * 37 % 11) as i32 - 5;
    let ticks = || context.rows.iter().zip(&context.ticks);
    let channels = [
        channel("single", ScalarType::F32, steps().map(|&n| (n as f32 * 0.002f32).to_le_bytes())),
        channel("rounded", ScalarType::F32, steps().map(|&n| ((f64::from(n) * 0.002) as f32).to_le_bytes())),
        channel(
            "turned",
            ScalarType::F32,
            ticks().map(|(&row, &tick)| (turned(row, tick) as f32).to_le_bytes()),
        ),
        channel(
            "radians",
            ScalarType::F32,
            ticks().map(|(_, &tick)| {
                ((f64::from(tick) * 0.01 * std::f64::consts::PI / 180.0) as f32).to_le_bytes()
            }),
        ),
        channel("backwards", ScalarType::U16, ticks().map(|(_, &tick)| (36_000 - tick as u16).to_le_bytes())),
    ];
    let size = round_trip(&channels, &context);
    assert!(size < 150, "{size} bytes");
}

#[test]
fn times_of_packets_are_known_in_all_their_firings() {
    let returns = returns();
    let context = context_of_firings(&returns);
    let time = |n: &u32| {
        // Six firings per packet; the times of packets are irregular.
        let packet = 1.6e9 + f64::from(n / 96 * 330 + noise(n / 96) % 7) * 1e-6;
        (packet + (f64::from(n / 16 % 6) * 55.296 + f64::from(n % 16) * 2.304) * 1e-6).to_le_bytes()
    };
    let size = round_trip(&[channel("time", ScalarType::F64, returns.iter().map(time))], &context);
    let packets = returns[returns.len() - 1] as usize / 96;
    assert!(size < 4 * packets, "{size} bytes of {packets} packets");
}

#[test]
fn a_column_has_one_time_in_every_line() {
    let context = RecordContext {
        rows: (0..RECORDS).map(|n| n / 500 + 1).collect(),
        columns: (0..RECORDS).map(|n| n % 500 + 1).collect(),
        ..RecordContext::default()
    };
    let time = |n: u32| (n % 500 * 97_656 + noise(n % 500) % 9000).to_le_bytes();
    let size = round_trip(&[channel("t", ScalarType::U32, (0..RECORDS).map(time))], &context);
    assert!(size < 3 * 500, "{size} bytes");
}

#[test]
fn the_range_in_millimetres_follows_from_the_steps() {
    let steps = |n: u32| 500 + noise(n) % 3000;
    let context = RecordContext {
        rows: (0..RECORDS).map(|n| n % 16 + 1).collect(),
        columns: (0..RECORDS).map(|n| n / 16 + 1).collect(),
        steps: (0..RECORDS).map(steps).collect(),
        ticks: (0..RECORDS).map(|n| n / 16).collect(),
        range_step_m: 0.008,
        ..RecordContext::default()
    };
    let size = round_trip(
        &[channel("range", ScalarType::U32, (0..RECORDS).map(|n| (8 * steps(n)).to_le_bytes()))],
        &context,
    );
    assert!(size < 40, "{size} bytes");
    // Without an image, the distance of the position says nearly the same.
    let positions = (0..RECORDS).map(|n| [0.0, 0.008 * steps(n) as f32 - 0.004, 0.0]).collect();
    let context = RecordContext { positions, ..RecordContext::default() };
    let size = round_trip(
        &[channel("range", ScalarType::U32, (0..RECORDS).map(|n| (8 * steps(n)).to_le_bytes()))],
        &context,
    );
    assert!(size < 200, "{size} bytes");
}

/// A picture of 40 smooth levels with a little noise, as packed colours, row after row from the bottom.
fn grey_picture() -> (Channel, RecordContext) {
    grey_picture_of(0)
}

/// The same with other noise.
fn grey_picture_of(number: u32) -> (Channel, RecordContext) {
    let grey = |n: u32| 30 + n % 200 / 5 + n / 200 / 2 % 3 + noise(n + number * RECORDS) % 2;
    let context = RecordContext {
        rows: (0..RECORDS).map(|n| 21 - n / 200).collect(),
        columns: (0..RECORDS).map(|n| n % 200 + 1).collect(),
        ..RecordContext::default()
    };
    let packed = |n: u32| f32::from_bits(grey(n) * 0x0001_0101).to_le_bytes();
    (channel("rgb", ScalarType::F32, (0..RECORDS).map(packed)), context)
}

#[test]
fn grey_levels_take_what_their_neighbours_leave_open() {
    let (picture, context) = grey_picture();
    let size = round_trip(&[picture], &context);
    // One bit of noise, and as much again for what the models do not know.
    assert!(size < 2 * RECORDS as usize / 8, "{size} bytes");
}

#[test]
fn light_follows_from_its_neighbours_and_the_frame_before() {
    const RECORDS: u32 = 32_000;
    // A picture of waves whose noise grows with the root of the light; nearer values are likelier; column by
    // column.
    let light = |n: u32| {
        let wave = (f64::from(n / 40) / 5.0 + f64::from(n % 40) / 3.0).sin();
        let noise = f64::from(noise(n) % 64 + noise(n + 99_999) % 64) / 64.0 - 1.0;
        (60.0 + 40.0 * wave + noise).powi(2)
    };
    let context = RecordContext {
        rows: (0..RECORDS).map(|n| n % 40 + 1).collect(),
        columns: (0..RECORDS).map(|n| n / 40 + 1).collect(),
        ..RecordContext::default()
    };
    let ambient = channel("ambient", ScalarType::U16, (0..RECORDS).map(|n| (light(n) as u16).to_le_bytes()));
    let bits = 8.0 * round_trip(&[ambient], &context) as f64 / f64::from(RECORDS);
    // Without the plan for images it takes 5.6.
    assert!(bits < 4.0, "{bits} bits a record");
}

#[test]
fn the_same_in_another_type_and_constants_cost_nothing() {
    let values = || (0..RECORDS).map(|n| noise(n) % 256);
    let intensity: Vec<f32> = values().map(|n| n as f32).collect();
    let context = RecordContext { intensity, ..RecordContext::default() };
    let channels = [
        channel("reflectivity", ScalarType::U16, values().map(|n| (n as u16).to_le_bytes())),
        channel("again", ScalarType::F64, values().map(|n| f64::from(n).to_le_bytes())),
        Channel {
            field: Field::padding(12),
            bytes: [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12].repeat(RECORDS as usize),
        },
        channel("return_type", ScalarType::U8, (0..RECORDS).map(|_| [3])),
    ];
    let size = round_trip(&channels, &context);
    assert!(size < 40, "{size} bytes");
}

#[test]
fn what_follows_from_the_position_costs_little() {
    let metres = |n: u32| f64::from(2000 + noise(n) % 5000) * 0.002;
    let angle = |n: u32| f64::from(n * 20) * 0.01 * std::f64::consts::PI / 180.0;
    let positions = (0..RECORDS)
        .map(|n| {
            let (metres, angle) = (metres(n), angle(n));
            [(metres * libm::sin(angle)) as f32, (metres * libm::cos(angle)) as f32, 0.25]
        })
        .collect();
    let context = RecordContext { positions, ..RecordContext::default() };
    let distance = |n: u32| {
        let metres = metres(n);
        ((metres * metres + 0.0625).sqrt() as f32).to_le_bytes()
    };
    let channels = [channel("distance", ScalarType::F32, (0..RECORDS).map(distance))];
    let size = round_trip(&channels, &context);
    assert!(size < RECORDS as usize / 2, "{size} bytes");
}

#[test]
fn what_repeats_far_away_is_compressed() {
    // Bytes without a rule that recur, but not after a fixed number of records.
    let turn: Vec<u8> = (0..20_000).map(|n| noise(n) as u8).collect();
    let field = Field { count: 20, ..Field::padding(1) };
    let bytes = [&turn[..], &turn[..7000], &turn[..], &turn[..9000]].concat();
    for compressors in [Compressors::Fast, Compressors::Slow, Compressors::All] {
        let channels = [Channel { field: field.clone(), bytes: bytes.clone() }];
        let mut encoder = ArithmeticEncoder::default();
        ChannelsModel::default()
            .code(&mut encoder, &mut channels.clone(), &RecordContext::default(), compressors, u64::MAX)
            .unwrap();
        let coded = encoder.finish();
        assert!(coded.len() < 21_000, "{} bytes", coded.len());
        let mut decoded = empty(&channels);
        ChannelsModel::default()
            .code(
                &mut ArithmeticDecoder::new(&coded),
                &mut decoded,
                &RecordContext::default(),
                compressors,
                u64::MAX,
            )
            .unwrap();
        assert_eq!(decoded, channels);
    }
}

/// The records of a frame that begins with this firing of a packet, their firings counted from that of the
/// packet.
fn frame_from(firing: u32) -> (Vec<u32>, RecordContext) {
    let returns: Vec<u32> = returns().iter().map(|n| n + 16 * firing).collect();
    let mut context = context_of_firings(&returns);
    context.columns.iter_mut().for_each(|column| *column -= firing);
    (returns, context)
}

#[test]
fn frames_that_begin_within_a_packet_know_its_firings_from_those_before() {
    let time = |n: &u32| {
        // Twelve firings per packet, each of which has a time of its own.
        let packet = 1.6e9 + f64::from(n / 192 * 700 + noise(n / 192) % 50) * 1e-6;
        (packet + f64::from(noise(n % 192) % 600) * 1e-6).to_le_bytes()
    };
    let frames = [0, 5, 11].map(|firing| {
        let (returns, context) = frame_from(firing);
        (vec![channel("time", ScalarType::F64, returns.iter().map(time))], context)
    });
    let sizes = frames_round_trip(&frames.each_ref().map(|(channels, context)| (&channels[..], context)));
    let packets = 2 * RECORDS as usize / 192;
    assert!(sizes[1..].iter().all(|&size| size < 6 * packets), "{sizes:?} bytes of {packets} packets");
}

#[test]
fn times_that_were_added_in_single_precision_take_little() {
    let (returns, context) = frame_from(0);
    let start = |packet: u32| (f64::from(packet * 1327 + noise(packet) % 60) * 1e-6) as f32;
    let time = |n: &u32| {
        let of_firing = (f64::from(n / 16 % 24) * 55.296 + f64::from(n % 16) * 2.304) * 1e-6;
        of_firing as f32 + start(n / 384)
    };
    let times = || returns.iter().map(|n| time(n).to_le_bytes());
    let size = round_trip(&[channel("time", ScalarType::F32, times())], &context);
    let packets = 2 * RECORDS as usize / 384;
    assert!(size < 20 * packets, "{size} bytes of {packets} packets");
}

/// Codes and decodes arbitrary integers by a rule; `are_singles`: they are ranks of float32 values.
fn round_trip_by(rule: Rule, are_singles: bool, sites: &[(u8, u8, Option<i64>)], integers: &[i64]) {
    let site = |&(key, column, geometry): &(u8, u8, Option<i64>)| Site {
        key: key.into(),
        column: column.into(),
        geometry,
        lagged: None,
    };
    let mut encoder = ArithmeticEncoder::default();
    let (mut writer, mut reader) = (RuleModel::default(), RuleModel::default());
    writer.prepare(rule, are_singles);
    reader.prepare(rule, are_singles);
    let known = || sites.iter().map(site).zip(integers.iter().copied()).map(Some);
    writer.code_phase(&mut encoder, rule, known());
    let (doubts, _) = writer.code_doubts(&mut encoder, rule, known());
    for (record, (at, &integer)) in sites.iter().zip(integers).enumerate() {
        assert_eq!(writer.code(&mut encoder, rule, doubts, record, &site(at), integer), integer);
    }
    let bytes = encoder.finish();
    let mut decoder = ArithmeticDecoder::new(&bytes);
    reader.code_phase(&mut decoder, rule, known());
    assert_eq!(reader.code_doubts(&mut decoder, rule, known()).0, doubts);
    for (record, (at, &integer)) in sites.iter().zip(integers).enumerate() {
        assert_eq!(reader.code(&mut decoder, rule, doubts, record, &site(at), 0), integer);
    }
}

/// A way to code a column.
#[derive(Clone, Copy, Debug)]
enum Way {
    Rule(Rule),
    Levels,
    Image,
}

/// Codes frames of a column in some way, with one model for all of them, and checks that they are restored.
/// Values are whole numbers or, off the scale, halves; `places` has the row and the column of each record.
fn frames_round_trip_by(way: Way, places: &[(u8, u8)], frames: &[Vec<f32>]) {
    let scale = Scale::from_code(1).unwrap();
    let has_exceptions = frames.iter().flatten().any(|value| value.fract() != 0.0);
    let plan = match way {
        Way::Rule(rule) => {
            Plan::Integers(Integers { scale, has_exceptions, rule: Some(rule), ..Integers::default() })
        }
        Way::Levels => Plan::Levels(Levels { scale, has_exceptions }),
        Way::Image => Plan::Image(Image { scale, has_exceptions, divisor: 1 }),
    };
    let context = RecordContext {
        rows: places.iter().map(|place| place.0.into()).collect(),
        columns: places.iter().map(|place| place.1.into()).collect(),
        ..RecordContext::default()
    };
    let images = ImageSize { cells: 0, most: 0 };
    let sources = Sources { channels: &[], known: &[], context: &context, images };
    let (mut writer, mut reader) = (ColumnModel::new(true), ColumnModel::new(true));
    for frame in frames {
        let mut bytes: Vec<u8> = frame.iter().flat_map(|value| value.to_le_bytes()).collect();
        let mut encoder = ArithmeticEncoder::default();
        writer.code(&mut encoder, &plan, &sources, ScalarType::F32, &mut bytes).unwrap();
        let coded = encoder.finish();
        let mut decoded = vec![0; bytes.len()];
        let mut decoder = ArithmeticDecoder::new(&coded);
        reader.code(&mut decoder, &plan, &sources, ScalarType::F32, &mut decoded).unwrap();
        assert_eq!(decoded, bytes);
    }
}

#[test]
fn images_of_channels_have_no_more_cells_than_allowed() {
    let (picture, context) = grey_picture();
    let channels = [picture];
    let code = |most_cells: u64| {
        let mut encoder = ArithmeticEncoder::default();
        let mut model = ChannelsModel::default();
        let cells =
            model.code(&mut encoder, &mut channels.clone(), &context, Compressors::default(), most_cells);
        (cells.unwrap(), encoder.finish())
    };
    let decode = |bytes: &[u8], most_cells: u64| {
        let (mut decoder, mut decoded) = (ArithmeticDecoder::new(bytes), empty(&channels));
        let mut model = ChannelsModel::default();
        model.code(&mut decoder, &mut decoded, &context, Compressors::default(), most_cells).map(|_| decoded)
    };
    let (cells, bytes) = code(u64::MAX);
    assert_eq!(cells, 22 * 201);
    assert_eq!(decode(&bytes, cells).unwrap(), channels);
    assert!(matches!(decode(&bytes, cells - 1), Err(Error::LimitExceeded { .. })));
    // An encoder finds another way.
    let (none, bytes) = code(cells - 1);
    assert_eq!(none, 0);
    assert_eq!(decode(&bytes, 0).unwrap(), channels);
}

#[test]
fn levels_may_all_be_off_the_scale() {
    frames_round_trip_by(Way::Levels, &[(0, 0), (1, 1)], &[vec![1.0, 2.0], vec![0.5; 2], vec![2.0, 0.5]]);
}

#[test]
fn only_the_first_columns_are_coded_as_levels() {
    let (_, context) = grey_picture();
    let channels: Vec<_> = (0..COLUMNS_WITH_LEVELS as u32 + 4).map(|n| grey_picture_of(n).0).collect();
    let code = |mut model: ChannelsModel| {
        let mut encoder = ArithmeticEncoder::default();
        let all = Compressors::default();
        model.code(&mut encoder, &mut channels.clone(), &context, all, u64::MAX).unwrap();
        let have_levels = model.columns.iter().map(|column| column.levels.is_some()).collect::<Vec<_>>();
        (have_levels, encoder.finish())
    };
    let decode = |bytes: &[u8]| {
        let (mut decoder, mut decoded) = (ArithmeticDecoder::new(bytes), empty(&channels));
        let decoded = ChannelsModel::default()
            .code(&mut decoder, &mut decoded, &context, Compressors::default(), u64::MAX)
            .map(|_| decoded);
        decoded.map_err(|error| error.to_string())
    };
    let (have_levels, bytes) = code(ChannelsModel::default());
    assert_eq!(have_levels.iter().rposition(|has| *has), Some(COLUMNS_WITH_LEVELS - 1));
    assert_eq!(decode(&bytes).unwrap(), channels);
    // An encoder that does not keep to this.
    let columns = vec![ColumnModel::new(true); channels.len()];
    let (have_levels, bytes) = code(ChannelsModel { columns, ..ChannelsModel::default() });
    assert_eq!(have_levels.last(), Some(&true));
    assert!(decode(&bytes).unwrap_err().contains("too high a number"));
}

#[test]
fn more_columns_than_have_models_come_back() {
    let values = |n: u32| {
        channel(&format!("c{n}"), ScalarType::U8, (0..300).map(move |at| [noise(at * 100 + n) as u8 & 3]))
    };
    let channels: Vec<Channel> = (0..70).map(values).collect();
    round_trip(&channels, &RecordContext::default());
}

/// Values of any type that are sometimes similar to those before them.
fn any_channel(records: usize) -> impl Strategy<Value = Channel> {
    let values = prop::collection::vec(any::<[u8; 8]>(), records * 3);
    (values, 0u8..10, 1u32..4, 0u8..4, any::<bool>()).prop_map(
        move |(values, number, count, kind, is_named)| {
            let scalar = ScalarType::from_number(number).unwrap();
            let size = scalar.size() as usize;
            let mut bytes = Vec::new();
            for (n, value) in values.iter().take(records * count as usize).enumerate() {
                let value = match kind {
                    0 => *value,
                    1 => [value[0] & 1, 0, 0, 0, 0, 0, 0, 0],
                    2 => (n as f64 / 100.0).to_le_bytes(),
                    _ => [7; 8],
                };
                bytes.extend_from_slice(&value[8 - size..]);
            }
            let name = if is_named { "a" } else { "" }.to_owned();
            Channel { field: Field { name, scalar, count }, bytes }
        },
    )
}

proptest! {
    #[test]
    fn any_channels_come_back(
        (channels, rows) in (0usize..50).prop_flat_map(|records| {
            let channels = prop::collection::vec(any_channel(records), 0..5);
            (channels, prop::collection::vec(0u32..5, records))
        }),
        has_image: bool,
    ) {
        let rows = if has_image { rows } else { Vec::new() };
        let (columns, steps) = (rows.clone(), rows.clone());
        let ticks = rows.clone();
        let context = RecordContext { rows, columns, steps, ticks, range_step_m: 0.01, tick_degrees: 0.1, ..RecordContext::default() };
        round_trip(&channels, &context);
    }

    #[test]
    fn any_integers_come_back_by_any_rule(
        code in 1u8..,
        are_singles: bool,
        records in prop::collection::vec(((0u8..4, 0u8..9, any::<Option<i64>>()), any::<i64>(), 0i64..3), 0..60),
    ) {
        let rule = Rule::from_code(code).unwrap();
        prop_assert_eq!(Rule::to_code(Some(rule)), code);
        let (sites, integers): (Vec<_>, Vec<_>) = records
            .into_iter()
            .map(|(site, any, small)| (site, if any % 3 == 0 { any } else { small }))
            .unzip();
        round_trip_by(rule, are_singles, &sites, &integers);
    }

    #[test]
    fn frames_come_back_in_any_way(
        records in prop::collection::vec((0u8..3, 0u8..20), 1..60),
        values in prop::collection::vec(prop::collection::vec(0u8..6, 60), 1..4),
        repeats in 1usize..4,
        code in 0u8..10,
        has_off: bool,
    ) {
        let way = if code == 9 { Way::Image } else { Rule::from_code(code).map_or(Way::Levels, Way::Rule) };
        // Repeated values follow from those before them; 5 stands for a value off the scale.
        let value = |value: &u8| if *value == 5 && has_off { 0.5 } else { f32::from(*value / 2) };
        let frames = values.iter().map(|values| values.iter().take(records.len()).map(value).collect());
        let frames: Vec<Vec<f32>> = frames.flat_map(|frame: Vec<f32>| std::iter::repeat_n(frame, repeats)).collect();
        frames_round_trip_by(way, &records, &frames);
    }

    #[test]
    fn any_bytes_decode_to_channels_or_an_error(bytes: Vec<u8>, channels in prop::collection::vec(any_channel(20), 1..4)) {
        let mut decoded = empty(&channels);
        let mut decoder = ArithmeticDecoder::new(&bytes);
        drop(ChannelsModel::default().code(&mut decoder, &mut decoded, &RecordContext::default(), Compressors::default(), u64::MAX));
    }
}
