//! `holdpoint store rebuild`: mends a store that no engine has open.

use clap::{Args, Subcommand};

use super::audit;
use crate::cli::context::CliContext;
use crate::cli::output::Output;
use crate::error::{CliError, Exit};
use holdpoint_engine::caller;
use holdpoint_registry::{Rebuilt, rebuild};

/// The arguments of `store`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Example:
  holdpoint store rebuild --from-chain")]
pub struct StoreArgs {
    /// The verb that was given, with its arguments.
    #[command(subcommand)]
    pub verb: StoreVerb,
}

/// What can be done with a store.
#[derive(Clone, Debug, PartialEq, Eq, Subcommand)]
pub enum StoreVerb {
    /// Makes the tables anew, keeps the damaged file beside them, and puts both on record.
    #[command(after_help = "\
What the chain cannot tell is refused by name, and nothing is changed then. Evidence and signatures that are
lost are named; a version that rests on them has to be evaluated or approved again.

Example:
  holdpoint store rebuild --from-chain")]
    Rebuild {
        /// From the audit log, which has to be whole: there is no other source.
        #[arg(long, required = true)]
        from_chain: bool,
    },
}

/// Does what was asked for.
///
/// # Errors
/// [`CliError`]; the store is as it was then.
pub fn run(context: &CliContext, args: &StoreArgs, out: &mut Output<'_>) -> Result<Exit, CliError> {
    match &args.verb {
        StoreVerb::Rebuild { from_chain: _ } => {
            audit::database(&context.data)?;
            let by = serde_json::to_string(&caller::own()).map_err(CliError::internal)?;
            let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
            let wall_ms = since.ok().and_then(|since| i64::try_from(since.as_millis()).ok()).unwrap_or(0);
            let rebuilt = rebuild(&context.data, &by, wall_ms).map_err(CliError::usage)?;
            out.answer(&serde_json::json!({ "rebuilt": rebuilt }), |out| tell(rebuilt.as_ref(), out))?;
            Ok(Exit::Confirmed)
        }
    }
}

fn tell(rebuilt: Option<&Rebuilt>, out: &mut Output<'_>) -> Result<(), CliError> {
    let Some(rebuilt) = rebuilt else {
        return out.line("the tables are what the audit log says; nothing was done");
    };
    out.line(&format!("rebuilt from {} records; the damaged file is {}", rebuilt.from_seq, rebuilt.kept_as))?;
    out.line(&format!("first found: {}", rebuilt.problem))?;
    for row in &rebuilt.differed {
        let columns =
            if row.columns.is_empty() { String::new() } else { format!(" ({})", row.columns.join(", ")) };
        out.line(&format!("mended  {} {:?}: {}{columns}", row.table, row.key, row.problem))?;
    }
    for (table, key) in &rebuilt.lost {
        out.line(&format!("lost    a text of {table} {key:?}; a mark stands for it"))?;
    }
    Ok(())
}
