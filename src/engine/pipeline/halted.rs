//! The pipeline while a person has stopped the cell: nothing is begun, activated or worked.

use super::{Pipeline, Progress};
use crate::fault::Fault;
use crate::halt;
use crate::world::switch::AskedStop;
use holdpoint_governance::alarms::{AlarmKey, Priority};
use holdpoint_protocol::command::{Reply, StopKept};

impl Pipeline {
    /// Puts a stop on record that was asked for on another thread, and tells when the arm stands.
    pub(super) fn take_in_halt(&mut self) {
        if let Err(error) = halt::take_in(&mut self.record, &mut self.world)
            && self.record.holding().is_none()
        {
            self.hold(&Fault::from(error).held());
        }
        halt::look(&mut self.record, &mut self.world);
    }

    /// A person stops the cell, at any time. A stop that cannot be written is one all the same; the engine holds then.
    pub(crate) fn halt(&mut self, asked: AskedStop) -> Reply {
        let reply = halt::stop(&mut self.record, &mut self.world, asked);
        if let Reply::Stopped { text, kept: StopKept::InMark | StopKept::InMemory } = &reply
            && self.record.holding().is_none()
        {
            self.hold(text);
        }
        reply
    }

    /// Another program took the name of the engine's socket, and the engine took it back; so many times by now.
    pub(crate) fn name_taken(&mut self, times: u64) {
        let text = format!(
            "the name of the engine's socket was taken ({times} since the start): what was answered there may have been somebody else's"
        );
        self.record.raise(AlarmKey::NameTaken, Priority::High, true, &text);
    }

    /// A stopped cell: nothing is begun, activated or worked. What runs comes to its end, and deadlines pass.
    pub(super) fn halted_slice(&mut self) -> Result<Progress, Fault> {
        if self.world.is_running() {
            let finished = self.world.thread.as_mut().and_then(|thread| thread.finished(false));
            let Some(finished) = finished else { return Ok(Progress::Idle { next_ms: None }) };
            self.finish_sequence(finished?)?;
            return Ok(Progress::Worked);
        }
        if self.look_at_deadlines()? {
            return Ok(Progress::Worked);
        }
        Ok(Progress::Idle { next_ms: self.next_deadline_ms() })
    }
}
