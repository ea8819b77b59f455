//! What `holdpoint status` shows: read from the store, completed by what a running engine adds.
//!
//! The store is the authority on states; only progress, holding and the provisional window come from the engine.
//! One formatter for all forms of the verb.

use std::collections::BTreeMap;

use serde::Serialize;

use super::StatusSubject;
use super::waiting::WaitingRow;
use crate::cli::profile_on_record;
use crate::cli::prune::wall_ms;
use crate::error::CliError;
use holdpoint_engine::context::ContextRecord;
use holdpoint_engine::door::{DoorError, Doubt};
use holdpoint_engine::halt;
use holdpoint_governance::alarms::{AlarmState, Priority};
use holdpoint_governance::decision::telling;
use holdpoint_governance::evidence::StaleCause;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{Flags, Stage, State};
use holdpoint_governance::profile::{ProfileName, SiteName, titled};
use holdpoint_governance::record::{AuditRecord, VersionSummary};
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::snapshot::{Purpose, QuestionView, ReadingView, Snapshot, StoppedView};
use holdpoint_protocol::words::clock_time;
use holdpoint_registry::{AuditFilter, Layout, VersionFilter, Views, lock_owner};
use holdpoint_text::Untrusted;

#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct StatusReport {
    /// Whether an engine runs on the store and answers.
    pub(super) engine_running: bool,
    /// Who has the store although no engine answers at its socket.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) in_use_by: Option<String>,
    /// Why the engine that is there said nothing, if so: what is shown is what the store holds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) silent: Option<String>,
    /// Why what was answered is not known to come from the engine.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) unverified: Option<DoubtRow>,
    /// The last record, where the engine said nothing.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) last_record: Option<AuditRecord>,
    /// How far the engine has read its record, while it comes up: nothing shown is verified.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) reading: Option<ReadingView>,
    /// Why it holds, if it does.
    pub(super) holding: Option<String>,
    /// Who stopped the cell, while it is stopped.
    pub(super) stopped: Option<StoppedView>,
    /// Why nothing becomes active and the arm stands until an administrator authorizes the profile, if so.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) unauthorized: Option<String>,
    /// The profile the store was last used with.
    pub(super) profile: Option<ProfileName>,
    /// Its own name, if it does not come with the program.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) site: Option<SiteName>,
    pub(super) families: Vec<FamilyStatusRow>,
    pub(super) versions: Vec<VersionRow>,
    pub(super) waiting: Vec<WaitingRow>,
    /// Monitors' questions, if an engine runs.
    pub(super) questions: Vec<QuestionRow>,
    /// Versions that one person may let in by the emergency door, if an engine runs.
    pub(super) emergencies: Vec<CapabilityId>,
    pub(super) alarms: Vec<AlarmRow>,
}

/// That an answer is not known to come from the engine.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct DoubtRow {
    code: &'static str,
    text: String,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct FamilyStatusRow {
    pub(super) family: String,
    pub(super) active: Option<CapabilityId>,
    pub(super) rollback_target: Option<CapabilityId>,
    /// Why no version is active, if none may be.
    pub(super) safe_stopped: Option<String>,
    /// Episodes worked and needed, while the active version is provisional and an engine runs.
    pub(super) provisional_episodes: Option<(u32, u32)>,
    /// Whether the active version is provisional: it works, and is not confirmed.
    pub(super) provisional: bool,
    /// Whether somebody holds the promotion of the active version, which works on.
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
    /// Let in by the emergency door, and not reviewed yet.
    pub(super) unreviewed: bool,
    /// Waits for somebody to resume it, if an engine runs.
    pub(super) held: bool,
    /// Profiles closed to it, if an engine runs.
    pub(super) closed: Vec<ProfileName>,
    /// Why what was measured of it does not count any more, if an engine runs.
    pub(super) stale: Vec<StaleCause>,
    /// `kappa_I`, `kappa_P`, `kappa_B`, `kappa_R`; absent if not measured.
    pub(super) kappas: [Option<f64>; 4],
    /// What the running stage does: so many done of so many.
    pub(super) progress: Option<ProgressRow>,
    /// The first reason of the last decision, if an engine runs.
    pub(super) reason: Option<String>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct ProgressRow {
    pub(super) what: String,
    pub(super) done: u64,
    pub(super) budget: u64,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct AlarmRow {
    pub(super) alarm: String,
    pub(super) priority: Priority,
    pub(super) state: AlarmState,
    pub(super) text: String,
}

impl StatusReport {
    /// What concerns the subject, or everything.
    pub(super) fn new(
        views: &Views,
        engine: Option<&Snapshot>,
        silent: Option<&DoorError>,
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
            found.map_or_else(Flags::default, |version| version.flags)
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
                safe_stopped: status.safe_stopped.then_some(status.reason),
                family: status.name,
            })
            .collect();
        // A running engine knows what it asks now; without one the store tells what was asked last.
        let waiting = match engine {
            Some(engine) => {
                engine.prompts.iter().map(|prompt| WaitingRow::asked(prompt, engine.time)).collect()
            }
            None => {
                // An engine that was interrupted may have left an earlier question of the same version.
                let requests = views.open_requests().map_err(CliError::usage)?;
                let asked = |id: &CapabilityId| {
                    versions.iter().any(|version| version.version == *id && version.flags.awaiting_approval)
                };
                let newest: BTreeMap<_, _> = requests
                    .into_iter()
                    .filter(|request| asked(&request.version))
                    .map(|request| (request.version.clone(), request))
                    .collect();
                let persons = views.persons().map_err(CliError::usage)?;
                let rows = newest.into_values().map(|request| {
                    let answers = views.approvals(&request.version).map_err(CliError::usage)?;
                    let is_active = versions
                        .iter()
                        .any(|version| version.version == request.version && version.state == State::Active);
                    let purpose = if is_active { Purpose::Release } else { Purpose::Activation };
                    Ok(WaitingRow::stored(request, purpose, &answers, &persons, WallTime::from_ms(wall_ms())))
                });
                rows.collect::<Result<Vec<_>, CliError>>()?
            }
        };
        let context = views.context().map_err(CliError::usage)?;
        let record = |json: &str| serde_json::from_str::<ContextRecord>(json).ok();
        Ok(Self {
            engine_running: engine.is_some(),
            in_use_by: match engine {
                Some(_) => None,
                None => views.folder().and_then(|folder| lock_owner(&Layout::new(folder)).ok()?),
            },
            silent: silent.map(ToString::to_string),
            unverified: None,
            last_record: silent.map(|_| last_record(views)).transpose()?.flatten(),
            reading: engine.and_then(|engine| engine.reading),
            holding: engine.and_then(|engine| engine.holding.clone()),
            // Without an engine the store tells; a stop outlives the engine.
            stopped: match engine {
                Some(engine) => engine.stopped.clone(),
                None => halt::recall(views).map_err(CliError::usage)?,
            },
            unauthorized: match engine {
                Some(engine) => engine.unauthorized.clone(),
                None => profile_on_record::missing(views),
            },
            site: context.as_ref().and_then(|(_, _, json)| record(json)?.site),
            profile: context.map(|(profile, _, _)| profile),
            families,
            versions: rows.map(|version| VersionRow::new(version, engine)).collect(),
            waiting: waiting.into_iter().filter(|row| wanted(&row.version)).collect(),
            questions: engine
                .iter()
                .flat_map(|engine| &engine.questions)
                .filter(|question| wanted(&question.version))
                .map(QuestionRow::new)
                .collect(),
            emergencies: engine
                .iter()
                .flat_map(|engine| &engine.emergencies)
                .filter(|door| wanted(&door.version))
                .map(|door| door.version.clone())
                .collect(),
            alarms: alarms(views)?,
        })
    }

    /// One line a row, for people. A line says all of its row, so that lines can be compared.
    pub(super) fn lines(&self) -> Vec<String> {
        let mut lines = Vec::new();
        let profile =
            self.profile.map_or_else(|| "none".to_owned(), |profile| titled(profile, self.site.as_ref()));
        lines.push(match (self.engine_running, &self.holding) {
            _ if self.silent.is_some() => {
                format!("engine   SILENT, last profile {profile}: what follows is what the store holds")
            }
            (true, _) if self.reading.is_some() => {
                let reading = self.reading.map_or_else(String::new, |reading| reading.to_string());
                format!(
                    "engine   coming up, profile {profile}; {reading}: nothing is carried out yet but `stop`"
                )
            }
            (true, None) => format!("engine   running, profile {profile}"),
            (true, Some(why)) => format!("engine   HOLDING, profile {profile}: {why}"),
            (false, _) => match &self.in_use_by {
                Some(owner) => format!(
                    "engine   NOT ANSWERING: {owner} has the store and is at no socket; last profile {profile}"
                ),
                None => format!("engine   not running, last profile {profile}"),
            },
        });
        lines.extend(self.unverified.as_ref().map(|doubt| format!("DOUBT    {}", doubt.text)));
        lines.extend(self.last_record.as_ref().map(last_record_line));
        lines.extend(self.stopped.as_ref().map(stopped_line));
        lines.extend(self.unauthorized.as_ref().map(|why| format!("profile  NOT AUTHORIZED: {why}")));
        lines.extend(self.families.iter().map(FamilyStatusRow::line));
        lines.extend(self.versions.iter().map(VersionRow::line));
        lines.extend(self.waiting.iter().map(WaitingRow::line));
        lines.extend(self.questions.iter().map(QuestionRow::line));
        lines.extend(self.emergencies.iter().map(|version| {
            format!("door     {version} is held back by people or the calendar; `holdpoint break-glass` lets it in")
        }));
        lines.extend(self.alarms.iter().map(AlarmRow::line));
        lines
    }
}

fn last_record(views: &Views) -> Result<Option<AuditRecord>, CliError> {
    let newest = AuditFilter { limit: 1, newest_first: true, ..AuditFilter::default() };
    Ok(views.audit(&newest).map_err(CliError::usage)?.pop())
}

fn last_record_line(record: &AuditRecord) -> String {
    let subject = Untrusted::new(record.subject.as_str());
    format!(
        "record   the last is number {}, {} {}, at {}",
        record.seq,
        record.kind,
        subject.line(),
        clock_time(record.at_ms)
    )
}

/// Everybody who stopped the cell, and what ends it.
pub(in crate::cli) fn stopped_line(stopped: &StoppedView) -> String {
    let by = if stopped.by.is_empty() { "somebody" } else { &stopped.by };
    let since = clock_time(stopped.since_ms);
    let mut line = format!("STOPPED  by {by}, {}, since {since}", stopped.caller);
    if !stopped.reason.is_empty() {
        line.push_str(&format!(": {}", stopped.reason));
    }
    if stopped.unnamed > 0 {
        line.push_str(&format!(", and {} more times", stopped.unnamed));
    }
    for stop in &stopped.again {
        let by = if stop.by.is_empty() { "somebody" } else { &stop.by };
        line.push_str(&format!(", and by {by}, {}, {}", stop.caller, clock_time(stop.at_ms)));
        if !stop.reason.is_empty() {
            line.push_str(&format!(": {}", stop.reason));
        }
    }
    line.push_str(&format!("; `holdpoint go --stops {}` says that all of it is known", stopped.stops));
    line
}

impl From<Doubt> for DoubtRow {
    fn from(doubt: Doubt) -> Self {
        Self { code: Doubt::CODE, text: doubt.to_string() }
    }
}

impl FamilyStatusRow {
    pub(super) fn line(&self) -> String {
        let name =
            |id: &Option<CapabilityId>| id.as_ref().map_or_else(|| "none".to_owned(), ToString::to_string);
        let mut line = format!(
            "family   {}: active {}, rollback target {}",
            self.family,
            name(&self.active),
            name(&self.rollback_target)
        );
        match self.provisional_episodes {
            Some((worked, needed)) => {
                line.push_str(&format!(", provisional {worked} of {needed} episodes"));
            }
            None if self.provisional => line.push_str(", provisional"),
            None => {}
        }
        if self.promotion_paused {
            line.push_str(", its promotion paused");
        }
        if let Some(why) = &self.safe_stopped {
            line.push_str(&format!(", SAFE-STOPPED: {why}"));
        }
        line
    }
}

impl VersionRow {
    fn new(version: &VersionSummary, engine: Option<&Snapshot>) -> Self {
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
            held: view.is_some_and(|view| view.held),
            closed: view.map_or_else(Vec::new, |view| view.closed.clone()),
            stale: view.map_or_else(Vec::new, |view| view.stale.clone()),
            kappas: version.kappas,
            progress: progress.map(|progress| ProgressRow {
                what: progress.what.clone(),
                done: progress.done,
                budget: progress.budget,
            }),
            reason: view.and_then(|view| telling(&view.reasons)).map(ToString::to_string),
        }
    }

    pub(super) fn line(&self) -> String {
        let mut line = format!("version  {}: {}", self.version, self.state);
        if let Some(stage) = self.running {
            line.push_str(&format!(", running {stage}"));
        }
        let flags = [
            (self.paused, self.state.paused_word()),
            (self.awaiting_approval, "awaiting approval"),
            (self.provisional, "provisional"),
            (self.restricted, "restricted"),
            (self.rollback_pending, "being rolled back"),
            (self.held, "held"),
            (self.unreviewed, "UNREVIEWED emergency activation"),
        ];
        for (_, word) in flags.iter().filter(|(set, _)| *set) {
            line.push_str(", ");
            line.push_str(word);
        }
        if !self.closed.is_empty() {
            let closed: Vec<&str> = self.closed.iter().map(|profile| profile.name()).collect();
            line.push_str(&format!(", closed under {}", closed.join(", ")));
        }
        if !self.stale.is_empty() {
            let causes: Vec<&str> = self.stale.iter().map(|cause| cause.name()).collect();
            line.push_str(&format!(", STALE evidence (another {})", causes.join(", ")));
        }
        if let Some(ProgressRow { what, done, budget }) = &self.progress {
            line.push_str(&format!(", {what} {done} of {budget}"));
        }
        if self.kappas.iter().any(Option::is_some) {
            for (name, value) in ["κI", "κP", "κB", "κR"].iter().zip(self.kappas) {
                let shown = value.map_or_else(|| "-".to_owned(), |value| format!("{value:.3}"));
                line.push_str(&format!("  {name} {shown}"));
            }
        }
        if let Some(reason) = &self.reason {
            line.push_str(&format!("  ({reason})"));
        }
        line
    }
}

/// A monitor's question: the version is rolled back at the deadline unless somebody answers.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct QuestionRow {
    pub(super) version: CapabilityId,
    pub(super) reason: String,
    pub(super) deadline_ms: u64,
}

impl QuestionRow {
    fn new(question: &QuestionView) -> Self {
        let reason = question.reasons.first();
        Self {
            version: question.version.clone(),
            reason: reason.map_or_else(String::new, |reason| format!("{}: {}", reason.code, reason.text)),
            deadline_ms: question.deadline_ms,
        }
    }

    fn line(&self) -> String {
        let by = self.deadline_ms / 1000;
        format!(
            "question {}: its monitor asks people ({}); unanswered by {by} s it is rolled back",
            self.version, self.reason
        )
    }
}

impl AlarmRow {
    fn line(&self) -> String {
        format!("alarm    {} {}, {}: {}", self.priority, self.alarm, self.state, self.text)
    }
}

/// Alarms that are not normal.
fn alarms(views: &Views) -> Result<Vec<AlarmRow>, CliError> {
    let entries = views.alarms().map_err(CliError::usage)?;
    let open = entries.into_iter().filter(|entry| entry.state != AlarmState::Normal);
    Ok(open
        .map(|entry| {
            let body: serde_json::Value = serde_json::from_str(&entry.json).unwrap_or_default();
            let text = body.get("text").and_then(serde_json::Value::as_str).unwrap_or_default().to_owned();
            AlarmRow { alarm: entry.alarm, priority: entry.priority, state: entry.state, text }
        })
        .collect())
}
