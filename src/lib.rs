#![doc = include_str!("ARCHITECTURE.md")]

pub mod alarms;
pub mod approvals;
pub mod bench;
pub mod cli;
pub mod engine;
pub mod experiment;
pub mod explain;
pub mod governance;
pub mod headless;
pub mod pipeline;
pub mod pool;
pub mod refine;
pub mod registry;
pub mod runtime;
pub mod stats;
pub mod text;
