//! Controllers of a program that uses Holdpoint as a library, under names of its own.
//!
//! A name stands for the same code as long as the process lasts: versions of a store are loaded by it, today's and those
//! of years ago.

use std::collections::BTreeMap;
use std::sync::{Arc, PoisonError, RwLock};

use holdpoint_governance::ids::is_name;
use holdpoint_governance::text_error::TextError;

use super::SkillBundle;
use super::native::Controller;

/// Loads a controller with the text of its parameter file; the file is only named in errors.
pub type LoadController = fn(file: &str, params: &str) -> Result<Arc<dyn SkillBundle>, TextError>;

/// The most controllers that are provided.
pub const PROVIDED_MAX: usize = 256;

static PROVIDED: RwLock<BTreeMap<String, LoadController>> = RwLock::new(BTreeMap::new());

/// Why a controller cannot be provided under a name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ProvideError {
    /// It is no name.
    #[error("{0:?} is no name of a controller; a-z, 0-9, '.', '_' and '-' are allowed, up to 64 characters")]
    Name(String),
    /// The name stands for other code.
    #[error("there is a controller {0:?} already")]
    Taken(String),
    /// There are as many as can be.
    #[error("{PROVIDED_MAX} controllers are provided, which is the most")]
    Full,
}

/// Makes `native:<name>` in a manifest stand for a controller of this program.
///
/// # Errors
/// [`ProvideError`]; the same code under the same name once more is none.
pub fn provide(name: &str, load: LoadController) -> Result<(), ProvideError> {
    if !is_name(name) {
        return Err(ProvideError::Name(name.to_owned()));
    }
    let mut provided = PROVIDED.write().unwrap_or_else(PoisonError::into_inner);
    let taken = match provided.get(name) {
        Some(known) => !std::ptr::fn_addr_eq(*known, load),
        None => Controller::names().contains(&name),
    };
    if taken {
        return Err(ProvideError::Taken(name.to_owned()));
    }
    if provided.len() >= PROVIDED_MAX {
        return Err(ProvideError::Full);
    }
    provided.insert(name.to_owned(), load);
    Ok(())
}

/// What is provided under a name.
pub(crate) fn provided(name: &str) -> Option<LoadController> {
    PROVIDED.read().unwrap_or_else(PoisonError::into_inner).get(name).copied()
}

/// Every name a manifest may use after `native:`.
pub(crate) fn names() -> Vec<String> {
    let provided = PROVIDED.read().unwrap_or_else(PoisonError::into_inner);
    Controller::names().into_iter().map(str::to_owned).chain(provided.keys().cloned()).collect()
}

#[cfg(test)]
mod tests {
    use holdpoint_body::{Command, Observation, TaskKind};
    use holdpoint_governance::exports::Interface;
    use holdpoint_governance::ids::Digest;

    use super::*;
    use crate::capability::{self, Capability};
    use crate::seeds::SeedKey;
    use crate::skill::native::NativeBundle;
    use crate::skill::{Hook, Skill};

    /// Code from outside: it says what the grasp's code says, and stands still.
    struct StillBundle(NativeBundle);

    struct StillRun;

    impl Skill for StillRun {
        fn tick(&mut self, _: &Observation) -> Command {
            Command::Stop
        }
        fn enter(&mut self, _: Hook) {}
    }

    impl SkillBundle for StillBundle {
        fn digest(&self) -> Digest {
            Digest::of_parts("still", &[])
        }
        fn interface(&self) -> Interface {
            self.0.interface()
        }
        fn task(&self) -> TaskKind {
            TaskKind::Grasp
        }
        fn start(&self, _: u64) -> Box<dyn Skill> {
            Box::new(StillRun)
        }
    }

    #[allow(clippy::unnecessary_wraps, reason = "what loads may fail")]
    fn still(file: &str, params: &str) -> Result<Arc<dyn SkillBundle>, TextError> {
        let Ok(controller) = Controller::parse("grasp", file, params) else { panic!("{file}") };
        Ok(Arc::new(StillBundle(NativeBundle::new(controller).unwrap())))
    }

    fn other(_: &str, _: &str) -> Result<Arc<dyn SkillBundle>, TextError> {
        panic!("never loaded")
    }

    #[test]
    fn one_call_registers_a_controller_from_outside() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../manifests/grasp/1.0.0");
        let mut package = capability::read(&folder).unwrap();
        package.manifest = package.manifest.replace("native:grasp", "native:still");
        let error = Capability::load("still", package.clone()).unwrap_err().to_string();
        assert!(error.contains("native:still") && error.contains("native:park"), "{error}");

        provide("still", still).unwrap();
        provide("still", still).unwrap();
        assert_eq!(provide("still", other), Err(ProvideError::Taken("still".to_owned())));
        assert_eq!(provide("grasp", other), Err(ProvideError::Taken("grasp".to_owned())));
        assert_eq!(provide("No Name", other), Err(ProvideError::Name("No Name".to_owned())));

        let version = Capability::load("still", package).unwrap();
        let native = Capability::read(&folder).unwrap();
        assert_ne!(version.digest(), native.digest());
        assert_eq!(version.bundle.interface(), native.bundle.interface());
        drop(version.start(SeedKey::of_run(1).seed(2)));
    }
}
