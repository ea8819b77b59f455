//! Exports a view as two files: the drawn text without styles, and its data as JSON.
//!
//! Each file is new, readable only by its owner, and never replaces another. The view has sanitized its text; JSON is
//! escaped.

use std::fs::OpenOptions;
use std::io::{self, Write as _};
use std::os::unix::fs::{DirBuilderExt as _, OpenOptionsExt as _};
use std::path::{Path, PathBuf};

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;

use crate::frame;
use crate::look::{Look, LookOptions};
use crate::model::{ConsoleModel, InputState, View};
use holdpoint_explain::health_series;
use holdpoint_text::{Hint, Untrusted, escape_json};
use holdpoint_wording::console::effects as wording;

/// Columns and rows of the text: wide enough for every column, long enough for a screen of a tall monitor.
const TEXT_SIZE: (u16, u16) = (160, 100);

/// The most numbers tried for a free name.
const NAMES_MAX: u32 = 1000;

/// Writes a view into the first writable folder and returns one sentence with the paths.
///
/// # Errors
/// One sentence.
pub fn write(folders: &[PathBuf], view: View, model: &ConsoleModel) -> Result<String, String> {
    let text = text(view, model)?;
    let json = json(view, model)?;
    let mut problem = wording::NO_FOLDER.to_owned();
    for folder in folders {
        match into_folder(folder, view, &text, &json) {
            Ok(stem) => {
                let more = if view == View::Health { health_files(&stem, model)? } else { String::new() };
                let stem = Untrusted::new(stem.display().to_string()).line();
                return Ok(wording::exported(stem, &more));
            }
            Err(error) => {
                let folder = Untrusted::new(folder.display().to_string()).line();
                problem = wording::cannot_write(folder, error);
            }
        }
    }
    Err(problem)
}

fn into_folder(folder: &Path, view: View, text: &str, json: &str) -> io::Result<PathBuf> {
    std::fs::DirBuilder::new().recursive(true).mode(0o700).create(folder)?;
    let title = view.title().to_lowercase();
    for number in 1..=NAMES_MAX {
        let stem = folder.join(format!("holdpoint-{title}-{number}"));
        let named = |ending: &str| stem.with_extension(ending);
        // Both names must be free: a pair belongs together.
        if named("json").exists() {
            continue;
        }
        match new_file(&named("txt"), text) {
            Ok(()) => return new_file(&named("json"), json).map(|()| stem),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error),
        }
    }
    Err(io::Error::other(wording::too_many_exports(NAMES_MAX)))
}

/// Extra files of the health view: the numbers as CSV, and a chart of each family as SVG.
fn health_files(stem: &Path, model: &ConsoleModel) -> Result<String, String> {
    let Some(series) = model.health() else { return Ok(String::new()) };
    let failure = |error: io::Error| wording::cannot_write_beside(&error);
    new_file(&stem.with_extension("csv"), &health_series::csv(series)).map_err(failure)?;
    let mut endings = String::from(", .csv");
    for family in series.families() {
        let mut notes = Vec::new();
        if let Some(bucket) = model.health_bucket() {
            let verdict = series.verdict(&family, bucket);
            notes.push(holdpoint_wording::health::health_verdict(&verdict));
            notes.extend(holdpoint_wording::health::confounding_versions(&verdict));
        }
        notes.extend(holdpoint_wording::health::omissions(&series.coverage));
        let name = format!("{family}.svg");
        new_file(&stem.with_extension(&name), &health_series::svg(series, &family, &notes))
            .map_err(failure)?;
        endings.push_str(&format!(", .{name}"));
    }
    Ok(endings)
}

fn new_file(path: &Path, text: &str) -> io::Result<()> {
    let mut file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(path)?;
    file.write_all(text.as_bytes())
}

/// The view as it is drawn, in ASCII and without styles.
fn text(view: View, model: &ConsoleModel) -> Result<String, String> {
    let options = LookOptions { ascii: true, ..LookOptions::default() };
    let look = Look::detect(&options).map_err(|error| error.sentence())?;
    let mut shown = model.clone();
    shown.view_state.view = view;
    shown.input = InputState::default();
    let area = Rect::new(0, 0, TEXT_SIZE.0, TEXT_SIZE.1);
    let mut buffer = Buffer::empty(area);
    frame::draw(&shown, &look, area, &mut buffer);
    Ok(lines(&buffer))
}

/// A buffer's text, without blanks at the ends of lines, and one empty line in place of many.
fn lines(buffer: &Buffer) -> String {
    let mut text = String::new();
    let mut blank = true;
    for row in buffer.content().chunks(usize::from(buffer.area.width).max(1)) {
        let line: String = row.iter().map(ratatui::buffer::Cell::symbol).collect();
        let line = line.trim_end();
        if !(line.is_empty() && blank) {
            text.push_str(line);
            text.push('\n');
        }
        blank = line.is_empty();
    }
    text
}

/// The data behind a view.
fn json(view: View, model: &ConsoleModel) -> Result<String, String> {
    let value = view.behavior().data(model);
    let text = value.and_then(|value| serde_json::to_string(&value)).map_err(|error| error.to_string())?;
    Ok(format!("{}\n", escape_json(&text)))
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt as _;
    use std::sync::Arc;

    use super::*;
    use crate::keymap::Keymap;
    use crate::model::ConsoleSettings;

    #[test]
    fn files_are_new_private_and_never_replace_another() {
        let settings =
            ConsoleSettings { read_only: false, mouse: false, tour: None, theme: "mono".to_owned() };
        let model = ConsoleModel::new(settings, Arc::new(Keymap::default()), Vec::new());
        let folder = tempfile::tempdir().unwrap();
        let folders = [PathBuf::from("/proc/nowhere"), folder.path().join("exports")];
        for number in 1..=2 {
            let message = write(&folders, View::Registry, &model).unwrap();
            assert!(message.contains(&format!("holdpoint-registry-{number}.txt and .json")), "{message}");
            for ending in ["txt", "json"] {
                let path = folder.path().join(format!("exports/holdpoint-registry-{number}.{ending}"));
                let mode = std::fs::metadata(&path).unwrap().permissions().mode();
                assert_eq!(mode & 0o777, 0o600, "{path:?}");
                assert!(!std::fs::read_to_string(&path).unwrap().contains('\u{1b}'));
            }
        }
        let written =
            std::fs::read_to_string(folder.path().join("exports/holdpoint-registry-1.json")).unwrap();
        let page: serde_json::Value = serde_json::from_str(&written).unwrap();
        assert_eq!(page["total"], 0);
        let nowhere = write(&folders[..1], View::Alarms, &model).unwrap_err();
        assert!(nowhere.contains("\"/proc/nowhere\""), "{nowhere}");
    }
}
