//! Turns a compiled module into a component.

use std::fmt::Display;

use wit_component::{ComponentEncoder, StringEncoding, embed_component_metadata};
use wit_parser::Resolve;

/// The first contract.
const WIT: &str = include_str!("../sdk/wit/skill.wit");

/// The second contract.
const WIT_2: &str = include_str!("../sdk/wit/2/skill.wit");

/// The name prefix of what a module of the first contract exports.
const EXPORT_PREFIX_1: &[u8] = b"holdpoint:skill/skill@1.0.0#";

/// The name prefix of the section that names a module's world.
const WORLD_SECTION: &[u8] = b"component-type";

/// Why a module cannot become a component.
#[derive(Debug, thiserror::Error)]
pub enum EncodeError {
    /// It is neither a module nor a component.
    #[error("what the compiler made is no WebAssembly")]
    NotWasm,
    /// The module does not fit the contract.
    #[error("no component can be made of the module: {0}")]
    Module(String),
}

/// Makes a component from a core module; returns a component unchanged.
///
/// # Errors
/// If it is neither, or does not fit the contract: a missing export, one of another type, or an import.
pub fn encode(built: Vec<u8>) -> Result<Vec<u8>, EncodeError> {
    match built.get(..8) {
        Some([0, b'a', b's', b'm', 0x0d, 0, 1, 0]) => return Ok(built),
        Some([0, b'a', b's', b'm', 1, 0, 0, 0]) => {}
        _ => return Err(EncodeError::NotWasm),
    }
    let mut module = built;
    if !contains(&module, WORLD_SECTION) {
        let mut resolve = Resolve::default();
        let wit = if contains(&module, EXPORT_PREFIX_1) { WIT } else { WIT_2 };
        let package = resolve.push_str("skill.wit", wit).map_err(refused)?;
        let world = resolve.select_world(&[package], Some("component")).map_err(refused)?;
        embed_component_metadata(&mut module, &resolve, world, StringEncoding::UTF8).map_err(refused)?;
    }
    ComponentEncoder::default().validate(true).module(&module).and_then(|mut it| it.encode()).map_err(refused)
}

/// The encoder's error with its causes.
fn refused(error: impl Display) -> EncodeError {
    EncodeError::Module(format!("{error:#}"))
}

fn contains(bytes: &[u8], part: &[u8]) -> bool {
    bytes.windows(part.len()).any(|window| window == part)
}
