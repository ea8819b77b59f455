//! One console at work: waits for whatever comes first, folds it into the model, draws.
//!
//! Must not hang: it waits for channels alone, and what may take long is another thread's.

use std::collections::VecDeque;
use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use tokio::sync::mpsc;
use tokio::time::MissedTickBehavior;

use super::EngineAt;
use super::farewell::{self, Cause, Left};
use super::input;
use super::pace::{FramePace, Want};
use super::screen::Screen;
use crate::effect::Effect;
use crate::effects::{Begun, EffectTarget, Errand, Hands, Outcome, Services};
use crate::frame;
use crate::look::Look;
use crate::model::{EngineLink, Model, Overlay, Seeking, View};
use crate::msg::{Msg, MsgKind};
use crate::prompt::OnScreen;
use crate::terminal::TerminalGuard;
use crate::terminal::guard::{Ending, RunningGuard};
use crate::theme::Themes;
use crate::update::update;
use holdpoint_engine::host::{EndFault, Host, StopError, Update};
use holdpoint_protocol::command::{Command, Request};
use holdpoint_text::Hint as _;

/// Time passes this often if nothing else happens.
const TICK: Duration = Duration::from_millis(500);

/// How long the engine has to end in good order. Less than the guard's patience.
const ENDING_MAX: Duration = Duration::from_secs(3);

/// What is left of it for the engine's thread, once its time is over.
const STOP_MAX: Duration = Duration::from_millis(500);

/// How long the process of an engine that ended in good order has to let go of the store.
const FREE_MAX: Duration = Duration::from_secs(2);

/// Things that are folded in before a frame is looked at again.
const BATCH_MAX: usize = 256;

/// The first pause between two looks for an engine at work; each is twice as long as the one before.
const SEEK_FIRST: Duration = Duration::from_millis(500);

/// The longest of these pauses.
const SEEK_PAUSE_MAX: Duration = Duration::from_secs(15);

/// How often an engine is looked for: a quarter of an hour, and then somebody has to come.
const SEEK_MAX: u32 = 64;

/// Errands that have something to tell at once.
const ERRANDS_MAX: usize = 16;

/// What a session is made of beside the screen.
pub(super) struct Parts {
    pub(super) engine: EngineAt,
    pub(super) view: Option<SocketAddr>,
    pub(super) services: Services,
    pub(super) themes: Themes,
    pub(super) exports: Option<PathBuf>,
    pub(super) operator: Option<String>,
}

/// See the module's head.
pub(super) struct Session {
    begun: Instant,
    model: Model,
    look: Look,
    screen: Screen,
    terminal: TerminalGuard,
    guard: RunningGuard,
    inputs: mpsc::Receiver<MsgKind>,
    /// How errands went that took long.
    errands: mpsc::Receiver<Errand>,
    hands: Hands,
    operator: Option<String>,
    pace: FramePace,
    /// Until when the engine may take to end, once it was asked to.
    leaving: Option<Instant>,
    cause: Cause,
    /// Nothing can be drawn any more.
    blind: bool,
    /// How the engine ended.
    ended: Option<Result<(), EndFault>>,
    /// Whether there was an engine here.
    came_up: bool,
    /// The engine was left at work.
    left: bool,
    /// It is to go on with nobody.
    keeps: bool,
    /// This console has asked it to end.
    asked_end: bool,
    /// The search for an engine at work; absent while there is one here.
    seek: Option<Seek>,
    /// Tells the session what errands came to.
    tell: mpsc::Sender<Errand>,
}

/// A search for an engine at work on the store.
struct Seek {
    tries: u32,
    /// When to look next; absent while somebody looks.
    due: Option<Instant>,
}

enum SessionInput {
    Input(Option<MsgKind>),
    Errand(Errand),
    Update(Option<Update>),
    Snapshot,
    Picture,
    Ending(Ending),
    Tick,
    Frame,
    Late,
}

impl Session {
    pub(super) fn start(
        parts: Parts,
        model: Model,
        look: Look,
        screen: Screen,
        terminal: TerminalGuard,
        guard: RunningGuard,
    ) -> io::Result<Self> {
        let view = parts.view;
        let mut model = model;
        let (tell, errands) = mpsc::channel(ERRANDS_MAX);
        let host = match parts.engine {
            EngineAt::Here(config) => Host::start(config),
            EngineAt::Elsewhere(host) => {
                model.told.link = EngineLink::Attached;
                model.told.process = host.process();
                model.told.doubt = host.doubt();
                *host
            }
            EngineAt::Begun(coming, begin) => {
                model.told.link = EngineLink::Attached;
                model.told.begun = true;
                let (sitting, tell) = (model.sitting(), tell.clone());
                let work = move || {
                    let begun = begin(sitting).map(Box::new);
                    // The console may have ended meanwhile; the engine ends then as well, for nobody sits at it.
                    drop(tell.blocking_send(Errand::Begun(begun)));
                };
                std::thread::Builder::new().name("beginning".to_owned()).spawn(work)?;
                *coming
            }
        };
        let Parts { services, themes, exports, .. } = parts;
        Ok(Self {
            begun: Instant::now(),
            model,
            look,
            screen,
            terminal,
            guard,
            inputs: input::start()?,
            errands,
            hands: Hands::new(host, services, themes, exports, tell.clone(), view),
            operator: parts.operator,
            pace: FramePace::default(),
            leaving: None,
            cause: Cause::Asked,
            blind: false,
            ended: None,
            came_up: false,
            left: false,
            keeps: false,
            asked_end: false,
            seek: None,
            tell,
        })
    }

    /// Works until the program ends, and gives the terminal back.
    pub(super) async fn run(mut self) -> Left {
        let mut ticks = tokio::time::interval(TICK);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        self.seat(false);
        while !self.is_over() {
            let came = self.wait(&mut ticks).await;
            self.fold(came);
            self.fold_what_waits();
            self.draw_if_due();
        }
        self.finish()
    }

    /// Nothing is left to wait for: the engine ended after it was asked to, or its time is over.
    fn is_over(&self) -> bool {
        self.leaving.is_some_and(|until| self.ended.is_some() || Instant::now() >= until)
    }

    async fn wait(&mut self, ticks: &mut tokio::time::Interval) -> SessionInput {
        let frame = self.pace.due_ms().filter(|_| !self.blind).map(|due_ms| self.moment(due_ms));
        let leaving = self.leaving;
        let host = &mut self.hands.host;
        tokio::select! {
            biased;
            ending = self.guard.ending(), if self.cause == Cause::Asked => SessionInput::Ending(ending),
            what = self.inputs.recv(), if !self.blind => SessionInput::Input(what),
            Some(what) = self.errands.recv() => SessionInput::Errand(what),
            () = until(frame) => SessionInput::Frame,
            () = until(leaving) => SessionInput::Late,
            told = host.updates.recv(), if self.ended.is_none() => SessionInput::Update(told),
            Ok(()) = host.snapshots.changed() => SessionInput::Snapshot,
            Ok(()) = host.pictures.changed() => SessionInput::Picture,
            _ = ticks.tick() => SessionInput::Tick,
        }
    }

    fn moment(&self, at_ms: u64) -> Instant {
        self.begun + Duration::from_millis(at_ms)
    }

    fn now_ms(&self) -> u64 {
        u64::try_from(self.begun.elapsed().as_millis()).unwrap_or(u64::MAX)
    }

    fn fold(&mut self, came: SessionInput) {
        match came {
            SessionInput::Input(Some(what)) => self.input(what),
            // The thread that reads has given up: the terminal is gone.
            SessionInput::Input(None) => self.told_to_end(true),
            SessionInput::Errand(Errand::Told(what)) => self.take(what, Want::Key),
            SessionInput::Errand(Errand::Signed(request)) => self.hand_over(*request),
            SessionInput::Errand(Errand::Sought(found)) => self.sought(found),
            SessionInput::Errand(Errand::Begun(begun)) => self.begun(begun),
            SessionInput::Update(Some(told)) => self.engine(told),
            SessionInput::Update(None) => {
                self.engine(Update::Ended(Err(EndFault::of("its thread is gone"))));
            }
            SessionInput::Snapshot => {
                let newest = self.hands.host.snapshots.borrow_and_update().clone();
                if let Some(snapshot) = newest {
                    self.take(MsgKind::Snapshot(snapshot), Want::Story);
                }
            }
            SessionInput::Picture => self.picture(),
            SessionInput::Ending(ending) => self.told_to_end(ending == Ending::Gone),
            SessionInput::Frame if self.model.plays() => self.fold_one(MsgKind::Tick),
            SessionInput::Tick => {
                self.take(MsgKind::Tick, Want::Story);
                self.look_for_an_engine();
            }
            SessionInput::Frame | SessionInput::Late => {}
        }
    }

    /// A backlog is folded in whole, so that the next frame shows its end.
    fn fold_what_waits(&mut self) {
        for _ in 0..BATCH_MAX {
            if let Ok(what) = self.inputs.try_recv() {
                self.input(what);
            } else if let Ok(told) = self.hands.host.updates.try_recv() {
                self.engine(told);
            } else {
                return;
            }
        }
    }

    fn input(&mut self, what: MsgKind) {
        if let MsgKind::Resize(columns, rows) = what
            && self.screen.resize(columns, rows).is_err()
        {
            self.told_to_end(true);
        }
        self.take(what, Want::Key);
    }

    fn engine(&mut self, told: Update) {
        let what = match told {
            Update::Started => {
                self.came_up = true;
                self.seat(true);
                MsgKind::EngineStarted
            }
            Update::Returned(request) => return self.hand_over(*request),
            Update::Events(events) => MsgKind::Events(events),
            Update::Past { events, earlier } => MsgKind::Past { events, earlier },
            Update::Answer { id, reply } => MsgKind::Answer { id, reply: Box::new(reply) },
            Update::Lagged { missed } => MsgKind::Lagged(missed),
            Update::Ended(how) => {
                self.ended = Some(how.clone());
                // Another engine may be at work there soon, or is already.
                let elsewhere = self.hands.host.is_attached() || how.as_ref().is_err_and(|why| why.in_use);
                if elsewhere && self.leaving.is_none() {
                    self.seek = Some(Seek { tries: 0, due: Some(Instant::now()) });
                }
                MsgKind::EngineEnded(how)
            }
        };
        self.take(what, Want::Story);
    }

    /// The engine that was being started is there, or will not be. What was asked meanwhile goes to it.
    fn begun(&mut self, begun: Result<Box<Begun>, EndFault>) {
        let waiting = self.hands.host.take_waiting();
        match begun {
            Ok(begun) => {
                let Begun { host, notice } = *begun;
                let is_own = !host.is_attached();
                let (process, doubt) = (host.process(), host.doubt());
                self.hands.host = host;
                if is_own {
                    self.model.told.link = EngineLink::Own;
                } else {
                    self.take(MsgKind::Seated(process, doubt), Want::Story);
                }
                if let Some(text) = notice {
                    self.take(MsgKind::Done { text, bad: true }, Want::Story);
                }
            }
            Err(why) => self.engine(Update::Ended(Err(why))),
        }
        for request in waiting {
            self.hand_over(request);
        }
    }

    /// Looks for an engine at work on the store, if it is time to: on a thread of its own, for one may be slow to answer.
    fn look_for_an_engine(&mut self) {
        let Some(seek) = self.seek.as_mut().filter(|_| self.leaving.is_none()) else { return };
        if seek.tries >= SEEK_MAX || seek.due.is_none_or(|due| due > Instant::now()) {
            return;
        }
        seek.tries += 1;
        seek.due = None;
        let (tell, sitting) = (self.tell.clone(), self.model.sitting());
        let layout = self.hands.host.layout().clone();
        let look = move || {
            let found = match Host::find(&layout, sitting) {
                Ok(Some(host)) => Ok(Box::new(host)),
                Ok(None) => Err("none is at work on this store".to_owned()),
                Err(error) => Err(error.sentence()),
            };
            // The console may have ended meanwhile.
            drop(tell.blocking_send(Errand::Sought(found)));
        };
        if let Err(error) = std::thread::Builder::new().name("seeking".to_owned()).spawn(look) {
            self.sought(Err(format!("cannot start a thread: {error}")));
        }
    }

    /// What a look for an engine came to.
    fn sought(&mut self, found: Result<Box<Host>, String>) {
        let Some(seek) = self.seek.as_mut().filter(|_| self.leaving.is_none()) else { return };
        match found {
            Ok(host) => {
                self.seek = None;
                self.ended = None;
                let (process, doubt) = (host.process(), host.doubt());
                self.hands.host = *host;
                self.take(MsgKind::Seated(process, doubt), Want::Story);
            }
            Err(said) => {
                let pause = SEEK_FIRST.saturating_mul(1 << seek.tries.min(8)).min(SEEK_PAUSE_MAX);
                seek.due = Some(Instant::now() + pause);
                let seeking = Seeking { tries: seek.tries, tries_max: SEEK_MAX, said };
                self.take(MsgKind::Sought(seeking), Want::Story);
            }
        }
    }

    /// Seats who was named: at once, so that an early stop is theirs; where their key is not there, once the store is, and
    /// then a name that is nobody's is told.
    fn seat(&mut self, is_last: bool) {
        let Some(name) = self.operator.as_deref() else { return };
        if is_last || self.hands.knows(name) {
            self.operator.take().into_iter().for_each(|name| self.carry_out(Effect::UseIdentity(name)));
        }
    }

    /// Hands a request over that came back from somewhere else.
    fn hand_over(&mut self, request: Request) {
        if let Outcome::Told(what) = self.hands.hand_over(&self.model, request) {
            self.take(what, Want::Key);
        }
    }

    fn picture(&mut self) {
        let newest = self.hands.host.pictures.borrow_and_update().clone();
        let Some(picture) = newest else { return };
        let seen = self.model.place.view == View::Overview;
        self.fold_one(MsgKind::Picture(picture));
        if seen {
            self.pace.want(Want::Picture);
        }
    }

    fn told_to_end(&mut self, gone: bool) {
        self.blind |= gone;
        let first = self.cause == Cause::Asked;
        if gone {
            self.cause = Cause::Gone;
        } else if first {
            self.cause = Cause::Told;
        }
        if first {
            self.take(MsgKind::EndAsked, Want::Key);
        }
    }

    /// Folds one thing in and asks for a frame.
    fn take(&mut self, what: MsgKind, want: Want) {
        self.fold_one(what);
        self.pace.want(want);
    }

    fn fold_one(&mut self, what: MsgKind) {
        let now_ms = self.now_ms();
        let effects = update(&mut self.model, Msg { now_ms, what });
        for effect in effects {
            self.carry_out(effect);
        }
        // Others at the engine see where this console is; a word that is no news is not sent.
        self.model.told.seat = self.hands.host.sit(self.model.sitting());
    }

    /// Carries out an effect and what follows from its answer.
    fn carry_out(&mut self, effect: Effect) {
        let mut open = VecDeque::from([effect]);
        while let Some(effect) = open.pop_front() {
            let mut place = EffectTarget {
                screen: &mut self.screen,
                terminal: &self.terminal,
                look: &mut self.look,
                model: &self.model,
            };
            match self.hands.carry_out(effect, &mut place) {
                Ok(Outcome::Quiet) => {}
                Ok(Outcome::Told(what)) => {
                    let now_ms = self.now_ms();
                    open.extend(update(&mut self.model, Msg { now_ms, what }));
                    self.pace.want(Want::Key);
                }
                Ok(Outcome::End) => self.end(),
                Ok(Outcome::Leave) => self.leave(),
                Ok(Outcome::Detach) => {
                    self.keeps = true;
                    self.leave();
                }
                Err(_) => self.told_to_end(true),
            }
        }
    }

    /// Leaves the engine as it is.
    fn leave(&mut self) {
        self.left = true;
        self.ended.get_or_insert(Ok(()));
        self.leaving.get_or_insert_with(Instant::now);
    }

    /// Asks the engine to end; the screen stays until it has. One that goes on without this console is left at work.
    fn end(&mut self) {
        if self.ended.is_some() {
            self.leaving.get_or_insert_with(Instant::now);
            return;
        }
        // Whoever's terminal is gone may come back to it; if nobody does, it ends by itself.
        let is_lost = self.cause == Cause::Gone && self.model.told.link == EngineLink::Attached;
        if is_lost || !self.model.told.ends_with_this() {
            return self.leave();
        }
        if self.leaving.is_none() {
            self.leaving = Some(Instant::now() + ENDING_MAX);
            self.asked_end = true;
            // A full queue is no reason to wait: the host is stopped in any case.
            drop(self.hands.ask(&self.model, "console-ends".to_owned(), Command::Shutdown));
        }
    }

    fn draw_if_due(&mut self) {
        let now_ms = self.now_ms();
        if self.blind || !self.pace.is_due(now_ms) {
            return;
        }
        #[cfg(debug_assertions)]
        fail_if_asked(&self.model);
        let (model, look) = (&self.model, &self.look);
        let mut seen = None;
        let drawn = self.screen.draw(|area, buffer| {
            frame::draw(model, look, area, buffer);
            seen = frame::decision_on_screen(model, look, area);
        });
        // The pace counts from the end of a frame: a slow terminal gets fewer.
        self.pace.drawn(self.now_ms());
        if self.model.plays() {
            self.pace.want(Want::Picture);
        }
        if drawn.is_err() {
            self.told_to_end(true);
        } else if let Some(seen) = seen {
            self.decision_shown(seen);
        }
    }

    /// What was really on the screen counts as read. The next frame says what is left.
    fn decision_shown(&mut self, seen: OnScreen) {
        let unread = |model: &Model| match &model.entry.overlay {
            Some(Overlay::Prompt(prompt)) => prompt.unread(),
            Some(Overlay::Form(form)) => form.unread(),
            Some(Overlay::Palette(_) | Overlay::Why(_) | Overlay::Film(_)) | None => 0,
        };
        let before = unread(&self.model);
        self.fold_one(MsgKind::DecisionShown(seen));
        if unread(&self.model) != before {
            self.pace.want(Want::Key);
        }
    }

    /// The engine first, the terminal last.
    fn finish(self) -> Left {
        let Self {
            model, hands, screen, terminal, guard, ended, cause, came_up, left, keeps, asked_end, ..
        } = self;
        let attached = hands.host.is_attached();
        // The engine is asked while nobody waits at the screen any more, and its answer is what is said last.
        let kept = if keeps { hands.host.keep() } else { Ok(()) };
        let elsewhere = hands.host.elsewhere();
        let stopped = match hands.host.stop(STOP_MAX) {
            Ok(()) => Some(Ok(())),
            Err(StopError::Failed(why)) => Some(Err(why)),
            Err(StopError::Late(_)) => None,
        };
        let ended = ended.or(stopped);
        // What this console has asked for is no fault, and it is over when the store is free.
        let ended = match ended {
            Some(Err(why)) if why.orderly && asked_end => {
                // After a signal there is not much time.
                elsewhere.wait_for_end(if cause == Cause::Asked { FREE_MAX } else { STOP_MAX });
                Some(Ok(()))
            }
            other => other,
        };
        drop(screen);
        drop(terminal);
        drop(guard);
        let ends_alone_s = model.told.snapshot.as_ref().and_then(|snapshot| snapshot.ends_alone_s);
        match (&ended, model.told.link) {
            (Some(Ok(())), _) if left && attached => {
                return farewell::at_work(&model, cause, &kept, ends_alone_s.filter(|_| !keeps));
            }
            (None, EngineLink::Attached) if asked_end => return farewell::still_ending(&model, cause),
            (Some(Err(why)), EngineLink::Attached) if came_up => {
                return farewell::ended_elsewhere(cause, why);
            }
            _ => {}
        }
        farewell::left(cause, came_up, ended, model.told.snapshot.as_deref())
    }
}

/// Waits until a moment; for ever if there is none.
async fn until(moment: Option<Instant>) {
    match moment {
        Some(moment) => tokio::time::sleep_until(moment.into()).await,
        None => std::future::pending().await,
    }
}

/// The test of the panic policy: a screen that fails while it is drawn. Not in a release.
#[cfg(debug_assertions)]
#[allow(clippy::panic, reason = "that is what is tested")]
fn fail_if_asked(model: &Model) {
    let asked = std::env::var("HOLDPOINT_TEST_PANIC").is_ok_and(|who| who == "ui");
    if asked && model.told.snapshot.is_some() {
        std::panic::panic_any("HOLDPOINT_TEST_PANIC asked for it");
    }
}
