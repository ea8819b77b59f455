//! Somebody sits down who is nobody yet: whether an identity is offered, and what is said of it.

use super::{operating, refuse};
use crate::effect::Effect;
use crate::form::Intent;
use crate::model::Model;
use holdpoint_governance::profile::ProfileName;

/// Nobody of this name is known. Where an unprotected key is enough to act, somebody who typed the name is offered to
/// make it.
pub(super) fn nobody(model: &mut Model, name: String, text: String) -> Vec<Effect> {
    let sim = model.told.snapshot.as_ref().is_some_and(|now| now.profile == ProfileName::Sim);
    let typed = model.seat.wanted.take().is_some_and(|wanted| wanted == name);
    if !(sim && typed && model.absence().is_none() && !model.settings.read_only) {
        return refuse(model, &text);
    }
    let said = lines(&name);
    operating::open(model, Intent::Identity(name), said)
}

pub(super) fn lines(name: &str) -> Vec<String> {
    vec![
        format!("Nobody here is called {name}; it is made as an operator and goes on record"),
        "Its key has no passphrase: enough to act in a simulated cell, and for no approval beside people"
            .to_owned(),
    ]
}
