//! `holdpoint schema`: the JSON schemas of the socket's messages, generated from the types.

use clap::Args;
use clap::builder::PossibleValuesParser;
use holdpoint_protocol::schema;
use serde_json::{Map, Value};

use crate::cli::output::CommandOutput;
use crate::error::{CliError, Exit};

/// The arguments of `schema`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint schema event
  holdpoint schema > holdpoint-schemas.json")]
pub struct SchemaArgs {
    /// The document to print [default: all, each under its name].
    #[arg(value_parser = PossibleValuesParser::new(schema::NAMES))]
    pub document: Option<String>,
}

/// Prints one schema, or an object of all of them; with `--json` on one line.
///
/// # Errors
/// If the output cannot be written.
pub fn run(args: &SchemaArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let documents =
        schema::documents().into_iter().map(|(name, schema)| (name.to_owned(), schema.to_value()));
    let mut documents: Map<String, Value> = documents.collect();
    let answer = match &args.document {
        Some(name) => documents.remove(name).unwrap_or_default(),
        None => documents.into(),
    };
    out.answer(&answer, |out| {
        let text = serde_json::to_string_pretty(&answer).map_err(CliError::internal)?;
        // JSON has no control characters but its own line ends, which stay.
        Ok(writeln!(out.sink(), "{text}")?)
    })?;
    Ok(Exit::Confirmed)
}
