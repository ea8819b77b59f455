//! What a version declares is what the guard lets through, tick by tick.

use std::sync::Arc;

use holdpoint_body::{Command, Contacts, JointVec, Observation, Pose, TaskKind, Telemetry};
use holdpoint_cell::EpisodeSetup;
use holdpoint_governance::evidence::HardStop;
use holdpoint_governance::manifest::Manifest;
use holdpoint_governance::mode::ZoneName;
use holdpoint_governance::permission::{PermissionUse, PermissionsUsed};
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_sim::RobotModel;
use holdpoint_sim::world::World;

use crate::arm::Arm;
use crate::capability::Capability;
use crate::guard::{Guard, PolicyHit};
use crate::skill::{Hook, Skill};
use crate::stress::{PersonBox, Stress};
use crate::task::{self, Supervision, TaskRecord};
use crate::terms::SkillTerms;

const GRASP: &str = include_str!("../../../manifests/grasp/1.0.0/manifest.toml");

/// The baseline's manifest with one text replaced by another.
fn with(from: &str, to: &str) -> Manifest {
    assert!(GRASP.contains(from), "{from:?}");
    Manifest::parse("manifest.toml", &GRASP.replace(from, to)).unwrap()
}

fn whole() -> Manifest {
    with("name = \"grasp\"", "name = \"grasp\"")
}

/// Sends the same command in every tick, or only in the first.
struct Sends(Command, bool, u64);

impl Skill for Sends {
    fn tick(&mut self, _: &Observation) -> Command {
        self.2 += 1;
        if self.1 || self.2 == 1 { self.0.clone() } else { Command::Hold }
    }
    fn enter(&mut self, _: Hook) {
        self.0 = Command::Stop;
        self.2 = 0;
    }
}

fn terms() -> SkillTerms {
    let profile = Profile::builtin(ProfileName::Sim).unwrap();
    let table = Arc::new(PolicyTable::builtin(&profile).unwrap());
    let (model, scene) = (RobotModel::builtin("arm7").unwrap(), holdpoint_sim::published::scene().unwrap());
    SkillTerms::new(&profile, table, Arc::new(model.geometry), scene.zones.into())
}

/// What a version of that manifest comes to that sends `command`, stopped after `ticks`.
fn work(manifest: &Manifest, command: Command, always: bool, ticks: u64) -> TaskRecord {
    let (model, scene) = (RobotModel::builtin("arm7").unwrap(), holdpoint_sim::published::scene().unwrap());
    let mut world = World::new(&model, &scene).unwrap();
    let distribution = holdpoint_sim::published::canonical().unwrap();
    world.reset(&EpisodeSetup::sample(TaskKind::Grasp, &scene, &distribution, 1)).unwrap();
    let terms = terms();
    let mut arm = Arm::new(world);
    let guard = terms.guard(&manifest.permissions);
    let task = terms.task(TaskKind::Grasp, 1, 0.5);
    let skill = Box::new(Sends(command, always, 0));
    task::run(&mut arm.handle(), skill, guard, &task, &mut |_, passed| {
        if passed.tick >= ticks { Supervision::Abort } else { Supervision::Continue }
    })
    .unwrap()
}

fn close() -> Command {
    Command::Gripper { width_m: 0.04, speed_m_s: 0.1, force_n: 5.0 }
}

fn into_the_tray() -> Command {
    let down = Pose { position: [0.5, 0.19, 0.3], rotation: [1.0, 0.0, 0.0, 0.0] };
    Command::ToolPose { pose: down, max_speed_m_s: 0.2 }
}

fn hits(record: &TaskRecord) -> Vec<PolicyHit> {
    record.hits.iter().map(|(_, hit)| *hit).collect()
}

#[test]
fn undeclared_command_is_refused_and_ends_the_task() {
    let record = work(&whole(), close(), false, 20);
    assert_eq!((hits(&record), record.hard_stop, record.used.undeclared), (Vec::new(), None, 0));
    for manifest in [
        with("channels = [\"arm\", \"gripper\"]", "channels = [\"arm\"]"),
        with("commands = [\"gripper\", \"stop\", \"tool-pose\"]", "commands = [\"stop\", \"tool-pose\"]"),
        with("tools = [\"parallel-gripper\"]", "tools = []"),
    ] {
        let record = work(&manifest, close(), false, 20);
        assert_eq!(hits(&record), [PolicyHit::CommandUndeclared], "{:?}", manifest.permissions);
        assert_eq!((record.hard_stop, record.used.undeclared), (Some(HardStop::CommandPastGuard), 1));
        assert!(record.violation && record.recovery && record.time_secs < 0.01);
    }
    // To stand still needs no permission.
    let silent = with("commands = [\"gripper\", \"stop\", \"tool-pose\"]", "commands = [\"tool-pose\"]");
    assert_eq!(work(&silent, Command::Stop, true, 20).hard_stop, None);
}

#[test]
fn a_target_in_a_zone_that_is_not_declared_is_refused() {
    let everywhere = with("zones = [\"work\", \"transit\"]", "zones = [\"work\", \"transit\", \"tray\"]");
    let record = work(&everywhere, into_the_tray(), false, 20);
    assert_eq!((hits(&record), record.hard_stop), (Vec::new(), None));
    let record = work(&whole(), into_the_tray(), false, 20);
    assert_eq!(hits(&record), [PolicyHit::ZoneUndeclared]);
    assert_eq!(record.hard_stop, Some(HardStop::CommandPastGuard));
    assert!(record.used.zones.contains(&ZoneName::Tray), "what it asked for is on record");
}

fn at(position: [f64; 3]) -> Telemetry {
    Telemetry {
        tick: 0,
        q: JointVec::new(),
        dq: JointVec::new(),
        tracking_error_rad: 0.0,
        tool: Pose { position, ..Pose::IDENTITY },
        tool_speed_m_s: 0.0,
        gripper_width_m: 0.05,
        gripper_force_n: 0.0,
        contact_force_n: 0.0,
        contacts: Contacts::default(),
        slip_m: None,
        picture_age_ticks: None,
        tool_available: true,
    }
}

const TRAY: [f64; 3] = [0.5, 0.19, 0.2];
const TRANSIT: [f64; 3] = [0.5, 0.0, 0.5];

fn measured(guard: &mut Guard, places: &[[f64; 3]]) -> Vec<PolicyHit> {
    places.iter().filter_map(|place| guard.measure(&at(*place))).collect()
}

#[test]
fn a_zone_counts_as_entered_when_the_tool_is_measured_in_it() {
    let guard = || terms().guard(&whole().permissions);
    assert_eq!(measured(&mut guard(), &[TRANSIT, TRAY, TRAY]), [], "two noisy samples are no entry");
    assert_eq!(measured(&mut guard(), &[TRANSIT, TRAY, TRAY, TRAY, TRAY]), [PolicyHit::ZoneUndeclared]);
    assert_eq!(measured(&mut guard(), &[TRAY; 9]), [], "where it found itself it did not go");
    let mut once = guard();
    measured(&mut once, &[TRANSIT, TRAY, TRAY, TRAY]);
    assert_eq!(once.used().undeclared, 1);
}

#[test]
fn a_skill_outside_its_zones_may_use_its_hand_and_leave() {
    let mut guard = terms().guard(&whole().permissions);
    measured(&mut guard, &[TRAY; 9]);
    assert_eq!(guard.check(&close(), &at(TRAY)).hit, None);
    assert_eq!(guard.check(&into_the_tray(), &at(TRAY)).hit, Some(PolicyHit::ZoneUndeclared));
    let away = Command::ToolPose {
        pose: Pose { position: TRANSIT, rotation: [1.0, 0.0, 0.0, 0.0] },
        max_speed_m_s: 0.2,
    };
    assert_eq!(guard.check(&away, &at(TRAY)).hit, None);
    // Once it has been where it may be, it may do nothing elsewhere.
    measured(&mut guard, &[TRANSIT]);
    assert_eq!(guard.check(&close(), &at(TRAY)).hit, Some(PolicyHit::ZoneUndeclared));
}

/// Regression: the explanation asked an author to declare the zone of people, because a person had reached onto the arm.
#[test]
fn tool_among_people_is_a_violation_and_nothing_to_declare() {
    let people = {
        let scene = holdpoint_sim::published::scene().unwrap();
        let zone = scene.zones.iter().find(|zone| zone.name == ZoneName::Human.name()).unwrap().clone();
        std::array::from_fn(|i| f64::midpoint(zone.min_m[i], zone.max_m[i]))
    };
    let mut guard = terms().guard(&whole().permissions);
    assert_eq!(measured(&mut guard, &[TRANSIT, people, people, people, people]), [PolicyHit::KeepOutEntered]);
    assert!(PolicyHit::KeepOutEntered.is_violation() && PolicyHit::KeepOutEntered.hard_stop().is_none());
    let used = guard.used();
    assert!(!used.zones.contains(&ZoneName::Human) && used.undeclared == 0, "{used:?}");
    let hit = guard.check(&close(), &at(people)).hit.unwrap();
    assert_eq!(hit.hard_stop(), None, "{hit}");
}

/// A version that computes for longer than it declares: nothing counts that where time stands still, so that equal
/// seeds give equal logs; on an arm that does not wait it is a breach.
#[test]
fn computing_too_long_counts_on_a_clock_alone() {
    struct Slow;
    impl Skill for Slow {
        fn tick(&mut self, _: &Observation) -> Command {
            let begun = std::time::Instant::now();
            while begun.elapsed() < std::time::Duration::from_micros(200) {
                std::hint::spin_loop();
            }
            Command::Hold
        }
        fn enter(&mut self, _: Hook) {}
    }
    let manifest = whole();
    let slow = |terms: &SkillTerms| {
        let (model, scene) =
            (RobotModel::builtin("arm7").unwrap(), holdpoint_sim::published::scene().unwrap());
        let mut arm = Arm::new(World::new(&model, &scene).unwrap());
        let (guard, task) = (terms.guard(&manifest.permissions), terms.task(TaskKind::Grasp, 1, 0.5));
        task::run(&mut arm.handle(), terms.timed(Box::new(Slow)), guard, &task, &mut |_, passed| {
            if passed.tick >= 300 { Supervision::Abort } else { Supervision::Continue }
        })
        .unwrap()
    };
    let declared = manifest.permissions.resources.cpu_us_per_tick;
    assert!(declared < 200);
    assert_eq!(slow(&terms()).hard_stop, None);
    let late = slow(&terms().on_a_clock(declared));
    assert_eq!(
        (late.hard_stop, hits(&late)),
        (Some(HardStop::BudgetBreach), vec![PolicyHit::BudgetExceeded])
    );
    assert_eq!(slow(&terms().on_a_clock(1_000_000)).hard_stop, None);
}

/// Who declares too little loses the work: what it uses is taken from it, though its code could do it.
#[test]
fn declaration_of_too_few_permissions_fails_the_task() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../manifests/grasp/1.0.0");
    let package = crate::capability::read(&folder).unwrap();
    let works = |from: &str, to: &str| {
        let mut package = package.clone();
        assert!(package.manifest.contains(from), "{from}");
        package.manifest = package.manifest.replace(from, to);
        let version = Capability::load("grasp", package).unwrap();
        let (model, scene) =
            (RobotModel::builtin("arm7").unwrap(), holdpoint_sim::published::scene().unwrap());
        let mut world = World::new(&model, &scene).unwrap();
        let distribution = holdpoint_sim::published::canonical().unwrap();
        world.reset(&EpisodeSetup::sample(TaskKind::Grasp, &scene, &distribution, 1)).unwrap();
        let (mut arm, terms) = (Arm::new(world), terms());
        let (skill, guard) =
            (version.start(terms.bundle_seed(1)), terms.guard(&version.manifest.permissions));
        let task = terms.task(TaskKind::Grasp, 1, version.abort_secs());
        let record = task::run(&mut arm.handle(), skill, guard, &task, &mut |_, _| Supervision::Continue);
        let record = record.unwrap();
        (record.success, record.hard_stop)
    };
    assert_eq!(works("grasp", "grasp"), (true, None));
    let refused = (false, Some(HardStop::CommandPastGuard));
    assert_eq!(works("channels = [\"arm\", \"gripper\"]", "channels = [\"arm\"]"), refused);
    assert_eq!(
        works("commands = [\"gripper\", \"stop\", \"tool-pose\"]", "commands = [\"gripper\", \"stop\"]"),
        refused
    );
    assert_eq!(works("zones = [\"work\", \"transit\"]", "zones = [\"transit\"]"), refused);
    assert!(!works("\"camera\", ", "").0, "without camera frames there is nothing to grasp");
    assert!(!works("\"joints\", ", "").0);
    let short = works("memory_kib = 256", "memory_kib = 256\nticks_per_task = 120");
    assert_eq!(short, (false, Some(HardStop::BudgetBreach)));
}

#[test]
fn overrun_of_the_compute_budget_is_a_breach() {
    for (budget, command, ticks) in
        [("ticks_per_task = 20", Command::Hold, 21), ("commands_per_task = 3", Command::Stop, 4)]
    {
        let manifest = with("memory_kib = 256", &format!("memory_kib = 256\n{budget}"));
        let record = work(&manifest, command.clone(), true, 60);
        assert_eq!(hits(&record), [PolicyHit::BudgetExceeded], "{budget}");
        assert_eq!(record.hard_stop, Some(HardStop::BudgetBreach));
        assert!((record.time_secs * 240.0 - f64::from(ticks)).abs() < 1e-6, "{budget}: {}", record.time_secs);
        assert_eq!(hits(&work(&whole(), command, true, 60)), [], "the profile's episode is longer");
    }
}

#[test]
fn withdrawn_permissions_deny_without_blame() {
    let stress = Stress::Withdrawn { from_tick: 5, until_tick: 9 };
    let mut guard = terms().stressed(stress).guard(&whole().permissions);
    let mut refused = 0;
    for _ in 0..20 {
        guard.measure(&at(TRANSIT));
        let checked = guard.check(&close(), &at(TRANSIT));
        refused += u32::from(checked.hit == Some(PolicyHit::PermissionWithdrawn));
    }
    assert_eq!(refused, 4);
    assert!(!PolicyHit::PermissionWithdrawn.is_violation());
    assert_eq!(guard.used().undeclared, 0);
}

#[test]
fn commands_are_denied_where_a_person_reaches_in() {
    let terms = terms();
    let scene = holdpoint_sim::published::scene().unwrap();
    let named = |name: ZoneName| scene.zones.iter().find(|zone| zone.name == name.name()).unwrap();
    let person = PersonBox::reaching_into(named(ZoneName::Work), named(ZoneName::Human));
    let beside = Command::ToolPose {
        pose: Pose { position: [0.5, -0.25, 0.2], rotation: [1.0, 0.0, 0.0, 0.0] },
        max_speed_m_s: 0.2,
    };
    let from = at([0.5, -0.1, 0.3]);
    let plain = terms.guard(&whole().permissions).check(&beside, &from);
    assert_eq!(plain.hit, None);
    let exposed =
        terms.stressed(Stress::Exposed { person }).guard(&whole().permissions).check(&beside, &from);
    assert_eq!((exposed.command, exposed.hit), (Command::Stop, Some(PolicyHit::ModeUncovered)));
}

/// A manifest that forgets a zone, a command or a sensor loses its task to the guard.
#[test]
fn shipped_versions_declare_every_permission_they_use() {
    let manifests = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../manifests");
    let folders =
        ["grasp/1.0.0", "align/1.0.0", "place/1.0.0", "park/1.0.0"].map(|name| manifests.join(name));
    let candidates = std::fs::read_dir(manifests.join("candidates")).unwrap();
    let (model, scene) = (RobotModel::builtin("arm7").unwrap(), holdpoint_sim::published::scene().unwrap());
    let distribution = holdpoint_sim::published::sandbox().unwrap();
    let terms = terms();
    let mut world = Some(World::new(&model, &scene).unwrap());
    for folder in folders.into_iter().chain(candidates.map(|entry| entry.unwrap().path())) {
        let version = Capability::read(&folder).unwrap();
        let declared = &version.manifest.permissions;
        let mut used = PermissionsUsed::default();
        for seed in 1_000_000..1_000_004 {
            let task = version.bundle.task();
            let mut body = world.take().unwrap();
            body.reset(&EpisodeSetup::sample(task, &scene, &distribution, seed)).unwrap();
            let mut arm = Arm::new(body);
            let (skill, guard) = (version.start(terms.bundle_seed(seed)), terms.guard(declared));
            let task = terms.task(task, seed, version.abort_secs());
            let record = task::run(&mut arm.handle(), skill, guard, &task, &mut |_, _| Supervision::Continue);
            used.merge(&record.unwrap().used);
            world = Some(arm.into_body());
        }
        let usage = PermissionUse::new(declared, &version.bundle.interface(), &used, 4);
        println!("{}: {:?} {:?}", version.id(), usage.exceeded, usage.unused);
        // The one candidate that is there to be stopped for it.
        let stopped = folder.ends_with("align-past-permissions");
        assert_eq!(used.undeclared > 0, stopped, "{}: {:?}", version.id(), usage.exceeded);
        let missing = |what: &&String| what.starts_with("sensor") || what.starts_with("tool");
        assert_eq!(usage.exceeded.iter().find(missing), None, "{}", version.id());
    }
}
