//! Groups from streams to another stream, as they are.

use std::collections::HashMap;
use std::io::Write;
use std::path::PathBuf;

use crate::ground::error::Result;
use crate::stream::container::{Group, StreamHeader, StreamWriter};
use crate::stream::source::GroupJob;

/// A stream to read, and what errors call it.
#[derive(Clone, Debug)]
pub struct Named<T> {
    /// Its file, or a word for what has none.
    pub path: PathBuf,
    /// The stream.
    pub stream: T,
}

/// Writes groups of other streams, and before them the sensor models that they need, each once.
pub struct GroupCopier<W> {
    writer: StreamWriter<W>,
    /// The numbers of the sensor models written so far, by the payloads of their records.
    sensors: HashMap<Vec<u8>, u64>,
}

impl<W: Write> GroupCopier<W> {
    /// Writes the stream header.
    ///
    /// # Errors
    /// This and all other functions: if `out` fails.
    pub fn create(out: W, header: &StreamHeader) -> Result<Self> {
        Ok(GroupCopier { writer: StreamWriter::create(out, header)?, sensors: HashMap::new() })
    }

    /// Writes the next group.
    ///
    /// # Errors
    /// If the output fails.
    pub fn write(&mut self, job: GroupJob) -> Result<()> {
        let sensor_model = match &job.sensor {
            Some(sensor) => self.number_of(&sensor.record)?,
            None => 0,
        };
        self.writer.write_group(&Group { sensor_model, ..job.group })
    }

    fn number_of(&mut self, record: &[u8]) -> Result<u64> {
        if let Some(number) = self.sensors.get(record) {
            return Ok(*number);
        }
        let number = self.writer.write_sensor_model(record)?;
        self.sensors.insert(record.to_vec(), number);
        Ok(number)
    }

    /// Ends the stream; returns its size in bytes.
    ///
    /// # Errors
    /// If the output fails.
    pub fn finish(self) -> Result<u64> {
        Ok(self.writer.finish()?.1)
    }
}
