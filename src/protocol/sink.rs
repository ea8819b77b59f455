//! What listens to an engine beside the front end, and what it reports back.

use std::collections::BTreeSet;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::record::UpgradeEnd;
use holdpoint_governance::words::Word;

use crate::event::Event;
use crate::film::Film;
use crate::picture::Picture;
use crate::snapshot::Snapshot;

/// Takes pictures of the live world, from whatever thread moves it. Must not wait.
pub type Pictures = Arc<dyn Fn(Picture) + Send + Sync>;

/// Has the live scene served at an address from now on; returns whether there was a listener to do it.
pub type Serve = Arc<dyn Fn(SocketAddr) -> bool + Send + Sync>;

/// What a listener is started with: its folder, and what in it is closed.
#[derive(Clone, Debug)]
pub struct Setup {
    /// The store's folder of recordings.
    pub recordings: PathBuf,
    /// Names of the files whose digest is on the audit record: never touched again.
    pub closed: BTreeSet<String>,
    /// Whether time is virtual: the same seed then gives the same bytes.
    pub scripted: bool,
}

/// Starts a listener for an engine that is up; a text says why there is none.
pub type MakeSink = Box<dyn FnOnce(Setup) -> Result<Box<dyn Sink>, String> + Send>;

/// A listener with files or viewers of its own. The engine never waits for it but at its end, and there not for
/// long; no decision hangs on any of it.
pub trait Sink: Send {
    /// What takes pictures; `None` if none are wanted.
    fn pictures(&self) -> Option<Pictures>;
    /// How a live viewer is served; `None` if this listener cannot.
    fn serve(&self) -> Option<Serve>;
    /// Takes what happened. `state` says how things stand; it is worked out only when it is called.
    fn events(&mut self, events: &[Event], state: &dyn Fn() -> Snapshot);
    /// Takes a piece of an evaluation of `version`, worked again after it was refused for it.
    fn film(&mut self, version: &CapabilityId, film: &Film);
    /// What there is to report; never waits.
    fn reports(&mut self) -> Vec<Report>;
    /// Ends it: what waits is written, for at most `patience`.
    fn finish(self: Box<Self>, patience: Duration) -> Vec<Report>;
}

/// What a sink reports back to the engine, which puts it on record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Report {
    /// An upgrade's recording is ended, compacted and safe on the disk.
    Closed(Closed),
    /// A recording failed: said once for each, the rest of it is not written.
    Failed {
        /// The version whose recording failed; absent if it is about no single one.
        version: Option<CapabilityId>,
        /// What failed, one sentence for the operator.
        text: String,
    },
    /// A viewer can connect to the live scene.
    Serving {
        /// The address for a viewer, e.g. `rerun+http://127.0.0.1:9876/proxy`.
        url: String,
    },
    /// No viewer can connect, although one was asked for.
    NotServing {
        /// Why nobody can connect, one sentence.
        text: String,
    },
}

/// A recording that is closed and never written again.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Closed {
    /// The candidate whose upgrade is recorded.
    pub version: CapabilityId,
    /// How the upgrade ended, as it is on record.
    pub outcome: Word<UpgradeEnd>,
    /// The file's name in the store's folder of recordings.
    pub file: String,
    /// SHA-256 of the file.
    pub digest: Digest,
    /// Size of the file, bytes.
    pub bytes: u64,
    /// Pictures of the live cell in the file.
    pub pictures: u64,
    /// Pictures and events that were dropped before they came here.
    pub dropped: (u64, u64),
}
