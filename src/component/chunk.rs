//! The commands of one answer, played one for each tick.
//!
//! Owns the rule when the rest of an answer is dropped. Judges no command: the guard checks each one in its tick.

use std::collections::VecDeque;

use holdpoint_body::{Command, GuardVerdict, Observation};

/// The most commands of one answer: those of a second.
pub const CHUNK_COMMANDS_MAX: usize = holdpoint_body::RATE_HZ as usize;

/// The commands of one answer.
#[derive(Clone, Debug, PartialEq)]
pub struct CommandChunk {
    /// That of the tick in which the code was asked.
    pub first: Command,
    /// Those of the ticks after it.
    pub rest: Vec<Command>,
}

/// What is left of the last answer.
#[derive(Debug, Default)]
pub struct ChunkPlayer {
    rest: VecDeque<Command>,
    /// The tick of the next command.
    due: u64,
}

impl ChunkPlayer {
    /// Takes what the code answered in a tick, and returns the command of this tick.
    pub fn begin(&mut self, chunk: CommandChunk, tick: u64) -> Command {
        self.rest = chunk.rest.into();
        self.due = tick.saturating_add(1);
        chunk.first
    }

    /// The command of this tick; `None` if the code has to be asked. The rest is dropped if the guard denied the last
    /// command, or if a tick was left out: the robot was interrupted, and the commands are of a time before.
    pub fn play(&mut self, seen: &Observation) -> Option<Command> {
        if seen.tick != self.due || seen.guard == GuardVerdict::Denied {
            self.rest.clear();
        }
        self.due = seen.tick.saturating_add(1);
        self.rest.pop_front()
    }

    /// Drops the rest.
    pub fn clear(&mut self) {
        self.rest.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::guest::seen;

    fn at(tick: u64, guard: GuardVerdict) -> Observation {
        Observation { guard, ..seen(tick) }
    }

    /// A player in the tick after an answer of `stop`, `done`, `hold` at tick 5.
    fn playing() -> ChunkPlayer {
        let mut player = ChunkPlayer::default();
        assert_eq!(player.play(&at(5, GuardVerdict::Allowed)), None);
        let chunk = CommandChunk { first: Command::Stop, rest: vec![Command::Done, Command::Hold] };
        assert_eq!(player.begin(chunk, 5), Command::Stop);
        player
    }

    #[test]
    fn each_tick_plays_one_command_and_the_code_is_asked_after_the_last() {
        let mut player = playing();
        assert_eq!(player.play(&at(6, GuardVerdict::Allowed)), Some(Command::Done));
        assert_eq!(player.play(&at(7, GuardVerdict::Clamped)), Some(Command::Hold));
        assert_eq!(player.play(&at(8, GuardVerdict::Allowed)), None);
    }

    #[test]
    fn rest_is_dropped_after_a_denied_command_a_gap_and_on_demand() {
        let mut denied = playing();
        assert_eq!(denied.play(&at(6, GuardVerdict::Denied)), None);
        assert_eq!(denied.play(&at(7, GuardVerdict::Allowed)), None, "it does not come back");
        for tick in [5, 7, 0] {
            assert_eq!(playing().play(&at(tick, GuardVerdict::Allowed)), None, "tick {tick}");
        }
        let mut cleared = playing();
        cleared.clear();
        assert_eq!(cleared.play(&at(6, GuardVerdict::Allowed)), None);
    }
}
