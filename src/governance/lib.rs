//! The rules: pure functions over plain data. No I/O, no clock, no randomness, no async.
//!
//! Takes texts and values and returns decisions with reasons; the caller opens files, measures episodes and keeps
//! time. It needs no simulator, store or screen, so the software of another robot can use it as a library with its own
//! machinery.
//!
//! # Judging a candidate with your own robot
//!
//! 1. **Parse** the manifests of the candidate and of the active version ([`manifest::Manifest::parse`]) and the
//!    profile with its policies ([`profile::Profile`], [`policy::PolicyTable`]). Each has a digest.
//! 2. **Read from the code** what it exports and needs ([`exports::Interface`]). The loader of the bundles supplies it;
//!    a copy of the manifest would make the comparison worthless.
//! 3. **Check what can be checked without running anything**: [`interface::assess`] and [`policy::assess`].
//! 4. **Measure** both versions on the same seeds and drill recovery, in your simulator or cell, and
//!    keep the raw values: [`evidence::PairedEvidence`] for [`behavior::assess`], [`evidence::RecoveryEvidence`] for
//!    [`recovery::assess`]. Evidence is bound to digests; evidence for other digests counts as no data. [`tries`] says
//!    how strictly the next try of an author is tested, and how many pairs it takes.
//! 5. **Join** the four results with [`composition::psi`], which names the next permitted stage and the reasons.
//! 6. After shadow, [`gate::assess_shadow`] and [`gate::evaluate`] decide on activation; on the robot [`monitor`]
//!    watches, and [`rollback`] and [`lifecycle`] define what may follow.
//!
//! The example takes a better version of a skill through steps 1 to 5, and then one that would break its callers.
//!
//! ```
//! use std::collections::BTreeMap;
//!
//! use holdpoint_governance::composition::{Kappas, psi};
//! use holdpoint_governance::decision::{DecisionContext, ReasonCode};
//! use holdpoint_governance::evidence::{
//!     DrillTallies, DrillTally, EpisodeValues, EvidenceBinding, Pair, PairedEvidence, RecoveryEvidence,
//!     SettlingTallies,
//! };
//! use holdpoint_governance::exports::Interface;
//! use holdpoint_governance::ids::Digest;
//! use holdpoint_governance::interface::{self, InterfaceInput, RegisteredVersion};
//! use holdpoint_governance::manifest::Manifest;
//! use holdpoint_governance::outcome::{InterfaceOutcome, PolicyOutcome, Recommendation};
//! use holdpoint_governance::policy::{self, PolicyInput, PolicyTable};
//! use holdpoint_governance::profile::{Profile, ProfileName};
//! use holdpoint_governance::rules_version::RulesVersion;
//! use holdpoint_governance::{behavior, recovery};
//!
//! // 1. Two versions of a skill that wipes a surface, and the rules of the place they run in.
//! const ACTIVE: &str = r#"
//! name = "wipe"
//! version = "1.0.0"
//!
//! [inputs.surface]
//! type = "pose"
//! unit = "m"
//! frame = "world"
//!
//! [outputs.outcome]
//! type = "enum"
//! values = ["done", "failed"]
//!
//! [invocation]
//! entry_points = ["wipe"]
//!
//! [permissions]
//! channels = ["arm"]
//! commands = ["stop", "tool-pose"]
//! zones = ["work", "transit"]
//! sensors = ["joints", "wrist-force"]
//! tools = ["parallel-gripper"]
//! max_speed_m_s = 0.4
//! max_force_n = 20.0
//! authority = 1
//!
//! [permissions.resources]
//! cpu_us_per_tick = 50
//! memory_kib = 256
//!
//! [recovery]
//! rollback_hook = "rollback"
//! failure_signals = ["timed_out"]
//!
//! [recovery.fallback]
//! family = "park"
//! version = "^1"
//!
//! [recovery.safe_abort]
//! hook = "safe-abort"
//! stop_time_max_ms = 400
//!
//! [deployment]
//! environments = ["sim", "real"]
//! bundle = "native:wipe"
//! "#;
//! let active = Manifest::parse("wipe/1.0.0", ACTIVE)?;
//! let candidate = Manifest::parse("wipe/1.1.0", &ACTIVE.replace("1.0.0", "1.1.0"))?;
//! let profile = Profile::builtin(ProfileName::Sim)?;
//! let table = PolicyTable::builtin(&profile)?;
//!
//! // 2. What the loader found in the candidate's code.
//! let exports: Interface = serde_json::from_value(serde_json::json!({
//!     "controller": "wipe",
//!     "semantics_version": "1.0.0",
//!     "entry_points": ["wipe"],
//!     "inputs": candidate.inputs,
//!     "outputs": candidate.outputs,
//!     "parameters": {},
//!     "hooks": ["rollback", "safe-abort"],
//!     "failure_signals": ["timed_out"],
//!     "needs": [{ "channel": "arm", "command": "stop" }, { "channel": "arm", "command": "tool-pose" }],
//! }))?;
//! let registered =
//!     [RegisteredVersion { id: active.id(), active: true, dependencies: BTreeMap::new() }];
//!
//! // 3. Interface and policy, without running anything.
//! let look = |candidate: &Manifest| {
//!     let input = InterfaceInput {
//!         candidate,
//!         exports: Some(&exports),
//!         active: Some(&active),
//!         registered: &registered,
//!     };
//!     interface::assess(&input, &profile.thresholds).assessment
//! };
//! let interface = look(&candidate);
//! assert_eq!(interface.outcome, InterfaceOutcome::Compatible);
//! let input = PolicyInput {
//!     permissions: &candidate.permissions,
//!     environments: &candidate.deployment.environments,
//!     exports: Some(&exports),
//!     active: Some(&active.permissions),
//! };
//! let policy = policy::assess(&input, &table, &profile).assessment;
//! assert_eq!(policy.outcome, PolicyOutcome::Compatible);
//!
//! // 4. Both versions on the same seeds, and the same drills with both. Your cell measures them.
//! let binding = EvidenceBinding {
//!     candidate: candidate.digest()?,
//!     active: Some(active.digest()?),
//!     profile: profile.digest()?,
//!     policy: table.digest,
//!     environment: Digest::of_parts("example", &[b"cell 7"]),
//!     neighbours: None,
//!     anchor: None,
//! };
//! let episode =
//!     |success| EpisodeValues { success, recovery: !success, time_s: 3.0, ..EpisodeValues::CLEAN };
//! let pairs = (0..u64::from(profile.evaluation.sandbox_pairs))
//!     .map(|seed| Pair {
//!         seed,
//!         active: episode(seed % 4 != 0),
//!         candidate: episode(seed % 40 != 0),
//!         live_like: false,
//!     })
//!     .collect();
//! let episodes = PairedEvidence { binding, pairs, hard_stops: Vec::new() };
//! let behavior = behavior::assess(&episodes, &binding, &profile).assessment;
//!
//! let all = DrillTally { passed: profile.evaluation.drills_per_kind, failed: 0, infeasible: 0, failed_alone: 0 };
//! let drills = DrillTallies { rollback: all, fallback: all, abort: all, detect: all, ..DrillTallies::default() };
//! let settling = SettlingTallies::default();
//! let rehearsed = RecoveryEvidence { binding, candidate: drills, active: drills, settling };
//! let recovery = recovery::assess(&rehearsed, &binding, &profile).assessment;
//!
//! // 5. The next permitted stage.
//! let under = DecisionContext {
//!     candidate: binding.candidate,
//!     active: binding.active,
//!     policy: binding.policy,
//!     profile: binding.profile,
//!     authority: Digest::of_parts("example", &[b"no approval in sim"]),
//!     environment: binding.environment,
//!     neighbours: binding.neighbours,
//!     anchor: binding.anchor,
//!     evidence: Digest::of_json("example.evidence", &episodes)?,
//!     rules: RulesVersion::CURRENT,
//! };
//! let has_approver = profile.has_approver();
//! let mut kappas = Kappas { interface, policy, behavior, recovery };
//! let decision = psi(&kappas, has_approver, under);
//! assert_eq!(*decision.outcome(), Recommendation::Activate);
//! assert!(decision.answers().admitted && decision.has(ReasonCode::CompositionEligible));
//!
//! // Evidence of another version is no evidence, and no evidence does not advance.
//! let other = EvidenceBinding { candidate: active.digest()?, ..binding };
//! kappas.behavior = behavior::assess(&episodes, &other, &profile).assessment;
//! assert_eq!(*psi(&kappas, has_approver, under).outcome(), Recommendation::Sandbox);
//!
//! // A surface given in the tool's frame: callers of the active version would wipe somewhere else.
//! let broken = ACTIVE.replace("1.0.0", "1.2.0").replace("frame = \"world\"", "frame = \"tool\"");
//! kappas.interface = look(&Manifest::parse("wipe/1.2.0", &broken)?);
//! let decision = psi(&kappas, has_approver, under);
//! assert_eq!(*decision.outcome(), Recommendation::Reject);
//! assert_eq!(decision.reasons()[0].code, ReasonCode::InterfaceSignatureBreaking);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # What the rules leave to their caller
//!
//! A decision grants nothing by itself. Your software has to ensure three things: a candidate has no handle to the
//! robot before [`gate::GatePassed`] exists; every command passes a guard that reads the same [`policy::PolicyTable`];
//! a change of state is written together with its record. Here the crates `holdpoint-runtime`, `holdpoint-engine` and
//! `holdpoint-registry` do that.

#![warn(missing_docs)]

// The expansion of `closed_set!` names this crate by its name, here as in the crates that use it.
extern crate self as holdpoint_governance;

pub mod ablation;
pub mod alarms;
mod alignment;
pub mod approval;
pub mod behavior;
pub mod cached_result;
pub mod calendar;
pub mod cell_ability;
pub mod closed_set;
pub mod comparison_evidence;
pub mod component;
pub mod composition;
pub mod condition;
pub mod decision;
pub mod deployability;
pub mod distribution_shift;
pub mod early_stop;
pub mod evaluation_key;
pub mod evidence;
pub mod explanation;
pub mod exports;
pub mod failure_cause;
pub mod finding;
pub mod gate;
pub mod harm;
pub mod health;
pub mod ids;
pub mod interface;
pub mod kappa;
pub mod lifecycle;
pub mod live_harm;
pub mod manifest;
pub mod metrics;
pub mod mode;
pub mod monitor;
pub mod notice;
pub mod outcome;
pub mod past_limit;
pub mod permission;
pub mod phase;
pub mod policy;
pub mod policy_hit;
mod policy_table;
pub mod profile;
pub mod profile_downgrade;
pub mod record;
pub mod recovery;
pub mod registration_rate;
pub mod risk;
pub mod rollback;
pub mod rules_version;
pub mod sensor_health;
pub mod shared_event;
pub mod site;
pub mod site_profile;
pub mod start_domain;
pub mod startup_stop;
pub mod stats;
pub mod store_finding;
pub mod strictness;
pub mod submission;
pub mod text_error;
pub mod time_excess;
pub mod tries;
pub mod value_type;
pub mod version_status;
pub mod wall_time;
pub mod watcher_signal;
pub mod worst_case_search;
mod zone_name;

pub use text_error::TextError;
