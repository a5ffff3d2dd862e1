//! Bytes from or to a file, and the checksum of them all.

use std::io::{self, Read, Write};

/// An input or output with the CRC-32C of all bytes that went through.
pub struct Checksummed<T> {
    inner: T,
    crc: u32,
}

impl<T> Checksummed<T> {
    /// From the first byte on.
    pub fn new(inner: T) -> Self {
        Self::resume(inner, 0)
    }

    /// After bytes with this checksum.
    pub fn resume(inner: T, crc: u32) -> Self {
        Checksummed { inner, crc }
    }

    /// The checksum of all bytes so far.
    pub fn crc(&self) -> u32 {
        self.crc
    }
}

impl<T: Read> Read for Checksummed<T> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let count = self.inner.read(bytes)?;
        self.crc = crc32c::crc32c_append(self.crc, &bytes[..count]);
        Ok(count)
    }
}

impl<T: Write> Write for Checksummed<T> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let count = self.inner.write(bytes)?;
        self.crc = crc32c::crc32c_append(self.crc, &bytes[..count]);
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner.flush()
    }
}
