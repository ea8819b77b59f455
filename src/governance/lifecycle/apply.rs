//! The transition function: from a family and an event to the new family and its changes, or a refusal.
//! States change only here. The program demands every [`LifecycleRule`]; the test `walk.rs` omits one at a time.

use super::changes::changes;
use super::rules::{AllLifecycleRules, LifecycleRefusal, LifecycleRule, LifecycleRules};
use super::{
    DeactivationKind, FamilyState, LifecycleChange, LifecycleEvent, Review, Stage, State, VERSIONS_MAX,
    ValidityStamp, Version, VersionFlags, VersionRef,
};
use crate::profile::ProfileName;

/// Applies an event under all rules.
///
/// # Errors
/// [`LifecycleRefusal`] with the reason; the family is then as before.
pub fn apply(
    family: &FamilyState,
    event: LifecycleEvent,
) -> Result<(FamilyState, Vec<LifecycleChange>), LifecycleRefusal> {
    apply_under(AllLifecycleRules, family, event)
}

pub(super) fn apply_under<R: LifecycleRules>(
    rules: R,
    family: &FamilyState,
    event: LifecycleEvent,
) -> Result<(FamilyState, Vec<LifecycleChange>), LifecycleRefusal> {
    let mut step = ApplyStep { family: family.clone(), rules };
    step.run(event)?;
    for (version, before) in step.family.versions.iter_mut().zip(&family.versions) {
        if version != before {
            version.row_version = before.row_version.saturating_add(1);
        }
    }
    let changes =
        if rules.demand(LifecycleRule::ReportChanges) { changes(family, &step.family) } else { Vec::new() };
    Ok((step.family, changes))
}

struct ApplyStep<R> {
    family: FamilyState,
    rules: R,
}

impl<R: LifecycleRules> ApplyStep<R> {
    fn version(&mut self, version: VersionRef) -> Result<&mut Version, LifecycleRefusal> {
        let unknown = LifecycleRefusal::UnknownVersion { version: version.0 };
        self.family.versions.get_mut(usize::from(version.0)).ok_or(unknown)
    }

    fn stamp(&mut self, version: VersionRef) -> Result<ValidityStamp, LifecycleRefusal> {
        let context = self.family.context;
        Ok(ValidityStamp { context, round: self.version(version)?.round })
    }

    fn ready(
        &mut self,
        version: VersionRef,
        event: &'static str,
        from: &[State],
    ) -> Result<&mut Version, LifecycleRefusal> {
        let pause_blocks = self.rules.demand(LifecycleRule::PauseBlocks);
        let found = self.within(version, event, from)?;
        if found.flags.paused && pause_blocks { Err(LifecycleRefusal::Paused) } else { Ok(found) }
    }

    fn within(
        &mut self,
        version: VersionRef,
        event: &'static str,
        from: &[State],
    ) -> Result<&mut Version, LifecycleRefusal> {
        let found = self.version(version)?;
        if from.contains(&found.state) {
            return Ok(found);
        }
        Err(LifecycleRefusal::State { event, state: found.state, allowed: from.to_vec() })
    }

    fn void_family(&mut self, rule: bool) {
        if rule {
            self.family.context = self.family.context.saturating_add(1);
            for version in &mut self.family.versions {
                version.gate = None;
                version.approval = None;
                version.flags.awaiting_approval = false;
            }
        }
    }

    fn run(&mut self, event: LifecycleEvent) -> Result<(), LifecycleRefusal> {
        match event {
            LifecycleEvent::Bootstrap => self.bootstrap(),
            LifecycleEvent::Register => self.register(),
            LifecycleEvent::Start { version, stage } => self.start(version, stage),
            LifecycleEvent::Pass { version, stage } => self.pass(version, stage),
            LifecycleEvent::Abort { version } => {
                let found = self.version(version)?;
                let running = found.flags.running.take();
                running.map(|_| ()).ok_or(LifecycleRefusal::Running { running })
            }
            LifecycleEvent::Demote { version } => self.demote(version),
            LifecycleEvent::Reject { version } => self.reject(version),
            LifecycleEvent::Repeat { version, stage } => self.repeat(version, stage),
            LifecycleEvent::RequestApproval { version } => self.request(version),
            LifecycleEvent::Approved { version, row_version } => self.approved(version, row_version),
            LifecycleEvent::ApprovalExpired { version } => {
                let found = self.version(version)?;
                if !found.flags.awaiting_approval && found.approval.is_none() {
                    return Err(LifecycleRefusal::Condition { why: "nothing was asked" });
                }
                found.flags.awaiting_approval = false;
                found.approval = None;
                found.gate = None;
                Ok(())
            }
            LifecycleEvent::Activate { version } => self.activate(version),
            LifecycleEvent::ActivateUnreviewed { version, until } => {
                self.activate(version)?;
                if self.rules.demand(LifecycleRule::EmergencyOpensReview) {
                    self.family.review = Some(Review { version, until });
                }
                Ok(())
            }
            LifecycleEvent::Reviewed { version } => {
                if !self.family.is_unreviewed(version) {
                    return Err(LifecycleRefusal::Condition { why: "no review of it is open" });
                }
                self.family.review = None;
                Ok(())
            }
            LifecycleEvent::Close { version, profile } => self.set_blocked(version, profile, true),
            LifecycleEvent::Open { version, profile } => self.set_blocked(version, profile, false),
            LifecycleEvent::Confirm { version } => self.confirm(version),
            LifecycleEvent::Restrict { version } => {
                let found = self.within(version, "restricting", &[State::Active])?;
                if found.flags.rollback_pending || found.flags.restricted {
                    return Err(LifecycleRefusal::Condition {
                        why: "it is restricted already, or being rolled back",
                    });
                }
                found.flags.restricted = true;
                Ok(())
            }
            LifecycleEvent::Release { version } => self.release(version),
            LifecycleEvent::BeginRollback { version } => {
                let found = self.within(version, "rolling back", &[State::Active])?;
                if found.flags.rollback_pending {
                    return Err(LifecycleRefusal::RollbackPending);
                }
                found.flags =
                    VersionFlags { rollback_pending: true, awaiting_approval: false, ..found.flags };
                Ok(())
            }
            LifecycleEvent::FinishRollback { version, leave } => self.finish_rollback(version, leave),
            LifecycleEvent::FailRollback { version } => self.fail_rollback(version),
            LifecycleEvent::Rearm { version } => self.rearm(version),
            LifecycleEvent::Pause { version } => self.pause(version, true),
            LifecycleEvent::Resume { version } => self.pause(version, false),
            LifecycleEvent::ContextChanged { needs_approval } => {
                self.family.needs_approval = needs_approval;
                self.void_family(self.rules.demand(LifecycleRule::ContextChangeVoids));
                Ok(())
            }
            LifecycleEvent::Restart => {
                if self.rules.demand(LifecycleRule::RestartAborts) {
                    self.family.versions.iter_mut().for_each(|version| version.flags.running = None);
                }
                Ok(())
            }
        }
    }

    fn bootstrap(&mut self) -> Result<(), LifecycleRefusal> {
        if !self.family.versions.is_empty() {
            return Err(LifecycleRefusal::Condition { why: "the family has a first version already" });
        }
        self.family.versions.push(Version::new(State::Active));
        Ok(())
    }

    fn register(&mut self) -> Result<(), LifecycleRefusal> {
        if self.family.versions.len() >= VERSIONS_MAX {
            return Err(LifecycleRefusal::Condition { why: "a family has at most 10,000 versions" });
        }
        self.family.versions.push(Version::new(State::Registered));
        Ok(())
    }

    fn start(&mut self, version: VersionRef, stage: Stage) -> Result<(), LifecycleRefusal> {
        let context = self.family.context;
        let from = match stage {
            Stage::Validation => State::Registered,
            Stage::Sandbox => State::Validated,
            Stage::Shadow => State::Sandboxed,
            Stage::Activation => State::Shadowed,
        };
        let bind = self.rules.demand(LifecycleRule::BindEvidence);
        let found = self.ready(version, "starting this stage", &[from])?;
        if found.flags.running.is_some() {
            return Err(LifecycleRefusal::Running { running: found.flags.running });
        }
        if stage == Stage::Shadow && bind && !is_current(found.sandbox, context) {
            return Err(LifecycleRefusal::Stale { what: "sandbox evidence" });
        }
        found.flags.running = Some(stage);
        Ok(())
    }

    fn pass(&mut self, version: VersionRef, stage: Stage) -> Result<(), LifecycleRefusal> {
        let stamp = self.stamp(version)?;
        let rules = self.rules;
        let from: &[State] = match stage {
            Stage::Validation => &[State::Registered],
            Stage::Sandbox => &[State::Validated, State::Demoted],
            Stage::Shadow => &[State::Sandboxed, State::Demoted],
            Stage::Activation => &[State::Shadowed],
        };
        let found = self.ready(version, "passing this stage", from)?;
        if found.flags.running != Some(stage) && rules.demand(LifecycleRule::PassNeedsRun) {
            return Err(LifecycleRefusal::Running { running: found.flags.running });
        }
        let stale = |what| Err(LifecycleRefusal::Stale { what });
        match stage {
            Stage::Validation => found.state = State::Validated,
            Stage::Sandbox => {
                found.state = State::Sandboxed;
                found.sandbox = Some(stamp);
            }
            Stage::Shadow => {
                if rules.demand(LifecycleRule::BindEvidence) && !is_current(found.sandbox, stamp.context) {
                    return stale("sandbox evidence");
                }
                found.state = State::Shadowed;
                found.shadow = Some(stamp);
            }
            Stage::Activation => {
                let current =
                    is_current(found.sandbox, stamp.context) && is_current(found.shadow, stamp.context);
                if rules.demand(LifecycleRule::BindEvidence) && !current {
                    return stale("sandbox or shadow evidence");
                }
                found.gate = Some(stamp);
            }
        }
        found.flags.running = None;
        Ok(())
    }

    fn confirm(&mut self, version: VersionRef) -> Result<(), LifecycleRefusal> {
        let rules = self.rules;
        if self.family.is_unreviewed(version) && rules.demand(LifecycleRule::ReviewBeforeConfirm) {
            return Err(LifecycleRefusal::ReviewOpen);
        }
        let found = self.ready(version, "confirming", &[State::Active])?;
        if found.flags.rollback_pending {
            return Err(LifecycleRefusal::RollbackPending);
        }
        if found.flags.restricted && rules.demand(LifecycleRule::ReleaseBeforeConfirm) {
            return Err(LifecycleRefusal::Condition { why: "it is restricted; it is released first" });
        }
        if !found.flags.provisional {
            return Err(LifecycleRefusal::Condition { why: "it is not provisional" });
        }
        found.flags.provisional = false;
        Ok(())
    }

    /// Blocks a version under a profile, or unblocks it; its state does not change.
    fn set_blocked(
        &mut self,
        version: VersionRef,
        profile: ProfileName,
        blocked: bool,
    ) -> Result<(), LifecycleRefusal> {
        let found = self.version(version)?;
        if found.state.is_terminal() {
            return Err(LifecycleRefusal::Condition { why: "it is rejected or rolled back for good" });
        }
        let changed = if blocked { found.closed.insert(profile) } else { found.closed.remove(&profile) };
        if changed {
            Ok(())
        } else {
            let why =
                if blocked { "it is blocked under the profile already" } else { "the profile is open to it" };
            Err(LifecycleRefusal::Condition { why })
        }
    }

    fn demote(&mut self, version: VersionRef) -> Result<(), LifecycleRefusal> {
        let mut from = vec![State::Validated, State::Sandboxed, State::Shadowed];
        if !self.rules.demand(LifecycleRule::ActiveLeavesByRollback) {
            from.push(State::Active);
        }
        let found = self.within(version, "demoting", &from)?;
        found.leave(State::Demoted);
        Ok(())
    }

    fn reject(&mut self, version: VersionRef) -> Result<(), LifecycleRefusal> {
        let mut from = vec![
            State::Registered,
            State::Validated,
            State::Sandboxed,
            State::Shadowed,
            State::Demoted,
            State::Superseded,
        ];
        if !self.rules.demand(LifecycleRule::ActiveLeavesByRollback) {
            from.push(State::Active);
        }
        let pinned = self.family.is_pinned(version) && self.rules.demand(LifecycleRule::PinPredecessor);
        let is_first = version == VersionRef(0) && self.rules.demand(LifecycleRule::KeepFirst);
        let found = self.within(version, "rejecting", &from)?;
        if found.state == State::Superseded && pinned {
            return Err(LifecycleRefusal::Pinned);
        }
        if is_first {
            let why = "a stopped family can always return to its first version, so that is not rejected; `demote` deactivates it";
            return Err(LifecycleRefusal::Condition { why });
        }
        found.leave(State::Rejected);
        Ok(())
    }

    fn repeat(&mut self, version: VersionRef, stage: Stage) -> Result<(), LifecycleRefusal> {
        let (context, rules) = (self.family.context, self.rules);
        let mut from = match stage {
            Stage::Sandbox => vec![State::Sandboxed, State::Shadowed, State::Demoted],
            Stage::Shadow => vec![State::Shadowed, State::Demoted],
            Stage::Validation | Stage::Activation => {
                return Err(LifecycleRefusal::Condition { why: "sandbox and shadow can be repeated" });
            }
        };
        if !rules.demand(LifecycleRule::TerminalIsFinal) {
            from.push(State::RolledBack);
        }
        if !rules.demand(LifecycleRule::RepeatOffControl) {
            from.push(State::Active);
        }
        let found = self.ready(version, "repeating this stage", &from)?;
        if found.flags.running.is_some() {
            return Err(LifecycleRefusal::Running { running: found.flags.running });
        }
        if stage == Stage::Shadow
            && rules.demand(LifecycleRule::BindEvidence)
            && !is_current(found.sandbox, context)
        {
            return Err(LifecycleRefusal::Stale { what: "sandbox evidence" });
        }
        if rules.demand(LifecycleRule::RepeatVoids) {
            found.gate = None;
            found.approval = None;
            found.round = found.round.saturating_add(1);
        }
        if stage == Stage::Sandbox {
            found.sandbox = None;
        }
        found.shadow = None;
        found.state = State::Demoted;
        found.flags = VersionFlags { running: Some(stage), ..VersionFlags::default() };
        Ok(())
    }

    fn request(&mut self, version: VersionRef) -> Result<(), LifecycleRefusal> {
        let found = self.ready(version, "asking for approval", &[State::Shadowed, State::Active])?;
        if found.state == State::Active && (!found.flags.restricted || found.flags.rollback_pending) {
            return Err(LifecycleRefusal::Condition {
                why: "an active version is asked about only while it is restricted",
            });
        }
        if found.flags.awaiting_approval {
            return Err(LifecycleRefusal::Condition { why: "people were asked already" });
        }
        found.flags.awaiting_approval = true;
        found.approval = None;
        Ok(())
    }

    fn approved(&mut self, version: VersionRef, row_version: u64) -> Result<(), LifecycleRefusal> {
        let stamp = self.stamp(version)?;
        let bind_row = self.rules.demand(LifecycleRule::BindRow);
        let found = self.ready(version, "approving", &[State::Shadowed, State::Active])?;
        if !found.flags.awaiting_approval {
            return Err(LifecycleRefusal::Condition { why: "nothing was asked" });
        }
        if bind_row && found.row_version != row_version {
            return Err(LifecycleRefusal::Stale { what: "approval" });
        }
        found.flags.awaiting_approval = false;
        found.approval = Some(stamp);
        Ok(())
    }

    /// Checks that the gate pass, and the approval if the profile needs one, are current.
    fn check_current(&mut self, version: VersionRef) -> Result<(), LifecycleRefusal> {
        let (stamp, rules, needs_approval) = (self.stamp(version)?, self.rules, self.family.needs_approval);
        let found = self.version(version)?;
        let (gate, approval) = (found.gate, found.approval);
        if rules.demand(LifecycleRule::BindGate) && gate != Some(stamp) {
            return Err(LifecycleRefusal::Stale { what: "gate pass" });
        }
        if needs_approval && rules.demand(LifecycleRule::BindApproval) && approval != Some(stamp) {
            return Err(LifecycleRefusal::Stale { what: "approval" });
        }
        Ok(())
    }

    fn activate(&mut self, version: VersionRef) -> Result<(), LifecycleRefusal> {
        if self.family.safe_stopped && self.rules.demand(LifecycleRule::StopHolds) {
            return Err(LifecycleRefusal::SafeStopped);
        }
        self.promotable()?;
        self.ready(version, "activating", &[State::Shadowed])?;
        self.check_current(version)?;
        let old = self.family.active();
        if let Some(old) = old {
            let supersede = self.rules.demand(LifecycleRule::SupersedeOld);
            let replaced = self.version(old)?;
            if replaced.flags.rollback_pending {
                return Err(LifecycleRefusal::RollbackPending);
            }
            if supersede {
                replaced.state = State::Superseded;
                replaced.left_restricted = replaced.flags.restricted;
                replaced.left_provisional = replaced.flags.provisional;
                replaced.flags = VersionFlags::default();
            }
        }
        self.enter(version, old)?;
        let entered = self.version(version)?;
        (entered.left_restricted, entered.left_provisional) = (false, false);
        Ok(())
    }

    /// Refuses while the review of a break-glass activation is open.
    fn promotable(&self) -> Result<(), LifecycleRefusal> {
        let blocked = self.family.review.is_some() && self.rules.demand(LifecycleRule::ReviewBlocks);
        if blocked { Err(LifecycleRefusal::ReviewOpen) } else { Ok(()) }
    }

    fn enter(
        &mut self,
        version: VersionRef,
        predecessor: Option<VersionRef>,
    ) -> Result<(), LifecycleRefusal> {
        self.void_family(self.rules.demand(LifecycleRule::ActiveChangeVoids));
        let found = self.version(version)?;
        found.state = State::Active;
        found.flags = VersionFlags { provisional: true, ..VersionFlags::default() };
        found.predecessor = predecessor;
        found.gate = None;
        found.approval = None;
        Ok(())
    }

    /// Reactivates a version, as provisional and as restricted as it was.
    fn enter_again(&mut self, version: VersionRef) -> Result<(), LifecycleRefusal> {
        let before = self.family.restorable_predecessor(version);
        self.enter(version, before)?;
        let rules = self.rules;
        let found = self.version(version)?;
        let [provisional, restricted] =
            [&mut found.left_provisional, &mut found.left_restricted].map(std::mem::take);
        found.flags.provisional = provisional && rules.demand(LifecycleRule::WindowOutlives);
        found.flags.restricted = restricted && rules.demand(LifecycleRule::RestrictionOutlives);
        Ok(())
    }

    fn release(&mut self, version: VersionRef) -> Result<(), LifecycleRefusal> {
        let (stamp, needs_approval) = (self.stamp(version)?, self.family.needs_approval);
        let bind = self.rules.demand(LifecycleRule::BindRelease);
        let found = self.ready(version, "releasing", &[State::Active])?;
        if !found.flags.restricted || found.flags.rollback_pending {
            return Err(LifecycleRefusal::Condition { why: "it is not restricted, or being rolled back" });
        }
        if needs_approval && bind && found.approval != Some(stamp) {
            return Err(LifecycleRefusal::Stale { what: "approval" });
        }
        found.flags.restricted = false;
        found.flags.awaiting_approval = false;
        found.approval = None;
        Ok(())
    }

    fn finish_rollback(
        &mut self,
        version: VersionRef,
        leave: DeactivationKind,
    ) -> Result<(), LifecycleRefusal> {
        let rules = self.rules;
        let found = self.within(version, "rolling back", &[State::Active])?;
        if rules.demand(LifecycleRule::RevokeFirst) && !found.flags.rollback_pending {
            return Err(LifecycleRefusal::Condition { why: "its command authority has to be revoked first" });
        }
        let target = found.predecessor;
        let Some(target) = target.filter(|t| self.family.state(*t) == Some(State::Superseded)) else {
            return Err(LifecycleRefusal::Condition { why: "there is no version to roll back to" });
        };
        let to = match leave {
            DeactivationKind::RolledBack => State::RolledBack,
            DeactivationKind::Demoted => State::Demoted,
        };
        self.version(version)?.leave(to);
        self.on_deactivated(version);
        if rules.demand(LifecycleRule::RestorePredecessor) {
            self.enter_again(target)?;
        }
        Ok(())
    }

    fn fail_rollback(&mut self, version: VersionRef) -> Result<(), LifecycleRefusal> {
        let rules = self.rules;
        let found = self.within(version, "failing a rollback", &[State::Active])?;
        if rules.demand(LifecycleRule::RevokeFirst) && !found.flags.rollback_pending {
            return Err(LifecycleRefusal::Condition { why: "its command authority has to be revoked first" });
        }
        found.leave(State::Demoted);
        self.on_deactivated(version);
        self.family.safe_stopped = rules.demand(LifecycleRule::StopWithoutTarget);
        self.void_family(rules.demand(LifecycleRule::ActiveChangeVoids));
        Ok(())
    }

    /// Called after an active version left; its break-glass review stays open.
    fn on_deactivated(&mut self, version: VersionRef) {
        if self.family.is_unreviewed(version) && !self.rules.demand(LifecycleRule::ReviewOutlives) {
            self.family.review = None;
        }
    }

    fn rearm(&mut self, version: VersionRef) -> Result<(), LifecycleRefusal> {
        if !self.family.safe_stopped {
            return Err(LifecycleRefusal::Condition { why: "the family is not stopped" });
        }
        let state = self.ready(version, "re-arming", &[State::Superseded, State::Demoted])?.state;
        if state == State::Demoted {
            self.promotable()?;
            let other = self.family.versions.iter().any(|version| version.state == State::Superseded);
            let acted = self.family.has_acted(version) || !self.rules.demand(LifecycleRule::RearmActedOnly);
            if other || !acted {
                let why = "a superseded version comes first, and a demoted one only if it was active before";
                return Err(LifecycleRefusal::Condition { why });
            }
            let is_first = version == VersionRef(0);
            let by_gate = self.family.needs_approval && self.rules.demand(LifecycleRule::RearmThroughGate);
            if by_gate && !is_first {
                let why = "where people decide, a demoted version comes back through the gate: reactivate the family's first version";
                return Err(LifecycleRefusal::Condition { why });
            }
        }
        self.enter_again(version)?;
        self.family.safe_stopped = false;
        Ok(())
    }

    fn pause(&mut self, version: VersionRef, paused: bool) -> Result<(), LifecycleRefusal> {
        let found = self.version(version)?;
        if found.state.is_terminal() || found.flags.paused == paused || found.state == State::Superseded {
            return Err(LifecycleRefusal::Condition {
                why: if paused { "it cannot be paused" } else { "it is not paused" },
            });
        }
        found.flags.paused = paused;
        Ok(())
    }
}

fn is_current(stamp: Option<ValidityStamp>, context: u32) -> bool {
    stamp.is_some_and(|stamp| stamp.context == context)
}
