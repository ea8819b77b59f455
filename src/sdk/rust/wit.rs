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
        path: "../wit/2",
        world: "component",
        pub_export_macro: true,
        default_bindings_module: "holdpoint_sdk::bindings",
    });
}

use std::marker::PhantomData;
use std::mem;
use std::sync::Mutex;

use bindings::exports::holdpoint::skill::skill::{Guest, Parameter};
use bindings::holdpoint::skill::types;
use holdpoint_body::{
    Command, Estimate, FailureSignal, GuardVerdict, JointVec, MAX_JOINTS, MAX_OBJECTS, MAX_SENSORS,
    NamedReading, ObjectName, Observation, Pose, SENSOR_VALUES_MAX, SeenObject, TaskKind, Twist,
};
use holdpoint_skill::{Hook, Skill};

use crate::{Bundle, params};

/// The one task of this instance.
static RUN: Mutex<Option<Box<dyn Skill>>> = Mutex::new(None);

/// The commands of this answer after the first.
static THEN: Mutex<Vec<Command>> = Mutex::new(Vec::new());

/// What the host calls, on behalf of a bundle.
pub struct Adapter<B>(PhantomData<B>);

impl<B: Bundle> Guest for Adapter<B> {
    fn describe(parameters: Vec<Parameter>) -> Result<types::Description, String> {
        let said = B::describe(params::read(parameters)?)?;
        let vector = |&(name, length): &(&str, u32)| types::VectorSpec { name: name.to_owned(), length };
        let vectors = B::SENSORS.iter().map(vector).collect();
        let wanted = types::Sensors { images: Vec::new(), vectors };
        Ok(types::Description { task: said.task.name().to_owned(), interface: said.interface, wanted })
    }

    /// Every sensor that is asked for is granted, or the component does not run.
    fn start(seed: u64, parameters: Vec<Parameter>, _granted: types::Sensors) -> Result<(), String> {
        let run = B::start(seed, params::read(parameters)?)?;
        with(&RUN, |place| *place = Some(run));
        Ok(())
    }

    fn step(seen: types::Observation) -> Vec<types::Command> {
        // The code describes a task that this kit knows, and is given no other one.
        let Some(seen) = observation(&seen) else { return vec![types::Command::Hold] };
        let first = with(&RUN, |run| run.as_mut().map_or(Command::Hold, |run| run.tick(&seen)));
        let rest = with(&THEN, mem::take);
        std::iter::once(first).chain(rest).map(command).collect()
    }

    fn enter(hook: types::Hook) {
        let hook = match hook {
            types::Hook::SafeAbort => Hook::SafeAbort,
            types::Hook::Rollback => Hook::Rollback,
        };
        with(&RUN, |run| {
            if let Some(run) = run {
                run.enter(hook);
            }
        });
    }
}

/// Adds a command to the answer of this tick, for the tick after its last one; an answer has at most 240. The code is asked
/// again after them, or earlier: if the guard denies one, a hook is entered, or the robot is interrupted.
pub fn then(command: Command) {
    with(&THEN, |rest| rest.push(command));
}

/// A component has one thread and panics end it, so a lock is never held by another and never poisoned.
fn with<T, R>(place: &Mutex<T>, work: impl FnOnce(&mut T) -> R) -> R {
    match place.lock() {
        Ok(mut value) => work(&mut value),
        Err(poisoned) => work(&mut poisoned.into_inner()),
    }
}

fn joint_vec(values: &[f64]) -> JointVec {
    values.iter().copied().take(MAX_JOINTS).collect()
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

/// `None` if this kit does not know the task.
fn observation(seen: &types::Observation) -> Option<Observation> {
    let object = |one: &types::SeenObject| {
        Some(SeenObject { name: ObjectName::from(&one.name).ok()?, estimate: estimate(one.estimate) })
    };
    let reading = |one: &types::NamedVector| {
        let values = one.values.iter().copied().take(SENSOR_VALUES_MAX).collect();
        Some(NamedReading { name: ObjectName::from(&one.name).ok()?, age_ticks: one.age_ticks, values })
    };
    Some(Observation {
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
        objects: seen.objects.iter().filter_map(object).take(MAX_OBJECTS).collect(),
        sensors: seen.vectors.iter().filter_map(reading).take(MAX_SENSORS).collect(),
        tool_available: seen.tool_available,
        goal: TaskKind::named(&seen.goal.task)?,
        guard: match seen.guard {
            types::Verdict::Allowed => GuardVerdict::Allowed,
            types::Verdict::Clamped => GuardVerdict::Clamped,
            types::Verdict::Denied => GuardVerdict::Denied,
        },
    })
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
            types::Command::Joints(types::JointMove { q: q.to_vec(), max_speed_rad_s })
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Description;

    /// Answers with a grip at the force on the first pad, then with `done`.
    struct Tested;

    #[derive(serde::Deserialize)]
    struct NoParams {}

    impl Bundle for Tested {
        type Params = NoParams;
        const SENSORS: &'static [(&'static str, u32)] = &[("pad-forces", 2)];

        fn describe(_: NoParams) -> Result<Description, String> {
            Ok(Description { task: TaskKind::Align, interface: "{}".to_owned() })
        }

        fn start(_: u64, _: NoParams) -> Result<Box<dyn Skill>, String> {
            Ok(Box::new(Self))
        }
    }

    impl Skill for Tested {
        fn tick(&mut self, seen: &Observation) -> Command {
            then(Command::Done);
            let force_n = seen.sensors[0].values[0];
            Command::Gripper { width_m: seen.object().unwrap().pose.position[0], speed_m_s: 0.1, force_n }
        }

        fn enter(&mut self, _: Hook) {}
    }

    fn seen(task: &str) -> types::Observation {
        let zero = types::Vector { x: 0.0, y: 0.0, z: 0.0 };
        let rotation = types::Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 };
        let pose = types::Pose { position: types::Vector { x: 0.25, ..zero }, rotation };
        let estimate = types::Estimate { pose, age_ticks: 3, sequence: 9 };
        types::Observation {
            tick: 7,
            q: vec![0.5; 7],
            dq: Vec::new(),
            tau: Vec::new(),
            tool: pose,
            tool_twist: types::Twist { linear: zero, angular: zero },
            gripper_width_m: 0.05,
            gripper_force_n: 1.0,
            wrist_force_n: 2.0,
            objects: vec![types::SeenObject { name: "object".to_owned(), estimate }],
            images: Vec::new(),
            vectors: vec![types::NamedVector {
                name: "pad-forces".to_owned(),
                age_ticks: 0,
                values: vec![18.5, 17.5],
            }],
            tool_available: true,
            goal: types::Goal {
                task: task.to_owned(),
                object: "object".to_owned(),
                target: "tray".to_owned(),
            },
            guard: types::Verdict::Allowed,
        }
    }

    #[test]
    fn objects_and_sensors_arrive_and_an_answer_has_the_commands_that_follow() {
        let described = <Adapter<Tested> as Guest>::describe(Vec::new()).unwrap();
        assert_eq!(described.task, "align");
        let wanted = &described.wanted;
        assert_eq!((wanted.vectors[0].name.as_str(), wanted.vectors[0].length), ("pad-forces", 2));
        assert!(wanted.images.is_empty());
        <Adapter<Tested> as Guest>::start(1, Vec::new(), described.wanted).unwrap();
        for _ in 0..2 {
            let answer = <Adapter<Tested> as Guest>::step(seen("align"));
            let [types::Command::Gripper(grip), types::Command::Done] = &answer[..] else {
                panic!("{answer:?}")
            };
            assert_eq!((grip.width_m, grip.force_n), (0.25, 18.5));
        }
        let other = <Adapter<Tested> as Guest>::step(seen("juggle"));
        assert!(matches!(&other[..], [types::Command::Hold]), "{other:?}");
    }
}
