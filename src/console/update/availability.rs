//! Whether a key would have an effect now, for hints and help.
//!
//! Applies the same rules as the key itself. Must change nothing.

use super::{
    ZOOM_MAX, brakes, cell_restart, means_something, navigation, operations, selection, works_without_engine,
};
use crate::action::Action;
use crate::model::{ConsoleModel, View};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_wording::console::availability as wording;
use holdpoint_wording::console::undo;

/// The current state, read once for many actions.
pub struct ActionAvailability<'a> {
    model: &'a ConsoleModel,
    /// The version under the cursor.
    here: Option<CapabilityId>,
    /// Rows of the list with the keys: they may be many, and are counted once.
    rows: usize,
}

impl<'a> ActionAvailability<'a> {
    #[must_use]
    pub fn of(model: &'a ConsoleModel) -> Self {
        let (rows, here) = model.rows_and_version();
        Self { model, here, rows }
    }

    /// Why an action would be refused now; absent if it would not. The screen shows read-only separately.
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
        if !means_something(model.view_state.view, action) {
            return Some(wording::MEANS_NOTHING_HERE.to_owned());
        }
        let version = || self.here.as_ref().ok_or_else(|| wording::NO_VERSION.to_owned());
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
            | A::Rearm
            | A::Anchor => version().and_then(|id| operations::intent(model, action, id).map(drop)),
            A::BreakGlass => version().and_then(|id| self.break_glass(id)),
            A::Abort => {
                operations::abort(model).map(drop).ok_or_else(|| wording::NOTHING_UNDER_WAY.to_owned())
            }
            A::Go => cell_restart::may_go(model).map(drop),
            A::Acknowledge | A::Shelve | A::Unshelve | A::ResetAlarm => {
                let rows = model.alarm_rows();
                let alarm = rows.get(model.row()).map(|item| item.alarm());
                let alarm = alarm.ok_or_else(|| wording::NO_ALARM.to_owned());
                alarm.and_then(|alarm| selection::takes(alarm, action))
            }
            A::Sort | A::SortReverse => navigation::unsorted(model).map_or(Ok(()), |why| Err(why.to_owned())),
            A::StateFilter => {
                navigation::not_filtered_by_state(model).map_or(Ok(()), |why| Err(why.to_owned()))
            }
            A::Undo if model.undo.last().is_none() => Err(undo::NOTHING.to_owned()),
            A::FindNext if model.view_state.search.is_empty() => Err(wording::NOTHING_SEARCHED.to_owned()),
            A::Mark if selection::markable(model).is_none() => Err(wording::NOTHING_TO_MARK.to_owned()),
            A::OpenRecording if model.view_state.view != View::Overview => version().map(drop),
            _ => Ok(()),
        };
        found.err()
    }

    fn break_glass(&self, id: &CapabilityId) -> Result<(), String> {
        let now = self.model.engine_data.snapshot.as_ref();
        let open = now.is_some_and(|now| now.emergencies.iter().any(|question| question.version == *id));
        if open { Ok(()) } else { Err(wording::NO_BREAK_GLASS.to_owned()) }
    }

    /// Whether a hint is useful: the key would have an effect here and now.
    #[must_use]
    pub fn is_offered(&self, action: Action) -> bool {
        use crate::action::Action as A;
        let model = self.model;
        // The screen shows an engine that is gone, but a stop may still go to any running engine.
        if model.absence().is_some() && (action.changes_something() || action == A::Verify) {
            return false;
        }
        let useful = match action {
            A::Open => model.view_state.view.behavior().can_open(model, self.rows, self.here.as_ref()),
            A::NextPane => model.view_state.view.panes().len() > 1,
            A::Show(View::Approvals) => !model.waiting_rows().is_empty(),
            A::JumpToAlarm => model.alarm_rows().iter().any(|item| item.alarm().state.calls()),
            A::Copy => model.view_state.view.behavior().copied(model).is_some(),
            A::Filter => self.rows > 1 || !model.view_state.filter().is_empty(),
            A::Abort => operations::is_anything_under_way(model),
            A::Freeze => model.engine_data.snapshot.is_some(),
            A::Mark => self.rows > 1,
            A::Left | A::Right if model.view_state.view == View::Health => model.engine_data.health.is_some(),
            A::ZoomIn | A::ZoomOut if model.view_state.view == View::Health => true,
            A::ZoomIn => self.charts() && model.view_state.zoom < ZOOM_MAX,
            A::ZoomOut => model.view_state.zoom > 0,
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
