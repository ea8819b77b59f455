//! # The guide
//!
#![allow(clippy::doc_markdown, reason = "the pages are prose: a name of a tool there needs no backticks")]
#![doc = include_str!(concat!(env!("OUT_DIR"), "/src/guide/index.md"))]

include!(concat!(env!("OUT_DIR"), "/guide_pages.rs"));
