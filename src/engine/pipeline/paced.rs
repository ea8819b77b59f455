//! The live world on a thread of its own, at the pace of a clock, while the engine's thread evaluates and answers.
//!
//! Owns who does what when: what has to happen between two sequences waits for the end of the one that runs, what
//! takes authority away stops the arm first. It decides nothing about versions. An engine that is not paced (a
//! script, an experiment) works whole sequences in one slice and never comes here.

use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::manager::{Fault, Progress, UpgradeManager, Work};
use super::pacer::{Onlooker, Pace, Switch};
use super::painter::Painter;
use super::sentry::Questions;
use super::sequence::{Begun, Shadowed, Stopped, Worked};
use super::shadow::Shadow;
use holdpoint_governance::approval;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{Stage, State};
use holdpoint_protocol::clock::Clock;
use holdpoint_protocol::command::Command;
use holdpoint_protocol::sink::Pictures;
use holdpoint_text::Hint;

/// Pause after a sequence in which nothing was worked: no version is active, or the world failed.
const NOTHING_PAUSE: Duration = Duration::from_secs(2);

/// When a command may be carried out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Timing {
    /// At once.
    Now,
    /// Between two sequences.
    Between,
    /// Between two sequences, and the arm is stopped for it.
    Stop,
}

/// The live world's thread and what it shares with the engine's.
pub(super) struct PacedWorld {
    switch: Arc<Switch>,
    pace: Arc<Pace>,
    questions: Questions,
    number: u64,
    running: Option<JoinHandle<Worked>>,
    not_before: Option<Instant>,
}

impl PacedWorld {
    /// How fast it works from now on.
    pub(super) fn set_pace(&self, times: Option<f64>) {
        self.pace.set(times);
    }

    fn set_off(
        &mut self,
        mut begun: Begun,
        shadow: Option<Shadow>,
        pictures: Pictures,
        clock: Clock,
    ) -> Result<(), Fault> {
        self.number += 1;
        begun.tell_at_once(Arc::clone(&self.questions));
        let painter = Painter::new(pictures, clock.clone(), begun.index(), begun.workers());
        let shared = (Arc::clone(&self.switch), Arc::clone(&self.pace));
        let mut onlooker = Onlooker::new(painter, self.number, shadow, shared, clock);
        self.switch.begin(self.number);
        let work = move || {
            let mut worked = begun.work(&mut onlooker);
            let (stopped, shadow) = onlooker.conclude(worked.outing.world(), &worked.report);
            worked.stopped = stopped;
            worked.shadow = shadow;
            worked
        };
        let thread = std::thread::Builder::new().name("live-world".to_owned()).spawn(work);
        let thread = thread
            .map_err(|error| Fault::Impossible(format!("the live world's thread does not start: {error}")))?;
        self.running = Some(thread);
        Ok(())
    }

    /// The sequence that is over; `None` while one runs, and where none does.
    fn landed(&mut self, wait: bool) -> Option<Result<Worked, Fault>> {
        let thread = self.running.take_if(|thread| wait || thread.is_finished())?;
        self.switch.end();
        let failed = |_| Fault::Impossible("the live world's thread failed".to_owned());
        Some(thread.join().map_err(failed))
    }
}

impl UpgradeManager {
    /// From now on pictures of the live world go to `pictures`, which must not wait.
    pub fn draw_live_world(&mut self, pictures: Pictures) {
        self.pictures = Some(pictures);
    }

    /// From now on the live world works on a thread of its own: `times` simulated seconds in a second (absent: as
    /// fast as it computes). Pictures of it go to `pictures`.
    pub fn pace_live_world(&mut self, times: Option<f64>, pictures: Pictures) {
        let pace = Arc::new(Pace::default());
        pace.set(times);
        self.pace = times;
        // Small parts of a slice, so that who asks is answered soon.
        self.part = self.jobs.max(1);
        self.pictures = Some(pictures);
        self.paced = Some(PacedWorld {
            switch: Arc::new(Switch::default()),
            pace,
            questions: Questions::default(),
            number: 0,
            running: None,
            not_before: None,
        });
    }

    /// Stops the arm where it works now; absent where the live world is not paced.
    #[must_use]
    pub fn switch(&self) -> Option<Arc<Switch>> {
        self.paced.as_ref().map(|paced| Arc::clone(&paced.switch))
    }

    /// Whether a sequence is being worked on the live world's thread.
    pub(crate) fn is_out(&self) -> bool {
        self.paced.as_ref().is_some_and(|paced| paced.running.is_some())
    }

    /// When a command may be carried out.
    pub(crate) fn timing(&self, command: &Command) -> Timing {
        if !self.is_out() {
            return Timing::Now;
        }
        let is_active = |id: &CapabilityId| {
            self.ledger.version(id).is_ok_and(|(_, standing, _)| standing.state == State::Active)
        };
        match command {
            command if command.stops_the_arm() => Timing::Stop,
            Command::Demote { operation, .. } | Command::Reject(operation)
                if is_active(&operation.version) =>
            {
                Timing::Stop
            }
            // The deadline of a question does not wait for the end of a sequence, so the answer does not either.
            Command::Continue(operation) if self.has_question(&operation.version) => Timing::Stop,
            Command::Drift { .. } | Command::LiveFault { .. } => Timing::Between,
            Command::Rollback(_)
            | Command::Restrict(_)
            | Command::Rearm(_)
            | Command::Shutdown
            | Command::Continue(_)
            | Command::Register { .. }
            | Command::Decide { .. }
            | Command::Demote { .. }
            | Command::Reject(_)
            | Command::Pause(_)
            | Command::Resume(_)
            | Command::Repeat { .. }
            | Command::AcknowledgeAlarm { .. }
            | Command::ResetAlarm { .. }
            | Command::ShelveAlarm { .. }
            | Command::UnshelveAlarm { .. }
            | Command::Pace { .. }
            | Command::Detail { .. }
            | Command::Registry { .. }
            | Command::Audit { .. }
            | Command::VerifyAudit
            | Command::Snapshot => Timing::Now,
        }
    }

    /// Stops the arm in the tick that runs. The sequence is over soon after.
    pub(crate) fn stop_live(&self) {
        if let Some(paced) = &self.paced {
            paced.switch.stop();
        }
    }

    /// Whether the arm is being stopped.
    pub(crate) fn is_stopping(&self) -> bool {
        self.paced.as_ref().is_some_and(|paced| paced.running.is_some() && paced.switch.stops(paced.number))
    }

    /// The engine ends in an orderly way: arm and agent come home, open records are closed.
    pub(crate) fn end(&mut self) {
        self.stop_live();
        self.come_home(true);
        if self.holding.is_none()
            && let Err(fault) = self.end_resumptions()
        {
            self.hold(&fault.sentence());
        }
    }

    /// The engine's own thread failed.
    pub(crate) fn fail(&mut self, why: &str) {
        self.hold(why);
    }

    /// Ends the sequence that is over. Tells whether arm and agent are at home then; `wait` waits for them. A fault
    /// on the way makes the engine hold.
    pub(crate) fn come_home(&mut self, wait: bool) -> bool {
        let landed = self.paced.as_mut().and_then(|paced| paced.landed(wait));
        if let Some(landed) = landed
            && let Err(fault) = landed.and_then(|worked| self.land(worked))
        {
            self.hold(&fault.sentence());
        }
        !self.is_out()
    }

    /// One slice of a paced engine.
    pub(super) fn paced_slice(&mut self) -> Result<Progress, Fault> {
        if self.is_out() {
            let landed = self.paced.as_mut().and_then(|paced| paced.landed(false));
            if let Some(landed) = landed {
                self.land(landed?)?;
                return Ok(Progress::Worked);
            }
            if self.look_at_questions()? || self.look_at_prompts()? {
                return Ok(Progress::Worked);
            }
        } else {
            if self.between_sequences()? {
                return Ok(Progress::Worked);
            }
            self.set_off()?;
        }
        self.evaluate_beside()
    }

    /// What may only be done while nothing is out. One thing at a time; tells whether there was one.
    fn between_sequences(&mut self) -> Result<bool, Fault> {
        if self.look_at_deadlines()? {
            return Ok(true);
        }
        if let Some(id) = self.granted.pop_first() {
            let (now_s, settings) = (self.now_s(), self.profile.approval);
            if let Some(prompt) = self.prompts.get(&id) {
                let result = approval::evaluate(&prompt.request, &prompt.votes, now_s, &settings);
                self.settle_prompt(&id, &result)?;
            }
            return Ok(true);
        }
        match self.work.take() {
            Some(Work::Confirmation(run)) if run.is_over() => {
                self.confirmation_slice(run)?;
                return Ok(true);
            }
            other => self.work = other,
        }
        if self.work.is_some() {
            return Ok(false);
        }
        if let Some(id) = self.next_confirmation() {
            self.begin_confirmation(&id)?;
            return Ok(true);
        }
        if let Some((id, Stage::Activation)) = self.next_stage() {
            self.activation(&id)?;
            return Ok(true);
        }
        Ok(false)
    }

    /// Work that the live world does not wait for.
    fn evaluate_beside(&mut self) -> Result<Progress, Fault> {
        match self.work.take() {
            Some(Work::Sandbox(run)) => {
                self.sandbox_slice(run)?;
                return Ok(Progress::Worked);
            }
            Some(Work::Confirmation(run)) if !run.is_over() => {
                self.confirmation_slice(run)?;
                return Ok(Progress::Worked);
            }
            other => self.work = other,
        }
        if self.work.is_none()
            && let Some((id, stage)) = self.next_stage()
            && stage != Stage::Activation
        {
            self.begin(&id, stage)?;
            return Ok(Progress::Worked);
        }
        Ok(Progress::Idle { next_ms: self.next_deadline_ms() })
    }

    /// Lets the live world work the next sequence, with the candidate in shadow where there is one.
    fn set_off(&mut self) -> Result<(), Fault> {
        let waits = self.paced.as_ref().and_then(|paced| paced.not_before);
        if waits.is_some_and(|not_before| Instant::now() < not_before) {
            return Ok(());
        }
        let shadow = self.shadow_to_take()?;
        let begun = self.begin_sequence()?;
        self.stopped = None;
        let clock = self.clock.clone();
        let pictures = self.pictures.clone().unwrap_or_else(|| Arc::new(|_| ()));
        let Some(paced) = &mut self.paced else { return Ok(()) };
        paced.set_off(begun, shadow, pictures, clock)
    }

    /// The sequence is over: what it was for happens now.
    fn land(&mut self, mut worked: Worked) -> Result<(), Fault> {
        let shadowed = worked.shadow.take();
        self.stopped.clone_from(&worked.stopped);
        if self.holding.is_some() {
            // Arm and agent come home; nothing is concluded from what they did.
            self.live.take_back(worked.outing);
            return Ok(());
        }
        let nothing = worked.report.tasks.is_empty();
        if let Some(paced) = &mut self.paced {
            paced.not_before = nothing.then(|| Instant::now() + NOTHING_PAUSE);
        }
        self.look_at_questions()?;
        let report = self.end_sequence(worked)?;
        self.look_at_resumptions(&report)?;
        if let Some(Shadowed { id, trace, fork }) = shadowed {
            match self.work.take() {
                Some(Work::Shadow(run)) if run.is_of(&id) => self.shadow_worked(run, trace, fork)?,
                // The candidate left shadow meanwhile.
                other => self.work = other,
            }
        }
        Ok(())
    }

    /// Tells what monitors ask while their sequence still runs. Tells whether there was anything.
    fn look_at_questions(&mut self) -> Result<bool, Fault> {
        let Some(paced) = &self.paced else { return Ok(false) };
        let Ok(mut waiting) = paced.questions.lock() else { return Ok(false) };
        let questions = std::mem::take(&mut *waiting);
        drop(waiting);
        for (watch, decision) in &questions {
            let own = self.watches.get_mut(&watch.id.family).filter(|own| own.id == watch.id);
            if let Some(own) = own {
                // The engine's copy shows the question; the monitor itself goes on in the sequence.
                own.monitor.clone_from(&watch.monitor);
                self.act_on(&watch.id, decision, None)?;
            }
        }
        Ok(!questions.is_empty())
    }

    /// How the last sequence was stopped, where it was.
    pub(super) fn last_stop(&self) -> Option<&Stopped> {
        self.stopped.as_ref()
    }
}
