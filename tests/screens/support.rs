//! A console in the middle of a shift, in each of its views.

use std::sync::Arc;

use holdpoint::approvals::keyfile::Protection;
use holdpoint::console::keymap::Keymap;
use holdpoint::console::model::{ConsoleModel, ConsoleSettings, EngineState, EventLogLine, View};
use holdpoint::console::operator::Operator;
use holdpoint::governance::approval::Role;
use holdpoint::protocol::detail::{AuditPage, AuditVerification};

pub use crate::health::health;
pub use crate::shift::*;

/// A console without any data yet.
pub fn blank() -> ConsoleModel {
    let settings =
        ConsoleSettings { read_only: false, mouse: false, tour: None, theme: "calm-dark".to_owned() };
    let mut model = ConsoleModel::new(settings, Arc::new(Keymap::default()), vec!["calm-dark".to_owned()]);
    model.now_ms = 60_000;
    model.engine_data.snapshot_ms = 60_000;
    model
}

/// A console in the middle of a shift.
pub fn model() -> ConsoleModel {
    let mut model = blank();
    model.engine_data.engine = EngineState::Running;
    model.engine_data.snapshot = Some(Arc::new(snapshot()));
    model.engine_data.frame = Some(Arc::new(video_frame()));
    model.session.operator =
        Some(Operator { name: "linus".to_owned(), role: Role::Operator, protection: Protection::None });
    model.engine_data.registry.take(registry_page());
    model.engine_data.audit = Arc::new(AuditPage { rows: audit_rows(), head: 391 });
    model.engine_data.verified = Some(AuditVerification {
        holds: true,
        records: 391,
        text: "every record follows from the one before".to_owned(),
    });
    let lines = [
        "state-changed place@1.1.0 validated -> sandboxed",
        "stage-started place@1.1.0 shadow budget 40",
        "approval-requested align@2.0.0 needed 2",
        "approval-received align@2.0.0 by grace: approve",
        "progress grasp@1.1.0 sandbox 137 of 480",
    ];
    for (seq, text) in (1u64..).zip(lines) {
        model.engine_data.events.push_back(EventLogLine {
            seq,
            at_ms: 720_000 + 8_000 * seq,
            text: text.to_owned(),
            shared: None,
        });
    }
    model
}

/// The same, in a view.
pub fn at(view: View) -> ConsoleModel {
    let mut model = model();
    model.view_state.view = view;
    match view {
        View::Candidate => {
            model.view_state.chosen = Some(id("align@2.0.0"));
            model.engine_data.detail = Some(Arc::new(detail()));
        }
        View::Shadow => model.view_state.chosen = Some(id("place@1.1.0")),
        View::Health => model.engine_data.health = Some((Arc::new(health()), model.now_ms)),
        _ => {}
    }
    model
}
