//! The sentences of the operator's screen: one file per view or concern, named as the file of the console that shows them.
//!
//! The console passes codes and values. Heads of columns and labels of one or two words stay with the view.

pub mod action;
pub mod alarms;
pub mod approval_screen;
pub mod approvals;
pub mod audit;
pub mod availability;
pub mod banner;
pub mod candidate;
pub mod cell_restart;
pub mod commands;
pub mod effects;
pub mod engine_requests;
pub mod engine_updates;
pub mod event_log;
pub mod families;
pub mod film;
pub mod find_in_view;
pub mod form;
pub mod formatters;
pub mod health;
pub mod hints;
pub mod identity_offer;
pub mod key_log;
pub mod keymap;
pub mod model;
pub mod navigation;
pub mod no_engine;
pub mod operations;
pub mod overlays;
pub mod overview;
pub mod palette;
pub mod pipeline;
pub mod recording;
pub mod registry;
pub mod replay;
pub mod robot;
pub mod run;
pub mod selection;
pub mod shadow;
pub mod shared;
pub mod small_window;
pub mod state_line;
pub mod status;
pub mod text_entry;
pub mod theme;
pub mod undo;
pub mod update;
pub mod waits;
pub mod watched;
pub mod why;

#[cfg(test)]
mod tests {
    use super::{audit, shared};

    /// The parts that may be missing, each once with all of them and once with none.
    #[test]
    fn sentences_of_records_leave_out_what_is_missing() {
        for (sentence, expected) in [
            (audit::state_set("registered", "validated", Some("fine")), "registered -> validated: fine"),
            (audit::state_set("registered", "validated", None), "registered -> validated"),
            (
                audit::submitted("cora", Some("manual"), Some("low"), Some("grasp@1.1.0")),
                "submitted by cora, manual, estimated risk low, made from grasp@1.1.0",
            ),
            (audit::submitted("cora", None, None, None), "submitted by cora"),
            (
                audit::has_the_arm("grasp@1.2.0", Some("gate"), Some("grasp@1.1.0")),
                "grasp@1.2.0 has the arm by gate; the rollback target is grasp@1.1.0",
            ),
            (audit::no_version_has_the_arm(None), "no version has the arm"),
            (audit::family_set(true, Some("a trip")), "safe-stopped: a trip"),
            (audit::to_decide("2", Some("noon"), Some("open")), "2 to decide by noon; now open"),
            (audit::to_decide("2", None, None), "2 to decide"),
            (
                audit::decided(Some("sandbox"), Some("reject"), Some("violation is worse")),
                "sandbox: decided reject: violation is worse",
            ),
            (audit::decided(None, None, None), "decided"),
            (audit::cell_stopped("ana", Some("a hand")), "ana stopped the cell: a hand"),
            (audit::asked_for("root", "register", Some("12")), "root asked for register (process 12)"),
            (audit::asked_for("root", "register", None), "root asked for register"),
            (audit::drift_sets_in("friction", Some("small")), "friction small sets in"),
            (audit::closed(Some("export")), "closed as export"),
            (audit::normal_measured(false, Some("40")), "what is normal for it was measured, over 40 tasks"),
            (audit::normal_measured(true, None), "what is normal for the camera check was measured"),
            (
                audit::person("ana", "enrolled", [Some("engineer"), Some("admin"), Some("known")]),
                "ana is enrolled as engineer by admin: known",
            ),
            (shared::live_pace(Some(10.0)), "the live cell runs 10 simulated seconds a second"),
            (shared::live_pace(None), "the live cell runs as fast as it computes"),
        ] {
            assert_eq!(sentence, expected);
        }
    }
}
