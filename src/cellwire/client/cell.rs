//! A cell at the other end of a connection, behind the ports. It keeps what the last answer told.

use std::any::Any;
use std::cell::{Cell, RefCell};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use holdpoint_body::{
    Body, BodyError, Command, GuardVerdict, Interrupt, JointVec, ObjectVec, Observation, Pose, ReadingVec,
    TaskKind, Telemetry, Twist,
};
use holdpoint_cell::film::EpisodeFrame;
use holdpoint_cell::truth::{ContactForces, ContactPoint, JointState, TrueState};
use holdpoint_cell::{
    CellCopy, CellError, CellSpec, EpisodeSetup, FixtureBox, InjectedFault, LiveCell, RobotCell, StateImage,
    TrialCell, WorkCall,
};
use holdpoint_text::Untrusted;
use nalgebra::Isometry3;

use super::peer::{CellCallError, Peer, unexpected};
use super::{Shared, lock};
use crate::framing::{WireError, decode};
use crate::messages::{Block, Call, CellReply, CellState, Role, Truth};

/// A state that the server keeps. It is released when it is dropped.
struct WireFork {
    shared: Arc<Shared>,
    session: u64,
    fork: u64,
}

impl Drop for WireFork {
    fn drop(&mut self) {
        lock(&self.shared.released).push((self.session, self.fork));
    }
}

/// See the module comment.
pub struct WireCell {
    shared: Arc<Shared>,
    role: Role,
    peer: RefCell<Peer>,
    seen: CellState,
    truth: Truth,
    /// The last reported state of the guard; absent since a start.
    guard: Cell<Option<GuardVerdict>>,
    /// Whether the server has yet to hear of it.
    is_untold: Cell<bool>,
}

impl WireCell {
    pub(super) fn new(shared: Arc<Shared>, role: Role) -> Result<Self, CellError> {
        let failed = |error: CellCallError| shared.cell_error(error);
        let mut peer = shared.join(role).map_err(failed)?;
        let call = Call::Observe { guard: GuardVerdict::Allowed };
        let reply = peer.ask(None, Vec::new(), call, None, shared.options.deadlines.call).map_err(failed)?;
        let CellReply::Seen(seen) = reply else {
            return Err(failed(unexpected(&reply).into()));
        };
        let truth = Truth {
            joints: JointState::default(),
            forces: ContactForces::default(),
            object: seen.object,
            object_speed_m_s: 0.0,
        };
        let mut cell = Self {
            shared: Arc::clone(&shared),
            role,
            peer: RefCell::new(peer),
            seen: CellState::clone(&seen),
            truth,
            guard: Cell::new(None),
            is_untold: Cell::new(false),
        };
        cell.take(*seen).map_err(|error| shared.cell_error(error.into()))?;
        cell.seen.observation = None;
        Ok(cell)
    }

    /// Asks; the guard's verdict and handles to release go along.
    fn ask(&self, call: Call, block: Option<&[u8]>, within: Duration) -> Result<CellReply, CellCallError> {
        let guard = self.guard.get().filter(|_| self.is_untold.get());
        let release = self.shared.take_released();
        let reply = self.peer.borrow_mut().ask(guard, release, call, block, within)?;
        self.is_untold.set(false);
        Ok(reply)
    }

    fn ask_block(&self, call: Call) -> Result<Vec<u8>, CellCallError> {
        let within = self.call_within();
        let reply = self.ask(call, None, within)?;
        self.peer.borrow_mut().follow(&reply, within)
    }

    /// A call that changes the cell.
    fn change(&mut self, call: Call, block: Option<&[u8]>, within: Duration) -> Result<(), CellCallError> {
        let reply = self.ask(call, block, within)?;
        let taken = match reply {
            CellReply::Seen(seen) => self.take(*seen),
            other => Err(unexpected(&other)),
        };
        // A cell that lies is not asked again: its arm stops when the connection ends.
        taken.map_err(|error| self.peer.borrow_mut().lose(error).into())
    }

    /// A call after which there is no observation yet.
    fn start(&mut self, call: Call, block: Option<&[u8]>, within: Duration) -> Result<(), CellCallError> {
        self.change(call, block, within)?;
        self.guard.set(None);
        self.is_untold.set(false);
        self.seen.observation = None;
        Ok(())
    }

    /// Connects again if the connection is lost.
    fn reconnect(&mut self) -> Result<(), CellError> {
        if self.peer.borrow().is_lost() {
            let peer = self.shared.join(self.role).map_err(|error| self.shared.cell_error(error))?;
            self.peer = RefCell::new(peer);
            self.guard.set(None);
            self.is_untold.set(false);
        }
        Ok(())
    }

    /// As [`Self::start`], on a new connection if the one before is lost.
    fn start_again(&mut self, call: Call, block: Option<&[u8]>, within: Duration) -> Result<(), CellError> {
        self.reconnect()?;
        self.start(call, block, within).map_err(|error| self.shared.cell_error(error))
    }

    /// Keeps what an answer tells, if it can be true.
    fn take(&mut self, mut seen: CellState) -> Result<(), WireError> {
        let joints = self.shared.spec.robot.geometry.joint_count();
        seen.check(joints).map_err(|field| {
            WireError::Lying(format!("{field} is not what a cell of {joints} joints has, or no number"))
        })?;
        if let Some(name) = seen.undeclared(&self.shared.spec) {
            let name = Untrusted::new(name).line();
            return Err(WireError::Lying(format!(
                "its description does not have \"{name}\", which it observes"
            )));
        }
        match seen.truth.take() {
            Some(truth) => self.truth = truth,
            None if self.role == Role::Trial => {
                return Err(WireError::Lying("a trial cell tells no true state".to_owned()));
            }
            None if self.shared.spec.abilities.referee => {
                return Err(WireError::Lying("it tells no true state, and has that ability".to_owned()));
            }
            None => {}
        }
        self.seen = seen;
        Ok(())
    }

    fn call_within(&self) -> Duration {
        self.shared.options.deadlines.call
    }

    fn step_within(&self) -> Duration {
        let deadlines = self.shared.options.deadlines;
        let counts = self.role == Role::Live && self.shared.options.watchdog_ms.is_some();
        if counts { deadlines.step } else { deadlines.call }
    }

    /// What a skill sees of a cell that does not answer: nothing that a rule could pass.
    fn unseen(&self, guard: GuardVerdict) -> Observation {
        let nothing: JointVec = self.seen.telemetry.q.iter().map(|_| f64::NAN).collect();
        Observation {
            tick: self.seen.telemetry.tick,
            q: nothing.clone(),
            dq: nothing.clone(),
            tau: nothing,
            tool: Pose { position: [f64::NAN; 3], rotation: [f64::NAN; 4] },
            tool_twist: Twist { linear: [f64::NAN; 3], angular: [f64::NAN; 3] },
            gripper_width_m: f64::NAN,
            gripper_force_n: f64::NAN,
            wrist_force_n: f64::NAN,
            objects: ObjectVec::new(),
            sensors: ReadingVec::new(),
            tool_available: false,
            goal: self.shared.spec.first_task(),
            guard,
        }
    }

    fn scenery(&self) -> (Vec<FixtureBox>, Vec<ContactPoint>) {
        // A screen asks between two ticks: that must not hide a cell that does not answer.
        match self.ask(Call::Scenery, None, self.step_within()) {
            Ok(CellReply::Scenery { fixtures, contacts }) => (fixtures, contacts),
            // A screen shows what there is; the next tick says that the cell is lost.
            Ok(_) | Err(_) => (Vec::new(), Vec::new()),
        }
    }

    fn inject_fault(&mut self, fault: InjectedFault) -> Result<(), CellError> {
        let within = self.call_within();
        self.change(Call::Inject { fault }, None, within).map_err(|error| self.shared.cell_error(error))
    }
}

impl Body for WireCell {
    fn observe(&mut self, last: GuardVerdict) -> Observation {
        if let (Some(told), Some(observation)) = (self.guard.get(), &self.seen.observation) {
            if told != last {
                self.guard.set(Some(last));
                self.is_untold.set(true);
            }
            return Observation { guard: last, ..observation.clone() };
        }
        let within = self.step_within();
        if self.change(Call::Observe { guard: last }, None, within).is_err() {
            return self.unseen(last);
        }
        self.guard.set(Some(last));
        self.seen.observation.clone().unwrap_or_else(|| self.unseen(last))
    }

    fn telemetry(&self) -> Telemetry {
        self.seen.telemetry.clone()
    }

    fn step(&mut self, command: &Command) -> Result<(), BodyError> {
        let (before, within) = (self.seen.tick, self.step_within());
        let stepped = self.change(Call::Step { command: command.clone() }, None, within).and_then(|()| {
            let now = self.seen.tick;
            if now == before + 1 {
                return Ok(());
            }
            let error = WireError::Lying(format!("tick {now} follows tick {before}"));
            Err(self.peer.borrow_mut().lose(error).into())
        });
        stepped.map_err(|error| self.shared.body_error(error))
    }

    fn interrupt(&mut self, interrupt: Interrupt) {
        let within = self.step_within();
        // A connection that is lost fails the next tick, and the cell stops by itself.
        let _ = self.change(Call::Interrupt { interrupt }, None, within);
    }

    fn inspect(&self) -> bool {
        self.seen.done && !self.peer.borrow().is_lost()
    }
}

impl RobotCell for WireCell {
    fn spec(&self) -> &Arc<CellSpec> {
        &self.shared.spec
    }

    fn tick(&self) -> u64 {
        self.seen.tick
    }

    fn begin_task(&mut self, task: TaskKind) {
        // As with an interrupt.
        let _ = self.start(Call::BeginTask { task }, None, self.call_within());
    }

    fn end_task(&mut self) {
        let _ = self.change(Call::EndTask, None, self.call_within());
    }

    fn shown_object(&self) -> Isometry3<f64> {
        self.seen.object
    }

    fn stop_declared(&self) -> Option<u64> {
        self.seen.stop_declared
    }

    fn copy(&self) -> Result<CellCopy, CellError> {
        let reply = self.ask(Call::Fork, None, self.call_within());
        match reply.map_err(|error| self.shared.cell_error(error))? {
            CellReply::Fork { fork, tick } => {
                let session = self.shared.session.load(Ordering::Acquire);
                let fork = WireFork { shared: Arc::clone(&self.shared), session, fork };
                Ok(CellCopy::in_memory(tick, fork))
            }
            other => Err(self.shared.cell_error(unexpected(&other).into())),
        }
    }

    fn export(&self) -> Result<StateImage, CellError> {
        StateImage::new(self.ask_block(Call::Export).map_err(|error| self.shared.cell_error(error))?)
    }

    fn observed(&self) -> Option<Observation> {
        match self.ask(Call::Observed, None, self.call_within()) {
            Ok(CellReply::Observed(observed)) => observed.map(|observed| *observed),
            Ok(_) | Err(_) => None,
        }
    }

    fn truth(&self) -> Option<TrueState<'_>> {
        self.shared.spec.abilities.referee.then(|| self.truth.state())
    }

    fn fixtures(&self) -> Vec<FixtureBox> {
        self.scenery().0
    }

    fn contact_points(&self) -> Vec<ContactPoint> {
        self.scenery().1
    }
}

impl LiveCell for WireCell {
    fn await_work(&mut self, call: &WorkCall<'_>) -> Result<(), CellError> {
        let asked = Call::AwaitWork { conditions: Box::new(call.conditions.clone()), seed: call.seed };
        self.start_again(asked, None, self.shared.options.deadlines.work)
    }

    fn inject(&mut self, fault: InjectedFault) -> Result<(), CellError> {
        self.inject_fault(fault)
    }
}

impl TrialCell for WireCell {
    fn reset(&mut self, setup: &EpisodeSetup) -> Result<(), CellError> {
        self.start_again(Call::Reset { setup: Box::new(setup.clone()) }, None, self.call_within())
    }

    fn go_on_from(&mut self, copy: &CellCopy) -> Result<(), CellError> {
        // A new connection can have a new session, in which the handle means nothing.
        self.reconnect()?;
        match (copy.memory::<WireFork>(), copy.image()) {
            (Some(fork), _)
                if Arc::ptr_eq(&fork.shared, &self.shared)
                    && fork.session == self.shared.session.load(Ordering::Acquire) =>
            {
                self.start_again(Call::GoOnFrom { fork: fork.fork }, None, self.call_within())
            }
            (None, Some(image)) => self.import(image),
            (Some(_), _) | (None, None) => Err(CellError::Snapshot(
                "it is a state of another cell, or of a session that ended".to_owned(),
            )),
        }
    }

    fn import(&mut self, image: &StateImage) -> Result<(), CellError> {
        let call = Call::Import { image: Block::of(image.bytes()) };
        self.start_again(call, Some(image.bytes()), self.call_within())
    }

    fn set_to(&mut self, observed: &Observation) -> Result<(), CellError> {
        self.start_again(Call::SetTo { observed: Box::new(observed.clone()) }, None, self.call_within())
    }

    fn inject(&mut self, fault: InjectedFault) {
        // As with an interrupt.
        let _ = self.inject_fault(fault);
    }

    fn true_state(&self) -> TrueState<'_> {
        self.truth.state()
    }

    fn as_any(&self) -> &dyn Any {
        self
    }

    fn film(&mut self) {
        let _ = self.change(Call::Film, None, self.call_within());
    }

    fn take_film(&mut self) -> Vec<EpisodeFrame> {
        let frames = self.ask_block(Call::TakeFilm).ok();
        frames.and_then(|bytes| decode(&bytes).ok()).unwrap_or_default()
    }
}
