//! A person's note for the next shift: recorded, published, and marked in the health charts. It decides nothing.

use holdpoint_governance::record::RecordKind;
use holdpoint_protocol::command::{Refusal, Reply};
use holdpoint_protocol::event::EventKind;
use holdpoint_record::REASON_BYTES_MAX;
use holdpoint_record::shift_note::ShiftNoteRecord;
use holdpoint_store::StoreError;
use holdpoint_text::is_visible;
use holdpoint_wording::command_effect::{EngineEffect, engine_effect};

use crate::decide::recorder::EngineRecorder;

/// Records a note.
///
/// # Errors
/// If it cannot be written.
pub(crate) fn take(record: &mut EngineRecorder, by: String, text: String) -> Result<Reply, StoreError> {
    let fits = |text: &str| is_visible(text) && text.len() <= REASON_BYTES_MAX;
    if !fits(&by) || !fits(&text) {
        let text =
            format!("a name and a note that can be read are needed, of 1 to {REASON_BYTES_MAX} bytes each");
        return Ok(Reply::Refused { code: Refusal::BadInput, text, hint: None });
    }
    let note = ShiftNoteRecord { by, text };
    record.note(RecordKind::ShiftNote, String::new(), serde_json::json!(note).to_string())?;
    let ShiftNoteRecord { by, text } = note;
    record.tell(EventKind::ShiftNote { by, text });
    Ok(Reply::Accepted { text: engine_effect(&EngineEffect::NoteRecorded), version: None })
}
