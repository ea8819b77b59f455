//! `holdpoint schema`: the JSON schemas of what goes over the socket, made from the types that are sent.

use clap::Args;
use clap::builder::PossibleValuesParser;
use holdpoint_protocol::schema;
use serde_json::{Map, Value};

use crate::cli::output::Output;
use crate::error::{CliError, Exit};

/// The arguments of `schema`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint schema event
  holdpoint schema > holdpoint-schemas.json")]
pub struct SchemaArgs {
    /// The document to print. Without it all of them are, each under its name.
    #[arg(value_parser = PossibleValuesParser::new(schema::NAMES))]
    pub document: Option<String>,
}

/// Prints one schema, or an object of all of them; with `--json` on one line.
///
/// # Errors
/// If the output cannot be written.
pub fn run(args: &SchemaArgs, out: &mut Output<'_>) -> Result<Exit, CliError> {
    let documents =
        schema::documents().into_iter().map(|(name, schema)| (name.to_owned(), schema.to_value()));
    let mut documents: Map<String, Value> = documents.collect();
    let answer = match &args.document {
        Some(name) => documents.remove(name).unwrap_or_default(),
        None => documents.into(),
    };
    out.answer(&answer, |out| {
        let text = serde_json::to_string_pretty(&answer).map_err(CliError::internal)?;
        // JSON has no control characters outside its own line ends, which must stay.
        Ok(writeln!(out.sink(), "{text}")?)
    })?;
    Ok(Exit::Confirmed)
}
