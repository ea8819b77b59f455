//! The stages together: every command in every state of a version, and what is stored between them.

mod anchors;
mod behavior_shift;
mod cache_edits;
mod cell_faults;
mod checkpoints;
mod compared_rates;
mod health_series;
mod live_harm;
mod named_sensors;
mod omitted_stages;
mod outputs_alone;
mod outside_domain;
mod outside_gate;
mod paused;
mod refused;
mod rerun;
mod shared_events;
mod state_verb_table;
mod stops;
mod store_metrics;
mod telemetry;
mod time_excess;
mod tries;
mod version_statuses;
mod wiring;
