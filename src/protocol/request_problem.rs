//! What a request has that no request may have, so that its client is answered with the field, its value and what is allowed.
//!
//! The types decide whether a request is valid, and their parser names no field in a tagged document. So this module
//! compares a refused document with the published schema, and names the first difference. It refuses nothing itself.

use std::fmt;
use std::sync::LazyLock;

use schemars::schema_for;
use serde_json::{Map, Value};

use super::wire::ClientMessage;

/// The most characters of a name or a value that are quoted.
const QUOTED_MAX: usize = 80;

static SCHEMA: LazyLock<Value> = LazyLock::new(|| schema_for!(ClientMessage).to_value());

/// The first difference of a request from the schema. A field is named by its place: `request.command.stage`.
#[derive(Clone, Debug, PartialEq, Eq)]
enum RequestProblem {
    UnknownField { field: String, allowed: Vec<String> },
    MissingField { field: String },
    Value { field: String, value: String, allowed: Vec<String> },
}

impl fmt::Display for RequestProblem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::UnknownField { field, allowed } => {
                write!(f, "the field {field:?} is unknown; allowed: {}", allowed.join(", "))
            }
            Self::MissingField { field } => write!(f, "the field {field:?} is missing"),
            Self::Value { field, value, allowed } => write!(
                f,
                "the field {field:?} has the value {value}, which is not allowed; allowed: {}",
                allowed.join(", ")
            ),
        }
    }
}

/// Why a line that asks the engine for something is no request, as one sentence; `None` if the line asks nothing. `error`
/// is the parser's, for what the schema does not tell.
#[must_use]
pub fn request_problem(line: &[u8], error: &serde_json::Error) -> Option<String> {
    let document: Value = serde_json::from_slice(line).ok()?;
    if document.get("call").and_then(Value::as_str) != Some("ask") {
        return None;
    }
    let problem = difference(&document, &SCHEMA, "");
    Some(problem.map_or_else(|| format!("this is no request: {error}"), |problem| problem.to_string()))
}

fn difference(value: &Value, schema: &Value, field: &str) -> Option<RequestProblem> {
    let schema = resolved(schema);
    if let Some(alternatives) = schema.get("oneOf").or_else(|| schema.get("anyOf")).and_then(Value::as_array)
    {
        return among(value, alternatives, field);
    }
    let names = constants(schema).unwrap_or_default();
    if !names.is_empty() {
        return (!names.contains(&value)).then(|| not_allowed(field, value, &names));
    }
    let types = types(schema);
    if !types.is_empty() && !types.iter().any(|name| is_of_type(value, name)) {
        let allowed = types.into_iter().map(str::to_owned).collect();
        return Some(RequestProblem::Value { field: field.to_owned(), value: quoted(value), allowed });
    }
    match value {
        Value::Object(fields) => in_object(fields, schema, field),
        Value::Array(items) => {
            let of = schema.get("items")?;
            items
                .iter()
                .enumerate()
                .find_map(|(place, item)| difference(item, of, &join(field, &place.to_string())))
        }
        Value::Null | Value::Bool(_) | Value::Number(_) | Value::String(_) => None,
    }
}

/// The schema that a reference names, or the schema itself.
fn resolved(schema: &Value) -> &Value {
    let path = schema.get("$ref").and_then(Value::as_str).and_then(|path| path.strip_prefix('#'));
    path.and_then(|path| SCHEMA.pointer(path)).unwrap_or(schema)
}

/// The difference from the alternative that is meant: by its tag, or the only one beside null.
fn among(value: &Value, alternatives: &[Value], field: &str) -> Option<RequestProblem> {
    let all: Vec<&Value> = alternatives.iter().map(resolved).collect();
    let meant: Vec<&Value> = all.iter().copied().filter(|one| types(one) != ["null"]).collect();
    if value.is_null() && meant.len() < all.len() {
        return None;
    }
    let names: Option<Vec<Vec<&Value>>> = meant.iter().map(|one| constants(one)).collect();
    if let Some(names) = names.map(|names| names.concat()) {
        return (!names.contains(&value)).then(|| not_allowed(field, value, &names));
    }
    let Some(tag) = tag(&meant) else {
        return if let [one] = meant.as_slice() { difference(value, one, field) } else { None };
    };
    let tags: Vec<&Value> = meant.iter().filter_map(|one| constant(one, tag)).collect();
    let tag_field = join(field, tag);
    match value.get(tag) {
        None => Some(RequestProblem::MissingField { field: tag_field }),
        Some(given) => match meant.iter().find(|one| constant(one, tag) == Some(given)) {
            Some(one) => difference(value, one, field),
            None => Some(not_allowed(&tag_field, given, &tags)),
        },
    }
}

fn in_object(fields: &Map<String, Value>, schema: &Value, field: &str) -> Option<RequestProblem> {
    let properties = schema.get("properties").and_then(Value::as_object)?;
    let is_closed = schema.get("additionalProperties") == Some(&Value::Bool(false));
    for (name, value) in fields {
        let field = join(field, name);
        match properties.get(name) {
            Some(of) => {
                if let Some(problem) = difference(value, of, &field) {
                    return Some(problem);
                }
            }
            None if is_closed => {
                return Some(RequestProblem::UnknownField {
                    field,
                    allowed: properties.keys().cloned().collect(),
                });
            }
            None => {}
        }
    }
    let required = schema.get("required").and_then(Value::as_array);
    let mut names = required.into_iter().flatten().filter_map(Value::as_str);
    let missing = names.find(|name| !fields.contains_key(*name))?;
    Some(RequestProblem::MissingField { field: join(field, missing) })
}

/// The names that a schema lists; `None` if it lists none.
fn constants(schema: &Value) -> Option<Vec<&Value>> {
    let one = schema.get("const").map(|one| vec![one]);
    one.or_else(|| Some(schema.get("enum")?.as_array()?.iter().collect()))
}

/// The field that tells the alternatives apart.
fn tag<'a>(alternatives: &[&'a Value]) -> Option<&'a str> {
    let properties = alternatives.first()?.get("properties")?.as_object()?;
    let is_tag = |name: &str| alternatives.iter().all(|one| constant(one, name).is_some());
    properties.keys().map(String::as_str).find(|name| is_tag(name))
}

/// The value that a schema prescribes for a field.
fn constant<'a>(schema: &'a Value, name: &str) -> Option<&'a Value> {
    schema.get("properties")?.get(name)?.get("const")
}

/// The types that a schema names; none if it leaves the type open.
fn types(schema: &Value) -> Vec<&str> {
    match schema.get("type") {
        Some(Value::String(name)) => vec![name],
        Some(Value::Array(names)) => names.iter().filter_map(Value::as_str).collect(),
        Some(_) | None => Vec::new(),
    }
}

fn is_of_type(value: &Value, name: &str) -> bool {
    match name {
        "null" => value.is_null(),
        "boolean" => value.is_boolean(),
        "integer" => value.is_i64() || value.is_u64(),
        "number" => value.is_number(),
        "string" => value.is_string(),
        "array" => value.is_array(),
        "object" => value.is_object(),
        _ => true,
    }
}

fn not_allowed(field: &str, value: &Value, names: &[&Value]) -> RequestProblem {
    let allowed = names.iter().map(|name| name.as_str().map_or_else(|| name.to_string(), str::to_owned));
    RequestProblem::Value { field: field.to_owned(), value: quoted(value), allowed: allowed.collect() }
}

fn quoted(value: &Value) -> String {
    shortened(&value.to_string())
}

fn shortened(text: &str) -> String {
    match text.char_indices().nth(QUOTED_MAX) {
        Some((end, _)) => format!("{}…", text.get(..end).unwrap_or_default()),
        None => text.to_owned(),
    }
}

fn join(field: &str, name: &str) -> String {
    let name = shortened(name);
    if field.is_empty() { name } else { format!("{field}.{name}") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    /// The answer to a document that is no request.
    fn answer(document: &Value) -> Option<String> {
        let line = document.to_string();
        let error = serde_json::from_str::<ClientMessage>(&line).expect_err("it is no call");
        request_problem(line.as_bytes(), &error)
    }

    fn ask(command: Value) -> Value {
        json!({ "call": "ask", "request": { "id": "a", "command": command } })
    }

    fn operation() -> Value {
        json!({ "version": "grasp@1.1.0", "by": "ana", "reason": "a try" })
    }

    fn problem(document: &Value) -> Option<RequestProblem> {
        difference(document, &SCHEMA, "")
    }

    #[test]
    fn the_field_its_value_and_what_is_allowed_are_named() {
        for (command, field, value, allowed) in [
            (json!({ "command": "open-the-gate" }), "command", "open-the-gate", "snapshot"),
            (
                json!({ "command": "demote", "operation": operation(), "profiles": ["sim", "warehouse"] }),
                "profiles.1",
                "warehouse",
                "human",
            ),
            (
                json!({ "command": "repeat", "operation": operation(), "stage": "gate" }),
                "stage",
                "gate",
                "sandbox",
            ),
            (
                json!({ "command": "shelve-alarm", "alarm": "a", "by": "b", "for_ms": "soon", "reason": "c" }),
                "for_ms",
                "soon",
                "integer",
            ),
            (json!({ "command": "live-fault", "fault": "fire" }), "fault", "fire", "telemetry-lost"),
        ] {
            let found = problem(&ask(command));
            let Some(RequestProblem::Value { field: place, value: given, allowed: known }) = &found else {
                panic!("{field}: {found:?}")
            };
            assert_eq!((place, given), (&format!("request.command.{field}"), &format!("{value:?}")));
            assert!(known.iter().any(|name| name == allowed), "{field}: {known:?}");
        }
        for (command, field, allowed) in [
            (json!({ "command": "pace", "times": 1.0, "surprise": 1 }), "surprise", "times"),
            (json!({ "command": "snapshot", "surprise": 1 }), "surprise", "command"),
            (
                json!({ "command": "pause", "version": "grasp@1.1.0", "by": "ana", "why": "x" }),
                "why",
                "reason",
            ),
        ] {
            let found = problem(&ask(command));
            let Some(RequestProblem::UnknownField { field: place, allowed: known }) = &found else {
                panic!("{field}: {found:?}")
            };
            assert_eq!(place, &format!("request.command.{field}"));
            assert!(known.iter().any(|name| name == allowed), "{field}: {known:?}");
        }
        for (document, field) in [
            (json!({ "call": "ask", "request": { "command": { "command": "snapshot" } } }), "request.id"),
            (json!({ "call": "ask" }), "request"),
        ] {
            assert_eq!(problem(&document), Some(RequestProblem::MissingField { field: field.to_owned() }));
        }
    }

    #[test]
    fn the_answer_names_the_difference_or_what_the_parser_found() {
        let unknown = ask(json!({ "command": "snapshot", "surprise": 1 }));
        assert_eq!(answer(&unknown), problem(&unknown).map(|problem| problem.to_string()));
        let untold = ask(json!({ "command": "detail", "version": "grasp" }));
        assert_eq!(problem(&untold), None);
        assert!(answer(&untold).is_some());
    }

    #[test]
    fn a_line_that_asks_nothing_has_no_answer() {
        assert_eq!(answer(&json!({ "call": "subscribe", "surprise": 1 })), None);
        assert_eq!(answer(&json!({})), None);
        let error = serde_json::from_str::<ClientMessage>("?").unwrap_err();
        assert_eq!(request_problem(b"?", &error), None);
    }

    #[test]
    fn long_names_and_values_are_shortened() {
        let long = "x".repeat(100_000);
        for (command, most) in
            [(json!({ "command": "snapshot", &long: 1 }), 1_000), (json!({ "command": long }), 2_000)]
        {
            let text = answer(&ask(command)).unwrap();
            assert!(text.len() < most, "{}", text.len());
        }
    }

    /// A request that the types accept differs from the schema in nothing.
    #[test]
    fn valid_requests_have_no_problem() {
        for command in [
            json!({ "command": "snapshot" }),
            json!({ "command": "pause", "version": "grasp@1.1.0", "by": "ana", "reason": "a try" }),
            json!({ "command": "drift", "kind": null, "magnitude": "" }),
            json!({ "command": "pace", "times": null }),
            json!({ "command": "pace", "times": 2 }),
            json!({ "command": "audit", "before": null, "subject": "", "limit": 5 }),
            json!({ "command": "demote", "operation": operation(), "profiles": ["human"] }),
        ] {
            let document = ask(command);
            assert!(serde_json::from_value::<ClientMessage>(document.clone()).is_ok(), "{document}");
            assert_eq!(difference(&document, &SCHEMA, ""), None, "{document}");
        }
    }
}
