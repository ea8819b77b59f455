//! Parts of every plot: the page, texts, and styles that distinguish series without color.

use std::fmt::Write as _;

/// Styles that distinguish curves: color, dashes, mark.
pub(crate) const STYLES: [(&str, &str, SeriesMark); 6] = [
    ("#111111", "", SeriesMark::Disc),
    ("#b02a2a", "6 3", SeriesMark::Triangle),
    ("#1f5fa8", "2 3", SeriesMark::Square),
    ("#2f7d32", "9 3 2 3", SeriesMark::Diamond),
    ("#8a5a00", "12 4", SeriesMark::Cross),
    ("#6a3d9a", "1 2", SeriesMark::Ring),
];

#[derive(Clone, Copy)]
pub(crate) enum SeriesMark {
    Disc,
    Triangle,
    Square,
    Diamond,
    Cross,
    Ring,
}

/// A text escaped for HTML and SVG.
#[must_use]
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

pub(crate) fn style(number: usize) -> (&'static str, &'static str, SeriesMark) {
    STYLES[number % STYLES.len()]
}

pub(crate) fn mark(out: &mut String, mark: SeriesMark, x: f64, y: f64, color: &str) {
    let path = |points: &[(f64, f64)]| {
        let points: Vec<String> =
            points.iter().map(|(dx, dy)| format!("{:.1},{:.1}", x + dx, y + dy)).collect();
        format!("<polygon points=\"{}\" fill=\"{color}\"/>", points.join(" "))
    };
    out.push_str(&match mark {
        SeriesMark::Disc => format!("<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3.5\" fill=\"{color}\"/>"),
        SeriesMark::Ring => format!(
            "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3.5\" fill=\"white\" stroke=\"{color}\" stroke-width=\"1.5\"/>"
        ),
        SeriesMark::Triangle => path(&[(0.0, -4.5), (4.5, 3.5), (-4.5, 3.5)]),
        SeriesMark::Square => path(&[(-3.5, -3.5), (3.5, -3.5), (3.5, 3.5), (-3.5, 3.5)]),
        SeriesMark::Diamond => path(&[(0.0, -5.0), (5.0, 0.0), (0.0, 5.0), (-5.0, 0.0)]),
        SeriesMark::Cross => format!(
            "<path d=\"M{:.1},{:.1} l8,8 m0,-8 l-8,8\" stroke=\"{color}\" stroke-width=\"2\" fill=\"none\"/>",
            x - 4.0,
            y - 4.0
        ),
    });
    out.push('\n');
}

pub(crate) fn text(out: &mut String, x: f64, y: f64, anchor: &str, content: &str) {
    let content = escaped(content);
    let _ = writeln!(out, "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\">{content}</text>");
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
