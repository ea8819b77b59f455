//! The operator console: a terminal front end of the engine's Command/Event/Snapshot socket.
//!
//! `update` is a pure reducer: a [`model::ConsoleModel`] and a [`msg::Msg`] give effects. Views only read; only the
//! run loop touches terminal, clock and engine. The console must hold no authority: the engine checks every decision
//! again, and losing a console means hold, never approve.

pub mod action;
pub mod approval_screen;
pub mod audit;
pub mod commands;
pub mod effect;
pub mod effects;
pub mod form;
pub mod formatters;
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
pub mod replay;
pub mod rows;
pub mod run;
pub mod secret;
pub mod state_filter;
pub mod terminal;
pub mod theme;
mod trend;
pub mod update;
pub mod views;
pub mod waiting_rows;
pub mod widgets;
