//! What a view of the console is: its names and keys, its list, its hints, the effect of its keys, and its drawing.
//!
//! The file of a view implements [`ConsoleView`] for a type without data, and the list of the views in
//! [`views`](super) names that type. The reducer and the frame ask the view on display and know no single one. Owns
//! no state: the model has it.

use ratatui::layout::Rect;

use super::small_window;
use crate::action::{Action, Scope};
use crate::effect::{Effect, EngineQuery};
use crate::model::{ConsoleModel, ItemKey};
use crate::update::{navigation, selection};
use crate::widgets::list::{GUTTER, place};
use crate::widgets::pen::Pen;
use crate::widgets::row::Row;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_wording::console::shared;

/// Why a list in the order of time cannot be sorted.
pub(super) const ORDER_OF_TIME: &str = shared::ORDER_OF_TIME;

/// The facts of a view that never change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ViewDescription {
    /// Its name on tabs, in exports and on other consoles: one word.
    pub title: &'static str,
    /// The name on tabs with little room.
    pub brief_title: &'static str,
    /// The name of the action that shows it, on the command line and in the keymap file.
    pub action: &'static str,
    /// The default keys of that action; the first stands on the tab.
    pub keys: &'static [&'static str],
    /// The help of that action, one sentence without a period.
    pub help: &'static str,
    /// The sentence of the tour: what to read first, and the next key.
    pub tour: &'static str,
    /// Its panes, in the order of Tab; at least one.
    pub panes: &'static [&'static str],
    /// Which actions mean something in it, besides those of [`Scope::Everywhere`] and [`Scope::Lists`].
    pub scopes: &'static [Scope],
    /// Why its list cannot be sorted; absent if it can.
    pub fixed_order: Option<&'static str>,
    /// Whether each pane shows other data of the engine, so that a change of the pane asks for them.
    pub queries_by_pane: bool,
    /// Whether it is about one version: the one under the cursor of the view before.
    pub is_about_version: bool,
}

/// A view. Each call is about the view on display: the model's pane and cursor are those of the view.
pub trait ConsoleView {
    fn description(&self) -> &'static ViewDescription;

    /// How many rows the list of the pane has.
    fn row_count(&self, model: &ConsoleModel) -> usize;

    /// The subject of a row.
    fn item_key(&self, model: &ConsoleModel, row: usize) -> Option<ItemKey>;

    /// The current place of an item; absent if it is gone.
    fn row_of(&self, model: &ConsoleModel, key: &ItemKey) -> Option<usize>;

    /// The version under the cursor, or the one of the view.
    fn version_here(&self, model: &ConsoleModel) -> Option<CapabilityId>;

    /// The length of the list, and the version under its cursor.
    #[must_use]
    fn rows_and_version(&self, model: &ConsoleModel) -> (usize, Option<CapabilityId>) {
        (self.row_count(model), self.version_here(model))
    }

    /// The text of each row, for a search.
    fn row_texts(&self, model: &ConsoleModel) -> Vec<String>;

    /// Whether the list of a pane is one of versions, in which some can be marked.
    #[must_use]
    fn lists_versions(&self, _pane: usize) -> bool {
        false
    }

    /// Whether the list of a pane is in the order of time, so that a cursor on its newest item stays at the newest.
    #[must_use]
    fn is_in_order_of_time(&self, _pane: usize) -> bool {
        false
    }

    /// Whether an item of the list can be marked.
    #[must_use]
    fn can_mark(&self, _item: &ItemKey) -> bool {
        false
    }

    /// Whether a typed text narrows the list now. Otherwise the cursor moves to it.
    #[must_use]
    fn is_filtered(&self, _model: &ConsoleModel) -> bool {
        false
    }

    /// The actions that apply, the most important first.
    fn hints(&self, model: &ConsoleModel) -> &'static [Action];

    /// The word for an action in a hint, where the action has another effect than elsewhere.
    #[must_use]
    fn hint_label(&self, _model: &ConsoleModel, _action: Action) -> Option<&'static str> {
        None
    }

    /// Whether there is something to open, in a list of `rows` rows with a version under the cursor.
    #[must_use]
    fn can_open(&self, _model: &ConsoleModel, rows: usize, _version: Option<&CapabilityId>) -> bool {
        rows > 0
    }

    /// The value for Copy: the one that a person would paste elsewhere.
    #[must_use]
    fn copied(&self, model: &ConsoleModel) -> Option<String> {
        selection::copied(model)
    }

    /// The query for the data of the view; absent if the snapshot has them.
    #[must_use]
    fn query(&self, _model: &ConsoleModel) -> Option<EngineQuery> {
        None
    }

    /// The data behind the view, for an export.
    ///
    /// # Errors
    /// If they cannot be written as JSON.
    fn data(&self, model: &ConsoleModel) -> serde_json::Result<serde_json::Value> {
        serde_json::to_value(model.engine_data.snapshot.as_deref())
    }

    /// Enter: opens what is under the cursor. It changes nothing outside this console.
    fn open(&self, model: &mut ConsoleModel) -> Vec<Effect>;

    /// The keys to the left and to the right.
    fn sideways(&self, model: &mut ConsoleModel, right: bool) -> Vec<Effect> {
        navigation::step_pane(model, right)
    }

    /// The keys that zoom.
    fn zoom(&self, model: &mut ConsoleModel, action: Action) -> Vec<Effect> {
        crate::update::zoom(model, action)
    }

    fn draw(&self, model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect);

    /// Its title in a window below 60 x 16.
    #[must_use]
    fn small_title(&self, model: &ConsoleModel) -> String {
        let ViewDescription { title, panes, .. } = self.description();
        let pane = panes.get(model.view_state.pane()).copied().unwrap_or("");
        if panes.len() > 1 { format!("{title}: {pane}") } else { (*title).to_owned() }
    }

    /// The place of the cursor, beside a title in a window below 60 x 16.
    #[must_use]
    fn small_place(&self, model: &ConsoleModel, _title: &str, _width: u16) -> String {
        place(model.row_count(), model.row())
    }

    /// A line for each row, in a window below 60 x 16.
    #[must_use]
    fn small_rows(&self, _model: &ConsoleModel, _pen: &Pen<'_>, _width: usize) -> Vec<Row> {
        Vec::new()
    }

    /// Draws the view in a window below 60 x 16.
    fn draw_small(&self, model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
        let rows = self.small_rows(model, pen, usize::from(area.width.saturating_sub(GUTTER)));
        small_window::draw_rows(model, &rows, pen, area);
    }
}
