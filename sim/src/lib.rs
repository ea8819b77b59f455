//! The manipulator cell: a rapier world, the arm, tasks, perturbations and ground truth.
//!
//! Owns physics, kinematics, the servo, perception and the referee. It knows nothing of manifests,
//! governance, stores or screens; what decides meets it only through [`holdpoint_cell`] and [`holdpoint_body`].

#![warn(missing_docs)]

pub mod bench_episode;
pub mod dynamics;
pub mod film;
pub mod pool;
pub mod published;
pub mod robot;
pub mod world;

mod build;
mod cell;
mod constraints;
mod coupled_rows;
mod effort;
mod fault;
mod free_body;
mod further;
mod handles;
mod motors;
mod object_contacts;
mod perception;
pub mod readout;
mod reduced_state;
mod servo;
mod state;
mod stepper;
mod survey;
mod urdf;
mod warm_start;
pub mod work_count;

pub use cell::{BUILD, SimCells, SimFactory};
pub use perception::CAMERA_HZ;
pub use pool::{PoolEnd, run_ordered};
pub use robot::RobotModel;
pub use world::{Fidelity, World, WorldConfig, WorldTruth};
