#![doc = include_str!(concat!(env!("OUT_DIR"), "/src/ARCHITECTURE.md"))]

pub mod bench;
pub mod cells;
pub mod cli;
pub mod error;
pub mod guide;
pub mod headless;
pub mod scenes;

pub use holdpoint_approvals as approvals;
pub use holdpoint_audit as audit;
pub use holdpoint_body as body;
pub use holdpoint_builder as builder;
#[cfg(feature = "console")]
pub use holdpoint_console as console;
pub use holdpoint_engine as engine;
pub use holdpoint_explain as explain;
pub use holdpoint_governance as governance;
pub use holdpoint_protocol as protocol;
pub use holdpoint_record as record;
pub use holdpoint_recordings as recordings;
pub use holdpoint_registry as registry;
pub use holdpoint_runtime as runtime;
#[cfg(feature = "rerun")]
pub use holdpoint_scene as scene;
pub use holdpoint_service as service;
pub use holdpoint_skill as skill;
pub use holdpoint_store as store;
pub use holdpoint_text as text;
pub use holdpoint_trials as trials;
pub use holdpoint_wording as wording;
