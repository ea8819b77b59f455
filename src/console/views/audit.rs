//! View.

use ratatui::layout::Rect;

use crate::console::model::Model;
use crate::console::widgets::pen::Pen;

/// Draws it.
pub fn draw(_model: &Model, _pen: &mut Pen<'_>, _area: Rect) {}
