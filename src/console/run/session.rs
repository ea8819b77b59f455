//! One running console: waits for the next event, updates the model, draws.
//!
//! Must not hang: it waits only for channels, and slow work runs on other threads.

mod reconnect;
mod terminal_check;

use std::collections::VecDeque;
use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use tokio::sync::mpsc;
use tokio::time::MissedTickBehavior;

use self::reconnect::ReconnectTimer;
use self::terminal_check::{continued, watch_continue};
use super::EngineLocation;
use super::exit_message::{self, ExitCause, ExitReport};
use super::frame_pace::{FramePace, FrameReason};
use super::input;
use super::screen::Screen;
use crate::approval_screen::VisibleRows;
use crate::effect::Effect;
use crate::effects::{BackgroundResult, EffectOutcome, EffectRunner, EffectTarget, Services, StartedEngine};
use crate::frame;
use crate::look::Look;
use crate::model::{ConsoleModel, EngineLink, Overlay, View};
use crate::msg::{Msg, MsgKind};
use crate::terminal::TerminalGuard;
use crate::terminal::guard::{EndSignal, RunningGuard};
use crate::theme::Themes;
use crate::update::update;
use holdpoint_protocol::command::{Command, Request};
use holdpoint_service::engine_handle::{EngineEndError, EngineHandle, EngineUpdate, StopError};
use holdpoint_wording::console::run as wording;

/// The interval of ticks without other events.
const TICK: Duration = Duration::from_millis(500);

/// How long the engine has to shut down cleanly. Less than the guard's patience.
const ENDING_MAX: Duration = Duration::from_secs(3);

/// The part of it for the engine's thread, after the engine's own time is over.
const STOP_MAX: Duration = Duration::from_millis(500);

/// How long the process of an engine that shut down cleanly has to release the store.
const FREE_MAX: Duration = Duration::from_secs(2);

/// Messages that are processed before a frame is drawn.
const BATCH_MAX: usize = 256;

/// Background results that can wait in the channel.
const JOBS_MAX: usize = 16;

/// The parts of a session besides the screen.
pub(super) struct SessionParts {
    pub(super) engine: EngineLocation,
    pub(super) view: Option<SocketAddr>,
    pub(super) services: Services,
    pub(super) themes: Themes,
    pub(super) exports: Option<PathBuf>,
    pub(super) operator: Option<String>,
}

/// See the module's head.
pub(super) struct Session {
    started_at: Instant,
    model: ConsoleModel,
    look: Look,
    screen: Screen,
    terminal: TerminalGuard,
    guard: RunningGuard,
    inputs: mpsc::Receiver<MsgKind>,
    /// The results of long jobs.
    job_results: mpsc::Receiver<BackgroundResult>,
    effects: EffectRunner,
    operator: Option<String>,
    pace: FramePace,
    /// The deadline of the engine's shutdown, once requested.
    leaving: Option<Instant>,
    cause: ExitCause,
    /// Drawing is no longer possible.
    screen_lost: bool,
    /// The engine's end.
    ended: Option<Result<(), EngineEndError>>,
    /// Whether there was an engine here.
    engine_started: bool,
    /// The engine was left running.
    engine_detached: bool,
    /// The engine keeps running without a console.
    keep_engine: bool,
    /// The search for a running engine; absent while the console has one.
    seek: Option<ReconnectTimer>,
    /// Sends job results to the session.
    job_sender: mpsc::Sender<BackgroundResult>,
}

enum SessionInput {
    Input(Option<MsgKind>),
    JobResult(BackgroundResult),
    Update(Option<EngineUpdate>),
    Snapshot,
    VideoFrame,
    Ending(EndSignal),
    /// The program continues after it was suspended.
    Continued,
    Tick,
    Frame,
    Late,
}

impl Session {
    pub(super) fn start(
        parts: SessionParts,
        model: ConsoleModel,
        look: Look,
        screen: Screen,
        terminal: TerminalGuard,
        guard: RunningGuard,
    ) -> io::Result<Self> {
        let view = parts.view;
        let mut model = model;
        let (sender, jobs) = mpsc::channel(JOBS_MAX);
        let host = match parts.engine {
            EngineLocation::Here(config) => EngineHandle::start(config),
            EngineLocation::Elsewhere(host) => {
                model.engine_data.link = EngineLink::Attached;
                model.engine_data.process = host.process();
                model.engine_data.unverified = host.unverified_origin();
                *host
            }
            EngineLocation::Begun(coming, begin) => {
                model.engine_data.link = EngineLink::Attached;
                model.engine_data.started_here = true;
                let (sitting, sender) = (model.attachment(), sender.clone());
                let work = move || {
                    let started = begin(sitting).map(Box::new);
                    // If the console has ended meanwhile, the engine ends as well: no console is attached to it.
                    drop(sender.blocking_send(BackgroundResult::Started(started)));
                };
                std::thread::Builder::new().name("beginning".to_owned()).spawn(work)?;
                *coming
            }
        };
        let SessionParts { services, themes, exports, .. } = parts;
        Ok(Self {
            started_at: Instant::now(),
            model,
            look,
            screen,
            terminal,
            guard,
            inputs: input::start()?,
            job_results: jobs,
            effects: EffectRunner::new(host, services, themes, exports, sender.clone(), view),
            operator: parts.operator,
            pace: FramePace::default(),
            leaving: None,
            cause: ExitCause::Requested,
            screen_lost: false,
            ended: None,
            engine_started: false,
            engine_detached: false,
            keep_engine: false,
            seek: None,
            job_sender: sender,
        })
    }

    /// Runs until the program ends, and restores the terminal.
    pub(super) async fn run(mut self) -> ExitReport {
        let mut ticks = tokio::time::interval(TICK);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut continues = watch_continue();
        self.set_operator(false);
        while !self.is_over() {
            let input = self.wait(&mut ticks, &mut continues).await;
            self.fold(input);
            self.drain_backlog();
            self.draw_if_due();
        }
        self.finish()
    }

    /// Whether nothing is left to wait for: the engine has shut down as requested, or its time is over.
    fn is_over(&self) -> bool {
        self.leaving.is_some_and(|until| self.ended.is_some() || Instant::now() >= until)
    }

    async fn wait(
        &mut self,
        ticks: &mut tokio::time::Interval,
        continues: &mut Option<tokio::signal::unix::Signal>,
    ) -> SessionInput {
        let frame = self.pace.due_ms().filter(|_| !self.screen_lost).map(|due_ms| self.instant_at(due_ms));
        let leaving = self.leaving;
        let host = &mut self.effects.host;
        tokio::select! {
            biased;
            ending = self.guard.ending(), if self.cause == ExitCause::Requested => SessionInput::Ending(ending),
            () = continued(continues) => SessionInput::Continued,
            what = self.inputs.recv(), if !self.screen_lost => SessionInput::Input(what),
            Some(what) = self.job_results.recv() => SessionInput::JobResult(what),
            () = until(frame) => SessionInput::Frame,
            () = until(leaving) => SessionInput::Late,
            told = host.updates.recv(), if self.ended.is_none() => SessionInput::Update(told),
            Ok(()) = host.snapshots.changed() => SessionInput::Snapshot,
            Ok(()) = host.frames.changed() => SessionInput::VideoFrame,
            _ = ticks.tick() => SessionInput::Tick,
        }
    }

    fn instant_at(&self, at_ms: u64) -> Instant {
        self.started_at + Duration::from_millis(at_ms)
    }

    fn now_ms(&self) -> u64 {
        u64::try_from(self.started_at.elapsed().as_millis()).unwrap_or(u64::MAX)
    }

    fn fold(&mut self, input: SessionInput) {
        match input {
            SessionInput::Input(Some(what)) => self.input(what),
            // The reading thread has ended: the terminal is lost.
            SessionInput::Input(None) => self.end_signalled(true),
            SessionInput::JobResult(BackgroundResult::Message(what)) => self.take(what, FrameReason::Key),
            SessionInput::JobResult(BackgroundResult::Signed(request)) => {
                if self.model.requests.hand_over(&request.id) {
                    self.hand_over(*request);
                }
            }
            SessionInput::JobResult(BackgroundResult::Reconnected(found)) => self.take_search_result(found),
            SessionInput::JobResult(BackgroundResult::Started(started)) => self.engine_started(started),
            SessionInput::Update(Some(update)) => self.engine(update),
            SessionInput::Update(None) => {
                self.engine(EngineUpdate::Ended(Err(EngineEndError::of(wording::THREAD_GONE))));
            }
            SessionInput::Snapshot => {
                let newest = self.effects.host.snapshots.borrow_and_update().clone();
                if let Some(snapshot) = newest {
                    self.take(MsgKind::Snapshot(snapshot), FrameReason::Change);
                }
            }
            SessionInput::VideoFrame => self.take_frame(),
            SessionInput::Ending(ending) => self.end_signalled(ending == EndSignal::TerminalLost),
            SessionInput::Frame if self.model.plays() => self.fold_one(MsgKind::Tick),
            SessionInput::Continued => self.check_terminal(true),
            SessionInput::Tick => {
                self.check_terminal(false);
                self.take(MsgKind::Tick, FrameReason::Change);
                self.look_for_an_engine();
            }
            SessionInput::Frame | SessionInput::Late => {}
        }
    }

    /// A backlog is processed completely, so that the next frame shows its final state.
    fn drain_backlog(&mut self) {
        for _ in 0..BATCH_MAX {
            if let Ok(what) = self.inputs.try_recv() {
                self.input(what);
            } else if let Ok(update) = self.effects.host.updates.try_recv() {
                self.engine(update);
            } else {
                return;
            }
        }
    }

    fn input(&mut self, what: MsgKind) {
        if let MsgKind::Resize(columns, rows) = what
            && self.screen.resize(columns, rows).is_err()
        {
            self.end_signalled(true);
        }
        self.take(what, FrameReason::Key);
    }

    fn engine(&mut self, update: EngineUpdate) {
        let what = match update {
            EngineUpdate::Started => {
                self.engine_started = true;
                self.set_operator(true);
                MsgKind::EngineStarted
            }
            EngineUpdate::Returned(request) => return self.hand_over(*request),
            EngineUpdate::Events(events) => MsgKind::Events(events),
            EngineUpdate::Past { events, earlier } => MsgKind::Past { events, earlier },
            EngineUpdate::Answer { id, reply } => MsgKind::Answer { id, reply: Box::new(reply) },
            EngineUpdate::Lagged { missed } => MsgKind::Lagged(missed),
            EngineUpdate::Ended(how) => {
                self.ended = Some(how.clone());
                // Another engine may start there soon, or has already.
                let elsewhere = self.effects.host.is_attached() || how.as_ref().is_err_and(|why| why.in_use);
                // A console that may start no engine waits for one.
                if (elsewhere || self.model.settings.read_only) && self.leaving.is_none() {
                    self.seek = Some(ReconnectTimer { tries: 0, due: Some(Instant::now()) });
                }
                MsgKind::EngineEnded(how)
            }
        };
        self.take(what, FrameReason::Change);
    }

    /// The started engine is there, or has failed. Waiting requests go to it.
    fn engine_started(&mut self, started: Result<Box<StartedEngine>, EngineEndError>) {
        let waiting = self.effects.host.take_waiting();
        match started {
            Ok(started) => {
                let StartedEngine { host, notice } = *started;
                let is_own = !host.is_attached();
                let (process, unverified) = (host.process(), host.unverified_origin());
                self.effects.host = host;
                if is_own {
                    self.model.engine_data.link = EngineLink::Own;
                } else {
                    self.take(MsgKind::Attached(process, unverified), FrameReason::Change);
                }
                if let Some(text) = notice {
                    self.take(MsgKind::Done { text, bad: true }, FrameReason::Change);
                }
            }
            Err(why) => self.engine(EngineUpdate::Ended(Err(why))),
        }
        for request in waiting {
            self.hand_over(request);
        }
    }

    /// Sets the named operator: at once, so that an early stop carries the name. Without a key, once the store is
    /// there; an unknown name is then reported.
    fn set_operator(&mut self, is_last: bool) {
        let Some(name) = self.operator.as_deref() else { return };
        if is_last || self.effects.knows(name) {
            self.operator.take().into_iter().for_each(|name| self.execute(Effect::UseIdentity(name)));
        }
    }

    /// Passes on a request that another thread returned.
    fn hand_over(&mut self, request: Request) {
        if let EffectOutcome::Message(what) = self.effects.submit(&self.model, request) {
            self.take(what, FrameReason::Key);
        }
    }

    fn take_frame(&mut self) {
        let newest = self.effects.host.frames.borrow_and_update().clone();
        let Some(frame) = newest else { return };
        let is_visible = self.model.view_state.view == View::Overview;
        self.fold_one(MsgKind::VideoFrame(frame));
        if is_visible {
            self.pace.want(FrameReason::Change);
        }
    }

    fn end_signalled(&mut self, gone: bool) {
        self.screen_lost |= gone;
        let first = self.cause == ExitCause::Requested;
        if gone {
            self.cause = ExitCause::TerminalLost;
        } else if first {
            self.cause = ExitCause::Signalled;
        }
        if first {
            self.take(MsgKind::EndRequested, FrameReason::Key);
        }
    }

    /// Applies one message and requests a frame.
    fn take(&mut self, what: MsgKind, want: FrameReason) {
        self.fold_one(what);
        self.pace.want(want);
    }

    fn fold_one(&mut self, what: MsgKind) {
        let now_ms = self.now_ms();
        let effects = update(&mut self.model, Msg { now_ms, what });
        for effect in effects {
            self.execute(effect);
        }
        // Other consoles see the position of this one; an unchanged position is not sent.
        self.model.engine_data.console_number = self.effects.host.set_presence(self.model.attachment());
    }

    /// Carries out an effect and handles its result.
    fn execute(&mut self, effect: Effect) {
        let mut open = VecDeque::from([effect]);
        while let Some(effect) = open.pop_front() {
            let mut place = EffectTarget {
                screen: &mut self.screen,
                terminal: &self.terminal,
                look: &mut self.look,
                model: &self.model,
            };
            match self.effects.execute(effect, &mut place) {
                Ok(EffectOutcome::Quiet) => {}
                Ok(EffectOutcome::Message(what)) => {
                    let now_ms = self.now_ms();
                    open.extend(update(&mut self.model, Msg { now_ms, what }));
                    self.pace.want(FrameReason::Key);
                }
                Ok(EffectOutcome::End) => self.end(),
                Ok(EffectOutcome::Leave) => self.leave(),
                Ok(EffectOutcome::Detach) => {
                    self.keep_engine = true;
                    self.leave();
                }
                Err(_) => self.end_signalled(true),
            }
        }
    }

    /// Leaves the engine as it is.
    fn leave(&mut self) {
        self.engine_detached = true;
        self.ended.get_or_insert(Ok(()));
        self.leaving.get_or_insert_with(Instant::now);
    }

    /// Asks the engine to end; the screen stays until then. An engine that keeps running is left as it is.
    fn end(&mut self) {
        if self.ended.is_some() {
            self.leaving.get_or_insert_with(Instant::now);
            return;
        }
        // A user whose terminal is lost may attach again; otherwise the engine ends by itself.
        let is_lost =
            self.cause == ExitCause::TerminalLost && self.model.engine_data.link == EngineLink::Attached;
        if is_lost || !self.model.ends_engine() {
            return self.leave();
        }
        if self.leaving.is_none() {
            self.leaving = Some(Instant::now() + ENDING_MAX);
            self.model.engine_data.is_ending = true;
            // A full queue is no reason to wait: the host is stopped in any case.
            drop(self.effects.send(&self.model, "console-ends".to_owned(), Command::Shutdown));
        }
    }

    fn draw_if_due(&mut self) {
        let now_ms = self.now_ms();
        if self.screen_lost || !self.pace.is_due(now_ms) {
            return;
        }
        #[cfg(debug_assertions)]
        panic_if_requested(&self.model);
        let (model, look) = (&self.model, &self.look);
        let mut visible = None;
        let drawn = self.screen.draw(|area, buffer| {
            frame::draw(model, look, area, buffer);
            visible = frame::decision_on_screen(model, look, area);
        });
        // The pace counts from the end of a frame, so a slow terminal gets fewer.
        self.pace.frame_drawn(self.now_ms());
        if self.model.plays() {
            self.pace.want(FrameReason::Change);
        }
        if drawn.is_err() {
            self.end_signalled(true);
        } else if let Some(visible) = visible {
            self.decision_shown(visible);
        }
    }

    /// Rows that were really on the screen count as read. The next frame shows how many are left.
    fn decision_shown(&mut self, visible: VisibleRows) {
        let unread = |model: &ConsoleModel| model.input.overlay.as_ref().map_or(0, Overlay::unread);
        let before = unread(&self.model);
        self.fold_one(MsgKind::DecisionShown(visible));
        if unread(&self.model) != before {
            self.pace.want(FrameReason::Key);
        }
    }

    /// The engine first, the terminal last.
    fn finish(self) -> ExitReport {
        let Self {
            model,
            effects,
            screen,
            terminal,
            guard,
            ended,
            cause,
            engine_started,
            engine_detached,
            keep_engine,
            ..
        } = self;
        let (attached, end_requested) = (effects.host.is_attached(), model.engine_data.is_ending);
        // The screen is already gone when the engine is asked, so its answer goes into the exit message.
        let reply = if keep_engine { effects.host.keep_engine_running() } else { Ok(()) };
        let elsewhere = effects.host.remote_engine();
        let stopped = match effects.host.stop(STOP_MAX) {
            Ok(()) => Some(Ok(())),
            Err(StopError::Failed(why)) => Some(Err(why)),
            Err(StopError::Late(_)) => None,
        };
        let ended = ended.or(stopped);
        // A requested end is no fault, and is complete once the store is free.
        let ended = match ended {
            Some(Err(why)) if why.orderly && end_requested => {
                // After a signal there is not much time.
                elsewhere.wait_for_end(if cause == ExitCause::Requested { FREE_MAX } else { STOP_MAX });
                Some(Ok(()))
            }
            other => other,
        };
        drop(screen);
        drop(terminal);
        drop(guard);
        let ends_alone_s = model.engine_data.snapshot.as_ref().and_then(|snapshot| snapshot.ends_alone_s);
        match (&ended, model.engine_data.link) {
            (Some(Ok(())), _) if engine_detached && attached => {
                return exit_message::at_work(&model, cause, &reply, ends_alone_s.filter(|_| !keep_engine));
            }
            (None, EngineLink::Attached) if end_requested => {
                return exit_message::still_ending(&model, cause);
            }
            (Some(Err(why)), EngineLink::Attached) if engine_started => {
                return exit_message::ended_elsewhere(cause, why);
            }
            _ => {}
        }
        exit_message::exit_report(cause, engine_started, ended, model.engine_data.snapshot.as_deref())
    }
}

/// Waits until a moment; for ever if there is none.
async fn until(at: Option<Instant>) {
    match at {
        Some(at) => tokio::time::sleep_until(at.into()).await,
        None => std::future::pending().await,
    }
}

/// Tests the panic policy: a screen that fails while it is drawn. Not in a release.
#[cfg(debug_assertions)]
#[allow(clippy::panic, reason = "that is what is tested")]
fn panic_if_requested(model: &ConsoleModel) {
    let is_requested = std::env::var("HOLDPOINT_TEST_PANIC").is_ok_and(|who| who == "ui");
    if is_requested && model.engine_data.snapshot.is_some() {
        std::panic::panic_any("HOLDPOINT_TEST_PANIC asked for it");
    }
}
