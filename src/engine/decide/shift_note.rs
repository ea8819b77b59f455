//! A person's note for the next shift: recorded, published, and marked in the health charts. It decides nothing.

use holdpoint_governance::record::RecordKind;
use holdpoint_protocol::command::Reply;
use holdpoint_protocol::event::EventKind;
use holdpoint_record::shift_note::ShiftNoteRecord;
use holdpoint_store::StoreError;
use holdpoint_wording::command_effect::{EngineEffect, engine_effect};

use crate::decide::people::persons::unreadable;
use crate::decide::recorder::EngineRecorder;

/// Records a note.
///
/// # Errors
/// If it cannot be written.
pub(crate) fn take(record: &mut EngineRecorder, by: String, text: String) -> Result<Reply, StoreError> {
    if let Some(refused) = unreadable(&by, &text) {
        return Ok(refused);
    }
    let note = ShiftNoteRecord { by, text };
    record.note(RecordKind::ShiftNote, String::new(), serde_json::json!(note).to_string())?;
    let ShiftNoteRecord { by, text } = note;
    record.tell(EventKind::ShiftNote { by, text });
    Ok(Reply::Accepted { text: engine_effect(&EngineEffect::NoteRecorded), version: None })
}
