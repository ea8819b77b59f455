//! A controller with its parameters, and what it says of itself: the same as the engine says of it when it is compiled in.

use holdpoint_sdk_1::{Description, Skill, TaskKind};
use holdpoint_skill::motion::{AbortStyle, RollbackStyle};
use holdpoint_skill::phases::PhaseRunner;
use holdpoint_skill::{align, grasp, place};
use serde::Deserialize;
use serde_json::{Value, json};

/// Which controller it is shows in the names of the parameters.
#[derive(Deserialize)]
#[serde(untagged, expecting = "these are the parameters of none of grasp, align and place")]
pub enum Params {
    Grasp(grasp::GraspParams),
    Align(align::AlignParams),
    Place(place::PlaceParams),
}

impl Params {
    pub fn start(self) -> Box<dyn Skill> {
        match self {
            Self::Grasp(params) => Box::new(PhaseRunner::new(grasp::Grasp::new(params))),
            Self::Align(params) => Box::new(PhaseRunner::new(align::Align::new(params))),
            Self::Place(params) => Box::new(PhaseRunner::new(place::Place::new(params))),
        }
    }

    pub fn description(&self) -> Description {
        let (task, signals, abort, rollback) = match self {
            Self::Grasp(p) => (TaskKind::Grasp, grasp::signals(p), p.abort, p.rollback),
            Self::Align(p) => (TaskKind::Align, align::signals(p), p.abort, p.rollback),
            Self::Place(p) => (TaskKind::Place, place::signals(p), p.abort, p.rollback),
        };
        let mut needs = vec![need("arm", "tool-pose"), need("arm", "stop")];
        if task != TaskKind::Align || abort == AbortStyle::Release {
            needs.push(need("gripper", "gripper"));
        }
        let sensors: &[&str] = match task {
            TaskKind::Align => &["camera", "joints"],
            _ => &["camera", "joints", "wrist-force"],
        };
        let pose = json!({"type": "pose", "unit": "m", "frame": "world"});
        let mut inputs = json!({
            "object": &pose,
            "gripper-width": {"type": "real", "unit": "m", "range": [0.0, 0.1]},
        });
        if task != TaskKind::Grasp {
            inputs["target"] = pose;
        }
        let mut hooks = Vec::new();
        if abort != AbortStyle::None {
            hooks.push("safe-abort");
        }
        if rollback != RollbackStyle::None {
            hooks.push("rollback");
        }
        let interface = json!({
            "controller": task.name(),
            "semantics_version": "1.1.0",
            "entry_points": [task.name()],
            "inputs": inputs,
            "outputs": {
                "outcome": {"type": "enum", "values": ["done", "failed"]},
                "duration": {"type": "real", "unit": "s", "range": [0.0, 60.0]},
            },
            "parameters": {},
            "hooks": hooks,
            "failure_signals": signals,
            "needs": needs,
            "sensors": sensors,
            "tools": ["parallel-gripper"],
        });
        Description { task, interface: interface.to_string() }
    }
}

fn need(channel: &str, command: &str) -> Value {
    json!({"channel": channel, "command": command})
}
