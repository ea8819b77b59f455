//! View 2: families and versions as a tree, each with state, the four values against their limits, and age.
//!
//! ```text
//! [All]  Active  Candidates  History                            3 of 8
//!   version        state                interface  policy     behavior  …        age
//! ▾ grasp (3)
//! ▸  1.1.0         ◌ running            1.00 ███┃ 0.97 ███┃ 0.91 …          7 min
//! reason: behavior-established-worse: …
//! ```

use ratatui::layout::Rect;

use super::console_view::{ConsoleView, ViewDescription};
use super::tabs;
use crate::action::{Action, Scope};
use crate::effect::{Effect, EngineQuery};
use crate::formatters::{duration, origin, reason_line, state_label};
use crate::look::{Glyph, Look, ThemeRole};
use crate::model::{ConsoleModel, ItemKey, SortBy, SortOrder, View};
use crate::rows::RegistryItem;
use crate::state_filter::{StateFilter, counts_and_place};
use crate::update::navigation;
use crate::widgets::bar::against_limit;
use crate::widgets::list::{GUTTER, place};
use crate::widgets::pen::{Fit, Pen, below, cut, heading_room};
use crate::widgets::row::Row;
use holdpoint_governance::decision::Dimension;
use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_governance::record::{VersionGroup, VersionSummary};
use holdpoint_governance::version_status::{RecordedChanges, StatusFacts, VersionStatus};
use holdpoint_wording::console::registry as wording;
use holdpoint_wording::counted;

/// Lines for the description of the version under the cursor.
const DETAIL_ROWS: u16 = 4;

const DIMENSIONS: [Dimension; 4] =
    [Dimension::Interface, Dimension::Policy, Dimension::Behavior, Dimension::Recovery];

/// Widths of the columns: name, state, bar of each kappa.
struct RegistryColumns {
    name: usize,
    state: usize,
    bar: usize,
    /// Author, origin and risk; zero without room for them. The rest of the line comes behind.
    by: usize,
}

/// The width from which author and reason of the state are beside a version.
const WIDE: usize = 150;

/// Columns of the widest age, `59 min`.
const AGE_WIDTH: usize = 6;

impl RegistryColumns {
    /// Columns before the age, with the gap that keeps it apart.
    const fn before_age(&self) -> usize {
        GUTTER as usize + self.name + self.state + 1 + DIMENSIONS.len() * self.kappa() + 1
    }

    /// A kappa with its bar and its sign.
    const fn kappa(&self) -> usize {
        5 + self.bar + 1
    }

    const fn of(fit: Fit, width: usize) -> Self {
        match fit {
            Fit::Full if width >= WIDE => Self { name: 20, state: 30, bar: 8, by: 30 },
            Fit::Full => Self { name: 20, state: 22, bar: 5, by: 0 },
            Fit::Two => Self { name: 17, state: 21, bar: 2, by: 0 },
            Fit::One | Fit::Tiny => Self { name: 9, state: 22, bar: 0, by: 0 },
        }
    }
}

/// View 2.
pub struct RegistryBehavior;

impl ConsoleView for RegistryBehavior {
    fn description(&self) -> &'static ViewDescription {
        &ViewDescription {
            title: "Registry",
            brief_title: "Registry",
            action: "registry",
            keys: &["2"],
            help: wording::HELP,
            tour: wording::TOUR,
            panes: &["All", "Active", "Candidates", "History"],
            scopes: &[Scope::Version],
            fixed_order: None,
            queries_by_pane: true,
            is_about_version: false,
        }
    }

    fn row_count(&self, model: &ConsoleModel) -> usize {
        model.registry_rows().len()
    }

    fn item_key(&self, model: &ConsoleModel, row: usize) -> Option<ItemKey> {
        model.registry_rows().get(row).map(|item| match item {
            RegistryItem::Family { family, .. } => ItemKey::Family((*family).clone()),
            RegistryItem::Version(row) => ItemKey::Version(row.version.clone()),
        })
    }

    fn row_of(&self, model: &ConsoleModel, key: &ItemKey) -> Option<usize> {
        model.registry_rows().iter().position(|item| match (item, key) {
            (RegistryItem::Family { family, .. }, ItemKey::Family(of)) => *family == of,
            (RegistryItem::Version(row), ItemKey::Version(id)) => row.version == *id,
            (RegistryItem::Family { .. } | RegistryItem::Version(_), _) => false,
        })
    }

    fn version_here(&self, model: &ConsoleModel) -> Option<CapabilityId> {
        self.rows_and_version(model).1
    }

    fn rows_and_version(&self, model: &ConsoleModel) -> (usize, Option<CapabilityId>) {
        let rows = model.registry_rows();
        let at = model.view_state.cursor().min(rows.len().saturating_sub(1));
        (rows.len(), rows.get(at).and_then(|item| version_of(model, item)))
    }

    fn row_texts(&self, model: &ConsoleModel) -> Vec<String> {
        let text = |row: &RegistryItem<'_>| match row {
            RegistryItem::Family { family, .. } => family.to_string(),
            RegistryItem::Version(row) => {
                format!("{} {} {}", row.version, row.author, state_label(row.state, &row.flags))
            }
        };
        model.registry_rows().iter().map(text).collect()
    }

    fn lists_versions(&self, _pane: usize) -> bool {
        true
    }

    fn can_mark(&self, item: &ItemKey) -> bool {
        matches!(item, ItemKey::Version(_))
    }

    fn is_filtered(&self, _model: &ConsoleModel) -> bool {
        true
    }

    fn hints(&self, _model: &ConsoleModel) -> &'static [Action] {
        &[
            Action::Open,
            Action::NextPane,
            Action::Filter,
            Action::Sort,
            Action::Rollback,
            Action::Resume,
            Action::Demote,
            Action::Repeat,
            Action::Release,
            Action::Rearm,
        ]
    }

    fn query(&self, model: &ConsoleModel) -> Option<EngineQuery> {
        let group = match model.view_state.pane_of(View::Registry) {
            1 => VersionGroup::Active,
            2 => VersionGroup::Candidate,
            3 => VersionGroup::History,
            _ => VersionGroup::All,
        };
        Some(EngineQuery::Registry { group, text: String::new() })
    }

    fn data(&self, model: &ConsoleModel) -> serde_json::Result<serde_json::Value> {
        serde_json::to_value(&*model.engine_data.registry.page)
    }

    fn open(&self, model: &mut ConsoleModel) -> Vec<Effect> {
        if let Some(RegistryItem::Family { family, open, .. }) = model.registry_rows().get(model.row()) {
            let (family, open) = ((*family).clone(), *open);
            set_branch(model, family, !open);
            return Vec::new();
        }
        navigation::choose(model)
    }

    /// The branch opens and closes; in a list without branches the pane changes.
    fn sideways(&self, model: &mut ConsoleModel, right: bool) -> Vec<Effect> {
        if model.engine_data.registry.is_flat() {
            return navigation::step_pane(model, right);
        }
        let family = match model.registry_rows().get(model.row()) {
            Some(RegistryItem::Family { family, .. }) => (*family).clone(),
            Some(RegistryItem::Version(row)) => row.version.family.clone(),
            None => return Vec::new(),
        };
        set_branch(model, family, right);
        Vec::new()
    }

    fn draw(&self, model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
        draw(model, pen, area);
    }

    fn small_place(&self, model: &ConsoleModel, title: &str, width: u16) -> String {
        let place = place(model.row_count(), model.row());
        counts_and_place(model, &place, heading_room(title, width))
    }

    fn small_rows(&self, model: &ConsoleModel, pen: &Pen<'_>, width: usize) -> Vec<Row> {
        model.registry_rows().iter().map(|item| small_row(model, item, pen, width)).collect()
    }
}

/// The version of a row; that of a family means its active version.
fn version_of(model: &ConsoleModel, item: &RegistryItem<'_>) -> Option<CapabilityId> {
    match item {
        RegistryItem::Version(row) => Some(row.version.clone()),
        RegistryItem::Family { family, .. } => {
            let families = &model.engine_data.snapshot.as_ref()?.families;
            families.iter().find(|known| known.family == **family)?.active.clone()
        }
    }
}

fn set_branch(model: &mut ConsoleModel, family: Family, open: bool) {
    if open {
        model.engine_data.registry.closed.remove(&family);
        return;
    }
    model.engine_data.registry.closed.insert(family.clone());
    // The cursor goes to the closed branch.
    let is_it =
        |item: &RegistryItem<'_>| matches!(item, RegistryItem::Family { family: of, .. } if **of == family);
    if let Some(row) = model.registry_rows().iter().position(is_it) {
        navigation::set_row(model, row);
    }
}

fn small_row(model: &ConsoleModel, item: &RegistryItem<'_>, pen: &Pen<'_>, width: usize) -> Row {
    match item {
        RegistryItem::Family { family, versions, open } => {
            let glyph = pen.look.glyph(if *open { Glyph::Open } else { Glyph::Closed });
            Row::of(ThemeRole::Title, &format!("{glyph} {family}"))
                .with(ThemeRole::Muted, &format!("  {versions}"))
        }
        RegistryItem::Version(row) => {
            let marked = model.view_state.marked_versions.contains(&row.version);
            lead(marked, false, pen.look)
                .cell(ThemeRole::Text, &super::cut_middle(&row.version.version.to_string(), 7), 8)
                .and(super::state_row(row.state, &row.flags, width.saturating_sub(12), pen.look))
        }
    }
}

fn draw(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let items = model.registry_rows();
    // The rows are many: they are made only once.
    let cursor = model.view_state.cursor().min(items.len().saturating_sub(1));
    let total = model.engine_data.registry.page.total;
    let shown = model.engine_data.registry.page.rows.len() as u64;
    let right = if total > shown { format!("{shown} of {total} read") } else { String::new() };
    let place = format!("{}  {right}", place(items.len(), cursor));
    let width = usize::from(area.width);
    let room = width.saturating_sub(tabs::panes(model).width() + 1);
    let place = Row::of(ThemeRole::Muted, &counts_and_place(model, place.trim(), room));
    tabs::draw_panes(model, place, pen, area);
    let area = below(area, 1);
    if items.is_empty() {
        let is_filtered = !model.filter().is_empty() || model.view_state.state_filter != StateFilter::All;
        let text = if is_filtered { wording::NO_VERSION_FITS } else { wording::NONE_OF_THIS_KIND };
        pen.text(area, 0, ThemeRole::Muted, text);
        return;
    }
    let columns = RegistryColumns::of(pen.fit, width);
    let look = pen.look;
    // An age is never cut: without room for the widest, only the lines below show it.
    let has_age = columns.before_age() + AGE_WIDTH <= width;
    pen.row(area, 0, &header(&columns, has_age, model.engine_data.registry.sort, look));
    // A large screen shows more about the version under the cursor, and the list keeps its rows.
    let left = area.height.saturating_sub(1 + u16::try_from(items.len()).unwrap_or(u16::MAX));
    let detail_rows = left.clamp(DETAIL_ROWS, (area.height / 3).max(DETAIL_ROWS));
    let (list, foot) = cut(below(area, 1), area.height.saturating_sub(1 + detail_rows));
    let limits = model.engine_data.registry.page.thresholds;
    pen.list(list, items.len(), Some(cursor), |index, _| match items.get(index) {
        Some(RegistryItem::Family { family, versions, open }) => {
            let glyph = look.glyph(if *open { Glyph::Open } else { Glyph::Closed });
            Row::of(ThemeRole::Title, &format!("{glyph} {family}"))
                .with(ThemeRole::Muted, &format!("  {}", counted(*versions, "version")))
        }
        Some(RegistryItem::Version(row)) => {
            let flat = model.engine_data.registry.is_flat();
            let marked = model.view_state.marked_versions.contains(&row.version);
            let anchor = model.engine_data.registry.page.anchors.contains(&row.version);
            let age_ms = has_age.then(|| model.age_ms(row));
            let line = version(row, (flat, marked, anchor), limits, age_ms, &columns, look);
            if columns.by > 0 { line.and(extra_columns(model, row, &columns)) } else { line }
        }
        None => Row::new(),
    });
    detail(model, items.get(cursor), pen, foot);
}

/// The columns' names; the sorting one has a sign.
fn header(columns: &RegistryColumns, has_age: bool, sort: SortOrder, look: &Look) -> Row {
    let sign = look.glyph(if sort.reversed { Glyph::Down } else { Glyph::Up });
    let heading = |by: SortBy, name: &str| {
        let marked = sort.by == by && sort != SortOrder::default();
        if marked { format!("{name}{sign}") } else { name.to_owned() }
    };
    let mut row = Row::new()
        .to_column(usize::from(GUTTER))
        .cell(ThemeRole::Muted, &heading(SortBy::Tree, "version"), columns.name)
        .cell(ThemeRole::Muted, &heading(SortBy::State, "state"), columns.state)
        .with(ThemeRole::Text, " ");
    // A gap and the sign of the order stand behind a name.
    let room = columns.kappa().saturating_sub(2);
    for (place, dimension) in DIMENSIONS.into_iter().enumerate() {
        let name = heading(SortBy::Kappa(place), &super::short(dimension.name(), room));
        row = row.cell(ThemeRole::Muted, &name, columns.kappa());
    }
    let age = if has_age { heading(SortBy::Age, " age") } else { String::new() };
    let age = age.as_str();
    if columns.by == 0 {
        return row.with(ThemeRole::Muted, age);
    }
    row.cell(ThemeRole::Muted, age, AGE_WIDTH + 3)
        .cell(ThemeRole::Muted, &heading(SortBy::Author, "made by"), columns.by)
        .with(ThemeRole::Muted, wording::WHY_IT_STANDS_THERE)
}

/// The author, and the deciding reason, for a wide screen.
fn extra_columns(model: &ConsoleModel, row: &VersionSummary, columns: &RegistryColumns) -> Row {
    let by = format!("{}, {}", super::short(&row.author, 14), origin(row.provenance));
    let room = columns.by.saturating_sub(1);
    let cause = holdpoint_wording::status_cause(&status(model, row)).unwrap_or_default();
    Row::new().cell(ThemeRole::Muted, &super::short(&by, room), columns.by).with(ThemeRole::Text, &cause)
}

/// The status of a version; by its row alone if the snapshot does not have it.
fn status(model: &ConsoleModel, row: &VersionSummary) -> VersionStatus {
    let now = model.engine_data.snapshot.as_deref();
    let known = now.and_then(|now| Some(now.status(model.candidate(&row.version)?)));
    known.unwrap_or_else(|| {
        VersionStatus::of(&StatusFacts {
            state: row.state,
            flags: &row.flags,
            held: false,
            reasons: &[],
            obstacle: None,
            recorded: &RecordedChanges::default(),
        })
    })
}

fn version(
    row: &VersionSummary,
    (flat, marked, anchor): (bool, bool, bool),
    limits: [f64; 4],
    age_ms: Option<u64>,
    columns: &RegistryColumns,
    look: &Look,
) -> Row {
    let kind = match (anchor, row.baseline) {
        _ if columns.name <= 12 => "",
        (true, _) => " anchor",
        (false, true) => " baseline",
        (false, false) => "",
    };
    // A plain list has no family headings, so each row names its family.
    let name = if flat { row.version.to_string() } else { format!("{}{kind}", row.version.version) };
    let lead = lead(marked, flat, look);
    let room = columns.name.saturating_sub(lead.width());
    let mut line = lead
        .cell(ThemeRole::Text, &super::cut_middle(&name, room.saturating_sub(1)), room)
        .and(super::state_row(row.state, &row.flags, columns.state, look))
        .to_column(columns.name + columns.state)
        .with(ThemeRole::Text, " ");
    for (kappa, limit) in row.kappas.into_iter().zip(limits) {
        let (role, text) = match kappa {
            None => (ThemeRole::Unknown, "?".to_owned()),
            Some(kappa) if kappa >= limit => (ThemeRole::Value, format!("{kappa:.2}")),
            Some(kappa) => (ThemeRole::Past, format!("{kappa:.2}")),
        };
        line = line.cell(role, &text, 5).and(against_limit(look, kappa, limit, columns.bar));
        // Without a bar, a sign says that the limit is not reached.
        let below = kappa.is_some_and(|kappa| !(kappa >= limit));
        line = line.with(ThemeRole::Past, if below { look.glyph(Glyph::Down) } else { " " });
    }
    let age = age_ms.map_or_else(String::new, |age_ms| format!(" {}", age(age_ms)));
    if columns.by == 0 {
        return line.with(ThemeRole::Muted, &age);
    }
    line.cell(ThemeRole::Muted, &age, AGE_WIDTH + 3)
}

/// The part before a version's name: its mark, or the room of a tree's branch.
#[must_use]
pub fn lead(marked: bool, flat: bool, look: &Look) -> Row {
    if marked {
        Row::of(ThemeRole::Focus, look.glyph(Glyph::Marked)).with(ThemeRole::Text, " ")
    } else if flat {
        Row::new()
    } else {
        Row::of(ThemeRole::Text, "  ")
    }
}

/// How long ago, in the largest unit that fits: [`AGE_WIDTH`] columns at most.
fn age(age_ms: u64) -> String {
    let mins = age_ms / 60_000;
    match mins {
        0 => format!("{} s", age_ms / 1_000),
        1..60 => format!("{mins} min"),
        60..1_440 => format!("{} h", mins / 60),
        _ => format!("{} d", (mins / 1_440).min(9_999)),
    }
}

/// The data of the snapshot and the page about the version under the cursor.
fn detail(model: &ConsoleModel, item: Option<&RegistryItem<'_>>, pen: &mut Pen<'_>, area: Rect) {
    let Some(RegistryItem::Version(row)) = item else {
        pen.pane(area, "Family", false, "");
        let text = wording::BRANCH_KEYS;
        pen.text(below(area, 1), 0, ThemeRole::Muted, text);
        return;
    };
    let inside = pen.pane(area, &row.version.to_string(), false, "");
    let limits = model.engine_data.registry.page.thresholds;
    let mut sentence = Row::of(
        ThemeRole::Text,
        &wording::detail(
            &state_label(row.state, &row.flags),
            &duration(model.age_ms(row)),
            if model.engine_data.registry.page.anchors.contains(&row.version) { "anchor, " } else { "" },
            &super::short(&row.author, 24),
            origin(row.provenance),
            row.risk,
        ),
    );
    let limits = DIMENSIONS.into_iter().zip(limits);
    let limits: Vec<String> = limits.map(|(of, limit)| format!("{} {limit:.2}", of.name())).collect();
    sentence.push(ThemeRole::Muted, &format!("  limits: {}", limits.join(", ")));
    pen.row(inside, 0, &sentence);
    let told = holdpoint_wording::version_status(&row.version, &status(model, row));
    let taken = pen.text(below(inside, 1), 0, ThemeRole::Text, &told);
    let Some(candidate) = model.candidate(&row.version) else { return };
    let mut rest = below(inside, 1 + taken);
    for reason in &candidate.reasons {
        let taken = pen.text(rest, 0, ThemeRole::Text, &reason_line(reason));
        rest = below(rest, taken);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ages from ten minutes on were cut in the most usual window.
    #[test]
    fn ages_are_never_cut_off_in_their_column() {
        const DAY_MS: u64 = 86_400_000;
        for (age_ms, text) in [
            (0, "0 s"),
            (59_999, "59 s"),
            (60_000, "1 min"),
            (3_599_999, "59 min"),
            (3_600_000, "1 h"),
            (DAY_MS - 1, "23 h"),
            (DAY_MS, "1 d"),
            (400 * DAY_MS, "400 d"),
            (u64::MAX, "9999 d"),
        ] {
            assert_eq!(age(age_ms), text);
            assert!(age(age_ms).len() <= AGE_WIDTH, "{text}");
        }
        for (width, height) in [(80, 24), (100, 30), (120, 36), (200, 60)] {
            let columns = RegistryColumns::of(Fit::of(width, height), usize::from(width));
            assert!(columns.before_age() + AGE_WIDTH <= usize::from(width), "{width} columns");
        }
    }
}
