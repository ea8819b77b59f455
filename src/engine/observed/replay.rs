//! Decisions on record, made again: each rule is given what is on record for it, and has to come to the same.
//!
//! A stage's decision is replayed from the raw values of its evidence: manifests and declarations for validation, episode
//! pairs and drills for behaviour and recovery, shadow sequences for shadow, the signed answers for the gate; each under
//! the profile it names, a site's own by its texts on record. Reads; decides nothing and changes nothing.

mod people;

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;
use serde_json::Value;

use holdpoint_governance::behavior::{self, SequenceEvidence};
use holdpoint_governance::composition::{Kappas, PsiContext, psi, psi_after_shadow};
use holdpoint_governance::condition::Condition;
use holdpoint_governance::decision::{Decision, MadeUnder};
use holdpoint_governance::ended::EndReason;
use holdpoint_governance::evidence::{Binding, PairedEvidence, RecoveryEvidence, ShadowEvidence};
use holdpoint_governance::gate::{self, GateInput, assess_shadow};
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::interface::{Registered, unmet};
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::metrics::observed::{NotReplayable, Replay};
use holdpoint_governance::omitted::Omitted;
use holdpoint_governance::outcome::Check;
use holdpoint_governance::own_profile::{OwnProfile, ProfileTexts};
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_governance::record::AuditRecord;
use holdpoint_governance::recovery;
use holdpoint_governance::risk::RiskClass;
use holdpoint_governance::search::Searched;
use holdpoint_governance::shift::{hold_against_sandbox, is_suspicious, judge_again};
use holdpoint_governance::wall_time::WallTime;
use holdpoint_registry::names::EvidenceKind;
use holdpoint_registry::{ApprovalEntry, EvidenceEntry, StoreError, Views};
use holdpoint_runtime::capability::Capability;

use super::history::History;
use crate::check;
use crate::context;
use crate::dossier::{Dossier, StaticAssessment};
use crate::doubt::{Confirmation, Suspicion, WorkedAgain};
use crate::ledger::{self, Member};
use crate::origin;
use crate::stages::sandbox::MODE_EPISODES;
use crate::stated;

/// A profile with its compiled policies, and the digests by which decisions name them.
pub(super) struct RulesInForce {
    pub(super) profile: Profile,
    digest: Digest,
    table: PolicyTable,
}

impl RulesInForce {
    /// Those that come with the program; one that does not load is left out.
    pub(super) fn known() -> Vec<Self> {
        ProfileName::ALL.into_iter().filter_map(|name| Self::of(Profile::builtin(name).ok()?)).collect()
    }

    /// A profile with the policies that come with the program under its name.
    pub(super) fn of(profile: Profile) -> Option<Self> {
        let table = PolicyTable::builtin(&profile).ok()?;
        Self::with(profile, table)
    }

    /// A site's own, by its texts on record; nothing if they make none for this build.
    fn own(texts: &ProfileTexts) -> Option<Self> {
        let own = OwnProfile::parse(texts.clone()).ok()?;
        Self::with(own.profile().clone(), own.table().clone())
    }

    fn with(profile: Profile, table: PolicyTable) -> Option<Self> {
        let digest = profile.digest().ok()?;
        Some(Self { profile, digest, table })
    }

    /// The same by its digest, with another rule behind it.
    #[cfg(test)]
    pub(super) fn changed(self, change: impl FnOnce(&mut Profile)) -> Self {
        let mut changed = self;
        change(&mut changed.profile);
        changed
    }
}

/// Why a decision did not come out, before it is known whose fault that is.
pub(super) enum Failed {
    Differs(String),
    Not(NotReplayable),
}

impl From<NotReplayable> for Failed {
    fn from(why: NotReplayable) -> Self {
        Self::Not(why)
    }
}

/// What is on record about one version. It may be large, so one is looked at after the other.
pub(super) struct VersionOnRecord {
    pub(super) id: CapabilityId,
    pub(super) evidence: Vec<EvidenceEntry>,
    approvals: Vec<ApprovalEntry>,
}

impl VersionOnRecord {
    pub(super) fn read(views: &Views, id: &CapabilityId) -> Result<Self, StoreError> {
        let (evidence, approvals) = (views.evidence(id, None)?, views.approvals(id)?);
        Ok(Self { id: id.clone(), evidence, approvals })
    }

    /// The conditions of use of the newest pass of the gate before a record.
    pub(super) fn conditions_before(&self, seq: u64) -> Vec<Condition> {
        let mut gates =
            self.evidence.iter().rev().filter(|one| one.kind == EvidenceKind::Gate && one.seq < seq);
        let passed = gates.find_map(|entry| serde_json::from_str::<Decision<Value>>(&entry.json).ok());
        passed.map_or_else(Vec::new, |decision| decision.answers().conditions.clone())
    }

    /// The newest dossier with a shadow in it, on record before a record.
    pub(super) fn shadow_before(&self, seq: u64) -> Option<Dossier> {
        let shadows = self.evidence.iter().rev();
        let mut shadows = shadows.filter(|one| one.kind == EvidenceKind::Shadow && one.seq < seq);
        shadows.find_map(|entry| dossier(&entry.json))
    }
}

/// Replays decisions of one store.
pub(super) struct Replayer<'a> {
    pub(super) history: &'a History,
    /// Profiles that come with the program and those on record.
    frames: Vec<RulesInForce>,
    /// What was in force, by the digest that the chain names it by: a place in `frames`.
    in_force: BTreeMap<Digest, usize>,
    /// Robot, scene and build of this program.
    environment: Digest,
    /// What loads of the versions in the store, and is what was registered.
    members: BTreeMap<CapabilityId, Member>,
}

impl<'a> Replayer<'a> {
    /// `frames`: the profiles that are known without the record.
    pub(super) fn new(
        views: &Views,
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
        let load = |id: &CapabilityId| Some((id.clone(), ledger::load_member(views, id).ok()??));
        let members = history.registered.iter().filter_map(|(_, id, _)| load(id)).collect();
        Self { history, frames, in_force, environment, members }
    }

    /// The decision of a stage.
    pub(super) fn decision(&self, of: &VersionOnRecord, record: &AuditRecord) -> Replay {
        let Some(under) = made_under(record) else {
            return Replay::NotReplayed { why: NotReplayable::Unreadable };
        };
        self.concluded(&under.environment, self.replayed(of, record, &under))
    }

    /// What settled a doubt or a suspicion, or did not; nothing is concluded where a suspicion begins.
    pub(super) fn settled(&self, entry: &EvidenceEntry) -> Option<Replay> {
        if let Ok(suspicion) = serde_json::from_str::<Suspicion>(&entry.json) {
            let again = suspicion.again.as_ref()?;
            let binding = again.pairs.binding;
            let found = self
                .frame(&binding.profile, &binding.policy)
                .map_err(Failed::from)
                .and_then(|frame| worked_again(again, frame))
                .and_then(|()| is_on_record(suspicion.digest(), entry));
            return Some(self.concluded(&binding.environment, found));
        }
        let Ok(kept) = serde_json::from_str::<Confirmation>(&entry.json) else {
            return Some(Replay::NotReplayed { why: NotReplayable::Unreadable });
        };
        let binding = kept.pairs.binding;
        Some(self.concluded(&binding.environment, self.confirmed(&kept, &binding, entry)))
    }

    /// A difference is a difference of the record only if this very build decided.
    fn concluded(&self, environment: &Digest, replayed: Result<(), Failed>) -> Replay {
        match replayed {
            Ok(()) => Replay::Equal,
            Err(Failed::Differs(_)) if *environment != self.environment => {
                Replay::NotReplayed { why: NotReplayable::OtherBuild }
            }
            Err(Failed::Differs(what)) => Replay::Differs { what },
            Err(Failed::Not(why)) => Replay::NotReplayed { why },
        }
    }

    fn replayed(&self, of: &VersionOnRecord, record: &AuditRecord, under: &MadeUnder) -> Result<(), Failed> {
        let frame = self.frame(&under.profile, &under.policy)?;
        let before = of.evidence.iter().rev().filter(|entry| entry.seq < record.seq);
        let newest = before.clone().next().ok_or(NotReplayable::EvidenceMissing)?;
        let measured = before.clone().find_map(|entry| Some((entry, dossier(&entry.json)?)));
        let (entry, dossier) = measured.ok_or(NotReplayable::Unreadable)?;
        let kappas = dossier.kappas.as_ref().ok_or(NotReplayable::Unreadable)?;
        match newest.kind {
            EvidenceKind::Compat => {
                self.statically(&of.id, newest.seq, (kappas, dossier.risk.as_ref()), frame)?;
                compose(kappas, frame, under, record)
            }
            EvidenceKind::Sandbox => {
                behaves(&dossier, frame)?;
                compose(kappas, frame, under, record)?;
                same_evidence(under, entry, &dossier)
            }
            EvidenceKind::Shadow => {
                let check = shadowed(&dossier, frame)?;
                let context = PsiContext { has_approver: frame.profile.has_approver() };
                as_recorded(record, &psi_after_shadow(kappas, context, *under, check))?;
                same_evidence(under, entry, &dossier)
            }
            EvidenceKind::Gate | EvidenceKind::Activation => {
                self.gated(of, (newest.seq, record), under, &dossier, frame)?;
                same_evidence(under, entry, &dossier)
            }
            EvidenceKind::Monitor | EvidenceKind::Rollback | EvidenceKind::Drill => {
                Err(NotReplayable::EvidenceMissing.into())
            }
        }
    }

    /// The four assessments without running anything, from what was registered and active before a record.
    fn statically(
        &self,
        id: &CapabilityId,
        seq: u64,
        (kappas, risk): (&Kappas, Option<&RiskClass>),
        frame: &RulesInForce,
    ) -> Result<(), Failed> {
        let candidate = self.capability(id)?;
        let registered = self.registered_before(seq)?;
        let active = registered.iter().find(|one| one.active && one.id.family == id.family);
        let active = active.map(|one| self.capability(&one.id)).transpose()?;
        let fallback = candidate.manifest.recovery.fallback.as_ref();
        let resolves = fallback.map(|binding| {
            self.history.registered.iter().any(|(_, known, _)| {
                known.family == binding.family
                    && binding.version.matches(&known.version)
                    && matches!(
                        self.history.state_before(known, seq),
                        Some(State::Active | State::Superseded)
                    )
            })
        });
        let author_known = self.author_known_before(id, seq)?;
        let against =
            check::Against { active, registered: &registered, fallback_resolves: resolves, author_known };
        let StaticAssessment { kappas: found, risk: class, .. } =
            check::assess(candidate, &against, &frame.profile, &frame.table);
        // Evidence of older builds has none.
        if let Some(risk) = risk {
            same("risk class", risk, &class)?;
        }
        same("kappa_I", &kappas.interface, &found.interface)?;
        same("kappa_P", &kappas.policy, &found.policy)?;
        same("kappa_B", &kappas.behavior, &found.behavior)?;
        same("kappa_R", &kappas.recovery, &found.recovery)
    }

    /// What a dependency could resolve to before a record, as the ledger has it: by family, each in the order of
    /// registration.
    fn registered_before(&self, seq: u64) -> Result<Vec<Registered>, Failed> {
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

    /// `asked_seq`: the first record of what the gate's decision moved; it was asked before.
    fn gated(
        &self,
        of: &VersionOnRecord,
        (asked_seq, record): (u64, &AuditRecord),
        under: &MadeUnder,
        dossier: &Dossier,
        frame: &RulesInForce,
    ) -> Result<(), Failed> {
        let kappas = dossier.kappas.as_ref().ok_or(NotReplayable::Unreadable)?;
        let Member { capability: candidate, origin, .. } = self.member(&of.id)?;
        let risk = origin::assessed_risk(dossier);
        let approval = if self.history.is_emergency(&of.id, (asked_seq, record.seq)) {
            self.emergency(of, record, under, (risk, frame))?
        } else {
            self.answers(of, record, under, kappas, (risk, frame))?
        };
        let closed = self.history.closed_before(&of.id, asked_seq).union(&dossier.closed).copied().collect();
        let input = GateInput {
            kappas,
            shadow: dossier.shadow.as_ref(),
            bindings: &dossier.bindings,
            current: &bound(under),
            improved: dossier.behavior.as_ref().is_some_and(|behavior| behavior.improved),
            approval: approval.as_ref(),
            risk,
            requester: &origin.requester,
            provenance: candidate.submission.provenance,
            closed: &closed,
            unmet: &unmet(&candidate.manifest, &self.registered_before(asked_seq)?),
            review_open: self.history.review_open_before(&of.id.family, asked_seq),
            profile_authorized: true,
            now: wall_of(record),
            clock_doubt: self.history.clock_doubt_before(asked_seq),
            row_version: 0,
            made_under: *under,
            omitted: Omitted::default(),
        };
        as_recorded(record, &gate::evaluate(&input, &frame.table, &frame.profile).decision)
    }

    fn confirmed(&self, kept: &Confirmation, binding: &Binding, entry: &EvidenceEntry) -> Result<(), Failed> {
        let frame = self.frame(&binding.profile, &binding.policy)?;
        // A confirmation works no episode under stress, and searches for nothing.
        let beside =
            BesidePairs { handovers: kept.handovers.as_ref(), unsafe_under_stress: 0, searched: None };
        assessed(&kept.pairs, &kept.drills, (&kept.behavior, &kept.recovery), frame, &beside)?;
        is_on_record(Digest::of_json("holdpoint.confirmation.v1", kept), entry)
    }

    fn frame(&self, profile: &Digest, policy: &Digest) -> Result<&RulesInForce, NotReplayable> {
        let found = self.frames.iter().find(|one| one.digest == *profile && one.table.digest == *policy);
        found.ok_or(NotReplayable::ProfileUnknown)
    }

    fn capability(&self, id: &CapabilityId) -> Result<&Capability, Failed> {
        self.member(id).map(|member| &member.capability)
    }

    fn member(&self, id: &CapabilityId) -> Result<&Member, Failed> {
        self.members.get(id).ok_or(Failed::Not(NotReplayable::EvidenceMissing))
    }

    /// Whether a version of the same author was confirmed before a record, and was in use or kept as a way back.
    fn author_known_before(&self, id: &CapabilityId, seq: u64) -> Result<bool, Failed> {
        let Some(key) = &self.member(id)?.origin.author_key else { return Ok(false) };
        Ok(self.members.iter().any(|(known, member)| {
            known != id
                && member.origin.author_key.as_ref() == Some(key)
                && self.history.confirmed_before(known, seq)
                && matches!(self.history.state_before(known, seq), Some(State::Active | State::Superseded))
        }))
    }

    /// What was in force when a record was written: by the chain, or in stores that do not say it in this build's
    /// form, by the last decision about the version before.
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

/// What a stage's decision was made under; nothing of another record.
fn made_under(record: &AuditRecord) -> Option<MadeUnder> {
    let decision: Decision<Value> = serde_json::from_value(stated::rule_part(&record.body)?).ok()?;
    Some(*decision.made_under())
}

/// When a record was written, as deadlines were held against it; a script's by its own clock.
fn wall_of(record: &AuditRecord) -> WallTime {
    match record.wall_ms {
        0 => WallTime::SCRIPT_EPOCH.plus_ms(record.at_ms),
        wall_ms => WallTime::from_ms(wall_ms),
    }
}

/// A dossier that was assessed; nothing for evidence in another form.
fn dossier(json: &str) -> Option<Dossier> {
    serde_json::from_str::<Dossier>(json).ok().filter(|dossier| dossier.kappas.is_some())
}

/// What the evidence had to be bound to when it was decided on.
const fn bound(under: &MadeUnder) -> Binding {
    Binding {
        candidate: under.candidate,
        active: under.active,
        profile: under.profile,
        policy: under.policy,
        environment: under.environment,
        neighbours: under.neighbours,
    }
}

/// `Psi` over the four assessments as recorded, against the decision.
fn compose(
    kappas: &Kappas,
    frame: &RulesInForce,
    under: &MadeUnder,
    record: &AuditRecord,
) -> Result<(), Failed> {
    let context = PsiContext { has_approver: frame.profile.has_approver() };
    as_recorded(record, &psi(kappas, context, *under))
}

/// Behaviour and recovery, from the raw pairs and drills of the sandbox.
fn behaves(dossier: &Dossier, frame: &RulesInForce) -> Result<(), Failed> {
    let (Some(binding), Some((candidate, active))) = (dossier.bindings.first(), dossier.drills) else {
        return Err(NotReplayable::EvidenceMissing.into());
    };
    let (Some(behavior), Some(recovery)) = (&dossier.behavior, &dossier.recovery) else {
        return Err(NotReplayable::EvidenceMissing.into());
    };
    let pairs = PairedEvidence {
        binding: *binding,
        pairs: dossier.pairs.clone(),
        hard_stops: dossier.hard_stops.clone(),
    };
    let drills = RecoveryEvidence { binding: *binding, candidate, active };
    let beside = BesidePairs {
        handovers: dossier.handovers.as_ref(),
        unsafe_under_stress: dossier.unsafe_under_stress,
        searched: dossier.searched.as_ref(),
    };
    assessed(&pairs, &drills, (behavior, recovery), frame, &beside)?;
    let Some(kappas) = &dossier.kappas else { return Err(NotReplayable::Unreadable.into()) };
    same("kappa_B", &kappas.behavior, &behavior.assessment)?;
    same("kappa_R", &kappas.recovery, &recovery.assessment)
}

/// What behaviour is judged by beside its pairs.
struct BesidePairs<'a> {
    handovers: Option<&'a SequenceEvidence>,
    unsafe_under_stress: u32,
    searched: Option<&'a Searched>,
}

/// Pairs and drills against what was made of them. Each rule asks again whether the evidence bears out that it ended
/// early.
fn assessed(
    pairs: &PairedEvidence,
    drills: &RecoveryEvidence,
    (behavior, recovery): (&behavior::BehaviorAssessment, &recovery::RecoveryAssessment),
    frame: &RulesInForce,
    beside: &BesidePairs<'_>,
) -> Result<(), Failed> {
    let ended = behavior.ended.or(recovery.ended).unwrap_or(EndReason::Full);
    let profile = &frame.profile;
    let mut again = behavior::assess_ended(pairs, &pairs.binding, profile, ended);
    behavior::judge_sequences(&mut again, beside.handovers, profile);
    behavior::doubt_under_stress(&mut again, beside.unsafe_under_stress, MODE_EPISODES, profile);
    behavior::doubt_by_search(&mut again, beside.searched, profile);
    same("behaviour", behavior, &again)?;
    same("recovery", recovery, &recovery::assess_ended(drills, &drills.binding, profile, ended))
}

/// What working a suspicious version again came to, from its raw pairs and sequences.
fn worked_again(again: &WorkedAgain, frame: &RulesInForce) -> Result<(), Failed> {
    let WorkedAgain { pairs, handovers, behavior, .. } = again;
    let ended = behavior.ended.unwrap_or(EndReason::Full);
    let mut found = behavior::assess_ended(pairs, &pairs.binding, &frame.profile, ended);
    behavior::judge_sequences(&mut found, handovers.as_ref(), &frame.profile);
    same("behaviour in the live world's conditions", behavior, &found)
}

/// Whether evidence is the one whose digest is on record.
fn is_on_record(digest: Result<Digest, serde_json::Error>, entry: &EvidenceEntry) -> Result<(), Failed> {
    match digest {
        Ok(digest) if digest == entry.digest => Ok(()),
        _ => Err(Failed::Differs("the evidence is not the one whose digest is on record".to_owned())),
    }
}

/// Shadow, from its raw sequences: what it came to.
fn shadowed(dossier: &Dossier, frame: &RulesInForce) -> Result<Check, Failed> {
    let (Some(binding), Some(recorded)) = (dossier.bindings.last(), &dossier.shadow) else {
        return Err(NotReplayable::EvidenceMissing.into());
    };
    let evidence = ShadowEvidence {
        binding: *binding,
        sequences: dossier.sequences.clone(),
        hard_stops: dossier.hard_stops.clone(),
    };
    let mut again = assess_shadow(&evidence, binding, &frame.profile);
    hold_against_sandbox(&mut again, &evidence, &dossier.pairs, &frame.profile);
    if let Some(worked) = &dossier.again {
        if !is_suspicious(&again) {
            return Err(Failed::Differs("it was worked again, and is not suspicious".to_owned()));
        }
        worked_again(worked, frame)?;
        judge_again(&mut again, &worked.behavior, worked.pairs.pairs.len());
    }
    same("shadow", recorded, &again)?;
    Ok(recorded.check)
}

/// Whether the evidence is the one the decision names, by its digest.
fn same_evidence(under: &MadeUnder, entry: &EvidenceEntry, dossier: &Dossier) -> Result<(), Failed> {
    let named = under.evidence == entry.digest;
    if named && dossier.digest().is_ok_and(|digest| digest == entry.digest) {
        return Ok(());
    }
    Err(Failed::Differs("the evidence is not the one the decision names by its digest".to_owned()))
}

/// Whether a decision made again is, in the form of records, the recorded one.
fn as_recorded<O: Serialize>(record: &AuditRecord, again: &Decision<O>) -> Result<(), Failed> {
    let recorded = stated::rule_part(&record.body).ok_or(NotReplayable::Unreadable)?;
    let again = serde_json::to_value(again).map_err(|_| NotReplayable::Unreadable)?;
    match differing("decision", &recorded, &again) {
        Some(what) => Err(Failed::Differs(what)),
        None => Ok(()),
    }
}

fn same<T: Serialize>(what: &str, recorded: &T, again: &T) -> Result<(), Failed> {
    let value = |of: &T| serde_json::to_value(of).map_err(|_| NotReplayable::Unreadable);
    match differing(what, &value(recorded)?, &value(again)?) {
        Some(what) => Err(Failed::Differs(what)),
        None => Ok(()),
    }
}

/// The longest value that is quoted of either side, characters.
const QUOTED_CHARS: usize = 60;

/// The first place at which two values differ, with both; nothing if they are equal.
pub(super) fn differing(at: &str, recorded: &Value, again: &Value) -> Option<String> {
    if recorded == again {
        return None;
    }
    match (recorded, again) {
        (Value::Object(a), Value::Object(b)) if a.keys().eq(b.keys()) => {
            a.iter().find_map(|(key, value)| differing(&format!("{at}.{key}"), value, b.get(key)?))
        }
        (Value::Array(a), Value::Array(b)) if a.len() == b.len() => {
            a.iter().zip(b).enumerate().find_map(|(index, (a, b))| differing(&format!("{at}[{index}]"), a, b))
        }
        _ => {
            let quoted = |value: &Value| {
                let text = value.to_string();
                let mut short: String = text.chars().take(QUOTED_CHARS).collect();
                if short.len() < text.len() {
                    short.push('…');
                }
                short
            };
            Some(format!("{at} is {} on record and {} when replayed", quoted(recorded), quoted(again)))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn the_first_difference_is_named_with_both_sides() {
        let recorded = json!({ "outcome": "reject", "reasons": [{ "evidence": 0.1 }] });
        assert_eq!(differing("decision", &recorded, &recorded), None);
        for (again, expected) in [
            (
                json!({ "outcome": "reject", "reasons": [{ "evidence": 0.2 }] }),
                "decision.reasons[0].evidence is 0.1 on record and 0.2 when replayed",
            ),
            (
                json!({ "outcome": "reject", "reasons": [] }),
                "decision.reasons is [{\"evidence\":0.1}] on record and [] when replayed",
            ),
            (
                json!("x"),
                "decision is {\"outcome\":\"reject\",\"reasons\":[{\"evidence\":0.1}]} on record and \"x\" when replayed",
            ),
        ] {
            assert_eq!(differing("decision", &recorded, &again).as_deref(), Some(expected));
        }
    }
}
