//! The ladder, rung by rung: what a test can break is broken, and each class of failure is reached.

mod no_comparison;
mod rollback_hook;

use std::path::Path;

use holdpoint_body::{Command as Motion, RATE_HZ, TaskKind};
use holdpoint_cell::InjectedFault;
use holdpoint_governance::alarms::Priority;
use holdpoint_governance::condition::Condition;
use holdpoint_governance::monitor::MonitorOutcome;
use holdpoint_governance::rollback::PostStatus;
use tempfile::TempDir;

use super::*;
use crate::decide::pipeline::{Pipeline, PipelineSettings, SliceOutcome};
use crate::live::fake_cell::StubFactory;
use crate::live::monitors::ActivationMonitor;
use crate::live::station::LiveFault;
use crate::quick_folder::quick_folder;
use crate::test_pipeline::{SEEDS, pipeline_of, settings, settings_in};
use crate::tests::assert_accepted;
use holdpoint_body::Body;
use holdpoint_governance::evidence::EpisodeValues;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_governance::site_profile::{ChosenProfile, ProfileTexts};
use holdpoint_governance::submission::Package;
use holdpoint_protocol::command::{Command, Operation};
use holdpoint_protocol::event::EventKind;
use holdpoint_record::wall_clock::WallClock;
use holdpoint_runtime::capability;
use holdpoint_runtime::recovery::{RecoveryReport, StoppedBy};
use holdpoint_store::{Change, EvidenceKind};
use holdpoint_trials::cell::Cell;
use holdpoint_trials::seeds::EpisodeSeeds;

/// What stands for a twin's task: no faster and no farther from its limits than live tasks of the candidates are.
pub(crate) const GOOD: EpisodeValues =
    EpisodeValues { near_violation: true, time_s: 8.0, ..EpisodeValues::CLEAN };

pub(crate) struct RollbackBench {
    pub(crate) folder: TempDir,
    pub(crate) pipeline: Pipeline,
}

impl RollbackBench {
    pub(crate) fn new() -> Self {
        Self::under(Profile::builtin(ProfileName::Sim).unwrap())
    }

    /// With this candidate active.
    pub(crate) fn with_active(name: &str) -> (Self, CapabilityId) {
        let mut bench = Self::new();
        let id = bench.activate(name);
        (bench, id)
    }

    pub(crate) fn under(profile: Profile) -> Self {
        Self::opened(quick_folder(), settings(profile, SEEDS))
    }

    /// In a scripted cell: its arm never moves, so a sequence ends with a grasp that failed.
    pub(crate) fn resting(profile: ProfileName) -> Self {
        Self::resting_under(Profile::builtin(profile).unwrap())
    }

    pub(crate) fn resting_under(profile: Profile) -> Self {
        Self::in_cell(StubFactory::exporting().into_cell(), profile)
    }

    /// As [`RollbackBench::with_active`], in a scripted cell.
    pub(crate) fn resting_with_active(name: &str) -> (Self, CapabilityId) {
        let mut bench = Self::resting(ProfileName::Sim);
        let id = bench.activate(name);
        (bench, id)
    }

    pub(crate) fn in_cell(cell: Cell, profile: Profile) -> Self {
        Self::opened(quick_folder(), settings_in(cell, profile, SEEDS))
    }

    /// Under a site's own profile, in a scripted cell.
    pub(crate) fn under_own(texts: ProfileTexts) -> Self {
        let (profile, table) = ChosenProfile::of(texts.clone()).unwrap().rules().unwrap();
        let shipped = settings_in(StubFactory::exporting().into_cell(), profile, SEEDS);
        Self::opened(quick_folder(), PipelineSettings { table, own: Some(texts), ..shipped })
    }

    /// The same store and cell under another profile, as an engine that comes up again finds them.
    pub(crate) fn reopened(self, profile: Profile) -> Self {
        let Self { folder, mut pipeline } = self;
        let cell = pipeline.live().context.cell.clone();
        drop(pipeline);
        Self::opened(folder, settings_in(cell, profile, SEEDS))
    }

    pub(crate) fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Under the run seed of a script.
    pub(crate) fn seeded(seed: u64) -> Self {
        let profile = Profile::builtin(ProfileName::Sim).unwrap();
        Self::opened(quick_folder(), settings(profile, EpisodeSeeds::OfRun(seed)))
    }

    fn opened(folder: TempDir, settings: PipelineSettings) -> Self {
        let pipeline = pipeline_of(folder.path(), settings, |_| WallClock::scripted(0, None));
        Self { folder, pipeline }
    }

    /// Makes a candidate active and watched without its evaluation: what is tested comes after that.
    pub(crate) fn activate(&mut self, name: &str) -> CapabilityId {
        let id = self.pass(name, &Stage::ALL);
        self.enter(&id, |version| LifecycleEvent::Activate { version });
        id
    }

    /// As [`RollbackBench::activate`], for a version under conditions.
    pub(crate) fn activate_package(&mut self, package: Package, conditions: &[Condition]) -> CapabilityId {
        let id = self.pass_package(package, &Stage::ALL, conditions);
        self.enter(&id, |version| LifecycleEvent::Activate { version });
        id
    }

    /// Opens its store again, as an engine that comes up does.
    pub(crate) fn restart(self) -> Self {
        self.reopened(Profile::builtin(ProfileName::Sim).unwrap())
    }

    /// Registers a candidate that has passed these stages, without working them.
    pub(crate) fn pass(&mut self, name: &str, stages: &[Stage]) -> CapabilityId {
        let package = capability::read(&Path::new(crate::MANIFESTS).join("candidates").join(name)).unwrap();
        self.pass_package(package, stages, &[])
    }

    fn pass_package(&mut self, package: Package, stages: &[Stage], conditions: &[Condition]) -> CapabilityId {
        let pipeline = &mut self.pipeline;
        let id = Capability::load("test", package.clone()).unwrap().id();
        assert_accepted(&pipeline.command(Command::Register { package, name: "test".to_owned(), by: None }));
        let version = pipeline.record().version_table().version(&id).unwrap().0;
        pipeline.live().evidence_files.edit(&id).conditions = conditions.to_vec();
        for stage in stages.iter().copied() {
            for event in [LifecycleEvent::Start { version, stage }, LifecycleEvent::Pass { version, stage }] {
                let note = TransitionNote::because(Notice::StageBegins);
                pipeline.live().record.transition(&id.family, event, note).unwrap();
            }
        }
        let live = pipeline.live();
        live.evidence_files.edit(&id).twins = vec![GOOD; 40];
        let evidence_file = live.evidence_files.of(&id).unwrap();
        let evidence = Change::PutEvidence {
            version: id.clone(),
            kind: EvidenceKind::Shadow,
            json: serde_json::to_string(evidence_file).unwrap(),
            digest: evidence_file.digest().unwrap(),
        };
        live.record.write(vec![evidence], Vec::new()).unwrap();
        id
    }

    /// Makes a candidate that has passed every stage active and watched.
    pub(crate) fn enter(&mut self, id: &CapabilityId, event: impl Fn(VersionRef) -> LifecycleEvent) {
        let pipeline = &mut self.pipeline;
        let version = pipeline.record().version_table().version(id).unwrap().0;
        let now_tick = pipeline.record().now_tick();
        let live = pipeline.live();
        let watched = ActivationMonitor::new(id, live.evidence_files.of(id), live.context, now_tick).unwrap();
        let digest = Digest::of_parts("test", &[b"gate"]);
        let gate = Change::PutEvidence {
            version: id.clone(),
            kind: EvidenceKind::Gate,
            json: "{}".to_owned(),
            digest,
        };
        let note = TransitionNote {
            cause: Some(ActiveCause::Gate { evidence: digest, approvals_needed: 0 }),
            before: vec![gate],
            ..TransitionNote::because(Notice::StageBegins)
        };
        pipeline.live().record.transition(&id.family, event(version), note).unwrap();
        pipeline.live().monitors.insert(watched);
        pipeline.drain_events();
    }

    pub(crate) fn by_operator(&mut self, id: &CapabilityId) -> RollbackRecord {
        let operation = Operation { version: id.clone(), by: "ann".to_owned(), reason: "drill".to_owned() };
        self.roll_back(Command::Rollback(operation))
    }

    fn roll_back(&mut self, command: Command) -> RollbackRecord {
        assert_accepted(&self.pipeline.command(command));
        let record = self.record();
        assert_eq!(record.trigger.kind, TriggerKind::Operator);
        assert!(!record.in_flight);
        record
    }

    /// The record in the event, which equals the stored one.
    fn record(&mut self) -> RollbackRecord {
        let events = self.pipeline.drain_events();
        let event_record = events.iter().rev().find_map(|event| match event {
            EventKind::RolledBack { record, .. } => Some((**record).clone()),
            _ => None,
        });
        let record = event_record.expect("an event reports the rollback");
        let views = self.pipeline.record().version_table().store().views().unwrap();
        let entry = views.evidence(&record.candidate, Some(EvidenceKind::Rollback)).unwrap().pop().unwrap();
        assert_eq!(serde_json::from_str::<RollbackRecord>(&entry.json).unwrap(), record);
        let rungs: Vec<Rung> = events
            .iter()
            .filter_map(|event| match event {
                EventKind::Rung { rung, .. } => Some(*rung),
                _ => None,
            })
            .collect();
        assert_eq!(rungs, record.rungs.iter().map(|rung| rung.rung).collect::<Vec<_>>());
        if record.post_status == PostStatus::SafeStopped {
            let rang = |event: &EventKind| {
                matches!(event, EventKind::Alarm { alarm, priority, .. }
                    if alarm.starts_with("safe-stopped:") && *priority == Priority::Critical)
            };
            assert!(events.iter().any(rang), "a safe-stopped family has a critical alarm: {events:?}");
        }
        record
    }

    /// The family has no active version, and the ladder ended where it failed.
    fn assert_stopped(&self, record: &RollbackRecord, failure: RungFailure) {
        assert_eq!(record.stopped_by(), Some(failure), "{:?}", record.rungs);
        assert_eq!(record.rungs.last().unwrap().failure, Some(failure), "nothing is tried after it");
        assert_eq!((record.post_status, record.recovered), (PostStatus::SafeStopped, Some(false)));
        assert_eq!(record.time_to_restored_ticks, None);
        let family = self.pipeline.record().version_table().family(&record.candidate.family).unwrap();
        assert!(family.state.safe_stopped && family.active().is_none());
    }

    fn assert_restored(&self, record: &RollbackRecord) {
        assert_eq!(record.stopped_by(), None, "{:?}", record.rungs);
        assert_eq!(record.post_status, PostStatus::RolledBack);
        let active = self.pipeline.record().active_of(&record.candidate.family).map(|active| active.id());
        assert_eq!(active, record.predecessor);
        let (safe, restored) = (record.time_to_safe_ticks.unwrap(), record.time_to_restored_ticks.unwrap());
        assert!(safe < restored, "{safe} {restored}");
        let rungs: Vec<Rung> = record.rungs.iter().map(|rung| rung.rung).collect();
        let is_hook = |rung: &Rung| matches!(rung, Rung::RollbackHook | Rung::SafeAbort);
        assert_eq!(rungs.iter().any(is_hook), record.trigger.kind.permits_hook());
        let tried = |rung: &Rung| !is_hook(rung) || rungs.contains(rung);
        assert_eq!(rungs, Rung::ALL.into_iter().filter(tried).collect::<Vec<_>>());
    }

    /// Moves the tool without any version, and leaves it moving or standing.
    fn move_tool(&mut self, position: [f64; 3], ticks: u32) {
        let body = self.pipeline.live().world.cell.rig_mut().unwrap().arm_mut().body_mut();
        let mut pose = body.telemetry().tool;
        pose.position = position;
        body.step(&Motion::ToolPose { pose, max_speed_m_s: 0.4 }).unwrap();
        for _ in 1..ticks {
            body.step(&Motion::Hold).unwrap();
        }
    }

    fn break_arm(&mut self, fault: InjectedFault) {
        self.pipeline
            .live()
            .world
            .cell
            .rig_mut()
            .unwrap()
            .arm_mut()
            .body_mut()
            .world_mut()
            .inject(fault)
            .unwrap();
    }
}

#[test]
fn safety_event_starts_the_rollback_in_its_tick() {
    // It flies low, among the live cell's clutter.
    let (mut bench, id) = RollbackBench::with_active("align-low-transit");
    for _ in 0..40 {
        assert_eq!(bench.pipeline.advance(), SliceOutcome::Ran);
        if bench.pipeline.live().monitors.iter().next().is_none() {
            break;
        }
    }
    let record = bench.record();
    assert_eq!(record.candidate, id);
    assert_eq!(record.trigger.kind, TriggerKind::SafetyEvent);
    assert!(record.trigger.event.is_some());
    assert!(record.in_flight);
    let swap = record.rungs.iter().find(|rung| rung.rung == Rung::SwapBinding).unwrap();
    let given_up = Notice::TargetBound { task: Some(TaskKind::Align), planned: 1 };
    assert_eq!(swap.text, given_up.into());
    bench.assert_restored(&record);
    // And so it does: nothing of what was in flight is gone on with.
    let report = bench.pipeline.live().sequence(None).unwrap();
    let worked: Vec<TaskKind> = report.tasks.iter().map(|done| done.record.task).collect();
    assert_eq!(worked, TaskKind::SEQUENCE[..worked.len()]);
    assert!(worked.len() > 1 && report.planned == 3, "{worked:?}");
    assert_eq!(Some(report.tasks[1].id.clone()), record.predecessor);
    let safe = record.time_to_safe_ticks.unwrap();
    assert!((1..u64::from(RATE_HZ)).contains(&safe), "the arm moved and was stopped: {safe} ticks");
}

#[test]
fn arm_at_standstill_is_restored_at_once() {
    let (mut bench, id) = RollbackBench::resting_with_active("grasp-improved");
    let record = bench.by_operator(&id);
    bench.assert_restored(&record);
    assert_eq!(record.recovered, Some(true), "{:?}", record.rungs);
}

#[test]
fn frames_show_the_sequence_and_the_ladder_and_change_nothing() {
    let frames = std::sync::Arc::new(std::sync::Mutex::new(Vec::new()));
    let outcomes = [false, true].map(|drawn| {
        let (mut bench, id) = RollbackBench::with_active("align-improved");
        if drawn {
            let sink = std::sync::Arc::clone(&frames);
            bench.pipeline.draw_live_world(std::sync::Arc::new(move |frame| {
                sink.lock().unwrap().push(frame);
            }));
        }
        for _ in 0..3 {
            assert_eq!(bench.pipeline.advance(), SliceOutcome::Ran);
        }
        let operation = Operation { version: id, by: "ann".to_owned(), reason: "drill".to_owned() };
        bench.pipeline.command(Command::Rollback(operation));
        (bench.pipeline.drain_events(), bench.pipeline.record().now_ms())
    });
    assert_eq!(outcomes[0], outcomes[1], "who draws changes neither what is done nor when");
    let frames = frames.lock().unwrap();
    assert!(frames.windows(2).all(|pair| pair[0].at_ms <= pair[1].at_ms), "frames are in order of time");
    assert!(
        frames
            .iter()
            .any(|frame| frame.task == Some(holdpoint_body::TaskKind::Grasp) && frame.envelope.is_some())
    );
    assert!(frames.iter().any(|frame| !frame.contacts.is_empty()));
    // The ladder ends with the tool clear of everything, and the arm under no task.
    let raised = |frame: &&holdpoint_protocol::video_frame::VideoFrame| {
        frame.task.is_none() && frame.stopped && frame.body.links.last().is_some_and(|tool| tool[2] > 0.15)
    };
    assert!(frames.iter().filter(raised).count() > 3, "{} frames", frames.len());
}

#[test]
fn hook_that_does_not_stop_the_arm_does_not_end_the_ladder() {
    let (mut bench, id) = RollbackBench::with_active("align-improved");
    bench.move_tool([0.5, 0.2, 0.35], 48);
    // The task was stopped 40 ticks ago, and its hook has not brought the arm to a standstill since.
    let world_tick = bench.pipeline.live().world.cell.rig_mut().unwrap().world().tick() - 40;
    let stopped = RecoveryReport {
        stopped_by: StoppedBy::Nothing,
        ticks_to_standstill: 40,
        motion_ticks: 40,
        violation: None,
        rollback_hook: None,
    };
    let trip = Trip { event: None, world_tick, tick: 0, stopped: Some(stopped) };
    let trigger = trigger(bench.pipeline.record(), TriggerKind::RateTrip, Notice::RollbackInterrupted);
    bench.pipeline.live().deactivate(&id, trigger, Some(&trip), DeactivationKind::RolledBack).unwrap();
    let record = bench.record();
    assert_eq!(record.rungs[1].failure, Some(RungFailure::HookFailed), "{:?}", record.rungs);
    assert!(record.time_to_safe_ticks.unwrap() >= 40, "time counts from the trigger");
    assert_eq!(record.unsafe_continuation_ms, ticks_to_ms(40));
    bench.assert_restored(&record);
}

#[test]
fn family_without_a_rollback_target_is_stopped() {
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    let version = "place@1.0.0".parse().unwrap();
    let operation = Operation { version, by: "ann".to_owned(), reason: "drill".to_owned() };
    let record = bench.roll_back(Command::Vacate(operation));
    bench.assert_stopped(&record, RungFailure::PredecessorMissing);
    assert!(record.time_to_safe_ticks.is_some());
}

#[test]
fn runaway_joint_is_no_standstill() {
    let (mut bench, id) = RollbackBench::with_active("align-improved");
    bench.break_arm(InjectedFault::JointRunaway { joint: 0 });
    let record = bench.by_operator(&id);
    bench.assert_stopped(&record, RungFailure::NoStandstill);
    assert_eq!(record.time_to_safe_ticks, None);
}

#[test]
fn a_jammed_joint_blocks_the_retreat() {
    let (mut bench, id) = RollbackBench::with_active("align-improved");
    bench.move_tool([0.5, 0.0, 0.10], 480);
    bench.break_arm(InjectedFault::JointStuck { joint: 1 });
    let record = bench.by_operator(&id);
    bench.assert_stopped(&record, RungFailure::RetreatBlocked);
    assert!(record.time_to_safe_ticks.is_some());
}

#[test]
fn rollback_target_changed_in_the_store_is_not_activated() {
    let (mut bench, id) = RollbackBench::resting_with_active("align-improved");
    let database = bench.pipeline.record().version_table().store().layout().database();
    assert!(database.starts_with(bench.folder.path()));
    let other = rusqlite::Connection::open(database).unwrap();
    // Write access to the file can remove its guards.
    let guards: Vec<String> = other
        .prepare("SELECT name FROM sqlite_master WHERE type = 'trigger' AND tbl_name = 'version'")
        .and_then(|mut found| found.query_map([], |row| row.get(0))?.collect())
        .unwrap();
    for guard in guards {
        other.execute_batch(&format!("DROP TRIGGER \"{guard}\"")).unwrap();
    }
    let sql = "UPDATE version SET submission = replace(submission, '1.0.0', '1.0.1')
               WHERE name = 'align@1.0.0'";
    assert_eq!(other.execute(sql, []).unwrap(), 1);
    let record = bench.by_operator(&id);
    bench.assert_stopped(&record, RungFailure::DigestMismatch);
}

#[test]
fn policies_that_are_not_the_profiles_end_the_ladder() {
    let (mut bench, id) = RollbackBench::resting_with_active("align-improved");
    let other = Profile::builtin(ProfileName::Human).unwrap();
    bench.pipeline.context_mut().table = std::sync::Arc::new(PolicyTable::builtin(&other).unwrap());
    let record = bench.by_operator(&id);
    bench.assert_stopped(&record, RungFailure::PolicyMismatch);
}

/// The shipped profile of class sim under a name of its own, with a policy text of its own.
fn line_4() -> ProfileTexts {
    let (file, profile) = Profile::builtin_text(ProfileName::Sim);
    let (policy_file, policy) = Profile::builtin_policy(ProfileName::Sim);
    let own = profile.replace("name = \"sim\"", "name = \"sim\"\nsite = \"line-4\"");
    let policy = format!("{policy}\n// the site's own\n");
    ProfileTexts { file: file.to_owned(), profile: own, policy_file: policy_file.to_owned(), policy }
}

#[test]
fn a_rollback_under_a_sites_own_policies_restores() {
    let mut bench = RollbackBench::under_own(line_4());
    let id = bench.activate("align-improved");
    let record = bench.by_operator(&id);
    bench.assert_restored(&record);
}

#[test]
fn the_agents_identity_is_the_same_before_and_after_upgrade_and_rollback() {
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    let of = |bench: &RollbackBench| {
        let views = bench.pipeline.record().version_table().store().views().unwrap();
        (bench.pipeline.snapshot().agent, crate::decide::store_identity::agent(&*views).unwrap().unwrap())
    };
    let before = of(&bench);
    assert_eq!(before.0, before.1);
    let id = bench.activate("align-improved");
    bench.pipeline.live().sequence(None).unwrap();
    assert_eq!(of(&bench), before, "after an upgrade, and work under it");
    let record = bench.by_operator(&id);
    bench.assert_restored(&record);
    assert_eq!(of(&bench), before, "after a rollback");
    assert_eq!(of(&bench.restart()), before, "after a restart");
}

#[test]
fn site_policies_other_than_those_in_force_end_the_ladder() {
    let mut bench = RollbackBench::under_own(line_4());
    let id = bench.activate("align-improved");
    // What the program ships for the class is not what the site wrote.
    let context = bench.pipeline.context_mut();
    context.table = std::sync::Arc::new(PolicyTable::builtin(&context.profile).unwrap());
    let record = bench.by_operator(&id);
    bench.assert_stopped(&record, RungFailure::PolicyMismatch);
}

#[test]
fn activation_that_cannot_be_written_ends_the_ladder() {
    let (mut bench, id) = RollbackBench::resting_with_active("align-improved");
    let database = bench.pipeline.record().version_table().store().layout().database();
    // Of the gate's activation and one that restores there can be one alone.
    let index = "CREATE UNIQUE INDEX refuse ON activation (family) WHERE cause IN ('gate', 'restore')";
    rusqlite::Connection::open(database).and_then(|other| other.execute_batch(index)).unwrap();
    let record = bench.by_operator(&id);
    bench.assert_stopped(&record, RungFailure::StoreFailed);
    assert_eq!(record.rungs.last().unwrap().rung, Rung::SwapBinding);
}

#[test]
fn silence_asks_then_restricts_then_rolls_back() {
    let (mut bench, id) = RollbackBench::resting_with_active("grasp-improved");
    bench.pipeline.live().world.cell.fault = Some(LiveFault::TelemetryLost);
    let mut decisions = Vec::new();
    let mut record = None;
    for _ in 0..60 {
        bench.pipeline.advance();
        for event in bench.pipeline.drain_events() {
            match event {
                EventKind::Monitor { version, decision, .. } if version == id => decisions.push(decision),
                EventKind::RolledBack { record: rollback, .. } => record = Some(rollback),
                _ => {}
            }
        }
        if record.is_some() {
            break;
        }
    }
    assert_eq!(decisions, [MonitorOutcome::Escalate, MonitorOutcome::Restrict, MonitorOutcome::Rollback]);
    let record = record.unwrap();
    assert_eq!(record.trigger.kind, TriggerKind::TelemetrySilence);
    bench.assert_restored(&record);
    let waited_s = bench.pipeline.live().context.profile.monitor.escalation_deadline_s;
    let at_s = record.trigger.tick as f64 / f64::from(RATE_HZ);
    // A deadline that passes while another version is at work is acted on after that sequence.
    assert!((waited_s..waited_s + 15.0).contains(&at_s), "rolled back at {at_s} s");
}

#[test]
fn lost_telemetry_of_an_idle_arm_rolls_the_version_back() {
    let mut bench = RollbackBench::resting(ProfileName::Sim);
    bench.activate("align-improved");
    let pipeline = &mut bench.pipeline;
    pipeline.live().world.cell.fault = Some(LiveFault::TelemetryLost);
    // Nothing is worked: only time passes, from one deadline to the next.
    let mut steps = 0;
    while pipeline.live().monitors.iter().next().is_some() {
        let next_ms = pipeline.next_deadline_ms().expect("silence has a deadline");
        pipeline.jump_to(next_ms);
        assert!(pipeline.live().look_at_monitors().unwrap(), "due at {next_ms}");
        steps += 1;
        assert!(steps < 5);
    }
    assert_eq!(steps, 3);
    let record = bench.record();
    assert_eq!(record.trigger.kind, TriggerKind::TelemetrySilence);
}

/// An unsigned rollback ended the predecessor's restriction, and let its window count as passed.
#[test]
fn a_rollback_target_keeps_its_restriction_and_monitor() {
    let (mut bench, before) = RollbackBench::resting_with_active("align-improved");
    let operation =
        Operation { version: before.clone(), by: "ann".to_owned(), reason: "too fast here".to_owned() };
    assert_accepted(&bench.pipeline.command(Command::Restrict(operation)));
    let id = bench.activate("align-low-transit");
    assert!(bench.pipeline.live().monitors.of(&before).is_none());
    bench.by_operator(&id);
    let (_, lifecycle, _) = bench.pipeline.record().version_table().version(&before).unwrap();
    assert_eq!(lifecycle.state, State::Active);
    assert!(lifecycle.flags.restricted && lifecycle.flags.provisional, "{lifecycle:?}");
    let watched = bench.pipeline.live().monitors.of(&before).map(|watched| watched.restricted);
    assert_eq!(watched, Some(true));
}
