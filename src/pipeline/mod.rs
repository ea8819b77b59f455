//! The seven stages: from registration to audit closure.
pub mod cell;
pub mod drills;
pub mod evaluate;
pub mod live;
pub mod seeds;
pub mod shadow;
