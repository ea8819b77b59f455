//! Answers to marks, and to keys that act on marked items.

pub const NOTHING_TO_MARK: &str = "there is nothing under the cursor that can be marked";
pub const ALL_ACKNOWLEDGED: &str = "every alarm that was marked is acknowledged already";
pub const ALREADY_ACKNOWLEDGED: &str = "it is already acknowledged";
pub const NOT_SHELVED: &str = "it is not shelved";
pub const NOTHING_MARKED: &str = "nothing is marked";

#[must_use]
pub fn marked(count: usize, reject: &str, pause: &str, copy: &str, back: &str) -> String {
    format!(
        "{count} marked: {reject} rejects, {pause} pauses, {copy} copies them, {back} takes the marks away"
    )
}

#[must_use]
pub fn acts_on_one(count: usize, back: &str) -> String {
    format!("{count} are marked, and this acts on one alone: {back} takes the marks away")
}

#[must_use]
pub fn too_many(marked: usize, room: usize) -> String {
    format!("{marked} are marked, and one question on this screen names {room}")
}

#[must_use]
pub fn take_its_mark_away(why: &str) -> String {
    format!("{why}: take its mark away")
}
