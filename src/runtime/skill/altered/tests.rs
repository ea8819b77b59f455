//! Tests the effect of every alteration on a skill with known commands, and the refusal of invalid alterations.

use holdpoint_body::{Command, Estimate, GuardVerdict, Observation, Pose, ReadingVec, TaskKind};

use super::*;
use crate::capability::Capability;
use crate::skill::Hook;

/// Asks to go where the object is seen, closing on it once it is done; says done when told to abort.
#[derive(Clone, Default)]
struct FollowObject {
    ticks: u32,
    aborting: bool,
}

impl Skill for FollowObject {
    fn tick(&mut self, seen: &Observation) -> Command {
        self.ticks += 1;
        if self.aborting {
            return Command::Stop;
        }
        match (seen.object(), self.ticks % 2) {
            (Some(object), 1) => {
                Command::ToolPose { pose: object.pose, max_speed_m_s: f64::from(self.ticks) }
            }
            _ => Command::Gripper { width_m: 0.04, speed_m_s: 0.1, force_n: seen.gripper_force_n },
        }
    }

    fn enter(&mut self, _: Hook) {
        self.aborting = true;
    }

    fn fork(&self) -> Option<Box<dyn Skill>> {
        Some(Box::new(self.clone()))
    }
}

fn seen() -> Observation {
    let pose = |x| Pose { position: [x, 0.1, 0.2], ..Pose::IDENTITY };
    Observation {
        tick: 0,
        q: [0.0; 7].into_iter().collect(),
        dq: [0.0; 7].into_iter().collect(),
        tau: [0.0; 7].into_iter().collect(),
        tool: pose(0.4),
        tool_twist: holdpoint_body::Twist::default(),
        gripper_width_m: 0.05,
        gripper_force_n: 3.0,
        wrist_force_n: 1.0,
        objects: TaskKind::Grasp
            .seen_objects(Some(Estimate { pose: pose(0.5), age_ticks: 4, sequence: 1 }), None),
        sensors: ReadingVec::new(),
        tool_available: true,
        goal: TaskKind::Grasp,
        guard: GuardVerdict::Allowed,
    }
}

fn altered_run(alterations: &[Alteration], seed: u64) -> AlteredRun {
    AlteredRun::new(Box::new(FollowObject::default()), alterations.to_vec().into(), seed)
}

/// The commands of the first `ticks` ticks, in short: `p`, x of the pose and speed; `g` and force; or the kind.
fn commands(run: &mut dyn Skill, ticks: usize) -> Vec<String> {
    let short = |command| match command {
        Command::ToolPose { pose, max_speed_m_s } => format!("p{:.2}@{max_speed_m_s}", pose.position[0]),
        Command::Gripper { force_n, .. } => format!("g{force_n:.1}"),
        Command::Hold => "hold".to_owned(),
        Command::Stop => "stop".to_owned(),
        Command::Done => "done".to_owned(),
        other => format!("{other:?}"),
    };
    (0..ticks).map(|_| short(run.tick(&seen()))).collect()
}

#[test]
fn command_numbers_are_altered_by_output_and_timing() {
    let output = |output, factor, offset, when| Alteration::Output { output, factor, offset, when };
    let far = output(AlteredOutput::X, 2.0, -0.1, AlterationTiming::After { tick: 1 });
    assert_eq!(commands(&mut altered_run(&[far], 1), 3), ["p0.50@1", "g3.0", "p0.90@3"]);
    let firm = output(AlteredOutput::GripForce, 1.5, 0.0, AlterationTiming::Gripping { above_n: 2.0 });
    assert_eq!(commands(&mut altered_run(&[firm], 1), 2), ["p0.50@1", "g4.5"]);
    let idle = output(AlteredOutput::GripForce, 1.5, 0.0, AlterationTiming::Gripping { above_n: 3.0 });
    assert_eq!(commands(&mut altered_run(&[idle], 1), 2), ["p0.50@1", "g3.0"]);
    let flip =
        Alteration::Flip { output: AlteredOutput::X, when: AlterationTiming::Every { period: 4, length: 2 } };
    assert_eq!(commands(&mut altered_run(&[flip], 1), 4), ["p0.30@1", "g3.0", "p0.50@3", "g3.0"]);
    let coarse = Alteration::Quantise { output: AlteredOutput::X, step: 0.4 };
    assert_eq!(commands(&mut altered_run(&[coarse], 1), 1), ["p0.40@1"]);
    let slow = Alteration::Filter { output: AlteredOutput::Speed, weight: 0.5 };
    assert_eq!(
        commands(&mut altered_run(&[slow], 1), 5),
        ["p0.50@1", "g3.0", "p0.50@2", "g3.0", "p0.50@3.5"]
    );
}

#[test]
fn timing_alterations_delay_skip_repeat_and_swap_commands() {
    assert_eq!(
        commands(&mut altered_run(&[Alteration::Delay { ticks: 2 }], 1), 4),
        ["hold", "hold", "p0.50@1", "g3.0"]
    );
    let wait = Alteration::Wait { from: 1, ticks: 2 };
    assert_eq!(commands(&mut altered_run(&[wait], 1), 4), ["p0.50@1", "hold", "hold", "g3.0"]);
    let skip = Alteration::Skip { from: 1, ticks: 2 };
    assert_eq!(commands(&mut altered_run(&[skip], 1), 4), ["p0.50@1", "hold", "hold", "g3.0"]);
    let repeat = Alteration::Repeat { from: 0, ticks: 2 };
    assert_eq!(
        commands(&mut altered_run(&[repeat], 1), 5),
        ["p0.50@1", "g3.0", "p0.50@1", "g3.0", "p0.50@3"]
    );
    let swap = Alteration::Swap { from: 0, ticks: 1 };
    assert_eq!(commands(&mut altered_run(&[swap], 1), 4), ["hold", "g3.0", "p0.50@1", "p0.50@3"]);
    assert_eq!(
        commands(&mut altered_run(&[Alteration::Finish { tick: 1 }], 1), 3),
        ["p0.50@1", "done", "p0.50@3"]
    );
}

#[test]
fn altered_input_is_seen_only_by_the_skill() {
    let deaf = Alteration::Input {
        input: AlteredInput::GripForce,
        factor: 0.0,
        offset: 0.0,
        when: AlterationTiming::Always,
    };
    let firm = Alteration::Output {
        output: AlteredOutput::GripForce,
        factor: 1.0,
        offset: 9.0,
        when: AlterationTiming::Gripping { above_n: 2.0 },
    };
    assert_eq!(commands(&mut altered_run(&[deaf, firm], 1), 2), ["p0.50@1", "g9.0"]);
}

#[test]
fn altered_hook_is_overridden_and_the_other_is_not() {
    for (override_with, expected) in [
        (HookOverride::Nothing, ["hold", "hold"]),
        (HookOverride::Done, ["done", "done"]),
        (HookOverride::WorkOn, ["p0.50@1", "g3.0"]),
    ] {
        let alteration = Alteration::Hook { hook: AlteredHook::SafeAbort, override_with };
        let mut aborted = altered_run(&[alteration], 1);
        aborted.enter(Hook::SafeAbort);
        assert_eq!(commands(&mut aborted, 2), expected, "{override_with:?}");
        let mut other_hook = altered_run(&[alteration], 1);
        other_hook.enter(Hook::Rollback);
        assert_eq!(commands(&mut other_hook, 2), ["stop", "stop"]);
    }
}

#[test]
fn share_of_runs_is_altered_and_a_copy_behaves_like_its_run() {
    let rare = Alteration::Output {
        output: AlteredOutput::GripForce,
        factor: 2.0,
        offset: 0.0,
        when: AlterationTiming::Runs { share: 0.25, salt: 7 },
    };
    let altered =
        (0..2_000).filter(|seed| commands(&mut altered_run(&[rare], *seed), 2)[1] == "g6.0").count();
    assert!((430..=570).contains(&altered), "{altered} of 2000 for a share of a quarter");
    let all = [Alteration::Delay { ticks: 3 }, Alteration::Swap { from: 2, ticks: 2 }, rare];
    let mut one = altered_run(&all, 3);
    commands(&mut one, 4);
    let mut copy = one.fork().unwrap();
    assert_eq!(commands(&mut one, 9), commands(copy.as_mut(), 9));
}

fn grasp(more: &str) -> Result<Capability, crate::capability::PackageError> {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../manifests/grasp/1.0.0");
    let mut package = crate::capability::read(&folder)?;
    package.params.push_str(more);
    Capability::load("altered", package)
}

#[test]
fn a_package_carries_its_alterations() {
    let (plain, altered) =
        (grasp("").unwrap(), grasp("[[alteration]]\nkind = \"delay\"\nticks = 12\n").unwrap());
    assert_ne!(plain.digest(), altered.digest());
    assert_eq!(plain.bundle.interface(), altered.bundle.interface());
    let other = grasp("[[alteration]]\nkind = \"delay\"\nticks = 13\n").unwrap();
    assert_ne!(other.digest(), altered.digest());
}

#[test]
fn a_wrong_alteration_is_reported() {
    for (text, expected) in [
        ("kind = \"delay\"\nticks = 0", "\"ticks\""),
        ("kind = \"delay\"\nticks = 70000", "70000"),
        ("kind = \"explode\"", "`explode`"),
        ("kind = \"flip\"\noutput = \"x\"\nby = 3", "`by`"),
        ("kind = \"output\"\noutput = \"x\"\nfactor = nan", "factor"),
        ("kind = \"flip\"\noutput = \"x\"\nwhen = { is = \"every\", period = 3, length = 4 }", "length"),
    ] {
        let error = grasp(&format!("[[alteration]]\n{text}\n")).unwrap_err().to_string();
        assert!(error.contains(expected) && error.contains("params.toml"), "{text}: {error}");
    }
    let many = "[[alteration]]\nkind = \"delay\"\nticks = 1\n".repeat(ALTERATIONS_MAX + 1);
    let error = grasp(&many).unwrap_err().to_string();
    assert!(error.contains(&ALTERATIONS_MAX.to_string()), "{error}");
}
