//! The operator console: a terminal front end of the engine's Command/Event/Snapshot door.
//!
//! `update` is a pure reducer (a [`model::Model`] and a [`msg::Msg`] give effects), views only read, and the run
//! loop alone touches the terminal, the clock and the engine. What the console must not do: hold authority. The
//! engine checks every decision again; a console that is gone means hold, never approve.

pub mod action;
pub mod audit;
pub mod commands;
pub mod effect;
pub mod effects;
pub mod form;
pub mod frame;
pub mod keymap;
pub mod line;
pub mod look;
pub mod model;
pub mod msg;
pub mod operator;
pub mod options;
pub mod palette;
pub mod player;
pub mod prompt;
pub mod replay;
pub mod rows;
pub mod run;
pub mod secret;
pub mod terminal;
pub mod theme;
mod trend;
pub mod update;
pub mod views;
pub mod widgets;
pub mod words;
