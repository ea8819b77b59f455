//! The texts of a replay: answers to keys, warnings, and what the screen shows of a recording.

use crate::counted;

pub const NO_FRAME_AFTER: &str = "no frame after this one";
pub const NO_FRAME_BEFORE: &str = "no frame before this one";
pub const NO_EVENT_AFTER: &str = "no event after this";
pub const NO_EVENT_BEFORE: &str = "no event before this";
pub const NO_DECISION_AFTER: &str = "no decision after this";
pub const NO_DECISION_BEFORE: &str = "no decision before this";
pub const NO_FAILURE: &str = "nothing goes wrong in this recording";
pub const NO_CHARTS: &str = "this recording holds no charts";
pub const GAPS_SKIPPED: &str = "gaps are skipped while playing";
pub const GAPS_PLAYED: &str = "gaps are played through";
pub const END: &str = "end of the recording; g goes to its beginning";
pub const FORCE_AT_THE_PADS: &str = "force at the pads, N";
pub const FORCE_ON_SURROUNDINGS: &str = "force on surroundings, N";
pub const REPLAY_FAILED: &str = "the replay failed; nothing was changed";
pub const EXPLAIN_NEEDS_NONE: &str = "`holdpoint explain` needs none";
pub const PRINTS_WITHOUT_A_TERMINAL: &str = "without one `holdpoint replay --terminal` prints the events";
pub const DECIDED_FOR: &str = "decided: passed, approved or confirmed";
pub const WENT_WRONG: &str = "rejected, failed, fault; on the bar: went wrong";
pub const DECIDED_HELD: &str = "decided: held or restricted; the monitor acted";
pub const PEOPLE_WERE_ASKED: &str = "people were asked";
pub const NOT_DONE_OR_LIMIT_PASSED: &str = "sequence not done, or a limit passed";
pub const RECORDING_GOES_ON: &str = "the recording goes on";
pub const NOT_CLOSED: &str = "not closed: the recording ends before the upgrade did";
pub const NO_EVENT_RECORDED: &str = "No event was recorded";
pub const NO_FAILURE_RECORDED: &str = "No failure was recorded";
pub const NOTHING_WENT_WRONG: &str = "Nothing went wrong";
pub const NOTHING_WRONG: &str = "nothing went wrong";
pub const DOWN_SHOWS_MORE: &str = "down shows more, esc closes";
pub const KEYS_OF_THE_REPLAY: &str = "Keys of the replay";
pub const ON_THE_TIME_BAR: &str = "On the time bar";
pub const JUMP_TARGETS: &str = "   12.5s  1:02  t 3000  +5s   enter jumps, esc cancels";
pub const NO_CHARTS_HERE: &str = "This recording holds no charts";

#[must_use]
pub fn skipped(length: &str) -> String {
    format!("skipped {length} without frames; s plays them through")
}

#[must_use]
pub fn span(from: &str, to: &str) -> String {
    format!("the recording goes from {from} to {to}")
}

#[must_use]
pub fn head(version: &str, against: &str, profile: &str, robot: &str, seed: &str, engine: &str) -> String {
    format!("{version}{against}: profile {profile}, robot {robot}, {seed}, engine {engine}")
}

#[must_use]
pub fn dropped(frames: u64, events: u64) -> String {
    format!("; dropped: {}, {}", counted(frames, "frame"), counted(events, "event"))
}

#[must_use]
pub fn went_wrong(failure: &str) -> String {
    format!("went wrong: {failure}")
}

#[must_use]
pub fn before_the_first(count: usize) -> String {
    format!("before the first of {count}")
}

#[must_use]
pub fn went_wrong_at(time: &str) -> String {
    format!("went wrong at {time}")
}

#[must_use]
pub fn went_wrong_with(time: &str, what: &str) -> String {
    format!("went wrong at {time}: {what}")
}

#[must_use]
pub fn state_not_recorded(glyph: &str) -> String {
    format!("{glyph} state not recorded yet")
}

#[must_use]
pub fn not_closed(glyph: &str) -> String {
    format!("{glyph} not closed")
}

#[must_use]
pub fn no_value_yet(glyph: &str) -> String {
    format!("{glyph} no value yet")
}

#[must_use]
pub fn no_frames_evaluated_apart(stretch: &str) -> String {
    format!("no frames {stretch}: the candidate is evaluated apart from the live cell")
}

#[must_use]
pub fn frame_is_earlier(age: &str) -> String {
    format!("frame of {age} earlier")
}

#[must_use]
pub fn stretch(from: &str, to: &str) -> String {
    format!("from {from} to {to}")
}

#[must_use]
pub fn no_frames(stretch: &str) -> String {
    format!("no frames {stretch}")
}

#[must_use]
pub fn holds_nothing(recording: &str) -> String {
    format!("the recording of \"{recording}\" holds neither frames nor events")
}

#[must_use]
pub fn cannot_jump(text: &str) -> String {
    format!("cannot jump to \"{text}\"; allowed are 12.5s, 1:02.5, t 3000, +5s and -5s")
}
