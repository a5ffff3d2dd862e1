//! Adaptive binary arithmetic coding.
//!
//! Every syntax element is written once, as a function over a [`BitCoder`]: the encoder's takes
//! the bits that it is given, the decoder's returns those of the stream. The models beside it turn
//! what is already known into the probability of the next bit; both sides run the same ones.
//!
//! Floating point here is f32 and f64 with `+ - * / sqrt` only, which all platforms round alike;
//! the tables that need more are made with `libm`.

mod adaptive;
mod adaptive_map;
mod arithmetic;
mod layered;
mod logistic;
mod tokens;

pub use adaptive::{AdaptiveBit, IntegerModel, SymbolModel};
pub use adaptive_map::AdaptiveMap;
pub use arithmetic::{ArithmeticDecoder, ArithmeticEncoder, BitCoder};
pub use layered::{LayeredBits, LayeredContext};
pub use logistic::{Counter, Logistic, MixedBits};
pub use tokens::{TokenCoder, TokenReader, TokenTables, TokenWriter};
