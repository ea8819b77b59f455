//! The renderer: only frames reach the terminal, each in one write and as one update.
//!
//! Must not choose what is drawn, and never asks the terminal anything while keys are read: a cursor report would
//! never arrive.

use std::cell::Cell;
use std::fs::File;
use std::io::{self, Write};
use std::rc::Rc;

use ratatui::Terminal;
use ratatui::backend::CrosstermBackend;
use ratatui::buffer::Buffer;
use ratatui::crossterm::queue;
use ratatui::crossterm::style::force_color_output;
use ratatui::crossterm::terminal::{BeginSynchronizedUpdate, EndSynchronizedUpdate};
use ratatui::layout::Rect;

use crate::terminal::modes;

/// The reserved size of a frame, bytes: a full screen of 200x60 with styles.
const FRAME_BYTES: usize = 64 * 1024;

/// Collects a frame and writes it at once; flushes in between are ignored.
struct FrameWriter {
    tty: File,
    frame: Vec<u8>,
    held: Rc<Cell<bool>>,
}

impl Write for FrameWriter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.frame.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        if self.held.get() {
            return Ok(());
        }
        if !modes::is_on() {
            // The terminal is restored: the rest of a frame and the library's cleanup must not reach it.
            self.frame.clear();
            return Ok(());
        }
        let written = self.tty.write_all(&self.frame);
        // A frame that could not be written is lost with its terminal.
        self.frame.clear();
        written
    }
}

pub struct Screen {
    terminal: Terminal<CrosstermBackend<FrameWriter>>,
    held: Rc<Cell<bool>>,
}

impl Screen {
    /// A screen on stdout.
    ///
    /// # Errors
    /// If stdout cannot be duplicated or the terminal does not report its size.
    pub fn new() -> io::Result<Self> {
        // The look decides about colors, `NO_COLOR` included; the library's own way would erase bold and reverse.
        force_color_output(true);
        let tty = File::from(rustix::io::fcntl_dupfd_cloexec(rustix::stdio::stdout(), 3)?);
        let held = Rc::new(Cell::new(false));
        let writer = FrameWriter { tty, frame: Vec::with_capacity(FRAME_BYTES), held: Rc::clone(&held) };
        Ok(Self { terminal: Terminal::new(CrosstermBackend::new(writer))?, held })
    }

    /// Columns and rows.
    ///
    /// # Errors
    /// If the terminal does not report them.
    pub fn size(&self) -> io::Result<(u16, u16)> {
        self.terminal.size().map(|size| (size.width, size.height))
    }

    /// Draws one frame: `paint` fills the whole buffer.
    ///
    /// # Errors
    /// If the terminal cannot be written to: it is lost.
    pub fn draw(&mut self, paint: impl FnOnce(Rect, &mut Buffer)) -> io::Result<()> {
        self.held.set(true);
        let drawn = self.frame(paint);
        self.held.set(false);
        drawn.and_then(|()| self.terminal.backend_mut().flush())
    }

    fn frame(&mut self, paint: impl FnOnce(Rect, &mut Buffer)) -> io::Result<()> {
        queue!(self.terminal.backend_mut(), BeginSynchronizedUpdate)?;
        self.terminal.draw(|frame| paint(frame.area(), frame.buffer_mut()))?;
        queue!(self.terminal.backend_mut(), EndSynchronizedUpdate)
    }

    /// Redraws the next frame completely: the terminal's size changed, and its contents are unknown.
    ///
    /// # Errors
    /// As [`Screen::draw`].
    pub fn resize(&mut self, columns: u16, rows: u16) -> io::Result<()> {
        self.held.set(true);
        let resized = self.terminal.resize(Rect::new(0, 0, columns, rows));
        self.held.set(false);
        resized
    }

    /// Sends a sequence that changes nothing of what is drawn, like a bell or a copy.
    ///
    /// # Errors
    /// As [`Screen::draw`].
    pub fn send(&mut self, sequence: &[u8]) -> io::Result<()> {
        let backend = self.terminal.backend_mut();
        backend.write_all(sequence)?;
        backend.flush()
    }
}
