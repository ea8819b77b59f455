//! The server that viewers connect to, in this process. It never blocks a caller: without a viewer, after a viewer was
//! killed, and at its end.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, TcpListener};

use rerun::grpc_server::GrpcServerSink;
use rerun::log::LogMsg;
use rerun::sink::LogSink;
use rerun::{MemoryLimit, ServerOptions};

use super::limits::SERVER_BYTES_MAX;
use holdpoint_text::Problem;

pub struct Server {
    sink: Option<GrpcServerSink>,
    url: String,
}

impl Server {
    /// Serves at this address only.
    ///
    /// # Errors
    /// The port is taken, or the address is not this machine's.
    pub fn start(address: SocketAddr) -> Result<Self, Problem> {
        let refused = |error: &dyn std::fmt::Display| {
            Problem::new(format!("cannot serve a viewer at \"{address}\": {error}"))
                .with_hint("name another address or port")
        };
        // The server itself reports no error for a taken port.
        let probe = TcpListener::bind(address).map_err(|error| refused(&error))?;
        let address = probe.local_addr().map_err(|error| refused(&error))?;
        drop(probe);
        let host = match address.ip() {
            IpAddr::V4(host) => host.to_string(),
            IpAddr::V6(host) => format!("[{host}]"),
        };
        let options = ServerOptions {
            memory_limit: MemoryLimit::from_bytes(SERVER_BYTES_MAX),
            ..ServerOptions::default()
        };
        let sink = GrpcServerSink::new(&host, address.port(), options).map_err(|error| refused(&error))?;
        Ok(Self { sink: Some(sink), url: url(address) })
    }

    /// The address for viewers.
    #[must_use]
    pub fn url(&self) -> &str {
        &self.url
    }

    /// Sends a message to the connected viewers, and keeps it for later ones.
    pub fn send(&self, message: LogMsg) {
        if let Some(sink) = &self.sink {
            sink.send(message);
        }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let sink = self.sink.take();
        // Dropping the server waits until everything is sent, however long: a detached thread does that.
        let _ = std::thread::Builder::new().name("scene-server-end".to_owned()).spawn(move || drop(sink));
    }
}

/// The URL of an address; an unspecified address is reached at the loopback here.
fn url(address: SocketAddr) -> String {
    let host = match address.ip() {
        IpAddr::V4(host) if host.is_unspecified() => IpAddr::V4(Ipv4Addr::LOCALHOST),
        IpAddr::V6(host) if host.is_unspecified() => IpAddr::V6(Ipv6Addr::LOCALHOST),
        host => host,
    };
    format!("rerun+http://{}/proxy", SocketAddr::new(host, address.port()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_url_names_an_address_that_can_be_reached() {
        for (address, wanted) in [
            ("127.0.0.1:9876", "rerun+http://127.0.0.1:9876/proxy"),
            ("0.0.0.0:1", "rerun+http://127.0.0.1:1/proxy"),
            ("[::1]:2", "rerun+http://[::1]:2/proxy"),
        ] {
            assert_eq!(url(address.parse().unwrap()), wanted);
        }
    }

    #[test]
    fn a_port_in_use_is_reported() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let text = Server::start(address).err().unwrap().to_string();
        assert!(text.contains(&address.to_string()), "{text}");
    }
}
