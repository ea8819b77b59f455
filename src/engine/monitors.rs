//! The monitors of active versions: one for each activation that is watched.

use std::collections::BTreeMap;

use holdpoint_governance::decision::{Reason, ReasonCode};
use holdpoint_governance::evidence::EpisodeValues;
use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_governance::monitor::{Monitor, MonitorAction, normal_rates};
use holdpoint_governance::omitted::Part;
use holdpoint_governance::strictness::Strictness;
use holdpoint_protocol::snapshot::{MonitorView, QuestionView};

use crate::context::Context;
use crate::dossier::Dossier;
use crate::fault::Fault;
use crate::record::Record;

/// The monitor of one activation.
#[derive(Clone)]
pub struct Watched {
    pub id: CapabilityId,
    /// Its charts and what they ask for.
    pub monitor: Monitor,
    /// Live tasks it has worked.
    pub episodes: u32,
    /// What it did in those, as far as a shift is looked for: none under a tighter envelope.
    pub(crate) lived: Vec<EpisodeValues>,
    /// Whether its envelope was tightened.
    pub restricted: bool,
    /// Whether it was confirmed.
    pub confirmed: bool,
    /// The gravest action of its monitor that was announced.
    pub announced: MonitorAction,
    /// What its first question was raised for.
    pub asked: Option<ReasonCode>,
    /// Why it asks people now; empty if it does not.
    pub question: Vec<Reason>,
}

impl Watched {
    /// A monitor for a version about to be activated. What is normal is what its twins did in the live world, at the
    /// unfavourable end of what so few of them can tell.
    ///
    /// # Errors
    /// If there is no shadow evidence to monitor it against.
    pub fn new(
        id: &CapabilityId,
        dossier: Option<&Dossier>,
        context: &Context,
        now_tick: u64,
    ) -> Result<Self, Fault> {
        let expected = dossier
            .and_then(|dossier| {
                if context.omitted.has(Part::Shadow) {
                    // An experiment left shadow out: what the version did in the sandbox is all there is.
                    let alone: Vec<EpisodeValues> = dossier.pairs.iter().map(|pair| pair.candidate).collect();
                    normal_rates(&alone)
                } else {
                    normal_rates(&dossier.twins)
                }
            })
            .ok_or_else(|| Fault::Impossible(format!("{id} has no shadow evidence to monitor it against")))?;
        let conditions = dossier.map(|dossier| &*dossier.conditions).unwrap_or_default();
        let monitor = Monitor::strict(&context.profile, &expected, Strictness::of(conditions), now_tick)
            .map_err(|error| Fault::Impossible(error.to_string()))?;
        Ok(Self {
            id: id.clone(),
            monitor,
            episodes: 0,
            lived: Vec::new(),
            restricted: false,
            confirmed: false,
            announced: MonitorAction::Continue,
            asked: None,
            question: Vec::new(),
        })
    }

    /// The monitor of a version that had control and gets it back; absent where its window was passed.
    ///
    /// # Errors
    /// As [`Watched::new`].
    pub(crate) fn again(
        id: &CapabilityId,
        record: &Record,
        dossier: Option<&Dossier>,
        context: &Context,
    ) -> Result<Option<Self>, Fault> {
        let (_, standing, _) = record.ledger().version(id)?;
        if !standing.left_provisional {
            return Ok(None);
        }
        let watched = Self::new(id, dossier, context, record.now_tick())?;
        Ok(Some(Self { restricted: standing.left_restricted, ..watched }))
    }
}

/// The monitors by family: at most one a family.
#[derive(Clone, Default)]
pub struct Monitors(BTreeMap<Family, Watched>);

impl Monitors {
    /// The monitor of a version.
    #[must_use]
    pub fn of(&self, id: &CapabilityId) -> Option<&Watched> {
        self.0.get(&id.family).filter(|watched| watched.id == *id)
    }

    /// The monitor of a version, to change.
    pub fn of_mut(&mut self, id: &CapabilityId) -> Option<&mut Watched> {
        self.0.get_mut(&id.family).filter(|watched| watched.id == *id)
    }

    /// From now on a version is watched, in place of whoever of its family was.
    pub fn insert(&mut self, watched: Watched) {
        self.0.insert(watched.id.family.clone(), watched);
    }

    /// Nobody of a family is watched any more.
    pub fn remove(&mut self, family: &Family) {
        self.0.remove(family);
    }

    /// Every monitor, in order of family.
    pub fn iter(&self) -> impl Iterator<Item = &Watched> {
        self.0.values()
    }

    /// Every monitor, to change.
    pub fn iter_mut(&mut self) -> impl Iterator<Item = &mut Watched> {
        self.0.values_mut()
    }

    /// Takes in monitors that were out in a sequence. A version that was taken off or replaced meanwhile has none any
    /// more; a question that was told meanwhile is still the same question.
    pub(crate) fn take_back(&mut self, others: Self) {
        for (family, watched) in others.0 {
            if let Some(own) = self.0.get_mut(&family).filter(|own| own.id == watched.id) {
                let (asked, question) = (own.asked, std::mem::take(&mut own.question));
                *own = watched;
                own.asked = own.asked.or(asked);
                if own.question.is_empty() {
                    own.question = question;
                }
            }
        }
    }

    /// Live tasks that a family's version has worked in its window; absent if none is open.
    #[must_use]
    pub fn window(&self, family: &Family) -> Option<u32> {
        self.0.get(family).filter(|watched| !watched.confirmed).map(|watched| watched.episodes)
    }

    /// Whether a monitor asks about a version.
    #[must_use]
    pub fn has_question(&self, id: &CapabilityId) -> bool {
        self.of(id).is_some_and(|watched| watched.monitor.escalation().is_some())
    }

    /// When a monitor has to be looked at again, virtual ms. `link_up`: telemetry arrives.
    #[must_use]
    pub fn next_ms(&self, link_up: bool) -> Option<u64> {
        let due = self.iter().flat_map(|watched| {
            let deadline = watched.monitor.escalation().map(|waiting| waiting.deadline_tick);
            let silence = if link_up { None } else { watched.monitor.silence_due_tick() };
            [deadline, silence]
        });
        due.flatten().map(ms_of).min()
    }

    /// Questions that wait for an answer.
    #[must_use]
    pub fn questions(&self) -> Vec<QuestionView> {
        let open = self.iter().filter_map(|watched| {
            let asked = watched.monitor.escalation()?;
            Some(QuestionView {
                version: watched.id.clone(),
                reasons: watched.question.clone(),
                deadline_ms: ms_of(asked.deadline_tick),
            })
        });
        open.collect()
    }

    /// Every monitor's charts against their limits; `needed` episodes make a window.
    #[must_use]
    pub fn views(&self, needed: u32) -> Vec<MonitorView> {
        let view = |watched: &Watched| MonitorView {
            version: watched.id.clone(),
            episodes: watched.episodes,
            needed,
            restricted: watched.restricted,
            factor: watched.monitor.strictness().factor(),
            coupled: watched.monitor.strictness().coupled(),
            charts: watched
                .monitor
                .charts()
                .map(|(rate, chart, stands, limit)| (format!("{} {chart}", rate.name()), stands, limit))
                .collect(),
        };
        self.iter().map(view).collect()
    }
}

/// The first virtual time at which a tick has come, ms.
#[must_use]
pub const fn ms_of(tick: u64) -> u64 {
    tick.saturating_mul(1000).div_ceil(holdpoint_body::RATE_HZ as u64)
}
