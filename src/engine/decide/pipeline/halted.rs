//! The pipeline while a person has stopped the cell: no stage begins, no version is activated, nothing runs.

use super::{Pipeline, SliceOutcome};
use crate::decide::halt;
use crate::fault::EngineFault;
use crate::live::stop_switch::StopRequest;
use holdpoint_governance::alarms::{AlarmKey, Priority};
use holdpoint_governance::notice::Notice;
use holdpoint_protocol::command::{Reply, StopPersistence};

impl Pipeline {
    /// Records a stop that another thread requested, and reports when the arm is at standstill.
    pub(super) fn take_in_halt(&mut self) {
        if self.world.switch().first_stop().is_some() {
            self.collect_earlier_sequence();
        }
        if let Err(error) = halt::record_stops(&mut self.record, &mut self.world)
            && self.record.holding().is_none()
        {
            self.hold(&EngineFault::from(error).halt_problem());
        }
        halt::report_standstill(&mut self.record, &mut self.world);
    }

    /// Processes a sequence that ended before the stop of the cell, so that the record has its tasks before the stop.
    fn collect_earlier_sequence(&mut self) {
        if !self.world.switch().has_stepped_since_halt() {
            self.collect_sequence(false);
        }
    }

    /// A person stops the cell, at any time. A stop that cannot be written still stops; the engine then halts.
    pub(crate) fn halt(&mut self, request: StopRequest) -> Reply {
        // The arm stops first: what that sequence leads to may move it.
        self.world.switch().halt(request.clone());
        self.collect_earlier_sequence();
        let reply = halt::stop(&mut self.record, &mut self.world, request);
        if let Reply::Stopped { text, kept: StopPersistence::InMark | StopPersistence::InMemory } = &reply
            && self.record.holding().is_none()
        {
            self.hold(text);
        }
        reply
    }

    /// Another program took the name of the engine's socket, and the engine took it back; `times` since the start.
    pub(crate) fn name_taken(&mut self, times: u64) {
        self.record.raise(AlarmKey::NameTaken, Priority::High, true, Notice::SocketNameTaken { times });
    }

    /// A stopped cell: no stage begins, no version is activated. A running sequence ends, and deadlines pass.
    pub(super) fn halted_slice(&mut self) -> Result<SliceOutcome, EngineFault> {
        if self.world.is_running() {
            let finished = self.world.thread.as_mut().and_then(|thread| thread.finished(false));
            let Some(finished) = finished else { return Ok(SliceOutcome::Idle { next_ms: None }) };
            self.finish_sequence(finished?)?;
            return Ok(SliceOutcome::Ran);
        }
        if self.look_at_deadlines()? {
            return Ok(SliceOutcome::Ran);
        }
        Ok(SliceOutcome::Idle { next_ms: self.next_deadline_ms() })
    }
}
