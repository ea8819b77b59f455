//! Shows a recording or the live scene in an installed viewer, beside this program.
//!
//! Finding and starting one may take seconds, so a separate thread does it and reports the result. The viewer writes
//! to a log, never to this terminal; its end changes nothing here.

use std::ffi::OsString;
use std::net::{SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use tokio::sync::mpsc;

use super::{BackgroundResult, bad, good};
use crate::effects::EffectOutcome;
use crate::msg::MsgKind;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_recordings::{recording_folder, viewer};
use holdpoint_text::{Hint, Untrusted};

/// The address of the live scene if the console starts it: this machine only.
pub(super) const LIVE: SocketAddr =
    SocketAddr::new(std::net::IpAddr::V4(std::net::Ipv4Addr::LOCALHOST), 9876);

/// How long the live scene may take to be served.
const SERVED_WITHIN: Duration = Duration::from_secs(3);

/// How often its address is tried.
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// How soon a viewer without a screen or graphics ends.
const FAILS_WITHIN: Duration = Duration::from_secs(2);

/// What the viewer shows.
pub(super) enum ViewerScene {
    Files(Vec<PathBuf>),
    Live(SocketAddr),
}

/// The files of an upgrade, in order.
pub(super) fn files(recordings: &Path, version: &CapabilityId) -> Result<Vec<PathBuf>, String> {
    let shown = || Untrusted::new(recordings.display().to_string()).line().into_string();
    let own = recording_folder::of(recordings, version);
    let own = own.map_err(|error| format!("cannot read {}: {error}", shown()))?;
    if own.is_empty() { Err(format!("there is no recording of {version} in {}", shown())) } else { Ok(own) }
}

/// Opens the viewer; the result is reported later.
pub(super) fn open(
    scene: ViewerScene,
    logs: PathBuf,
    sender: mpsc::Sender<BackgroundResult>,
) -> EffectOutcome {
    let work = move || {
        let what = match start(&scene, &logs) {
            Ok(text) => MsgKind::Done { text, bad: false },
            Err(text) => MsgKind::Done { text: Untrusted::new(text).line().into_string(), bad: true },
        };
        // The console may have ended meanwhile.
        drop(sender.blocking_send(BackgroundResult::Message(what)));
    };
    match std::thread::Builder::new().name("viewer-start".to_owned()).spawn(work) {
        Ok(_) => good("starting the scene viewer".to_owned()),
        Err(error) => bad(format!("cannot start a thread for the scene viewer: {error}")),
    }
}

fn start(scene: &ViewerScene, logs: &Path) -> Result<String, String> {
    let found = viewer::find(viewer::path().as_deref()).map_err(|error| error.sentence())?;
    if !viewer::has_screen() {
        return Err(viewer::ViewerError::NoScreen.sentence());
    }
    let (arguments, what): (Vec<OsString>, String) = match scene {
        ViewerScene::Files(files) => {
            let name = |path: &PathBuf| path.file_name().map(|name| name.to_string_lossy().into_owned());
            let names: Vec<String> = files.iter().filter_map(name).collect();
            (files.iter().map(|path| path.clone().into_os_string()).collect(), names.join(", "))
        }
        ViewerScene::Live(address) => {
            served(*address)?;
            (vec![format!("rerun+http://{address}/proxy").into()], format!("the live scene at {address}"))
        }
    };
    let opened = found.open(&arguments, logs).map_err(|error| error.sentence())?;
    if opened.ended_within(FAILS_WITHIN) == Some(false) {
        let log = Untrusted::new(opened.log.display().to_string()).line().into_string();
        return Err(format!("the scene viewer ended at once; {log} says why"));
    }
    Ok(format!("the scene viewer {} shows {what}", found.version))
}

/// Waits until the live scene is served.
fn served(address: SocketAddr) -> Result<(), String> {
    let until = Instant::now() + SERVED_WITHIN;
    loop {
        match TcpStream::connect_timeout(&address, LOOK_EVERY) {
            Ok(_) => return Ok(()),
            Err(error) if Instant::now() >= until => {
                return Err(format!("the live scene is not served at {address}: {error}"));
            }
            Err(_) => std::thread::sleep(LOOK_EVERY),
        }
    }
}
