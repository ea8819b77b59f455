//! `holdpoint cell serve | check`: the simulated cell as a process, and any such process against the cell protocol.

use std::io::{self, Write as _};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use clap::Args;
use holdpoint_cell::CellSource as _;
use holdpoint_cellwire::check::{check as check_cell, measure};
use holdpoint_cellwire::client::Connect;
use holdpoint_cellwire::framing::WireStream;
use holdpoint_cellwire::{CellServer, Endpoint, ServerOptions};
use serde::Serialize;

use crate::cells::CELLS;
use crate::cli::output::CommandOutput;
use crate::error::{CliError, Exit};
use holdpoint_text::{ErrorReason, Untrusted};
use holdpoint_wording::program::cell as sentences;
use holdpoint_wording::program::cell_promise::cell_promise;

/// The arguments of `cell serve`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Runs until a signal ends it. Prints a line for each arm that it stops by itself.

Examples:
  holdpoint cell serve --listen unix:/run/holdpoint/cell.sock
  holdpoint cell serve --listen tcp:127.0.0.1:7001 --robot arm6")]
pub struct CellServeArgs {
    /// Where it listens: `unix:PATH`, or `tcp:ADDRESS:PORT` with an address of this machine.
    #[arg(long, value_name = "ENDPOINT")]
    pub listen: Endpoint,
    /// The robot: a built-in one by its name, or a URDF file [default: arm7].
    #[arg(long, value_name = "NAME|FILE")]
    pub robot: Option<String>,
}

/// The arguments of `cell check`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Moves the arms of the cell, the live one, too. Exits with 1 if a promise is broken.

Example:
  holdpoint cell check unix:/run/holdpoint/cell.sock")]
pub struct CellCheckArgs {
    /// Where the cell listens: `unix:PATH` or `tcp:ADDRESS:PORT`.
    #[arg(value_name = "ENDPOINT")]
    pub endpoint: Endpoint,
}

/// What a served cell tells first.
#[derive(Serialize)]
struct ServedCell<'a> {
    endpoint: String,
    robot: &'a str,
    build: &'a str,
}

/// Serves until the listener fails.
///
/// # Errors
/// [`CliError::Usage`] for a robot that cannot be read, or an endpoint that cannot be listened at.
pub fn serve(args: &CellServeArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let factory = match args.robot.as_deref() {
        Some(robot) if Path::new(robot).extension().is_some_and(|own| own == "urdf") => {
            CELLS.load(Path::new(robot))
        }
        robot => CELLS.builtin(robot),
    };
    let factory =
        factory.map_err(|error| CliError::usage(error.to_string()).with_details(ErrorReason::BadFile))?;
    let refused = |error: io::Error| {
        CliError::usage(format!("cannot listen at {}: {error}", args.listen))
            .with_hint("name another endpoint, or end the process that listens there")
            .with_details(ErrorReason::BadFile)
    };
    let listener = args.listen.listen().map_err(refused)?;
    let endpoint = listener.endpoint().map_err(refused)?.to_string();
    let notes = Box::new(|text: &str| {
        // Without a reader the notes are lost, and the cell works on.
        let _ = writeln!(io::stderr().lock(), "{}", Untrusted::new(text).line());
    });
    let spec = Arc::clone(factory.spec());
    let served = ServedCell { endpoint, robot: &spec.robot.name, build: factory.build_digest() };
    out.answer(&served, |out| {
        let robot = Untrusted::new(served.robot).line();
        out.line(&sentences::listens(robot, &served.endpoint))
    })?;
    out.flush()?;
    let options = ServerOptions { notes, ..ServerOptions::default() };
    let server = Arc::new(CellServer::new(Arc::clone(&factory), options).map_err(CliError::internal)?);
    server.run(&listener).map_err(CliError::internal)?;
    Ok(Exit::Confirmed)
}

/// Whether a cell keeps the protocol.
#[derive(Serialize)]
struct CheckedCell {
    endpoint: String,
    promises: Vec<CheckedPromise>,
    exchange: Option<CheckedExchange>,
}

#[derive(Serialize)]
struct CheckedPromise {
    promise: &'static str,
    /// What is wrong; absent where it is kept.
    #[serde(skip_serializing_if = "Option::is_none")]
    problem: Option<String>,
}

/// The time of one exchange of a tick, with what the cell computes.
#[derive(Serialize)]
struct CheckedExchange {
    ticks: usize,
    p50_us: u64,
    p99_us: u64,
    max_us: u64,
    overruns: usize,
}

/// Within this time a cell has to take a connection.
const CONNECT_WITHIN: Duration = Duration::from_secs(5);

fn connection(endpoint: &Endpoint) -> Connect {
    let endpoint = endpoint.clone();
    Box::new(move || -> io::Result<Box<dyn WireStream>> { Ok(Box::new(endpoint.connect(CONNECT_WITHIN)?)) })
}

/// Checks a cell, one line for each promise.
///
/// # Errors
/// [`CliError::Usage`] if no process listens at the endpoint.
pub fn check(args: &CellCheckArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let endpoint = &args.endpoint;
    endpoint.connect(CONNECT_WITHIN).map_err(|error| {
        CliError::usage(format!("no cell listens at {endpoint}: {error}"))
            .with_hint("start it first, e.g. with `holdpoint cell serve --listen ENDPOINT`")
            .with_details(ErrorReason::BadFile)
    })?;
    let verdicts = check_cell(connection(endpoint));
    let times = measure(connection(endpoint)).ok();
    let promises = verdicts.into_iter().map(|verdict| CheckedPromise {
        promise: cell_promise(verdict.promise),
        problem: verdict.problem.map(|problem| Untrusted::new(problem).line().to_string()),
    });
    let checked = CheckedCell {
        endpoint: endpoint.to_string(),
        promises: promises.collect(),
        exchange: times.map(|times| CheckedExchange {
            ticks: times.ticks,
            p50_us: times.p50_us,
            p99_us: times.p99_us,
            max_us: times.max_us,
            overruns: times.overruns,
        }),
    };
    let broken = checked.promises.iter().filter(|promise| promise.problem.is_some()).count();
    out.answer(&checked, |out| {
        for CheckedPromise { promise, problem } in &checked.promises {
            out.line(&sentences::checked_promise(promise, problem.as_deref()))?;
        }
        if let Some(exchange) = &checked.exchange {
            let CheckedExchange { ticks, p50_us, p99_us, max_us, overruns } = exchange;
            out.line(&sentences::exchange_times(*ticks, [*p50_us, *p99_us, *max_us], *overruns))?;
        }
        out.line(&sentences::broken_promises(broken, checked.promises.len()))
    })?;
    Ok(if broken == 0 { Exit::Confirmed } else { Exit::Rejected })
}
