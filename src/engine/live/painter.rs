//! Draws video frames of the running live cell: in a sequence, and on the ladder between two.
//!
//! Hands the frames over without waiting and decides nothing. The frames are the same whether a sequence runs in one
//! slice or at the pace of a clock; but at the pace of a clock a twin is drawn as far as it has come by then.

use std::sync::{Arc, Mutex};

use holdpoint_body::{RATE_HZ, TaskKind, Telemetry};
use holdpoint_cell::RobotCell;

use super::listener::Listener;
use super::shadow::Shadow;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_protocol::clock::Clock;
use holdpoint_protocol::sink::VideoFrameSink;
use holdpoint_protocol::video_frame::{ArmView, EnvelopeView, Twin, VideoFrame};
use holdpoint_runtime::task::{Supervision, Tick};
use holdpoint_trials::cell_frame::{self, narrow};

/// Ticks between two video frames: 30 a second of simulated time.
const FRAME_EVERY_TICKS: u64 = (RATE_HZ / 30) as u64;

/// The most video frames kept of a twin: a minute.
const TWIN_FRAMES_MAX: usize = 1_800;

/// Who works which task of a sequence, and the envelope that holds them.
pub(crate) type SequenceVersions = Vec<(TaskKind, CapabilityId, EnvelopeView)>;

/// The twin at each frame, in the order of its ticks; its thread adds them.
type TwinBodies = Arc<Mutex<Vec<ArmView>>>;

pub(crate) struct Painter {
    sink: VideoFrameSink,
    clock: Clock,
    sequence: u64,
    workers: SequenceVersions,
    twin: TwinBodies,
    last: Option<VideoFrame>,
}

impl Painter {
    pub(crate) fn new(sink: VideoFrameSink, clock: Clock, sequence: u64, workers: SequenceVersions) -> Self {
        Self { sink, clock, sequence, workers, twin: TwinBodies::default(), last: None }
    }

    pub(crate) fn at_work(&self, task: TaskKind) -> Option<CapabilityId> {
        self.workers.iter().find(|(known, ..)| *known == task).map(|(_, id, _)| id.clone())
    }

    fn envelope(&self, task: TaskKind) -> Option<EnvelopeView> {
        self.workers.iter().find(|(known, ..)| *known == task).map(|(.., envelope)| *envelope)
    }

    /// A task begins. A twin runs ahead, so that both can be drawn side by side.
    pub(crate) fn before_task(
        &mut self,
        world: &dyn RobotCell,
        task: TaskKind,
        seed: u64,
        shadow: Option<&mut Shadow>,
    ) {
        self.twin = TwinBodies::default();
        let Some(shadow) = shadow else { return };
        shadow.before_task(world, task, seed);
        shadow.run_twin_ahead(task, seed, &mut |world, passed| keep_body(&self.twin, world, passed));
    }

    /// As [`Self::before_task`], with the twin on a thread of its own: it is drawn as far as it has come.
    pub(crate) fn before_task_beside(
        &mut self,
        world: &dyn RobotCell,
        task: TaskKind,
        seed: u64,
        shadow: Option<&mut Shadow>,
    ) {
        self.twin = TwinBodies::default();
        let Some(shadow) = shadow else { return };
        let bodies = Arc::clone(&self.twin);
        shadow.run_twin_beside(Box::new(move |world, passed| keep_body(&bodies, world, passed)));
        shadow.before_task(world, task, seed);
    }

    /// A tick passed: draws if a frame is due, and in any case if `stopped`.
    pub(crate) fn tick(
        &mut self,
        world: &dyn RobotCell,
        task: TaskKind,
        passed: &Tick<'_>,
        shadow: Option<&Shadow>,
        stopped: bool,
    ) {
        if !stopped && !is_due(passed.tick) {
            return;
        }
        let twin = shadow.and_then(|shadow| {
            let index = usize::try_from(passed.tick / FRAME_EVERY_TICKS).unwrap_or(usize::MAX);
            let bodies = self.twin.lock().ok()?;
            let body = bodies.get(index).or_else(|| bodies.last())?.clone();
            Some(Twin { version: shadow.id(), body })
        });
        let frame = VideoFrame {
            task: Some(task),
            version: self.at_work(task),
            envelope: self.envelope(task),
            stopped: stopped || world.stop_declared().is_some(),
            twin,
            ..frame_of(world, passed.seen, self.sequence, cell_frame::at_ms(&self.clock, world))
        };
        self.last = Some(frame.clone());
        (self.sink)(frame);
    }

    /// The sequence is over: the arm at rest, if there was anything to draw.
    pub(crate) fn rest(&mut self, world: &dyn RobotCell, stopped: bool) {
        let Some(last) = self.last.take() else { return };
        (self.sink)(VideoFrame {
            at_ms: cell_frame::at_ms(&self.clock, world),
            at_secs: world.secs(),
            task: None,
            version: None,
            body: cell_frame::body(world, &world.telemetry()),
            speed_m_s: 0.0,
            envelope: None,
            contacts: cell_frame::contacts(world),
            stopped,
            twin: None,
            ..last
        });
    }
}

/// The world in a frame of no task, without an envelope and a twin.
fn frame_of(world: &dyn RobotCell, seen: &Telemetry, sequence: u64, at_ms: u64) -> VideoFrame {
    let contacts = &seen.contacts;
    VideoFrame {
        sequence,
        at_ms,
        at_secs: world.secs(),
        task: None,
        version: None,
        body: cell_frame::body(world, seen),
        speed_m_s: narrow(seen.tool_speed_m_s),
        force_n: narrow(seen.gripper_force_n),
        contact_n: narrow(seen.contact_force_n),
        envelope: None,
        contacts: cell_frame::contacts(world),
        blocks: cell_frame::blocks(world),
        unexpected_contact: contacts.robot_fixture || contacts.robot_clutter || contacts.robot_robot,
        stopped: false,
        twin: None,
    }
}

/// Keeps the twin's body, if a frame is due.
fn keep_body(bodies: &TwinBodies, world: &dyn RobotCell, passed: &Tick<'_>) {
    if !is_due(passed.tick) {
        return;
    }
    let body = cell_frame::body(world, passed.seen);
    if let Ok(mut bodies) = bodies.lock()
        && bodies.len() < TWIN_FRAMES_MAX
    {
        bodies.push(body);
    }
}

const fn is_due(tick: u64) -> bool {
    tick % FRAME_EVERY_TICKS == 1
}

/// Draws a sequence that runs in one slice, for a candidate in shadow as well.
pub(crate) struct SequencePainter<'a> {
    pub(crate) painter: Painter,
    pub(crate) shadow: Option<&'a mut Shadow>,
}

impl Listener for SequencePainter<'_> {
    fn before_task(&mut self, world: &dyn RobotCell, task: TaskKind, seed: u64) {
        self.painter.before_task(world, task, seed, self.shadow.as_deref_mut());
    }

    fn tick(&mut self, world: &dyn RobotCell, task: TaskKind, passed: &Tick<'_>) -> Supervision {
        let supervision =
            self.shadow.as_mut().map_or(Supervision::Continue, |shadow| shadow.tick(world, task, passed));
        self.painter.tick(world, task, passed, self.shadow.as_deref(), false);
        supervision
    }
}

/// Draws the arm while the ladder moves it: no task runs, and time continues from the present clock.
pub(crate) struct LadderPainter {
    sink: VideoFrameSink,
    clock: Clock,
    from_ms: u64,
    sequence: u64,
    version: CapabilityId,
    envelope: EnvelopeView,
    ticks: u64,
}

impl LadderPainter {
    pub(crate) fn new(
        sink: VideoFrameSink,
        clock: Clock,
        sequence: u64,
        version: CapabilityId,
        envelope: EnvelopeView,
    ) -> Self {
        let from_ms = clock.now_ms();
        Self { sink, clock, from_ms, sequence, version, envelope, ticks: 0 }
    }

    pub(crate) fn tick(&mut self, world: &dyn RobotCell) {
        self.ticks += 1;
        if !is_due(self.ticks) {
            return;
        }
        let passed_ms = self.ticks.saturating_mul(1000) / u64::from(RATE_HZ);
        let at_ms = if self.clock.is_scripted() { self.from_ms + passed_ms } else { self.clock.now_ms() };
        (self.sink)(VideoFrame {
            version: Some(self.version.clone()),
            envelope: Some(self.envelope),
            stopped: true,
            ..frame_of(world, &world.telemetry(), self.sequence, at_ms)
        });
    }
}
