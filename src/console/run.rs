//! The run loop: everything that happens becomes a message, the reducer says what is to be done, and what changed
//! is drawn at the pace that fits.
//!
//! Owns the order of beginning and ending: terminal first and given back last, the first frame before the engine,
//! the engine's end before the screen's. Must not decide anything: that is the reducer's, and behind it the
//! engine's.

mod farewell;
pub mod input;
pub mod pace;
pub mod screen;
mod session;

use std::borrow::Cow;
use std::io;
use std::net::SocketAddr;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

pub use self::farewell::{Cause, Left};
use self::screen::Screen;
use self::session::Session;
pub use super::effects::Begun;
use super::effects::Services;
use super::keymap::Keymap;
use super::look::{Look, LookOptions, ThemeError};
use super::model::{ConsoleSettings, Model};
use super::options::Options;
use super::terminal::guard::RunningGuard;
use super::terminal::log::{LogFile, state_folder};
use super::terminal::{TerminalGuard, background, panic};
use super::theme::Themes;
use holdpoint_engine::host::{EndFault, Host, HostConfig};
use holdpoint_protocol::seat::Sitting;
use holdpoint_text::Hint;

/// The engine that a console is at.
pub enum EngineAt {
    /// One that starts with the console, in its process.
    Here(HostConfig),
    /// One that is at work in another process.
    Elsewhere(Box<Host>),
    /// One that is started in a process of its own: what waits for it, and how it is started.
    Begun(Box<Host>, BeginEngine),
}

/// Starts an engine in a process of its own and sits down at it. Waits for that, so it is called on a thread of its own.
pub type BeginEngine = Box<dyn FnOnce(Sitting) -> Result<Begun, EndFault> + Send>;

/// What a console is started with.
pub struct Console {
    pub engine: EngineAt,
    /// Where the live scene is served; absent if it is not.
    pub view: Option<SocketAddr>,
    pub options: Options,
    /// How a shell names the store, where it is not the one that is taken without a word.
    pub data: Option<String>,
    pub keymap: Arc<Keymap>,
    /// The themes there are.
    pub themes: Themes,
    pub services: Services,
}

/// Why there was no console, or none any more.
#[derive(Debug, thiserror::Error)]
pub enum ConsoleError {
    /// The theme does not exist.
    #[error(transparent)]
    Theme(#[from] ThemeError),
    /// The terminal, or what is needed beside it, cannot be used.
    #[error("cannot use this terminal: {0}")]
    Terminal(#[from] io::Error),
    /// A fault of the console's own; it is in the words that were printed before.
    #[error("the console failed; the engine was left holding")]
    Failed,
}

impl Hint for ConsoleError {
    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Theme(error) => error.hint(),
            Self::Terminal(_) => Some("`holdpoint run --plain` needs none".into()),
            Self::Failed => None,
        }
    }
}

/// Runs a console on this terminal to its end. Both standard input and output are a terminal's.
///
/// # Errors
/// [`ConsoleError`]; the terminal is as it was.
pub fn run(console: Console) -> Result<Left, ConsoleError> {
    // What is wrong with the settings is said on the terminal as it is.
    let look = look(&console.options, &console.themes, None)?;
    let guard = RunningGuard::start()?;
    panic::install();
    let ended = catch_unwind(AssertUnwindSafe(|| on_screen(console, look, guard)));
    panic::uninstall();
    ended.unwrap_or(Err(ConsoleError::Failed))
}

/// Everything between taking the terminal and giving it back.
fn on_screen(console: Console, look: Look, guard: RunningGuard) -> Result<Left, ConsoleError> {
    let state = state_folder();
    // A console without a log is better than none.
    let log = state.as_deref().and_then(|folder| LogFile::open(folder).ok());
    let terminal = TerminalGuard::enter(log, console.options.mouse)?;
    let look = if console.options.theme.is_none() && look.depth() != super::look::Depth::Mono {
        // Nothing reads keys yet: the terminal's answer cannot be taken for some.
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
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build()?;
    let exports = state.map(|folder| folder.join("exports"));
    let parts = session::Parts {
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

fn model(options: &Options, keymap: Arc<Keymap>, themes: &Themes, look: &Look) -> Model {
    let settings = ConsoleSettings {
        read_only: options.read_only,
        mouse: options.mouse,
        tour: options.tour.then_some(0),
        theme: look.theme().name().to_owned(),
    };
    Model::new(settings, keymap, themes.names())
}
