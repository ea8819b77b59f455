//! Shows a recording or the live scene in an installed viewer, beside this program; without one, has the console
//! replay the recording.
//!
//! Finding and starting one may take seconds, so a separate thread does it and reports the result. The viewer writes
//! to a log, never to this terminal; its end changes nothing here.

use std::ffi::OsString;
use std::net::{SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use tokio::sync::mpsc;

use super::{BackgroundResult, ReadRecording, bad, good};
use crate::effects::EffectOutcome;
use crate::msg::MsgKind;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_recordings::{recording_folder, viewer};
use holdpoint_text::{Hint, Untrusted};
use holdpoint_wording::console::effects as wording;

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
    let own = own.map_err(|error| wording::cannot_read(&shown(), error))?;
    if own.is_empty() { Err(wording::no_recording(version, &shown())) } else { Ok(own) }
}

/// Opens the viewer; the result is reported later.
pub(super) fn open(
    scene: ViewerScene,
    logs: PathBuf,
    read: ReadRecording,
    sender: mpsc::Sender<BackgroundResult>,
) -> EffectOutcome {
    let work = move || {
        let what = match start(&scene, &logs) {
            Ok(text) => MsgKind::Done { text, bad: false },
            Err(why) => without_viewer(&scene, &why, &read),
        };
        // The console may have ended meanwhile.
        drop(sender.blocking_send(BackgroundResult::Message(what)));
    };
    match std::thread::Builder::new().name("viewer-start".to_owned()).spawn(work) {
        Ok(_) => good(wording::STARTING_VIEWER.to_owned()),
        Err(error) => bad(wording::no_viewer_thread(error)),
    }
}

/// What there is without a viewer: the replay in this terminal; for the live scene, the console's own view of the arm.
fn without_viewer(scene: &ViewerScene, why: &str, read: &ReadRecording) -> MsgKind {
    let why = Untrusted::new(why).line().into_string();
    let failed = |text: String| MsgKind::Done { text: Untrusted::new(text).line().into_string(), bad: true };
    match scene {
        ViewerScene::Files(files) => match read(files) {
            Ok(recording) => MsgKind::RecordingRead { recording: Box::new(recording), why },
            Err(problem) => failed(format!("{why}; {}", problem.sentence())),
        },
        ViewerScene::Live(_) => failed(wording::overview_draws(why)),
    }
}

fn start(scene: &ViewerScene, logs: &Path) -> Result<String, String> {
    let found = viewer::find(viewer::path().as_deref()).map_err(|error| error.to_string())?;
    if !viewer::has_screen() {
        return Err(viewer::ViewerError::NoScreen.to_string());
    }
    let (arguments, what): (Vec<OsString>, String) = match scene {
        ViewerScene::Files(files) => {
            let name = |path: &PathBuf| path.file_name().map(|name| name.to_string_lossy().into_owned());
            let names: Vec<String> = files.iter().filter_map(name).collect();
            (files.iter().map(|path| path.clone().into_os_string()).collect(), names.join(", "))
        }
        ViewerScene::Live(address) => {
            served(*address)?;
            (vec![format!("rerun+http://{address}/proxy").into()], wording::live_scene(*address))
        }
    };
    let opened = found.open(&arguments, logs).map_err(|error| error.to_string())?;
    if opened.ended_within(FAILS_WITHIN) == Some(false) {
        let log = Untrusted::new(opened.log.display().to_string()).line().into_string();
        return Err(wording::viewer_ended(&log));
    }
    Ok(wording::viewer_shows(&found.version.to_string(), &what))
}

/// Waits until the live scene is served.
fn served(address: SocketAddr) -> Result<(), String> {
    let until = Instant::now() + SERVED_WITHIN;
    loop {
        match TcpStream::connect_timeout(&address, LOOK_EVERY) {
            Ok(_) => return Ok(()),
            Err(error) if Instant::now() >= until => {
                return Err(wording::not_served(address, error));
            }
            Err(_) => std::thread::sleep(LOOK_EVERY),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    use holdpoint_recordings::recording::{Recording, RecordingSubject};
    use holdpoint_text::Problem;

    fn recording() -> Recording {
        Recording {
            about: RecordingSubject {
                version: "grasp@1.1.0".parse().unwrap(),
                digest: holdpoint_governance::ids::Digest::from_bytes([1; 32]),
                predecessor: None,
                profile: holdpoint_governance::profile::ProfileName::Sim.into(),
                robot: String::new(),
                seed: None,
                engine_build: String::new(),
            },
            outcome: None,
            scenery: holdpoint_protocol::video_frame::Scenery::default(),
            pictures: Vec::new(),
            events: Vec::new(),
            series: Vec::new(),
            films: Vec::new(),
            dropped: (0, 0),
        }
    }

    #[test]
    fn without_a_viewer_the_recording_is_read_for_this_terminal() {
        let why = viewer::ViewerError::NotFound.to_string();
        let files = || ViewerScene::Files(vec![PathBuf::from("a.rrd"), PathBuf::from("a.2.rrd")]);
        let read: ReadRecording = Arc::new(|files: &[PathBuf]| {
            assert_eq!(files.len(), 2);
            Ok(recording())
        });
        let MsgKind::RecordingRead { recording, why: told } = without_viewer(&files(), &why, &read) else {
            panic!("the recording is read")
        };
        assert_eq!(
            (recording.about.version.to_string().as_str(), told.as_str()),
            ("grasp@1.1.0", why.as_str())
        );
        let fails: ReadRecording = Arc::new(|_: &[PathBuf]| Err(Problem::new("the file is torn")));
        let MsgKind::Done { text, bad: true } = without_viewer(&files(), &why, &fails) else {
            panic!("it is reported")
        };
        assert!(text.contains("no `rerun`") && text.contains("torn"), "{text}");
        let MsgKind::Done { text, bad: true } = without_viewer(&ViewerScene::Live(LIVE), &why, &fails) else {
            panic!("it is reported")
        };
        assert!(text.contains("Overview") && !text.contains("pip"), "{text}");
    }
}
