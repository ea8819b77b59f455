//! Draws pictures of the live world while it is worked: in a sequence, and on the ladder between two.
//!
//! Looks and hands pictures over; decides nothing and is never waited for. What is drawn is the same whether a
//! sequence is worked in one slice or at the pace of a clock.

use holdpoint_body::{RATE_HZ, TaskKind};
use holdpoint_sim::world::World;

use super::listener::Listener;
use super::portrait::{self, narrow};
use super::shadow::Shadow;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_protocol::clock::Clock;
use holdpoint_protocol::picture::{ArmPicture, EnvelopePicture, Picture, Twin};
use holdpoint_protocol::sink::Pictures;
use holdpoint_runtime::task::{Supervision, Tick};

/// Ticks between two pictures: 30 a second of simulated time.
const PICTURE_EVERY_TICKS: u64 = (RATE_HZ / 30) as u64;

/// The most pictures kept of a twin: a minute.
const TWIN_PICTURES_MAX: usize = 1_800;

/// Who works which task of a sequence, and the envelope that holds them.
pub(crate) type SequenceParties = Vec<(TaskKind, CapabilityId, EnvelopePicture)>;

pub(crate) struct Painter {
    pictures: Pictures,
    clock: Clock,
    sequence: u64,
    workers: SequenceParties,
    twin: Vec<ArmPicture>,
    last: Option<Picture>,
}

impl Painter {
    pub(crate) const fn new(
        pictures: Pictures,
        clock: Clock,
        sequence: u64,
        workers: SequenceParties,
    ) -> Self {
        Self { pictures, clock, sequence, workers, twin: Vec::new(), last: None }
    }

    pub(crate) fn at_work(&self, task: TaskKind) -> Option<CapabilityId> {
        self.workers.iter().find(|(known, ..)| *known == task).map(|(_, id, _)| id.clone())
    }

    fn envelope(&self, task: TaskKind) -> Option<EnvelopePicture> {
        self.workers.iter().find(|(known, ..)| *known == task).map(|(.., envelope)| *envelope)
    }

    /// A task begins. A twin runs ahead, so that both can be drawn side by side.
    pub(crate) fn before_task(
        &mut self,
        world: &World,
        task: TaskKind,
        seed: u64,
        shadow: Option<&mut Shadow>,
    ) {
        self.twin.clear();
        let Some(shadow) = shadow else { return };
        shadow.before_task(world, task, seed);
        let bodies = &mut self.twin;
        shadow.run_twin_ahead(task, seed, &mut |world, passed| {
            if is_due(passed.tick) && bodies.len() < TWIN_PICTURES_MAX {
                bodies.push(portrait::body(world, passed.seen));
            }
        });
    }

    /// A tick passed: draws if a picture is due, and in any case if `stopped`.
    pub(crate) fn tick(
        &mut self,
        world: &World,
        task: TaskKind,
        passed: &Tick<'_>,
        shadow: Option<&Shadow>,
        stopped: bool,
    ) {
        if !stopped && !is_due(passed.tick) {
            return;
        }
        let seen = passed.seen;
        let contacts = &seen.contacts;
        let twin = shadow.and_then(|shadow| {
            let index = usize::try_from(passed.tick / PICTURE_EVERY_TICKS).unwrap_or(usize::MAX);
            let body = self.twin.get(index).or_else(|| self.twin.last())?.clone();
            Some(Twin { version: shadow.id(), body })
        });
        let picture = Picture {
            sequence: self.sequence,
            at_ms: portrait::at_ms(&self.clock, world),
            at_secs: world.sim_secs(),
            task: Some(task),
            version: self.at_work(task),
            body: portrait::body(world, seen),
            speed_m_s: narrow(seen.tool_speed_m_s),
            force_n: narrow(seen.gripper_force_n),
            contact_n: narrow(seen.contact_force_n),
            envelope: self.envelope(task),
            contacts: portrait::contacts(world),
            blocks: portrait::blocks(world),
            unexpected_contact: contacts.robot_fixture || contacts.robot_clutter || contacts.robot_robot,
            stopped: stopped || world.stop_declared().is_some(),
            twin,
        };
        self.last = Some(picture.clone());
        (self.pictures)(picture);
    }

    /// The sequence is over: the arm at rest, if there was anything to draw.
    pub(crate) fn rest(&mut self, world: &World, stopped: bool) {
        let Some(last) = self.last.take() else { return };
        (self.pictures)(Picture {
            at_ms: portrait::at_ms(&self.clock, world),
            at_secs: world.sim_secs(),
            task: None,
            version: None,
            body: portrait::body(world, &world.telemetry()),
            speed_m_s: 0.0,
            envelope: None,
            contacts: portrait::contacts(world),
            stopped,
            twin: None,
            ..last
        });
    }
}

const fn is_due(tick: u64) -> bool {
    tick % PICTURE_EVERY_TICKS == 1
}

/// Draws a sequence that is worked in one slice, for a candidate in shadow as well.
pub(crate) struct Drawn<'a> {
    pub(crate) painter: Painter,
    pub(crate) shadow: Option<&'a mut Shadow>,
}

impl Listener for Drawn<'_> {
    fn before_task(&mut self, world: &World, task: TaskKind, seed: u64) {
        self.painter.before_task(world, task, seed, self.shadow.as_deref_mut());
    }

    fn tick(&mut self, world: &World, task: TaskKind, passed: &Tick<'_>) -> Supervision {
        let asked =
            self.shadow.as_mut().map_or(Supervision::Continue, |shadow| shadow.tick(world, task, passed));
        self.painter.tick(world, task, passed, self.shadow.as_deref(), false);
        asked
    }
}

/// Draws the arm while the ladder moves it: nobody works a task then, and time goes on from where the clock stands.
pub(crate) struct Sketch {
    pictures: Pictures,
    clock: Clock,
    from_ms: u64,
    sequence: u64,
    version: CapabilityId,
    envelope: EnvelopePicture,
    ticks: u64,
}

impl Sketch {
    pub(crate) fn new(
        pictures: Pictures,
        clock: Clock,
        sequence: u64,
        version: CapabilityId,
        envelope: EnvelopePicture,
    ) -> Self {
        let from_ms = clock.now_ms();
        Self { pictures, clock, from_ms, sequence, version, envelope, ticks: 0 }
    }

    pub(crate) fn tick(&mut self, world: &World) {
        self.ticks += 1;
        if !is_due(self.ticks) {
            return;
        }
        let passed_ms = self.ticks.saturating_mul(1000) / u64::from(RATE_HZ);
        let at_ms = if self.clock.is_scripted() { self.from_ms + passed_ms } else { self.clock.now_ms() };
        let seen = world.telemetry();
        let contacts = &seen.contacts;
        (self.pictures)(Picture {
            sequence: self.sequence,
            at_ms,
            at_secs: world.sim_secs(),
            task: None,
            version: Some(self.version.clone()),
            body: portrait::body(world, &seen),
            speed_m_s: narrow(seen.tool_speed_m_s),
            force_n: narrow(seen.gripper_force_n),
            contact_n: narrow(seen.contact_force_n),
            envelope: Some(self.envelope),
            contacts: portrait::contacts(world),
            blocks: portrait::blocks(world),
            unexpected_contact: contacts.robot_fixture || contacts.robot_clutter || contacts.robot_robot,
            stopped: true,
            twin: None,
        });
    }
}
