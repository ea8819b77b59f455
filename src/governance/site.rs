//! The site file: the robot, the live cell and the trial cells, the families with their baselines, and the profile.
//!
//! Owns the text form (TOML, unknown fields refused), its limits and the digest. Opens no file: a path in it is a text,
//! relative to the file's folder.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::Path;

use holdpoint_body::task::{SEQUENCE_ALLOWED, is_sequence};
use holdpoint_body::{FURTHER_OBJECTS_MAX, FurtherObject, FurtherProblem, OBJECT_NAME_BYTES_MAX, TaskKind};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::ids::{Digest, Family, is_name};
use super::profile::ProfileName;
use super::text_error::{TextError, check_size, parse_toml};

/// The largest text of a site file, bytes; checked before it is parsed.
pub const SITE_BYTES_MAX: usize = 64 * 1024;

/// The most families of a site file.
pub const SITE_FAMILIES_MAX: usize = 64;

/// The longest path in a site file, bytes.
pub const SITE_PATH_BYTES_MAX: usize = 1024;

crate::closed_set! {
    /// An implementation of a cell.
    CellKind, "kind of cell", {
        /// The simulator of this program.
        Simulated = "simulated",
        /// Another process, which speaks the cell protocol.
        Wire = "wire",
    }
}

/// What an engine is started with: robot, cells, families and profile.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Site {
    /// A built-in robot by its name, or a URDF file.
    pub robot: String,
    /// A built-in profile by its name, or the TOML file of another one.
    pub profile: String,
    /// The tasks of a simulated cell, in their order; absent for those of the built-in cell.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(with = "Option<Vec<String>>")]
    pub sequence: Option<Vec<TaskKind>>,
    /// The further objects of a simulated cell, by their names in observations.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub objects: BTreeMap<String, FurtherObject>,
    /// The cell in which the active versions work.
    pub live: SiteCell,
    /// The cell of sandbox, drills and the twin in shadow.
    pub trial: SiteCell,
    /// The families with their first versions, in the order in which a new store registers them.
    pub families: Vec<SiteFamily>,
}

/// A cell of a site.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SiteCell {
    /// Its implementation. The simulated one has no settings.
    pub kind: CellKind,
    /// Where a cell of the kind `wire` is: `unix:PATH` or `tcp:ADDRESS:PORT`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub endpoint: Option<String>,
}

/// A family of a site.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SiteFamily {
    /// Its name, as the manifest of the baseline has it.
    pub name: Family,
    /// The folder of its first version.
    pub baseline: String,
    /// The family that takes over after an abort, as the manifest of the baseline binds it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fallback: Option<Family>,
}

impl Site {
    /// The file and the text of the site that comes with the program.
    pub const SHIPPED: (&'static str, &'static str) =
        ("manifests/site.toml", include_str!("../../manifests/site.toml"));

    /// Parses and checks; `file` is its name in errors.
    ///
    /// # Errors
    /// [`TextError`], the first there is.
    pub fn parse(file: &str, text: &str) -> Result<Self, TextError> {
        check_size(file, text, SITE_BYTES_MAX)?;
        let site: Self = parse_toml(file, text).map_err(|error| unknown_kind(file, text).unwrap_or(error))?;
        site.check(file, text)?;
        Ok(site)
    }

    /// The site that comes with the program.
    ///
    /// # Errors
    /// Never: a test parses it.
    pub fn shipped() -> Result<Self, TextError> {
        let (file, text) = Self::SHIPPED;
        Self::parse(file, text)
    }

    /// The robot's URDF file; absent for a built-in robot.
    #[must_use]
    pub fn robot_file(&self) -> Option<&str> {
        has_extension(&self.robot, "urdf").then_some(self.robot.as_str())
    }

    fn profile_file(&self) -> Option<&str> {
        has_extension(&self.profile, "toml").then_some(self.profile.as_str())
    }

    /// SHA-256 over every value. The files that it names have digests of their own.
    ///
    /// # Errors
    /// Never for a parsed site: it holds texts and finite numbers only.
    pub fn digest(&self) -> Result<Digest, serde_json::Error> {
        Digest::of_json("holdpoint.site.v1", self)
    }

    /// The published JSON Schema of a site file.
    #[must_use]
    pub fn json_schema() -> serde_json::Value {
        schemars::schema_for!(Self).to_value()
    }

    fn check(&self, file: &str, text: &str) -> Result<(), TextError> {
        let refuse = |field: &str, value: &str, allowed: &str| {
            Err(TextError::value(file, text, field, value, allowed))
        };
        match self.robot_file() {
            Some(path) if !is_path(path) => return refuse("robot", path, &path_allowed()),
            None if !is_name(&self.robot) => {
                return refuse("robot", &self.robot, "the name of a built-in robot, or a URDF file");
            }
            Some(_) | None => {}
        }
        match self.profile_file() {
            Some(path) if !is_path(path) => return refuse("profile", path, &path_allowed()),
            None if self.profile.parse::<ProfileName>().is_err() => {
                let allowed = format!("{}, or the TOML file of a profile", ProfileName::NAMES.join(", "));
                return refuse("profile", &self.profile, &allowed);
            }
            Some(_) | None => {}
        }
        let cells = check_cell("live", &self.live).and_then(|()| self.check_trial());
        if let Err((field, value, allowed)) = cells {
            return refuse(&field, &value, allowed);
        }
        if let Some((field, value, allowed)) = self.object_problem() {
            return refuse(&field, &value, &allowed);
        }
        if self.families.len() > SITE_FAMILIES_MAX {
            let allowed = format!("up to {SITE_FAMILIES_MAX} families");
            return refuse("families", &format!("{} families", self.families.len()), &allowed);
        }
        for (index, family) in self.families.iter().enumerate() {
            self.check_family(index, family).map_err(|(field, value, allowed)| {
                family_error(file, text, (index, family), &field, &value, &allowed)
            })?;
        }
        // The tasks of a cell of another process are checked where it is connected.
        let tasks: &[TaskKind] = match (self.live.kind, &self.sequence) {
            (CellKind::Simulated, None) => &TaskKind::SEQUENCE,
            (CellKind::Simulated, Some(tasks)) if is_sequence(tasks) => tasks,
            (CellKind::Simulated, Some(tasks)) => {
                return refuse("sequence", &format!("{tasks:?}"), SEQUENCE_ALLOWED);
            }
            (CellKind::Wire, None) => &[],
            (CellKind::Wire, Some(tasks)) => {
                let allowed = "none: a cell of another process states its tasks itself";
                return refuse("sequence", &format!("{tasks:?}"), allowed);
            }
        };
        let tasks: Vec<Family> = tasks.iter().copied().map(Family::from).collect();
        if tasks.iter().any(|task| !self.families.iter().any(|family| family.name == *task)) {
            let listed = names(self.families.iter().map(|family| &family.name));
            let allowed = format!("a family for each task: {}", names(tasks.iter()));
            return refuse("families", &listed, &allowed);
        }
        Ok(())
    }

    /// Field, value and what is allowed of the first problem of a further object.
    fn object_problem(&self) -> Option<(String, String, String)> {
        let most = match self.live.kind {
            CellKind::Simulated => FURTHER_OBJECTS_MAX,
            CellKind::Wire => 0,
        };
        let count = self.objects.len();
        if count > most {
            let allowed = match self.live.kind {
                CellKind::Simulated => format!("up to {most} objects"),
                CellKind::Wire => "none: a cell of another process states its objects itself".to_owned(),
            };
            return Some(("objects".to_owned(), format!("{count} objects"), allowed));
        }
        let of_tasks = TaskKind::ALL.map(TaskKind::declaration).map(|task| [task.object, task.target]);
        let of_tasks = of_tasks.as_flattened();
        self.objects.iter().find_map(|(name, object)| {
            let field = format!("objects.{name}");
            if !is_name(name) || name.len() > OBJECT_NAME_BYTES_MAX || of_tasks.contains(&name.as_str()) {
                let allowed = format!(
                    "1 to {OBJECT_NAME_BYTES_MAX} of a-z, 0-9, ., _ and -, with a letter or digit first; not the name \
                     of a task's object"
                );
                return Some((field, name.clone(), allowed));
            }
            let FurtherProblem { field: own, value, allowed } = object.problem()?;
            Some((format!("{field}.{own}"), value, allowed))
        })
    }

    /// As [`check_cell`]: trial cells continue from states of the live cell, so both are at one place.
    fn check_trial(&self) -> Result<(), (String, String, &'static str)> {
        check_cell("trial", &self.trial)?;
        if self.trial.kind != self.live.kind {
            return Err(("trial.kind".to_owned(), self.trial.kind.to_string(), "the kind of the live cell"));
        }
        match &self.trial.endpoint {
            Some(endpoint) if self.live.endpoint.as_ref() != Some(endpoint) => {
                Err(("trial.endpoint".to_owned(), endpoint.clone(), "the endpoint of the live cell"))
            }
            Some(_) | None => Ok(()),
        }
    }

    /// Field, value and what is allowed of the first problem of a family.
    fn check_family(&self, index: usize, family: &SiteFamily) -> Result<(), (String, String, String)> {
        let above = || self.families.iter().take(index).map(|other| &other.name);
        if above().any(|name| *name == family.name) {
            let allowed = "each family once".to_owned();
            return Err(("name".to_owned(), family.name.to_string(), allowed));
        }
        if !is_path(&family.baseline) {
            return Err(("baseline".to_owned(), family.baseline.clone(), path_allowed()));
        }
        match &family.fallback {
            Some(fallback) if !above().any(|name| name == fallback) => {
                let allowed = format!("a family that stands above: {}", names(above()));
                Err(("fallback".to_owned(), fallback.to_string(), allowed))
            }
            Some(_) | None => Ok(()),
        }
    }
}

/// A value of a family that is not allowed, with the line of the family's table.
#[must_use]
pub fn family_error(
    file: &str,
    text: &str,
    (index, family): (usize, &SiteFamily),
    field: &str,
    value: &str,
    allowed: &str,
) -> TextError {
    let headers = text.lines().enumerate().filter(|(_, line)| line.trim_start().starts_with("[[families]]"));
    TextError::Value {
        file: file.to_owned(),
        line: headers.map(|(line, _)| line + 1).nth(index).unwrap_or(1),
        field: format!("families.{}.{field}", family.name),
        value: value.to_owned(),
        allowed: allowed.to_owned(),
    }
}

/// The error of a text that names a kind of cell that this program does not have. Its settings are then unknown, too.
fn unknown_kind(file: &str, text: &str) -> Option<TextError> {
    let table: toml::Table = toml::from_str(text).ok()?;
    ["live", "trial"].into_iter().find_map(|cell| {
        let kind = table.get(cell)?.get("kind")?.as_str()?;
        let error = kind.parse::<CellKind>().err()?;
        Some(TextError::value(file, text, &format!("{cell}.kind"), kind, &error.allowed))
    })
}

fn has_extension(path: &str, extension: &str) -> bool {
    Path::new(path).extension().is_some_and(|own| own == extension)
}

fn is_path(path: &str) -> bool {
    !path.is_empty() && path.len() <= SITE_PATH_BYTES_MAX && !path.contains(char::is_control)
}

/// What the endpoint of a cell may be.
const ENDPOINT_ALLOWED: &str =
    "unix: with an absolute path of up to 107 bytes, or tcp: with an address of this machine and a port";

fn is_endpoint(text: &str) -> bool {
    if let Some(path) = text.strip_prefix("unix:") {
        return is_path(path) && path.len() <= 107 && Path::new(path).is_absolute();
    }
    let address = text.strip_prefix("tcp:").and_then(|rest| rest.parse::<SocketAddr>().ok());
    address.is_some_and(|address| address.ip().is_loopback())
}

fn path_allowed() -> String {
    format!("a path of 1 to {SITE_PATH_BYTES_MAX} bytes without control characters")
}

fn names<'a>(families: impl Iterator<Item = &'a Family>) -> String {
    let names: Vec<&str> = families.map(Family::as_str).collect();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

/// Field, value and what is allowed of the problem of a cell.
fn check_cell(name: &str, cell: &SiteCell) -> Result<(), (String, String, &'static str)> {
    let problem = |value: &str, allowed| Err((format!("{name}.endpoint"), value.to_owned(), allowed));
    match (cell.kind, cell.endpoint.as_deref()) {
        (CellKind::Simulated, None) => Ok(()),
        (CellKind::Simulated, Some(endpoint)) => problem(endpoint, "none: a simulated cell has no endpoint"),
        (CellKind::Wire, Some(endpoint)) if is_endpoint(endpoint) => Ok(()),
        (CellKind::Wire, endpoint) => problem(endpoint.unwrap_or("none"), ENDPOINT_ALLOWED),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shipped() -> &'static str {
        Site::SHIPPED.1
    }

    #[test]
    fn the_shipped_site_is_the_built_in_cell() {
        let site = Site::shipped().unwrap();
        assert_eq!((site.robot.as_str(), site.robot_file()), ("arm7", None));
        assert_eq!((site.profile.as_str(), site.profile_file()), ("sim", None));
        assert_eq!((site.live.kind, site.trial.kind), (CellKind::Simulated, CellKind::Simulated));
        let families: Vec<(&str, Option<&str>)> = site
            .families
            .iter()
            .map(|family| (family.name.as_str(), family.fallback.as_ref().map(Family::as_str)))
            .collect();
        let park = Some("park");
        assert_eq!(families, [("park", None), ("grasp", park), ("align", park), ("place", park)]);
    }

    #[test]
    fn the_digest_covers_the_values_and_not_the_text() {
        let digest = |text: &str| Site::parse("site.toml", text).unwrap().digest().unwrap();
        let spaced = shipped().replace("robot = \"arm7\"", "robot    =    \"arm7\" # seven joints");
        assert_eq!(digest(&spaced), digest(shipped()));
        for (from, to) in [
            ("\"arm7\"", "\"arm6\""),
            ("\"sim\"", "\"real\""),
            ("\"grasp/1.0.0\"", "\"grasp/1.0.1\""),
            ("baseline = \"align/1.0.0\"\nfallback = \"park\"", "baseline = \"align/1.0.0\""),
        ] {
            assert_ne!(digest(&shipped().replace(from, to)), digest(shipped()), "{to}");
        }
    }

    /// Each wrong value gets one error that names file, line, field, value and what is allowed.
    #[test]
    fn wrong_values_are_refused_by_field() {
        let long = format!("\"{}.urdf\"", "x".repeat(SITE_PATH_BYTES_MAX));
        for (from, to, field, value) in [
            ("\"simulated\"", "\"bridge\"", "live.kind", "bridge"),
            (
                "[trial]\nkind = \"simulated\"",
                "[trial]\nkind = \"bridge\"\naddress = \"x\"",
                "trial.kind",
                "bridge",
            ),
            (
                "kind = \"simulated\"",
                "kind = \"wire\"\nendpoint = \"tcp:192.168.0.4:7001\"",
                "live.endpoint",
                "tcp:192.168.0.4:7001",
            ),
            (
                "kind = \"simulated\"",
                "kind = \"wire\"\nendpoint = \"unix:cell.sock\"",
                "live.endpoint",
                "unix:cell.sock",
            ),
            (
                "kind = \"simulated\"",
                "kind = \"simulated\"\nendpoint = \"unix:/run/cell.sock\"",
                "live.endpoint",
                "unix:/run/cell.sock",
            ),
            ("\"arm7\"", "\"Arm 7\"", "robot", "Arm 7"),
            ("\"arm7\"", long.as_str(), "robot", "xx"),
            ("\"sim\"", "\"moon\"", "profile", "moon"),
            ("name = \"grasp\"", "name = \"park\"", "families.park.name", "park"),
            ("\"place/1.0.0\"", "\"\"", "families.place.baseline", ""),
            ("fallback = \"park\"", "fallback = \"place\"", "families.grasp.fallback", "place"),
            ("name = \"place\"", "name = \"put\"", "families", "park, grasp, align, put"),
        ] {
            let text = shipped().replacen(from, to, 1);
            assert_ne!(text, shipped(), "{to}");
            let error = Site::parse("site.toml", &text).unwrap_err();
            let TextError::Value { line, field: named, value: shown, allowed, .. } = &error else {
                panic!("{to}: {error}");
            };
            assert_eq!(named, field, "{error}");
            assert!(shown.starts_with(value) && !allowed.is_empty(), "{error}");
            let own = text.lines().nth(line - 1).unwrap();
            let last = field.rsplit('.').next().unwrap();
            assert!(own.starts_with("[[families]]") || own.starts_with(last), "{error}: {own}");
        }
    }

    /// A site without a sequence has the digest of before there were any.
    #[test]
    fn the_families_needed_are_those_of_the_sequence() {
        let of = |sequence: &str, from: &str, to: &str| {
            let text = format!("sequence = {sequence}\n{}", shipped().replace(from, to));
            Site::parse("site.toml", &text)
        };
        let without_align = of("[\"grasp\", \"place\"]", "name = \"align\"", "name = \"wipe\"").unwrap();
        assert_eq!(without_align.sequence, Some(vec![TaskKind::Grasp, TaskKind::Place]));
        assert_ne!(without_align.digest().unwrap(), Site::shipped().unwrap().digest().unwrap());
        let text = serde_json::to_string(&Site::shipped().unwrap()).unwrap();
        assert!(!text.contains("sequence"), "{text}");
        let live = "kind = \"simulated\"";
        let wire = "kind = \"wire\"\nendpoint = \"unix:/run/cell.sock\"";
        for (sequence, from, to, field) in [
            ("[\"align\", \"place\"]", "", "", "sequence"),
            ("[]", "", "", "sequence"),
            ("[\"grasp\", \"align\"]", "name = \"align\"", "name = \"wipe\"", "families"),
            ("[\"grasp\", \"place\"]", live, wire, "sequence"),
        ] {
            let error = of(sequence, from, to).unwrap_err();
            assert!(matches!(&error, TextError::Value { field: named, .. } if named == field), "{error}");
        }
        assert!(matches!(of("[\"wipe\"]", "", ""), Err(TextError::Syntax { .. })));
    }

    /// A site without further objects has the digest of before there were any.
    #[test]
    fn further_objects_are_named_and_checked_field_by_field() {
        const LID: &str = "\n[objects.lid]\nshape = { box = { half_m = [0.03, 0.02, 0.01] } }\nmass_kg = 0.2\n\
                           friction = 0.5\nx_m = [0.4, 0.5]\ny_m = [0.0, 0.0]\nyaw_rad = [-0.5, 0.5]\n";
        let of = |objects: &str| Site::parse("site.toml", &format!("{}{objects}", shipped()));
        let site = of(LID).unwrap();
        assert_eq!(site.objects["lid"].shape.half_m(), [0.03, 0.02, 0.01]);
        assert_ne!(site.digest().unwrap(), Site::shipped().unwrap().digest().unwrap());
        assert_ne!(site.digest().unwrap(), of(&LID.replace("0.2", "0.3")).unwrap().digest().unwrap());
        let text = serde_json::to_string(&Site::shipped().unwrap()).unwrap();
        assert!(!text.contains("objects"), "{text}");
        for (from, to, field) in [
            ("[objects.lid]", "[objects.tray]", "objects.tray"),
            ("[objects.lid]", "[objects.Lid]", "objects.Lid"),
            ("[objects.lid]", "[objects.seventeen-letters]", "objects.seventeen-letters"),
            ("mass_kg = 0.2", "mass_kg = nan", "objects.lid.mass_kg"),
            ("friction = 0.5", "friction = 9.0", "objects.lid.friction"),
            ("[0.03, 0.02, 0.01]", "[0.03, 0.02, 0.0001]", "objects.lid.shape"),
            ("x_m = [0.4, 0.5]", "x_m = [0.5, 0.4]", "objects.lid.x_m"),
        ] {
            let text = LID.replacen(from, to, 1);
            assert_ne!(text, LID, "{to}");
            let error = of(&text).unwrap_err();
            let TextError::Value { line, field: named, value, allowed, .. } = &error else {
                panic!("{to}: {error}");
            };
            assert_eq!(named, field, "{error}");
            assert!(!value.is_empty() && !allowed.is_empty() && *line > shipped().lines().count(), "{error}");
        }
        let many: String = (0..7).map(|number| LID.replace("lid", &format!("box-{number}"))).collect();
        let wire =
            shipped().replace("kind = \"simulated\"", "kind = \"wire\"\nendpoint = \"unix:/run/cell.sock\"");
        for error in [of(&many), Site::parse("site.toml", &format!("{wire}{LID}"))].map(Result::unwrap_err) {
            assert!(matches!(&error, TextError::Value { field, .. } if field == "objects"), "{error}");
        }
        for text in [format!("{LID}{LID}"), LID.replace("box", "ball"), LID.replace("mass_kg", "mass")] {
            assert!(matches!(of(&text), Err(TextError::Syntax { .. })), "{text}");
        }
    }

    /// Trial cells continue from states of the live cell.
    #[test]
    fn cells_over_the_wire_are_at_one_endpoint() {
        let of = |trial: &str| {
            let live = "kind = \"wire\"\nendpoint = \"unix:/run/cell.sock\"";
            let text = shipped().replacen("kind = \"simulated\"", live, 1);
            Site::parse("site.toml", &text.replacen("kind = \"simulated\"", trial, 1))
        };
        let site = of("kind = \"wire\"\nendpoint = \"unix:/run/cell.sock\"").unwrap();
        assert_eq!((site.live.kind, &site.live), (CellKind::Wire, &site.trial));
        assert_eq!(site.live.endpoint.as_deref(), Some("unix:/run/cell.sock"));
        for (trial, field) in [
            ("kind = \"simulated\"", "trial.kind"),
            ("kind = \"wire\"", "trial.endpoint"),
            ("kind = \"wire\"\nendpoint = \"tcp:127.0.0.1:7001\"", "trial.endpoint"),
        ] {
            let error = of(trial).unwrap_err();
            assert!(matches!(&error, TextError::Value { field: named, .. } if named == field), "{error}");
        }
    }

    #[test]
    fn unknown_fields_and_long_texts_are_refused() {
        for (from, to) in [
            ("robot =", "tint = \"red\"\nrobot ="),
            ("kind = \"simulated\"", "kind = \"simulated\"\naddress = \"x\""),
            ("name = \"park\"", "name = \"park\"\nweight = 1"),
            ("robot = \"arm7\"\n", ""),
            ("name = \"park\"", "name = \"Park\""),
        ] {
            let text = shipped().replacen(from, to, 1);
            assert_ne!(text, shipped(), "{to}");
            let error = Site::parse("site.toml", &text).unwrap_err();
            assert!(matches!(error, TextError::Syntax { .. }), "{to}: {error}");
        }
        let huge = format!("{}# {}\n", shipped(), "x".repeat(SITE_BYTES_MAX));
        assert!(matches!(Site::parse("site.toml", &huge), Err(TextError::TooLarge { .. })));
        let family = |number: usize| format!("[[families]]\nname = \"more-{number}\"\nbaseline = \"x\"\n");
        let many: String = (0..SITE_FAMILIES_MAX).map(family).collect();
        let error = Site::parse("site.toml", &format!("{}{many}", shipped())).unwrap_err();
        assert!(matches!(&error, TextError::Value { field, .. } if field == "families"), "{error}");
    }
}
