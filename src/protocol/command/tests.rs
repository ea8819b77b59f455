//! Commands in their written form: each one parses, and none with an unknown field.

use serde_json::{Value, json};

use crate::wire::ClientMessage;

fn call(command: &Value) -> Value {
    json!({ "call": "ask", "request": { "id": "r1", "command": command } })
}

fn read(call: &Value) -> Result<ClientMessage, serde_json::Error> {
    serde_json::from_str(&call.to_string())
}

/// A command of each kind, as a client writes it.
fn commands() -> Vec<Value> {
    let operation =
        |name: &str| json!({ "command": name, "version": "grasp@1.0.0", "by": "ana", "reason": "a test" });
    let mut all: Vec<Value> = [
        "reject",
        "rollback",
        "vacate",
        "pause",
        "resume",
        "restrict",
        "rearm",
        "anchor",
        "review-tries",
        "continue",
    ]
    .map(operation)
    .into();
    let about = json!({ "version": "grasp@1.0.0", "by": "ana", "reason": "a test" });
    all.extend([
        json!({ "command": "register", "name": "x",
            "package": { "manifest": "", "submission": "", "params": "" } }),
        json!({ "command": "demote", "operation": about, "profiles": [] }),
        json!({ "command": "release", "operation": about, "profiles": [] }),
        json!({ "command": "repeat", "operation": about, "stage": "sandbox" }),
        json!({ "command": "drift", "kind": null, "magnitude": "" }),
        json!({ "command": "live-fault", "fault": null }),
        json!({ "command": "acknowledge-alarm", "alarm": "x", "by": "ana" }),
        json!({ "command": "reset-alarm", "alarm": "x", "by": "ana", "reason": "r" }),
        json!({ "command": "shelve-alarm", "alarm": "x", "by": "ana", "for_ms": 1, "reason": "r" }),
        json!({ "command": "unshelve-alarm", "alarm": "x", "by": "ana" }),
        json!({ "command": "stop", "by": "", "reason": "" }),
        json!({ "command": "go", "by": "ana", "reason": "r", "since_ms": 1, "stops": 1 }),
        json!({ "command": "confirm-time", "by": "ana", "reason": "r", "time": "2026-01-01T00:00:00Z" }),
        json!({ "command": "note", "by": "ana", "text": "t" }),
        json!({ "command": "goal", "goal": "grasp", "by": "ana", "reason": "r" }),
        json!({ "command": "pace", "times": null }),
        json!({ "command": "detail", "version": "grasp@1.0.0" }),
        json!({ "command": "question", "version": "grasp@1.0.0", "purpose": "activation", "who": "ana" }),
        json!({ "command": "film", "version": "grasp@1.0.0", "asked": { "of": "drill", "number": 3 } }),
        json!({ "command": "registry", "group": "all", "text": "", "offset": 0, "limit": 1 }),
        json!({ "command": "audit", "before": null, "subject": "", "limit": 1 }),
        json!({ "command": "health", "asked": { "bucket_ms": 60000, "buckets": 1 } }),
        json!({ "command": "verify-audit" }),
        json!({ "command": "snapshot" }),
        json!({ "command": "shutdown" }),
        decision(),
        person(),
    ]);
    all
}

fn person() -> Value {
    let act = json!({ "act": "enrol", "name": "ben", "role": "engineer", "key": "", "unprotected": false,
        "by": "ana", "reason": "r", "store_id": "s", "follows": "a".repeat(64), "nonce": "b".repeat(32) });
    json!({ "command": "person", "signed": { "act": act, "public_key": "", "signature": "" } })
}

fn decision() -> Value {
    let digest = "a".repeat(64);
    let approval = json!({ "who": "ana", "role": "engineer", "decision": "approve", "reason": "r",
        "version": "grasp@1.0.0", "candidate_digest": digest, "row_version": 1, "evidence_digest": digest,
        "policy_digest": digest, "profile": "human", "store_id": "s", "nonce": "b".repeat(32),
        "not_after_ms": 1, "break_glass": false });
    let signed = json!({ "approval": approval, "public_key": "", "signature": "" });
    json!({ "command": "decide", "signed": signed })
}

/// Every command and its effect on authority.
#[test]
fn every_command_has_one_authority_class() {
    use super::{AuthorityEffect, Command};
    let classes = [
        (AuthorityEffect::Reads, "audit detail film health question registry snapshot verify-audit"),
        (AuthorityEffect::TakesAway, "demote pause reject restrict rollback shutdown stop vacate"),
        (
            AuthorityEffect::Gives,
            "anchor confirm-time continue drift go goal live-fault rearm register release repeat reset-alarm resume review-tries shelve-alarm",
        ),
        (AuthorityEffect::SignedItself, "decide person"),
        (AuthorityEffect::Neither, "acknowledge-alarm note pace unshelve-alarm"),
    ];
    let mut count = 0;
    for (class, names) in classes {
        for name in names.split(' ') {
            count += 1;
            let written = commands().into_iter().find(|command| command["command"] == name).unwrap();
            let command: Command = serde_json::from_value(written).unwrap();
            assert_eq!(command.authority_effect(), class, "{name}");
            assert_eq!(command.takes_authority_away(), class == AuthorityEffect::TakesAway, "{name}");
            assert_eq!(command.only_reads(), class == AuthorityEffect::Reads, "{name}");
            // The engine stops before it looks up any identity; a command that lets something continue names its
            // signer. A registration carries its signature; only the signature names the signer of a drift or a fault.
            let named_elsewhere = ["register", "drift", "live-fault"].contains(&name);
            let names_somebody = command.by().is_some() || named_elsewhere;
            assert!(class != AuthorityEffect::Gives || names_somebody, "{name}");
        }
    }
    assert_eq!(count, commands().len(), "one class for each");
}

/// The commands that a halted engine accepts beside queries, and those that wait for the end of a sequence.
#[test]
fn alarms_and_stops_are_harmless_and_changes_of_the_cell_wait() {
    use super::{Command, CommandFacts};
    let named = |fits: fn(CommandFacts<'_>) -> bool| {
        let mut names: Vec<String> = Vec::new();
        for written in commands() {
            let command: Command = serde_json::from_value(written.clone()).unwrap();
            if !command.only_reads() && fits(command.facts()) {
                names.push(written["command"].as_str().unwrap().to_owned());
            }
        }
        names.sort();
        names.join(" ")
    };
    let harmless = "acknowledge-alarm reset-alarm shelve-alarm stop unshelve-alarm";
    assert_eq!(named(|facts| facts.is_harmless), harmless);
    assert_eq!(named(|facts| facts.waits_for_sequence), "drift go goal live-fault");
    let is_refused_on_hold = |written| {
        let command: Command = serde_json::from_value(written).unwrap();
        command.only_reads() && !command.facts().is_harmless
    };
    assert!(!commands().into_iter().any(is_refused_on_hold), "a halted engine answers every query");
}

/// Adds an unknown field to every object within, one at a time.
fn with_unknown_fields(value: &Value) -> Vec<Value> {
    let Value::Object(fields) = value else { return Vec::new() };
    let mut all = Vec::new();
    let mut more = fields.clone();
    more.insert("unknown".to_owned(), json!(1));
    all.push(Value::Object(more));
    for (name, inner) in fields {
        all.extend(with_unknown_fields(inner).into_iter().map(|inner| {
            let mut other = fields.clone();
            other.insert(name.clone(), inner);
            Value::Object(other)
        }));
    }
    all
}

#[test]
fn every_request_refuses_fields_that_it_does_not_know() {
    let kinds: std::collections::BTreeSet<String> =
        commands().iter().map(|command| command["command"].to_string()).collect();
    let schema = serde_json::to_value(schemars::schema_for!(super::Command)).unwrap();
    assert_eq!(kinds.len(), schema["oneOf"].as_array().unwrap().len(), "one of each kind: {kinds:?}");
    let mut calls: Vec<Value> = commands().iter().map(call).collect();
    calls.push(json!({ "call": "subscribe" }));
    for call in calls {
        assert!(read(&call).is_ok(), "{call}: {:?}", read(&call));
        for wrong in with_unknown_fields(&call) {
            assert!(read(&wrong).is_err(), "{wrong}");
        }
    }
}
