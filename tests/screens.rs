//! Every screen at every size, as an operator sees it.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test says what it expects by failing"
)]

#[path = "support/console.rs"]
mod support;

use holdpoint::console::frame::text_of;
use holdpoint::console::look::{Depth, Glyphs, Look, Theme};
use holdpoint::console::model::{Model, View};

const SIZES: [(u16, u16); 4] = [(120, 36), (100, 30), (80, 24), (60, 16)];

fn look() -> Look {
    Look::new(Theme::builtin("calm-dark").unwrap(), Depth::True, Glyphs::Unicode)
}

fn shown(model: &Model, (width, height): (u16, u16)) -> String {
    text_of(model, &look(), width, height)
}

#[test]
fn every_view_at_every_size() {
    for view in View::ALL {
        let model = support::at(view);
        for size in SIZES {
            let name = format!("{}_{}x{}", view.title().to_lowercase(), size.0, size.1);
            insta::assert_snapshot!(name, shown(&model, size));
        }
    }
}
