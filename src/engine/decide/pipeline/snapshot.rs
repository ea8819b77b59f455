//! The snapshot: the current state of cell, versions and requests.

use super::StageWork;
use crate::decide::clock_mismatch;
use crate::decide::people::approvals::Approvals;
use crate::decide::people::break_glass_approvals;
use crate::decide::people::request_display::RequestSources;
use crate::decide::people::signed_calls::SignedCalls;
use crate::decide::recorder::EngineRecorder;
use crate::live::monitors::Monitors;
use crate::live::{self, LiveWorld};
use holdpoint_governance::alarms::Alarm;
use holdpoint_governance::decision::Reason;
use holdpoint_governance::finding::Finding;
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::version_status::{RecordedChanges, VersionCondition};
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::clock::Clock;
use holdpoint_protocol::snapshot::{
    AlarmView, ApprovalRequestView, CandidateView, FamilyView, LiveView, ReviewView, Snapshot,
};
use holdpoint_record::context::Context;
use holdpoint_record::evidence_binding::stale_causes;
use holdpoint_record::evidence_file::{EvidenceFile, EvidenceFiles};
use holdpoint_record::evidence_view::{pairs, shadow};
use holdpoint_record::version_table::FamilyEntry;
use holdpoint_text::Hint;

/// What a snapshot is taken of.
pub(crate) struct SnapshotView<'a> {
    pub(crate) context: &'a Context,
    pub(crate) record: &'a EngineRecorder,
    pub(crate) evidence_files: &'a EvidenceFiles,
    pub(crate) approvals: &'a Approvals,
    pub(crate) signed_calls: &'a SignedCalls,
    pub(crate) monitors: &'a Monitors,
    pub(crate) world: &'a LiveWorld,
    pub(super) parked: &'a [StageWork],
}

/// The reasons of the newest decision that explain what the version is now. Those of the gate, which decides before the
/// approvers are asked, have the count of approvals since.
fn present_reasons(
    reasons: &[Reason],
    condition: VersionCondition,
    request: Option<&ApprovalRequestView>,
) -> Vec<Reason> {
    let explains = |reason: &&Reason| condition.is_explained_by(reason.code);
    let mut reasons: Vec<Reason> = reasons.iter().filter(explains).cloned().collect();
    let Some(request) = request else { return reasons };
    let given = u32::try_from(request.approved_by.len()).unwrap_or(u32::MAX);
    let count = if request.officer_missing && given >= request.needed {
        Finding::SafetyOfficerMissing
    } else {
        Finding::ApprovalsSoFar { given, needed: request.needed }
    };
    for reason in &mut reasons {
        if reason.finding == Some(Finding::NotAskedYet) {
            *reason = Reason::new(reason.dimension, count.clone());
        }
    }
    reasons
}

impl SnapshotView<'_> {
    /// The current snapshot.
    pub(crate) fn snapshot(&self) -> Snapshot {
        let Self { context, record, evidence_files, .. } = *self;
        let from = RequestSources { context, record, evidence_files };
        let prompts = self.approvals.views(from);
        let mut candidates = Vec::new();
        let mut families = Vec::new();
        for (family, entry) in self.record.version_table().families() {
            families.push(self.family_view(family, entry));
            for (member, version) in entry.members.iter().zip(&entry.state.versions) {
                let id = member.capability.id();
                let baseline = member.capability.submission.parent.is_none();
                let request = prompts.iter().find(|request| request.version == id);
                let rests = baseline && matches!(version.state, State::Active | State::Superseded);
                if rests && request.is_none() {
                    continue;
                }
                let empty = EvidenceFile::default();
                let evidence_file = self.evidence_files.of(&id).unwrap_or(&empty);
                let submission = &member.capability.submission;
                candidates.push(CandidateView {
                    parked: self.parked.iter().any(|work| *work.id() == id),
                    version: id,
                    digest: member.capability.digest(),
                    state: version.state,
                    left: member.course.left,
                    ran: member.course.ran,
                    confirmed: member.course.confirmed,
                    flags: version.flags,
                    row_version: member.row_version,
                    author: submission.author.clone(),
                    provenance: submission.provenance,
                    risk: evidence_file.risk.as_ref().map_or(submission.estimated_risk, |risk| risk.class),
                    progress: evidence_file.progress.clone(),
                    dimensions: evidence_file.dimensions(&self.context.profile),
                    composite: evidence_file.composite(&self.context.profile),
                    pairs: pairs(evidence_file),
                    drills: evidence_file.drills,
                    shadow: shadow(evidence_file, &self.context.profile.evaluation),
                    reasons: present_reasons(
                        &evidence_file.reasons,
                        VersionCondition::of(version.state, &version.flags, evidence_file.held),
                        request,
                    ),
                    conditions: evidence_file.conditions.clone(),
                    deployment: evidence_file.deployment,
                    held: evidence_file.held,
                    closed: version.closed.union(&evidence_file.closed).copied().collect(),
                    stale: stale_causes(
                        self.context,
                        self.record.version_table(),
                        &member.capability,
                        version.state,
                        evidence_file,
                    ),
                    counted: evidence_file.counted.clone(),
                    status: None,
                });
            }
        }
        let mut snapshot = Snapshot {
            at_ms: self.record.now_ms(),
            wall_ms: self.record.version_table().wall().machine_time().map(WallTime::ms),
            up_since_ms: match self.record.clock() {
                Clock::Real { from_ms, .. } => Some(*from_ms),
                Clock::Virtual { .. } => None,
            },
            time: self.record.wall_now(),
            clock_doubt: clock_mismatch::view(self.record),
            profile: self.context.profile.name,
            site: self.context.profile.site.clone(),
            site_file: self.context.cell.site_file(),
            robot: self.context.cell.spec.robot.name.clone(),
            seed: self.record.seeds().of_run(),
            policy: self.context.digest,
            agent: self.world.cell.agent_hash(),
            reading: None,
            signing: self.signed_calls.view(self.context, self.record),
            holding: self.record.holding().map(Hint::sentence),
            stopped: self.world.halted.clone(),
            unauthorized: self.context.unauthorized.as_ref().map(holdpoint_wording::notice_sentence),
            families,
            candidates,
            emergencies: break_glass_approvals::views(from),
            prompts,
            alarms: self.alarm_views(),
            live: self.live_view(),
            questions: self.monitors.questions(),
            alarm_summary: self.record.alarms().summary(self.record.now_ms()),
            scenery: live::scenery(&self.context.cell),
            thresholds: self.context.thresholds(),
            observed: self.record.observed(),
            seats: Vec::new(),
            ends_alone_s: None,
        };
        // The queue, which a status names, is known once all candidates are.
        let (table, nothing) = (self.record.version_table(), RecordedChanges::default());
        let status = |of: &CandidateView| {
            snapshot.status_by(of, table.recorded_changes(&of.version).unwrap_or(&nothing))
        };
        let statuses: Vec<_> = snapshot.candidates.iter().map(status).collect();
        for (candidate, status) in snapshot.candidates.iter_mut().zip(statuses) {
            candidate.status = Some(status);
        }
        snapshot
    }

    fn family_view(&self, family: &holdpoint_governance::ids::Family, entry: &FamilyEntry) -> FamilyView {
        let active = entry.state.active();
        let version = active.and_then(|active| entry.state.get(active));
        let pinned = version.and_then(|version| version.predecessor);
        let name = |version: holdpoint_governance::lifecycle::VersionRef| {
            entry.members.get(usize::from(version.0)).map(|member| member.capability.id())
        };
        let needed = self.context.profile.activation.provisional_episodes;
        FamilyView {
            family: family.clone(),
            active: active.and_then(name),
            pinned: pinned.and_then(name),
            safe_stopped: entry.state.safe_stopped,
            flags: version.map(|version| version.flags),
            provisional: self.monitors.window(family).map(|episodes| (episodes, needed)),
            review: entry.state.review.and_then(|review| {
                let overdue = review.until <= self.record.wall_now();
                Some(ReviewView { version: name(review.version)?, until: review.until, overdue })
            }),
        }
    }

    fn alarm_views(&self) -> Vec<AlarmView> {
        let now_ms = self.record.now_ms();
        self.record.alarms().open().into_iter().map(|alarm| alarm_view(alarm, now_ms)).collect()
    }

    fn live_view(&self) -> LiveView {
        let (recent, last) = (self.world.recent(), &self.world.last_tasks);
        let n = recent.len();
        let share = (n > 0).then(|| recent.iter().filter(|ok| **ok).count() as f64 / n as f64);
        let needed = self.context.profile.activation.provisional_episodes;
        LiveView {
            sequences: self.world.cell.sequences(),
            recent_success: share,
            recent: n as u64,
            last: last.clone(),
            uncovered: self.world.uncovered,
            drift: self.world.cell.drift().copied(),
            fault: self.world.cell.fault,
            goal: self.world.cell.goal.name().to_owned(),
            pace: self.world.pace(),
            outcomes: recent,
            monitors: self.monitors.views(needed),
        }
    }
}

/// An alarm as it is shown.
#[must_use]
pub fn alarm_view(alarm: &Alarm, now_ms: u64) -> AlarmView {
    AlarmView {
        alarm: alarm.key.to_string(),
        subject: alarm.group.to_string(),
        state: alarm.state(),
        priority: alarm.priority,
        text: alarm.text.clone(),
        since_ms: alarm.first_ms,
        state_below: alarm.state_below(),
        latching: alarm.latching,
        acknowledged_by: alarm.acknowledged_by.clone().filter(|by| !by.is_empty()),
        shelf: alarm
            .shelf
            .as_ref()
            .map(|shelf| (shelf.by.clone(), shelf.reason.raw().to_owned(), shelf.until)),
        raises: alarm.raises,
        chattering: alarm.is_chattering(now_ms),
    }
}
