//! The reader of the crate `store`, answered from the files in a store's folder.

use crate::reading::views::Views;
use crate::telemetry::telemetry_views::TelemetryViews;
use crate::verification::verify::verify;
use holdpoint_approvals::keyfile;
use holdpoint_store::{
    Layout, ReadableStore, RecordViews, StoreError, TelemetryReader, VerifyError, VerifyReport,
};

/// Reads the store in a folder, also while an engine has it open. The caller knows that its tables match its chain.
#[derive(Clone, Debug)]
pub struct SqliteReader {
    layout: Layout,
}

impl SqliteReader {
    /// The reader of the store in this folder; nothing is touched.
    #[must_use]
    pub const fn new(layout: Layout) -> Self {
        Self { layout }
    }
}

impl ReadableStore for SqliteReader {
    fn views(&self) -> Result<Box<dyn RecordViews>, StoreError> {
        Ok(Box::new(Views::open(&self.layout.database())?))
    }

    fn telemetry(&self) -> Result<Option<Box<dyn TelemetryReader>>, StoreError> {
        let file = self.layout.telemetry();
        if !file.is_file() {
            return Ok(None);
        }
        Ok(Some(Box::new(TelemetryViews::open(&file)?)))
    }

    fn verify(&self) -> Result<VerifyReport, VerifyError> {
        let key = keyfile::read_public(&self.layout.store_public_key()).ok().map(|(key, _)| key);
        verify(&self.layout.database(), key.as_ref())
    }
}
