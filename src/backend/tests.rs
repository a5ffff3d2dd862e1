//! Tests that every back-end of the registry must pass.

use proptest::prelude::*;

use super::*;

/// Bytes like those of residuals: mostly small numbers, a few larger ones.
fn residual_like(length: usize) -> Vec<u8> {
    let mut state = 12345u32;
    let mut next = || {
        state = state.wrapping_mul(1664525).wrapping_add(1013904223);
        state >> 24
    };
    (0..length).map(|_| (next() as u8 & next() as u8 & next() as u8) >> (next() % 4)).collect()
}

fn comes_back(backend: &dyn Backend, bytes: &[u8], level: Level) -> usize {
    let packed = backend.compress(bytes, level).unwrap();
    let name = backend.name();
    assert!(decompress(backend, &packed, bytes.len()).unwrap() == bytes, "{name} at {level:?}");
    packed.len()
}

#[test]
fn numbers_and_names_are_unique_and_found() {
    for backend in BACKENDS {
        assert_eq!(by_id(backend.id()).unwrap().name(), backend.name());
        assert_eq!(by_name(backend.name()).unwrap().id(), backend.id());
    }
    assert!(by_id(200).is_err());
    assert_eq!(by_id(LZMA).unwrap().name(), "lzma");
}

#[test]
fn all_bytes_come_back_at_every_level() {
    let residuals = residual_like(3000);
    for backend in BACKENDS {
        for level in Level::all() {
            for bytes in [&[][..], &[7], &[0; 2000], &residuals] {
                comes_back(*backend, bytes, level);
            }
        }
    }
}

#[test]
fn residuals_get_smaller() {
    let residuals = residual_like(60_000);
    for backend in BACKENDS.iter().filter(|backend| backend.name() != "store") {
        let size = comes_back(*backend, &residuals, Level::default());
        assert!(size < 55_000, "{}: {size}", backend.name());
        assert!(comes_back(*backend, &[0; 100_000], Level::default()) < 1000, "{}", backend.name());
    }
}

#[test]
fn damage_never_changes_the_length() {
    let residuals = residual_like(300);
    for backend in BACKENDS {
        let packed = backend.compress(&residuals, Level::default()).unwrap();
        for length in 0..packed.len() {
            if let Ok(bytes) = decompress(*backend, &packed[..length], residuals.len()) {
                assert_eq!(bytes.len(), residuals.len());
            }
        }
        for bit in (0..packed.len() * 8).step_by(5) {
            let mut damaged = packed.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            if let Ok(bytes) = decompress(*backend, &damaged, residuals.len()) {
                assert_eq!(bytes.len(), residuals.len());
            }
        }
    }
}

#[test]
fn another_decoder_reads_our_lzma() {
    let residuals = residual_like(5000);
    let packed = by_id(LZMA).unwrap().compress(&residuals, Level::default()).unwrap();
    let mut file = vec![packed[0]];
    file.extend(5000u32.to_le_bytes());
    file.extend(5000u64.to_le_bytes());
    file.extend(&packed[1..]);
    let mut decoded = Vec::new();
    lzma_rs::lzma_decompress(&mut &file[..], &mut decoded).unwrap();
    assert!(decoded == residuals);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn any_bytes_come_back(bytes in prop::collection::vec(any::<u8>(), 0..600), level in 1u8..=9) {
        for backend in BACKENDS {
            comes_back(*backend, &bytes, Level::new(level).unwrap());
        }
    }
}

#[test]
fn trials_tell_only_clear_differences() {
    for (coder, models, result) in [
        (1000, 1000, Verdict::Open),
        (1010, 1000, Verdict::Open),
        (1000, 1010, Verdict::Open),
        (1020, 1000, Verdict::Lost(4.0)),
        (1000, 1020, Verdict::Won(4.0)),
        (1000, usize::MAX, Verdict::Won(4.0)),
    ] {
        assert_eq!(Verdict::of(coder, models, 4.0), result, "{coder} and {models} bytes");
    }
}

#[test]
fn trials_hold_for_frames_that_are_alike() {
    for (likeness, is_alike) in [(3.4, false), (3.6, true), (4.0, true), (4.4, true), (4.6, false)] {
        assert_eq!(Verdict::Lost(4.0).has_lost(|| likeness), is_alike, "{likeness}");
        assert_eq!(Verdict::Won(4.0).has_won(|| likeness), is_alike, "{likeness}");
        assert!(!Verdict::Won(4.0).has_lost(|| likeness) && !Verdict::Lost(4.0).has_won(|| likeness));
    }
    assert!(!Verdict::Open.has_lost(|| 0.0) && !Verdict::Lost(f64::NAN).has_lost(|| f64::NAN));
    let verdict = Verdict::of(2000, 1000, Verdict::likeness(&residual_like(6000), 500));
    assert!(verdict.has_lost(|| Verdict::likeness(&residual_like(3000), 250)), "{verdict:?}");
    assert!(!verdict.has_lost(|| Verdict::likeness(&[0; 6000], 500)), "{verdict:?}");
}
