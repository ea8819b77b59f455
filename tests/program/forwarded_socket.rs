//! A socket that another program relays, as `ssh -L` does: its answers are marked, and a stop arrives without a
//! confirmation.

use std::io::{self, Read, Write};
use std::net::Shutdown;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::time::Instant;

use holdpoint::protocol::command::{Command, Reply};
use holdpoint::service::control_socket::{Client, StopCall, StopOutcome, socket_path};
use holdpoint::store::Layout;
use holdpoint_wording::program::engine::unverified_answer;

use crate::host::{Front, PATIENCE};
use crate::quick_folder::quick_folder;

/// Passes every connection at the socket of `near` on to that of the engine in `far`.
fn forward(near: &Path, far: &Path) {
    let listener = UnixListener::bind(socket_path(&Layout::new(near))).unwrap();
    let far: PathBuf = socket_path(&Layout::new(far));
    std::thread::spawn(move || {
        while let Ok((client, _)) = listener.accept() {
            let Ok(engine) = UnixStream::connect(&far) else { return };
            let (Ok(from_client), Ok(to_engine)) = (client.try_clone(), engine.try_clone()) else { return };
            std::thread::spawn(move || pass_on(from_client, to_engine));
            std::thread::spawn(move || pass_on(engine, client));
        }
    });
}

fn pass_on(mut from: UnixStream, mut to: UnixStream) {
    let mut bytes = [0; 4096];
    loop {
        match from.read(&mut bytes) {
            Ok(count) if count > 0 => {
                if to.write_all(bytes.get(..count).unwrap_or_default()).is_err() {
                    break;
                }
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Ok(_) | Err(_) => break,
        }
    }
    drop(to.shutdown(Shutdown::Both));
}

#[test]
fn a_stop_over_a_forwarded_socket_arrives_and_is_not_confirmed() {
    let (near, far) = (quick_folder(), quick_folder());
    let mut engine = Front::start(far.path(), Some(1.0));
    forward(near.path(), far.path());
    let layout = Layout::new(near.path());
    let mut client = Client::connect(&layout).unwrap().unwrap();
    let origin = client.unverified_origin().expect("this process has no store here");
    assert!(matches!(client.send(Command::Snapshot), Ok(Reply::Snapshot { .. })));
    let stop = || StopCall::new("ana".to_owned(), "a test".to_owned()).unwrap().send(&layout);
    let outcome = stop();
    let StopOutcome::NotConfirmed(why) = &outcome else { panic!("{outcome:?}") };
    assert!(why.starts_with(&unverified_answer(origin, "")), "{why}");
    let stops = |engine: &mut Front| engine.snapshot().stopped.map_or(0, |stopped| stopped.stops);
    assert_eq!(stops(&mut engine), 1);
    assert!(!layout.stop_request().exists(), "no mark stays where no engine takes it");
    // With a store in the folder, the process at its socket is no engine. It gets the stop, and its answer does not count.
    std::fs::write(layout.database(), "").unwrap();
    assert!(matches!(stop(), StopOutcome::NoEngine));
    let until = Instant::now() + PATIENCE;
    while stops(&mut engine) < 2 {
        assert!(Instant::now() < until, "the stop does not arrive");
    }
}
