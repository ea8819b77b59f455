//! Which commands any robot can carry out: finite numbers in their range, and an angle for each joint.
//!
//! A cell calls it before a step. The limits of a profile are the guard's, and the reach of the arm is the cell's.

use crate::{BodyError, Command};

/// Returns an error for a command with a number that is not finite or out of range.
///
/// # Errors
/// [`BodyError::Command`] with the value and what is needed.
pub fn check_command(command: &Command, joints: usize) -> Result<(), BodyError> {
    let positive = |name: &str, value: f64| {
        if value.is_finite() && value > 0.0 {
            Ok(())
        } else {
            Err(BodyError::Command(format!("{name} is \"{value}\"; a finite number above 0 is needed")))
        }
    };
    match command {
        Command::ToolPose { pose, max_speed_m_s } => {
            if !pose.is_valid() {
                let problem = format!("tool pose \"{pose:?}\" is not finite with a unit quaternion");
                return Err(BodyError::Command(problem));
            }
            positive("max_speed_m_s", *max_speed_m_s)
        }
        Command::Joints { q, max_speed_rad_s } => {
            if q.len() != joints || q.iter().any(|v| !v.is_finite()) {
                return Err(BodyError::Command(format!(
                    "joints \"{q:?}\"; {joints} finite angles are needed"
                )));
            }
            positive("max_speed_rad_s", *max_speed_rad_s)
        }
        Command::Gripper { width_m, speed_m_s, force_n } => {
            if !width_m.is_finite() || *width_m < 0.0 {
                return Err(BodyError::Command(format!("width_m is \"{width_m}\"; 0 or more is needed")));
            }
            positive("speed_m_s", *speed_m_s)?;
            positive("force_n", *force_n)
        }
        Command::Hold | Command::Stop | Command::Done | Command::Fail { .. } => Ok(()),
    }
}
