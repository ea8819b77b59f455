//! The pump: carries out requests, runs a slice, and delivers the events to all listeners.
//!
//! Every front end drives its engine through it, in its own loop: a script, the plain stream, the thread behind a console. It
//! owns only the order. A termination signal lets the running slice finish, and nothing more is begun, approved or activated;
//! a second signal interrupts the slice.

use std::time::Duration;

use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_protocol::command::{Command, Reply, Request};
use holdpoint_protocol::event::Event;
use holdpoint_protocol::sink::{MakeSink, ServeScene, VideoFrameSink};

use crate::control_socket::{ControlSocket, ControlSocketError, SignalHandling};
use crate::listeners::Listeners;
use holdpoint_engine::Engine;
use holdpoint_engine::decide::pipeline::SliceOutcome;
#[cfg(feature = "experiments")]
use holdpoint_engine::live::station::TaskTruth;

/// The steps of a turn before its events are delivered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum TurnStep {
    Requests,
    Slice,
    Settling,
}

/// An engine with its socket and its listeners.
pub struct Pump {
    engine: Engine,
    socket: Option<ControlSocket>,
    listeners: Listeners,
}

impl Pump {
    /// Starts the listeners of an engine without a socket.
    #[must_use]
    pub fn new(mut engine: Engine, sinks: Vec<MakeSink>) -> Self {
        let listeners = Listeners::start(&mut engine, sinks);
        Self { engine, socket: None, listeners }
    }

    /// Starts the listeners of an engine with an open socket.
    #[must_use]
    pub fn with_socket(mut engine: Engine, socket: ControlSocket, sinks: Vec<MakeSink>) -> Self {
        let listeners = Listeners::start(&mut engine, sinks);
        Self { engine, socket: Some(socket), listeners }
    }

    /// Opens the socket for other processes.
    ///
    /// # Errors
    /// [`ControlSocketError`].
    pub fn open_socket(&mut self, signals: SignalHandling) -> Result<(), ControlSocketError> {
        self.socket = Some(ControlSocket::open(
            self.engine.layout(),
            self.engine.cancel(),
            self.engine.switch(),
            signals,
        )?);
        Ok(())
    }

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

    /// As [`Engine::call_referee`].
    #[cfg(feature = "experiments")]
    pub fn call_referee(&mut self) {
        self.engine.call_referee();
    }

    /// As [`Engine::take_verdicts`].
    #[cfg(feature = "experiments")]
    pub fn take_verdicts(&mut self) -> Vec<TaskTruth> {
        self.engine.take_verdicts()
    }

    /// As [`Engine::draw_live_world`].
    pub fn draw_live_world(&mut self, sink: VideoFrameSink) {
        self.engine.draw_live_world(sink);
    }

    /// As [`Engine::pace_live_world`].
    pub fn pace_live_world(&mut self, times: Option<f64>, sink: VideoFrameSink) {
        self.engine.pace_live_world(times, sink);
    }

    /// Begins one stage of one candidate, by the call for that stage.
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

    /// Sends frames of the live cell to all listeners; absent if no listener uses them.
    #[must_use]
    pub fn frame_sink(&self) -> Option<VideoFrameSink> {
        self.listeners.video_frames()
    }

    /// Serves a live viewer; absent if no listener can.
    #[must_use]
    pub fn serve(&self) -> Option<ServeScene> {
        self.listeners.serve()
    }

    /// Carries out requests from the socket, and signals.
    fn requests(&mut self) {
        let Some(socket) = &mut self.socket else { return };
        socket.poll(&mut self.engine);
        if let Some(times) = socket.name_taken_anew() {
            self.engine.name_taken(times);
        }
        if socket.end_signals() > 0 && !self.engine.has_ended() {
            self.engine.submit(Request::unsigned("signal-to-end".to_owned(), Command::Shutdown));
        }
    }

    /// Records the outcome of recordings. A script does so only at its end, so that the order of its records does not depend on
    /// the listeners' threads.
    fn settle(&mut self) {
        if !self.engine.is_scripted() {
            self.listeners.settle(&mut self.engine);
        }
    }

    /// Delivers the events to all listeners, and returns them.
    pub fn deliver_events(&mut self) -> Vec<Event> {
        let events = self.engine.drain_events();
        if let Some(socket) = &mut self.socket {
            socket.publish(&events);
            // Requests that the last slice carried out: a request that ended the engine is answered before the socket closes.
            socket.answer_later(&self.engine);
        }
        self.listeners.events(&mut self.engine, &events);
        events
    }

    /// One turn: requests, a slice, events.
    pub fn turn(&mut self) -> (SliceOutcome, Vec<Event>) {
        self.guarded_turn(|pump, _, step| step(pump))
    }

    /// As [`Pump::turn`]; `guard` runs each step, and may handle its failure.
    pub(crate) fn guarded_turn(
        &mut self,
        mut guard: impl FnMut(&mut Self, TurnStep, &mut dyn FnMut(&mut Self)),
    ) -> (SliceOutcome, Vec<Event>) {
        let mut progress = SliceOutcome::Ran;
        guard(self, TurnStep::Requests, &mut Self::requests);
        guard(self, TurnStep::Slice, &mut |pump| progress = pump.engine.advance());
        guard(self, TurnStep::Settling, &mut Self::settle);
        (progress, self.deliver_events())
    }

    /// Waits until a request arrives, or for `at_most`. Returns at once without a socket.
    pub fn wait(&mut self, at_most: Duration) {
        if let Some(socket) = &mut self.socket {
            socket.wait(at_most);
        }
    }

    /// Ends the listeners, records their recordings, and returns the remaining events.
    pub fn finish(&mut self) -> Vec<Event> {
        self.listeners.finish(&mut self.engine);
        self.deliver_events()
    }
}
