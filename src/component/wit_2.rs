//! The contract `holdpoint:skill@2.0.0` on the host's side, and its messages from and to the body's own.

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
    wasmtime::component::bindgen!({ path: "../sdk/wit/2", world: "component" });
}

use holdpoint_body::{
    Command, Estimate, FailureSignal, GuardVerdict, JointVec, MAX_JOINTS, NamedReading, Observation, Pose,
    TaskKind, Twist,
};
use holdpoint_skill::Hook;

use crate::chunk::{CHUNK_COMMANDS_MAX, CommandChunk};
use crate::contract::ComponentDescription;
use crate::sensors::{ImageSpec, PixelFormat, SensorSet, VectorSpec};
use crate::wit::{self, number, shared_messages};

pub use bindings::exports::holdpoint::skill::skill;
pub use bindings::holdpoint::skill::types;

shared_messages!();

/// `None` if there are more values than an arm can have joints.
fn joint_vec(values: &[f64]) -> Option<JointVec> {
    (values.len() <= MAX_JOINTS).then(|| values.iter().copied().map(number).collect())
}

/// Parameters in the form of this contract.
pub fn parameters(all: &[wit::types::Parameter]) -> Vec<types::Parameter> {
    let value = |value: &wit::types::Value| match value {
        wit::types::Value::Number(number) => types::Value::Number(*number),
        wit::types::Value::Flag(flag) => types::Value::Flag(*flag),
        wit::types::Value::Text(text) => types::Value::Text(text.clone()),
    };
    all.iter()
        .map(|parameter| types::Parameter { name: parameter.name.clone(), value: value(&parameter.value) })
        .collect()
}

/// What a component says of itself.
pub fn description(said: types::Description) -> ComponentDescription {
    let image = |spec: types::ImageSpec| ImageSpec {
        name: spec.name,
        width_px: spec.width_px,
        height_px: spec.height_px,
        format: match spec.format {
            types::PixelFormat::Gray8 => PixelFormat::Gray8,
            types::PixelFormat::Rgb8 => PixelFormat::Rgb8,
            types::PixelFormat::Depth16 => PixelFormat::Depth16,
        },
    };
    let vector = |spec: types::VectorSpec| VectorSpec { name: spec.name, length: spec.length };
    ComponentDescription {
        task: TaskKind::named(&said.task).ok_or(said.task),
        interface: said.interface,
        wanted: SensorSet {
            images: said.wanted.images.into_iter().map(image).collect(),
            vectors: said.wanted.vectors.into_iter().map(vector).collect(),
        },
    }
}

/// Granted sensors, as a component receives them.
pub fn sensors(granted: &SensorSet) -> types::Sensors {
    let image = |spec: &ImageSpec| types::ImageSpec {
        name: spec.name.clone(),
        width_px: spec.width_px,
        height_px: spec.height_px,
        format: match spec.format {
            PixelFormat::Gray8 => types::PixelFormat::Gray8,
            PixelFormat::Rgb8 => types::PixelFormat::Rgb8,
            PixelFormat::Depth16 => types::PixelFormat::Depth16,
        },
    };
    let vector = |spec: &VectorSpec| types::VectorSpec { name: spec.name.clone(), length: spec.length };
    types::Sensors {
        images: granted.images.iter().map(image).collect(),
        vectors: granted.vectors.iter().map(vector).collect(),
    }
}

/// What a component is given in a step: of the named sensors, those that it was granted, in the form that it asked for.
pub fn observation(seen: &Observation, granted: &SensorSet) -> types::Observation {
    let declared = seen.goal.declaration();
    let objects = seen.objects.iter().map(|object| types::SeenObject {
        name: object.name.as_str().to_owned(),
        estimate: estimate(&object.estimate),
    });
    let vectors = granted.vectors.iter().filter_map(|vector| {
        let is_it = |read: &&NamedReading| {
            read.name.as_str() == vector.name && u32::try_from(read.values.len()) == Ok(vector.length)
        };
        let read = seen.sensors.iter().find(is_it)?;
        Some(types::NamedVector {
            name: vector.name.clone(),
            age_ticks: read.age_ticks,
            values: read.values.to_vec(),
        })
    });
    types::Observation {
        tick: seen.tick,
        q: seen.q.to_vec(),
        dq: seen.dq.to_vec(),
        tau: seen.tau.to_vec(),
        tool: pose(&seen.tool),
        tool_twist: twist(&seen.tool_twist),
        gripper_width_m: seen.gripper_width_m,
        gripper_force_n: seen.gripper_force_n,
        wrist_force_n: seen.wrist_force_n,
        objects: objects.collect(),
        images: Vec::new(),
        vectors: vectors.collect(),
        tool_available: seen.tool_available,
        goal: types::Goal {
            task: seen.goal.name().to_owned(),
            object: declared.object.to_owned(),
            target: declared.target.to_owned(),
        },
        guard: verdict(seen.guard),
    }
}

/// The commands of an answer; `None` if there is none or too many, or if one of them is no command.
pub fn chunk(answer: &[types::Command]) -> Option<CommandChunk> {
    let (first, rest) = answer.split_first().filter(|_| answer.len() <= CHUNK_COMMANDS_MAX)?;
    Some(CommandChunk { first: command(first)?, rest: rest.iter().map(command).collect::<Option<_>>()? })
}
