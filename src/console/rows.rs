//! The rows of each list: the reducer moves over them and the views draw them.

use std::fmt::Write as _;

use super::audit::{self, AuditGroup, AuditItem};
use super::formatters::state_label;
use super::model::{ConsoleModel, EventLogLine, ItemKey, View};
use super::state_filter::StateFilterFacts;
use holdpoint_governance::alarms::{AlarmState, Priority};
use holdpoint_governance::behavior::component_of;
use holdpoint_governance::condition::Condition;
use holdpoint_governance::decision::{Reason, ReasonCode};
use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_governance::lifecycle::{State, VersionFlags};
use holdpoint_governance::record::{AuditRecord, VersionSummary};
use holdpoint_governance::version_status::VersionCondition;
use holdpoint_protocol::detail::{Detail, DrillView, FieldDiff, MeasuredValue};
use holdpoint_protocol::event::DimensionResult;
use holdpoint_protocol::explanation::DecisionExplanation;
use holdpoint_protocol::snapshot::{AlarmView, CandidateView, Disagreement, is_at_work, waits_its_turn};
use holdpoint_wording::console::record::record_sentence;

/// A row of the registry's tree.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RegistryItem<'a> {
    Family {
        family: &'a Family,
        /// How many of its versions are on the page.
        versions: usize,
        /// Whether its branch is open.
        open: bool,
    },
    Version(&'a VersionSummary),
}

/// A row of the alarm list.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AlarmItem<'a> {
    Alarm(&'a AlarmView),
    /// Alarms of one subject in a flood, behind the first of them.
    Group {
        first: &'a AlarmView,
        /// How many alarms it represents.
        count: usize,
    },
}

impl<'a> AlarmItem<'a> {
    /// The alarm on the row.
    #[must_use]
    pub const fn alarm(self) -> &'a AlarmView {
        match self {
            Self::Alarm(alarm) | Self::Group { first: alarm, .. } => alarm,
        }
    }
}

/// A row of the candidate view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CandidateItem<'a> {
    Dimension(&'a DimensionResult),
    /// A component of the behavior comparison: its worsening against the margin.
    Worsening(&'a MeasuredValue),
    /// A measured value with its own interval.
    Measure(&'a MeasuredValue),
    Reason(&'a Reason),
    /// A component that is better on average, with an interval that includes zero.
    Unproven(&'a Reason, &'a MeasuredValue),
    /// A condition of use.
    Condition(&'a Condition),
    /// An untested property.
    Untested(&'a str),
    /// A field that differs.
    Difference(&'a FieldDiff),
    /// A heading: a sandbox mode.
    Mode(&'a str),
    /// A kind of drill.
    Drill(&'a DrillView),
    Decision(&'a DecisionExplanation),
    /// A record of the log.
    Record(&'a AuditRecord),
}

/// What a candidate of the overview calls for, in the order of the list.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum CandidateRank {
    /// It is in control and not confirmed: a monitor watches it.
    Watched,
    /// A stage of it runs.
    AtWork,
    /// It continues when a person acts.
    WithPeople,
    /// Its stage has not come, or waits for the end of another one.
    Queued,
    /// Nothing more happens to it by itself.
    Settled,
}

impl CandidateRank {
    #[must_use]
    pub const fn of(candidate: &CandidateView) -> Self {
        match VersionCondition::of(candidate.state, &candidate.flags, candidate.held) {
            VersionCondition::Provisional
            | VersionCondition::PromotionPaused
            | VersionCondition::Restricted
            | VersionCondition::Leaving => Self::Watched,
            // What left the pipeline may keep an older count.
            VersionCondition::Superseded | VersionCondition::Rejected | VersionCondition::RolledBack => {
                Self::Settled
            }
            _ if is_at_work(candidate) => Self::AtWork,
            VersionCondition::Running if waits_its_turn(candidate) => Self::Queued,
            VersionCondition::Running => Self::AtWork,
            VersionCondition::Paused
            | VersionCondition::AwaitingApproval
            | VersionCondition::Held
            | VersionCondition::Demoted => Self::WithPeople,
            VersionCondition::Queued => Self::Queued,
            VersionCondition::Confirmed => Self::Settled,
        }
    }

    /// Whether it is on the screen wherever the cursor is.
    #[must_use]
    pub const fn is_pinned(self) -> bool {
        matches!(self, Self::Watched | Self::AtWork)
    }
}

impl ConsoleModel {
    /// The registry's tree under its filter and pane.
    #[must_use]
    pub fn registry_rows(&self) -> Vec<RegistryItem<'_>> {
        let mut sieve =
            RowFilter::new(if self.view_state.view == View::Registry { self.filter() } else { "" });
        let facts = StateFilterFacts::of(self);
        let listing = &self.engine_data.registry;
        let all = &listing.page.rows;
        let as_it_comes = if listing.places.is_empty() { 0..all.len() } else { 0..0 };
        let places = listing.places.iter().copied().chain(as_it_comes);
        let rows: Vec<(usize, &VersionSummary)> = places
            .filter_map(|place| Some((*listing.families.get(place)?, all.get(place)?)))
            .filter(|(_, row)| self.is_listed(&facts, &row.version, row.state, &row.flags, &row.author))
            // Words are made only for a filter: each frame asks for every row.
            .filter(|(_, row)| {
                sieve.takes_all()
                    || sieve.fits(&[&row.version, &row.author, &state_text(row.state, &row.flags)])
            })
            .collect();
        if listing.is_flat() {
            return rows.into_iter().map(|(_, row)| RegistryItem::Version(row)).collect();
        }
        let mut items = Vec::with_capacity(rows.len() + 8);
        for versions in rows.chunk_by(|(a, _), (b, _)| a == b) {
            let Some((_, first)) = versions.first() else { continue };
            let family = &first.version.family;
            let open = !self.engine_data.registry.closed.contains(family);
            items.push(RegistryItem::Family { family, versions: versions.len(), open });
            if open {
                items.extend(versions.iter().map(|(_, row)| RegistryItem::Version(row)));
            }
        }
        items
    }

    /// The alarms, in the order of attention. In a flood, related alarms share one row, except critical ones; the others of an
    /// open group stand below it. A filter does not apply to them.
    #[must_use]
    pub fn alarm_rows(&self) -> Vec<AlarmItem<'_>> {
        let Some(snapshot) = &self.engine_data.snapshot else { return Vec::new() };
        if !snapshot.alarm_summary.flood {
            return snapshot.alarms.iter().map(AlarmItem::Alarm).collect();
        }
        let mut items: Vec<AlarmItem<'_>> = Vec::new();
        let mut grouped: std::collections::BTreeMap<(&str, Priority, AlarmState), Vec<&AlarmView>> =
            std::collections::BTreeMap::new();
        let groupable = |alarm: &AlarmView| match alarm.priority {
            Priority::Critical => false,
            Priority::High | Priority::Low => true,
        };
        for alarm in snapshot.alarms.iter().filter(|alarm| groupable(alarm)) {
            grouped.entry((&alarm.subject, alarm.priority, alarm.state)).or_default().push(alarm);
        }
        let mut listed_groups = std::collections::BTreeSet::new();
        for alarm in &snapshot.alarms {
            let id = (alarm.subject.as_str(), alarm.priority, alarm.state);
            match grouped.get(&id).filter(|members| groupable(alarm) && members.len() > 1) {
                None => items.push(AlarmItem::Alarm(alarm)),
                Some(members) => {
                    // The first alarm set off the others.
                    let first = members.iter().min_by_key(|member| member.since_ms);
                    if let Some(first) = first.filter(|_| listed_groups.insert(id)) {
                        items.push(AlarmItem::Group { first, count: members.len() });
                        if self.view_state.opened_groups.contains(&alarm.subject) {
                            let rest = members.iter().filter(|member| member.alarm != first.alarm);
                            items.extend(rest.map(|member| AlarmItem::Alarm(member)));
                        }
                    }
                }
            }
        }
        items
    }

    /// Candidates in the pipeline by [`CandidateRank`]; of equal ones the newest of the last family first, but the queue in
    /// the order in which its stages begin.
    #[must_use]
    pub fn pipeline_rows(&self) -> Vec<&CandidateView> {
        let Some(snapshot) = &self.engine_data.snapshot else { return Vec::new() };
        let mut sieve =
            RowFilter::new(if self.view_state.view == View::Overview { self.filter() } else { "" });
        let facts = StateFilterFacts::of(self);
        let mut rows: Vec<(CandidateRank, usize, &CandidateView)> = snapshot
            .candidates
            .iter()
            .enumerate()
            .filter(|(_, row)| self.is_listed(&facts, &row.version, row.state, &row.flags, &row.author))
            .filter(|(_, row)| sieve.fits(&[&row.version, &row.author, &state_text(row.state, &row.flags)]))
            .map(|(place, row)| match CandidateRank::of(row) {
                CandidateRank::Queued => (CandidateRank::Queued, place, row),
                rank => (rank, usize::MAX - place, row),
            })
            .collect();
        rows.sort_by_key(|(rank, place, _)| (*rank, *place));
        rows.into_iter().map(|(_, _, row)| row).collect()
    }

    /// The log under its filter and pane, newest first.
    #[must_use]
    pub fn audit_rows(&self) -> Vec<AuditItem<'_>> {
        let mut sieve = RowFilter::new(if self.view_state.view == View::Audit { self.filter() } else { "" });
        let group = AuditGroup::of_pane(self.view_state.pane_of(View::Audit));
        let shown = self.engine_data.audit.rows.iter().filter(|row| group.shows(row.kind.known()));
        // The content behind a sentence is not on the screen.
        audit::rows(shown.filter(|row| {
            let sentence = std::fmt::from_fn(|f| f.write_str(&record_sentence(row)));
            sieve.fits(&[&row.kind, &row.subject, &sentence])
        }))
    }

    /// The record on display in raw form, if it was in the last page.
    #[must_use]
    pub fn opened_record(&self) -> Option<&AuditRecord> {
        let opened = self.view_state.opened.as_ref().filter(|_| self.view_state.view == View::Audit)?;
        self.engine_data.audit.rows.iter().find(|row| row.seq == opened.seq)
    }

    /// Lines of the event log under its filter, newest first.
    #[must_use]
    pub fn event_log_rows(&self) -> Vec<&EventLogLine> {
        let mut sieve = RowFilter::new(self.event_log_filter());
        self.event_log().iter().rev().filter(|line| sieve.fits(&[&line.text])).collect()
    }

    /// Everything about the subject, if the engine has answered about it.
    #[must_use]
    pub fn subject_detail(&self) -> Option<&Detail> {
        let subject = self.subject()?;
        self.engine_data.detail.as_deref().filter(|detail| detail.version == subject)
    }

    /// The rows of a pane of the candidate view.
    #[must_use]
    pub fn candidate_rows(&self, pane: usize) -> Vec<CandidateItem<'_>> {
        let Some(detail) = self.subject_detail() else { return Vec::new() };
        match pane {
            0 => {
                let reasons = detail.reasons.iter().map(|reason| match unproven(detail, reason) {
                    Some(measure) => CandidateItem::Unproven(reason, measure),
                    None => CandidateItem::Reason(reason),
                });
                let rest = detail.behavior.iter().map(CandidateItem::Worsening);
                let conditions = detail.conditions.iter().map(CandidateItem::Condition);
                let untested = detail.untested.iter().map(|text| CandidateItem::Untested(text));
                let dimensions = detail.dimensions.iter().map(CandidateItem::Dimension);
                dimensions.chain(reasons).chain(rest).chain(conditions).chain(untested).collect()
            }
            1 => detail.differences.iter().map(CandidateItem::Difference).collect(),
            2 => detail
                .modes
                .iter()
                .flat_map(|mode| {
                    let heading = std::iter::once(CandidateItem::Mode(mode.mode.name()));
                    heading.chain(mode.measures.iter().map(CandidateItem::Measure))
                })
                .collect(),
            3 => detail.drills.iter().map(CandidateItem::Drill).collect(),
            4 => detail.decisions.iter().map(CandidateItem::Decision).collect(),
            _ => detail.audit.iter().map(CandidateItem::Record).collect(),
        }
    }

    /// Disagreements of twin and live world, newest first.
    #[must_use]
    pub fn disagreement_rows(&self) -> Vec<&Disagreement> {
        let subject = self.subject();
        let candidates = self.charted().map_or(&[][..], |snapshot| &snapshot.candidates);
        let ours = candidates.iter().find(|candidate| Some(&candidate.version) == subject.as_ref());
        ours.and_then(|candidate| candidate.shadow.as_ref())
            .map(|shadow| shadow.disagreements.iter().collect())
            .unwrap_or_default()
    }

    /// How many rows the present view and pane has.
    #[must_use]
    pub fn row_count(&self) -> usize {
        self.view_state.view.behavior().row_count(self)
    }

    /// The subject of a row of the present view and pane.
    #[must_use]
    pub fn item_key(&self, row: usize) -> Option<ItemKey> {
        self.view_state.view.behavior().item_key(self, row)
    }

    /// The current place of an item in the present view and pane; absent if it is gone.
    #[must_use]
    pub fn row_of(&self, key: &ItemKey) -> Option<usize> {
        self.view_state.view.behavior().row_of(self, key)
    }

    /// The row under the cursor, within the list.
    #[must_use]
    pub fn row(&self) -> usize {
        self.view_state.cursor().min(self.row_count().saturating_sub(1))
    }

    /// The length of the list with the keys, and the version under its cursor; the rows are made only once.
    #[must_use]
    pub fn rows_and_version(&self) -> (usize, Option<CapabilityId>) {
        self.view_state.view.behavior().rows_and_version(self)
    }

    /// The version under the cursor, or the one of the view.
    #[must_use]
    pub fn version_here(&self) -> Option<CapabilityId> {
        self.view_state.view.behavior().version_here(self)
    }
}

/// The identifying text of a row of the candidate view, without headings and values.
#[must_use]
pub fn row_key_text(item: &CandidateItem<'_>) -> String {
    match item {
        CandidateItem::Dimension(result) => result.dimension.name().to_owned(),
        CandidateItem::Worsening(measure) | CandidateItem::Measure(measure) => measure.name.clone(),
        CandidateItem::Reason(reason) | CandidateItem::Unproven(reason, _) => {
            format!("{}: {}", reason.code, holdpoint_wording::reason(reason))
        }
        CandidateItem::Condition(condition) => holdpoint_wording::condition_of_use(condition),
        CandidateItem::Untested(what) => (*what).to_owned(),
        CandidateItem::Difference(difference) => difference.field.clone(),
        CandidateItem::Mode(mode) => (*mode).to_owned(),
        CandidateItem::Drill(drill) => drill.kind.name().to_owned(),
        CandidateItem::Decision(decision) => format!("{} {}", decision.record, decision.ruling.outcome()),
        CandidateItem::Record(record) => format!("{} {} {}", record.seq, record.kind, record.body),
    }
}

/// The whole text of a row of the candidate view, for a search.
#[must_use]
pub fn search_text(item: &CandidateItem<'_>) -> String {
    match item {
        CandidateItem::Decision(decision) => {
            let reasons = decision.reasons.iter().map(|reason| {
                let code = reason.code.as_ref().map(ToString::to_string).unwrap_or_default();
                format!("{code} {} {}", reason.text, reason.measured.as_deref().unwrap_or_default())
            });
            let rest = decision.change.iter().chain(&decision.then).cloned();
            let all: Vec<String> = reasons.chain(rest).collect();
            format!("{} {}", row_key_text(item), all.join(" "))
        }
        CandidateItem::Difference(difference) => {
            let value = |value: &Option<serde_json::Value>| {
                value.as_ref().map(ToString::to_string).unwrap_or_default()
            };
            format!("{} {} {}", row_key_text(item), value(&difference.old), value(&difference.new))
        }
        CandidateItem::Dimension(result) => format!("{} {}", row_key_text(item), result.outcome.name()),
        _ => row_key_text(item),
    }
}

/// The component that a reason calls better, if its interval includes zero.
fn unproven<'a>(detail: &'a Detail, reason: &Reason) -> Option<&'a MeasuredValue> {
    if reason.code != ReasonCode::BehaviorImproved {
        return None;
    }
    let name = component_of(reason)?.name();
    let measure = detail.behavior.iter().find(|measure| measure.name == name)?;
    measure.interval.filter(|[_, high]| *high >= 0.0).map(|_| measure)
}

/// The rows by their text; a measured value by its mode as well.
#[must_use]
pub fn row_keys(rows: &[CandidateItem<'_>]) -> Vec<ItemKey> {
    let mut mode = "";
    let mut keys = Vec::with_capacity(rows.len());
    for item in rows {
        if let CandidateItem::Mode(name) = *item {
            mode = name;
        }
        keys.push(ItemKey::Text(format!("{mode} {}", row_key_text(item))));
    }
    keys
}

/// The state of a version, in words that are made only where a filter asks for them.
fn state_text(state: State, flags: &VersionFlags) -> impl std::fmt::Display {
    let flags = *flags;
    std::fmt::from_fn(move |f| f.write_str(&state_label(state, &flags)))
}

/// A filter: the text that a row must contain, in either case. An empty one matches everything.
struct RowFilter {
    wanted: String,
    /// Rewritten for each text: lists are long and are drawn often.
    buffer: String,
}

impl RowFilter {
    fn new(filter: &str) -> Self {
        Self { wanted: filter.to_lowercase(), buffer: String::new() }
    }

    /// Whether the filter is empty.
    const fn takes_all(&self) -> bool {
        self.wanted.is_empty()
    }

    /// Whether one of the texts contains the filter's text.
    fn fits(&mut self, texts: &[&dyn std::fmt::Display]) -> bool {
        self.wanted.is_empty()
            || texts.iter().any(|text| {
                self.buffer.clear();
                // Writing into a string cannot fail.
                let _ = write!(self.buffer, "{text}");
                if self.buffer.is_ascii() {
                    self.buffer.make_ascii_lowercase();
                    self.buffer.contains(&self.wanted)
                } else {
                    self.buffer.to_lowercase().contains(&self.wanted)
                }
            })
    }
}
