//! Listeners of an engine beside the front end, and their reports.

use std::collections::BTreeSet;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use holdpoint_governance::closed_set::Lenient;
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::record::UpgradeEnd;

use crate::event::Event;
use crate::film::Film;
use crate::snapshot::Snapshot;
use crate::video_frame::VideoFrame;

/// Takes video frames of the live world, from any thread. Must not block.
pub type VideoFrameSink = Arc<dyn Fn(VideoFrame) + Send + Sync>;

/// Serves the live scene at an address from now on; returns whether a listener can do it.
pub type ServeScene = Arc<dyn Fn(SocketAddr) -> bool + Send + Sync>;

/// The start values of a listener: its folder, and the closed files in it.
#[derive(Clone, Debug)]
pub struct SinkSetup {
    /// The store's folder of recordings.
    pub recordings: PathBuf,
    /// Names of the files whose digest is recorded: never changed again.
    pub closed: BTreeSet<String>,
    /// Whether time is virtual: the same seed then gives the same bytes.
    pub scripted: bool,
}

/// Starts a listener for a running engine; a text says why there is none.
pub type MakeSink = Box<dyn FnOnce(SinkSetup) -> Result<Box<dyn Sink>, String> + Send>;

/// A listener with its own files or viewers. The engine waits for it only at its end, and then briefly; no
/// decision depends on it.
pub trait Sink: Send {
    /// The sink of video frames; `None` if none are wanted.
    fn video_frames(&self) -> Option<VideoFrameSink>;
    /// The server of live viewers; `None` if this listener has none.
    fn serve(&self) -> Option<ServeScene>;
    /// Takes new events. `state` computes the current snapshot only when it is called.
    fn events(&mut self, events: &[Event], state: &dyn Fn() -> Snapshot);
    /// Takes a film of the evaluation of `version`, re-run after the version was refused for it.
    fn film(&mut self, version: &CapabilityId, film: &Film);
    /// New reports; does not block.
    fn reports(&mut self) -> Vec<SinkReport>;
    /// Ends it: queued data is written, for at most `patience`.
    fn finish(self: Box<Self>, patience: Duration) -> Vec<SinkReport>;
}

/// A report of a sink to the engine, which records it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SinkReport {
    /// An upgrade's recording is complete, compacted and on disk.
    Closed(ClosedRecording),
    /// A recording failed: reported once, the rest of it is not written.
    Failed {
        /// The version whose recording failed; absent if there is no single one.
        version: Option<CapabilityId>,
        /// The failure, one sentence for the operator.
        text: String,
    },
    /// A viewer can connect to the live scene.
    Serving {
        /// The address for a viewer, e.g. `rerun+http://127.0.0.1:9876/proxy`.
        url: String,
    },
    /// No viewer can connect, although one was requested.
    NotServing {
        /// Why no client can connect, one sentence.
        text: String,
    },
}

/// A recording that is closed and never written again.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ClosedRecording {
    /// The candidate whose upgrade is recorded.
    pub version: CapabilityId,
    /// The recorded end of the upgrade.
    pub outcome: Lenient<UpgradeEnd>,
    /// The file's name in the store's folder of recordings.
    pub file: String,
    /// SHA-256 of the file.
    pub digest: Digest,
    /// Size of the file, bytes.
    pub bytes: u64,
    /// Video frames of the live cell in the file.
    pub frames: u64,
    /// Video frames and events that were dropped before they came here.
    pub dropped: (u64, u64),
}
