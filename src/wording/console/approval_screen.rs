//! The texts of an approval request on the screen.

pub const NO_IDENTITY: &str = "say who you are: Esc, then `:as NAME`";
pub const CLOSED: &str = "the question is closed: nothing is left to decide";
pub const STALE: &str = "evidence changed: r reads it again";
pub const OWN_WORK: &str = "you made it: another approver decides (Esc, then `:as NAME`)";
pub const APPROVED_ALREADY: &str = "you have approved: another approver is needed (Esc, then `:as NAME`)";
pub const QUORUM_COMPLETE: &str = "the quorum is complete: no approval is missing";
pub const SHORT_ID_MISSING: &str = "type the short id (tab)";
pub const REASON_MISSING: &str = "give a reason (tab)";
pub const SHORT_ID_HERE: &str = "type the short id";
pub const REASON_HERE: &str = "type a reason";
pub const REASON_BEFORE_KEY: &str =
    "A reason comes first: type it, leave the field (tab), then press the key again";
pub const NO_REFUSAL: &str = "Esc changes nothing; F rejects the version";
pub const NOT_DELIVERED: &str = "your text is being requested: wait, or r reads it again";
pub const UNREAD: &str = "read it to its end (pagedown)";
pub const TYPING: &str = "leave the field (tab)";
pub const CLOSED_WHILE_TYPING: &str = "it closed while you typed";
pub const CANDIDATE_CHANGED: &str = "the candidate changed";
pub const EVIDENCE_CHANGED: &str = "the evidence changed";
pub const POLICY_CHANGED: &str = "the policy changed";
pub const REQUEST_RENEWED: &str = "the request was renewed";
pub const ACTIVE_VERSION_CHANGED: &str = "the active version changed";
pub const TEXT_CHANGED: &str = "its text changed";
pub const READ_AT_THE_CONSOLE: &str = "evidence read at the console";
pub const WAIT_A_MOMENT: &str = "wait a moment";
pub const ALL_OF_IT: &str = "all of it";
pub const NOTHING_LEFT_TO_DECIDE: &str = "nothing is left to decide here";
pub const SIGN_AND_REJECT: &str = " Sign and reject  ";
pub const BACK_TO_THE_QUESTION: &str = " back to the question";
pub const LEAVES_IT_SO: &str = " leaves it so";
pub const PASSPHRASE_CHECKED: &str = "the passphrase is being checked";
pub const SIGNED_AND_SENT: &str = "it is signed and sent; the engine has not answered yet";
pub const TAKES_IT_BACK: &str = " takes it back";
pub const LEAVES_IT: &str = " leaves it";
pub const NO_OPERATOR: &str = "no operator";
pub const FIRST: &str = "First";
pub const THEN: &str = "then";
pub const TO_SIGN: &str = "to sign";
pub const TO_REJECT: &str = "to reject";

#[must_use]
pub fn approved_it(by: &str) -> String {
    format!("{by} approved it, which was enough")
}

#[must_use]
pub fn not_to_be_signed(why: &str) -> String {
    format!("NOT TO BE SIGNED: {why}")
}

#[must_use]
pub fn rejected_it(by: &str) -> String {
    format!("{by} rejected it")
}

#[must_use]
pub fn lines_shown(first: usize, last: usize, count: usize, more: &str) -> String {
    format!("lines {first} to {last} of {count}, {more}")
}

#[must_use]
pub fn one_reads(one: &str) -> String {
    format!("{one} is reading this")
}

#[must_use]
pub fn two_read(one: &str, two: &str) -> String {
    format!("{one} and {two} are reading this")
}

#[must_use]
pub fn several_read(one: &str, two: &str, more: usize) -> String {
    format!("{one}, {two} and {more} more are reading this")
}

#[must_use]
pub fn press_to_read_again(glyph: &str, change: &str, at: &str, key: &str) -> String {
    format!("{glyph} STALE: {change} at {at}; press {key} to read it again")
}

#[must_use]
pub fn lines_unread(glyph: &str, unread: usize, all: usize, key: &str) -> String {
    format!("{glyph} {unread} of {all} lines unread: {key} shows the next")
}

#[must_use]
pub fn key_did_nothing(hint: &str) -> String {
    format!("That key did nothing: {hint}")
}

#[must_use]
pub fn end_and_back(key: &str) -> String {
    format!("end, back: {key}")
}
