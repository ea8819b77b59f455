//! Answers to questions: one version in full, pages of the registry and of the audit log, the chain checked.
//!
//! Reads the store's views and the evidence; changes nothing. Every page is bounded in rows and bytes.

use std::collections::BTreeSet;

use crate::fault::ExplainFault;
use crate::why;
use holdpoint_governance::decision::Reason;
use holdpoint_governance::explanation::{LookupRefusal, SearchField, VerifiedChain};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::record::{AuditRecord, RecordKind, VersionGroup};
use holdpoint_protocol::command::{Refusal, Reply};
use holdpoint_protocol::detail::{AuditPage, AuditVerification, Detail, PAGE_MAX, RegistryPage};
use holdpoint_record::context::Context;
use holdpoint_record::difference::version_differences;
use holdpoint_record::evidence_file::{EvidenceFile, EvidenceFiles};
use holdpoint_record::evidence_view::{behavior, drills, modes};
use holdpoint_record::rationale::check_explanation;
use holdpoint_record::version_table::VersionTable;
use holdpoint_runtime::capability::Capability;
use holdpoint_store::{AuditFilter, EvidenceEntry, EvidenceKind, ReadableStore, StoreError, VersionFilter};
use holdpoint_text::Hint;
use holdpoint_wording::lookup::{lookup_hint, lookup_refusal, verified_chain};

/// The most bytes of record bodies in one answer; a page that would be longer ends there.
const BODIES_BYTES_MAX: usize = 6 * 1024 * 1024;

/// The longest part of a record's body in a version's trail, bytes; the whole body is in the audit log.
const TRAIL_BODY_BYTES_MAX: usize = 4 * 1024;

/// The most records of a version's trail; a longer one is without seals.
const TRAIL_MAX: usize = 500;

/// The longest text that is looked for, bytes.
const TEXT_BYTES_MAX: usize = 256;

/// A page of the registry.
///
/// # Errors
/// If the store cannot be read.
pub fn registry_page(
    context: &Context,
    version_table: &VersionTable,
    group: VersionGroup,
    text: &str,
    offset: u64,
    limit: u64,
) -> Result<Reply, ExplainFault> {
    if let Some(refused) = too_long(SearchField::Text, text) {
        return Ok(refused);
    }
    let filter = VersionFilter {
        group,
        text: (!text.is_empty()).then(|| text.to_owned()),
        offset: usize::try_from(offset).unwrap_or(usize::MAX),
        limit: rows(limit),
        ..VersionFilter::default()
    };
    let (found, total) = version_table.store().views()?.versions(&filter)?;
    let anchors = version_table.anchors_by_people().cloned().collect();
    let thresholds = context.thresholds();
    let page = RegistryPage { rows: found, total: total as u64, thresholds, anchors };
    Ok(Reply::Registry { page })
}

/// A page of the audit log, the newest first.
///
/// # Errors
/// If the store cannot be read.
pub fn audit_page(
    version_table: &VersionTable,
    before: Option<u64>,
    subject: &str,
    without: BTreeSet<RecordKind>,
    limit: u64,
) -> Result<Reply, ExplainFault> {
    if let Some(refused) = too_long(SearchField::Subject, subject) {
        return Ok(refused);
    }
    let views = version_table.store().views()?;
    let filter = AuditFilter {
        before_seq: before,
        subject: (!subject.is_empty()).then(|| subject.to_owned()),
        without,
        limit: rows(limit),
        newest_first: true,
        ..AuditFilter::default()
    };
    let rows = bounded(views.audit(&filter)?);
    let head = views.head()?.seq;
    Ok(Reply::Audit { page: AuditPage { rows, head } })
}

/// Checks the whole chain, the registry against it, and what is sealed into it.
pub(crate) fn verify_audit(reader: &dyn ReadableStore) -> Result<Reply, StoreError> {
    let head = reader.views()?.head()?.seq;
    let verified = match reader.verify() {
        Ok(report) => AuditVerification {
            holds: true,
            records: report.records,
            text: verified_chain(&VerifiedChain {
                checkpoints: report.checkpoints,
                signatures_checked: report.key_given,
                approvals: report.approvals,
                batches: report.batches,
            }),
        },
        Err(error) => AuditVerification { holds: false, records: head, text: error.sentence() },
    };
    Ok(Reply::Verified { verified })
}

/// Everything about one version.
///
/// # Errors
/// If the store or the version cannot be read.
pub fn detail(
    context: &Context,
    version_table: &VersionTable,
    evidence_files: &EvidenceFiles,
    id: &CapabilityId,
) -> Result<Reply, ExplainFault> {
    let views = version_table.store().views()?;
    let Some(stored) = views.version(id)? else {
        return Ok(refused(&LookupRefusal::UnknownVersion(id.clone())));
    };
    let evidence_file = full_evidence_file(evidence_files, id, &stored.evidence);
    let (_, _, member) = version_table.version(id)?;
    let capability = &member.capability;
    let against = against(version_table, id);
    let explained = why::explain(&*views, id)?;
    let is_long = stored.audit_links.len() > TRAIL_MAX;
    let filter = AuditFilter {
        subject: Some(id.to_string()),
        without: RecordKind::SEALS.into_iter().filter(|_| is_long).collect(),
        limit: TRAIL_MAX,
        newest_first: true,
        ..AuditFilter::default()
    };
    let registration = AuditFilter {
        subject: Some(id.to_string()),
        kind: Some(RecordKind::VersionRegistered),
        limit: 1,
        ..AuditFilter::default()
    };
    let registration = views.audit(&registration)?;
    let mut audit = bounded(views.audit(&filter)?);
    audit.iter_mut().for_each(shorten);
    let assessed = evidence_file.kappas.is_some();
    let detail = Detail {
        version: id.clone(),
        against: against.as_ref().map(Capability::id),
        parent: stored.parent.clone(),
        digest: stored.candidate_digest,
        summary: capability.submission.summary.clone(),
        author: stored.summary.author.clone(),
        provenance: stored.summary.provenance,
        risk: evidence_file.risk.as_ref().map_or(stored.summary.risk, |risk| risk.class),
        risk_causes: evidence_file.risk.as_ref().map(|risk| risk.causes.clone()).unwrap_or_default(),
        requester: member.origin.requester.clone(),
        registered_ms: stored.registered_ms,
        registered_at: registration.first().and_then(AuditRecord::wall),
        dimensions: evidence_file.dimensions(&context.profile),
        composite: evidence_file.composite(&context.profile),
        reasons: reasons(&evidence_file),
        conditions: evidence_file.conditions.clone(),
        why: check_explanation::rationales(&evidence_file, &reasons(&evidence_file)),
        differences: against.map_or_else(Vec::new, |active| version_differences(Some(&active), capability)),
        behavior: behavior(&evidence_file),
        modes: modes(&evidence_file),
        drills: drills(&evidence_file),
        decisions: explained.map_or_else(Vec::new, |all| all.decisions),
        audit,
        evidence: if assessed { Some(evidence_file.digest()?) } else { None },
        untested: if assessed {
            let aspects = holdpoint_record::untested::untested(&evidence_file);
            aspects.into_iter().map(holdpoint_wording::request::untested).collect()
        } else {
            Vec::new()
        },
    };
    Ok(Reply::Detail { detail: Box::new(detail) })
}

/// What a version would replace, or has replaced.
fn against(version_table: &VersionTable, id: &CapabilityId) -> Option<Capability> {
    let entry = version_table.family(&id.family).ok()?;
    let (_, lifecycle, _) = entry.find(id)?;
    let other = match lifecycle.state {
        State::Active | State::Superseded | State::RolledBack => lifecycle.predecessor,
        State::Registered
        | State::Validated
        | State::Sandboxed
        | State::Shadowed
        | State::Demoted
        | State::Rejected => entry.state.active(),
    };
    let member = entry.members.get(usize::from(other?.0))?;
    Some(member.capability.clone()).filter(|other| other.id() != *id)
}

/// Rows of a page: at least one, at most [`PAGE_MAX`].
fn rows(limit: u64) -> usize {
    usize::try_from(limit).unwrap_or(usize::MAX).clamp(1, PAGE_MAX)
}

fn too_long(field: SearchField, text: &str) -> Option<Reply> {
    let (bytes, max) = (text.len(), TEXT_BYTES_MAX);
    (bytes > max).then(|| refused(&LookupRefusal::TextTooLong { field, bytes, max }))
}

fn refused(refusal: &LookupRefusal) -> Reply {
    let code = match refusal {
        LookupRefusal::UnknownVersion(_) => Refusal::NotFound,
        LookupRefusal::TextTooLong { .. } => Refusal::BadInput,
    };
    Reply::Refused { code, text: lookup_refusal(refusal), hint: lookup_hint(refusal).map(str::to_owned) }
}

/// Rows until their bodies are more than one answer carries; the first one always.
fn bounded(records: Vec<AuditRecord>) -> Vec<AuditRecord> {
    let mut bytes = 0_usize;
    let mut rows = Vec::new();
    for record in records {
        bytes = bytes.saturating_add(record.body.len());
        if bytes > BODIES_BYTES_MAX && !rows.is_empty() {
            break;
        }
        rows.push(record);
    }
    rows
}

/// The beginning of a body, and how long it is.
fn shorten(row: &mut AuditRecord) {
    if row.body.len() > TRAIL_BODY_BYTES_MAX {
        let whole = row.body.len();
        let start: String = row.body.chars().take(TRAIL_BODY_BYTES_MAX / 4).collect();
        row.body = serde_json::json!({ "bytes": whole, "start": start }).to_string();
    }
}

/// Everything known of a version. Of a version in the history an engine keeps only the summary; its measurements come
/// from the record.
pub(crate) fn full_evidence_file(
    evidence_files: &EvidenceFiles,
    id: &CapabilityId,
    evidence: &[EvidenceEntry],
) -> EvidenceFile {
    let known = evidence_files.of(id).cloned().unwrap_or_default();
    let mut whole = if known.pairs.is_empty() && known.alone.is_empty() {
        match newest_evidence_file(evidence) {
            Some(stored) if known.kappas.is_some() => {
                let EvidenceFile { kappas, conditions, reasons, .. } = known;
                EvidenceFile { kappas, conditions, reasons, ..stored }
            }
            Some(stored) => stored,
            None => known,
        }
    } else {
        known
    };
    if whole.confirmation.is_none() {
        let settled = evidence.iter().rev().filter(|entry| entry.kind == EvidenceKind::Monitor);
        whole.confirmation = settled.into_iter().find_map(|entry| serde_json::from_str(&entry.json).ok());
    }
    whole
}

/// The newest recorded evidence file.
fn newest_evidence_file(evidence: &[EvidenceEntry]) -> Option<EvidenceFile> {
    use EvidenceKind as Kind;
    let stages = |entry: &&EvidenceEntry| matches!(entry.kind, Kind::Compat | Kind::Sandbox | Kind::Shadow);
    let newest = evidence.iter().rev().find(stages)?;
    serde_json::from_str(&newest.json).ok()
}

/// The reasons of the last decision first, then those of the dimensions that are not among them.
fn reasons(evidence_file: &EvidenceFile) -> Vec<Reason> {
    let mut all = evidence_file.reasons.clone();
    if let Some(kappas) = &evidence_file.kappas {
        let dimensions = [
            &kappas.interface.reasons,
            &kappas.policy.reasons,
            &kappas.behavior.reasons,
            &kappas.recovery.reasons,
        ];
        for reason in dimensions.into_iter().flatten() {
            if !all.contains(reason) {
                all.push(reason.clone());
            }
        }
    }
    all
}
