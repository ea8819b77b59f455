//! Carries out what the reducer wants done, and answers with messages.
//!
//! Owns the way to the engine, the identities' keys for the moment of a signature, files and the clipboard. Must
//! not decide: a decision that is signed here was made in the prompt, and the engine checks it again.

mod clipboard;
mod export;
mod people;
mod viewer;

use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;

use tokio::sync::mpsc;

use self::viewer::ViewerScene;
use super::effect::Effect;
use super::look::Look;
use super::model::Model;
use super::msg::MsgKind;
use super::run::screen::Screen;
use super::terminal::TerminalGuard;
use super::theme::Themes;
use holdpoint_approvals::Passphrase;
use holdpoint_engine::host::Host;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_protocol::command::{Command, Refusal, Reply, Request};
use holdpoint_text::{Hint, Problem, Untrusted};

/// The pause between two bells at least, ms: an alarm flood must not become a continuous tone.
const BELL_INTERVAL_MS: u64 = 10_000;

/// Reads a candidate for registration: the folder, or the next demonstration candidate that is none of the known
/// versions. Answers the engine's command, or what is wrong.
pub type ReadCandidate = Box<dyn FnMut(Option<&str>, &[CapabilityId]) -> Result<Command, Problem>>;

/// What an effect is carried out on.
pub struct EffectTarget<'a> {
    pub screen: &'a mut Screen,
    pub terminal: &'a TerminalGuard,
    pub look: &'a mut Look,
    pub model: &'a Model,
}

/// What came of an effect.
#[derive(Debug, PartialEq)]
pub enum Outcome {
    Quiet,
    /// Something to tell the reducer.
    Told(MsgKind),
    End,
}

pub struct Hands {
    pub host: Host,
    candidates: ReadCandidate,
    themes: Themes,
    exports: Option<PathBuf>,
    errands: mpsc::Sender<MsgKind>,
    view: Option<SocketAddr>,
    rung_ms: Option<u64>,
}

impl Hands {
    /// Hands for an engine. `exports` is where exports go if not here; what takes long
    /// tells `errands` how it went, and `view` is where the live scene is served already.
    #[must_use]
    pub fn new(
        host: Host,
        candidates: ReadCandidate,
        themes: Themes,
        exports: Option<PathBuf>,
        errands: mpsc::Sender<MsgKind>,
        view: Option<SocketAddr>,
    ) -> Self {
        Self { host, candidates, themes, exports, errands, view, rung_ms: None }
    }

    /// Does one thing.
    ///
    /// # Errors
    /// If the terminal cannot be written to: it is gone.
    pub fn carry_out(&mut self, effect: Effect, place: &mut EffectTarget<'_>) -> io::Result<Outcome> {
        Ok(match effect {
            Effect::Ask { id, question } => self.ask(id, question.into_command()),
            Effect::Operate { id, confirmed, passphrase } => {
                self.ask_as(place.model, id, confirmed.into_command(), passphrase)
            }
            Effect::Decide { id, decision, passphrase } => {
                let is_protected = passphrase.is_some();
                match people::sign(&self.host.identities(), &decision, passphrase) {
                    Ok(command) => self.ask(id, command),
                    Err(problem) if is_protected => {
                        Outcome::Told(MsgKind::Unsigned { id, text: problem.sentence() })
                    }
                    Err(problem) => refused(id, Refusal::BadInput, &problem),
                }
            }
            Effect::Register { id, folder, passphrase } => {
                let known = known(place.model);
                match (self.candidates)(folder.as_deref(), &known) {
                    Ok(command) => self.ask_as(place.model, id, command, passphrase),
                    Err(problem) => refused(id, Refusal::BadInput, &problem),
                }
            }
            Effect::ReadIdentities => match people::list(&self.host.identities()) {
                Ok(people) => Outcome::Told(MsgKind::Identities(people)),
                Err(problem) => bad(problem.sentence()),
            },
            Effect::UseIdentity(name) => match people::find(&self.host.identities(), &name) {
                Ok(operator) => Outcome::Told(MsgKind::Operator(operator)),
                Err(problem) => bad(problem.sentence()),
            },
            Effect::Copy(text) => clipboard::copy(place.screen, &text)?,
            Effect::Export(view) => {
                let folders = [Some(PathBuf::from(".")), self.exports.clone()];
                match export::write(&folders.into_iter().flatten().collect::<Vec<_>>(), view, place.model) {
                    Ok(text) => good(text),
                    Err(text) => bad(text),
                }
            }
            Effect::OpenRecording(version) => self.recording(&version),
            Effect::OpenLive => self.live(),
            Effect::UseTheme(name) => match self.themes.get(&name) {
                Ok(theme) => {
                    *place.look = place.look.with_theme(theme);
                    Outcome::Told(MsgKind::Theme(name))
                }
                Err(error) => bad(error.sentence()),
            },
            Effect::TakeMouse(take) => {
                place.terminal.take_mouse(take)?;
                Outcome::Quiet
            }
            Effect::Bell => self.ring(place)?,
            Effect::End => Outcome::End,
        })
    }

    /// Asks the engine; a full queue is an answer as well.
    #[must_use]
    pub fn ask(&self, id: String, command: Command) -> Outcome {
        self.hand_over(Request::unsigned(id, command))
    }

    /// Asks the engine, with the signature of who sits here where one is asked for.
    fn ask_as(&self, model: &Model, id: String, command: Command, passphrase: Option<Passphrase>) -> Outcome {
        let is_protected = passphrase.is_some();
        match people::seal(&self.host.identities(), model, &command, passphrase) {
            Ok(seal) => self.hand_over(Request { id, command, seal }),
            Err(problem) if is_protected => Outcome::Told(MsgKind::Unsigned { id, text: problem.sentence() }),
            Err(problem) => refused(id, Refusal::BadInput, &problem),
        }
    }

    fn hand_over(&self, request: Request) -> Outcome {
        let id = request.id.clone();
        match self.host.ask(request) {
            Ok(()) => Outcome::Quiet,
            Err(_) => {
                let hint = "wait for its answers, then ask again";
                refused(id, Refusal::NotNow, &Problem::new("the engine is busy").with_hint(hint))
            }
        }
    }

    fn ring(&mut self, place: &mut EffectTarget<'_>) -> io::Result<Outcome> {
        let now_ms = place.model.now_ms;
        let rests = self.rung_ms.is_some_and(|rung_ms| now_ms.saturating_sub(rung_ms) < BELL_INTERVAL_MS);
        if !rests {
            self.rung_ms = Some(now_ms);
            place.screen.send(b"\x07")?;
        }
        Ok(Outcome::Quiet)
    }

    fn recording(&self, version: &CapabilityId) -> Outcome {
        match viewer::files(&self.host.recordings(), version) {
            Ok(files) => self.show(ViewerScene::Files(files)),
            Err(text) => bad(text),
        }
    }

    fn live(&self) -> Outcome {
        let address = self.view.unwrap_or(viewer::LIVE);
        if !self.host.serve_scene(address) {
            return bad("no live scene is drawn here: this run keeps no recordings".to_owned());
        }
        self.show(ViewerScene::Live(address))
    }

    fn show(&self, shown: ViewerScene) -> Outcome {
        viewer::open(shown, self.host.logs(), self.errands.clone())
    }
}

/// The versions the console knows of, history included if the registry was read.
fn known(model: &Model) -> Vec<CapabilityId> {
    let candidates = model.told.snapshot.iter().flat_map(|snapshot| &snapshot.candidates);
    let listed = model.told.registry.page.rows.iter().map(|row| &row.version);
    candidates.map(|candidate| &candidate.version).chain(listed).cloned().collect()
}

fn good(text: String) -> Outcome {
    Outcome::Told(MsgKind::Done { text, bad: false })
}

fn bad(text: String) -> Outcome {
    Outcome::Told(MsgKind::Done { text: Untrusted::new(text).line().into_string(), bad: true })
}

fn refused(id: String, code: Refusal, problem: &impl Hint) -> Outcome {
    Outcome::Told(MsgKind::Answer { id, reply: Box::new(Reply::refused(code, problem)) })
}
