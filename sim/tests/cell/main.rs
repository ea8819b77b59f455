//! The cell through its public face.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test says what it expects by failing"
)]

mod copies;
mod determinism;
mod dynamics;
mod fidelity;
mod further;
mod inputs;
mod kinematics;
mod perception;
mod referee;
mod script;
mod work;
