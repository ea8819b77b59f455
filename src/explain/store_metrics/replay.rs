//! Replays decisions: applies each rule to its recorded inputs, and compares the results.
//!
//! Each stage's decision is replayed from its raw evidence, under the profile it names; a custom one by its recorded texts.

mod approval_replay;
mod first_difference;

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;
use serde_json::Value;

use holdpoint_governance::ablation::AblatedParts;
use holdpoint_governance::behavior::{self, SequenceEvidence};
use holdpoint_governance::comparison_evidence::ComparisonEvidence;
use holdpoint_governance::composition::{Kappas, psi, psi_after_shadow};
use holdpoint_governance::condition::Condition;
use holdpoint_governance::decision::{Decision, DecisionContext};
use holdpoint_governance::distribution_shift::{apply_re_evaluation, compare_with_sandbox, is_suspicious};
use holdpoint_governance::early_stop::EarlyStopReason;
use holdpoint_governance::evidence::{
    AnchorEvidence, EvidenceBinding, HardStop, PairedEvidence, RecoveryEvidence,
};
use holdpoint_governance::gate::{self, GateInput, assess_shadow};
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::interface::{RegisteredVersion, unmet};
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::metrics::store_metrics::{NotReplayable, ReplayOutcome};
use holdpoint_governance::outcome::CheckResult;
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_governance::record::AuditRecord;
use holdpoint_governance::recovery;
use holdpoint_governance::rules_version::RulesVersion;
use holdpoint_governance::site_profile::{ProfileTexts, SiteProfile};
use holdpoint_governance::tries::{self, CountedTry};
use holdpoint_governance::wall_time::WallTime;
use holdpoint_governance::worst_case_search::SearchFinding;
use holdpoint_runtime::capability::Capability;
use holdpoint_store::{ApprovalEntry, EvidenceEntry, EvidenceKind, RecordViews, StoreError};

pub(super) use self::first_difference::differing;
use super::history::History;
use holdpoint_record::evidence_file::{EvidenceFile, MODE_EPISODES, StaticAssessment};
use holdpoint_record::version_concern::{Confirmation, ReEvaluationEvidence, VersionConcern};
use holdpoint_record::version_table::{self, VersionEntry};
use holdpoint_record::{check, context, recorded_decision, version_origin};
use holdpoint_wording::program::replay as sentences;

/// A profile with its compiled policies, and the digests that decisions name.
pub struct RulesInForce {
    pub profile: Profile,
    digest: Digest,
    pub(super) table: PolicyTable,
}

impl RulesInForce {
    /// The built-in ones; one that does not load is left out.
    #[must_use]
    pub fn known() -> Vec<Self> {
        ProfileName::ALL.into_iter().filter_map(|name| Self::of(Profile::builtin(name).ok()?)).collect()
    }

    /// A profile with its built-in policies; `None` if this build cannot use it.
    #[must_use]
    pub fn of(profile: Profile) -> Option<Self> {
        let table = PolicyTable::builtin(&profile).ok()?;
        Self::with(profile, table)
    }

    /// A custom one from its recorded texts; `None` if this build cannot use them.
    fn own(texts: &ProfileTexts) -> Option<Self> {
        let own = SiteProfile::parse(texts.clone()).ok()?;
        Self::with(own.profile().clone(), own.table().clone())
    }

    fn with(profile: Profile, table: PolicyTable) -> Option<Self> {
        let digest = profile.digest().ok()?;
        Some(Self { profile, digest, table })
    }
}

pub(super) enum ReplayFailure {
    Differs(String),
    Not(NotReplayable),
}

impl From<NotReplayable> for ReplayFailure {
    fn from(why: NotReplayable) -> Self {
        Self::Not(why)
    }
}

/// The recorded data of one version. It may be large, so versions are read one after the other.
pub(super) struct VersionRecords {
    pub(super) id: CapabilityId,
    pub(super) evidence: Vec<EvidenceEntry>,
    approvals: Vec<ApprovalEntry>,
}

impl VersionRecords {
    pub(super) fn read(views: &dyn RecordViews, id: &CapabilityId) -> Result<Self, StoreError> {
        let (evidence, approvals) = (views.evidence(id, None)?, views.approvals(id)?);
        Ok(Self { id: id.clone(), evidence, approvals })
    }

    /// The conditions of use of the newest gate pass before a record.
    pub(super) fn conditions_before(&self, seq: u64) -> Vec<Condition> {
        let mut gates =
            self.evidence.iter().rev().filter(|one| one.kind == EvidenceKind::Gate && one.seq < seq);
        let passed = gates.find_map(|entry| serde_json::from_str::<Decision<Value>>(&entry.json).ok());
        passed.map_or_else(Vec::new, |decision| decision.answers().conditions.clone())
    }

    /// The newest evidence file with a shadow before a record.
    pub(super) fn shadow_before(&self, seq: u64) -> Option<EvidenceFile> {
        let shadows = self.evidence.iter().rev();
        let mut shadows = shadows.filter(|one| one.kind == EvidenceKind::Shadow && one.seq < seq);
        shadows.find_map(|entry| assessed_evidence_file(&entry.json))
    }
}

pub(super) struct Replayer<'a> {
    pub(super) history: &'a History,
    frames: Vec<RulesInForce>,
    /// Places in `frames`, by the digest in the chain.
    in_force: BTreeMap<Digest, usize>,
    environment: Digest,
    /// The stored versions that load with their registered digest.
    pub(super) members: BTreeMap<CapabilityId, VersionEntry>,
}

impl<'a> Replayer<'a> {
    /// `frames`: the profiles known without the record.
    pub(super) fn new(
        views: &dyn RecordViews,
        history: &'a History,
        mut frames: Vec<RulesInForce>,
        environment: Digest,
    ) -> Self {
        frames.extend(history.own_profiles.iter().filter_map(RulesInForce::own));
        let decided_in = history.decisions.iter().filter_map(made_under).map(|under| under.environment);
        let environments: BTreeSet<Digest> = decided_in.chain([environment]).collect();
        let mut in_force = BTreeMap::new();
        for (place, frame) in frames.iter().enumerate() {
            for cell in &environments {
                in_force.insert(context::digest(&frame.digest, &frame.table.digest, cell), place);
            }
        }
        let load = |id: &CapabilityId| Some((id.clone(), version_table::load_member(views, id).ok()??));
        let members = history.registered.iter().filter_map(|(_, id, _)| load(id)).collect();
        Self { history, frames, in_force, environment, members }
    }

    pub(super) fn decision(&self, of: &VersionRecords, record: &AuditRecord) -> ReplayOutcome {
        let Some(under) = made_under(record) else {
            return ReplayOutcome::NotReplayed { why: NotReplayable::Unreadable };
        };
        let found = self.replay_decision(of, record, &under);
        if under.rules != RulesVersion::CURRENT && matches!(found, Err(ReplayFailure::Differs(_))) {
            return ReplayOutcome::NotReplayed { why: NotReplayable::OtherRules };
        }
        self.replay_outcome(&under.environment, found)
    }

    /// Replays the evidence on a concern; `None` where it begins.
    pub(super) fn replay_concern(&self, entry: &EvidenceEntry) -> Option<ReplayOutcome> {
        if let Ok(suspicion) = serde_json::from_str::<VersionConcern>(&entry.json) {
            let again = suspicion.again.as_ref()?;
            let binding = again.pairs.binding;
            let found = self
                .frame(&binding.profile, &binding.policy)
                .map_err(ReplayFailure::from)
                .and_then(|frame| replay_re_evaluation(again, frame))
                .and_then(|()| is_on_record(suspicion.digest(), entry));
            return Some(self.replay_outcome(&binding.environment, found));
        }
        let Ok(confirmation) = serde_json::from_str::<Confirmation>(&entry.json) else {
            return Some(ReplayOutcome::NotReplayed { why: NotReplayable::Unreadable });
        };
        let binding = confirmation.pairs.binding;
        Some(
            self.replay_outcome(
                &binding.environment,
                self.replay_confirmation(&confirmation, &binding, entry),
            ),
        )
    }

    /// A difference counts only if this build made the decision.
    fn replay_outcome(&self, environment: &Digest, result: Result<(), ReplayFailure>) -> ReplayOutcome {
        match result {
            Ok(()) => ReplayOutcome::Equal,
            Err(ReplayFailure::Differs(_)) if *environment != self.environment => {
                ReplayOutcome::NotReplayed { why: NotReplayable::OtherBuild }
            }
            Err(ReplayFailure::Differs(what)) => ReplayOutcome::Differs { what },
            Err(ReplayFailure::Not(why)) => ReplayOutcome::NotReplayed { why },
        }
    }

    fn replay_decision(
        &self,
        of: &VersionRecords,
        record: &AuditRecord,
        under: &DecisionContext,
    ) -> Result<(), ReplayFailure> {
        let frame = self.frame(&under.profile, &under.policy)?;
        let before = of.evidence.iter().rev().filter(|entry| entry.seq < record.seq);
        let newest = before.clone().next().ok_or(NotReplayable::EvidenceMissing)?;
        let measured = before.clone().find_map(|entry| Some((entry, assessed_evidence_file(&entry.json)?)));
        let (entry, evidence_file) = measured.ok_or(NotReplayable::Unreadable)?;
        let kappas = evidence_file.kappas.as_ref().ok_or(NotReplayable::Unreadable)?;
        match newest.kind {
            EvidenceKind::Compat => {
                self.replay_static(&of.id, newest.seq, &evidence_file, frame)?;
                compose(kappas, frame, under, record)
            }
            // Time ended the sandbox: what was measured by then decided nothing.
            EvidenceKind::Sandbox if evidence_file.time_excess.is_some() => {
                self.replay_static(&of.id, newest.seq, &evidence_file, frame)?;
                compose(kappas, frame, under, record)?;
                check_evidence(under, entry, &evidence_file)
            }
            EvidenceKind::Sandbox => {
                replay_sandbox(&evidence_file, frame)?;
                compose(kappas, frame, under, record)?;
                check_evidence(under, entry, &evidence_file)
            }
            EvidenceKind::Shadow => {
                let check = replay_shadow(&evidence_file, frame)?;
                let has_approver = frame.profile.has_approver();
                check_recorded(record, &psi_after_shadow(kappas, has_approver, *under, check))?;
                check_evidence(under, entry, &evidence_file)
            }
            EvidenceKind::Gate | EvidenceKind::Activation => {
                self.replay_gate(of, (newest.seq, record), under, &evidence_file, frame)?;
                check_evidence(under, entry, &evidence_file)
            }
            EvidenceKind::Monitor | EvidenceKind::Rollback | EvidenceKind::Drill => {
                Err(NotReplayable::EvidenceMissing.into())
            }
        }
    }

    /// The static assessments from the versions registered and active before a record.
    fn replay_static(
        &self,
        id: &CapabilityId,
        seq: u64,
        evidence_file: &EvidenceFile,
        frame: &RulesInForce,
    ) -> Result<(), ReplayFailure> {
        let kappas = evidence_file.kappas.as_ref().ok_or(NotReplayable::Unreadable)?;
        let candidate = self.capability(id)?;
        let registered = self.registered_before(seq)?;
        let active = registered.iter().find(|one| one.active && one.id.family == id.family);
        let active = active.map(|one| self.capability(&one.id)).transpose()?;
        let before = |id: &CapabilityId| Some((id.clone(), self.history.state_before(id, seq)?));
        let known = self.history.registered.iter().filter_map(|(_, id, _)| before(id));
        let fallback = check::fallback_match(candidate, known);
        let author_known = self.author_known_before(id, seq)?;
        let against = check::CheckInputs { active, registered: &registered, fallback, author_known };
        let StaticAssessment { kappas: found, risk: class, .. } =
            check::assess(candidate, &against, &frame.profile, &frame.table)
                .with_time_excess(evidence_file.time_excess, &frame.profile);
        // Evidence of older builds has none.
        if let Some(risk) = &evidence_file.risk {
            same("risk class", risk, &class)?;
        }
        same("kappa_I", &kappas.interface, &found.interface)?;
        same("kappa_P", &kappas.policy, &found.policy)?;
        same("kappa_B", &kappas.behavior, &found.behavior)?;
        same("kappa_R", &kappas.recovery, &found.recovery)
    }

    fn registered_before(&self, seq: u64) -> Result<Vec<RegisteredVersion>, ReplayFailure> {
        let mut known: Vec<&CapabilityId> = self.history.registered.iter().map(|(_, id, _)| id).collect();
        known.sort_by(|a, b| a.family.cmp(&b.family));
        let mut registered = Vec::new();
        for id in known {
            match self.history.state_before(id, seq) {
                Some(state) if !state.is_terminal() => {
                    registered.push(check::entry(self.capability(id)?, state == State::Active));
                }
                Some(_) | None => {}
            }
        }
        Ok(registered)
    }

    /// `asked_seq`: the first record of the gate's decision, which preceded it.
    fn replay_gate(
        &self,
        of: &VersionRecords,
        (asked_seq, record): (u64, &AuditRecord),
        under: &DecisionContext,
        evidence_file: &EvidenceFile,
        frame: &RulesInForce,
    ) -> Result<(), ReplayFailure> {
        let kappas = evidence_file.kappas.as_ref().ok_or(NotReplayable::Unreadable)?;
        let VersionEntry { capability: candidate, origin, .. } = self.member(&of.id)?;
        let risk = version_origin::assessed_risk(evidence_file);
        let approval = if self.history.is_emergency(&of.id, (asked_seq, record.seq)) {
            self.break_glass_result(of, record, under, (risk, frame))?
        } else {
            self.answers(of, record, under, kappas, (risk, frame))?
        };
        let blocked_under = self
            .history
            .blocked_under_before(&of.id, asked_seq)
            .union(&evidence_file.closed)
            .copied()
            .collect();
        let input = GateInput {
            kappas,
            shadow: evidence_file.shadow.as_ref(),
            bindings: &evidence_file.bindings,
            current: &binding_of(under),
            improved: evidence_file.behavior.as_ref().is_some_and(|behavior| behavior.improved),
            approval: approval.as_ref(),
            risk,
            requester: &origin.requester,
            provenance: candidate.submission.provenance,
            blocked_under: &blocked_under,
            unmet: &unmet(&candidate.manifest, &self.registered_before(asked_seq)?),
            review_open: self.history.review_open_before(&of.id.family, asked_seq),
            profile_authorized: true,
            now: wall_of(record),
            clock_doubt: self.history.clock_doubt_before(asked_seq),
            row_version: 0,
            made_under: *under,
            omitted: AblatedParts::default(),
        };
        check_recorded(record, &gate::evaluate(&input, &frame.table, &frame.profile).decision)
    }

    fn replay_confirmation(
        &self,
        confirmation: &Confirmation,
        binding: &EvidenceBinding,
        entry: &EvidenceEntry,
    ) -> Result<(), ReplayFailure> {
        let frame = self.frame(&binding.profile, &binding.policy)?;
        // A confirmation runs no stress episodes and no search.
        let beside = UnpairedEvidence {
            is_settling: false,
            anchor: confirmation.anchor.as_ref(),
            handovers: confirmation.handovers.as_ref(),
            uncompared_stops: &[],
            unsafe_under_stress: 0,
            searched: None,
            counted: None,
        };
        replay_assessment(
            &confirmation.pairs,
            &confirmation.drills,
            (&confirmation.behavior, &confirmation.recovery),
            frame,
            &beside,
        )?;
        is_on_record(Digest::of_json("holdpoint.confirmation.v1", confirmation), entry)
    }

    pub(super) fn frame(&self, profile: &Digest, policy: &Digest) -> Result<&RulesInForce, NotReplayable> {
        let found = self.frames.iter().find(|one| one.digest == *profile && one.table.digest == *policy);
        found.ok_or(NotReplayable::ProfileUnknown)
    }

    fn capability(&self, id: &CapabilityId) -> Result<&Capability, ReplayFailure> {
        self.member(id).map(|member| &member.capability)
    }

    fn member(&self, id: &CapabilityId) -> Result<&VersionEntry, ReplayFailure> {
        self.members.get(id).ok_or(ReplayFailure::Not(NotReplayable::EvidenceMissing))
    }

    /// Whether a version of the same author was confirmed before a record, and was in use or a rollback target.
    fn author_known_before(&self, id: &CapabilityId, seq: u64) -> Result<bool, ReplayFailure> {
        let Some(key) = &self.member(id)?.origin.author_key else { return Ok(false) };
        Ok(self.members.iter().any(|(known, member)| {
            known != id
                && member.origin.author_key.as_ref() == Some(key)
                && self.history.confirmed_before(known, seq)
                && matches!(self.history.state_before(known, seq), Some(State::Active | State::Superseded))
        }))
    }

    /// The rules in force when a record was written, from the chain or, in older stores, from the version's last decision.
    pub(super) fn frame_at(&self, id: &CapabilityId, seq: u64) -> Option<&RulesInForce> {
        let named = self.history.context_at(seq).and_then(|digest| self.in_force.get(&digest));
        if let Some(frame) = named.and_then(|place| self.frames.get(*place)) {
            return Some(frame);
        }
        let name = id.to_string();
        let mut decided = self.history.decisions.iter().rev();
        let under = decided
            .find_map(|one| if one.seq < seq && one.subject == name { made_under(one) } else { None })?;
        self.frame(&under.profile, &under.policy).ok()
    }
}

fn made_under(record: &AuditRecord) -> Option<DecisionContext> {
    let decision: Decision<Value> =
        serde_json::from_value(recorded_decision::rule_part(&record.body)?).ok()?;
    Some(*decision.made_under())
}

/// The wall time of a record that deadlines were compared with; a script's by its own clock.
fn wall_of(record: &AuditRecord) -> WallTime {
    match record.wall_ms {
        0 => WallTime::SCRIPT_EPOCH.plus_ms(record.at_ms),
        wall_ms => WallTime::from_ms(wall_ms),
    }
}

fn assessed_evidence_file(json: &str) -> Option<EvidenceFile> {
    serde_json::from_str::<EvidenceFile>(json).ok().filter(|evidence_file| evidence_file.kappas.is_some())
}

const fn binding_of(under: &DecisionContext) -> EvidenceBinding {
    EvidenceBinding {
        candidate: under.candidate,
        active: under.active,
        profile: under.profile,
        policy: under.policy,
        environment: under.environment,
        neighbours: under.neighbours,
        anchor: under.anchor,
    }
}

fn compose(
    kappas: &Kappas,
    frame: &RulesInForce,
    under: &DecisionContext,
    record: &AuditRecord,
) -> Result<(), ReplayFailure> {
    check_recorded(record, &psi(kappas, frame.profile.has_approver(), *under))
}

fn replay_sandbox(evidence_file: &EvidenceFile, frame: &RulesInForce) -> Result<(), ReplayFailure> {
    if let (Some(finding), Some(kappas)) = (&evidence_file.refused_try, &evidence_file.kappas) {
        return same("kappa_B", &kappas.behavior, &behavior::without_try(finding.clone()));
    }
    let (Some(binding), Some((candidate, active))) = (evidence_file.bindings.first(), evidence_file.drills)
    else {
        return Err(NotReplayable::EvidenceMissing.into());
    };
    let (Some(behavior), Some(recovery)) = (&evidence_file.behavior, &evidence_file.recovery) else {
        return Err(NotReplayable::EvidenceMissing.into());
    };
    if let Some(CountedTry { by_author, in_family, level, pairs, .. }) = &evidence_file.counted {
        let settings = &frame.profile.tries;
        same(sentences::TRY_LEVEL, level, &tries::level(settings, *by_author, *in_family))?;
        let price = tries::price(settings, frame.profile.evaluation.sandbox_pairs, *level);
        same(sentences::TRY_PAIRS, &Some(*pairs), &price)?;
    }
    let pairs = PairedEvidence {
        binding: *binding,
        pairs: evidence_file.pairs.clone(),
        hard_stops: evidence_file.hard_stops.clone(),
    };
    let drills = RecoveryEvidence { binding: *binding, candidate, active, settling: evidence_file.settling };
    let beside = UnpairedEvidence {
        is_settling: true,
        anchor: evidence_file.anchor.as_ref(),
        handovers: evidence_file.handovers.as_ref(),
        uncompared_stops: &evidence_file.uncompared_stops,
        unsafe_under_stress: evidence_file.unsafe_under_stress,
        searched: evidence_file.searched.as_ref(),
        counted: evidence_file.counted.as_ref(),
    };
    replay_assessment(&pairs, &drills, (behavior, recovery), frame, &beside)?;
    let Some(kappas) = &evidence_file.kappas else { return Err(NotReplayable::Unreadable.into()) };
    same("kappa_B", &kappas.behavior, &behavior.assessment)?;
    same("kappa_R", &kappas.recovery, &recovery.assessment)
}

struct UnpairedEvidence<'a> {
    is_settling: bool,
    anchor: Option<&'a AnchorEvidence>,
    handovers: Option<&'a SequenceEvidence>,
    uncompared_stops: &'a [HardStop],
    unsafe_under_stress: u32,
    searched: Option<&'a SearchFinding>,
    counted: Option<&'a CountedTry>,
}

/// Assesses pairs and drills again. Each rule checks again that the evidence supports an early end.
fn replay_assessment(
    pairs: &PairedEvidence,
    drills: &RecoveryEvidence,
    (behavior, recovery): (&behavior::BehaviorAssessment, &recovery::RecoveryAssessment),
    frame: &RulesInForce,
    beside: &UnpairedEvidence<'_>,
) -> Result<(), ReplayFailure> {
    let ended = behavior.ended.or(recovery.ended).unwrap_or(EarlyStopReason::Full);
    let profile = &frame.profile;
    let UnpairedEvidence { is_settling, anchor, handovers: sequences, counted, .. } = *beside;
    let has_anchor = pairs.binding.anchor.is_some();
    // Records of older rules have no such pair.
    let has_live_like = pairs.pairs.iter().any(|pair| pair.live_like);
    let evidence = ComparisonEvidence {
        pairs,
        drills,
        is_settling,
        has_live_like,
        has_anchor,
        anchor,
        sequences,
        counted,
    };
    let (mut again, recovered) = evidence.assess(&pairs.binding, ended, profile);
    behavior::add_uncompared_concern(&mut again, beside.uncompared_stops, profile);
    behavior::add_stress_concern(&mut again, beside.unsafe_under_stress, MODE_EPISODES, profile);
    behavior::add_search_concern(&mut again, beside.searched, profile);
    same("behavior", behavior, &again)?;
    same("recovery", recovery, &recovered)
}

fn replay_re_evaluation(again: &ReEvaluationEvidence, frame: &RulesInForce) -> Result<(), ReplayFailure> {
    let ReEvaluationEvidence { pairs, handovers, behavior, .. } = again;
    let ended = behavior.ended.unwrap_or(EarlyStopReason::Full);
    let mut found = behavior::assess_early_stop(pairs, &pairs.binding, &frame.profile, ended);
    behavior::apply_sequences(&mut found, handovers.as_ref(), &frame.profile);
    same(sentences::LIVE_BEHAVIOR, behavior, &found)
}

fn is_on_record(
    digest: Result<Digest, serde_json::Error>,
    entry: &EvidenceEntry,
) -> Result<(), ReplayFailure> {
    match digest {
        Ok(digest) if digest == entry.digest => Ok(()),
        _ => Err(ReplayFailure::Differs(sentences::OTHER_EVIDENCE_ON_RECORD.to_owned())),
    }
}

fn replay_shadow(evidence_file: &EvidenceFile, frame: &RulesInForce) -> Result<CheckResult, ReplayFailure> {
    let (Some(binding), Some(recorded)) = (evidence_file.bindings.last(), &evidence_file.shadow) else {
        return Err(NotReplayable::EvidenceMissing.into());
    };
    let evidence = evidence_file.shadow_evidence(*binding);
    let mut again = assess_shadow(&evidence, binding, &frame.profile);
    compare_with_sandbox(&mut again, &evidence, &evidence_file.pairs, &frame.profile);
    if let Some(re_evaluation) = &evidence_file.again {
        if !is_suspicious(&again) {
            return Err(ReplayFailure::Differs(sentences::NEEDLESS_RE_EVALUATION.to_owned()));
        }
        replay_re_evaluation(re_evaluation, frame)?;
        apply_re_evaluation(&mut again, &re_evaluation.behavior, re_evaluation.pairs.pairs.len());
    } else if let Some(excess) = &evidence_file.time_excess {
        excess.leave_open(&mut again, &frame.profile);
    }
    same("shadow", recorded, &again)?;
    Ok(recorded.check)
}

fn check_evidence(
    under: &DecisionContext,
    entry: &EvidenceEntry,
    evidence_file: &EvidenceFile,
) -> Result<(), ReplayFailure> {
    let named = under.evidence == entry.digest;
    if named && evidence_file.digest().is_ok_and(|digest| digest == entry.digest) {
        return Ok(());
    }
    Err(ReplayFailure::Differs(sentences::OTHER_EVIDENCE_IN_DECISION.to_owned()))
}

fn check_recorded<O: Serialize>(record: &AuditRecord, again: &Decision<O>) -> Result<(), ReplayFailure> {
    let recorded = recorded_decision::rule_part(&record.body).ok_or(NotReplayable::Unreadable)?;
    let again = serde_json::to_value(again).map_err(|_| NotReplayable::Unreadable)?;
    match differing("decision", &recorded, &again) {
        Some(what) => Err(ReplayFailure::Differs(what)),
        None => Ok(()),
    }
}

fn same<T: Serialize>(what: &str, recorded: &T, again: &T) -> Result<(), ReplayFailure> {
    let value = |of: &T| serde_json::to_value(of).map_err(|_| NotReplayable::Unreadable);
    match differing(what, &value(recorded)?, &value(again)?) {
        Some(what) => Err(ReplayFailure::Differs(what)),
        None => Ok(()),
    }
}
