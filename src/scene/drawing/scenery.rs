//! The fixed scene, and the style of the bodies that move.

use rerun::archetypes::{Arrows3D, Boxes3D, Capsules3D, LineStrips3D, Points3D, TextLog, ViewCoordinates};
use rerun::components::{FillMode, Radius};

use super::world::BodyRole;
use super::{part, theme};
use crate::limits::TEXT_WIDTH_MAX;
use crate::rows::PendingRows;
use holdpoint_protocol::video_frame::{Region, Scenery};
use holdpoint_text::Untrusted;

pub(super) fn draw(rows: &mut PendingRows, scenery: &Scenery) {
    rows.always("world", &ViewCoordinates::RIGHT_HAND_Z_UP());
    for fixture in &scenery.fixtures {
        if fixture.name == Region::TABLE {
            let solid =
                boxed(fixture).with_colors([theme::solid([92, 96, 104])]).with_fill_mode(FillMode::Solid);
            rows.always("world/table", &solid);
        } else {
            // Where the tray may be; the tray itself is drawn with each sequence.
            rows.always(
                &format!("world/zones/{}", part(&fixture.name)),
                &outlined(fixture, [74, 124, 176], 70),
            );
        }
    }
    for zone in &scenery.keep_outs {
        let name = Untrusted::new(&zone.name).display(TEXT_WIDTH_MAX).into_string();
        let ghost = boxed(zone)
            .with_colors([theme::ghost([214, 60, 60], 8)])
            .with_fill_mode(FillMode::Solid)
            .with_labels([name])
            .with_show_labels(false);
        let path = format!("world/zones/{}", part(&zone.name));
        rows.always(&path, &ghost);
        rows.always(&format!("{path}/edges"), &outlined(zone, [214, 60, 60], 150));
    }
    if let Some(workspace) = &scenery.workspace {
        rows.always("world/zones/workspace", &outlined(workspace, [120, 150, 190], 110));
    }
    for role in [BodyRole::Live, BodyRole::Twin] {
        style_body(rows, role);
    }
    rows.always("world/standing", &Boxes3D::update_fields().with_fill_mode(FillMode::Solid));
    rows.always("world/contacts", &Arrows3D::update_fields().with_radii([0.003]));
    rows.always("log/audit", &TextLog::update_fields().with_color(theme::solid([200, 206, 214])));
}

/// Colors and sizes of a body, which never change.
fn style_body(rows: &mut PendingRows, role: BodyRole) {
    let root = role.root();
    let (arm, joint, hand, path) = match role {
        BodyRole::Live => (
            theme::solid([205, 210, 218]),
            theme::solid([70, 140, 255]),
            theme::solid([60, 66, 76]),
            theme::solid([70, 140, 255]),
        ),
        BodyRole::Twin => (
            theme::ghost([255, 150, 40], 70),
            theme::ghost([255, 150, 40], 110),
            theme::ghost([255, 150, 40], 90),
            theme::ghost([255, 150, 40], 160),
        ),
    };
    let arm = Capsules3D::update_fields()
        .with_radii([role.link_m()])
        .with_colors([arm])
        .with_fill_mode(FillMode::Solid);
    rows.always(&format!("{root}/arm/links"), &arm);
    let joints = Points3D::update_fields().with_radii([role.link_m() + 0.004]).with_colors([joint]);
    rows.always(&format!("{root}/arm/joints"), &joints);
    let pads = Boxes3D::update_fields().with_colors([hand]).with_fill_mode(FillMode::Solid);
    rows.always(&format!("{root}/gripper"), &pads);
    rows.always(&format!("{root}/object"), &Boxes3D::update_fields().with_fill_mode(FillMode::Solid));
    let path = LineStrips3D::update_fields().with_radii([0.0025]).with_colors([path]);
    rows.always(&format!("{root}/path"), &path);
}

/// The edges of a region.
fn outlined(region: &Region, rgb: [u8; 3], alpha: u8) -> Boxes3D {
    boxed(region)
        .with_colors([theme::ghost(rgb, alpha)])
        // In points of the screen: an edge close to the camera stays a line.
        .with_radii([Radius::new_ui_points(1.0)])
        .with_fill_mode(FillMode::MajorWireframe)
}

fn boxed(region: &Region) -> Boxes3D {
    let combined = |combine: fn(f32, f32) -> f32| {
        let [x, y, z] = region.min;
        let [to_x, to_y, to_z] = region.max;
        [combine(x, to_x), combine(y, to_y), combine(z, to_z)]
    };
    let center = combined(f32::midpoint);
    let half = combined(|min, max| ((max - min) / 2.0).abs());
    Boxes3D::from_centers_and_half_sizes([center], [half])
}
