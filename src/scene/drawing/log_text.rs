//! Text: the upgrade's phase, the log of events and alarms, and the upgrade's document.

use rerun::archetypes::{StateChange, TextDocument, TextLog};
use rerun::components::TextLogLevel;

use super::Drawing;
use crate::labels;
use crate::limits::TEXT_WIDTH_MAX;
use crate::rows::RowTime;
use holdpoint_governance::record::UpgradeEnd;
use holdpoint_protocol::event::{Event, EventKind};
use holdpoint_protocol::film::FilmMark;
use holdpoint_recordings::recording::{FilmSpan, RecordingSubject};
use holdpoint_text::Untrusted;
use holdpoint_wording::event::{sentence, upgrade_phase};
use holdpoint_wording::film::recorded_part;

/// The known data of the upgrade.
#[derive(Debug, Default)]
pub(super) struct UpgradeFacts {
    about: Option<RecordingSubject>,
    decided: Option<Event>,
    phase: Option<String>,
    outcome: Option<UpgradeEnd>,
}

impl Drawing {
    /// Writes the upgrade's document at the beginning.
    pub fn introduce(&mut self, about: &RecordingSubject, at_ms: u64) {
        let time = self.row_time(at_ms, self.sequence);
        self.upgrade.about = Some(about.clone());
        self.write_document(&time);
    }

    pub(super) fn log_event(&mut self, event: &Event, time: &RowTime) {
        self.log(event, time);
        let ours = event.kind.version().is_some_and(|version| self.version.as_ref() == Some(version));
        if !ours {
            return;
        }
        if let Some(phase) = upgrade_phase(&event.kind)
            && self.upgrade.phase.as_deref() != Some(phase.as_str())
        {
            self.rows.at("phase", time, &StateChange::single(phase.as_str()));
            self.upgrade.phase = Some(phase);
        }
        match &event.kind {
            EventKind::Decided { .. } | EventKind::Monitor { .. } | EventKind::RolledBack { .. } => {
                self.upgrade.decided = Some(event.clone());
            }
            EventKind::AuditClosed { outcome, .. } => self.upgrade.outcome = Some(*outcome),
            EventKind::Activated { .. } | EventKind::Confirmed { .. } => {}
            _ => return,
        }
        self.write_document(time);
    }

    fn log(&mut self, event: &Event, time: &RowTime) {
        let (path, level) = match &event.kind {
            // A line for each episode would bury the rest.
            EventKind::Progress { .. } => return,
            EventKind::Alarm { priority, state, .. } => {
                ("log/alarms", labels::alarm_level(*priority, *state))
            }
            kind => ("log/audit", labels::level(kind)),
        };
        let text = sentence(event, TEXT_WIDTH_MAX).into_string();
        self.rows.at(path, time, &TextLog::new(text).with_level(TextLogLevel::from(level)));
    }

    /// An event of one version in a part of an evaluation.
    pub(super) fn log_film(&mut self, span: &FilmSpan, time: &RowTime) {
        let text =
            Untrusted::new(recorded_part(&span.title, &span.why)).display(TEXT_WIDTH_MAX).into_string();
        self.rows.at("log/film", time, &TextLog::new(text).with_level(TextLogLevel::INFO));
    }

    pub(super) fn log_mark(&mut self, who: &str, mark: &FilmMark, time: &RowTime) {
        let level = if mark.bad { TextLogLevel::WARN } else { TextLogLevel::INFO };
        let text = Untrusted::new(format!("{who}: {}", mark.text)).display(TEXT_WIDTH_MAX).into_string();
        self.rows.at("log/film", time, &TextLog::new(text).with_level(TextLogLevel::from(level)));
    }

    fn write_document(&mut self, time: &RowTime) {
        let Some(about) = &self.upgrade.about else { return };
        let text = labels::document(
            about,
            self.upgrade.phase.as_deref(),
            self.upgrade.decided.as_ref(),
            self.upgrade.outcome,
        );
        self.rows.at("upgrade", time, &TextDocument::from_markdown(text));
    }
}
