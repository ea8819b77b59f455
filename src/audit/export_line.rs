//! The lines of an exported history: each value has one text, and a line that is too long is not read.
//!
//! Each value is written again and compared with its line. This refuses a list in place of an object, repeated or
//! reordered fields, blanks, other escapes and redundant values.

use std::io::{self, BufRead, Read as _, Write};

use serde::{Deserialize, Serialize};

use super::ascii_json::write_ascii_json;
use super::checkpoint::Checkpoint;
use holdpoint_approvals::SignedApproval;
use holdpoint_governance::closed_set::Lenient;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::record::AuditRecord;

/// The longest record line, bytes: its body has at most 4 MiB, and each byte may become an escape of six.
pub const LINE_BYTES_MAX: u64 = 32 << 20;
pub const SHORT_LINE_BYTES_MAX: u64 = 64 << 10;
pub const START_OF_FILE: &[u8; 10] = b"{\"export\":";
const START_OF_RECORD: &[u8] = b"{\"record\":{";

/// One line.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ExportLine {
    /// The first.
    Export(ExportHeader),
    /// A checkpoint; all stand before the records, oldest first.
    Head(Checkpoint),
    /// The signed end of the chain.
    End(Checkpoint),
    /// A record; they stand in their order.
    Record(Box<ExportedRecord>),
    /// A person's signed decision.
    Approval(Box<SignedApproval>),
}

/// The name of the form in the first line.
pub(crate) const FORMAT: &str = "holdpoint-store-export";
pub(crate) const VERSION: u32 = 1;

/// The first line.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExportHeader {
    /// The name of the form.
    pub format: String,
    pub version: u32,
    pub store_id: String,
    pub records: u64,
    /// 64 hexadecimal digits.
    pub public_key: Option<String>,
}

impl ExportHeader {
    /// The first line of a file of this program's form.
    #[must_use]
    pub fn new(store_id: String, records: u64, public_key: Option<String>) -> Self {
        Self { format: FORMAT.to_owned(), version: VERSION, store_id, records, public_key }
    }
}

/// A record in its line's form.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExportedRecord {
    seq: u64,
    prev: Digest,
    hash: Digest,
    at_ms: u64,
    kind: String,
    subject: String,
    body: String,
    wall_ms: i64,
}

impl From<AuditRecord> for ExportedRecord {
    fn from(record: AuditRecord) -> Self {
        let AuditRecord { seq, prev, hash, at_ms, kind, subject, body, wall_ms } = record;
        Self { seq, prev, hash, at_ms, kind: kind.to_string(), subject, body, wall_ms }
    }
}

impl From<ExportedRecord> for AuditRecord {
    fn from(record: ExportedRecord) -> Self {
        let ExportedRecord { seq, prev, hash, at_ms, kind, subject, body, wall_ms } = record;
        Self { seq, prev, hash, at_ms, kind: Lenient::read(kind), subject, body, wall_ms }
    }
}

impl ExportLine {
    /// Writes it with its newline.
    ///
    /// # Errors
    /// If it has no JSON form, or cannot be written.
    pub fn write(&self, mut out: impl Write) -> serde_json::Result<()> {
        write_ascii_json(&mut out, self)?;
        out.write_all(b"\n").map_err(serde_json::Error::io)
    }

    /// Reads a line with its newline, in the form of [`Self::write`].
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn parse(line: &[u8]) -> Result<Self, String> {
        if line.last() != Some(&b'\n') {
            return Err("the file is cut short in it".to_owned());
        }
        let parsed: Self = serde_json::from_slice(line).map_err(|error| error.to_string())?;
        let mut left = UnmatchedBytes(line);
        if parsed.write(&mut left).is_ok() && left.0.is_empty() {
            return Ok(parsed);
        }
        Err("it is not as it was written".to_owned())
    }
}

/// The content of a line for the comparison.
struct UnmatchedBytes<'a>(&'a [u8]);

impl Write for UnmatchedBytes<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0 = self.0.strip_prefix(bytes).ok_or(io::ErrorKind::InvalidData)?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// The next line with its end, `None` at the end of the file. Reads no more than the limit.
///
/// # Errors
/// If it cannot be read or is longer.
pub fn next_line(reader: &mut impl BufRead) -> Result<Option<Vec<u8>>, String> {
    let (mut line, mut most) = (Vec::new(), SHORT_LINE_BYTES_MAX);
    let mut read_up_to = |line: &mut Vec<u8>, bytes: u64| {
        let more = bytes.saturating_sub(line.len() as u64);
        reader.by_ref().take(more).read_until(b'\n', line).map_err(|error| error.to_string())
    };
    read_up_to(&mut line, most + 1)?;
    if line.starts_with(START_OF_RECORD) {
        most = LINE_BYTES_MAX;
        if line.last() != Some(&b'\n') {
            read_up_to(&mut line, most + 1)?;
        }
    }
    if line.len() as u64 > most {
        return Err(format!("it has more than {most} bytes, and so many are allowed"));
    }
    Ok((!line.is_empty()).then_some(line))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Reads the requested number of bytes, and counts them.
    struct EndlessReader(u64, Vec<u8>);

    impl io::Read for EndlessReader {
        fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
            let start = usize::try_from(self.0).unwrap();
            for (at, byte) in into.iter_mut().enumerate() {
                *byte = self.1.get(start + at).copied().unwrap_or(b'[');
            }
            self.0 += into.len() as u64;
            Ok(into.len())
        }
    }

    #[test]
    fn export_line_is_read_up_to_its_limit() {
        for (start, most) in [("{\"head\":{", SHORT_LINE_BYTES_MAX), ("{\"record\":{", LINE_BYTES_MAX)] {
            let mut reader = io::BufReader::new(EndlessReader(0, start.into()));
            let error = next_line(&mut reader).unwrap_err();
            assert!(error.contains(&most.to_string()), "{error}");
            let read = reader.get_ref().0;
            assert!(read <= most + (64 << 10), "{start}: {read} bytes were read");
        }
        let mut whole = vec![b' '; usize::try_from(SHORT_LINE_BYTES_MAX).unwrap() - 1];
        whole.push(b'\n');
        assert_eq!(next_line(&mut whole.as_slice()).unwrap().as_deref(), Some(whole.as_slice()));
        whole.insert(0, b' ');
        assert!(next_line(&mut whole.as_slice()).is_err());
        assert_eq!(next_line(&mut io::empty()).unwrap(), None);
    }
}
