//! The store's invariants, each with a named checker.

use rusqlite::{Connection, OptionalExtension};

use crate::chain::compare::compare;
use crate::chain::fold::{ChainFault, Fold, FoldError};
use crate::database::columns::parsed;
use holdpoint_governance::approval::ApprovalDecision;
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::record::ActivationCause;
use holdpoint_store::EvidenceKind;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Invariant {
    /// I1: a bootstrapped family has exactly one active version, or is safe-stopped and has none.
    OneActive,
    /// I2: nothing became active without its gate record and the approvals it needed.
    GatedActivation,
    /// I3: the tables are the fold of the audit chain.
    StateIsFold,
    /// I4: the audit chain is whole.
    Chain,
    /// I5: every receipt's records are in the chain.
    Acknowledged,
    /// I6: the rollback target is superseded, of the family and pinned.
    RollbackTarget,
}

/// A violated invariant.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{subject}: {problem}")]
pub struct Violation {
    pub invariant: Invariant,
    pub subject: String,
    pub problem: String,
}

fn violation(invariant: Invariant, subject: &str, problem: impl Into<String>) -> Violation {
    Violation { invariant, subject: subject.to_owned(), problem: problem.into() }
}

/// Checks all of I1 to I6; empty if all hold. Reads the whole chain.
///
/// # Errors
/// If the database cannot be read.
pub fn check_invariants(connection: &Connection) -> rusqlite::Result<Vec<Violation>> {
    let mut found = check_registry(connection)?;
    match Fold::read(connection) {
        Ok(fold) => found.extend(compare(&fold, connection)?.map(of_fault)),
        Err(FoldError::Fault(fault)) => found.push(of_fault(fault)),
        Err(FoldError::Read { source, .. }) => return Err(source),
    }
    found.extend(check_acknowledged(connection)?);
    Ok(found)
}

/// I1, I2 and I6: those that need no reading of the chain.
pub(crate) fn check_registry(connection: &Connection) -> rusqlite::Result<Vec<Violation>> {
    let mut select = connection.prepare("SELECT name FROM family ORDER BY name")?;
    let families: Vec<String> = select.query_map([], |row| row.get(0))?.collect::<Result<_, _>>()?;
    let mut found = Vec::new();
    for family in families {
        found.extend(check_family(connection, &family)?);
    }
    let mut orphans = connection.prepare(
        "SELECT name FROM version v WHERE NOT EXISTS (SELECT 1 FROM family f WHERE f.name = v.family)",
    )?;
    for name in orphans.query_map([], |row| row.get::<_, String>(0))? {
        found.push(violation(Invariant::OneActive, &name?, "its family is missing"));
    }
    found.extend(check_gates(connection)?);
    Ok(found)
}

fn of_fault(fault: ChainFault) -> Violation {
    match fault {
        ChainFault::Record { seq, problem } => violation(Invariant::Chain, &format!("record {seq}"), problem),
        ChainFault::Row { table, key, problem } => {
            violation(Invariant::StateIsFold, &format!("{table} {key:?}"), problem)
        }
    }
}

/// I1 and I6 of one family.
pub(crate) fn check_family(connection: &Connection, family: &str) -> rusqlite::Result<Vec<Violation>> {
    type FamilyColumns = (Option<String>, Option<String>, bool, bool);
    let row: Option<FamilyColumns> = connection
        .prepare_cached("SELECT active, pinned, bootstrapped, safe_stopped FROM family WHERE name = ?1")?
        .query_row([family], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?)))
        .optional()?;
    let Some((active, pinned, bootstrapped, safe_stopped)) = row else {
        return Ok(vec![violation(Invariant::OneActive, family, "the family is missing")]);
    };
    let in_state_active: Vec<String> = connection
        .prepare_cached("SELECT name FROM version WHERE family = ?1 AND state = 'active'")?
        .query_map([family], |row| row.get(0))?
        .collect::<Result<_, _>>()?;
    let mut found = Vec::new();
    let mut one_active = |problem: String| found.push(violation(Invariant::OneActive, family, problem));
    if in_state_active.iter().ne(active.iter()) {
        one_active(format!("its pointer is at {active:?}, in state active are {in_state_active:?}"));
    }
    if bootstrapped && active.is_none() && !safe_stopped {
        one_active("it has no active version and is not safe-stopped".to_owned());
    }
    if active.is_some() && (safe_stopped || !bootstrapped) {
        one_active("it has an active version although it is safe-stopped or was never started".to_owned());
    }
    let stray: Option<String> = connection
        .prepare_cached(
            "SELECT name FROM version
             WHERE family = ?1 AND state <> 'active' AND (provisional = 1 OR restricted = 1 OR rollback_pending = 1)",
        )?
        .query_row([family], |row| row.get(0))
        .optional()?;
    if let Some(name) = stray {
        one_active(format!("{name} is provisional, restricted or being rolled back, but not active"));
    }
    if let Some(name) = pinned {
        let target: Option<(String, State)> = connection
            .prepare_cached("SELECT family, state FROM version WHERE name = ?1")?
            .query_row([&name], |row| Ok((row.get(0)?, parsed(row, 1)?)))
            .optional()?;
        if target != Some((family.to_owned(), State::Superseded)) {
            let problem = format!("its rollback target {name} must be one of its superseded versions");
            found.push(violation(Invariant::RollbackTarget, family, problem));
        }
    } else if let Some(name) = &active
        && came_through_gate(connection, family, name)?
    {
        let problem = format!("{name} replaced another version, but no rollback target is pinned");
        found.push(violation(Invariant::RollbackTarget, family, problem));
    }
    Ok(found)
}

/// Whether the family's last activation came through the gate and made the replaced version the rollback target.
fn came_through_gate(connection: &Connection, family: &str, active: &str) -> rusqlite::Result<bool> {
    let last: Option<(Option<String>, ActivationCause, Option<String>)> = connection
        .prepare_cached(
            "SELECT active, cause, pinned FROM activation WHERE family = ?1 ORDER BY seq DESC LIMIT 1",
        )?
        .query_row([family], |row| Ok((row.get(0)?, parsed(row, 1)?, row.get(2)?)))
        .optional()?;
    Ok(last.is_some_and(|(name, cause, pinned)| {
        name.as_deref() == Some(active) && cause == ActivationCause::Gate && pinned.is_some()
    }))
}

/// I2: each activation through the gate has its gate record before it and the approvals it needed.
fn check_gates(connection: &Connection) -> rusqlite::Result<Vec<Violation>> {
    let mut select = connection.prepare(
        "SELECT a.seq, a.active FROM activation a
         WHERE a.cause = ?1 AND (
           NOT EXISTS (SELECT 1 FROM evidence e WHERE e.version = a.active AND e.kind = ?2
                         AND e.digest = a.gate_digest AND e.seq < a.seq)
           OR a.approvals_needed > (SELECT count(DISTINCT p.who) FROM approval p WHERE p.version = a.active
                         AND p.decision = ?3 AND p.consumed_seq < a.seq))",
    )?;
    let names = [ActivationCause::Gate.name(), EvidenceKind::Gate.name(), ApprovalDecision::Approve.name()];
    let rows = select.query_map(names, |row| Ok((row.get::<_, u64>(0)?, row.get::<_, String>(1)?)))?;
    rows.map(|row| {
        let (seq, name) = row?;
        let problem = format!("record {seq} made it active without its gate record or enough approvals");
        Ok(violation(Invariant::GatedActivation, &name, problem))
    })
    .collect()
}

/// I5: every stored receipt points at an existing record.
pub(crate) fn check_acknowledged(connection: &Connection) -> rusqlite::Result<Vec<Violation>> {
    let mut select = connection
        .prepare("SELECT id, last_seq FROM command WHERE last_seq > (SELECT seq FROM audit_head)")?;
    let rows = select.query_map([], |row| Ok((row.get::<_, String>(0)?, row.get::<_, u64>(1)?)))?;
    rows.map(|row| {
        let (id, seq) = row?;
        Ok(violation(
            Invariant::Acknowledged,
            &id,
            format!("its receipt names record {seq}, which is not there"),
        ))
    })
    .collect()
}
