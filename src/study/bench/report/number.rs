//! Numbers in human-readable form.

/// The number with this many decimals, or as many as it has; a dash if there is no value.
pub fn decimals(value: Option<f64>, decimals: Option<usize>) -> String {
    match (value, decimals) {
        (None, _) => "-".to_owned(),
        (Some(value), None) => value.to_string(),
        (Some(value), Some(decimals)) => format!("{value:.decimals$}"),
    }
}

/// The number with three or four significant digits, and no exponent.
pub fn significant(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    let whole_digits = value.abs().log10().floor() as i32 + 1;
    let decimals = (4 - whole_digits).clamp(0, 9) as usize;
    let text = format!("{value:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_the_digits_that_say_something() {
        let cases = [
            (0.0, "0"),
            (1.0, "1"),
            (7.6049, "7.605"),
            (0.000_287_6, "0.0002876"),
            (0.05, "0.05"),
            (1978.4, "1978"),
            (123_456.7, "123457"),
        ];
        for (value, expected) in cases {
            assert_eq!(significant(value), expected);
        }
        assert_eq!(decimals(Some(3.456), Some(2)), "3.46");
        assert_eq!(decimals(Some(27.12), None), "27.12");
        assert_eq!(decimals(None, Some(2)), "-");
    }
}
