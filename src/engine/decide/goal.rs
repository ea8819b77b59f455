//! The goal of the agent of the live cell: set by a person, recorded, and restored after a restart.

use holdpoint_body::TaskKind;
use holdpoint_governance::record::RecordKind;
use holdpoint_protocol::command::{Refusal, Reply};
use holdpoint_protocol::event::EventKind;
use holdpoint_runtime::agent::Goal;
use holdpoint_store::{AuditFilter, RecordViews, StoreError};
use holdpoint_text::Untrusted;
use holdpoint_wording::command_effect::{EngineEffect, engine_effect};
use serde::{Deserialize, Serialize};

use crate::decide::people::persons::unreadable;
use crate::decide::recorder::EngineRecorder;
use crate::live::LiveWorld;

/// A goal in the audit chain.
#[derive(Serialize, Deserialize)]
struct GoalRecord {
    goal: String,
    by: String,
    reason: String,
}

/// Sets the goal `text` from the next sequence on, if the agent's interpreter knows it.
///
/// # Errors
/// If it cannot be written; the goal is then unchanged.
pub(crate) fn set(
    record: &mut EngineRecorder,
    world: &mut LiveWorld,
    text: &str,
    by: String,
    reason: String,
) -> Result<Reply, StoreError> {
    let refuse = |text: String| Ok(Reply::Refused { code: Refusal::BadInput, text, hint: None });
    let goal = match Goal::interpret(text, world.cell.tasks()) {
        Ok(goal) => goal,
        Err(error) => return refuse(Untrusted::new(error.to_string()).line().into_string()),
    };
    if let Some(refused) = unreadable(&by, &reason) {
        return Ok(refused);
    }
    let goal_record = GoalRecord { goal: goal.name().to_owned(), by, reason };
    let body = serde_json::json!(goal_record).to_string();
    record.note(RecordKind::GoalSet, String::new(), body)?;
    world.cell.goal = goal;
    let GoalRecord { goal: name, by, reason } = goal_record;
    record.tell(EventKind::GoalSet { goal: name, by, reason });
    let text = engine_effect(&EngineEffect::Goal(&goal.plan(world.cell.tasks())));
    Ok(Reply::Accepted { text, version: None })
}

/// The newest goal in the chain; absent if there is none, or the interpreter of a cell with these tasks does not know it.
///
/// # Errors
/// If the store cannot be read.
pub(crate) fn recall(views: &dyn RecordViews, tasks: &[TaskKind]) -> Result<Option<Goal>, StoreError> {
    let found = views.audit(&AuditFilter::newest(RecordKind::GoalSet))?.into_iter().next();
    let stored = found.and_then(|record| serde_json::from_str::<GoalRecord>(&record.body).ok());
    Ok(stored.and_then(|stored| Goal::interpret(&stored.goal, tasks).ok()))
}
