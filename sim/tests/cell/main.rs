//! The cell through its public face.

mod determinism;
mod fidelity;
mod inputs;
mod kinematics;
mod perception;
mod referee;
mod script;
mod work;
