//! The monitors of active versions: one per activation, and the newest live tasks that each was fed.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use holdpoint_body::TaskKind;
use holdpoint_cell::CellCopy;

use holdpoint_governance::ablation::AblationPart;
use holdpoint_governance::decision::{Reason, ReasonCode};
use holdpoint_governance::evidence::EpisodeValues;
use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_governance::monitor::{Monitor, MonitorAction};
use holdpoint_governance::strictness::Strictness;
use holdpoint_protocol::monitor_chart::ChartView;
use holdpoint_protocol::snapshot::{EscalationView, MonitorView};
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::terms::SkillTerms;

use crate::fault::EngineFault;
use holdpoint_record::context::Context;
use holdpoint_record::evidence_binding::measured_terms_of;
use holdpoint_record::evidence_file::{EvidenceFile, EvidenceFiles};
use holdpoint_record::version_table::VersionTable;

/// The monitor of one activation.
#[derive(Clone)]
pub struct ActivationMonitor {
    pub id: CapabilityId,
    /// Its charts and the actions they require.
    pub monitor: Monitor,
    /// Live tasks it has run.
    pub episodes: u32,
    /// Their values, as far as a shift is tested: none under a tighter envelope.
    pub(crate) lived: Vec<EpisodeValues>,
    /// Whether its envelope was tightened.
    pub restricted: bool,
    /// Whether it was confirmed.
    pub confirmed: bool,
    /// Whether it passed its rollback drills.
    pub(crate) rollback_rehearsed: bool,
    /// The most severe published action of its monitor.
    pub announced: MonitorAction,
    /// The reason of its first escalation.
    pub escalation_reason: Option<ReasonCode>,
    /// The reasons of its open escalation; empty if there is none.
    pub question: Vec<Reason>,
}

impl ActivationMonitor {
    /// A monitor for a version about to be activated. Its normal values are those of its twins in the live cell, at the bad
    /// end of their confidence interval.
    ///
    /// # Errors
    /// If there is no shadow evidence to monitor it against.
    pub fn new(
        id: &CapabilityId,
        evidence_file: Option<&EvidenceFile>,
        context: &Context,
        now_tick: u64,
    ) -> Result<Self, EngineFault> {
        let settings = &context.profile.monitor;
        let expected = evidence_file
            .and_then(|evidence_file| {
                if context.omitted.has(AblationPart::Shadow) {
                    // An experiment omitted shadow: only the values of the sandbox are available.
                    evidence_file.normal_rates_in_pairs(settings)
                } else {
                    evidence_file.normal_rates(settings)
                }
            })
            .ok_or_else(|| {
                EngineFault::Impossible(format!("{id} has no shadow evidence to monitor it against"))
            })?;
        let conditions = evidence_file.map(|evidence_file| &*evidence_file.conditions).unwrap_or_default();
        let monitor = Monitor::strict(&context.profile, &expected, Strictness::of(conditions), now_tick)
            .map_err(|error| EngineFault::Impossible(error.to_string()))?;
        Ok(Self {
            id: id.clone(),
            monitor,
            episodes: 0,
            lived: Vec::new(),
            restricted: false,
            confirmed: false,
            rollback_rehearsed: evidence_file
                .is_some_and(|file| file.has_passed_rollback_drills(&context.profile.recovery)),
            announced: MonitorAction::Continue,
            escalation_reason: None,
            question: Vec::new(),
        })
    }

    /// The monitor of a version that had control and gets it back; absent if its window had passed.
    ///
    /// # Errors
    /// As [`ActivationMonitor::new`].
    pub(crate) fn reactivated(
        id: &CapabilityId,
        (version_table, now_tick): (&VersionTable, u64),
        evidence_file: Option<&EvidenceFile>,
        context: &Context,
    ) -> Result<Option<Self>, EngineFault> {
        let (_, state, _) = version_table.version(id)?;
        if !state.left_provisional {
            return Ok(None);
        }
        let watched = Self::new(id, evidence_file, context, now_tick)?;
        Ok(Some(Self { restricted: state.left_restricted, ..watched }))
    }
}

/// A live task that a monitor was fed, to the end and without a person's intervention.
pub(crate) struct MonitoredTask {
    /// The world where it began; absent where it was not kept.
    pub(crate) start: Option<Arc<CellCopy>>,
    pub(crate) task: TaskKind,
    pub(crate) seed: u64,
    pub(crate) values: EpisodeValues,
    /// The version ran under a tighter envelope.
    pub(crate) tightened: bool,
}

/// A monitor that was removed, and the tasks it was fed.
pub(crate) struct EndedMonitor {
    pub(crate) watched: ActivationMonitor,
    /// The oldest first.
    pub(crate) tasks: VecDeque<MonitoredTask>,
}

/// The monitors by family, at most one per family.
#[derive(Default)]
pub struct Monitors {
    by_family: BTreeMap<Family, ActivationMonitor>,
    /// The newest tasks of each. They end with the monitor, and no sequence gets a copy.
    tasks: BTreeMap<Family, VecDeque<MonitoredTask>>,
}

impl Monitors {
    /// The monitor of a version.
    #[must_use]
    pub fn of(&self, id: &CapabilityId) -> Option<&ActivationMonitor> {
        self.by_family.get(&id.family).filter(|watched| watched.id == *id)
    }

    /// The monitor of a version, to change.
    pub fn of_mut(&mut self, id: &CapabilityId) -> Option<&mut ActivationMonitor> {
        self.by_family.get_mut(&id.family).filter(|watched| watched.id == *id)
    }

    /// Monitors a version, in place of an earlier one of its family.
    pub fn insert(&mut self, watched: ActivationMonitor) {
        self.tasks.remove(&watched.id.family);
        self.by_family.insert(watched.id.family.clone(), watched);
    }

    /// Removes the monitor of a family.
    pub(crate) fn remove(&mut self, family: &Family) -> Option<EndedMonitor> {
        let tasks = self.tasks.remove(family).unwrap_or_default();
        self.by_family.remove(family).map(|watched| EndedMonitor { watched, tasks })
    }

    /// Keeps a task that the monitor of a version was fed, and the newest `most` tasks in all.
    pub(crate) fn keep_task(&mut self, id: &CapabilityId, task: MonitoredTask, most: usize) {
        if self.of(id).is_none() {
            return;
        }
        let kept = self.tasks.entry(id.family.clone()).or_default();
        kept.push_back(task);
        while kept.len() > most {
            kept.pop_front();
        }
    }

    /// The monitors for one sequence, without their tasks.
    pub(crate) fn for_sequence(&self) -> Self {
        Self { by_family: self.by_family.clone(), tasks: BTreeMap::new() }
    }

    /// Every monitor, in order of family.
    pub fn iter(&self) -> impl Iterator<Item = &ActivationMonitor> {
        self.by_family.values()
    }

    /// Every monitor, to change.
    pub fn iter_mut(&mut self) -> impl Iterator<Item = &mut ActivationMonitor> {
        self.by_family.values_mut()
    }

    /// Restores monitors after a sequence. A version that was rolled back or replaced meanwhile keeps none; an escalation raised
    /// meanwhile stays the same escalation.
    pub(crate) fn take_back(&mut self, others: Self) {
        for (family, watched) in others.by_family {
            if let Some(own) = self.by_family.get_mut(&family).filter(|own| own.id == watched.id) {
                let (reason, question) = (own.escalation_reason, std::mem::take(&mut own.question));
                *own = watched;
                own.escalation_reason = own.escalation_reason.or(reason);
                if own.question.is_empty() {
                    own.question = question;
                }
            }
        }
    }

    /// Live tasks of a family's version in its window; absent if none is open.
    #[must_use]
    pub fn window(&self, family: &Family) -> Option<u32> {
        self.by_family.get(family).filter(|watched| !watched.confirmed).map(|watched| watched.episodes)
    }

    /// Whether a version has an open escalation.
    #[must_use]
    pub fn has_question(&self, id: &CapabilityId) -> bool {
        self.of(id).is_some_and(|watched| watched.monitor.escalation().is_some())
    }

    /// When a monitor is due next, virtual ms. `link_up`: telemetry arrives.
    #[must_use]
    pub fn next_ms(&self, link_up: bool) -> Option<u64> {
        let due = self.iter().flat_map(|watched| {
            let deadline = watched.monitor.escalation().map(|escalation| escalation.deadline_tick);
            let silence = if link_up { None } else { watched.monitor.silence_due_tick() };
            [deadline, silence]
        });
        due.flatten().map(ms_of).min()
    }

    /// The open escalations.
    #[must_use]
    pub fn questions(&self) -> Vec<EscalationView> {
        let open = self.iter().filter_map(|watched| {
            let escalation = watched.monitor.escalation()?;
            Some(EscalationView {
                version: watched.id.clone(),
                reasons: watched.question.clone(),
                deadline_ms: ms_of(escalation.deadline_tick),
            })
        });
        open.collect()
    }

    /// Every monitor's charts against their limits; a window has `needed` episodes.
    #[must_use]
    pub fn views(&self, needed: u32) -> Vec<MonitorView> {
        let view = |watched: &ActivationMonitor| MonitorView {
            version: watched.id.clone(),
            episodes: watched.episodes,
            needed,
            restricted: watched.restricted,
            factor: watched.monitor.strictness().factor,
            coupled: watched.monitor.strictness().coupled,
            charts: watched
                .monitor
                .charts()
                .map(|(rate, level, value, limit)| ChartView {
                    rate: rate.into(),
                    level: level.into(),
                    value,
                    limit,
                })
                .collect(),
        };
        self.iter().map(view).collect()
    }
}

/// The terms a version runs under: the profile, capped by its manifest and its conditions, and tighter if its monitor or an
/// operator restricted it.
#[must_use]
pub fn terms_of(
    context: &Context,
    version_table: &VersionTable,
    evidence_files: &EvidenceFiles,
    monitors: &Monitors,
    capability: &Capability,
) -> SkillTerms {
    let id = capability.id();
    let by_operator = version_table.version(&id).is_ok_and(|(_, state, _)| state.flags.restricted);
    let by_monitor = monitors.of(&id).is_some_and(|watched| watched.restricted);
    let terms = measured_terms_of(context, evidence_files, capability);
    if by_operator || by_monitor { terms.tightened(context.profile.monitor.restrict_factor) } else { terms }
}

/// The first virtual time at which a tick has passed, ms.
#[must_use]
pub const fn ms_of(tick: u64) -> u64 {
    tick.saturating_mul(1000).div_ceil(holdpoint_body::RATE_HZ as u64)
}
