//! The contract on the component's side, and its messages from and to the body's own.

#[allow(
    clippy::all,
    clippy::pedantic,
    missing_docs,
    unsafe_op_in_unsafe_fn,
    reason = "generated from the WIT"
)]
pub mod bindings {
    wit_bindgen::generate!({
        path: "../wit",
        world: "component",
        pub_export_macro: true,
        default_bindings_module: "holdpoint_sdk_1::bindings",
    });
}

use std::marker::PhantomData;
use std::sync::Mutex;

use bindings::exports::holdpoint::skill::skill::{Guest, Parameter};
use bindings::holdpoint::skill::types;
use holdpoint_body::{
    Command, Estimate, FailureSignal, GuardVerdict, JointVec, Observation, Pose, ReadingVec, TaskKind, Twist,
};
use holdpoint_skill::{Hook, Skill};

use crate::{Bundle, params};

/// The one task of this instance.
static RUN: Mutex<Option<Box<dyn Skill>>> = Mutex::new(None);

/// What the host calls, on behalf of a bundle.
pub struct Adapter<B>(PhantomData<B>);

impl<B: Bundle> Guest for Adapter<B> {
    fn describe(parameters: Vec<Parameter>) -> Result<types::Description, String> {
        let said = B::describe(params::read(parameters)?)?;
        // Code can perform a task that is declared and not in the contract.
        // It cannot be described then, so it is refused before any of its ticks.
        let Some(task) = contract_task(said.task) else {
            return Err(format!("the contract has no task {}", said.task));
        };
        Ok(types::Description { task, interface: said.interface })
    }

    fn start(seed: u64, parameters: Vec<Parameter>) -> Result<(), String> {
        let run = B::start(seed, params::read(parameters)?)?;
        with_run(|place| *place = Some(run));
        Ok(())
    }

    fn tick(seen: types::Observation) -> types::Command {
        let seen = observation(&seen);
        command(with_run(|run| run.as_mut().map_or(Command::Hold, |run| run.tick(&seen))))
    }

    fn enter(hook: types::Hook) {
        let hook = match hook {
            types::Hook::SafeAbort => Hook::SafeAbort,
            types::Hook::Rollback => Hook::Rollback,
        };
        with_run(|run| {
            if let Some(run) = run {
                run.enter(hook);
            }
        });
    }
}

/// A component has one thread and panics end it, so the lock is never held by another and never poisoned.
fn with_run<T>(work: impl FnOnce(&mut Option<Box<dyn Skill>>) -> T) -> T {
    match RUN.lock() {
        Ok(mut run) => work(&mut run),
        Err(poisoned) => work(&mut poisoned.into_inner()),
    }
}

/// The most joints of the contract.
const CONTRACT_JOINTS: usize = 8;

fn joint_vec(joints: &types::Joints) -> JointVec {
    let types::Joints { count, j0, j1, j2, j3, j4, j5, j6, j7 } = *joints;
    [j0, j1, j2, j3, j4, j5, j6, j7].into_iter().take(usize::from(count)).collect()
}

/// Of more joints than the contract has, the count says so, and the host refuses the command.
fn joints(values: &JointVec) -> types::Joints {
    let mut all = [0.0; CONTRACT_JOINTS];
    all.iter_mut().zip(values).for_each(|(place, value)| *place = *value);
    let [j0, j1, j2, j3, j4, j5, j6, j7] = all;
    #[allow(clippy::cast_possible_truncation, reason = "at most MAX_JOINTS, 16")]
    let count = values.len() as u8;
    types::Joints { count, j0, j1, j2, j3, j4, j5, j6, j7 }
}

const fn numbers(vector: types::Vector) -> [f64; 3] {
    [vector.x, vector.y, vector.z]
}

const fn pose(pose: &types::Pose) -> Pose {
    let r = pose.rotation;
    Pose { position: numbers(pose.position), rotation: [r.x, r.y, r.z, r.w] }
}

const fn estimate(seen: types::Estimate) -> Estimate {
    Estimate { pose: pose(&seen.pose), age_ticks: seen.age_ticks, sequence: seen.sequence }
}

fn observation(seen: &types::Observation) -> Observation {
    let goal = match seen.goal {
        types::Task::Grasp => TaskKind::Grasp,
        types::Task::Align => TaskKind::Align,
        types::Task::Place => TaskKind::Place,
    };
    Observation {
        tick: seen.tick,
        q: joint_vec(&seen.q),
        dq: joint_vec(&seen.dq),
        tau: joint_vec(&seen.tau),
        tool: pose(&seen.tool),
        tool_twist: Twist {
            linear: numbers(seen.tool_twist.linear),
            angular: numbers(seen.tool_twist.angular),
        },
        gripper_width_m: seen.gripper_width_m,
        gripper_force_n: seen.gripper_force_n,
        wrist_force_n: seen.wrist_force_n,
        objects: goal.seen_objects(seen.object.map(estimate), seen.target.map(estimate)),
        sensors: ReadingVec::new(),
        tool_available: seen.tool_available,
        goal,
        guard: match seen.guard {
            types::Verdict::Allowed => GuardVerdict::Allowed,
            types::Verdict::Clamped => GuardVerdict::Clamped,
            types::Verdict::Denied => GuardVerdict::Denied,
        },
    }
}

fn command(asked: Command) -> types::Command {
    match asked {
        Command::Hold => types::Command::Hold,
        Command::ToolPose {
            pose: Pose { position: [x, y, z], rotation: [qx, qy, qz, qw] },
            max_speed_m_s,
        } => {
            let position = types::Vector { x, y, z };
            let rotation = types::Quaternion { x: qx, y: qy, z: qz, w: qw };
            types::Command::ToolPose(types::ToolPose {
                pose: types::Pose { position, rotation },
                max_speed_m_s,
            })
        }
        Command::Joints { q, max_speed_rad_s } => {
            types::Command::Joints(types::JointMove { q: joints(&q), max_speed_rad_s })
        }
        Command::Gripper { width_m, speed_m_s, force_n } => {
            types::Command::Gripper(types::Grip { width_m, speed_m_s, force_n })
        }
        Command::Stop => types::Command::Stop,
        Command::Done => types::Command::Done,
        Command::Fail { signal } => types::Command::Fail(match signal {
            FailureSignal::TargetNotFound => types::Failure::TargetNotFound,
            FailureSignal::GraspMissed => types::Failure::GraspMissed,
            FailureSignal::ObjectSlipped => types::Failure::ObjectSlipped,
            FailureSignal::UnexpectedContact => types::Failure::UnexpectedContact,
            FailureSignal::AlignmentLost => types::Failure::AlignmentLost,
            FailureSignal::PlacementMissed => types::Failure::PlacementMissed,
            FailureSignal::ToolUnavailable => types::Failure::ToolUnavailable,
            FailureSignal::InputStale => types::Failure::InputStale,
            FailureSignal::TimedOut => types::Failure::TimedOut,
        }),
    }
}

/// `None` for a task that the contract does not have.
#[allow(unreachable_patterns, reason = "a task can be declared before the contract has it")]
const fn contract_task(task: TaskKind) -> Option<types::Task> {
    match task {
        TaskKind::Grasp => Some(types::Task::Grasp),
        TaskKind::Align => Some(types::Task::Align),
        TaskKind::Place => Some(types::Task::Place),
        _ => None,
    }
}
