//! Commands, replies and reports of the engine: plain serde values, one interface for all front ends.
//!
//! Commands go in; events, snapshots of the current state and video frames of the live cell come out. The domain's own
//! enums travel as they are, so a front end can match on them. A document with an unknown word is refused with the
//! list of valid words. Nothing here acts: the engine checks every command.
//!
//! # Where foreign text is sanitized
//!
//! Text travels as it was written and is sanitized once, where it is shown: by `sentence` and `line` of
//! `holdpoint_wording::event` for an event, by `holdpoint_text::Untrusted::display` for any other text. Each result may be
//! printed, drawn and wrapped as it is. The console's rows sanitize everything that they draw; safe text passes unchanged.

#![warn(missing_docs)]

pub mod account_role;
pub mod approval_document;
mod authority;
mod caller;
pub mod clock;
pub mod command;
pub mod console_presence;
pub mod detail;
pub mod event;
pub mod explanation;
pub mod film;
pub mod health;
pub mod monitor_chart;
mod request_kind;
pub mod request_problem;
mod request_signing;
pub mod scenario_state;
pub mod schema;
pub mod signing_refusal;
pub mod sink;
pub mod snapshot;
pub mod video_frame;
pub mod wire;
pub mod work_unit;
