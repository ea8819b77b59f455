//! A console in the middle of a shift, in each of its views.

use std::sync::Arc;

use holdpoint::approvals::keyfile::Protection;
use holdpoint::console::keymap::Keymap;
use holdpoint::console::model::{ConsoleSettings, EngineState, Listing, Model, StoryLine, View};
use holdpoint::console::operator::Operator;
use holdpoint::governance::approval::Role;
use holdpoint::protocol::detail::{AuditPage, Verified};

pub use crate::health::health;
pub use crate::shift::*;

/// A console without anything told yet.
pub fn blank() -> Model {
    let settings =
        ConsoleSettings { read_only: false, mouse: false, tour: None, theme: "calm-dark".to_owned() };
    let mut model = Model::new(settings, Arc::new(Keymap::default()), vec!["calm-dark".to_owned()]);
    model.now_ms = 60_000;
    model.told.snapshot_ms = 60_000;
    model
}

/// A console in the middle of a shift.
pub fn model() -> Model {
    let mut model = blank();
    model.told.engine = EngineState::Running;
    model.told.snapshot = Some(Arc::new(snapshot()));
    model.told.picture = Some(Arc::new(picture()));
    model.seat.operator =
        Some(Operator { name: "linus".to_owned(), role: Role::Operator, protection: Protection::None });
    model.told.registry = Listing { page: Arc::new(registry_page()), ..Listing::default() };
    model.told.audit = Arc::new(AuditPage { rows: audit_rows(), head: 391 });
    model.told.verified = Some(Verified {
        holds: true,
        records: 391,
        text: "every record follows from the one before".to_owned(),
    });
    let told = [
        "state-changed place@1.1.0 validated -> sandboxed",
        "stage-started place@1.1.0 shadow budget 40",
        "approval-requested align@2.0.0 needed 2",
        "approval-received align@2.0.0 by grace: approve",
        "progress grasp@1.1.0 sandbox 137 of 480",
    ];
    for (seq, text) in (1u64..).zip(told) {
        model.told.story.push_back(StoryLine {
            seq,
            at_ms: 720_000 + 8_000 * seq,
            text: text.to_owned(),
            sequences: 0,
        });
    }
    model
}

/// The same, in a view.
pub fn at(view: View) -> Model {
    let mut model = model();
    model.place.view = view;
    match view {
        View::Candidate => {
            model.place.chosen = Some(id("align@2.0.0"));
            model.told.detail = Some(Arc::new(detail()));
        }
        View::Shadow => model.place.chosen = Some(id("place@1.1.0")),
        View::Health => model.told.health = Some((Arc::new(health()), model.now_ms)),
        View::Overview | View::Registry | View::Alarms | View::Approvals | View::Audit => {}
    }
    model
}
