//! The run loop: each event becomes a message, the reducer requests effects, and changes are drawn at a suitable
//! pace.
//!
//! Owns the order of start and end: the terminal is first and last, the first frame comes before the engine, and the
//! engine ends before the screen. Must not decide anything: the reducer does, and behind it the engine.

mod exit_message;
pub mod frame_pace;
pub mod input;
pub mod screen;
mod session;

use std::borrow::Cow;
use std::io;
use std::net::SocketAddr;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

pub use self::exit_message::{ExitCause, ExitReport};
use self::screen::Screen;
use self::session::Session;
use super::effects::Services;
pub use super::effects::StartedEngine;
use super::keymap::Keymap;
use super::look::{Look, LookOptions, ThemeError};
use super::model::{ConsoleModel, ConsoleSettings};
use super::options::Options;
use super::terminal::guard::RunningGuard;
use super::terminal::log::{LogFile, state_folder};
use super::terminal::{TerminalGuard, background, panic};
use super::theme::Themes;
use holdpoint_protocol::console_presence::ConsolePresence;
use holdpoint_service::engine_handle::{EngineEndError, EngineHandle, LaunchConfig};
use holdpoint_text::{ErrorDetails, ErrorReason, Hint};
use holdpoint_wording::console::run as wording;
use holdpoint_wording::console::shared;

/// The engine of a console.
pub enum EngineLocation {
    /// An engine that starts with the console, in its process.
    Here(LaunchConfig),
    /// A running engine in another process.
    Elsewhere(Box<EngineHandle>),
    /// An engine that is started in a separate process: the channel that waits for it, and how to start it.
    Begun(Box<EngineHandle>, StartEngine),
}

/// Starts an engine in its own process and attaches to it. It blocks, so the caller uses a separate thread.
pub type StartEngine = Box<dyn FnOnce(ConsolePresence) -> Result<StartedEngine, EngineEndError> + Send>;

/// The parameters of a console.
pub struct ConsoleSetup {
    pub engine: EngineLocation,
    /// The address of the live scene; absent if it is not served.
    pub view: Option<SocketAddr>,
    pub options: Options,
    /// The store as a shell names it; absent if it is the default store.
    pub data: Option<String>,
    pub keymap: Arc<Keymap>,
    /// The themes there are.
    pub themes: Themes,
    pub services: Services,
}

/// Why a console did not start, or ended early.
#[derive(Debug, thiserror::Error)]
pub enum ConsoleError {
    /// The theme does not exist.
    #[error(transparent)]
    Theme(#[from] ThemeError),
    /// The terminal, or what is needed beside it, cannot be used.
    #[error("{}", shared::cannot_use_terminal(.0))]
    Terminal(#[from] io::Error),
    /// A fault of the console itself; its message was printed before.
    #[error("{}", wording::CONSOLE_FAILED)]
    Failed,
}

impl Hint for ConsoleError {
    fn details(&self) -> Option<ErrorDetails> {
        match self {
            Self::Theme(error) => error.details(),
            Self::Terminal(_) => Some(ErrorReason::Environment.into()),
            Self::Failed => Some(ErrorReason::Internal.into()),
        }
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Theme(error) => error.hint(),
            Self::Terminal(_) => Some(wording::PLAIN_NEEDS_NONE.into()),
            Self::Failed => None,
        }
    }
}

/// Runs a console on this terminal until it ends. Standard input and output are a terminal.
///
/// # Errors
/// [`ConsoleError`]; the terminal is as it was.
pub fn run(console: ConsoleSetup) -> Result<ExitReport, ConsoleError> {
    // Problems of the settings are printed before the screen opens.
    let look = look(&console.options, &console.themes, None)?;
    let guard = RunningGuard::start()?;
    panic::install();
    let ended = catch_unwind(AssertUnwindSafe(|| on_screen(console, look, guard)));
    panic::uninstall();
    ended.unwrap_or(Err(ConsoleError::Failed))
}

/// Everything between taking the terminal and giving it back.
fn on_screen(console: ConsoleSetup, look: Look, guard: RunningGuard) -> Result<ExitReport, ConsoleError> {
    let state = state_folder();
    // A console without a log is better than none.
    let log = state.as_deref().and_then(|folder| LogFile::open(folder).ok());
    let terminal = TerminalGuard::enter(log, console.options.mouse)?;
    let look = if console.options.theme.is_none() && look.depth() != super::look::ColorDepth::Mono {
        // No thread reads keys yet, so the terminal's answer cannot be taken for keys.
        self::look(&console.options, &console.themes, background::is_light())?
    } else {
        look
    };
    let mut screen = Screen::new()?;
    let mut model = model(&console.options, console.keymap, &console.themes, &look);
    model.data = console.data;
    if let Ok(size) = screen.size() {
        model.size = size;
    }
    // The first frame does not wait for the engine.
    screen.draw(|area, buffer| super::frame::draw(&model, &look, area, buffer))?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let exports = state.map(|folder| folder.join("exports"));
    let parts = session::SessionParts {
        engine: console.engine,
        view: console.view,
        services: console.services,
        themes: console.themes,
        exports,
        operator: console.options.operator,
    };
    let session = Session::start(parts, model, look, screen, terminal, guard)?;
    Ok(runtime.block_on(session.run()))
}

/// The look by flags and settings, then the environment, then the background.
pub(super) fn look(
    options: &Options,
    themes: &Themes,
    light_background: Option<bool>,
) -> Result<Look, ThemeError> {
    let variable = |name| std::env::var(name).ok();
    let chosen = options.theme.as_deref().map(|name| themes.get(name)).transpose()?;
    let fitting = Look::detect(&LookOptions {
        theme: None,
        color: options.color.unwrap_or_default(),
        ascii: options.ascii,
        no_color: variable("NO_COLOR").is_some_and(|value| !value.is_empty()),
        term: variable("TERM"),
        colorterm: variable("COLORTERM"),
        light_background,
    })?;
    Ok(chosen.map_or(fitting.clone(), |theme| fitting.with_theme(theme)))
}

fn model(options: &Options, keymap: Arc<Keymap>, themes: &Themes, look: &Look) -> ConsoleModel {
    let settings = ConsoleSettings {
        read_only: options.read_only,
        mouse: options.mouse,
        tour: options.tour.then_some(0),
        theme: look.theme().name().to_owned(),
    };
    ConsoleModel::new(settings, keymap, themes.names())
}
