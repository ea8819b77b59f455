//! How much of a file may go to the decoder: whole messages whose stated sizes are possible.
//!
//! The decoder and the Arrow reader allocate the stated size before the data is there. An impossible size aborts the
//! process, and no guard catches that. Sizes are therefore compared with the bytes first.

use rerun::external::arrow::ipc::root_as_message;
use rerun::external::re_log_encoding::external::lz4_flex::block::decompress;
use rerun::external::re_log_encoding::{Decodable as _, MessageHeader, MessageKind, StreamHeader};

/// LZ4 expands one byte to at most this many.
const LZ4_RATIO_MAX: usize = 256;
/// The largest message, uncompressed, bytes; this program's messages are far below.
const MESSAGE_BYTES_MAX: usize = 1 << 27;
/// The marker before a message of an Arrow stream, in place of a length.
const CONTINUES: [u8; 4] = [0xff; 4];

/// Length of the file's head and its whole, credible messages.
pub(crate) fn credible_bytes(bytes: &[u8]) -> usize {
    let mut end = StreamHeader::ENCODED_SIZE_BYTES;
    while let Some((kind, message)) = message_at(bytes, end) {
        match kind {
            // An index follows, which is not read.
            MessageKind::End => break,
            MessageKind::ArrowMsg if chunk_is_credible(message).is_none() => break,
            MessageKind::ArrowMsg | MessageKind::SetStoreInfo | MessageKind::BlueprintActivationCommand => {}
        }
        end += MessageHeader::ENCODED_SIZE_BYTES + message.len();
    }
    end.min(bytes.len())
}

fn message_at(bytes: &[u8], at: usize) -> Option<(MessageKind, &[u8])> {
    let (header, rest) = bytes.get(at..)?.split_at_checked(MessageHeader::ENCODED_SIZE_BYTES)?;
    let header = MessageHeader::from_rrd_bytes(header).ok()?;
    Some((header.kind, rest.get(..usize::try_from(header.len).ok()?)?))
}

/// `Some` if a chunk's sizes are possible: its own, and those of the Arrow stream in it.
fn chunk_is_credible(message: &[u8]) -> Option<()> {
    let (mut compression, mut size, mut payload) = (0, 0, &[][..]);
    let mut rest = message;
    // The protocol buffer `ArrowMsg`: only these three fields set how much is allocated.
    while !rest.is_empty() {
        let key = varint(&mut rest)?;
        match (key >> 3, key & 7) {
            (2, 0) => compression = varint(&mut rest)?,
            (3, 0) => size = varint(&mut rest)?,
            (field, 2) => {
                let length = usize::try_from(varint(&mut rest)?).ok()?;
                let bytes = take(&mut rest, length)?;
                if field == 5 {
                    payload = bytes;
                }
            }
            (_, 0) => drop(varint(&mut rest)?),
            (_, 1) => drop(take(&mut rest, 8)?),
            (_, 5) => drop(take(&mut rest, 4)?),
            _ => return None,
        }
    }
    let size = usize::try_from(size).ok()?;
    if size > MESSAGE_BYTES_MAX || size / LZ4_RATIO_MAX > payload.len() {
        return None;
    }
    match compression {
        // Not compressed: the value 1, or absent.
        0 | 1 => stream_is_credible(payload),
        _ => stream_is_credible(&decompress(payload, size).ok()?),
    }
}

/// `Some` if every message of an Arrow stream has its stated length.
fn stream_is_credible(mut stream: &[u8]) -> Option<()> {
    while !stream.is_empty() {
        let mut length = take(&mut stream, 4)?;
        if length == CONTINUES {
            length = take(&mut stream, 4)?;
        }
        let length = u32::from_le_bytes(length.try_into().ok()?);
        if length == 0 {
            break;
        }
        let message = root_as_message(take(&mut stream, usize::try_from(length).ok()?)?).ok()?;
        take(&mut stream, usize::try_from(message.bodyLength()).ok()?)?;
        // Compressed again inside, with its own sizes: this program writes none of those.
        if message.header_as_record_batch().is_some_and(|batch| batch.compression().is_some()) {
            return None;
        }
    }
    Some(())
}

fn take<'a>(rest: &mut &'a [u8], length: usize) -> Option<&'a [u8]> {
    let (front, left) = rest.split_at_checked(length)?;
    *rest = left;
    Some(front)
}

/// A number of a protocol buffer.
fn varint(rest: &mut &[u8]) -> Option<u64> {
    let mut number = 0;
    for shift in (0..64).step_by(7) {
        let byte = *take(rest, 1)?.first()?;
        number |= u64::from(byte & 0x7f) << shift;
        if byte < 0x80 {
            return Some(number);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn recording() -> Vec<u8> {
        let file = "../../tests/fixtures/store-4831bf5/store/recordings/align-1.1.0-08189f45.rrd";
        std::fs::read(std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(file)).unwrap()
    }

    /// The starts of all messages, and where the file's index begins.
    fn starts(bytes: &[u8]) -> Vec<usize> {
        let mut starts = vec![StreamHeader::ENCODED_SIZE_BYTES];
        while let Some((kind, message)) = message_at(bytes, starts[starts.len() - 1])
            && kind != MessageKind::End
        {
            starts.push(starts[starts.len() - 1] + MessageHeader::ENCODED_SIZE_BYTES + message.len());
        }
        starts
    }

    #[test]
    fn intact_recording_is_credible_up_to_its_index() {
        let bytes = recording();
        let starts = starts(&bytes);
        assert!(starts.len() > 3, "{starts:?}");
        assert_eq!(Some(&credible_bytes(&bytes)), starts.last());
    }

    /// Each of these sizes aborted the process: they cannot be allocated, and no panic can be caught.
    #[test]
    fn impossible_sizes_end_the_credible_part() {
        let good = recording();
        let starts = starts(&good);
        let third = starts[2];
        let mut long = good.clone();
        long[third + 8..third + 16].copy_from_slice(&(u64::MAX / 3).to_le_bytes());
        assert_eq!(credible_bytes(&long), third);
        // The uncompressed size of a chunk, in place of the start of the message.
        let payload = third + MessageHeader::ENCODED_SIZE_BYTES;
        let mut swollen = good.clone();
        swollen[payload] = 3 << 3;
        swollen[payload + 1..payload + 10].fill(0xff);
        swollen[payload + 10] = 1;
        assert_eq!(credible_bytes(&swollen), third);
        let folder = tempfile::tempdir().unwrap();
        for (name, bytes) in [("long.rrd", long), ("swollen.rrd", swollen)] {
            let file = folder.path().join(name);
            std::fs::write(&file, &bytes).unwrap();
            if let Err(error) = crate::read(&file) {
                assert!(error.to_string().contains(name), "{error}");
            }
        }
    }

    #[test]
    fn an_arrow_stream_has_its_stated_length() {
        assert_eq!(stream_is_credible(&[0xff, 0xff, 0xff, 0xff, 0, 0, 0, 0]), Some(()));
        assert_eq!(stream_is_credible(&[0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x7f]), None);
        assert_eq!(stream_is_credible(&[8, 0, 0, 0, 1]), None);
    }
}
