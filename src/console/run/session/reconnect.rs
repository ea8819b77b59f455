//! The search for a running engine, after the console lost its engine or found none.
//!
//! Owns when to search and for how long. Must not start an engine.

use std::time::{Duration, Instant};

use super::Session;
use crate::effects::BackgroundResult;
use crate::model::ReconnectStatus;
use crate::msg::MsgKind;
use crate::run::frame_pace::FrameReason;
use holdpoint_service::engine_handle::EngineHandle;
use holdpoint_text::Hint as _;
use holdpoint_wording::console::run as wording;

/// The first pause between two searches for a running engine; each is twice as long as the one before.
const SEEK_FIRST: Duration = Duration::from_millis(500);

/// The longest of these pauses.
const SEEK_PAUSE_MAX: Duration = Duration::from_secs(15);

/// How often the console searches for an engine: 15 minutes, and then an operator has to act.
const SEEK_MAX: u32 = 64;

/// A search for a running engine on the store.
pub(super) struct ReconnectTimer {
    pub(super) tries: u32,
    /// When to search next; absent during a search.
    pub(super) due: Option<Instant>,
}

impl Session {
    /// Searches for a running engine on the store when it is due, on a separate thread: it may answer slowly.
    pub(super) fn look_for_an_engine(&mut self) {
        let Some(seek) = self.seek.as_mut().filter(|_| self.leaving.is_none()) else { return };
        if seek.tries >= SEEK_MAX || seek.due.is_none_or(|due| due > Instant::now()) {
            return;
        }
        seek.tries += 1;
        seek.due = None;
        let (sender, sitting) = (self.job_sender.clone(), self.model.attachment());
        let layout = self.effects.host.layout().clone();
        let look = move || {
            let found = match EngineHandle::find(&layout, sitting) {
                Ok(Some(host)) => Ok(Box::new(host)),
                Ok(None) => Err(wording::NO_ENGINE_ON_THIS_STORE.to_owned()),
                Err(error) => Err(error.sentence()),
            };
            // The console may have ended meanwhile.
            drop(sender.blocking_send(BackgroundResult::Reconnected(found)));
        };
        if let Err(error) = std::thread::Builder::new().name("seeking".to_owned()).spawn(look) {
            self.take_search_result(Err(wording::no_thread(error)));
        }
    }

    /// Handles the result of a search for an engine.
    pub(super) fn take_search_result(&mut self, found: Result<Box<EngineHandle>, String>) {
        let Some(seek) = self.seek.as_mut().filter(|_| self.leaving.is_none()) else { return };
        match found {
            Ok(host) => {
                self.seek = None;
                self.ended = None;
                let (process, unverified) = (host.process(), host.unverified_origin());
                self.effects.host = *host;
                self.take(MsgKind::Attached(process, unverified), FrameReason::Change);
            }
            Err(result) => {
                let pause = SEEK_FIRST.saturating_mul(1 << seek.tries.min(8)).min(SEEK_PAUSE_MAX);
                seek.due = Some(Instant::now() + pause);
                let seeking = ReconnectStatus { tries: seek.tries, tries_max: SEEK_MAX, result };
                self.take(MsgKind::ReconnectFailed(seeking), FrameReason::Change);
            }
        }
    }
}
