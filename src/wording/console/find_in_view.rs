//! Answers to a search in a list.

pub const NOTHING_SEARCHED: &str = "nothing was searched for yet; / begins a search";
