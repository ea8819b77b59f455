//! The run loop of a replay: waits for a key, a signal or the next frame, updates the model, and draws the changes.
//!
//! Owns terminal and clock while a replay is open. It sleeps until something changes.

use std::borrow::Cow;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::{Duration, Instant};

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use tokio::sync::mpsc;

use super::frame;
use super::jump::ms_of_tick;
use super::model::ReplayModel;
use super::playback::wakes_in_ms;
use super::speed::Speed;
use super::timeline::Timeline;
use super::update::{ReplayEffect, ReplayMsg, ReplayMsgKind, update};
use crate::frame::plain;
use crate::look::{ColorDepth, Look, ThemeError};
use crate::msg;
use crate::options::Options;
use crate::run::input;
use crate::run::look;
use crate::run::screen::Screen;
use crate::terminal::guard::RunningGuard;
use crate::terminal::log::{LogFile, state_folder};
use crate::terminal::{TerminalGuard, background, panic};
use crate::theme::Themes;
use holdpoint_recordings::recording::Recording;
use holdpoint_text::{ErrorDetails, ErrorReason, Hint};
use holdpoint_wording::console::replay as wording;
use holdpoint_wording::console::shared;

/// Keys that are processed before a frame is drawn.
const BATCH_MAX: usize = 64;

/// How a replay is shown.
#[derive(Clone, Debug)]
pub struct ReplayOptions {
    /// Where it begins; at the first moment if absent.
    pub start_tick: Option<u64>,
    /// How fast it plays.
    pub speed: Speed,
    /// Theme, colors and glyphs from the console's settings.
    pub console: Options,
    /// The themes there are.
    pub themes: Themes,
}

/// Why a replay did not start, or ended early.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The theme does not exist.
    #[error(transparent)]
    Theme(#[from] ThemeError),
    /// The recording is empty.
    #[error("{}", wording::holds_nothing(.0))]
    Empty(String),
    /// The terminal, or what is needed beside it, cannot be used.
    #[error("{}", shared::cannot_use_terminal(.0))]
    Terminal(#[from] io::Error),
    /// A fault of the replay itself; its message was printed before.
    #[error("{}", wording::REPLAY_FAILED)]
    Failed,
}

impl Hint for ReplayError {
    fn details(&self) -> Option<ErrorDetails> {
        match self {
            Self::Theme(error) => error.details(),
            Self::Empty(_) => Some(ErrorReason::BadFile.into()),
            Self::Terminal(_) => Some(ErrorReason::Environment.into()),
            Self::Failed => Some(ErrorReason::Internal.into()),
        }
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Theme(error) => error.hint(),
            Self::Empty(_) => Some(wording::EXPLAIN_NEEDS_NONE.into()),
            Self::Terminal(_) => Some(wording::PRINTS_WITHOUT_A_TERMINAL.into()),
            Self::Failed => None,
        }
    }
}

/// Replays a recording on this terminal until the user leaves or a signal comes. Standard input and output are a
/// terminal.
///
/// # Errors
/// [`ReplayError`]; the terminal is as it was.
pub fn run(recording: Recording, options: ReplayOptions) -> Result<(), ReplayError> {
    if recording.span_ms().is_none() {
        return Err(ReplayError::Empty(recording.about.version.to_string()));
    }
    // Problems of the settings are printed before the screen opens.
    let look = look(&options.console, &options.themes, None)?;
    let mut model = ReplayModel::new(Timeline::new(recording), options.speed);
    if let Some(tick) = options.start_tick {
        model.cursor = model.timeline.at(ms_of_tick(tick));
    }
    let guard = RunningGuard::start()?;
    panic::install();
    let ended = catch_unwind(AssertUnwindSafe(|| on_screen(model, look, &options, guard)));
    panic::uninstall();
    ended.unwrap_or(Err(ReplayError::Failed))
}

/// One moment of a recording as plain text, without blanks at the ends of lines; the options set the moment.
///
/// # Errors
/// [`ReplayError::Theme`] or [`ReplayError::Empty`].
pub fn still(
    recording: Recording,
    options: &ReplayOptions,
    (width, height): (u16, u16),
) -> Result<String, ReplayError> {
    if recording.span_ms().is_none() {
        return Err(ReplayError::Empty(recording.about.version.to_string()));
    }
    let look = look(&options.console, &options.themes, None)?;
    let mut model = ReplayModel::new(Timeline::new(recording), options.speed);
    if let Some(tick) = options.start_tick {
        model.cursor = model.timeline.at(ms_of_tick(tick));
    }
    let area = Rect::new(0, 0, width, height);
    let mut buf = Buffer::empty(area);
    frame::draw(&model, &look, area, &mut buf);
    Ok(plain(&buf))
}

/// Everything between taking the terminal and giving it back.
fn on_screen(
    model: ReplayModel,
    look: Look,
    options: &ReplayOptions,
    guard: RunningGuard,
) -> Result<(), ReplayError> {
    // A replay without a log is better than none.
    let log = state_folder().and_then(|folder| LogFile::open(&folder).ok());
    let terminal = TerminalGuard::enter(log, false)?;
    let look = if options.console.theme.is_none() && look.depth() != ColorDepth::Mono {
        // No thread reads keys yet, so the terminal's answer cannot be taken for keys.
        self::look(&options.console, &options.themes, background::is_light())?
    } else {
        look
    };
    let mut screen = Screen::new()?;
    screen.draw(|area, buffer| frame::draw(&model, &look, area, buffer))?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build()?;
    let showing =
        ReplaySession { started_at: Instant::now(), model, look, screen, inputs: input::start()?, guard };
    let ended = runtime.block_on(showing.run());
    drop(terminal);
    ended.map_err(ReplayError::Terminal)
}

/// A replay on the screen.
struct ReplaySession {
    started_at: Instant,
    model: ReplayModel,
    look: Look,
    screen: Screen,
    inputs: mpsc::Receiver<msg::MsgKind>,
    guard: RunningGuard,
}

enum ReplayInput {
    Input(Option<msg::MsgKind>),
    Ending,
    Time,
}

impl ReplaySession {
    /// Runs until the user leaves; a lost terminal or a signal counts as leaving.
    async fn run(mut self) -> io::Result<()> {
        loop {
            let effects = match self.wait().await {
                ReplayInput::Input(Some(what)) => self.fold_inputs(what)?,
                ReplayInput::Input(None) | ReplayInput::Ending => return Ok(()),
                ReplayInput::Time => self.fold(ReplayMsgKind::Tick),
            };
            if effects.contains(&ReplayEffect::Leave) {
                return Ok(());
            }
            if effects.contains(&ReplayEffect::Draw) {
                #[cfg(debug_assertions)]
                panic_if_requested();
                let (model, look) = (&self.model, &self.look);
                self.screen.draw(|area, buffer| frame::draw(model, look, area, buffer))?;
            }
        }
    }

    async fn wait(&mut self) -> ReplayInput {
        let wakes_in = wakes_in_ms(&self.model).map(Duration::from_millis);
        tokio::select! {
            biased;
            _ = self.guard.ending() => ReplayInput::Ending,
            what = self.inputs.recv() => ReplayInput::Input(what),
            () = after(wakes_in) => ReplayInput::Time,
        }
    }

    /// Waiting keys are processed together, so that the frame shows their final state.
    fn fold_inputs(&mut self, first: msg::MsgKind) -> io::Result<Vec<ReplayEffect>> {
        let mut effects = self.fold_input(first)?;
        for _ in 0..BATCH_MAX {
            let Ok(what) = self.inputs.try_recv() else { break };
            effects.extend(self.fold_input(what)?);
        }
        Ok(effects)
    }

    fn fold_input(&mut self, what: msg::MsgKind) -> io::Result<Vec<ReplayEffect>> {
        let what = match what {
            msg::MsgKind::Key(key) => ReplayMsgKind::Key(key),
            msg::MsgKind::Paste(text) => ReplayMsgKind::Paste(text),
            msg::MsgKind::Resize(columns, rows) => {
                self.screen.resize(columns, rows)?;
                ReplayMsgKind::Resize
            }
            // The mouse is off, and there is no engine to send the other messages.
            msg::MsgKind::Wheel(_)
            | msg::MsgKind::Burst
            | msg::MsgKind::LineMode(_)
            | msg::MsgKind::Click(..)
            | msg::MsgKind::EngineStarted
            | msg::MsgKind::Events(_)
            | msg::MsgKind::Past { .. }
            | msg::MsgKind::Attached(..)
            | msg::MsgKind::ReconnectFailed(_)
            | msg::MsgKind::Answer { .. }
            | msg::MsgKind::Lagged(_)
            | msg::MsgKind::Snapshot(_)
            | msg::MsgKind::VideoFrame(_)
            | msg::MsgKind::EngineEnded(_)
            | msg::MsgKind::Identities(_)
            | msg::MsgKind::Operator(_)
            | msg::MsgKind::Done { .. }
            | msg::MsgKind::NoIdentity { .. }
            | msg::MsgKind::OperatorFiles { .. }
            | msg::MsgKind::Completions { .. }
            | msg::MsgKind::Unsigned { .. }
            | msg::MsgKind::RecordingRead { .. }
            | msg::MsgKind::Theme(_)
            | msg::MsgKind::DecisionShown(_)
            | msg::MsgKind::EndRequested
            | msg::MsgKind::Tick => ReplayMsgKind::Tick,
        };
        Ok(self.fold(what))
    }

    fn fold(&mut self, what: ReplayMsgKind) -> Vec<ReplayEffect> {
        let now_ms = u64::try_from(self.started_at.elapsed().as_millis()).unwrap_or(u64::MAX);
        update(&mut self.model, ReplayMsg { now_ms, what })
    }
}

/// Tests the panic policy: a screen that fails while it is drawn. Not in a release.
#[cfg(debug_assertions)]
#[allow(clippy::panic, reason = "that is what is tested")]
fn panic_if_requested() {
    if std::env::var("HOLDPOINT_TEST_PANIC").is_ok_and(|who| who == "ui") {
        std::panic::panic_any("HOLDPOINT_TEST_PANIC asked for it");
    }
}

/// Waits this long; for ever without a duration.
async fn after(span: Option<Duration>) {
    match span {
        Some(span) => tokio::time::sleep(span).await,
        None => std::future::pending().await,
    }
}
