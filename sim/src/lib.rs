//! The manipulator cell: a rapier world, the arm, tasks, perturbations and ground truth.
pub mod io;
