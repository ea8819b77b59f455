//! A movie of terminal screens as one SVG: text, colors, and a strip of frames that CSS moves.
//!
//! Equal lines of several frames are stored once. The file has no script, so that a forge shows it in a page.

use std::collections::HashMap;

use vt100::{Cell, Color, Screen};

/// Columns and rows of every screen.
pub const SIZE: (u16, u16) = (100, 30);

/// Width of a column, px.
const COLUMN: usize = 8;

/// Height of a line, px.
const LINE: usize = 17;

/// Depth of the baseline below the top of a line, px.
const BASELINE: usize = 13;

/// Size of the letters: a column of a common monospaced font is three fifths of it.
const FONT_SIZE: &str = "13.33px";

const MONOSPACED: &str = "ui-monospace,SFMono-Regular,Menlo,Consolas,'DejaVu Sans Mono',monospace";

const SANS_SERIF: &str = "system-ui,-apple-system,'Segoe UI','DejaVu Sans',sans-serif";

/// Space at the left and the right of the screen, px.
const MARGIN: usize = 16;

/// Height of the title bar, px.
const TITLE_BAR: usize = 36;

/// Height of the caption below the screen, px.
const CAPTION: usize = 46;

/// A color in red, green and blue.
type Rgb = [u8; 3];

const FOREGROUND: Rgb = [0xd8, 0xdc, 0xe2];

const BACKGROUND: Rgb = [0x16, 0x1a, 0x20];

/// The frame round the screen.
const FRAME: Rgb = [0x0d, 0x10, 0x14];

/// The buttons in the title bar.
const BUTTONS: [Rgb; 3] = [[0xff, 0x5f, 0x57], [0xfe, 0xbc, 0x2e], [0x28, 0xc8, 0x40]];

/// The first colors of a terminal, which programs name by number.
const PALETTE: [Rgb; 16] = [
    [0x2a, 0x2f, 0x38],
    [0xe0, 0x6c, 0x75],
    [0x98, 0xc3, 0x79],
    [0xe5, 0xc0, 0x7b],
    [0x61, 0xaf, 0xef],
    [0xb8, 0x5f, 0xcf],
    [0x56, 0xc2, 0xcf],
    [0xd8, 0xdc, 0xe2],
    [0x5c, 0x63, 0x70],
    [0xff, 0x7b, 0x85],
    [0xb5, 0xe0, 0x90],
    [0xff, 0xd9, 0x8a],
    [0x82, 0xc4, 0xff],
    [0xd7, 0x8b, 0xee],
    [0x7d, 0xdf, 0xea],
    [0xff, 0xff, 0xff],
];

/// Frames in the order in which they are shown.
pub struct Movie {
    title: String,
    /// Every different line as SVG, with its baseline at 0.
    lines: Vec<String>,
    /// The place of a line in `lines`.
    places: HashMap<String, usize>,
    frames: Vec<Frame>,
}

/// One screen with its caption.
struct Frame {
    /// Rows that show something, and the places of their lines.
    rows: Vec<(usize, usize)>,
    caption: String,
    secs: f64,
}

impl Movie {
    pub fn new(title: &str) -> Self {
        Self { title: title.to_owned(), lines: Vec::new(), places: HashMap::new(), frames: Vec::new() }
    }

    /// Adds a screen, which the movie shows for this time.
    pub fn add(&mut self, screen: &Screen, caption: &str, secs: f64) {
        let mut rows = Vec::new();
        for row in 0..SIZE.1 {
            let line: String = runs(screen, row).iter().map(Run::to_svg).collect();
            if !line.is_empty() {
                rows.push((usize::from(row), self.place(line)));
            }
        }
        self.frames.push(Frame { rows, caption: caption.to_owned(), secs });
    }

    fn place(&mut self, line: String) -> usize {
        if let Some(place) = self.places.get(&line) {
            return *place;
        }
        let place = self.lines.len();
        self.places.insert(line.clone(), place);
        self.lines.push(line);
        place
    }

    pub fn frame_count(&self) -> usize {
        self.frames.len()
    }

    /// The time until the movie begins again, s.
    pub fn secs(&self) -> f64 {
        self.frames.iter().map(|frame| frame.secs).sum()
    }

    /// The whole file.
    pub fn to_svg(&self) -> String {
        let (columns, rows) = (usize::from(SIZE.0), usize::from(SIZE.1));
        let (screen_width, screen_height) = (columns * COLUMN, rows * LINE);
        let (width, strip_height) = (screen_width + 2 * MARGIN, screen_height + CAPTION);
        let height = TITLE_BAR + strip_height;
        let title = escaped(&self.title);
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
             viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{title}\" xml:space=\"preserve\">\n\
             <title>{title}</title>\n<style>{}</style>\n",
            self.style(screen_width)
        );
        svg += "<defs>\n";
        for (place, line) in self.lines.iter().enumerate() {
            svg += &format!("<g id=\"l{place}\">{line}</g>\n");
        }
        svg += "</defs>\n";
        svg += &format!(
            "<rect width=\"{width}\" height=\"{height}\" rx=\"10\" fill=\"{}\"/>\n\
             <rect y=\"{TITLE_BAR}\" width=\"{width}\" height=\"{screen_height}\" fill=\"{}\"/>\n",
            hex(FRAME),
            hex(BACKGROUND)
        );
        for (at, button) in BUTTONS.into_iter().enumerate() {
            let (x, y) = (MARGIN + 6 + at * 20, TITLE_BAR / 2);
            svg += &format!("<circle cx=\"{x}\" cy=\"{y}\" r=\"6\" fill=\"{}\"/>\n", hex(button));
        }
        svg += &format!("<text class=\"title\" x=\"{}\" y=\"23\">{title}</text>\n", width / 2);
        // The inner viewport cuts off the frames beside the present one.
        svg += &format!(
            "<svg x=\"{MARGIN}\" y=\"{TITLE_BAR}\" width=\"{screen_width}\" height=\"{strip_height}\">\n\
             <g class=\"strip\">\n"
        );
        for (at, frame) in self.frames.iter().enumerate() {
            svg += &format!("<g transform=\"translate({} 0)\">", at * screen_width);
            for (row, place) in &frame.rows {
                svg += &format!("<use href=\"#l{place}\" y=\"{}\"/>", row * LINE + BASELINE);
            }
            let (x, y) = (screen_width / 2, screen_height + 29);
            svg += &format!(
                "<text class=\"caption\" x=\"{x}\" y=\"{y}\">{}</text></g>\n",
                escaped(&frame.caption)
            );
        }
        svg += "</g>\n</svg>\n</svg>\n";
        svg
    }

    /// The style sheet: the strip shows each frame for its time, then jumps to the next.
    fn style(&self, screen_width: usize) -> String {
        let all_secs = self.secs();
        let (mut stops, mut begun_secs) = (String::new(), 0.0);
        for (at, frame) in self.frames.iter().enumerate() {
            let (percent, left) = (begun_secs / all_secs * 100.0, at * screen_width);
            stops += &format!("{percent:.3}%{{transform:translateX(-{left}px)}}");
            begun_secs += frame.secs;
        }
        let text = hex(FOREGROUND);
        format!(
            "text{{font-family:{MONOSPACED};font-size:{FONT_SIZE};white-space:pre}}\
             .b{{font-weight:700}}.d{{opacity:.6}}.i{{font-style:italic}}.u{{text-decoration:underline}}\
             .title,.caption{{font-family:{SANS_SERIF};text-anchor:middle;fill:{text}}}\
             .title{{font-size:13px;opacity:.7}}.caption{{font-size:16px}}\
             .strip{{fill:{text};animation:play {all_secs:.1}s step-end infinite}}\
             @keyframes play{{{stops}}}\
             @media (prefers-reduced-motion:reduce){{.strip{{animation:none}}}}"
        )
    }
}

/// How cells are drawn.
#[derive(Clone, Copy, PartialEq, Eq)]
struct CellStyle {
    fore: Rgb,
    /// Absent for the screen's own background.
    back: Option<Rgb>,
    bold: bool,
    dim: bool,
    italic: bool,
    underline: bool,
}

impl CellStyle {
    fn of(cell: &Cell) -> Self {
        let (fore, back) = (cell.fgcolor(), cell.bgcolor());
        let (fore, back) = if cell.inverse() {
            (rgb(back, BACKGROUND), Some(rgb(fore, FOREGROUND)))
        } else {
            (rgb(fore, FOREGROUND), (back != Color::Default).then(|| rgb(back, BACKGROUND)))
        };
        let (bold, dim) = (cell.bold(), cell.dim());
        Self { fore, back, bold, dim, italic: cell.italic(), underline: cell.underline() }
    }

    /// The attributes of a text in this style.
    fn attributes(&self) -> String {
        let flags = [(self.bold, "b"), (self.dim, "d"), (self.italic, "i"), (self.underline, "u")];
        let classes: Vec<&str> = flags.into_iter().filter(|(is, _)| *is).map(|(_, class)| class).collect();
        let mut attributes = String::new();
        if self.fore != FOREGROUND {
            attributes += &format!(" fill=\"{}\"", hex(self.fore));
        }
        if !classes.is_empty() {
            attributes += &format!(" class=\"{}\"", classes.join(" "));
        }
        attributes
    }
}

/// Cells of one style that follow each other, all of ASCII or none.
struct Run {
    style: CellStyle,
    /// Absent while there are only blanks.
    is_ascii: Option<bool>,
    /// Columns and their text.
    cells: Vec<(usize, String)>,
    /// The column behind the last one.
    end: usize,
}

fn runs(screen: &Screen, row: u16) -> Vec<Run> {
    let mut runs: Vec<Run> = Vec::new();
    for column in 0..SIZE.0 {
        let Some(cell) = screen.cell(row, column) else { break };
        // The second column of a wide sign is part of it.
        if cell.is_wide_continuation() {
            continue;
        }
        let text = if cell.has_contents() { cell.contents().to_owned() } else { " ".to_owned() };
        let style = CellStyle::of(cell);
        let is_ascii = (text != " ").then(|| text.is_ascii());
        let column = usize::from(column);
        let end = column + if cell.is_wide() { 2 } else { 1 };
        match runs.last_mut() {
            Some(run)
                if run.style == style
                    && (is_ascii.is_none() || run.is_ascii.is_none() || run.is_ascii == is_ascii) =>
            {
                run.is_ascii = run.is_ascii.or(is_ascii);
                run.cells.push((column, text));
                run.end = end;
            }
            _ => runs.push(Run { style, is_ascii, cells: vec![(column, text)], end }),
        }
    }
    runs
}

impl Run {
    /// As SVG; empty if nothing is to be seen.
    fn to_svg(&self) -> String {
        let mut svg = String::new();
        let first = self.cells.first().map_or(0, |(column, _)| *column);
        if let Some(back) = self.style.back {
            let (x, width) = (first * COLUMN, (self.end - first) * COLUMN);
            let fill = hex(back);
            svg += &format!(
                "<rect x=\"{x}\" y=\"-{BASELINE}\" width=\"{width}\" height=\"{LINE}\" fill=\"{fill}\"/>"
            );
        }
        // Blanks show nothing, unless they are underlined.
        let is_seen = |(_, text): &(usize, String)| text != " " || self.style.underline;
        let (from, to) = (self.cells.iter().position(is_seen), self.cells.iter().rposition(is_seen));
        let (Some(from), Some(to)) = (from, to) else { return svg };
        let seen = &self.cells[from..=to];
        let (start, sign) = &seen[0];
        let x = start * COLUMN;
        let is_even = self.is_ascii != Some(false) || seen.iter().all(|(_, text)| text == sign);
        let (place, text): (String, String) = if seen.len() == 1 {
            (format!("x=\"{x}\""), sign.clone())
        } else if is_even {
            // The same width in every font.
            let text = seen.iter().map(|(_, text)| text.as_str()).collect();
            (format!("x=\"{x}\" textLength=\"{}\"", seen.len() * COLUMN), text)
        } else {
            // Such signs come from other fonts, with other widths: each has a place of its own.
            let signs: Vec<&(usize, String)> = seen.iter().filter(|(_, text)| text != " ").collect();
            let columns: Vec<String> =
                signs.iter().map(|(column, _)| (column * COLUMN).to_string()).collect();
            let text = signs.iter().map(|(_, text)| text.as_str()).collect();
            (format!("x=\"{}\"", columns.join(" ")), text)
        };
        let attributes = self.style.attributes();
        svg + &format!("<text {place}{attributes}>{}</text>", escaped(&text))
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

fn hex([red, green, blue]: Rgb) -> String {
    format!("#{red:02x}{green:02x}{blue:02x}")
}

fn rgb(color: Color, default: Rgb) -> Rgb {
    match color {
        Color::Default => default,
        Color::Idx(index) => indexed(index),
        Color::Rgb(red, green, blue) => [red, green, blue],
    }
}

/// A color of the 256 that a terminal names by number: the palette, a cube of six levels, and a ramp of grays.
fn indexed(index: u8) -> Rgb {
    let level = |step: u8| if step == 0 { 0 } else { 55 + 40 * step };
    match index {
        0..16 => PALETTE[usize::from(index)],
        16..232 => {
            let place = index - 16;
            [level(place / 36), level(place / 6 % 6), level(place % 6)]
        }
        232.. => [8 + 10 * (index - 232); 3],
    }
}
