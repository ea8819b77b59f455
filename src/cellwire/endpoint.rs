//! Where a cell is: a Unix socket or a port of this machine. Opens and listens; knows no message.

use std::fmt;
use std::io;
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::os::unix::fs::PermissionsExt as _;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;

use crate::framing::WireStream;

/// What an endpoint may be, for errors.
pub const ENDPOINT_FORMS: &str =
    "unix:PATH, or tcp:ADDRESS:PORT with an address of this machine such as 127.0.0.1";

/// The longest path of a Unix socket, bytes.
const PATH_BYTES_MAX: usize = 107;

/// An address at which cells are offered.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Endpoint {
    /// A Unix socket.
    Unix(PathBuf),
    /// A port of the loopback device.
    Tcp(SocketAddr),
}

/// A text that is no endpoint.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{found:?} is no endpoint of a cell; allowed: {ENDPOINT_FORMS}")]
pub struct EndpointError {
    /// The text.
    pub found: String,
}

impl FromStr for Endpoint {
    type Err = EndpointError;
    fn from_str(text: &str) -> Result<Self, EndpointError> {
        let parsed = if let Some(path) = text.strip_prefix("unix:") {
            let is_path = (1..=PATH_BYTES_MAX).contains(&path.len()) && !path.contains(char::is_control);
            is_path.then(|| Self::Unix(PathBuf::from(path)))
        } else {
            let address = text.strip_prefix("tcp:").and_then(|rest| rest.parse::<SocketAddr>().ok());
            // Another machine is reached by a forwarded port: the protocol has no keys of its own.
            address.filter(|address| address.ip().is_loopback()).map(Self::Tcp)
        };
        parsed.ok_or_else(|| EndpointError { found: text.to_owned() })
    }
}

impl fmt::Display for Endpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unix(path) => write!(f, "unix:{}", path.display()),
            Self::Tcp(address) => write!(f, "tcp:{address}"),
        }
    }
}

/// A connection to an endpoint.
#[derive(Debug)]
pub enum EndpointStream {
    /// Over a Unix socket.
    Unix(UnixStream),
    /// Over TCP.
    Tcp(TcpStream),
}

impl Endpoint {
    /// Connects.
    ///
    /// # Errors
    /// If no process listens.
    pub fn connect(&self, within: Duration) -> io::Result<EndpointStream> {
        match self {
            Self::Unix(path) => UnixStream::connect(path).map(EndpointStream::Unix),
            Self::Tcp(address) => {
                let stream = TcpStream::connect_timeout(address, within)?;
                stream.set_nodelay(true)?;
                Ok(EndpointStream::Tcp(stream))
            }
        }
    }

    /// Listens. The file of a Unix socket is for its owner alone; one without a listener is replaced.
    ///
    /// # Errors
    /// If the address is taken, or not this user's.
    pub fn listen(&self) -> io::Result<EndpointListener> {
        match self {
            Self::Unix(path) => {
                let bound = match UnixListener::bind(path) {
                    Err(error) if error.kind() == io::ErrorKind::AddrInUse => {
                        if UnixStream::connect(path).is_ok() {
                            return Err(error);
                        }
                        std::fs::remove_file(path)?;
                        UnixListener::bind(path)
                    }
                    bound => bound,
                }?;
                std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o600))?;
                Ok(EndpointListener::Unix(bound))
            }
            Self::Tcp(address) => TcpListener::bind(address).map(EndpointListener::Tcp),
        }
    }
}

/// Takes connections.
#[derive(Debug)]
pub enum EndpointListener {
    /// At a Unix socket.
    Unix(UnixListener),
    /// At a port.
    Tcp(TcpListener),
}

impl EndpointListener {
    /// Waits for the next connection.
    ///
    /// # Errors
    /// If the listener fails.
    pub fn accept(&self) -> io::Result<EndpointStream> {
        match self {
            Self::Unix(listener) => listener.accept().map(|(stream, _)| EndpointStream::Unix(stream)),
            Self::Tcp(listener) => {
                let (stream, _) = listener.accept()?;
                stream.set_nodelay(true)?;
                Ok(EndpointStream::Tcp(stream))
            }
        }
    }

    /// Where it listens; a port 0 has become a real one.
    ///
    /// # Errors
    /// If the system does not say.
    pub fn endpoint(&self) -> io::Result<Endpoint> {
        match self {
            Self::Unix(listener) => {
                let path = listener.local_addr()?.as_pathname().map(PathBuf::from);
                Ok(Endpoint::Unix(path.unwrap_or_default()))
            }
            Self::Tcp(listener) => listener.local_addr().map(Endpoint::Tcp),
        }
    }
}

impl io::Read for EndpointStream {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Unix(stream) => stream.read(bytes),
            Self::Tcp(stream) => stream.read(bytes),
        }
    }
}

impl io::Write for EndpointStream {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::Unix(stream) => stream.write(bytes),
            Self::Tcp(stream) => stream.write(bytes),
        }
    }
    fn flush(&mut self) -> io::Result<()> {
        match self {
            Self::Unix(stream) => stream.flush(),
            Self::Tcp(stream) => stream.flush(),
        }
    }
}

impl WireStream for EndpointStream {
    fn limit_read(&self, within: Option<Duration>) -> io::Result<()> {
        match self {
            Self::Unix(stream) => stream.set_read_timeout(within),
            Self::Tcp(stream) => stream.set_read_timeout(within),
        }
    }
    fn limit_write(&self, within: Option<Duration>) -> io::Result<()> {
        match self {
            Self::Unix(stream) => stream.set_write_timeout(within),
            Self::Tcp(stream) => stream.set_write_timeout(within),
        }
    }
    fn close(&self) {
        // A connection that is closed already is what is wanted.
        let _ = match self {
            Self::Unix(stream) => stream.shutdown(Shutdown::Both),
            Self::Tcp(stream) => stream.shutdown(Shutdown::Both),
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_this_machine_is_an_endpoint() {
        for text in ["unix:/run/cell.sock", "unix:cell.sock", "tcp:127.0.0.1:7001", "tcp:[::1]:7001"] {
            assert_eq!(text.parse::<Endpoint>().unwrap().to_string(), text);
        }
        let long = format!("unix:{}", "x".repeat(PATH_BYTES_MAX + 1));
        for text in [
            "",
            "unix:",
            "tcp:",
            "cell.sock",
            "tcp:192.168.0.4:7001",
            "tcp:127.0.0.1",
            "udp:127.0.0.1:1",
            &long,
        ] {
            let error = text.parse::<Endpoint>().unwrap_err();
            assert_eq!(error.found, text);
            assert!(error.to_string().contains("unix:PATH"), "{error}");
        }
    }
}
