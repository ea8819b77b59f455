//! One slice of a comparison of a version with another after its sandbox: a confirmation, or a suspicious version that is
//! worked again.

use holdpoint_governance::evidence::SandboxMode;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::task::TaskRecord;

use super::closing::progress;
use crate::binding::{party, team};
use crate::cell::{Cell, Conditions};
use crate::context::Context;
use crate::dossier::Dossiers;
use crate::fault::Fault;
use crate::record::Record;
use crate::trial::Trials;
use crate::trial::evaluation::{Evaluation, Plan};
use crate::trial::trace::keep_trace;

/// What is compared, and where.
pub(super) struct Compared<'a> {
    pub(super) id: &'a CapabilityId,
    pub(super) with: &'a Capability,
    pub(super) cell: &'a Cell,
    /// Whose conditions the cell's sandbox has.
    pub(super) conditions: Conditions,
    pub(super) plan: Plan,
    /// Whose progress it is, and what it is called.
    pub(super) stage: Stage,
    pub(super) what: &'static str,
}

/// Works one slice, keeps its traces and tells how far it is. Gives the episodes that were worked.
///
/// # Errors
/// If a worker fails, or what came of it cannot be written.
pub(super) fn work_slice(
    context: &Context,
    trials: &Trials,
    record: &mut Record,
    dossiers: &mut Dossiers,
    of: &Compared<'_>,
    evaluation: &mut Evaluation,
) -> Result<u64, Fault> {
    let candidate = record.capability(of.id)?;
    let ledger = record.ledger();
    let store = ledger.store();
    let party = |version| party(context, ledger, dossiers, version);
    let (new, old) = (party(&candidate), party(of.with));
    let lab = trials.lab(of.cell, store).beside(team(context, ledger, dossiers, &candidate));
    let Some(slice) = evaluation.step(&lab, &new, &old, &context.profile)? else { return Ok(0) };
    let fresh: Vec<TaskRecord> = slice.records.into_iter().map(|(new, _)| new).collect();
    if !fresh.is_empty() {
        let now_ms = record.now_ms();
        keep_trace(store, of.cell, of.id, SandboxMode::Confirmation, of.conditions, &fresh, now_ms)?;
    }
    let what = format!("{}, {}", of.what, slice.what);
    progress(record, dossiers, of.id, of.stage, &what, (slice.done, of.plan.budget()));
    Ok(fresh.len() as u64)
}
