//! The one pump: what waits at the door, a slice of work, and what happened to everybody who listens.
//!
//! Every front end drives its engine through this, in its own loop: a script, the plain stream, the thread behind a
//! console. Owns the order and nothing else. On a signal to end the slice that runs is finished and nothing more is
//! begun, approved or activated; a second signal interrupts the slice.

use std::time::Duration;

use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_protocol::command::{Command, Reply, Request};
use holdpoint_protocol::event::Event;
use holdpoint_protocol::sink::{MakeSink, Pictures, Serve};

use crate::Engine;
use crate::door::{Door, DoorError, Signals};
use crate::listeners::Listeners;
use crate::pipeline::Progress;

/// The steps of a turn before what happened is told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum TurnStep {
    Requests,
    Slice,
    Settling,
}

/// An engine with its door and its listeners.
pub struct Pump {
    engine: Engine,
    door: Option<Door>,
    listeners: Listeners,
}

impl Pump {
    /// Starts the listeners of an engine; its door stays closed.
    #[must_use]
    pub fn new(mut engine: Engine, sinks: Vec<MakeSink>) -> Self {
        let listeners = Listeners::start(&mut engine, sinks);
        Self { engine, door: None, listeners }
    }

    /// Starts the listeners of an engine whose door is open already.
    #[must_use]
    pub fn with_door(mut engine: Engine, door: Door, sinks: Vec<MakeSink>) -> Self {
        let listeners = Listeners::start(&mut engine, sinks);
        Self { engine, door: Some(door), listeners }
    }

    /// Opens the door for other processes.
    ///
    /// # Errors
    /// [`DoorError`].
    pub fn open_door(&mut self, signals: Signals) -> Result<(), DoorError> {
        self.door =
            Some(Door::open(self.engine.layout(), self.engine.cancel(), self.engine.switch(), signals)?);
        Ok(())
    }

    /// The engine, to look at.
    #[must_use]
    pub const fn engine(&self) -> &Engine {
        &self.engine
    }

    /// As [`Engine::submit`].
    pub fn submit(&mut self, request: Request) -> Reply {
        self.engine.submit(request)
    }

    /// As [`Engine::offer`].
    pub fn offer(&mut self, request: Request) -> Option<Reply> {
        self.engine.offer(request)
    }

    /// As [`Engine::jump_to`].
    pub const fn jump_to(&mut self, at_ms: u64) -> bool {
        self.engine.jump_to(at_ms)
    }

    /// As [`Engine::work_one`].
    pub fn work_one(&mut self) {
        self.engine.work_one();
    }

    /// As [`Engine::draw_live_world`].
    pub fn draw_live_world(&mut self, pictures: Pictures) {
        self.engine.draw_live_world(pictures);
    }

    /// As [`Engine::pace_live_world`].
    pub fn pace_live_world(&mut self, times: Option<f64>, pictures: Pictures) {
        self.engine.pace_live_world(times, pictures);
    }

    /// Begins one stage of one candidate by itself, by the call that is for it.
    pub fn launch(&mut self, id: &CapabilityId, stage: Stage) -> Reply {
        match stage {
            Stage::Validation => self.engine.run_compat_checks(id),
            Stage::Sandbox => self.engine.launch_sandbox_eval(id),
            Stage::Shadow => self.engine.launch_shadow_eval(id),
            Stage::Activation => self.engine.activate_candidate(id),
        }
    }

    /// As [`Engine::fail`].
    pub(crate) fn fail(&mut self, why: &str) {
        self.engine.fail(why);
    }

    /// Takes pictures of the live world for all listeners; absent if nobody wants any.
    #[must_use]
    pub fn pictures(&self) -> Option<Pictures> {
        self.listeners.pictures()
    }

    /// How a live viewer is served; absent if nobody can.
    #[must_use]
    pub fn serve(&self) -> Option<Serve> {
        self.listeners.serve()
    }

    /// Carries out what waits at the door, and what signals ask for.
    fn requests(&mut self) {
        let Some(door) = &mut self.door else { return };
        door.poll(&mut self.engine);
        if let Some(times) = door.name_taken_anew() {
            self.engine.name_taken(times);
        }
        if door.endings_asked() > 0 && !self.engine.has_ended() {
            self.engine.submit(Request::unsigned("signal-to-end".to_owned(), Command::Shutdown));
        }
    }

    /// Puts on record what became of recordings. A script does so at its end and not before: its records are then in
    /// the same places whatever the listeners' threads do.
    fn settle(&mut self) {
        if !self.engine.is_scripted() {
            self.listeners.settle(&mut self.engine);
        }
    }

    /// Tells what happened to everybody who listens, and to the caller.
    pub fn tell(&mut self) -> Vec<Event> {
        let events = self.engine.drain_events();
        if let Some(door) = &self.door {
            door.publish(&events);
        }
        self.listeners.events(&mut self.engine, &events);
        events
    }

    /// One turn: requests, a slice, what happened.
    pub fn turn(&mut self) -> (Progress, Vec<Event>) {
        self.guarded_turn(|pump, _, step| step(pump))
    }

    /// As [`Pump::turn`]; `guard` is given each step to do, and may do something about one that fails.
    pub(crate) fn guarded_turn(
        &mut self,
        mut guard: impl FnMut(&mut Self, TurnStep, &mut dyn FnMut(&mut Self)),
    ) -> (Progress, Vec<Event>) {
        let mut progress = Progress::Worked;
        guard(self, TurnStep::Requests, &mut Self::requests);
        guard(self, TurnStep::Slice, &mut |pump| progress = pump.engine.advance());
        guard(self, TurnStep::Settling, &mut Self::settle);
        (progress, self.tell())
    }

    /// Waits until something came in at the door, or for `at_most`. Returns at once if the door is closed.
    pub fn wait(&mut self, at_most: Duration) {
        if let Some(door) = &mut self.door {
            door.wait(at_most);
        }
    }

    /// Ends the listeners, whose recordings are on record then, and tells the rest.
    pub fn finish(&mut self) -> Vec<Event> {
        self.listeners.finish(&mut self.engine);
        self.tell()
    }
}
