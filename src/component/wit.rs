//! The contract `holdpoint:skill@1.0.0` on the host's side, and its messages from and to the body's own.

#[allow(
    clippy::all,
    clippy::pedantic,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    missing_docs,
    reason = "generated from the WIT"
)]
mod bindings {
    wasmtime::component::bindgen!({ path: "../sdk/wit", world: "component" });
}

use holdpoint_body::{
    Command, Estimate, FailureSignal, GuardVerdict, JointVec, Observation, Pose, TaskKind, Twist,
};
use holdpoint_skill::Hook;

use crate::contract::ComponentDescription;
use crate::sensors::SensorSet;

pub use bindings::exports::holdpoint::skill::skill;
pub use bindings::holdpoint::skill::types;

/// The conversions of messages that both contracts have, for the module `types` in scope.
macro_rules! shared_messages {
    () => {
        const fn vector([x, y, z]: [f64; 3]) -> types::Vector {
            types::Vector { x, y, z }
        }

        const fn pose(pose: &Pose) -> types::Pose {
            let [x, y, z, w] = pose.rotation;
            types::Pose { position: vector(pose.position), rotation: types::Quaternion { x, y, z, w } }
        }

        const fn twist(twist: &Twist) -> types::Twist {
            types::Twist { linear: vector(twist.linear), angular: vector(twist.angular) }
        }

        const fn estimate(seen: &Estimate) -> types::Estimate {
            types::Estimate { pose: pose(&seen.pose), age_ticks: seen.age_ticks, sequence: seen.sequence }
        }

        const fn verdict(guard: GuardVerdict) -> types::Verdict {
            match guard {
                GuardVerdict::Allowed => types::Verdict::Allowed,
                GuardVerdict::Clamped => types::Verdict::Clamped,
                GuardVerdict::Denied => types::Verdict::Denied,
            }
        }

        const fn signal(failure: types::Failure) -> FailureSignal {
            match failure {
                types::Failure::TargetNotFound => FailureSignal::TargetNotFound,
                types::Failure::GraspMissed => FailureSignal::GraspMissed,
                types::Failure::ObjectSlipped => FailureSignal::ObjectSlipped,
                types::Failure::UnexpectedContact => FailureSignal::UnexpectedContact,
                types::Failure::AlignmentLost => FailureSignal::AlignmentLost,
                types::Failure::PlacementMissed => FailureSignal::PlacementMissed,
                types::Failure::ToolUnavailable => FailureSignal::ToolUnavailable,
                types::Failure::InputStale => FailureSignal::InputStale,
                types::Failure::TimedOut => FailureSignal::TimedOut,
            }
        }

        /// What a component asks for; its numbers are taken as they are. `None` if it is no command.
        pub fn command(requested: &types::Command) -> Option<Command> {
            Some(match requested {
                types::Command::Hold => Command::Hold,
                types::Command::ToolPose(types::ToolPose { pose, max_speed_m_s }) => {
                    let (p, r) = (pose.position, pose.rotation);
                    let position = [p.x, p.y, p.z].map(number);
                    let rotation = [r.x, r.y, r.z, r.w].map(number);
                    Command::ToolPose {
                        pose: Pose { position, rotation },
                        max_speed_m_s: number(*max_speed_m_s),
                    }
                }
                types::Command::Joints(types::JointMove { q, max_speed_rad_s }) => {
                    Command::Joints { q: joint_vec(q)?, max_speed_rad_s: number(*max_speed_rad_s) }
                }
                types::Command::Gripper(types::Grip { width_m, speed_m_s, force_n }) => Command::Gripper {
                    width_m: number(*width_m),
                    speed_m_s: number(*speed_m_s),
                    force_n: number(*force_n),
                },
                types::Command::Stop => Command::Stop,
                types::Command::Done => Command::Done,
                types::Command::Fail(failure) => Command::Fail { signal: signal(*failure) },
            })
        }

        /// A hook, as a component knows it.
        pub const fn hook(hook: Hook) -> types::Hook {
            match hook {
                Hook::SafeAbort => types::Hook::SafeAbort,
                Hook::Rollback => types::Hook::Rollback,
            }
        }
    };
}

pub(crate) use shared_messages;

shared_messages!();

/// The most joints of the contract.
const CONTRACT_JOINTS: usize = 8;

/// A joint vector; the values beyond the count are 0. `None` if the arm has more joints than the contract.
fn joints(values: &JointVec) -> Option<types::Joints> {
    let count = values.len();
    let mut all = [0.0; CONTRACT_JOINTS];
    all.get_mut(..count)?.copy_from_slice(values);
    let [j0, j1, j2, j3, j4, j5, j6, j7] = all;
    #[allow(clippy::cast_possible_truncation, reason = "at most CONTRACT_JOINTS, 8")]
    let count = count as u8;
    Some(types::Joints { count, j0, j1, j2, j3, j4, j5, j6, j7 })
}

/// `None` if it says to have more joints than there can be.
fn joint_vec(joints: &types::Joints) -> Option<JointVec> {
    let types::Joints { count, j0, j1, j2, j3, j4, j5, j6, j7 } = *joints;
    let all = [j0, j1, j2, j3, j4, j5, j6, j7].map(number);
    Some(all.get(..usize::from(count))?.iter().copied().collect())
}

/// `None` if the contract does not have the task: no component performs it.
fn task(task: TaskKind) -> Option<types::Task> {
    let all = [types::Task::Grasp, types::Task::Align, types::Task::Place];
    all.into_iter().find(|known| task_kind(*known) == task)
}

/// The primitive a component performs.
const fn task_kind(task: types::Task) -> TaskKind {
    match task {
        types::Task::Grasp => TaskKind::Grasp,
        types::Task::Align => TaskKind::Align,
        types::Task::Place => TaskKind::Place,
    }
}

/// What a component says of itself; the contract has no sensors to ask for.
pub fn description(said: types::Description) -> ComponentDescription {
    ComponentDescription {
        task: Ok(task_kind(said.task)),
        interface: said.interface,
        wanted: SensorSet::default(),
    }
}

/// What a component is given in a tick. `None` if the contract does not have the task, or not as many joints.
pub fn observation(seen: &Observation) -> Option<types::Observation> {
    Some(types::Observation {
        tick: seen.tick,
        q: joints(&seen.q)?,
        dq: joints(&seen.dq)?,
        tau: joints(&seen.tau)?,
        tool: pose(&seen.tool),
        tool_twist: twist(&seen.tool_twist),
        gripper_width_m: seen.gripper_width_m,
        gripper_force_n: seen.gripper_force_n,
        wrist_force_n: seen.wrist_force_n,
        object: seen.object().map(estimate),
        target: seen.target().map(estimate),
        tool_available: seen.tool_available,
        goal: task(seen.goal)?,
        guard: verdict(seen.guard),
    })
}

/// A number as it is. A NaN has a single form, so its bits carry no message.
pub const fn number(number: f64) -> f64 {
    if number.is_nan() { f64::NAN } else { number }
}
