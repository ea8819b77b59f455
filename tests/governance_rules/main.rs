//! The rules of governance against tables of worked values, and against values that are none.

mod asking;
mod compatibility;
mod fixture;
mod gating;
mod monitoring;
mod never_pass;
mod paper;
mod texts;
