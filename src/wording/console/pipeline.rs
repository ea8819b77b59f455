//! The texts of the pipeline.

pub const NO_CANDIDATE_FITS: &str = "No candidate fits the filter";
pub const NO_CANDIDATE: &str = "No candidate yet. To see one judged:";
pub const DEMO: &str = "  :demo          a demonstration candidate";
pub const REGISTER: &str = "  :register DIR  the candidate in a folder";
pub const PEOPLE_ARE_ASKED: &str = "people are asked";

#[must_use]
pub fn done_and_in_control(settled: usize, active: usize) -> String {
    format!("DONE {settled}, {active} in control")
}

#[must_use]
pub fn place_in_filter_of_all(place: &str, filter: &str, all: usize) -> String {
    format!("{place} with {filter:?}, {all} in all")
}

#[must_use]
pub fn keys_of_this_view(keys: &str) -> String {
    format!("  {keys:<14} the keys of this view")
}

#[must_use]
pub fn stands_still_at(done: u64, budget: u64, unit: &str, why: &str) -> String {
    format!("stands still at {done} of {budget} {unit}: {why}")
}

#[must_use]
pub fn stage_begins(stage: &str) -> String {
    format!("{stage} begins; nothing has run yet")
}

#[must_use]
pub fn whole_stage(done: u64, budget: u64) -> String {
    format!("; {done} of {budget} in all")
}

#[must_use]
pub fn stage_stands_still(stage: &str, why: &str) -> String {
    format!("{stage} stands still: {why}")
}

#[must_use]
pub fn between_left(elapsed: &str, least: &str, most: &str) -> String {
    format!("{elapsed}, {least} to {most} left")
}
