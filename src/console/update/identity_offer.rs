//! An unknown name after `:as`: whether an identity is offered, and its text.

use super::{operations, refuse};
use crate::effect::Effect;
use crate::form::Intent;
use crate::model::ConsoleModel;
use holdpoint_governance::profile::ProfileName;
use holdpoint_wording::console::identity_offer as wording;

/// Handles an unknown name. Where an unencrypted key is enough to act, the form offers to make the identity.
pub(super) fn unknown_identity(model: &mut ConsoleModel, name: String, text: String) -> Vec<Effect> {
    let sim = model.engine_data.snapshot.as_ref().is_some_and(|now| now.profile == ProfileName::Sim);
    let typed = model.session.requested_name.take().is_some_and(|wanted| wanted == name);
    if !(sim && typed && model.absence().is_none() && !model.settings.read_only) {
        return refuse(model, &text);
    }
    let consequences = lines(&name);
    operations::open(model, Intent::Identity(name), consequences)
}

pub(super) fn lines(name: &str) -> Vec<String> {
    vec![wording::is_made(name), wording::NO_PASSPHRASE.to_owned()]
}
