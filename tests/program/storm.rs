//! Hundreds of connections that send nothing, half a line or garbage, or never read: the cell still stops in time,
//! the engine decides as before, and its record is sound.
//!
//! `HOLDPOINT_STORM` is how many connections (150), `HOLDPOINT_STORM_SEED` the seed (1).

use std::io::{Read as _, Write as _};
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use holdpoint::protocol::command::{Command, Reply};
use holdpoint::protocol::wire::CALL_BYTES_MAX;
use holdpoint::registry::verify;
use holdpoint::service::control_socket::{Client, socket_path};
use holdpoint::store::Layout;

use crate::host::{Front, PATIENCE};
use crate::mutate::{Random, mutant};
use crate::quick_folder::quick_folder;

/// The time limit for the answer to a stop, even on a busy machine.
const ANSWERED_WITHIN: Duration = Duration::from_secs(10);

fn number(name: &str, otherwise: usize) -> usize {
    std::env::var(name).map_or(otherwise, |text| text.parse().unwrap())
}

#[test]
fn stop_works_during_a_storm_of_connections() {
    let (connections, seed) = (number("HOLDPOINT_STORM", 150), number("HOLDPOINT_STORM_SEED", 1) as u64);
    let folder = quick_folder();
    let mut front = Front::start(folder.path(), None);
    let layout = Layout::new(folder.path());
    let lines: Vec<Vec<u8>> = [
        r#"{"call":"subscribe"}"#,
        r#"{"call":"ask","request":{"id":"a","command":{"command":"snapshot"}}}"#,
        r#"{"call":"ask","request":{"id":"b","command":{"command":"verify-audit"}}}"#,
        r#"{"call":"ask","request":{"id":"c","command":{"command":"stop","by":"x","reason":"y"}}}"#,
    ]
    .iter()
    .map(|line| format!("{line}\n").into_bytes())
    .collect();
    let mut open_streams = Vec::new();
    let (mut refused, mut worst, mut stops) = (0, Duration::ZERO, 0);
    for index in 0..connections {
        let mut random = Random::of_run(seed, index as u64);
        let Ok(mut stream) = UnixStream::connect(socket_path(&layout)) else {
            refused += 1;
            continue;
        };
        stream.set_write_timeout(Some(Duration::from_millis(50))).unwrap();
        match random.below(6) {
            // Sends nothing.
            0 => {}
            // Half a line, and no more.
            1 => drop(stream.write_all(&lines[1][..20])),
            // Garbage.
            2 => drop(stream.write_all(&mutant(&mut random, &lines, lines.len()))),
            // A line without an end.
            3 => drop(stream.write_all(&vec![b'x'; random.below(CALL_BYTES_MAX.min(1 << 16) + 2)])),
            // Subscribes to all events, and reads nothing.
            4 => drop(stream.write_all(&lines[0])),
            // Sends a request, reads a little, and is gone.
            _ => {
                drop(stream.write_all(&lines[random.below(3)]));
                stream.set_read_timeout(Some(Duration::from_millis(5))).unwrap();
                drop(stream.read(&mut [0; 64]));
                continue;
            }
        }
        open_streams.push(stream);
        if index % 50 == 49 {
            let begun = Instant::now();
            let mut client = Client::connect(&layout).unwrap().expect("the engine answers");
            let stop = Command::Stop { by: "ana".to_owned(), reason: "a storm".to_owned() };
            let reply = client.send(stop).unwrap();
            assert!(matches!(reply, Reply::Stopped { .. }), "{reply:?}");
            let took = begun.elapsed();
            assert!(took < ANSWERED_WITHIN, "seed {seed}, connection {index}: a stop took {took:?}");
            assert!(front.snapshot().stopped.is_some(), "seed {seed}, connection {index}");
            (worst, stops) = (worst.max(took), stops + 1);
        }
    }
    assert!(stops > 0 && refused < connections / 2, "{refused} of {connections} were refused");
    assert_eq!(front.snapshot().holding, None);
    let open_count = open_streams.len();
    front.host.stop(PATIENCE).unwrap();
    verify(&layout.database(), None).unwrap();
    println!(
        "storm: seed {seed}, {connections} connections, {open_count} open, {refused} refused, {stops} stops, worst {worst:?}"
    );
}
