//! `holdpoint cell serve`: the simulated cell as a process, over the cell protocol.

use std::io::{self, Write as _};
use std::path::Path;
use std::sync::Arc;

use clap::Args;
use holdpoint_cell::CellSource as _;
use holdpoint_cellwire::{CellServer, Endpoint, ServerOptions};
use serde::Serialize;

use crate::cells::CELLS;
use crate::cli::output::CommandOutput;
use crate::error::{CliError, Exit};
use holdpoint_text::{ErrorReason, Untrusted};

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
        // Without a reader nothing is told; the cell works on.
        let _ = writeln!(io::stderr().lock(), "{}", Untrusted::new(text).line());
    });
    let spec = Arc::clone(factory.spec());
    let served = ServedCell { endpoint, robot: &spec.robot.name, build: factory.build_digest() };
    out.answer(&served, |out| {
        let robot = Untrusted::new(served.robot).line();
        out.line(&format!("the cell of {robot} listens at {}", served.endpoint))
    })?;
    out.flush()?;
    let options = ServerOptions { notes, ..ServerOptions::default() };
    let server = Arc::new(CellServer::new(Arc::clone(&factory), options).map_err(CliError::internal)?);
    server.run(&listener).map_err(CliError::internal)?;
    Ok(Exit::Confirmed)
}
