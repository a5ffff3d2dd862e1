//! The types of values, and values of any type. FORMAT.md 8.1.

/// The type of a value in a record. All types are little-endian in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ScalarType {
    /// Signed 8-bit integer.
    I8,
    /// Unsigned 8-bit integer.
    U8,
    /// Signed 16-bit integer.
    I16,
    /// Unsigned 16-bit integer.
    U16,
    /// Signed 32-bit integer.
    I32,
    /// Unsigned 32-bit integer.
    U32,
    /// Signed 64-bit integer.
    I64,
    /// Unsigned 64-bit integer.
    U64,
    /// IEEE 754 single precision.
    F32,
    /// IEEE 754 double precision.
    F64,
}

impl ScalarType {
    /// Every scalar, at the index of its number in the serialised form.
    const ALL: [ScalarType; 10] = {
        use ScalarType::*;
        [I8, U8, I16, U16, I32, U32, I64, U64, F32, F64]
    };

    /// Bytes of one value.
    pub fn size(self) -> u32 {
        match self {
            ScalarType::I8 | ScalarType::U8 => 1,
            ScalarType::I16 | ScalarType::U16 => 2,
            ScalarType::I32 | ScalarType::U32 | ScalarType::F32 => 4,
            ScalarType::I64 | ScalarType::U64 | ScalarType::F64 => 8,
        }
    }

    /// The type with this number in the serialised form.
    pub fn from_number(number: u8) -> Option<Self> {
        Self::ALL.get(usize::from(number)).copied()
    }

    /// Its name in a list of fields: `u8`, `f32` and so on.
    pub fn name(self) -> &'static str {
        ["i8", "u8", "i16", "u16", "i32", "u32", "i64", "u64", "f32", "f64"][self as usize]
    }

    /// The type with this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|scalar| scalar.name() == name)
    }

    /// A value of this type, from its bytes; `None` if there are too few.
    pub fn number(self, bytes: &[u8]) -> Option<Number> {
        fn of<const N: usize, T, V>(
            bytes: &[u8],
            make: fn([u8; N]) -> T,
            number: fn(V) -> Number,
        ) -> Option<Number>
        where
            V: From<T>,
        {
            bytes.first_chunk().map(|bytes| number(make(*bytes).into()))
        }
        match self {
            ScalarType::I8 => of(bytes, i8::from_le_bytes, Number::Integer),
            ScalarType::U8 => of(bytes, u8::from_le_bytes, Number::Integer),
            ScalarType::I16 => of(bytes, i16::from_le_bytes, Number::Integer),
            ScalarType::U16 => of(bytes, u16::from_le_bytes, Number::Integer),
            ScalarType::I32 => of(bytes, i32::from_le_bytes, Number::Integer),
            ScalarType::U32 => of(bytes, u32::from_le_bytes, Number::Integer),
            ScalarType::I64 => of(bytes, i64::from_le_bytes, Number::Integer),
            ScalarType::U64 => of(bytes, u64::from_le_bytes, Number::Integer),
            ScalarType::F32 => of(bytes, f32::from_le_bytes, Number::Float),
            ScalarType::F64 => of(bytes, f64::from_le_bytes, Number::Float),
        }
    }

    /// True for the two floating-point types.
    pub fn is_float(self) -> bool {
        matches!(self, ScalarType::F32 | ScalarType::F64)
    }
}

/// A value of any type, exactly. All values of a type are of the same variant.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub enum Number {
    /// A value of an integer type.
    Integer(i128),
    /// A value of a floating-point type.
    Float(f64),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scalars_are_numbered_by_their_place() {
        for (number, scalar) in ScalarType::ALL.iter().enumerate() {
            assert_eq!(*scalar as usize, number);
        }
    }
}
