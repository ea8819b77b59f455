//! Carries out what the reducer wants done, and answers with messages.
//!
//! Owns the way to the engine, the identities' keys for the moment of a signature, files and the clipboard. Must
//! not decide: a decision that is signed here was made in the prompt, and the engine checks it again.

mod clipboard;
mod export;
mod folder;
mod people;
mod viewer;

use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;

use tokio::sync::mpsc;

use self::viewer::ViewerScene;
use super::effect::Effect;
use super::form::NOBODY;
use super::keymap::Keymap;
use super::look::Look;
use super::model::{Absence, Model};
use super::msg::MsgKind;
use super::run::screen::Screen;
use super::terminal::TerminalGuard;
use super::theme::Themes;
use holdpoint_approvals::Passphrase;
use holdpoint_engine::host::{EndFault, Host, NotTaken};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_protocol::command::{Authority, Command, Refusal, Reply, Request};
use holdpoint_text::{Hint, Problem, Untrusted, WIDTH_MAX};

/// The pause between two bells at least, ms: an alarm flood must not become a continuous tone.
const BELL_INTERVAL_MS: u64 = 10_000;

/// Reads a candidate for registration: the folder, or the next demonstration candidate that is none of the known
/// versions. Answers the engine's command, or what is wrong.
pub type ReadCandidate = Box<dyn FnMut(Option<&str>, &[CapabilityId]) -> Result<Command, Problem>>;

/// What an operator's own files say now.
pub struct OwnFiles {
    pub keymap: Arc<Keymap>,
    pub themes: Themes,
}

/// Looks whether the operator's files changed: nothing if not, else what they say or what is wrong with them.
pub type ReadOwnFiles = Box<dyn FnMut() -> Option<Result<OwnFiles, Problem>>>;

/// Makes an identity of this name without a passphrase and enrolls it. It may wait for the engine: on a thread of its own.
pub type MakeIdentity = Arc<dyn Fn(&str) -> Result<(), Problem> + Send + Sync>;

/// What the console has the program do beside the engine.
pub struct Services {
    pub read_candidate: ReadCandidate,
    pub read_own_files: ReadOwnFiles,
    pub make_identity: MakeIdentity,
}

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
    Leave,
    Detach,
}

/// What an errand that took long came to.
pub enum Errand {
    /// Something to tell the reducer.
    Told(MsgKind),
    /// A request that was signed, for the engine.
    Signed(Box<Request>),
    /// A look for an engine at work on the store: the seat at it, or why there is none.
    Sought(Result<Box<Host>, String>),
    /// An engine that was being started in a process of its own: the seat at it, or why there is none.
    Begun(Result<Box<Begun>, EndFault>),
}

/// An engine that a console has started.
pub struct Begun {
    pub host: Host,
    /// What somebody has to know about it; absent if nothing.
    pub notice: Option<String>,
}

pub struct Hands {
    pub host: Host,
    services: Services,
    themes: Themes,
    exports: Option<PathBuf>,
    errands: mpsc::Sender<Errand>,
    view: Option<SocketAddr>,
    rung_ms: Option<u64>,
}

impl Hands {
    /// Hands for an engine. `exports` is where exports go if not here; what takes long
    /// tells `errands` how it went, and `view` is where the live scene is served already.
    #[must_use]
    pub fn new(
        host: Host,
        services: Services,
        themes: Themes,
        exports: Option<PathBuf>,
        errands: mpsc::Sender<Errand>,
        view: Option<SocketAddr>,
    ) -> Self {
        Self { host, services, themes, exports, errands, view, rung_ms: None }
    }

    /// Does one thing.
    ///
    /// # Errors
    /// If the terminal cannot be written to: it is gone.
    pub fn carry_out(&mut self, effect: Effect, place: &mut EffectTarget<'_>) -> io::Result<Outcome> {
        Ok(match effect {
            Effect::Ask { id, question } => self.ask(place.model, id, question.into_command()),
            Effect::Operate { id, confirmed, passphrase } => {
                self.ask_as(place.model, id, confirmed.into_command(), passphrase)
            }
            Effect::Decide { id, decision, passphrase } => {
                let (folder, is_protected) = (self.host.identities(), passphrase.is_some());
                let of = id.clone();
                self.sign(id, is_protected, move || {
                    people::sign(&folder, &decision, passphrase).map(|command| Request::unsigned(of, command))
                })
            }
            Effect::Register { id, folder, passphrase } => {
                let known = known(place.model);
                match (self.services.read_candidate)(folder.as_deref(), &known) {
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
                Err(problem) => {
                    let text = Untrusted::new(problem.sentence()).display(WIDTH_MAX).into_string();
                    Outcome::Told(MsgKind::NoIdentity { name, text })
                }
            },
            Effect::MakeIdentity(name) => self.make_identity(name),
            Effect::ReadFolder { typed, path } => self.read_folder(typed, path),
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
            Effect::LookAtOwnFiles => self.look_at_own_files(place),
            Effect::TakeMouse(take) => {
                place.terminal.take_mouse(take)?;
                Outcome::Quiet
            }
            Effect::Bell => self.ring(place)?,
            Effect::End => Outcome::End,
            Effect::Leave => Outcome::Leave,
            Effect::Detach => Outcome::Detach,
        })
    }

    /// Takes in keys and themes that changed while the console is open. A file that is wrong changes nothing: what was in
    /// force stays, and the problem is said.
    fn look_at_own_files(&mut self, place: &mut EffectTarget<'_>) -> Outcome {
        match (self.services.read_own_files)() {
            None => Outcome::Quiet,
            Some(Err(problem)) => bad(format!("not taken in, the old ones stay: {}", problem.sentence())),
            Some(Ok(files)) => {
                self.themes = files.themes;
                // The theme in use may be gone, or another one now.
                if let Ok(theme) = self.themes.get(place.look.theme().name()) {
                    *place.look = place.look.with_theme(theme);
                }
                Outcome::Told(MsgKind::OwnFiles { keymap: files.keymap, themes: self.themes.names() })
            }
        }
    }

    /// Makes an identity as a person does on the command line. On a thread of its own, for the engine takes it in.
    fn make_identity(&self, name: String) -> Outcome {
        let (tell, folder) = (self.errands.clone(), self.host.identities());
        let make = Arc::clone(&self.services.make_identity);
        let work = move || {
            let came = match make(&name).and_then(|()| people::find(&folder, &name)) {
                Ok(operator) => MsgKind::Operator(operator),
                Err(problem) => told(&problem.sentence(), true),
            };
            // The console may have ended meanwhile.
            drop(tell.blocking_send(Errand::Told(came)));
        };
        aside("identity", String::new(), work)
    }

    /// What a typed path could become. A folder may be slow to answer: on a thread of its own.
    fn read_folder(&self, typed: String, path: String) -> Outcome {
        let tell = self.errands.clone();
        let work = move || {
            let lines = folder::completions(&typed, &path);
            // The console may have ended meanwhile.
            drop(tell.blocking_send(Errand::Told(MsgKind::Completions { typed, lines })));
        };
        aside("folder", String::new(), work)
    }

    /// Whether there is a key of this name.
    #[must_use]
    pub fn knows(&self, name: &str) -> bool {
        people::find(&self.host.identities(), name).is_ok()
    }

    /// Asks the engine; a full queue is an answer as well.
    #[must_use]
    pub fn ask(&self, model: &Model, id: String, command: Command) -> Outcome {
        self.hand_over(model, Request::unsigned(id, command))
    }

    /// Asks the engine, with the signature of who sits here where one is asked for.
    fn ask_as(&self, model: &Model, id: String, command: Command, passphrase: Option<Passphrase>) -> Outcome {
        let signing = model.told.snapshot.as_ref().and_then(|snapshot| snapshot.signing.clone());
        let gives = command.authority() == Authority::Gives;
        let Some(signing) = signing.filter(|signing| signing.required && gives) else {
            return self.ask(model, id, command);
        };
        let who = model.seat.operator.as_ref().map(|who| who.name.as_str());
        let Some(name) = command.by().or(who).map(ToOwned::to_owned) else {
            return refused(id, Refusal::BadInput, &Problem::new(NOBODY));
        };
        let (folder, is_protected) = (self.host.identities(), passphrase.is_some());
        let of = id.clone();
        self.sign(id, is_protected, move || {
            let seal = Some(people::seal(&folder, &name, &signing, &command, passphrase)?);
            Ok(Request { id: of, command, seal })
        })
    }

    /// Signs on a thread of its own: a key takes its time to open, or waits for somebody, and who sits here must be able
    /// to stop the arm meanwhile.
    fn sign(
        &self,
        id: String,
        is_protected: bool,
        work: impl FnOnce() -> Result<Request, Problem> + Send + 'static,
    ) -> Outcome {
        let (tell, of) = (self.errands.clone(), id.clone());
        let work = move || {
            let came = match work() {
                Ok(request) => Errand::Signed(Box::new(request)),
                Err(problem) if is_protected => {
                    Errand::Told(MsgKind::Unsigned { id: of, text: problem.sentence() })
                }
                Err(problem) => Errand::Told(answer(of, Refusal::BadInput, &problem)),
            };
            // The console may have ended meanwhile.
            drop(tell.blocking_send(came));
        };
        aside("signing", id, work)
    }

    /// Hands a request to the engine; a full queue is an answer as well. Where there is no engine here, what stops goes to
    /// the one that is at work on the store, and nothing else does.
    #[must_use]
    pub fn hand_over(&self, model: &Model, request: Request) -> Outcome {
        match self.host.ask(request) {
            Ok(()) => Outcome::Quiet,
            Err(NotTaken::Busy(request)) => {
                let hint = "wait for its answers, then ask again";
                let problem = Problem::new("the engine is busy").with_hint(hint);
                refused(request.id, Refusal::NotNow, &problem)
            }
            Err(NotTaken::Ended(request)) if request.command.stops_what_acts() => self.stop_at_work(*request),
            Err(NotTaken::Ended(request)) => {
                refused(request.id, Refusal::NotNow, &model.absence().unwrap_or(Absence::Ended).problem())
            }
        }
    }

    /// Has the engine in another process stop what acts. It may be slow to answer: on a thread of its own.
    fn stop_at_work(&self, request: Request) -> Outcome {
        let (tell, engine, id) = (self.errands.clone(), self.host.elsewhere(), request.id.clone());
        aside("stopping", id, move || {
            let reply = Box::new(engine.ask(request.command));
            // The console may have ended meanwhile.
            drop(tell.blocking_send(Errand::Told(MsgKind::Answer { id: request.id, reply })));
        })
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

/// Does what may take long beside the console, which goes on reading keys.
fn aside(name: &str, id: String, work: impl FnOnce() + Send + 'static) -> Outcome {
    match std::thread::Builder::new().name(name.to_owned()).spawn(work) {
        Ok(_) => Outcome::Quiet,
        Err(error) => {
            let text = format!("cannot start a thread for {name}: {error}");
            refused(id, Refusal::BadInput, &Problem::new(text))
        }
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
    Outcome::Told(told(&text, true))
}

fn told(text: &str, bad: bool) -> MsgKind {
    MsgKind::Done { text: Untrusted::new(text).display(WIDTH_MAX).into_string(), bad }
}

fn refused(id: String, code: Refusal, problem: &impl Hint) -> Outcome {
    Outcome::Told(answer(id, code, problem))
}

fn answer(id: String, code: Refusal, problem: &impl Hint) -> MsgKind {
    MsgKind::Answer { id, reply: Box::new(Reply::refused(code, problem)) }
}
