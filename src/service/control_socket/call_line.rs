//! A client's call, read from one line.
//!
//! A long line costs the time to parse it, so it is parsed on another thread than the socket's, and only once. Decides
//! nothing about the call.

use std::io;

use tokio::io::{AsyncBufRead, AsyncBufReadExt, AsyncReadExt};

use holdpoint_protocol::request_problem::request_problem;
use holdpoint_protocol::wire::{ClientMessage, PROTOCOL};

/// The longest line of an observer or of an attached console, bytes. The socket's own thread parses lines up to this length.
pub(super) const SHORT_CALL_BYTES_MAX: usize = 64 << 10;

/// A line of a client.
#[derive(Debug, PartialEq)]
pub(super) enum ReadLine {
    Call(ClientMessage),
    Nothing,
    /// A request with a field or a value that is not allowed, and why.
    Refused(String),
    /// No call, and why.
    Bad(String),
}

/// Reads the next line, of up to `bytes_max` bytes with its line break.
pub(super) async fn read_call<R: AsyncBufRead + Unpin>(
    reader: &mut R,
    bytes_max: usize,
) -> io::Result<ReadLine> {
    let mut line = Vec::new();
    let limit = bytes_max as u64 + 1;
    reader.take(limit).read_until(b'\n', &mut line).await?;
    if line.last() != Some(&b'\n') {
        let long = line.len() > bytes_max;
        let text = format!("a line has more than {bytes_max} bytes, which is not allowed");
        return Ok(if long { ReadLine::Bad(text) } else { ReadLine::Nothing });
    }
    if line.len() > SHORT_CALL_BYTES_MAX {
        return tokio::task::spawn_blocking(move || long_call(&line)).await.map_err(io::Error::other);
    }
    Ok(match serde_json::from_slice(&line) {
        Ok(call) => ReadLine::Call(call),
        Err(error) => match request_problem(&line, &error) {
            Some(problem) => ReadLine::Refused(problem),
            None => ReadLine::Bad(format!("this is no call of protocol {PROTOCOL}: {error}")),
        },
    })
}

/// The parser's error is not shown: it can quote a name of any length.
fn long_call(line: &[u8]) -> ReadLine {
    let text = || {
        format!(
            "this line of {} bytes is no call of protocol {PROTOCOL}; lines up to {SHORT_CALL_BYTES_MAX} bytes are \
             answered with the reason",
            line.len()
        )
    };
    serde_json::from_slice(line).map_or_else(|_| ReadLine::Bad(text()), ReadLine::Call)
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_protocol::command::{Command, Request};
    use holdpoint_protocol::wire::{self, CALL_BYTES_MAX};

    async fn read(line: &str, bytes_max: usize) -> ReadLine {
        read_call(&mut line.as_bytes(), bytes_max).await.unwrap()
    }

    /// The socket's thread parsed such a line a second time, and then wrote all of it out again.
    #[tokio::test]
    async fn a_long_line_that_is_no_call_is_not_compared_with_the_schema() {
        let ask = |length: usize| {
            let value = "x".repeat(length);
            format!(r#"{{"call":"ask","request":{{"id":"a","command":{{"command":"{value}"}}}}}}"#) + "\n"
        };
        let ReadLine::Refused(text) = read(&ask(1000), CALL_BYTES_MAX).await else { panic!("no request") };
        assert!(text.contains("request.command.command"), "{text}");
        let ReadLine::Bad(text) = read(&ask(SHORT_CALL_BYTES_MAX), CALL_BYTES_MAX).await else {
            panic!("no call")
        };
        assert!(!text.contains("xx") && text.len() < 200, "{text}");
    }

    #[tokio::test]
    async fn a_line_up_to_the_limit_is_read() {
        let command = Command::Stop { by: "ana".to_owned(), reason: "r".repeat(SHORT_CALL_BYTES_MAX) };
        let request = Box::new(Request::unsigned("a".to_owned(), command));
        let call = ClientMessage::Ask { request };
        let line = wire::line(&call).unwrap();
        assert_eq!(read(&line, CALL_BYTES_MAX).await, ReadLine::Call(call));
        assert!(
            matches!(read(&line, SHORT_CALL_BYTES_MAX).await, ReadLine::Bad(_)),
            "an observer's is shorter"
        );
        assert_eq!(read("", SHORT_CALL_BYTES_MAX).await, ReadLine::Nothing);
    }
}
