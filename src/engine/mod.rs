//! The one door: commands in, events out, a snapshot for whoever looks.
//!
//! The engine numbers events, remembers answers so that a retried command is carried out once, and
//! keeps nothing else: authority lies with the manager and the rules behind it. It is synchronous:
//! who owns it calls [`Engine::submit`] and [`Engine::advance`] in turn.

pub mod clock;
pub mod command;
pub mod detail;
pub mod door;
pub mod embedded;
pub mod event;
mod evidence_view;
mod lookup;
pub mod picture;
pub mod service;
pub mod snapshot;
pub mod told;
mod view;

use std::collections::VecDeque;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use self::clock::Clock;
use self::command::{Command, Refusal, Reply, Request};
use self::event::Event;
use self::snapshot::Snapshot;
use crate::governance::policy::PolicyTable;
use crate::governance::profile::{Profile, ProfileName};
use crate::pipeline::cache::EpisodeCache;
use crate::pipeline::cell::Cell;
use crate::pipeline::ledger::{Ledger, LedgerError};
use crate::pipeline::manager::{Fault, Progress, Settings, UpgradeManager};
use crate::registry::{Store, StoreError};
use crate::runtime::capability::{Capability, Package, PackageError};

/// The three texts of a family's first version.
macro_rules! embedded_baseline {
    ($family:literal) => {
        (
            concat!("manifests/", $family, "/1.0.0"),
            [
                include_str!(concat!("../../manifests/", $family, "/1.0.0/manifest.toml")),
                include_str!(concat!("../../manifests/", $family, "/1.0.0/submission.toml")),
                include_str!(concat!("../../manifests/", $family, "/1.0.0/params.toml")),
            ],
        )
    };
}
/// Answers remembered for retried commands.
const ANSWERS_KEPT: usize = 1024;

/// Why an engine could not start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The store cannot be used.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The registry cannot be read.
    #[error(transparent)]
    Ledger(#[from] LedgerError),
    /// A profile does not parse.
    #[error(transparent)]
    Profile(#[from] crate::governance::text_error::TextError),
    /// The policies do not compile.
    #[error(transparent)]
    Policy(#[from] crate::governance::policy::PolicyError),
    /// A baseline does not load.
    #[error(transparent)]
    Baseline(#[from] PackageError),
    /// The cell cannot be built.
    #[error(transparent)]
    Sim(#[from] holdpoint_sim::SimError),
    /// The start could not be written.
    #[error(transparent)]
    Fault(#[from] Fault),
}

/// What an engine is started with.
pub struct Config<'a> {
    /// The store's folder.
    pub data: &'a Path,
    /// The profile.
    pub profile: ProfileName,
    /// The run's seed.
    pub seed: u64,
    /// Workers for evaluation.
    pub jobs: usize,
    /// Whether time is virtual (a script) or follows the machine's.
    pub scripted: bool,
    /// The cell.
    pub cell: Cell,
    /// Where episodes of active versions are kept.
    pub cache: EpisodeCache,
}

/// See the module's head.
pub struct Engine {
    manager: UpgradeManager,
    next_seq: u64,
    answers: VecDeque<(String, Reply)>,
    ended: bool,
}

/// The embedded baselines, in the order they are bootstrapped: what others fall back to comes first.
const BASELINES: [(&str, [&str; 3]); 4] = [
    embedded_baseline!("park"),
    embedded_baseline!("grasp"),
    embedded_baseline!("align"),
    embedded_baseline!("place"),
];

/// The embedded first versions of every family.
///
/// # Errors
/// Where an embedded file does not load.
pub fn baselines() -> Result<Vec<Capability>, PackageError> {
    BASELINES
        .into_iter()
        .map(|(name, [manifest, submission, params])| {
            let package = Package {
                manifest: manifest.to_owned(),
                submission: submission.to_owned(),
                params: params.to_owned(),
            };
            Capability::load(name, package)
        })
        .collect()
}

impl Engine {
    /// Opens the store and starts; finishes or undoes what an interrupted engine left.
    ///
    /// # Errors
    /// [`StartError`]; the store is then as it was, but for the recovery that was written.
    pub fn start(config: Config<'_>) -> Result<Self, StartError> {
        let profile = Profile::builtin(config.profile)?;
        let table = PolicyTable::builtin(&profile)?;
        let baselines = baselines()?;
        let store = Store::open(config.data)?;
        let from_ms = store.opening().head.at_ms;
        let clock = if config.scripted { Clock::scripted(from_ms) } else { Clock::real(from_ms) };
        let ledger = Ledger::open(store, !config.scripted)?;
        let settings = Settings {
            seed: config.seed,
            jobs: config.jobs,
            profile,
            table,
            cell: config.cell,
            cache: config.cache,
        };
        let manager = UpgradeManager::new(settings, ledger, clock, baselines)?;
        Ok(Self { manager, next_seq: 1, answers: VecDeque::new(), ended: false })
    }

    /// Carries out one request. The same id again gets the same answer and does nothing.
    pub fn submit(&mut self, request: Request) -> Reply {
        if let Some((_, reply)) = self.answers.iter().find(|(id, _)| *id == request.id) {
            return reply.clone();
        }
        let reply = match request.command {
            Command::Snapshot => return Reply::Snapshot { snapshot: Box::new(self.snapshot()) },
            Command::Shutdown => {
                self.ended = true;
                Reply::Accepted {
                    text: "the engine ends; nothing was approved or activated by it".to_owned(),
                    version: None,
                }
            }
            _ if self.ended => {
                Reply::Refused { code: Refusal::NotNow, text: "the engine is ending".to_owned(), hint: None }
            }
            command => self.manager.command(command),
        };
        self.answers.push_back((request.id, reply.clone()));
        if self.answers.len() > ANSWERS_KEPT {
            self.answers.pop_front();
        }
        reply
    }

    /// One slice of work.
    pub fn advance(&mut self) -> Progress {
        if self.ended { Progress::Idle { next_ms: None } } else { self.manager.advance() }
    }

    /// A script's clock jumps to a deadline. Tells whether it moved.
    pub const fn jump_to(&mut self, at_ms: u64) -> bool {
        self.manager.jump_to(at_ms)
    }

    /// Virtual time, ms.
    #[must_use]
    pub fn now_ms(&self) -> u64 {
        self.manager.clock().now_ms()
    }

    /// Events since the last call, numbered, in order.
    pub fn drain_events(&mut self) -> Vec<Event> {
        let at_ms = self.now_ms();
        let kinds = self.manager.drain_events();
        kinds
            .into_iter()
            .map(|kind| {
                let seq = self.next_seq;
                self.next_seq += 1;
                Event { seq, at_ms, kind }
            })
            .collect()
    }

    /// How things stand.
    #[must_use]
    pub fn snapshot(&self) -> Snapshot {
        self.manager.snapshot()
    }

    /// Whether the engine was asked to end.
    #[must_use]
    pub const fn has_ended(&self) -> bool {
        self.ended
    }

    /// Why the engine holds, where it does.
    #[must_use]
    pub fn holding(&self) -> Option<&str> {
        self.manager.holding()
    }

    /// Set to interrupt running evaluations between episodes.
    #[must_use]
    pub fn cancel(&self) -> Arc<AtomicBool> {
        self.manager.cancel()
    }

    /// Where the store keeps what.
    #[must_use]
    pub fn layout(&self) -> &crate::registry::Layout {
        self.manager.ledger().store().layout()
    }
}
