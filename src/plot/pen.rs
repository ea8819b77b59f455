//! What every plot is drawn with: the page, words, and what tells one series from another without colour.

use std::fmt::Write as _;

/// What tells curves apart: colour, dashes, mark.
pub(crate) const STYLES: [(&str, &str, Mark); 6] = [
    ("#111111", "", Mark::Disc),
    ("#b02a2a", "6 3", Mark::Triangle),
    ("#1f5fa8", "2 3", Mark::Square),
    ("#2f7d32", "9 3 2 3", Mark::Diamond),
    ("#8a5a00", "12 4", Mark::Cross),
    ("#6a3d9a", "1 2", Mark::Ring),
];

#[derive(Clone, Copy)]
pub(crate) enum Mark {
    Disc,
    Triangle,
    Square,
    Diamond,
    Cross,
    Ring,
}

/// A text as it may stand in HTML and SVG.
#[must_use]
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

pub(crate) fn style(number: usize) -> (&'static str, &'static str, Mark) {
    STYLES[number % STYLES.len()]
}

pub(crate) fn mark(out: &mut String, mark: Mark, x: f64, y: f64, color: &str) {
    let path = |points: &[(f64, f64)]| {
        let points: Vec<String> =
            points.iter().map(|(dx, dy)| format!("{:.1},{:.1}", x + dx, y + dy)).collect();
        format!("<polygon points=\"{}\" fill=\"{color}\"/>", points.join(" "))
    };
    out.push_str(&match mark {
        Mark::Disc => format!("<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3.5\" fill=\"{color}\"/>"),
        Mark::Ring => format!(
            "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3.5\" fill=\"white\" stroke=\"{color}\" stroke-width=\"1.5\"/>"
        ),
        Mark::Triangle => path(&[(0.0, -4.5), (4.5, 3.5), (-4.5, 3.5)]),
        Mark::Square => path(&[(-3.5, -3.5), (3.5, -3.5), (3.5, 3.5), (-3.5, 3.5)]),
        Mark::Diamond => path(&[(0.0, -5.0), (5.0, 0.0), (0.0, 5.0), (-5.0, 0.0)]),
        Mark::Cross => format!(
            "<path d=\"M{:.1},{:.1} l8,8 m0,-8 l-8,8\" stroke=\"{color}\" stroke-width=\"2\" fill=\"none\"/>",
            x - 4.0,
            y - 4.0
        ),
    });
    out.push('\n');
}

pub(crate) fn text(out: &mut String, x: f64, y: f64, anchor: &str, words: &str) {
    let words = escaped(words);
    let _ = writeln!(out, "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\">{words}</text>");
}

pub(crate) fn head(out: &mut String, width: f64, height: f64, title: &str) {
    let _ = writeln!(
        out,
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{0}\" \
         font-family=\"sans-serif\" font-size=\"12\">\n<title>{0}</title>\n<rect width=\"{width}\" height=\"{height}\" \
         fill=\"white\"/>",
        escaped(title)
    );
}
