//! Makes a component of a core module that exports a skill, with WASI's preview 1 adapted: for the guests of tests.
//!
//!     cargo run -p holdpoint-component --example encode_guest -- CORE.wasm OUT.wasm

use wasi_preview1_component_adapter_provider::{
    WASI_SNAPSHOT_PREVIEW1_ADAPTER_NAME, WASI_SNAPSHOT_PREVIEW1_REACTOR_ADAPTER,
};
use wit_component::{ComponentEncoder, StringEncoding, embed_component_metadata};
use wit_parser::Resolve;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut names = std::env::args().skip(1);
    let (Some(from), Some(to)) = (names.next(), names.next()) else {
        return Err("two names are needed: the core module, and the component to make".into());
    };
    let mut resolve = Resolve::default();
    let package = resolve.push_str("skill.wit", include_str!("../../sdk/wit/skill.wit"))?;
    let world = resolve.select_world(&[package], Some("component"))?;
    let mut core = std::fs::read(from)?;
    embed_component_metadata(&mut core, &resolve, world, StringEncoding::UTF8)?;
    let component = ComponentEncoder::default()
        .module(&core)?
        .adapter(WASI_SNAPSHOT_PREVIEW1_ADAPTER_NAME, WASI_SNAPSHOT_PREVIEW1_REACTOR_ADAPTER)?
        .encode()?;
    std::fs::write(to, component)?;
    Ok(())
}
