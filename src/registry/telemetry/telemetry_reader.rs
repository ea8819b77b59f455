//! The telemetry reader of the crate `store`, answered from SQLite.

use std::collections::BTreeSet;

use crate::telemetry::telemetry_views::TelemetryViews;
use holdpoint_store::{StoreError, StoredBatch, TelemetryReader};

impl TelemetryReader for TelemetryViews {
    fn each_batch(&self, to_batch: u64, visit: &mut dyn FnMut(StoredBatch)) -> Result<(), StoreError> {
        Self::each_batch(self, to_batch, visit)
    }

    fn each_of_streams(
        &self,
        streams: [&str; 2],
        span: (u64, u64),
        visit: &mut dyn FnMut(StoredBatch),
    ) -> Result<(), StoreError> {
        Self::each_of_streams(self, streams, span, visit)
    }

    fn each_of(&self, numbers: &[u64], visit: &mut dyn FnMut(u64)) -> Result<(), StoreError> {
        Self::each_of(self, numbers, visit)
    }

    fn oldest(&self) -> Result<Option<u64>, StoreError> {
        Self::oldest(self)
    }

    fn numbers(&self) -> Result<BTreeSet<u64>, StoreError> {
        Self::numbers(self)
    }
}
