//! Plain values the tables start from: a grasp manifest with the code's exports, and clean evidence.

use std::collections::BTreeSet;

use holdpoint_governance::comparison_evidence::ComparisonEvidence;
use holdpoint_governance::composition::Kappas;
use holdpoint_governance::decision::{DecisionContext, Kappa};
use holdpoint_governance::evidence::{
    Conduct, DrillTallies, DrillTally, EpisodeValues, EvidenceBinding, Pair, PairedEvidence,
    RecoveryEvidence, SettlingTallies, ShadowEvidence, ShadowSequence,
};
use holdpoint_governance::exports::Interface;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::manifest::Manifest;
use holdpoint_governance::mode::RequiredCommand;
use holdpoint_governance::outcome::{
    Assessment, Basis, BehaviorOutcome, InterfaceOutcome, PolicyOutcome, RecoveryOutcome,
};
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_governance::rules_version::RulesVersion;
use holdpoint_governance::wall_time::WallTime;

pub const MANIFEST: &str = r#"
name = "grasp"
version = "1.0.0"

[inputs.object_pose]
type = "pose"
unit = "m"
frame = "world"

[outputs.width]
type = "real"
unit = "m"
range = [0.0, 0.08]

[invocation]
entry_points = ["run"]

[invocation.parameters.approach_speed]
type = "real"
unit = "m/s"
range = [0.05, 0.2]
required = false
default = 0.1

[invocation.preconditions.gripper_width]
min = 0.04

[invocation.postconditions.held]
equals = true

[permissions]
channels = ["arm", "gripper"]
commands = ["tool-pose", "gripper", "stop"]
zones = ["work", "transit"]
tools = ["parallel-gripper"]
max_speed_m_s = 0.2
max_force_n = 20.0
authority = 1
resources = { cpu_us_per_tick = 200, memory_kib = 1024 }

[recovery]
rollback_hook = "restore"
safe_abort = { hook = "abort", stop_time_max_ms = 300 }
fallback = { family = "grasp", version = "^1" }
failure_signals = ["grasp_missed", "object_slipped"]

[deployment]
environments = ["sim", "real", "human"]
bundle = "native:grasp"
params = "params.toml"
"#;

pub fn profile(name: ProfileName) -> Profile {
    Profile::builtin(name).unwrap()
}

pub fn manifest() -> Manifest {
    Manifest::parse("manifest.toml", MANIFEST).unwrap()
}

/// The manifest with one text replaced by another; panics if the text is not there.
pub fn manifest_with(from: &str, to: &str) -> Manifest {
    assert!(MANIFEST.contains(from), "{from:?} is not in the manifest");
    Manifest::parse("manifest.toml", &MANIFEST.replace(from, to)).unwrap()
}

/// Exports of code that matches the manifest.
pub fn exports(manifest: &Manifest) -> Interface {
    let mut needs = BTreeSet::new();
    for channel in &manifest.permissions.channels {
        for command in manifest.permissions.commands.iter().filter(|command| channel.takes(**command)) {
            needs.insert(RequiredCommand { channel: *channel, command: *command });
        }
    }
    Interface {
        controller: "grasp".into(),
        semantics_version: semver::Version::new(1, 0, 0),
        entry_points: manifest.invocation.entry_points.clone(),
        inputs: manifest.inputs.clone(),
        outputs: manifest.outputs.clone(),
        parameters: manifest.invocation.parameters.clone(),
        hooks: ["restore", "abort"].map(String::from).into(),
        failure_signals: manifest.recovery.failure_signals.clone(),
        needs,
        sensors: manifest.permissions.sensors.clone(),
        tools: manifest.permissions.tools.clone(),
    }
}

/// A moment of the wall clock, s after a script's beginning.
pub fn at(secs: u32) -> WallTime {
    WallTime::SCRIPT_EPOCH.plus_ms(u64::from(secs) * 1_000)
}

pub fn digest(name: &str) -> Digest {
    Digest::of_parts("test", &[name.as_bytes()])
}

pub fn binding() -> EvidenceBinding {
    EvidenceBinding {
        candidate: digest("candidate"),
        active: Some(digest("active")),
        profile: digest("profile"),
        policy: digest("policy"),
        environment: digest("environment"),
        neighbours: Some(digest("neighbours")),
        anchor: None,
    }
}

pub fn made_under() -> DecisionContext {
    let EvidenceBinding { candidate, active, profile, policy, environment, neighbours, anchor } = binding();
    DecisionContext {
        candidate,
        active,
        policy,
        profile,
        authority: digest("authority"),
        environment,
        neighbours,
        anchor,
        evidence: digest("evidence"),
        rules: RulesVersion::CURRENT,
    }
}

pub const GOOD: EpisodeValues = EpisodeValues { time_s: 4.0, ..EpisodeValues::CLEAN };

/// As many equal pairs as the profile's budget.
pub fn pairs(profile: &Profile) -> PairedEvidence {
    let pairs = (0..u64::from(profile.evaluation.sandbox_pairs))
        .map(|seed| Pair { seed, active: GOOD, candidate: GOOD, live_like: false })
        .collect();
    PairedEvidence { binding: binding(), pairs, hard_stops: Vec::new() }
}

/// Drills with so many passed of 100, in the order rollback, fallback, abort, detect.
pub fn drills(passed: [u32; 4]) -> DrillTallies {
    let [rollback, fallback, abort, detect] =
        passed.map(|passed| DrillTally { passed, failed: 100 - passed, infeasible: 0, failed_alone: 0 });
    DrillTallies { rollback, fallback, abort, detect, ..DrillTallies::default() }
}

pub fn recovery(active: [u32; 4], candidate: [u32; 4]) -> RecoveryEvidence {
    RecoveryEvidence {
        binding: binding(),
        candidate: drills(candidate),
        active: drills(active),
        settling: SettlingTallies::default(),
    }
}

/// A comparison of these pairs and drills, without any of the parts that may be added.
pub fn comparison<'a>(pairs: &'a PairedEvidence, drills: &'a RecoveryEvidence) -> ComparisonEvidence<'a> {
    ComparisonEvidence {
        pairs,
        drills,
        is_settling: false,
        has_live_like: false,
        has_anchor: false,
        anchor: None,
        sequences: None,
        counted: None,
    }
}

pub fn shadow(profile: &Profile) -> ShadowEvidence {
    let sequence = |seed| ShadowSequence {
        seed,
        live_success: true,
        twin_success: true,
        live_policy_hit: false,
        twin_policy_hit: false,
        live_watcher_event: false,
        twin_watcher_event: false,
        output_divergence: 0.01,
        envelope_divergence: 0.01,
        live_conduct: Conduct::default(),
        twin_conduct: Conduct::default(),
        twin_difference: None,
    };
    let sequences = (0..u64::from(profile.evaluation.shadow_sequences)).map(sequence).collect();
    ShadowEvidence {
        binding: binding(),
        sequences,
        hard_stops: Vec::new(),
        outputs: Vec::new(),
        missing: Vec::new(),
    }
}

fn assessment<O>(outcome: O, kappa: f64) -> Assessment<O> {
    Assessment {
        outcome,
        kappa: Some(Kappa::new(kappa).unwrap()),
        basis: Basis::Measured,
        reasons: Vec::new(),
        conditions: Vec::new(),
    }
}

/// Assessments as the thresholds alone make them of four values.
pub fn kappas(profile: &Profile, [i, p, b, r]: [f64; 4]) -> Kappas {
    let t = &profile.thresholds;
    let pick = |good: bool| usize::from(good);
    Kappas {
        interface: assessment(
            [InterfaceOutcome::Incompatible, InterfaceOutcome::Compatible][pick(i >= t.interface())],
            i,
        ),
        policy: assessment(
            [PolicyOutcome::Incompatible, PolicyOutcome::Compatible][pick(p >= t.policy())],
            p,
        ),
        behavior: assessment(
            [BehaviorOutcome::Incompatible, BehaviorOutcome::Compatible][pick(b >= t.behavior())],
            b,
        ),
        recovery: assessment(
            [RecoveryOutcome::Incompatible, RecoveryOutcome::Compatible][pick(r >= t.recovery())],
            r,
        ),
    }
}

/// A generator of uniform numbers; the same series every time.
pub struct Uniform(pub u64);

impl Uniform {
    pub fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((mixed ^ (mixed >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }
}
