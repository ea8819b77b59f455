//! Runs a candidate in trial cells before its submission: no store, no record, no decision.
//!
//! Runs episodes of the sandbox with the guard and envelope of the least strict profile, beside the baseline. The results are
//! for the author of the skill.

use holdpoint_governance::mode::UnknownZone;
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_protocol::film::{Film, FilmRefusal, FilmSubject, FilmedRun};
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::skill::Skill;
use holdpoint_runtime::task::TaskRecord;
use holdpoint_runtime::terms::SkillTerms;
use holdpoint_text::Hint as _;
use holdpoint_trials::cell::{Cell, Conditions};
use holdpoint_trials::episodes::{alone, alone_with};
use holdpoint_trials::tick_time::median_tick_us;
use holdpoint_trials::undisturbed_run::TrialCase;
use holdpoint_trials::unoffered_sensor::UnofferedSensor;
use holdpoint_trials::worker::Worker;

use crate::episode_replay::film_render::FilmedWork;
use holdpoint_record::check::{CheckError, RegisteredVersions, UnknownFamily};
use holdpoint_record::context::Context;
use holdpoint_record::evidence_binding::terms_under;
use holdpoint_trials::cell_frame;

/// Why a candidate cannot be tried.
#[derive(Debug, thiserror::Error)]
pub enum TryoutError {
    /// The cell has no baseline of its family.
    #[error(transparent)]
    Family(#[from] UnknownFamily),
    /// Its manifest names a zone that the cell does not have.
    #[error(transparent)]
    Zone(#[from] UnknownZone),
    /// It asks for a sensor that the cell does not offer.
    #[error(transparent)]
    Sensor(#[from] UnofferedSensor),
    /// A baseline does not load.
    #[error(transparent)]
    Check(#[from] CheckError),
    /// An embedded profile or its policies are invalid.
    #[error("{0}")]
    BuiltIn(String),
}

/// Wraps the code of a run.
pub type SkillWrapper<'a> = dyn FnMut(Box<dyn Skill>) -> Box<dyn Skill> + 'a;

/// A candidate, the version beside it, and their cell.
pub struct Tryout {
    context: Context,
    candidate: Capability,
    active: Capability,
}

impl Tryout {
    /// A candidate beside the baseline of its family, in a cell and of its site.
    ///
    /// # Errors
    /// [`TryoutError`].
    pub fn new(candidate: Capability, cell: Cell) -> Result<Self, TryoutError> {
        if let Some(unknown) = candidate.manifest.unknown_zone("manifest.toml", &cell.zones) {
            return Err(unknown.into());
        }
        if let Some(unoffered) = UnofferedSensor::of(&candidate, &cell.spec) {
            return Err(unoffered.into());
        }
        let family = candidate.id().family;
        let versions = RegisteredVersions::commissioned(cell.site.as_deref())?;
        let Some(active) = versions.active(&family).cloned() else {
            return Err(match versions.unknown_family(&candidate, "manifest.toml") {
                Some(unknown) => unknown.into(),
                None => TryoutError::BuiltIn(format!("the family {family} has no first version")),
            });
        };
        let built_in = |error: String| TryoutError::BuiltIn(error);
        let profile = Profile::builtin(ProfileName::Sim).map_err(|error| built_in(error.sentence()))?;
        let table = PolicyTable::builtin(&profile).map_err(|error| built_in(error.sentence()))?;
        let context =
            Context::new(profile, table, None, cell).map_err(|error| built_in(error.to_string()))?;
        Ok(Self { context, candidate, active })
    }

    /// The candidate.
    #[must_use]
    pub const fn candidate(&self) -> &Capability {
        &self.candidate
    }

    /// The version beside it.
    #[must_use]
    pub const fn active(&self) -> &Capability {
        &self.active
    }

    /// The robot's name.
    #[must_use]
    pub fn robot(&self) -> &str {
        &self.context.cell.spec.robot.name
    }

    /// One episode of the candidate, with its code wrapped.
    #[must_use]
    pub fn run_episode(&self, worker: &mut Worker, seed: u64, around: &mut SkillWrapper<'_>) -> TaskRecord {
        let (terms, version) = (self.terms(), &self.candidate);
        let (cell, conditions) = (&self.context.cell, Conditions::Sandbox);
        alone_with(worker, TrialCase { cell, terms: &terms, version, conditions, seed }, around)
    }

    /// Processor time of the candidate's median tick, us; `None` for a controller that is compiled in, and if no tick ran.
    #[must_use]
    pub fn median_tick_us(&self) -> Option<f64> {
        median_tick_us(&self.context.cell, &self.terms(), &self.candidate)
    }

    fn terms(&self) -> SkillTerms {
        terms_under(&self.context, &self.candidate, &[])
    }

    /// Films one episode of both.
    ///
    /// # Errors
    /// [`FilmRefusal::CellCannotFilm`] if the cell keeps no frames.
    pub fn film(&self, seed: u64) -> Result<Film, FilmRefusal> {
        if !self.context.cell.spec.abilities.film {
            return Err(FilmRefusal::CellCannotFilm);
        }
        let [candidate, active] = [&self.candidate, &self.active].map(|version| self.filmed(version, seed));
        Ok(Film {
            of: FilmSubject::Episode,
            number: 1,
            count: 1,
            beyond: 0,
            task: self.candidate.bundle.task(),
            seed,
            drill: None,
            phase: None,
            why: String::new(),
            doubts: Vec::new(),
            scenery: cell_frame::scenery(&self.context.cell.scene),
            candidate,
            active,
        })
    }

    fn filmed(&self, version: &Capability, seed: u64) -> FilmedRun {
        let terms = terms_under(&self.context, version, &[]);
        let (mut worker, cell) = (Worker::filming(), &self.context.cell);
        let trial = TrialCase { cell, terms: &terms, version, conditions: Conditions::Sandbox, seed };
        let done = alone(&mut worker, trial);
        let limits = &self.context.profile.harm;
        FilmedWork { version, terms: &terms, cell, limits, as_recorded: None }.episode(&mut worker, &done)
    }
}
