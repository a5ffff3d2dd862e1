//! Static coding of tokens by an asymmetric numeral system (range ANS): a section's tokens are counted first,
//! then each is coded with the resulting frequency. Faster than adaptive coding, and nearly as small where
//! many tokens share few contexts. FORMAT.md 5.5.
//!
//! As with bits, every syntax element is written once, as a function over a [`TokenCoder`].

mod alias;
mod frequencies;
mod numbers;
mod reader;
mod tables;
mod writer;

pub use numbers::numbers_of_token;
pub use reader::TokenReader;
pub use tables::{Counts, StartTables, TokenTables};
pub use writer::TokenWriter;

use numbers::NumberToken;

/// The largest number of plain bits coded at once: they fit into eight bytes at any bit offset.
pub const MOST_BITS: u32 = 56;

/// Codes tokens and plain bits in one direction or the other.
pub trait TokenCoder {
    /// True if this side knows the tokens.
    const ENCODES: bool;

    /// Codes one token in a context. The decoder ignores `token`. Both return the token.
    fn token(&mut self, context: usize, token: u8) -> u8;

    /// Codes the lowest `count` bits of `value`, at most [`MOST_BITS`], each as likely to be 0 as 1.
    fn bits(&mut self, value: u64, count: u32) -> u64;

    /// Whether a decoder has read past the end of its bytes, so that the values it returns are meaningless.
    fn is_exhausted(&self) -> bool {
        false
    }

    /// Codes a number below 2^60: small ones as tokens of their own, larger ones by a token for their highest
    /// bits and the rest as plain bits.
    #[inline]
    fn number(&mut self, context: usize, value: u64) -> u64 {
        let known = NumberToken::of(value);
        let found = NumberToken::from_token(self.token(context, known.token));
        if found.low_bits <= 32 {
            return found.base + self.bits(known.rest, found.low_bits);
        }
        let high = self.bits(known.rest >> 32, found.low_bits - 32);
        found.base + (high << 32 | self.bits(known.rest, 32))
    }
}

#[cfg(test)]
mod tests;
