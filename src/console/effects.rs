//! Carries out the reducer's effects and answers with messages.
//!
//! Owns the connection to the engine, the identities' keys during a signature, files and the clipboard. Must not
//! decide: the prompt made each signed decision, and the engine checks it again.

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
use super::keymap::Keymap;
use super::look::Look;
use super::model::{ConsoleModel, EngineAbsence};
use super::msg::MsgKind;
use super::run::screen::Screen;
use super::terminal::TerminalGuard;
use super::theme::Themes;
use holdpoint_approvals::Passphrase;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_protocol::command::{AuthorityEffect, Command, Refusal, Reply, Request};
use holdpoint_recordings::recording::Recording;
use holdpoint_service::engine_handle::{EngineEndError, EngineHandle, RequestRejected};
use holdpoint_text::{Hint, Problem, Untrusted, WIDTH_MAX};
use holdpoint_wording::console::effects as wording;
use holdpoint_wording::console::shared;

/// The pause between two bells at least, ms: an alarm flood must not become a continuous tone.
const BELL_INTERVAL_MS: u64 = 10_000;

/// Reads a candidate for registration from the folder, or the next demonstration candidate besides the known
/// versions. Returns the engine's command, or the problem.
pub type ReadCandidate = Box<dyn FnMut(Option<&str>, &[CapabilityId]) -> Result<Command, Problem>>;

/// The contents of an operator's own files.
pub struct OperatorFiles {
    pub keymap: Arc<Keymap>,
    pub themes: Themes,
}

/// Checks whether the operator's files changed: nothing if not, else their contents or the problem.
pub type ReadOperatorFiles = Box<dyn FnMut() -> Option<Result<OperatorFiles, Problem>>>;

/// Makes and enrolls an identity without a passphrase, on a separate thread: it may wait for the engine.
pub type MakeIdentity = Arc<dyn Fn(&str) -> Result<(), Problem> + Send + Sync>;

/// Reads the recording of an upgrade from its files; slow, so on a separate thread.
pub type ReadRecording = Arc<dyn Fn(&[PathBuf]) -> Result<Recording, Problem> + Send + Sync>;

/// Services of the program besides the engine.
pub struct Services {
    pub read_candidate: ReadCandidate,
    pub read_own_files: ReadOperatorFiles,
    pub make_identity: MakeIdentity,
    pub read_recording: ReadRecording,
}

/// The objects that an effect works on.
pub struct EffectTarget<'a> {
    pub screen: &'a mut Screen,
    pub terminal: &'a TerminalGuard,
    pub look: &'a mut Look,
    pub model: &'a ConsoleModel,
}

/// The result of an effect.
#[derive(Debug, PartialEq)]
pub enum EffectOutcome {
    Quiet,
    /// A message for the reducer.
    Message(MsgKind),
    End,
    Leave,
    Detach,
}

/// The result of a long job.
pub enum BackgroundResult {
    /// A message for the reducer.
    Message(MsgKind),
    /// A signed request for the engine.
    Signed(Box<Request>),
    /// The result of a search for a running engine on the store: the connection, or why there is none.
    Reconnected(Result<Box<EngineHandle>, String>),
    /// The result of starting an engine in its own process: the connection, or why there is none.
    Started(Result<Box<StartedEngine>, EngineEndError>),
}

/// An engine that a console has started.
pub struct StartedEngine {
    pub host: EngineHandle,
    /// A notice for the operator; absent if there is none.
    pub notice: Option<String>,
}

pub struct EffectRunner {
    pub host: EngineHandle,
    services: Services,
    themes: Themes,
    exports: Option<PathBuf>,
    job_results: mpsc::Sender<BackgroundResult>,
    view: Option<SocketAddr>,
    last_bell_ms: Option<u64>,
}

impl EffectRunner {
    /// The executor for an engine. `exports` is the fallback folder for exports; long jobs report to `jobs`; `view`
    /// is the address of the live scene, if it is served already.
    #[must_use]
    pub fn new(
        host: EngineHandle,
        services: Services,
        themes: Themes,
        exports: Option<PathBuf>,
        jobs: mpsc::Sender<BackgroundResult>,
        view: Option<SocketAddr>,
    ) -> Self {
        Self { host, services, themes, exports, job_results: jobs, view, last_bell_ms: None }
    }

    /// Carries out one effect.
    ///
    /// # Errors
    /// If the terminal cannot be written to: it is lost.
    pub fn execute(&mut self, effect: Effect, place: &mut EffectTarget<'_>) -> io::Result<EffectOutcome> {
        Ok(match effect {
            Effect::Ask { id, question } => self.send(place.model, id, question.into_command()),
            Effect::Operate { id, confirmed, passphrase } => {
                self.send_signed(place.model, id, confirmed.into_command(), passphrase)
            }
            Effect::Decide { id, decision, passphrase } => {
                let (folder, is_protected) = (self.host.identities(), passphrase.is_some());
                let of = id.clone();
                self.sign(id, is_protected, move || {
                    people::sign(&folder, &decision, passphrase).map(|command| Request::unsigned(of, command))
                })
            }
            Effect::Register { id, folder, passphrase } => {
                let known = known_versions(place.model);
                let folder = folder.as_deref().map(folder::in_home);
                match (self.services.read_candidate)(folder.as_deref(), &known) {
                    Ok(command) => self.send_signed(place.model, id, command, passphrase),
                    Err(problem) => refused(id, Refusal::BadInput, &problem),
                }
            }
            Effect::ReadIdentities => match people::list(&self.host.identities()) {
                Ok(people) => EffectOutcome::Message(MsgKind::Identities(people)),
                Err(problem) => bad(problem.sentence()),
            },
            Effect::UseIdentity(name) => match people::find(&self.host.identities(), &name) {
                Ok(operator) => EffectOutcome::Message(MsgKind::Operator(operator)),
                Err(problem) => {
                    let text = Untrusted::new(problem.sentence()).display(WIDTH_MAX).into_string();
                    EffectOutcome::Message(MsgKind::NoIdentity { name, text })
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
                    EffectOutcome::Message(MsgKind::Theme(name))
                }
                Err(error) => bad(error.sentence()),
            },
            Effect::CheckOperatorFiles => self.look_at_own_files(place),
            Effect::TakeMouse(take) => {
                place.terminal.take_mouse(take)?;
                EffectOutcome::Quiet
            }
            Effect::Bell => self.ring(place)?,
            Effect::End => EffectOutcome::End,
            Effect::Leave => EffectOutcome::Leave,
            Effect::Detach => EffectOutcome::Detach,
        })
    }

    /// Loads keys and themes that changed while the console is open. A faulty file changes nothing, and the console
    /// shows the problem.
    fn look_at_own_files(&mut self, place: &mut EffectTarget<'_>) -> EffectOutcome {
        match (self.services.read_own_files)() {
            None => EffectOutcome::Quiet,
            Some(Err(problem)) => bad(wording::old_ones_stay(&problem.sentence())),
            Some(Ok(files)) => {
                self.themes = files.themes;
                // The theme in use may be missing or changed.
                if let Ok(theme) = self.themes.get(place.look.theme().name()) {
                    *place.look = place.look.with_theme(theme);
                }
                EffectOutcome::Message(MsgKind::OperatorFiles {
                    keymap: files.keymap,
                    themes: self.themes.names(),
                })
            }
        }
    }

    /// Makes an identity as the command line does, on a separate thread, because the engine enrolls it.
    fn make_identity(&self, name: String) -> EffectOutcome {
        let (sender, folder) = (self.job_results.clone(), self.host.identities());
        let make = Arc::clone(&self.services.make_identity);
        let work = move || {
            let message = match make(&name).and_then(|()| people::find(&folder, &name)) {
                Ok(operator) => MsgKind::Operator(operator),
                Err(problem) => status_message(&problem.sentence(), true),
            };
            // The console may have ended meanwhile.
            drop(sender.blocking_send(BackgroundResult::Message(message)));
        };
        spawn_job("identity", String::new(), work)
    }

    /// Finds completions of a typed path, on a separate thread, because a folder may answer slowly.
    fn read_folder(&self, typed: String, path: String) -> EffectOutcome {
        let sender = self.job_results.clone();
        let work = move || {
            let lines = folder::completions(&typed, &path);
            // The console may have ended meanwhile.
            drop(sender.blocking_send(BackgroundResult::Message(MsgKind::Completions { typed, lines })));
        };
        spawn_job("folder", String::new(), work)
    }

    /// Whether there is a key of this name.
    #[must_use]
    pub fn knows(&self, name: &str) -> bool {
        people::find(&self.host.identities(), name).is_ok()
    }

    /// Sends the engine a query; a full queue counts as an answer.
    #[must_use]
    pub fn send(&self, model: &ConsoleModel, id: String, command: Command) -> EffectOutcome {
        self.submit(model, Request::unsigned(id, command))
    }

    /// Sends a request to the engine, with the operator's signature where the engine requires one.
    fn send_signed(
        &self,
        model: &ConsoleModel,
        id: String,
        command: Command,
        passphrase: Option<Passphrase>,
    ) -> EffectOutcome {
        let signing = model.engine_data.snapshot.as_ref().and_then(|snapshot| snapshot.signing.clone());
        let gives = command.authority_effect() == AuthorityEffect::Gives;
        let Some(signing) = signing.filter(|signing| signing.required && gives) else {
            return self.send(model, id, command);
        };
        let who = model.session.operator.as_ref().map(|who| who.name.as_str());
        let Some(name) = command.by().or(who).map(ToOwned::to_owned) else {
            return refused(id, Refusal::BadInput, &Problem::new(shared::CHOOSE_IDENTITY_FIRST));
        };
        let (folder, is_protected) = (self.host.identities(), passphrase.is_some());
        let of = id.clone();
        self.sign(id, is_protected, move || {
            let seal = Some(people::seal(&folder, &name, &signing, &command, passphrase)?);
            Ok(Request { id: of, command, seal })
        })
    }

    /// Signs on a separate thread: a key can be slow to open or wait for a person, and the operator must be able to
    /// stop the arm meanwhile.
    fn sign(
        &self,
        id: String,
        is_protected: bool,
        work: impl FnOnce() -> Result<Request, Problem> + Send + 'static,
    ) -> EffectOutcome {
        let (sender, of) = (self.job_results.clone(), id.clone());
        let work = move || {
            let result = match work() {
                Ok(request) => BackgroundResult::Signed(Box::new(request)),
                Err(problem) if is_protected => {
                    BackgroundResult::Message(MsgKind::Unsigned { id: of, text: problem.sentence() })
                }
                Err(problem) => BackgroundResult::Message(answer(of, Refusal::BadInput, &problem)),
            };
            // The console may have ended meanwhile.
            drop(sender.blocking_send(result));
        };
        spawn_job("signing", id, work)
    }

    /// Sends the engine a request; a full queue counts as an answer. Without an engine here, only a stop goes to the
    /// running engine of the store.
    #[must_use]
    pub fn submit(&self, model: &ConsoleModel, request: Request) -> EffectOutcome {
        match self.host.submit(request) {
            Ok(()) => EffectOutcome::Quiet,
            Err(RequestRejected::Busy(request)) => {
                let hint = wording::WAIT_FOR_ANSWERS;
                let problem = Problem::new(wording::ENGINE_BUSY).with_hint(hint);
                refused(request.id, Refusal::NotNow, &problem)
            }
            Err(RequestRejected::Ended(request)) if request.command.stops_what_acts() => {
                self.stop_at_work(*request)
            }
            Err(RequestRejected::Ended(request)) => refused(
                request.id,
                Refusal::NotNow,
                &model.absence().unwrap_or(EngineAbsence::Ended).problem(),
            ),
        }
    }

    /// Sends a stop to the engine in another process, on a separate thread, because it may answer slowly.
    fn stop_at_work(&self, request: Request) -> EffectOutcome {
        let (sender, engine, id) = (self.job_results.clone(), self.host.remote_engine(), request.id.clone());
        spawn_job("stopping", id, move || {
            let reply = Box::new(engine.send(request.command));
            // The console may have ended meanwhile.
            drop(sender.blocking_send(BackgroundResult::Message(MsgKind::Answer { id: request.id, reply })));
        })
    }

    fn ring(&mut self, place: &mut EffectTarget<'_>) -> io::Result<EffectOutcome> {
        let now_ms = place.model.now_ms;
        let rests =
            self.last_bell_ms.is_some_and(|rung_ms| now_ms.saturating_sub(rung_ms) < BELL_INTERVAL_MS);
        if !rests {
            self.last_bell_ms = Some(now_ms);
            place.screen.send(b"\x07")?;
        }
        Ok(EffectOutcome::Quiet)
    }

    fn recording(&self, version: &CapabilityId) -> EffectOutcome {
        match viewer::files(&self.host.recordings(), version) {
            Ok(files) => self.show(ViewerScene::Files(files)),
            Err(text) => bad(text),
        }
    }

    fn live(&self) -> EffectOutcome {
        let address = self.view.unwrap_or(viewer::LIVE);
        if !self.host.serve_scene(address) {
            return bad(wording::NO_LIVE_SCENE.to_owned());
        }
        self.show(ViewerScene::Live(address))
    }

    fn show(&self, shown: ViewerScene) -> EffectOutcome {
        let read = Arc::clone(&self.services.read_recording);
        viewer::open(shown, self.host.logs(), read, self.job_results.clone())
    }
}

/// Starts a long job beside the console, which keeps reading keys.
fn spawn_job(name: &str, id: String, work: impl FnOnce() + Send + 'static) -> EffectOutcome {
    match std::thread::Builder::new().name(name.to_owned()).spawn(work) {
        Ok(_) => EffectOutcome::Quiet,
        Err(error) => {
            let text = wording::no_thread(name, error);
            refused(id, Refusal::BadInput, &Problem::new(text))
        }
    }
}

/// The versions that the console knows, with history if the registry was read.
fn known_versions(model: &ConsoleModel) -> Vec<CapabilityId> {
    let candidates = model.engine_data.snapshot.iter().flat_map(|snapshot| &snapshot.candidates);
    let listed = model.engine_data.registry.page.rows.iter().map(|row| &row.version);
    candidates.map(|candidate| &candidate.version).chain(listed).cloned().collect()
}

fn good(text: String) -> EffectOutcome {
    EffectOutcome::Message(MsgKind::Done { text, bad: false })
}

fn bad(text: String) -> EffectOutcome {
    EffectOutcome::Message(status_message(&text, true))
}

fn status_message(text: &str, bad: bool) -> MsgKind {
    MsgKind::Done { text: Untrusted::new(text).display(WIDTH_MAX).into_string(), bad }
}

fn refused(id: String, code: Refusal, problem: &impl Hint) -> EffectOutcome {
    EffectOutcome::Message(answer(id, code, problem))
}

fn answer(id: String, code: Refusal, problem: &impl Hint) -> MsgKind {
    MsgKind::Answer { id, reply: Box::new(Reply::refused(code, problem)) }
}
