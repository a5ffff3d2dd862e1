//! Entropy coding: adaptive binary arithmetic coding, and static coding of tokens. FORMAT.md 5 and 6.
//!
//! Every syntax element is written once, as a function over a [`BitCoder`]: the encoder's coder takes the
//! bits, the decoder's returns them. The models turn what is already known into the probability of the next
//! bit, in the same way on both sides.
//!
//! Floating point here is f32 and f64 with `+ - * / sqrt` only, which all platforms round alike; tables that
//! need more are made with `libm`.

mod adaptive;
mod arithmetic;
mod hashed;
mod layered;
mod logistic;
mod network;
mod tokens;

pub use adaptive::{AdaptiveBit, IntegerModel, code_below_highest};
pub use arithmetic::{ArithmeticDecoder, ArithmeticEncoder, BitCoder};
pub use hashed::{Candidates, HashedCounters, LINE_LEVELS, Line, hash, hash_below};
pub use layered::{LayeredBits, LayeredContext, LayeredMixer, MixContexts, MixRates};
pub use logistic::{Counter, Logistic, MixedBits};
pub use network::{Activations, Network, NetworkRates};
pub use tokens::{Counts, StartTables, TokenCoder, TokenReader, TokenTables, TokenWriter, numbers_of_token};
