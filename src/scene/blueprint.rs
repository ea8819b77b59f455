//! The viewer's initial layout: the scene on the left, charts on the right, phase, log and document below.
//!
//! Written as plain rows with fixed ids, so that every recording holds the same bytes.

use std::io;

use rerun::blueprint::components::{
    ActiveTab, AutoLayout, AutoViews, BackgroundKind, ColumnShare, ContainerKind, IncludedContent, LoopMode,
    PanelState, QueryExpression, RootContainer, RowShare, TimelineName, ViewClass,
};
use rerun::components::Name;
use rerun::datatypes;
use rerun::external::re_log_types::BlueprintActivationCommand;
use rerun::external::re_sdk_types::blueprint::archetypes::{
    Background, ContainerBlueprint, EyeControls3D, PanelBlueprint, TimePanelBlueprint, ViewBlueprint,
    ViewContents, ViewportBlueprint,
};
use rerun::log::{Chunk, LogMsg};
use rerun::time::{TimeCell, TimePoint};
use rerun::{AsComponents, EntityPath, StoreId, StoreKind};

use super::drawing::theme;
use super::file::{APPLICATION, message, opening};
use super::rows::RowIds;

/// A view: number, class, name, origin, contents.
type BlueprintView = (u8, &'static str, &'static str, &'static str, &'static [&'static str]);

const SCENE: u8 = 1;
const VIEWS: [BlueprintView; 10] = [
    (SCENE, "3D", holdpoint_wording::scene::CELL_AND_TWIN, "/world", &["$origin/**"]),
    (2, "TimeSeries", "Tool speed, m/s", "/plots/tool/speed", &["$origin/**"]),
    (3, "TimeSeries", "Forces, N", "/plots/tool", &["+ $origin/force/**", "+ $origin/contact/**"]),
    (4, "TimeSeries", "Shadow divergence", "/plots/shadow", &["$origin/**"]),
    (5, "TimeSeries", "Kappas", "/plots/kappa", &["$origin/**"]),
    (6, "TimeSeries", "Pairs", "/plots/pairs", &["$origin/**"]),
    (7, "TimeSeries", "Monitor", "/plots/monitor", &["$origin/**"]),
    (8, "StateTimeline", "Phase", "/phase", &["$origin/**"]),
    (9, "TextLog", "Log", "/log", &["$origin/**"]),
    (10, "TextDocument", "Upgrade", "/upgrade", &["$origin/**"]),
];

/// The camera: from the front and the right, a little above.
const EYE_M: [f32; 3] = [1.12, -0.86, 0.66];
const LOOK_AT_M: [f32; 3] = [0.36, 0.02, 0.24];

/// The layout as messages.
///
/// # Errors
/// If a row is not well formed, which is a defect of this program.
pub fn messages() -> io::Result<Vec<LogMsg>> {
    let store = StoreId::new(StoreKind::Blueprint, APPLICATION, "holdpoint-layout");
    let mut page = BlueprintPage { ids: RowIds::of_segment(0), store, messages: Vec::new() };
    let first = opening(&page.store, &mut page.ids);
    page.messages.push(first);
    for view in VIEWS {
        page.view(view)?;
    }
    let eye = EyeControls3D::new()
        .with_position(EYE_M)
        .with_look_target(LOOK_AT_M)
        .with_eye_up([0.0_f32, 0.0, 1.0]);
    page.put(&format!("{}/EyeControls3D", view_path(SCENE)), &eye)?;
    let dark = Background::new(BackgroundKind::SolidColor).with_color(theme::solid([18, 21, 26]));
    page.put(&format!("{}/Background", view_path(SCENE)), &dark)?;
    page.containers()?;
    page.panels()?;
    let command = BlueprintActivationCommand::make_active(page.store.clone());
    page.messages.push(LogMsg::BlueprintActivationCommand(command));
    Ok(page.messages)
}

struct BlueprintPage {
    ids: RowIds,
    store: StoreId,
    messages: Vec<LogMsg>,
}

/// A fixed id; `kind` keeps views and containers apart.
fn uuid(kind: u8, number: u8) -> rerun::external::uuid::Uuid {
    let mut bytes = *b"holdpoint-layout";
    // Version 4, variant 1, as every reader expects of an id.
    bytes[6] = 0x40;
    bytes[8] = 0x80;
    bytes[14] = kind;
    bytes[15] = number;
    rerun::external::uuid::Uuid::from_bytes(bytes)
}

fn view_path(number: u8) -> String {
    format!("view/{}", uuid(1, number))
}

fn container_path(number: u8) -> String {
    format!("container/{}", uuid(2, number))
}

impl BlueprintPage {
    fn put(&mut self, path: &str, what: &dyn AsComponents) -> io::Result<()> {
        let mut point = TimePoint::default();
        point.insert_cell("blueprint", TimeCell::from_sequence(0));
        let row = self.ids.row();
        let chunk = Chunk::builder_with_id(self.ids.chunk(), EntityPath::parse_forgiving(path))
            .with_archetype(row, point, what)
            .build()
            .map_err(|error| io::Error::other(error.to_string()))?;
        self.messages.push(message(&self.store, &chunk)?);
        Ok(())
    }

    fn view(&mut self, (number, class, name, origin, contents): BlueprintView) -> io::Result<()> {
        let path = view_path(number);
        let queries = contents.iter().map(|query| QueryExpression((*query).into()));
        self.put(&format!("{path}/ViewContents"), &ViewContents::new(queries))?;
        let view = ViewBlueprint::new(ViewClass(class.into()))
            .with_display_name(Name(name.into()))
            .with_space_origin(origin);
        self.put(&path, &view)
    }

    /// Root, top row, charts, tabs and bottom row.
    fn containers(&mut self) -> io::Result<()> {
        const ROOT: u8 = 1;
        const TOP: u8 = 2;
        const CHARTS: u8 = 3;
        const TABS: u8 = 4;
        const BOTTOM: u8 = 5;
        let included =
            |paths: Vec<String>| paths.into_iter().map(|path| IncludedContent(path.as_str().into()));
        let columns = |shares: &[f32]| {
            shares.iter().map(|share| ColumnShare(datatypes::Float32(*share))).collect::<Vec<_>>()
        };
        let rows = |shares: &[f32]| {
            shares.iter().map(|share| RowShare(datatypes::Float32(*share))).collect::<Vec<_>>()
        };

        let tabs = ContainerBlueprint::new(ContainerKind::Tabs)
            .with_contents(included((4..=7).map(view_path).collect()))
            .with_active_tab(ActiveTab(datatypes::EntityPath::from(view_path(4).as_str())));
        self.put(&container_path(TABS), &tabs)?;
        let charts = ContainerBlueprint::new(ContainerKind::Vertical)
            .with_contents(included(vec![view_path(2), view_path(3), container_path(TABS)]))
            .with_row_shares(rows(&[1.0, 1.0, 1.2]));
        self.put(&container_path(CHARTS), &charts)?;
        let top = ContainerBlueprint::new(ContainerKind::Horizontal)
            .with_contents(included(vec![view_path(SCENE), container_path(CHARTS)]))
            .with_col_shares(columns(&[3.0, 2.0]));
        self.put(&container_path(TOP), &top)?;
        let bottom = ContainerBlueprint::new(ContainerKind::Horizontal)
            .with_contents(included((8..=10).map(view_path).collect()))
            .with_col_shares(columns(&[1.6, 2.4, 1.6]));
        self.put(&container_path(BOTTOM), &bottom)?;
        let root = ContainerBlueprint::new(ContainerKind::Vertical)
            .with_contents(included(vec![container_path(TOP), container_path(BOTTOM)]))
            .with_row_shares(rows(&[3.0, 1.25]));
        self.put(&container_path(ROOT), &root)?;
        let viewport = ViewportBlueprint::new()
            .with_root_container(RootContainer(uuid(2, ROOT).into()))
            .with_auto_layout(AutoLayout(datatypes::Bool(false)))
            .with_auto_views(AutoViews(datatypes::Bool(false)));
        self.put("viewport", &viewport)
    }

    fn panels(&mut self) -> io::Result<()> {
        for panel in ["blueprint_panel", "selection_panel"] {
            self.put(panel, &PanelBlueprint::new().with_state(PanelState::Hidden))?;
        }
        let time = TimePanelBlueprint::new()
            .with_state(PanelState::Collapsed)
            .with_timeline(TimelineName("sim_time".into()))
            .with_loop_mode(LoopMode::Off);
        self.put("time_panel", &time)
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn blueprint_is_deterministic() {
        assert_eq!(super::messages().unwrap(), super::messages().unwrap());
    }
}
