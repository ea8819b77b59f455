//! The report of `holdpoint status`: read from the store, completed by a running engine.
//!
//! The store is the authority on states; only progress, a halt and the provisional window come from the engine. One
//! formatter for all forms of the verb.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::StatusSubject;
use super::pending_approval::PendingApprovalRow;
use super::person_acts::{PersonActRow, person_acts};
use crate::cli::profile_authorization;
use crate::cli::prune::wall_ms;
use crate::cli::stop::stop_moment;
use crate::error::CliError;
use holdpoint_engine::decide::halt;
use holdpoint_governance::alarms::{AlarmState, Priority, Shelving};
use holdpoint_governance::evidence::StaleCause;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{Stage, State, VersionFlags};
use holdpoint_governance::notice::{Notice, NoticeOrText};
use holdpoint_governance::profile::{ProfileName, SiteName, titled};
use holdpoint_governance::record::{AuditRecord, VersionSummary};
use holdpoint_governance::tries::CountedTry;
use holdpoint_governance::version_status::{Obstacle, StatusFacts, VersionCondition, VersionStatus};
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::snapshot::{EscalationView, RequestKind, Snapshot, StartupProgressView, StoppedView};
use holdpoint_protocol::work_unit::PartCount;
use holdpoint_record::context::ContextRecord;
use holdpoint_registry::Views;
use holdpoint_runtime::capability::shown;
use holdpoint_service::control_socket::{ControlSocketError, UnverifiedOrigin};
use holdpoint_store::{AuditFilter, Layout, VersionFilter, lock_owner};
use holdpoint_text::Untrusted;
use holdpoint_trials::site::StoreSite;
use holdpoint_wording::counted_try;
use holdpoint_wording::program::status as sentences;
use holdpoint_wording::program::status::EngineLine;

#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct StatusReport {
    /// Whether an engine runs on the store and answers.
    pub(super) engine_running: bool,
    /// The process that has the store although no engine answers at its socket.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) in_use_by: Option<String>,
    /// Why the running engine did not answer, if so; the report then shows the store.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) silent: Option<String>,
    /// Why the answer is not known to come from the engine.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) unverified: Option<UnverifiedAnswerRow>,
    /// The last record, if the engine did not answer.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) last_record: Option<AuditRecord>,
    /// The engine's progress in reading its history while it starts: nothing shown is verified yet.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) reading: Option<StartupProgressView>,
    /// Why it is halted, if it is.
    pub(super) holding: Option<String>,
    /// The person who stopped the cell, while it is stopped.
    pub(super) stopped: Option<StoppedView>,
    /// The same as a line for people, in time of day if an engine tells it.
    #[serde(skip)]
    pub(super) stopped_line: Option<String>,
    /// Why nothing is activated and the arm stays at standstill until an administrator authorizes the profile, if
    /// so.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) unauthorized: Option<String>,
    /// The profile the store was last used with.
    pub(super) profile: Option<ProfileName>,
    /// The name of a site profile.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) site: Option<SiteName>,
    /// The site file the store was last used with; null for the built-in site.
    pub(super) site_file: Option<StoreSite>,
    pub(super) families: Vec<FamilyStatusRow>,
    pub(super) versions: Vec<VersionRow>,
    pub(super) waiting: Vec<PendingApprovalRow>,
    /// Escalations, if an engine runs.
    pub(super) questions: Vec<MonitorQuestionRow>,
    /// Versions that one person may activate by break-glass, if an engine runs.
    pub(super) emergencies: Vec<CapabilityId>,
    /// What people did to the cell as a whole, and why: its goal, its last start, and the last note.
    pub(super) people: Vec<PersonActRow>,
    pub(super) alarms: Vec<AlarmRow>,
}

/// The warning that an answer is not known to come from the engine.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct UnverifiedAnswerRow {
    code: &'static str,
    text: String,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct FamilyStatusRow {
    pub(super) family: String,
    pub(super) active: Option<CapabilityId>,
    pub(super) rollback_target: Option<CapabilityId>,
    /// Why no version is active, if the family is safe-stopped.
    pub(super) safe_stopped: Option<String>,
    /// Episodes run and needed, while the active version is provisional and an engine runs.
    pub(super) provisional_episodes: Option<(u32, u32)>,
    /// Whether the active version is provisional.
    pub(super) provisional: bool,
    /// Whether the promotion of the active version is paused; the version still runs.
    pub(super) promotion_paused: bool,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct VersionRow {
    pub(super) version: CapabilityId,
    pub(super) state: State,
    pub(super) running: Option<Stage>,
    pub(super) paused: bool,
    pub(super) awaiting_approval: bool,
    pub(super) provisional: bool,
    pub(super) restricted: bool,
    pub(super) rollback_pending: bool,
    /// Activated by break-glass, and not reviewed yet.
    pub(super) unreviewed: bool,
    /// Waits for an operator to resume it, if an engine runs.
    pub(super) held: bool,
    /// Whether it was confirmed, if an engine runs.
    #[serde(skip)]
    pub(super) confirmed: bool,
    /// Profiles it is blocked under, if an engine runs.
    pub(super) closed: Vec<ProfileName>,
    /// Why its evidence is stale, if an engine runs.
    pub(super) stale: Vec<StaleCause>,
    /// `kappa_I`, `kappa_P`, `kappa_B`, `kappa_R`; absent if not measured.
    pub(super) kappas: [Option<f64>; 4],
    /// The progress of the running stage: done and total.
    pub(super) progress: Option<ProgressRow>,
    /// The try that its sandbox counts as, if an engine runs.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) counted: Option<CountedTry>,
    /// Its status: what it is, since when, by whom or by which rule, and what ends that.
    pub(super) status: VersionStatus,
    /// The person and the reason, or the rule, of its status.
    pub(super) reason: Option<String>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct ProgressRow {
    pub(super) what: String,
    /// Of the whole stage.
    pub(super) done: u64,
    pub(super) budget: u64,
    /// Of the unit that runs, if that is a part of the stage.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) part: Option<PartCount>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct AlarmRow {
    pub(super) alarm: String,
    pub(super) priority: Priority,
    pub(super) state: AlarmState,
    /// The problem as a sentence.
    pub(super) text: String,
    /// The problem with its values; absent for the text of an older build.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) notice: Option<Notice>,
    /// The person who shelved it, until when, and why.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) shelf: Option<Shelving>,
}

impl StatusReport {
    /// The report on the subject, or on everything.
    pub(super) fn new(
        views: &Views,
        engine: Option<&Snapshot>,
        silent: Option<&ControlSocketError>,
        subject: Option<&StatusSubject>,
    ) -> Result<Self, CliError> {
        let wanted = |version: &CapabilityId| match subject {
            None => true,
            Some(StatusSubject::Family(family)) => version.family == *family,
            Some(StatusSubject::Version(one)) => version == one,
        };
        let family_of = subject.map(|subject| match subject {
            StatusSubject::Family(family) => family.to_string(),
            StatusSubject::Version(version) => version.family.to_string(),
        });
        let filter = VersionFilter { family: family_of.clone(), ..VersionFilter::default() };
        let (versions, _) = views.versions(&filter).map_err(CliError::usage)?;
        let rows = versions.iter().filter(|version| wanted(&version.version));
        let families = views.families().map_err(CliError::usage)?;
        let flags = |active: Option<&CapabilityId>| {
            let found = versions.iter().find(|version| Some(&version.version) == active);
            found.map_or_else(VersionFlags::default, |version| version.flags)
        };
        let families = families
            .into_iter()
            .filter(|status| family_of.as_ref().is_none_or(|name| *name == status.name))
            .map(|status| FamilyStatusRow {
                provisional: flags(status.active.as_ref()).provisional,
                promotion_paused: flags(status.active.as_ref()).paused,
                provisional_episodes: engine.and_then(|engine| {
                    engine.families.iter().find(|view| view.family.as_str() == status.name)?.provisional
                }),
                active: status.active,
                rollback_target: status.pinned,
                safe_stopped: status.safe_stopped.then(|| holdpoint_wording::notice(&status.reason)),
                family: status.name,
            })
            .collect();
        let in_use_by = match engine {
            Some(_) => None,
            None => views.folder().and_then(|folder| lock_owner(&Layout::new(folder)).ok()?),
        };
        let runs = engine.is_some() || silent.is_some() || in_use_by.is_some();
        // A running engine knows its requests; otherwise the store has the last ones.
        let waiting = match engine {
            Some(engine) => engine
                .prompts
                .iter()
                .map(|prompt| PendingApprovalRow::from_request(prompt, engine.time))
                .collect(),
            None => {
                // An interrupted engine may have left an earlier request for the same version.
                let requests = views.open_requests().map_err(CliError::usage)?;
                let is_awaiting = |id: &CapabilityId| {
                    versions.iter().any(|version| version.version == *id && version.flags.awaiting_approval)
                };
                let newest: BTreeMap<_, _> = requests
                    .into_iter()
                    .filter(|request| is_awaiting(&request.version))
                    .map(|request| (request.version.clone(), request))
                    .collect();
                let persons = views.persons().map_err(CliError::usage)?;
                let rows = newest.into_values().map(|request| {
                    let answers = views.approvals(&request.version).map_err(CliError::usage)?;
                    let is_active = versions
                        .iter()
                        .any(|version| version.version == request.version && version.state == State::Active);
                    let purpose = if is_active { RequestKind::Release } else { RequestKind::Activation };
                    Ok(PendingApprovalRow::stored(
                        request,
                        purpose,
                        &answers,
                        &persons,
                        WallTime::from_ms(wall_ms()),
                    ))
                });
                rows.collect::<Result<Vec<_>, CliError>>()?
            }
        };
        // The store knows of stops without an engine; a stop outlives the engine.
        let stopped = match engine {
            Some(engine) => engine.stopped.clone(),
            None => halt::recall(views).map_err(CliError::usage)?,
        };
        let newest = if engine.is_some() { None } else { last_record(views)? };
        let recorded = newest.as_ref().and_then(|record| Some((record.at_ms, record.wall()?)));
        let moment = |at_ms, wall| stop_moment((at_ms, wall), engine, recorded);
        let context = views.context().map_err(CliError::usage)?;
        let record =
            context.as_ref().and_then(|(_, _, json)| serde_json::from_str::<ContextRecord>(json).ok());
        let (site, site_file) = record.map_or((None, None), |record| (record.site, record.site_file));
        Ok(Self {
            engine_running: engine.is_some(),
            in_use_by,
            silent: silent.map(ToString::to_string),
            unverified: None,
            last_record: newest.filter(|_| silent.is_some()),
            reading: engine.and_then(|engine| engine.reading),
            holding: engine.and_then(|engine| engine.holding.clone()),
            people: person_acts(views, stopped.is_some()).map_err(CliError::usage)?,
            stopped_line: stopped
                .as_ref()
                .map(|stopped| {
                    let starter = starter(views)?;
                    Ok::<_, CliError>(sentences::stopped(
                        stopped,
                        (&starter, sentences::CELL_IS_EMPTY),
                        &moment,
                    ))
                })
                .transpose()?,
            stopped,
            unauthorized: match engine {
                Some(engine) => engine.unauthorized.clone(),
                None => profile_authorization::missing(views),
            },
            site,
            site_file,
            profile: context.map(|(profile, _, _)| profile),
            families,
            versions: rows
                .map(|version| {
                    let status = status_of(views, version, engine, runs)?;
                    Ok(VersionRow::new(version, status, engine))
                })
                .collect::<Result<_, CliError>>()?,
            waiting: waiting.into_iter().filter(|row| wanted(&row.version)).collect(),
            questions: engine
                .iter()
                .flat_map(|engine| &engine.questions)
                .filter(|question| wanted(&question.version))
                .map(MonitorQuestionRow::new)
                .collect(),
            emergencies: engine
                .iter()
                .flat_map(|engine| &engine.emergencies)
                .filter(|request| wanted(&request.version))
                .map(|request| request.version.clone())
                .collect(),
            alarms: alarms(views)?,
        })
    }

    /// What concerns the whole cell, for people. A line states its whole row, so that lines can be compared.
    pub(super) fn head(&self) -> Vec<String> {
        let mut lines = Vec::new();
        let profile =
            self.profile.map_or_else(|| "none".to_owned(), |profile| titled(profile, self.site.as_ref()));
        let engine = match (self.engine_running, &self.holding, self.reading) {
            _ if self.silent.is_some() => EngineLine::Silent,
            (true, _, Some(reading)) => EngineLine::ComingUp(reading),
            (true, None, None) => EngineLine::Running,
            (true, Some(why), None) => EngineLine::Halted(why),
            (false, ..) => self.in_use_by.as_deref().map_or(EngineLine::NotRunning, EngineLine::NotAnswering),
        };
        lines.push(sentences::engine(engine, &profile));
        lines.extend(
            self.site_file.as_ref().map(|site| sentences::site_file(shown(&site.file), &site.digest.short())),
        );
        lines.extend(self.unverified.as_ref().map(|doubt| sentences::warning(&doubt.text)));
        lines.extend(self.last_record.as_ref().map(last_record_line));
        lines.extend(self.stopped_line.clone());
        lines.extend(self.unauthorized.as_ref().map(|why| sentences::not_authorized(why)));
        lines
    }

    /// One line for each other row.
    pub(super) fn rows(&self) -> Vec<String> {
        let mut lines = Vec::new();
        lines.extend(self.people.iter().map(PersonActRow::line));
        lines.extend(self.families.iter().map(FamilyStatusRow::line));
        lines.extend(self.versions.iter().map(VersionRow::line));
        lines.extend(self.waiting.iter().map(PendingApprovalRow::line));
        lines.extend(self.questions.iter().map(MonitorQuestionRow::line));
        lines.extend(self.emergencies.iter().map(sentences::waits_for_approvers));
        lines.extend(self.alarms.iter().map(AlarmRow::line));
        lines
    }
}

fn last_record(views: &Views) -> Result<Option<AuditRecord>, CliError> {
    let newest = AuditFilter { limit: 1, newest_first: true, ..AuditFilter::default() };
    Ok(views.audit(&newest).map_err(CliError::usage)?.pop())
}

fn last_record_line(record: &AuditRecord) -> String {
    let subject = Untrusted::new(record.subject.as_str()).line();
    let at = holdpoint_wording::record_time(record.at_ms, record.wall());
    sentences::last_record(record.seq, &record.kind, subject, &at)
}

/// A person whose role may start the cell, for the command that does so; `NAME` if there is none.
fn starter(views: &Views) -> Result<String, CliError> {
    let persons = views.persons().map_err(CliError::usage)?;
    let person = persons.enrolled().find(|person| person.role.may_resume());
    Ok(person.map_or_else(|| "NAME".to_owned(), |person| person.name.clone()))
}

impl From<UnverifiedOrigin> for UnverifiedAnswerRow {
    fn from(doubt: UnverifiedOrigin) -> Self {
        Self { code: UnverifiedOrigin::CODE, text: doubt.to_string() }
    }
}

impl FamilyStatusRow {
    pub(super) fn line(&self) -> String {
        let name =
            |id: &Option<CapabilityId>| id.as_ref().map_or_else(|| "none".to_owned(), ToString::to_string);
        let mut line = sentences::family(&self.family, name(&self.active), name(&self.rollback_target));
        if self.provisional || self.provisional_episodes.is_some() {
            line.push_str(&sentences::provisional(self.provisional_episodes));
        }
        if self.promotion_paused {
            line.push_str(sentences::PROMOTION_PAUSED);
        }
        if let Some(why) = &self.safe_stopped {
            line.push_str(&format!(", SAFE-STOPPED: {why}"));
        }
        line
    }
}

/// The status of a version: the engine's if that knows the version as it is now, or else by the store alone. `runs` if an
/// engine runs, also one that does not answer.
fn status_of(
    views: &Views,
    version: &VersionSummary,
    engine: Option<&Snapshot>,
    runs: bool,
) -> Result<VersionStatus, CliError> {
    let given = engine.and_then(|engine| {
        let mut candidates = engine.candidates.iter();
        let view = candidates.find(|candidate| candidate.version == version.version)?;
        let is_current = view.state == version.state && view.flags == version.flags;
        view.status.clone().filter(|_| is_current)
    });
    if let Some(given) = given {
        return Ok(given);
    }
    let recorded = views.recorded_changes(&version.version).map_err(CliError::usage)?;
    let absent = (!runs && version.flags.running.is_some()).then_some(Obstacle::EngineAbsent);
    Ok(VersionStatus::of(&StatusFacts {
        state: version.state,
        flags: &version.flags,
        held: recorded.has_lapsed(),
        reasons: &[],
        obstacle: absent.as_ref(),
        recorded: &recorded,
    }))
}

impl VersionRow {
    fn new(version: &VersionSummary, status: VersionStatus, engine: Option<&Snapshot>) -> Self {
        let view = engine.and_then(|engine| {
            engine.candidates.iter().find(|candidate| candidate.version == version.version)
        });
        let flags = &version.flags;
        let progress = view.and_then(|view| view.progress.as_ref()).filter(|_| flags.running.is_some());
        Self {
            version: version.version.clone(),
            state: version.state,
            running: flags.running,
            paused: flags.paused,
            awaiting_approval: flags.awaiting_approval,
            provisional: flags.provisional,
            restricted: flags.restricted,
            rollback_pending: flags.rollback_pending,
            unreviewed: version.unreviewed,
            held: status.condition == VersionCondition::Held,
            confirmed: view.is_some_and(|view| view.confirmed),
            closed: view.map_or_else(Vec::new, |view| view.closed.clone()),
            stale: view.map_or_else(Vec::new, |view| view.stale.clone()),
            kappas: version.kappas,
            progress: progress.map(|progress| ProgressRow {
                what: progress.what.to_string(),
                done: progress.done,
                budget: progress.budget,
                part: progress.part,
            }),
            counted: view.and_then(|view| view.counted.clone()),
            reason: holdpoint_wording::status_cause(&status),
            status,
        }
    }

    pub(super) fn line(&self) -> String {
        let mut line = format!("version  {}: {}", self.version, self.state);
        if let Some(stage) = self.running {
            let is_interrupted = self.status.obstacle == Some(Obstacle::EngineAbsent);
            line.push_str(&sentences::stage_at_work(stage, is_interrupted));
        }
        let flags = [
            (self.paused, self.state.paused_label()),
            (self.awaiting_approval, sentences::AWAITING_APPROVAL),
            (self.provisional, "provisional"),
            (self.restricted, "restricted"),
            (self.rollback_pending, sentences::ROLLED_BACK_NOW),
            (self.held, "held"),
            (self.unreviewed, sentences::UNREVIEWED),
        ];
        for (_, word) in flags.iter().filter(|(set, _)| *set) {
            line.push_str(", ");
            line.push_str(word);
        }
        if !self.closed.is_empty() {
            let closed: Vec<&str> = self.closed.iter().map(|profile| profile.name()).collect();
            line.push_str(&format!(", blocked under {}", closed.join(", ")));
        }
        if !self.stale.is_empty() {
            let causes: Vec<&str> = self.stale.iter().map(|cause| cause.name()).collect();
            line.push_str(&sentences::stale_evidence(&causes));
        }
        if let Some(ProgressRow { what, done, budget, part }) = &self.progress {
            let part = part.as_ref().map(|part| (part.done, part.budget));
            line.push_str(&sentences::progress(what, (*done, *budget), part));
        }
        if self.kappas.iter().any(Option::is_some) {
            for (name, value) in ["κI", "κP", "κB", "κR"].iter().zip(self.kappas) {
                let shown = value.map_or_else(|| "-".to_owned(), |value| format!("{value:.3}"));
                line.push_str(&format!("  {name} {shown}"));
            }
        }
        // A part of the text may be a person's.
        let status = Untrusted::new(holdpoint_wording::version_status(&self.version, &self.status));
        line.push_str(&format!("  [{}]", status.line()));
        if let Some(counted) = &self.counted {
            line.push_str(&format!("  [{}]", counted_try(&self.version.family, counted)));
        }
        line
    }
}

/// An escalation: the version is rolled back at the deadline without an answer.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct MonitorQuestionRow {
    pub(super) version: CapabilityId,
    pub(super) reason: String,
    pub(super) deadline_ms: u64,
}

impl MonitorQuestionRow {
    fn new(question: &EscalationView) -> Self {
        let reason = question.reasons.first();
        Self {
            version: question.version.clone(),
            reason: reason.map_or_else(String::new, |reason| {
                format!("{}: {}", reason.code, holdpoint_wording::reason(reason))
            }),
            deadline_ms: question.deadline_ms,
        }
    }

    fn line(&self) -> String {
        sentences::drift_question(&self.version, &self.reason, self.deadline_ms / 1000)
    }
}

impl AlarmRow {
    fn line(&self) -> String {
        sentences::alarm(self.priority, &self.alarm, self.state, &self.text, self.shelf.as_ref())
    }
}

/// Alarms that are not normal.
fn alarms(views: &Views) -> Result<Vec<AlarmRow>, CliError> {
    let entries = views.alarms().map_err(CliError::usage)?;
    let open = entries.into_iter().filter(|entry| entry.state != AlarmState::Normal);
    Ok(open
        .map(|entry| {
            let body: serde_json::Value = serde_json::from_str(&entry.json).unwrap_or_default();
            let problem = body.get("text").and_then(|text| NoticeOrText::deserialize(text).ok());
            let problem = problem.unwrap_or_default();
            let (text, notice) = (holdpoint_wording::notice(&problem), problem.notice().cloned());
            let shelf = body.get("shelf").and_then(|shelf| Shelving::deserialize(shelf).ok());
            AlarmRow { alarm: entry.alarm, priority: entry.priority, state: entry.state, text, notice, shelf }
        })
        .collect())
}
