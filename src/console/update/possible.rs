//! Whether a key would do something as things stand: what hints offer and help marks.
//!
//! Asks the same rules that answer the key itself. Must change nothing.

use super::{ZOOM_MAX, brakes, halted, marking, means_something, moving, operating, works_without_engine};
use crate::action::Action;
use crate::model::{Model, View};
use holdpoint_governance::ids::CapabilityId;

/// How things stand, looked at once for many actions.
pub struct Possible<'a> {
    model: &'a Model,
    /// The version under the cursor.
    here: Option<CapabilityId>,
    /// Rows of the list that has the keys: they may be many, and are counted once.
    rows: usize,
}

impl<'a> Possible<'a> {
    #[must_use]
    pub fn of(model: &'a Model) -> Self {
        let (rows, here) = model.rows_and_version();
        Self { model, here, rows }
    }

    /// Why an action would be refused now; absent if it would not. That a console is read-only is said beside it.
    #[must_use]
    pub fn why_not(&self, action: Action) -> Option<String> {
        use crate::action::Action as A;
        let model = self.model;
        if let Some(absence) = model.absence() {
            let bare = model.bare_absence().is_some() && !works_without_engine(action);
            if bare || (action.changes_something() && !brakes(action)) {
                return Some(absence.problem().to_string());
            }
        }
        if !means_something(model.place.view, action) {
            return Some("it means nothing in this view".to_owned());
        }
        let version = || self.here.as_ref().ok_or_else(|| "no version is under the cursor".to_owned());
        let found = match action {
            A::Pause
            | A::Resume
            | A::Refuse
            | A::Demote
            | A::Rollback
            | A::Restrict
            | A::Repeat
            | A::Release
            | A::Continue
            | A::Rearm => version().and_then(|id| operating::intent(model, action, id).map(drop)),
            A::BreakGlass => version().and_then(|id| self.emergency(id)),
            A::Abort => operating::abort(model).map(drop).ok_or_else(|| "nothing is under way".to_owned()),
            A::Go => halted::may_go(model).map(drop),
            A::Acknowledge | A::Shelve | A::Unshelve | A::ResetAlarm => {
                let rows = model.alarm_rows();
                let alarm = rows.get(model.row()).map(|item| item.alarm());
                let alarm = alarm.ok_or_else(|| "no alarm is under the cursor".to_owned());
                alarm.and_then(|alarm| marking::takes(alarm, action))
            }
            A::Sort | A::SortReverse => moving::unsorted(model).map_or(Ok(()), |why| Err(why.to_owned())),
            A::FindNext if model.place.sought.is_empty() => Err("nothing was searched for yet".to_owned()),
            A::Mark if marking::markable(model).is_none() => {
                Err("nothing under the cursor can be marked".to_owned())
            }
            A::OpenRecording if model.place.view != View::Overview => version().map(drop),
            _ => Ok(()),
        };
        found.err()
    }

    fn emergency(&self, id: &CapabilityId) -> Result<(), String> {
        let now = self.model.told.snapshot.as_ref();
        let open = now.is_some_and(|now| now.emergencies.iter().any(|question| question.version == *id));
        if open { Ok(()) } else { Err("it is nothing that the emergency door is for".to_owned()) }
    }

    /// Whether a hint says something by offering it: it would do something here and now.
    #[must_use]
    pub fn is_offered(&self, action: Action) -> bool {
        use crate::action::Action as A;
        let model = self.model;
        // What stops may still be asked of whichever engine is at work: what is on the screen is of one that is gone.
        if model.absence().is_some() && (action.changes_something() || action == A::Verify) {
            return false;
        }
        let useful = match action {
            A::Open => match model.place.view {
                View::Overview => self.here.is_some(),
                View::Alarms => self.here.is_some(),
                View::Registry | View::Approvals | View::Audit => self.rows > 0,
                View::Shadow => self.here.is_some(),
                View::Candidate => model.subject_detail().is_some_and(|detail| !detail.why.is_empty()),
                View::Health => false,
            },
            A::NextPane => model.place.view.panes().len() > 1,
            A::ShowApprovals => !model.waiting_rows().is_empty(),
            A::JumpToAlarm => model.alarm_rows().iter().any(|item| item.alarm().state.calls()),
            A::Copy => moving::copied(model).is_some(),
            A::Filter => self.rows > 1 || !model.place.filter().is_empty(),
            A::Freeze => model.told.snapshot.is_some(),
            A::Mark => self.rows > 1,
            A::Left | A::Right if model.place.view == View::Health => model.told.health.is_some(),
            A::ZoomIn | A::ZoomOut if model.place.view == View::Health => true,
            A::ZoomIn => self.charts() && model.place.zoom < ZOOM_MAX,
            A::ZoomOut => model.place.zoom > 0,
            _ => true,
        };
        useful && self.why_not(action).is_none()
    }

    /// Whether there is a series to zoom into.
    fn charts(&self) -> bool {
        let candidate = self.here.as_ref().and_then(|id| self.model.candidate(id));
        candidate
            .and_then(|candidate| candidate.shadow.as_ref())
            .is_some_and(|shadow| shadow.series.len() > 2)
    }
}
