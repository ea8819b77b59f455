//! The fixed part of the cell: table, tray, clutter, zones, and what counts as done.
//!
//! Parsed strictly: an unknown key, a number that is not finite or a size that is not above 0 is an
//! error naming the file and the key.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::error::CellError;
use holdpoint_body::Zone;
use holdpoint_body::number::{finite3, positive};

use crate::number::{parse_toml, read_text};

/// A static box.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Table {
    /// Center, m.
    #[serde(deserialize_with = "finite3")]
    pub centre_m: [f64; 3],
    /// Half extents, m.
    #[serde(deserialize_with = "finite3")]
    pub half_m: [f64; 3],
    /// Coulomb coefficient.
    #[serde(deserialize_with = "positive")]
    pub friction: f64,
}

/// The cube that is handled.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectShape {
    /// Half the edge, m.
    #[serde(deserialize_with = "positive")]
    pub half_m: f64,
}

/// The tray the cube belongs in. Its frame: center of the floor's upper face, x along a wall.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tray {
    /// Free play between object and wall, each side, m.
    #[serde(deserialize_with = "positive")]
    pub clearance_m: f64,
    /// Thickness of the floor, m.
    #[serde(deserialize_with = "positive")]
    pub floor_m: f64,
    /// Height of the walls' top above the table, m.
    #[serde(deserialize_with = "positive")]
    pub wall_top_m: f64,
    /// Thickness of a wall, m.
    #[serde(deserialize_with = "positive")]
    pub wall_m: f64,
    /// Coulomb coefficient.
    #[serde(deserialize_with = "positive")]
    pub friction: f64,
}

/// A box that may stand on the table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Clutter {
    /// Name.
    pub name: String,
    /// Position, m.
    pub centre_xy_m: [f64; 2],
    /// Half extents, m.
    #[serde(deserialize_with = "finite3")]
    pub half_m: [f64; 3],
}

/// What the end-of-task inspection accepts.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tolerance {
    /// Least rise of a lifted object, m.
    #[serde(deserialize_with = "positive")]
    pub lift_m: f64,
    /// Largest displacement in the hand since the grip closed, m.
    #[serde(deserialize_with = "positive")]
    pub in_hand_m: f64,
    /// Largest horizontal error over the tray, m.
    #[serde(deserialize_with = "positive")]
    pub align_xy_m: f64,
    /// Largest yaw error over the tray, modulo the cube's quarter turn, rad.
    #[serde(deserialize_with = "positive")]
    pub align_yaw_rad: f64,
    /// Height of the object above its seat when it hovers, m.
    #[serde(deserialize_with = "positive")]
    pub hover_m: f64,
    /// Largest deviation from that height, m.
    #[serde(deserialize_with = "positive")]
    pub hover_band_m: f64,
    /// Speed below which the object is still, m/s.
    #[serde(deserialize_with = "positive")]
    pub still_m_s: f64,
    /// Largest tilt of the placed object, rad.
    #[serde(deserialize_with = "positive")]
    pub place_tilt_rad: f64,
    /// Largest height error of the placed object, m.
    #[serde(deserialize_with = "positive")]
    pub place_height_m: f64,
    /// Least distance of the tool from its place at the seated object, m.
    #[serde(deserialize_with = "positive")]
    pub place_clear_m: f64,
}

/// The cell.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// Version of the file's format; 1.
    pub format: u32,
    /// Name.
    pub name: String,
    /// The bench.
    pub table: Table,
    /// The cube.
    pub object: ObjectShape,
    /// The tray.
    pub tray: Tray,
    /// What may stand in the way.
    #[serde(default)]
    pub clutter: Vec<Clutter>,
    /// Zones, first match wins.
    #[serde(default, rename = "zone")]
    pub zones: Vec<Zone>,
    /// Acceptance.
    pub tolerance: Tolerance,
}

/// The most clutter and zones a scene may have.
const LIST_MAX: usize = 16;

impl Scene {
    /// A scene from a file.
    ///
    /// # Errors
    /// [`CellError::File`] naming the file and the key.
    pub fn load(path: &Path) -> Result<Self, CellError> {
        Self::from_toml(&path.display().to_string(), &read_text(path)?)
    }

    /// A scene from a TOML text; `file` is used in errors.
    ///
    /// # Errors
    /// [`CellError::File`] naming the file and the key.
    pub fn from_toml(file: &str, text: &str) -> Result<Self, CellError> {
        let scene: Self = parse_toml(file, text)?;
        scene.check(file)?;
        Ok(scene)
    }

    /// Checks what the types cannot; `file` is used in errors.
    ///
    /// # Errors
    /// [`CellError::File`] naming the file and the key.
    pub fn check(&self, file: &str) -> Result<(), CellError> {
        if self.format != 1 {
            return Err(CellError::file(
                file,
                "format",
                format!("\"{}\" is not known; this build reads 1", self.format),
            ));
        }
        if self.clutter.len() > LIST_MAX || self.zones.len() > LIST_MAX {
            let problem = format!(
                "\"{}\" clutter and \"{}\" zones; at most {LIST_MAX} each",
                self.clutter.len(),
                self.zones.len()
            );
            return Err(CellError::file(file, "clutter and zone", problem));
        }
        let boxes = self.clutter.iter().map(|c| (format!("clutter \"{}\"", c.name), c.half_m));
        for (element, half) in boxes.chain([("table".to_owned(), self.table.half_m)]) {
            if half.iter().any(|v| *v <= 0.0) {
                return Err(CellError::file(
                    file,
                    element,
                    format!("half_m \"{half:?}\": every value must be above 0"),
                ));
            }
        }
        for clutter in &self.clutter {
            if clutter.centre_xy_m.iter().any(|v| !v.is_finite()) {
                let problem = format!("centre_xy_m \"{:?}\" is not finite", clutter.centre_xy_m);
                return Err(CellError::file(file, format!("clutter \"{}\"", clutter.name), problem));
            }
        }
        for (i, zone) in self.zones.iter().enumerate() {
            let element = format!("zone \"{}\"", zone.name);
            if (0..3).any(|k| zone.min_m[k] >= zone.max_m[k]) {
                let problem = format!(
                    "min_m \"{:?}\" must lie below max_m \"{:?}\" on every axis",
                    zone.min_m, zone.max_m
                );
                return Err(CellError::file(file, element, problem));
            }
            if self.zones.iter().take(i).any(|other| other.name == zone.name) {
                return Err(CellError::file(file, element, "is defined twice"));
            }
        }
        if self.tray.wall_top_m <= self.tray.floor_m {
            let problem = format!(
                "wall_top_m \"{}\" must lie above floor_m {}",
                self.tray.wall_top_m, self.tray.floor_m
            );
            return Err(CellError::file(file, "tray", problem));
        }
        Ok(())
    }

    /// A zone by name.
    #[must_use]
    pub fn zone(&self, name: &str) -> Option<&Zone> {
        holdpoint_body::zone::named(&self.zones, name)
    }

    /// Height of the highest thing that stands on the table, tray or clutter, above the table, m.
    #[must_use]
    pub fn tallest_m(&self) -> f64 {
        self.clutter.iter().map(|piece| 2.0 * piece.half_m[2]).fold(self.tray.wall_top_m, f64::max)
    }

    /// Height of the object's center when it is seated in the tray, m.
    #[must_use]
    pub fn seat_height_m(&self) -> f64 {
        self.tray.floor_m + self.object.half_m
    }
}
