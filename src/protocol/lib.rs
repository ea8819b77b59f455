//! What is asked of an engine and what it reports: plain serde values, one interface for all front ends.
//!
//! Commands go in, events come out, a snapshot says how things stand, a picture what the live cell looks like. The
//! domain's own enums travel as they are: a front end matches on them, and a word that is in no set is refused when
//! a document is read, with the list. Nothing here acts: the engine checks every command.
//!
//! # Where foreign text is made safe
//!
//! What travels is text as it was written. There is one border, and it is where a text meets somebody's eyes:
//! [`words::sentence`] and [`words::line`] for an event, `holdpoint_text::Untrusted::display` for any other text. Each
//! returns a `Shown`, whose text may be printed, drawn and wrapped as it is. The console's rows are such a border for
//! everything that they draw; what is safe already comes out of them as it went in.

#![warn(missing_docs)]

mod answer;
mod authority;
mod caller;
mod changes;
pub mod clock;
pub mod command;
pub mod detail;
pub mod event;
pub mod explained;
pub mod film;
pub mod health;
pub mod picture;
mod purpose;
pub mod question;
pub mod schema;
pub mod seat;
pub mod sink;
pub mod snapshot;
pub mod standing;
pub mod wire;
pub mod words;
