use super::numbers::NumberToken;
use super::*;
use proptest::prelude::*;

const CONTEXTS: usize = 5;

/// Codes tokens, numbers and bits; some contexts have only one token.
fn code<C: TokenCoder>(coder: &mut C, values: &[(usize, u64, u32)]) -> Vec<(u64, u64)> {
    let code_one = |&(context, value, count): &(usize, u64, u32)| {
        let token = coder.token(context % 2, value as u8 & 7);
        let number = coder.number(2 + context % 2, value);
        let certain = coder.token(4, 9);
        let bits = coder.bits(value, count);
        (number + u64::from(token) + u64::from(certain), bits)
    };
    values.iter().map(code_one).collect()
}

proptest! {
    #[test]
    fn tokens_come_back(
        frames in proptest::collection::vec(
            proptest::collection::vec((0usize..9, 0u64..1 << 60, 0..=MOST_BITS), 0..300), 0..4),
        small in any::<bool>(),
    ) {
        let (mut written, mut read) = (TokenTables::default(), TokenTables::default());
        for mut frame in frames {
            if small {
                frame.iter_mut().for_each(|(_, value, _)| *value %= 50);
            }
            let mut writer = TokenWriter::new(CONTEXTS);
            let coded = code(&mut writer, &frame);
            let payload = writer.finish(&mut written).unwrap();
            let mut reader = TokenReader::new(&payload, CONTEXTS, &mut read).unwrap();
            prop_assert_eq!(code(&mut reader, &frame), coded);
            prop_assert!(!reader.is_exhausted());
            let counts = reader.into_counts();
            prop_assert!(!read.lack_one(&counts));
            read.learn(&counts);
        }
    }

    #[test]
    fn any_bytes_decode_to_something(
        bytes: Vec<u8>,
        values in proptest::collection::vec((0usize..9, 0u64..9, 0..=MOST_BITS), 0..300),
    ) {
        let mut tables = TokenTables::default();
        if let Ok(mut reader) = TokenReader::new(&bytes, CONTEXTS, &mut tables) {
            code(&mut reader, &values);
        }
    }

    #[test]
    fn numbers_come_back_from_their_tokens(value in 0u64..1 << 60) {
        let token = NumberToken::of(value);
        prop_assert_eq!(token.base + token.rest, value);
        let found = NumberToken::from_token(token.token);
        prop_assert_eq!((found.base, found.low_bits), (token.base, token.low_bits));
    }
}

#[test]
fn a_payload_gives_no_tokens_without_end() {
    let mut writer = TokenWriter::new(1);
    writer.token(0, 7);
    let payload = writer.finish(&mut TokenTables::default()).unwrap();
    let mut tables = TokenTables::default();
    let mut reader = TokenReader::new(&payload, 1, &mut tables).unwrap();
    let tokens = (0..1 << 24).take_while(|_| {
        reader.token(0, 0);
        !reader.is_exhausted()
    });
    assert!(tokens.count() < 1 << 21);
}

#[test]
fn a_token_without_a_table_is_noticed() {
    let mut writer = TokenWriter::new(2);
    writer.token(0, 7);
    let payload = writer.finish(&mut TokenTables::default()).unwrap();
    for context in 0..2 {
        let mut tables = TokenTables::default();
        let mut reader = TokenReader::new(&payload, 2, &mut tables).unwrap();
        reader.token(context, 0);
        let counts = reader.into_counts();
        assert_eq!(tables.lack_one(&counts), context == 1);
    }
}

#[test]
fn a_section_of_escapes_comes_back() {
    let mut writer = TokenWriter::new(1);
    (0..100).for_each(|_| assert_eq!(writer.token(0, 255), 255));
    let payload = writer.finish(&mut TokenTables::default()).unwrap();
    let mut tables = TokenTables::default();
    let mut reader = TokenReader::new(&payload, 1, &mut tables).unwrap();
    assert!((0..100).all(|_| reader.token(0, 0) == 255) && !reader.is_exhausted());
}

#[test]
fn frequent_tokens_take_little() {
    let mut writer = TokenWriter::new(1);
    (0..100_000u32).for_each(|i| assert_eq!(writer.token(0, u8::from(i % 100 == 0)), u8::from(i % 100 == 0)));
    let payload = writer.finish(&mut TokenTables::default()).unwrap();
    // 0.081 bits per token, and the states.
    assert!(payload.len() < 1038, "{}", payload.len());
}

#[test]
fn reciprocals_divide_exactly() {
    for frequency in 1..4096u32 {
        let share = super::tables::Share::of(frequency as u16, 0);
        let end = frequency << 20;
        let near_multiples = (0..50u32).map(|i| (end / frequency / 50 * i) * frequency);
        let states = near_multiples.flat_map(|state| [state.wrapping_sub(1), state, state + 1]);
        for state in states.chain([end.wrapping_sub(1), end.wrapping_sub(frequency)]) {
            if u64::from(state) < u64::from(frequency) << 20 {
                assert_eq!(
                    share.divide(state),
                    (state / frequency, state % frequency),
                    "{state} / {frequency}"
                );
            }
        }
    }
}

/// The likeliest token takes so few bits that a word holds more than 2^15 of them.
#[test]
fn many_tokens_in_few_words_come_back() {
    let tokens = |place: usize| if place.is_multiple_of(4100) { 1u8 } else { 0 };
    let (mut written, mut read) = (TokenTables::default(), TokenTables::default());
    let mut writer = TokenWriter::new(1);
    let count = 20_000_000;
    for place in 0..count {
        writer.token(0, tokens(place));
    }
    let payload = writer.finish(&mut written).unwrap();
    let mut reader = TokenReader::new(&payload, 1, &mut read).unwrap();
    assert!((0..count).all(|place| reader.token(0, 0) == tokens(place)));
    assert!(!reader.is_exhausted());
}
