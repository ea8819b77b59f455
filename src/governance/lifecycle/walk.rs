//! The life of a family walked exhaustively: a baseline and two candidates, crashes, restarts and changes of
//! the profile at any point, against the invariants of the lifecycle; and for every rule a mutant without it,
//! which the walk has to catch.
//!
//! The ordinary run walks two parts: everything that can happen with one candidate, and what two candidates can do to
//! each other. The second part omits aborting, repeating, pausing, restricting and confirming, which look at one
//! version only. `HOLDPOINT_WALK=full` walks the whole space of two candidates, which takes more than 15 minutes.
//!
//! A robot, like a profile, is part of what [`LifecycleEvent::ContextChanged`] stands for, with the mutant
//! `ContextChangeVoids`. The agent's identity is in no state of a family, and no event moves it. So this walk omits
//! it; the engine's tests cover every entry point for another agent.
//!
//! Counters are brought back to "the present one" or "an earlier one" after each step, so that the space is
//! finite without a bound on the length of a history.

use std::collections::{BTreeSet, HashSet, VecDeque};

use super::apply::apply_under;
use super::rules::{AllLifecycleRules, LifecycleRule, LifecycleRules};
use super::{
    DeactivationKind, FamilyState, LifecycleChange, LifecycleEvent, Stage, State, ValidityStamp, Version,
    VersionFlags, VersionRef,
};
use crate::wall_time::WallTime;

const VERSIONS: usize = 3;
/// No walk may grow beyond this.
const WORLDS_MAX: usize = 60_000_000;

/// The true history of a version, recorded by the walk and not by the product.
#[derive(Clone, Copy, Default, PartialEq, Eq, Debug)]
struct VersionTruth {
    sandbox: bool,
    shadow: bool,
    gate: bool,
    approval: bool,
    /// The stage that a live engine is working on.
    started: Option<Stage>,
}

#[derive(Clone, PartialEq, Eq, Debug)]
struct WalkWorld {
    family: FamilyState,
    truth: [VersionTruth; VERSIONS],
    /// The unreviewed version that one person activated.
    unreviewed: Option<VersionRef>,
    /// The versions that were in control before.
    acted: [bool; VERSIONS],
    /// Versions restricted now or when they left: until people lift it or the gate activates them again.
    restricted: [bool; VERSIONS],
    /// The versions whose window is not passed.
    provisional: [bool; VERSIONS],
}

fn stamp_code(stamp: Option<ValidityStamp>) -> u128 {
    stamp.map_or(0, |stamp| 1 + u128::from(stamp.context) * 2 + u128::from(stamp.round))
}

fn stage_code(stage: Option<Stage>) -> u128 {
    match stage {
        None => 0,
        Some(Stage::Validation) => 1,
        Some(Stage::Sandbox) => 2,
        Some(Stage::Shadow) => 3,
        Some(Stage::Activation) => 4,
    }
}

/// Counters become 1 = the present one, 0 = an earlier one.
fn canonical(mut world: WalkWorld) -> WalkWorld {
    let context = world.family.context;
    for version in &mut world.family.versions {
        let round = version.round;
        let stamps = [&mut version.sandbox, &mut version.shadow, &mut version.gate, &mut version.approval];
        for stamp in stamps.into_iter().flatten() {
            *stamp = ValidityStamp {
                context: u32::from(stamp.context == context),
                round: u32::from(stamp.round == round),
            };
        }
        // Sandbox and shadow evidence holds over rounds: repeating shadow keeps the sandbox.
        for stamp in [&mut version.sandbox, &mut version.shadow].into_iter().flatten() {
            stamp.round = 1;
        }
        version.round = 1;
        version.row_version = 1;
    }
    // How a version left control is looked at where it can come back. That a candidate keeps it is tested by itself: here
    // it would multiply everything that can be measured of one.
    for (index, version) in world.family.versions.iter_mut().enumerate() {
        if matches!(version.state, State::Registered | State::Validated | State::Sandboxed | State::Shadowed)
        {
            (version.left_restricted, version.left_provisional) = (false, false);
            (world.restricted[index], world.provisional[index]) = (false, false);
        }
    }
    world.family.context = 1;
    world
}

/// The world as a number, for the set of worlds seen.
fn key(world: &WalkWorld) -> u128 {
    let mut key = u128::from(world.family.safe_stopped) | u128::from(world.family.needs_approval) << 1;
    let mut at = 2;
    let mut put = |value: u128, bits: u32| {
        assert!(value < 1 << bits, "a field of the key is too narrow");
        key |= value << at;
        at += bits;
    };
    put(world.family.versions.len() as u128, 2);
    for (index, version) in world.family.versions.iter().enumerate() {
        let (acted, restricted, provisional) =
            (world.acted[index], world.restricted[index], world.provisional[index]);
        for bit in
            [version.acted, acted, version.left_restricted, restricted, version.left_provisional, provisional]
        {
            put(u128::from(bit), 1);
        }
    }
    for version in [world.family.review.map(|review| review.version), world.unreviewed] {
        put(version.map_or(0, |version| u128::from(version.0) + 1), 2);
    }
    for (version, truth) in world.family.versions.iter().zip(&world.truth) {
        let flags = version.flags;
        put(State::ALL.iter().position(|state| *state == version.state).unwrap() as u128, 4);
        put(stage_code(flags.running), 3);
        let bits = [
            flags.paused,
            flags.awaiting_approval,
            flags.provisional,
            flags.restricted,
            flags.rollback_pending,
        ];
        for bit in bits {
            put(u128::from(bit), 1);
        }
        put(version.predecessor.map_or(0, |p| u128::from(p.0) + 1), 2);
        put(stamp_code(version.sandbox), 3);
        put(stamp_code(version.shadow), 3);
        put(stamp_code(version.gate), 3);
        put(stamp_code(version.approval), 3);
        for bit in [truth.sandbox, truth.shadow, truth.gate, truth.approval] {
            put(u128::from(bit), 1);
        }
        put(stage_code(truth.started), 3);
    }
    assert!(at <= 128);
    key
}

/// The walked part of the space.
#[derive(Clone, Copy)]
struct WalkPart {
    versions: usize,
    /// Aborting, repeating, pausing, restricting, releasing, confirming and expiries too.
    single_version_events: bool,
}

const ONE_CANDIDATE: WalkPart = WalkPart { versions: 2, single_version_events: true };
const TWO_CANDIDATES: WalkPart = WalkPart { versions: 3, single_version_events: false };
const EVERYTHING: WalkPart = WalkPart { versions: 3, single_version_events: true };

fn events(world: &WalkWorld, part: WalkPart) -> Vec<LifecycleEvent> {
    let mut out = Vec::new();
    if world.family.versions.len() < part.versions {
        out.push(LifecycleEvent::Register);
    }
    out.extend([LifecycleEvent::Bootstrap, LifecycleEvent::Restart]);
    out.extend([true, false].map(|needs_approval| LifecycleEvent::ContextChanged { needs_approval }));
    for index in 0..world.family.versions.len() {
        let version = VersionRef(u16::try_from(index).unwrap());
        for stage in Stage::ALL {
            out.push(LifecycleEvent::Start { version, stage });
            out.push(LifecycleEvent::Pass { version, stage });
        }
        let row_version = world.family.versions[index].row_version;
        out.extend([
            LifecycleEvent::Demote { version },
            LifecycleEvent::Reject { version },
            LifecycleEvent::RequestApproval { version },
            LifecycleEvent::Approved { version, row_version },
            LifecycleEvent::Approved { version, row_version: row_version - 1 },
            LifecycleEvent::Activate { version },
            LifecycleEvent::ActivateUnreviewed { version, until: WallTime::default() },
            LifecycleEvent::Reviewed { version },
            LifecycleEvent::BeginRollback { version },
            LifecycleEvent::FinishRollback { version, leave: DeactivationKind::RolledBack },
            LifecycleEvent::FinishRollback { version, leave: DeactivationKind::Demoted },
            LifecycleEvent::FailRollback { version },
            LifecycleEvent::Rearm { version },
        ]);
        if part.single_version_events {
            out.extend(Stage::ALL.map(|stage| LifecycleEvent::Repeat { version, stage }));
            out.extend([
                LifecycleEvent::Abort { version },
                LifecycleEvent::ApprovalExpired { version },
                LifecycleEvent::Confirm { version },
                LifecycleEvent::Restrict { version },
                LifecycleEvent::Release { version },
            ]);
        }
        // Pausing is walked on the second version; its rule does not look at any other.
        if part.single_version_events && index == 1 {
            out.extend([LifecycleEvent::Pause { version }, LifecycleEvent::Resume { version }]);
        }
    }
    out
}

/// The true effect of the event, by the walk's own records.
fn follow(before: &WalkWorld, event: LifecycleEvent, after: &mut WalkWorld) {
    let index = |version: VersionRef| usize::from(version.0);
    match event {
        LifecycleEvent::Start { version, stage } => after.truth[index(version)].started = Some(stage),
        LifecycleEvent::Repeat { version, stage } => {
            let truth = &mut after.truth[index(version)];
            *truth = VersionTruth {
                sandbox: truth.sandbox && stage == Stage::Shadow,
                started: Some(stage),
                ..VersionTruth::default()
            };
        }
        LifecycleEvent::Pass { version, stage } => {
            let truth = &mut after.truth[index(version)];
            truth.started = None;
            match stage {
                Stage::Validation => {}
                Stage::Sandbox => truth.sandbox = true,
                Stage::Shadow => truth.shadow = true,
                Stage::Activation => truth.gate = true,
            }
        }
        LifecycleEvent::Abort { version } => after.truth[index(version)].started = None,
        LifecycleEvent::Approved { version, row_version } => {
            let present = before.family.versions[index(version)].row_version == row_version;
            after.truth[index(version)].approval = present;
        }
        LifecycleEvent::RequestApproval { version } | LifecycleEvent::ApprovalExpired { version } => {
            after.truth[index(version)].approval = false;
        }
        LifecycleEvent::Release { version } => {
            after.truth[index(version)].approval = false;
            after.restricted[index(version)] = false;
        }
        LifecycleEvent::Restrict { version } => after.restricted[index(version)] = true,
        LifecycleEvent::Activate { version } => {
            after.restricted[index(version)] = false;
            after.provisional[index(version)] = true;
        }
        LifecycleEvent::Confirm { version } => after.provisional[index(version)] = false,
        LifecycleEvent::Bootstrap
        | LifecycleEvent::Register
        | LifecycleEvent::Demote { .. }
        | LifecycleEvent::Reject { .. }
        | LifecycleEvent::Close { .. }
        | LifecycleEvent::Open { .. }
        | LifecycleEvent::BeginRollback { .. }
        | LifecycleEvent::FinishRollback { .. }
        | LifecycleEvent::FailRollback { .. }
        | LifecycleEvent::Rearm { .. }
        | LifecycleEvent::Pause { .. }
        | LifecycleEvent::Resume { .. }
        | LifecycleEvent::ContextChanged { .. } => {}
        LifecycleEvent::ActivateUnreviewed { version, .. } => {
            after.unreviewed = Some(version);
            after.restricted[index(version)] = false;
            after.provisional[index(version)] = true;
        }
        LifecycleEvent::Reviewed { .. } => after.unreviewed = None,
        // Nothing can happen between a crash and the restart, so they are one step: no stage is at work after it.
        LifecycleEvent::Restart => after.truth.iter_mut().for_each(|truth| truth.started = None),
    }
    if let Some(active) = after.family.active() {
        after.acted[index(active)] = true;
    }
    for (index, version) in after.family.versions.iter().enumerate() {
        if version.state.is_terminal() {
            (after.restricted[index], after.provisional[index]) = (false, false);
        }
    }
    let moved = before.family.active() != after.family.active();
    if moved || matches!(event, LifecycleEvent::ContextChanged { .. }) {
        for truth in &mut after.truth {
            *truth = VersionTruth { started: truth.started, ..VersionTruth::default() };
        }
    }
    for (index, version) in after.family.versions.iter().enumerate() {
        let was = before.family.versions.get(index).map(|version| version.state);
        let truth = &mut after.truth[index];
        if was != Some(version.state)
            && matches!(version.state, State::Demoted | State::Rejected | State::RolledBack)
        {
            truth.gate = false;
            truth.approval = false;
            truth.shadow = false;
            if !matches!(event, LifecycleEvent::Repeat { .. }) {
                truth.started = None;
            }
        }
    }
}

/// The invariants of every world.
fn state_problem(world: &WalkWorld) -> Option<&'static str> {
    let family = &world.family;
    let active: Vec<&Version> =
        family.versions.iter().filter(|version| version.state == State::Active).collect();
    if active.len() != usize::from(!family.safe_stopped) {
        return Some("exactly one active version, or safe-stopped");
    }
    if family.versions[0].state == State::Rejected {
        return Some("the version that a stopped family returns to was rejected");
    }
    let target =
        |version: &Version| version.predecessor.is_none_or(|p| family.state(p) == Some(State::Superseded));
    if !active.iter().all(|version| target(version)) {
        return Some("the rollback target is superseded and so can be restored");
    }
    for version in &family.versions {
        let VersionFlags { running, provisional, restricted, rollback_pending, awaiting_approval, .. } =
            version.flags;
        if version.state != State::Active && (provisional || restricted || rollback_pending) {
            return Some("only an active version is provisional, restricted or being rolled back");
        }
        if running.is_some()
            && matches!(
                version.state,
                State::Active | State::Superseded | State::Rejected | State::RolledBack
            )
        {
            return Some("no stage runs on a version that is not a candidate");
        }
        if awaiting_approval && !matches!(version.state, State::Shadowed | State::Active) {
            return Some("people are asked about shadowed and active versions only");
        }
    }
    if family.review.map(|review| review.version) != world.unreviewed {
        return Some("a review is open from an emergency activation until people have reviewed it");
    }
    None
}

/// The invariants of every step.
fn step_problem(
    before: &WalkWorld,
    event: LifecycleEvent,
    after: &WalkWorld,
    changes: &[LifecycleChange],
) -> Option<&'static str> {
    let (old, new) = (&before.family, &after.family);
    for (index, (was, is)) in old.versions.iter().zip(&new.versions).enumerate() {
        if was.state != is.state && !was.state.may_become(is.state) {
            let through_demoted =
                matches!(event, LifecycleEvent::Repeat { .. }) && is.state == State::Demoted;
            if !through_demoted || was.state.is_terminal() {
                return Some("a change of state that the table does not have");
            }
        }
        let advanced = was.state != is.state
            && !matches!(is.state, State::Demoted | State::Rejected | State::RolledBack | State::Superseded);
        let by_others = matches!(event, LifecycleEvent::FinishRollback { .. });
        if advanced && was.flags.paused && !by_others {
            return Some("a paused version advanced");
        }
        if is.state == State::Active && was.state == State::Shadowed {
            let truth = &before.truth[index];
            if !(truth.gate && truth.sandbox && truth.shadow) {
                return Some("active without a passed gate on current evidence");
            }
            if old.needs_approval && !truth.approval {
                return Some("active without the approvals the profile needs");
            }
        }
        if is.state == State::Active && was.state == State::Demoted {
            let rearmed = matches!(event, LifecycleEvent::Rearm { .. }) && old.safe_stopped;
            if !rearmed || !before.acted[index] {
                return Some("a demoted version acts again that never did, or without being reactivated");
            }
            if old.needs_approval && index != 0 {
                return Some("a demoted version acts again beside the gate, where people decide");
            }
        }
        if is.state == State::Active && is.flags.restricted != after.restricted[index] {
            return Some("a version is in control and not as restricted as it was");
        }
        if is.state == State::Active && is.flags.provisional != after.provisional[index] {
            return Some("a version is in control whose window counts as passed and is not");
        }
        if is.state == State::Active && was.state == State::Shadowed && before.unreviewed.is_some() {
            return Some("a promotion while a review is open");
        }
        let confirmed = was.state == State::Active
            && is.state == State::Active
            && was.flags.provisional
            && !is.flags.provisional;
        if confirmed && was.flags.restricted {
            return Some("a restricted version was confirmed");
        }
        if confirmed && before.unreviewed.is_some_and(|version| usize::from(version.0) == index) {
            return Some("an unreviewed version was confirmed");
        }
        if was.flags.restricted
            && !is.flags.restricted
            && is.state == State::Active
            && old.needs_approval
            && !before.truth[index].approval
        {
            return Some("a restriction was lifted without approval");
        }
        if was.state == State::Active
            && matches!(is.state, State::RolledBack | State::Demoted)
            && !was.flags.rollback_pending
        {
            return Some("the binding moved before the command authority was revoked");
        }
    }
    if let LifecycleEvent::Pass { version, stage } = event
        && before.truth[usize::from(version.0)].started != Some(stage)
    {
        return Some("a stage was passed that did not run");
    }
    if !reported(old, new, changes) {
        return Some("a change was not reported");
    }
    None
}

/// Whether the reported changes lead from the old family to the new one.
fn reported(old: &FamilyState, new: &FamilyState, changes: &[LifecycleChange]) -> bool {
    let mut states: Vec<(State, VersionFlags)> = old.versions.iter().map(|v| (v.state, v.flags)).collect();
    let (mut active, mut stopped) = (old.active(), old.safe_stopped);
    let mut review = old.review.map(|review| review.version);
    for change in changes {
        match *change {
            LifecycleChange::Added { state, .. } => states.push((state, VersionFlags::default())),
            LifecycleChange::State { version, from, to } => {
                let slot = &mut states[usize::from(version.0)].0;
                if *slot != from {
                    return false;
                }
                *slot = to;
            }
            LifecycleChange::Flags { version, to, .. } => states[usize::from(version.0)].1 = to,
            LifecycleChange::Active { to, .. } => active = to,
            LifecycleChange::SafeStopped { stopped: to } => stopped = to,
            LifecycleChange::Review { open } => review = open,
            LifecycleChange::Standing { .. } | LifecycleChange::Context { .. } => {}
        }
    }
    let wanted: Vec<(State, VersionFlags)> = new.versions.iter().map(|v| (v.state, v.flags)).collect();
    let reviewed = review == new.review.map(|review| review.version);
    states == wanted && active == new.active() && stopped == new.safe_stopped && reviewed
}

#[derive(Default)]
struct LifecycleWalk {
    worlds: usize,
    steps: usize,
    problem: Option<(&'static str, String)>,
    /// A candidate became active; the baseline came back; two successors in a row; a stopped family was reactivated; a
    /// break-glass activation was reviewed while active; a demoted version passed a stage again.
    reached: [bool; 6],
    rows: BTreeSet<(State, VersionFlags)>,
}

fn walk<R: LifecycleRules>(rules: R, part: WalkPart) -> LifecycleWalk {
    let mut start = WalkWorld {
        family: FamilyState::empty(true),
        truth: [VersionTruth::default(); VERSIONS],
        unreviewed: None,
        acted: [true, false, false],
        restricted: [false; VERSIONS],
        provisional: [false; VERSIONS],
    };
    start.family = apply_under(AllLifecycleRules, &start.family, LifecycleEvent::Bootstrap).unwrap().0;
    let start = canonical(start);
    let mut seen = HashSet::from([key(&start)]);
    let mut open = VecDeque::from([start]);
    let mut walk = LifecycleWalk { worlds: 1, ..LifecycleWalk::default() };
    while let Some(world) = open.pop_front() {
        let mut next: Vec<WalkWorld> = Vec::new();
        for event in events(&world, part) {
            let Ok((family, changes)) = apply_under(rules, &world.family, event) else { continue };
            let WalkWorld { truth, unreviewed, acted, restricted, provisional, .. } = world;
            let mut after = WalkWorld { family, truth, unreviewed, acted, restricted, provisional };
            follow(&world, event, &mut after);
            walk.steps += 1;
            if let Some(problem) = step_problem(&world, event, &after, &changes) {
                walk.problem = Some((problem, format!("{event:?} in {world:?}")));
                return walk;
            }
            let chain = after
                .family
                .versions
                .get(2)
                .is_some_and(|v| v.state == State::Active && v.predecessor == Some(VersionRef(1)));
            walk.reached[0] |= after.family.active().is_some_and(|active| active.0 > 0);
            walk.reached[1] |= matches!(event, LifecycleEvent::FinishRollback { .. })
                && after.family.active() == Some(VersionRef(0));
            walk.reached[2] |= chain && after.family.versions[1].predecessor == Some(VersionRef(0));
            walk.reached[3] |= matches!(event, LifecycleEvent::Rearm { .. });
            walk.reached[4] |= matches!(event, LifecycleEvent::Reviewed { .. })
                && after.family.active().is_some_and(|active| active.0 > 0);
            walk.reached[5] |= matches!(event, LifecycleEvent::Pass { version, .. }
                if world.family.state(version) == Some(State::Demoted));
            next.push(canonical(after));
        }
        for world in next {
            if !seen.insert(key(&world)) {
                continue;
            }
            if let Some(problem) = state_problem(&world) {
                walk.problem = Some((problem, format!("{world:?}")));
                return walk;
            }
            walk.rows.extend(world.family.versions.iter().map(|version| (version.state, version.flags)));
            walk.worlds += 1;
            assert!(walk.worlds <= WORLDS_MAX, "more worlds than {WORLDS_MAX}");
            open.push_back(world);
        }
    }
    walk
}

#[test]
#[allow(
    clippy::disallowed_methods,
    reason = "the long walk is asked for from outside; the rules read no environment"
)]
fn every_lifecycle_history_keeps_the_invariants() {
    // A changed count means a changed lifecycle: explain it in the commit message.
    let found = [ONE_CANDIDATE, TWO_CANDIDATES].map(|part| {
        let walk = walk(AllLifecycleRules, part);
        assert_eq!(walk.problem, None);
        walk.rows.iter().copied().for_each(crate::version_status::tests::assert_row_shows_its_own_state);
        (walk.worlds, walk.steps, walk.reached)
    });
    let known = [
        (71_446, 746_942, [true, true, false, true, true, true]),
        (18_272, 163_359, [true, true, true, true, true, false]),
    ];
    assert_eq!(found, known);
    if std::env::var("HOLDPOINT_WALK").is_ok_and(|value| value == "full") {
        let walk = walk(AllLifecycleRules, EVERYTHING);
        assert_eq!((walk.problem, walk.reached), (None, [true; 6]));
        // How many there are since versions keep how they left control was never counted to the end.
        println!("everything: {} worlds, {} steps", walk.worlds, walk.steps);
    }
}

/// Every rule but one.
#[derive(Clone, Copy)]
struct LifecycleRulesExcept(LifecycleRule);

impl LifecycleRules for LifecycleRulesExcept {
    fn demand(self, rule: LifecycleRule) -> bool {
        self.0 != rule
    }
}

#[test]
fn every_omitted_lifecycle_rule_is_detected() {
    let mutants: [(LifecycleRule, WalkPart); 31] = [
        (LifecycleRule::SupersedeOld, TWO_CANDIDATES),
        (LifecycleRule::ActiveLeavesByRollback, ONE_CANDIDATE),
        (LifecycleRule::PinPredecessor, TWO_CANDIDATES),
        (LifecycleRule::RestorePredecessor, TWO_CANDIDATES),
        (LifecycleRule::StopWithoutTarget, ONE_CANDIDATE),
        (LifecycleRule::RevokeFirst, ONE_CANDIDATE),
        (LifecycleRule::BindGate, TWO_CANDIDATES),
        (LifecycleRule::BindApproval, TWO_CANDIDATES),
        (LifecycleRule::BindRow, TWO_CANDIDATES),
        (LifecycleRule::BindEvidence, TWO_CANDIDATES),
        (LifecycleRule::ActiveChangeVoids, TWO_CANDIDATES),
        (LifecycleRule::ContextChangeVoids, TWO_CANDIDATES),
        (LifecycleRule::RepeatVoids, ONE_CANDIDATE),
        (LifecycleRule::PauseBlocks, ONE_CANDIDATE),
        (LifecycleRule::TerminalIsFinal, ONE_CANDIDATE),
        (LifecycleRule::RestartAborts, ONE_CANDIDATE),
        (LifecycleRule::StopHolds, TWO_CANDIDATES),
        (LifecycleRule::PassNeedsRun, ONE_CANDIDATE),
        (LifecycleRule::ReviewBlocks, TWO_CANDIDATES),
        (LifecycleRule::EmergencyOpensReview, TWO_CANDIDATES),
        (LifecycleRule::ReviewOutlives, TWO_CANDIDATES),
        (LifecycleRule::ReviewBeforeConfirm, ONE_CANDIDATE),
        (LifecycleRule::ReleaseBeforeConfirm, ONE_CANDIDATE),
        (LifecycleRule::BindRelease, ONE_CANDIDATE),
        (LifecycleRule::RearmActedOnly, ONE_CANDIDATE),
        (LifecycleRule::KeepFirst, ONE_CANDIDATE),
        (LifecycleRule::RearmThroughGate, ONE_CANDIDATE),
        (LifecycleRule::RestrictionOutlives, ONE_CANDIDATE),
        (LifecycleRule::WindowOutlives, TWO_CANDIDATES),
        (LifecycleRule::RepeatOffControl, ONE_CANDIDATE),
        (LifecycleRule::ReportChanges, ONE_CANDIDATE),
    ];
    for (rule, part) in mutants {
        let found = walk(LifecycleRulesExcept(rule), part).problem;
        assert!(found.is_some(), "the walk does not notice that {rule:?} is missing");
    }
}
