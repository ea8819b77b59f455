//! The messages of the cell protocol: the calls of the ports, their answers, and what is refused.
//!
//! Every value is in SI units and in the world frame, as in the ports. A message is one MessagePack value of at most
//! [`MESSAGE_BYTES_MAX`]; larger things are announced by a [`Block`] and follow as raw bytes. Owns no stream.

use holdpoint_body::disturbance::Drift;
use holdpoint_body::{
    Command, GuardVerdict, Interrupt, JointVec, ObjectVec, Observation, ReadingVec, TaskKind, Telemetry,
};
use holdpoint_cell::truth::{ContactForces, ContactPoint, JointState, TrueState};
use holdpoint_cell::{CellSpec, Distribution, EpisodeSetup, FixtureBox, InjectedFault, StateImage};
use holdpoint_text::hex::hex;
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use crate::refusal::CellRefusal;

/// Raised when a message changes; both sides must have the same.
pub const PROTOCOL: u32 = 2;

/// The largest message, bytes without its length.
pub const MESSAGE_BYTES_MAX: usize = 1 << 20;

/// The largest block of raw bytes: a state, a description, the frames of an episode.
pub const BLOCK_BYTES_MAX: usize = StateImage::MAX_BYTES;

/// The most forks that a session keeps.
pub const FORKS_MAX: usize = 1024;

/// The most handles that one request releases.
pub const RELEASED_MAX: usize = 256;

/// The longest name that a client gives itself, bytes.
pub const CLIENT_BYTES_MAX: usize = 64;

/// The shortest and the longest time of a watchdog, ms.
pub const WATCHDOG_MS: [u32; 2] = [10, 10_000];

/// What a connection is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// It asks what the cells are, and keeps its session open.
    Control,
    /// It is the cell that works; there is one at a time.
    Live,
    /// It is a cell for trials.
    Trial,
}

impl Role {
    /// The name in texts.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Control => "control",
            Self::Live => "live",
            Self::Trial => "trial",
        }
    }
}

/// The first message of a connection, from the client.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Hello {
    /// [`PROTOCOL`] of the client.
    pub protocol: u32,
    /// What the connection is for.
    pub role: Role,
    /// The session that it joins; absent for a new one.
    pub session: Option<u64>,
    /// The watchdog of a live cell, ms between two commands; absent in lockstep, where no time counts.
    pub watchdog_ms: Option<u32>,
    /// Who connects, for messages.
    pub client: String,
}

/// The bounds of a server.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ServerLimits {
    /// The largest message, bytes.
    pub message_bytes: u64,
    /// The largest block, bytes.
    pub block_bytes: u64,
    /// The most forks of a session.
    pub forks: u64,
}

/// The answer to a [`Hello`] that is taken.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Welcome {
    /// [`PROTOCOL`] of the server.
    pub protocol: u32,
    /// The session: its forks end with its last connection.
    pub session: u64,
    /// SHA-256 of the [`FactoryDescription`] as it is sent, in hexadecimal digits.
    pub description: String,
    /// Digest of what computes the cells.
    pub build: String,
    /// Ticks per second.
    pub rate_hz: u32,
    /// The watchdog as it is set.
    pub watchdog_ms: Option<u32>,
    /// The bounds of the server.
    pub bounds: ServerLimits,
}

/// The answer to a [`Hello`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Greeting {
    /// The connection is open.
    Welcome(Welcome),
    /// It is closed now.
    Refused(CellRefusal),
}

/// What the cells of a server are; the block that answers [`Call::Describe`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FactoryDescription {
    /// What a cell is and can do.
    pub spec: CellSpec,
    /// Digest of what computes the cells.
    pub build: String,
    /// The distributions that trials are drawn from: without disturbance, the sandbox's, and the live cell's.
    pub distributions: [Distribution; 3],
}

/// A request. The answer has the same number.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CellRequest {
    /// Counts the requests of a connection from 1, without gaps.
    pub sequence: u64,
    /// What the guard did with the command before, where it differs from what was last told.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub guard: Option<GuardVerdict>,
    /// Handles of forks that the client does not need any more; at most [`RELEASED_MAX`].
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub release: Vec<u64>,
    /// What is asked.
    pub call: Call,
}

/// What is asked of a cell. Where no answer is named, it is [`CellReply::Seen`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Call {
    /// The description; answered by [`CellReply::Block`].
    Describe,
    /// A distribution after a drift; answered by [`CellReply::Distribution`].
    Drift {
        /// The distribution.
        of: Box<Distribution>,
        /// What changes, and how much.
        drift: Drift,
    },
    /// The present state, with an observation.
    Observe {
        /// What the guard did with the command before.
        guard: GuardVerdict,
    },
    /// One tick: sends a command, lets a tick pass, and tells what is then seen.
    Step {
        /// The command.
        command: Command,
    },
    /// From outside the skill: stop, or take commands again.
    Interrupt {
        /// Which of the two.
        interrupt: Interrupt,
    },
    /// Switches the goal and restarts the task's tick.
    BeginTask {
        /// The goal.
        task: TaskKind,
    },
    /// The task is over.
    EndTask,
    /// What stands in the cell and what touches; answered by [`CellReply::Scenery`].
    Scenery,
    /// What the sensors tell, for a trial cell to be set to; answered by [`CellReply::Observed`].
    Observed,
    /// Keeps the present state under a handle; answered by [`CellReply::Fork`].
    Fork,
    /// The present state as bytes; answered by [`CellReply::Block`].
    Export,
    /// Breaks something, from the next tick on.
    Inject {
        /// What breaks.
        fault: InjectedFault,
    },
    /// Of a live cell: waits until work is presented.
    AwaitWork {
        /// What a simulated cell draws the work from.
        conditions: Box<Distribution>,
        /// Seed of the draw.
        seed: u64,
    },
    /// Of a trial cell: starts an episode.
    Reset {
        /// The episode.
        setup: Box<EpisodeSetup>,
    },
    /// Of a trial cell: continues from a fork of the session.
    GoOnFrom {
        /// Its handle.
        fork: u64,
    },
    /// Of a trial cell: continues from exported bytes, which follow as a block.
    Import {
        /// The bytes.
        image: Block,
    },
    /// Of a trial cell: goes to the state that another cell observed.
    SetTo {
        /// What was observed.
        observed: Box<Observation>,
    },
    /// Of a trial cell: from now on the frames of every episode are kept.
    Film,
    /// Of a trial cell: the frames of the episode so far; answered by [`CellReply::Block`], a list of `EpisodeFrame`.
    TakeFilm,
}

impl Call {
    /// The name in texts.
    #[must_use]
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Describe => "describe",
            Self::Drift { .. } => "drift",
            Self::Observe { .. } => "observe",
            Self::Step { .. } => "step",
            Self::Interrupt { .. } => "interrupt",
            Self::BeginTask { .. } => "begin_task",
            Self::EndTask => "end_task",
            Self::Scenery => "scenery",
            Self::Observed => "observed",
            Self::Fork => "fork",
            Self::Export => "export",
            Self::Inject { .. } => "inject",
            Self::AwaitWork { .. } => "await_work",
            Self::Reset { .. } => "reset",
            Self::GoOnFrom { .. } => "go_on_from",
            Self::Import { .. } => "import",
            Self::SetTo { .. } => "set_to",
            Self::Film => "film",
            Self::TakeFilm => "take_film",
        }
    }
}

/// Announces raw bytes, which follow in frames of at most [`MESSAGE_BYTES_MAX`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Block {
    /// How many; at most [`BLOCK_BYTES_MAX`].
    pub bytes: u64,
    /// Their SHA-256, in hexadecimal digits.
    pub sha256: String,
}

impl Block {
    /// Announces these bytes.
    #[must_use]
    pub fn of(bytes: &[u8]) -> Self {
        Self { bytes: bytes.len() as u64, sha256: sha256_hex(bytes) }
    }
}

/// SHA-256 in hexadecimal digits.
#[must_use]
pub fn sha256_hex(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}

/// True state.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// Joint positions and speeds.
    pub joints: JointState,
    /// Forces between robot, object and surroundings.
    pub forces: ContactForces,
    /// Where the object is, world frame, m.
    pub object: Isometry3<f64>,
    /// Its speed, m/s.
    pub object_speed_m_s: f64,
}

impl From<TrueState<'_>> for Truth {
    fn from(state: TrueState<'_>) -> Self {
        Self {
            joints: state.joints.clone(),
            forces: *state.forces,
            object: state.object,
            object_speed_m_s: state.object_speed_m_s,
        }
    }
}

impl Truth {
    /// The same as the ports give it.
    #[must_use]
    pub const fn state(&self) -> TrueState<'_> {
        TrueState {
            joints: &self.joints,
            forces: &self.forces,
            object: self.object,
            object_speed_m_s: self.object_speed_m_s,
        }
    }
}

/// The present state of a cell.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CellState {
    /// Ticks since the work was presented.
    pub tick: u64,
    /// What a skill may see; absent until [`Call::Observe`] after a start.
    pub observation: Option<Observation>,
    /// What watcher and monitor may see.
    pub telemetry: Telemetry,
    /// The verdict of the inspection: whether the work is done now.
    pub done: bool,
    /// Tick of a declared failure, or of a stop, that still stands.
    pub stop_declared: Option<u64>,
    /// Where a screen draws the object, world frame, m.
    pub object: Isometry3<f64>,
    /// True state; absent where the cell knows no more than its sensors tell.
    pub truth: Option<Truth>,
}

impl CellState {
    /// What is not usable: a number that is not finite, or a list that is not one value per joint.
    ///
    /// # Errors
    /// The name of the first such field.
    pub fn check(&self, joints: usize) -> Result<(), String> {
        let t = &self.telemetry;
        let pose = |pose: &holdpoint_body::Pose| pose.is_valid();
        let mut facts = vec![
            ("telemetry.q", is_list(&t.q, joints)),
            ("telemetry.dq", is_list(&t.dq, joints)),
            ("telemetry.tracking_error_rad", t.tracking_error_rad.is_finite()),
            ("telemetry.tool", pose(&t.tool)),
            ("telemetry.tool_speed_m_s", t.tool_speed_m_s.is_finite()),
            ("telemetry.gripper_width_m", t.gripper_width_m.is_finite()),
            ("telemetry.gripper_force_n", t.gripper_force_n.is_finite()),
            ("telemetry.contact_force_n", t.contact_force_n.is_finite()),
            ("telemetry.slip_m", t.slip_m.is_none_or(f64::is_finite)),
            ("stop_declared", self.stop_declared.is_none_or(|tick| tick <= self.tick)),
            ("object", self.object.to_homogeneous().iter().all(|value| value.is_finite())),
        ];
        if let Some(o) = &self.observation {
            facts.extend([
                ("observation.q", is_list(&o.q, joints)),
                ("observation.dq", is_list(&o.dq, joints)),
                ("observation.tau", is_list(&o.tau, joints)),
                ("observation.tool", pose(&o.tool)),
                (
                    "observation.tool_twist",
                    o.tool_twist.linear.iter().chain(&o.tool_twist.angular).all(|value| value.is_finite()),
                ),
                ("observation.gripper_width_m", o.gripper_width_m.is_finite()),
                ("observation.gripper_force_n", o.gripper_force_n.is_finite()),
                ("observation.wrist_force_n", o.wrist_force_n.is_finite()),
                ("observation.objects", are_objects(&o.objects)),
                ("observation.sensors", are_readings(&o.sensors)),
            ]);
        }
        if let Some(truth) = &self.truth {
            facts.extend([
                ("truth.joints.q", is_list(&truth.joints.q, joints)),
                ("truth.object_speed_m_s", truth.object_speed_m_s.is_finite()),
            ]);
        }
        facts.iter().find(|(_, holds)| !holds).map_or(Ok(()), |(name, _)| Err((*name).to_owned()))
    }

    /// The name of the first object or sensor in the observation that the description of the cell does not have, or has
    /// with other numbers.
    #[must_use]
    pub fn undeclared(&self, spec: &CellSpec) -> Option<&str> {
        let seen = self.observation.as_ref()?;
        let object = seen.objects.iter().find(|one| spec.object(&one.name).is_none());
        let sensor = || seen.sensors.iter().find(|one| !spec.offers(&one.name, one.values.len()));
        object.map(|one| one.name.as_str()).or_else(|| sensor().map(|one| one.name.as_str()))
    }
}

fn is_list(values: &JointVec, joints: usize) -> bool {
    values.len() == joints && values.iter().all(|value| value.is_finite())
}

/// Whether each sensor has a name of its own and numbers.
fn are_readings(sensors: &ReadingVec) -> bool {
    sensors.iter().enumerate().all(|(place, read)| {
        let is_named = !read.name.is_empty() && sensors.iter().take(place).all(|one| one.name != read.name);
        is_named && read.values.iter().all(|value| value.is_finite())
    })
}

/// Whether each object has a name of its own and a pose.
fn are_objects(objects: &ObjectVec) -> bool {
    objects.iter().enumerate().all(|(place, seen)| {
        let is_named = !seen.name.is_empty() && objects.iter().take(place).all(|one| one.name != seen.name);
        is_named && seen.estimate.pose.is_valid()
    })
}

/// An answer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Answer {
    /// The number of the request.
    pub sequence: u64,
    /// What came of it.
    pub reply: CellReply,
}

/// What came of a request.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CellReply {
    /// The state after the call.
    Seen(Box<CellState>),
    /// A state is kept.
    Fork {
        /// Its handle.
        fork: u64,
        /// Ticks since the work was presented.
        tick: u64,
    },
    /// Bytes follow.
    Block(Block),
    /// What stands in the cell and what touches.
    Scenery {
        /// What stands in the cell, beside table and robot.
        fixtures: Vec<FixtureBox>,
        /// Where robot and object touch what they touch, the strongest first.
        contacts: Vec<ContactPoint>,
    },
    /// A distribution.
    Distribution(Box<Distribution>),
    /// What the sensors tell; absent for a cell that does not say.
    Observed(Option<Box<Observation>>),
    /// The call had no effect.
    Refused(CellRefusal),
}

#[cfg(test)]
mod tests;
