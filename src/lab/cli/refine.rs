//! `holdpoint-lab refine`: arguments, progress on the standard error, and the printed report.
//!
//! Searches and judges nothing: [`crate::parameter_search`] searches, and the pipeline judges the registered
//! candidate.

use std::io::{IsTerminal as _, Write as _};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use holdpoint_body::TaskKind;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use tokio::signal::unix::{SignalKind, signal};
use tokio_util::sync::CancellationToken;

use super::{jobs_or_cores, table};
use crate::parameter_search::search::SearchProgress;
use crate::parameter_search::settings::{EPISODES_MAX, GENERATIONS_MAX, RefineError, SearchSettings};
use crate::parameter_search::{RefineReport, refine};
use crate::wording::answers;
use holdpoint::cli::output::CommandOutput;
use holdpoint::cli::run::JOBS_MAX;
use holdpoint::error::{CliError, Exit};
use holdpoint_text::ErrorReason;

/// The interval between updates of the bar.
const DRAW_EVERY: Duration = Duration::from_millis(200);

/// The arguments of `refine`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
The search sees whether undisturbed episodes succeed, and how long they take. It sees no
violation, no anomaly and no recovery; the pipeline measures those.
To continue an interrupted search, give the same command again.

Examples:
  holdpoint-lab refine grasp --out candidates
  holdpoint-lab refine align --generations 20 --episodes 16 --seed 3 --out candidates --json")]
pub struct RefineArgs {
    /// The family whose baseline the search improves.
    #[arg(value_parser = families())]
    pub family: TaskKind,
    /// Generations of the search.
    #[arg(long, value_name = "N", default_value_t = 20,
          value_parser = clap::value_parser!(u32).range(1..=i64::from(GENERATIONS_MAX)))]
    pub generations: u32,
    /// Episodes for each set of parameters.
    #[arg(long, value_name = "N", default_value_t = 12,
          value_parser = clap::value_parser!(u32).range(1..=i64::from(EPISODES_MAX)))]
    pub episodes: u32,
    /// Seed; the same arguments and the same seed give the same candidate.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u32,
    /// Episodes simulated at once [default: one per core]; the candidate is the same for any number.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=i64::from(JOBS_MAX)))]
    pub jobs: Option<u16>,
    /// The folder that gets FAMILY-refined; nothing is overwritten.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// The candidate's version [default: the baseline's next minor one].
    #[arg(long, value_name = "X.Y.Z")]
    pub version: Option<semver::Version>,
}

/// The families that perform a task.
fn families() -> impl TypedValueParser<Value = TaskKind> {
    PossibleValuesParser::new(TaskKind::ALL.map(TaskKind::name))
        .try_map(|name| TaskKind::named(&name).ok_or_else(|| format!("no task has the name {name:?}")))
}

/// Searches, shows the progress, and prints the result.
///
/// # Errors
/// [`CliError`]: 2 for an error in arguments or files, 3 if it was interrupted or found nothing better.
pub fn run(args: &RefineArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let settings = SearchSettings {
        task: args.family,
        generations: args.generations,
        episodes: args.episodes,
        seed: args.seed,
        jobs: jobs_or_cores(args.jobs).clamp(1, usize::from(JOBS_MAX)),
        out: &args.out,
        version: args.version.clone(),
    };
    let interrupts = Interrupts::take()?;
    let mut teller = ProgressReporter::new();
    let report = refine(&settings, &interrupts.raised, &mut |progress| teller.report(progress));
    teller.finish();
    let report = report.map_err(error)?;
    out.answer(&report, |out| show(&report, out))?;
    Ok(Exit::Confirmed)
}

fn error(error: RefineError) -> CliError {
    match error {
        RefineError::Interrupted { .. } | RefineError::NothingBetter { .. } => {
            CliError::from_engine_fault(error)
        }
        RefineError::Setting { .. }
        | RefineError::Exists(_)
        | RefineError::Io { .. }
        | RefineError::JournalTooLarge { .. } => CliError::usage(error),
        RefineError::NoBaseline(_)
        | RefineError::Package(_)
        | RefineError::Native(_)
        | RefineError::Edit { .. }
        | RefineError::Profile(_)
        | RefineError::Policy(_)
        | RefineError::Sim(_)
        | RefineError::Work(_)
        | RefineError::Optimizer(_) => CliError::fault(error),
    }
}

fn show(report: &RefineReport, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    answers::refined(report).iter().try_for_each(|line| out.line(line))?;
    out.line("")?;
    let mut table = table(answers::REFINE_COLUMNS);
    for change in &report.changes {
        table.row([change.parameter.to_owned(), change.before.to_string(), change.after.to_string()]);
    }
    out.table(&table)?;
    out.line("")?;
    answers::after_search(report).iter().try_for_each(|line| out.line(line))
}

/// Shows the progress on standard error: a bar on a terminal, else a line for each generation.
struct ProgressReporter {
    bar: Option<ProgressBar>,
    began: Instant,
}

impl ProgressReporter {
    fn new() -> Self {
        let began = Instant::now();
        let bar = std::io::stderr().is_terminal().then(|| {
            let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr());
            if let Ok(style) = ProgressStyle::with_template("{bar:24} {msg}") {
                bar.set_style(style.progress_chars("=> "));
            }
            bar.enable_steady_tick(DRAW_EVERY);
            bar
        });
        Self { bar, began }
    }

    fn report(&mut self, progress: &SearchProgress) {
        let line = answers::search(progress, self.began.elapsed());
        match &self.bar {
            Some(bar) => {
                bar.set_length(progress.episodes_total);
                bar.set_position(progress.episodes_done);
                bar.set_message(line);
            }
            None if progress.generation_ended => {
                // A closed progress stream does not stop the search.
                drop(writeln!(std::io::stderr().lock(), "{line}"));
            }
            None => {}
        }
    }

    fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

/// Handles the signals to end: the search then ends between two episodes.
struct Interrupts {
    raised: Arc<AtomicBool>,
    stop: CancellationToken,
    thread: Option<JoinHandle<()>>,
}

impl Interrupts {
    fn take() -> Result<Self, CliError> {
        let raised = Arc::new(AtomicBool::new(false));
        let stop = CancellationToken::new();
        let thread = Self::listen(&raised, &stop).map_err(|error| {
            let text = format!("cannot handle the signals to end: {error}");
            CliError::usage(text).with_details(ErrorReason::Environment)
        })?;
        Ok(Self { raised, stop, thread: Some(thread) })
    }

    fn listen(raised: &Arc<AtomicBool>, stop: &CancellationToken) -> std::io::Result<JoinHandle<()>> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_io().build()?;
        {
            let _inside = runtime.enter();
            for kind in [SignalKind::terminate(), SignalKind::interrupt(), SignalKind::hangup()] {
                let (raised, mut signal) = (Arc::clone(raised), signal(kind)?);
                runtime.spawn(async move {
                    while signal.recv().await.is_some() {
                        raised.store(true, Ordering::Release);
                    }
                });
            }
        }
        let stop = stop.clone();
        std::thread::Builder::new()
            .name("interrupts".to_owned())
            .spawn(move || runtime.block_on(stop.cancelled()))
    }
}

impl Drop for Interrupts {
    fn drop(&mut self) {
        self.stop.cancel();
        if let Some(thread) = self.thread.take() {
            drop(thread.join());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parameter_search::objective::Score;

    #[test]
    fn a_line_shows_progress_and_time_left() {
        let score = Score { episodes: 4, successes: 4, ticks: 4 * 480 };
        let progress = SearchProgress {
            generation: 2,
            generations: 8,
            generation_ended: true,
            baseline: score,
            best: score,
            episodes_done: 60,
            episodes_simulated: 20,
            episodes_total: 100,
        };
        for (progress, text) in [
            (
                progress,
                "generation 2 of 8: best 4/4 done in 2.00 s, 60 of 100 episodes, 10 s, at most 20 s left",
            ),
            (
                SearchProgress {
                    episodes_simulated: 0,
                    best: Score { successes: 0, ticks: 0, ..score },
                    ..progress
                },
                "generation 2 of 8: best 0/4 done, 60 of 100 episodes, 10 s",
            ),
        ] {
            assert_eq!(answers::search(&progress, Duration::from_secs(10)), text);
        }
    }
}
