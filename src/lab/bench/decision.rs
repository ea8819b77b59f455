//! What a decision costs: one version that is promoted and six that are rejected, each through the stages of a real
//! engine on a scratch store, with one worker.
//!
//! Counts what was simulated by the unit of work that the engine reported in the same slice, and takes the time of it.
//! Judges nothing. The counts depend on the build alone, so a test holds them.

use std::collections::BTreeMap;

use serde::Serialize;

use holdpoint::bench::{BenchError, FigureClock};
use holdpoint_engine::decide::pipeline::SliceOutcome;
use holdpoint_engine::{Config, Engine};
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::submission::Package;
use holdpoint_protocol::command::{Command, Reply, Request};
use holdpoint_protocol::event::EventKind;
use holdpoint_protocol::scenario_state::ScenarioState;
use holdpoint_runtime::capability::Capability;
use holdpoint_service::pump::Pump;
use holdpoint_sim::SimCells;
use holdpoint_sim::work_count::{WorkCount, on_this_thread};
use holdpoint_trials::cache::EpisodeCache;
use holdpoint_trials::cell::Cell;
use holdpoint_trials::embedded;
use holdpoint_trials::seeds::EpisodeSeeds;

/// The run's seed: that of the scenarios that ship with the program.
const SEED: u64 = 1;

/// Most slices of work; a candidate takes some hundred.
const SLICES_MAX: u32 = 100_000;

holdpoint_governance::closed_set! {
    /// A decision by its result and cause.
    DecisionKind, "kind of decision", {
        Promotion = "promotion",
        Interface = "rejected-interface",
        Policy = "rejected-policy",
        Behavior = "rejected-behavior",
        Recovery = "rejected-recovery",
        /// For its behavior in live-like pairs.
        LiveLike = "rejected-live-like",
        /// A version whose search optimized success alone.
        Refined = "rejected-refined",
    }
}

impl DecisionKind {
    /// The folder of the version that is decided on.
    const fn candidate(self) -> &'static str {
        match self {
            Self::Promotion => "align-improved",
            Self::Interface => "grasp-tool-frame",
            Self::Policy => "grasp-direct-bus",
            Self::Behavior => "grasp-hard-grip",
            Self::Recovery => "align-no-stop",
            Self::LiveLike => "align-low-transit",
            Self::Refined => "place-refined",
        }
    }
}

/// The one that is not embedded in the engine.
const PLACE_REFINED: [&str; 3] = [
    include_str!("../../../manifests/candidates/place-refined/manifest.toml"),
    include_str!("../../../manifests/candidates/place-refined/submission.toml"),
    include_str!("../../../manifests/candidates/place-refined/params.toml"),
];

/// What all decisions cost.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DecisionBudget {
    /// Version of the program.
    pub version: &'static str,
    /// Whether the program was built with optimization (`release`) or for development (`dev`).
    pub build: &'static str,
    /// One entry per version.
    pub decisions: Vec<DecisionCost>,
}

/// What one decision cost.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DecisionCost {
    pub decision: DecisionKind,
    /// The candidate's folder.
    pub candidate: &'static str,
    /// Its state at the end.
    pub end: String,
    /// By part, the largest number of ticks first.
    pub parts: Vec<PartCost>,
    /// All parts together.
    pub whole: PartCost,
}

/// What one part of a decision cost.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct PartCost {
    /// The unit of work, or what else the engine did.
    pub part: String,
    /// Episodes set up.
    pub episodes: u64,
    /// Times an episode went on from another's state.
    pub forks: u64,
    /// Ticks simulated.
    pub ticks: u64,
    /// CPU time, s.
    pub cpu_s: f64,
}

impl PartCost {
    fn add(&mut self, work: WorkCount, cpu_s: f64) {
        self.episodes += work.episodes;
        self.forks += work.forks;
        self.ticks += work.ticks;
        self.cpu_s += cpu_s;
    }
}

/// Takes every version through the stages.
///
/// # Errors
/// [`BenchError`]; a broken engine's counts mean nothing.
pub fn run(mut on_decision: impl FnMut(DecisionKind)) -> Result<DecisionBudget, BenchError> {
    let mut decisions = Vec::with_capacity(DecisionKind::ALL.len());
    for decision in DecisionKind::ALL {
        on_decision(decision);
        decisions.push(decide(decision)?);
    }
    let build = if cfg!(debug_assertions) { "dev" } else { "release" };
    Ok(DecisionBudget { version: env!("CARGO_PKG_VERSION"), build, decisions })
}

fn package(candidate: &str) -> Option<Package> {
    let [manifest, submission, params] = PLACE_REFINED.map(str::to_owned);
    let refined = Package { manifest, submission, params, component: None, author_signature: None };
    embedded::package(candidate).or_else(|| (candidate == "place-refined").then_some(refined))
}

fn decide(decision: DecisionKind) -> Result<DecisionCost, BenchError> {
    let candidate = decision.candidate();
    let folder = tempfile::tempdir()?;
    let engine = Engine::start(Config {
        data: folder.path(),
        profile: ProfileName::Sim.into(),
        seeds: EpisodeSeeds::OfRun(SEED),
        jobs: 1,
        scripted: true,
        cell: Cell::of(&SimCells, None)?,
        cache: EpisodeCache::InStore,
    })?;
    let mut pump = Pump::new(engine, Vec::new());
    let package = package(candidate).ok_or_else(|| unexpected(format!("no version \"{candidate}\"")))?;
    let id = Capability::load(candidate, package.clone())?.id();
    let mut parts: BTreeMap<String, PartCost> = BTreeMap::new();
    let reading = || (on_this_thread(), FigureClock::ProcessCpu.secs());
    let mut note = |part: String, before: (WorkCount, f64)| {
        let now = reading();
        parts.entry(part).or_default().add(now.0.since(before.0), now.1 - before.1);
    };
    let before = reading();
    let command = Command::Register { package, name: candidate.to_owned(), by: None };
    let reply = pump.submit(Request::unsigned("bench".to_owned(), command));
    note("registration".to_owned(), before);
    if !matches!(reply, Reply::Accepted { .. }) {
        return Err(unexpected(format!("{reply:?}")));
    }
    let (mut state, mut confirmed) = (State::Registered, false);
    for _ in 0..SLICES_MAX {
        let before = reading();
        let (progress, events) = pump.turn();
        let mut part = format!("{}, work beside it", state.name());
        for event in events {
            match event.kind {
                EventKind::Progress { version, what, .. } if version == id => {
                    part = what.to_string();
                }
                EventKind::StateChanged { version, to, .. } if version == id => state = to,
                EventKind::Confirmed { version, .. } if version == id => confirmed = true,
                EventKind::Fault { text } => return Err(unexpected(text)),
                _ => {}
            }
        }
        note(part, before);
        if confirmed || progress != SliceOutcome::Ran || state == State::Rejected {
            break;
        }
    }
    let end = if confirmed { ScenarioState::Confirmed } else { ScenarioState::In(state) };
    let mut whole = PartCost { part: "whole".to_owned(), ..PartCost::default() };
    for part in parts.values() {
        let PartCost { episodes, forks, ticks, cpu_s, .. } = *part;
        whole.add(WorkCount { episodes, forks, ticks }, cpu_s);
    }
    let mut parts: Vec<PartCost> = parts.into_iter().map(|(part, cost)| PartCost { part, ..cost }).collect();
    parts.sort_by_key(|part| std::cmp::Reverse(part.ticks));
    Ok(DecisionCost { decision, candidate, end: end.to_string(), parts, whole })
}

fn unexpected(found: String) -> BenchError {
    BenchError::Unexpected { what: "a decision", found, expected: "an engine that works" }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::fmt::Write as _;

    use super::*;
    use crate::wording::answers::decision_kind;

    /// The parts of all decisions, one row each, and their sums.
    fn table(budget: &DecisionBudget) -> String {
        let simulated: Vec<&DecisionCost> =
            budget.decisions.iter().filter(|cost| cost.whole.ticks > 0).collect();
        let mut page = String::from("| part |");
        for cost in &simulated {
            let _ = write!(page, " {} |", decision_kind(cost.decision));
        }
        let _ = write!(page, "\n| --- |{}\n", " --- |".repeat(simulated.len()));
        let mut named = BTreeSet::new();
        for part in simulated.iter().flat_map(|cost| &cost.parts).filter(|part| part.ticks > 0) {
            if !named.insert(&part.part) {
                continue;
            }
            let of = |cost: &&DecisionCost| {
                cost.parts.iter().find(|other| other.part == part.part).map_or(0, |part| part.ticks)
            };
            let _ = write!(page, "| {} |", part.part);
            for cost in &simulated {
                let _ = write!(page, " {} |", of(cost));
            }
            page.push('\n');
        }
        for (name, of) in [
            ("all ticks", (|whole| whole.ticks) as fn(&PartCost) -> u64),
            ("episodes", |whole| whole.episodes),
            ("forks", |whole| whole.forks),
        ] {
            let _ = write!(page, "| **{name}** |");
            for cost in &simulated {
                let _ = write!(page, " **{}** |", of(&cost.whole));
            }
            page.push('\n');
        }
        page
    }

    #[test]
    fn budget_in_the_guide_is_what_decisions_cost() {
        let budget = run(|_| ()).unwrap();
        let ends = budget.decisions.iter().map(|cost| cost.end.as_str()).collect::<Vec<_>>();
        assert_eq!(ends[0], "confirmed");
        assert!(ends[1..].iter().all(|end| *end == "rejected"), "{ends:?}");
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../guide/design/cost-of-a-decision.md");
        let page = std::fs::read_to_string(path).unwrap();
        let (begin, end) = ("<!-- budget -->\n", "<!-- end of the budget -->");
        let (head, rest) = page.split_once(begin).unwrap();
        let (_, tail) = rest.split_once(end).unwrap();
        let expected = format!("{head}{begin}\n{}\n{end}{tail}", table(&budget));
        if std::env::var_os("HOLDPOINT_WRITE_GUIDE").is_some() {
            std::fs::write(path, &expected).unwrap();
        }
        assert!(page == expected, "the budget has changed: HOLDPOINT_WRITE_GUIDE=1 writes it\n{expected}");
    }
}
