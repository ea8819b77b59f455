//! The monitor's place inside a live task: a safety event of a watched version acts in the tick it happens.
//!
//! It feeds the monitors tick by tick and stops a task if one of them requests more than a question. It decides
//! nothing (the rules do, in `governance::monitor`) and writes nothing: the engine acts on decisions after the task,
//! at standstill.

use std::sync::{Arc, Mutex};

use crate::live::monitors::{ActivationMonitor, Monitors};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::monitor::{MonitorAction, MonitorDecision, SafetyEvent};
use holdpoint_protocol::clock::{Clock, tick_of};
use holdpoint_runtime::recovery::RecoveryReport;
use holdpoint_runtime::safety_event::safety_event;
use holdpoint_runtime::task::{Supervision, TaskRecord, Tick};

/// A task that was stopped in flight.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Trip {
    /// The safety event, for which the interrupt stopped the arm; absent if it was for something else.
    pub event: Option<SafetyEvent>,
    /// When, ticks of the live world.
    pub world_tick: u64,
    /// When, virtual ticks of the engine.
    pub tick: u64,
    /// What was done to stop the arm.
    pub stopped: Option<RecoveryReport>,
}

/// What a monitor decided during a sequence.
#[derive(Clone, Debug)]
pub struct RaisedMonitor {
    pub id: CapabilityId,
    pub decision: MonitorDecision,
    /// The task it stopped, if it did.
    pub trip: Option<Trip>,
}

/// Questions of monitors that are reported during the sequence, each with its monitor.
pub(crate) type MonitorQuestions = Arc<Mutex<Vec<(ActivationMonitor, MonitorDecision)>>>;

/// Supervises one sequence for every monitor there is.
pub struct SequenceSupervisor {
    monitors: Monitors,
    clock: Clock,
    from_tick: u64,
    link_up: bool,
    raised: Vec<RaisedMonitor>,
    questions: Option<MonitorQuestions>,
}

impl SequenceSupervisor {
    /// A supervisor for a sequence that begins now. `link_up`: telemetry arrives.
    pub(crate) fn new(mut monitors: Monitors, clock: Clock, link_up: bool) -> Self {
        let from_tick = tick_of(clock.now_ms());
        if link_up {
            // The arm at rest has been read before it sets out.
            for watched in monitors.iter_mut() {
                watched.monitor.telemetry(from_tick);
            }
        }
        Self { monitors, clock, from_tick, link_up, raised: Vec::new(), questions: None }
    }

    /// Reports questions at once: operators must not wait for the end of a sequence to learn of a deadline.
    pub(crate) fn tell_at_once(&mut self, questions: MonitorQuestions) {
        self.questions = Some(questions);
    }

    /// One tick of a task of `id`. `world_tick` counts from the start of the sequence.
    pub fn tick(&mut self, id: &CapabilityId, world_tick: u64, passed: &Tick<'_>) -> Supervision {
        let now = self.now_tick(world_tick);
        let Some(watched) = self.monitors.of_mut(id) else {
            return Supervision::Continue;
        };
        // Where the link is down nothing of the task reaches the monitor, its safety events neither.
        let event = if self.link_up { safety_event(passed) } else { None };
        if self.link_up {
            watched.monitor.telemetry(now);
        }
        let decision = match event {
            Some(event) => watched.monitor.safety(event, now),
            None => watched.monitor.tick(now),
        };
        if decision.action <= watched.announced {
            return Supervision::Continue;
        }
        watched.announced = decision.action;
        if decision.action == MonitorAction::Escalate
            && let Some(Ok(mut queue)) = self.questions.as_ref().map(|questions| questions.lock())
        {
            queue.push((watched.clone(), decision));
            return Supervision::Continue;
        }
        let stops = decision.action >= MonitorAction::Restrict;
        let rolls_back = decision.action == MonitorAction::Rollback && watched.rollback_rehearsed;
        let trip = stops.then_some(Trip { event, world_tick, tick: now, stopped: None });
        self.raised.push(RaisedMonitor { id: id.clone(), decision, trip });
        match event {
            _ if !stops => Supervision::Continue,
            Some(_) => Supervision::Interrupt,
            None if rolls_back => Supervision::RollBack,
            None => Supervision::Abort,
        }
    }

    /// Virtual ticks now. A script's clock does not run during a sequence, so there the world's ticks count; a clock
    /// that follows real time gives them itself, at any speed of the world.
    fn now_tick(&self, world_tick: u64) -> u64 {
        if self.clock.is_scripted() {
            self.from_tick.saturating_add(world_tick)
        } else {
            tick_of(self.clock.now_ms())
        }
    }

    /// After a task of `id`: how the arm was stopped belongs to the trip that stopped it.
    pub fn ended(&mut self, id: &CapabilityId, record: &TaskRecord) {
        let last = self.raised.last_mut().filter(|raised| raised.id == *id);
        if let Some(trip) = last.and_then(|raised| raised.trip.as_mut())
            && trip.stopped.is_none()
        {
            trip.stopped = record.recovered;
        }
    }

    /// The monitors as they are now, and what was decided, in order.
    #[must_use]
    pub(crate) fn stand_down(self) -> (Monitors, Vec<RaisedMonitor>) {
        (self.monitors, self.raised)
    }
}
