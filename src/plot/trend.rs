//! Values over time in stacked panels on one axis, with marks.
//!
//! Only consecutive points are joined: a gap in the record is a gap in the plot.

use std::fmt::Write as _;

use super::pen::{head, mark, style, text};

/// Width of the whole plot, in its own units.
const WIDTH: f64 = 960.0;
/// Room at the left for numbers, at the right for names.
const LEFT: f64 = 64.0;
const RIGHT: f64 = 190.0;
/// Room above the first panel, and above each panel for its title.
const TOP: f64 = 44.0;
const TITLE: f64 = 22.0;
/// Height of a panel's inside.
const PANEL: f64 = 120.0;
/// Height of a line of text.
const LINE: f64 = 16.0;
/// Room for the letters of marks, and for the axis.
const LETTERS: f64 = 20.0;
const AXIS: f64 = 40.0;
/// Letters closer than this would overlap: the most important one stands for all.
const APART: f64 = 9.0;
/// The most marks listed with their text.
pub const MARKS_LISTED_MAX: usize = 60;

/// A value at a place of the axis, with its band.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrendPoint {
    /// Place on the axis, as a share from 0 to 1.
    pub at: f64,
    /// Its step on the axis: consecutive points have consecutive numbers.
    pub step: u32,
    /// The value, in the panel's unit.
    pub value: f64,
    /// Lower and upper end of its band, in the panel's unit.
    pub band: [f64; 2],
}

/// One series.
#[derive(Clone, Debug, PartialEq)]
pub struct TrendLine {
    /// Its label beside the panel.
    pub name: String,
    /// Its style; a series in several panels has the same style in all.
    pub style: usize,
    /// In order.
    pub points: Vec<TrendPoint>,
}

/// One quantity.
#[derive(Clone, Debug, PartialEq)]
pub struct TrendPanel {
    /// The title, with the unit and the meaning of the band.
    pub title: String,
    /// Least and greatest value of the upright axis.
    pub range: [f64; 2],
    /// Decimals of the numbers at the axis.
    pub digits: usize,
    /// The series.
    pub lines: Vec<TrendLine>,
}

/// A mark.
#[derive(Clone, Debug, PartialEq)]
pub struct TrendMark {
    /// Place on the axis, as a share from 0 to 1.
    pub at: f64,
    /// The letter on the line of marks.
    pub letter: char,
    /// Its rank where letters overlap: the smallest number is drawn.
    pub weight: u8,
    /// Its event and time, one sentence.
    pub text: String,
}

/// See the module's head.
#[derive(Clone, Debug, PartialEq)]
pub struct TrendPlot {
    pub title: String,
    /// Sentences below the title.
    pub notes: Vec<String>,
    /// The title of the lower axis, with its unit.
    pub axis: String,
    /// Labeled places of the axis, as shares from 0 to 1.
    pub ticks: Vec<(f64, String)>,
    pub panels: Vec<TrendPanel>,
    /// The text in a panel without a point.
    pub empty: String,
    pub marks: Vec<TrendMark>,
    /// The line below the listed marks, if there are more than [`MARKS_LISTED_MAX`].
    pub unlisted: Option<String>,
}

fn inside() -> f64 {
    WIDTH - LEFT - RIGHT
}

fn x(at: f64) -> f64 {
    LEFT + inside() * at.clamp(0.0, 1.0)
}

impl TrendPlot {
    /// The plot as SVG.
    #[must_use]
    pub fn svg(&self) -> String {
        let notes = self.notes.len() as f64 * LINE;
        let marks_at = TOP + notes;
        let listed = self.marks.len().min(MARKS_LISTED_MAX);
        let panels = self.panels.len() as f64 * (PANEL + TITLE);
        let list_at = marks_at + LETTERS + panels + AXIS;
        let more = usize::from(self.unlisted.is_some());
        let height = list_at + (listed + more) as f64 * LINE + 12.0;
        let mut out = String::new();
        head(&mut out, WIDTH, height, &self.title);
        text(&mut out, LEFT, 20.0, "start", &self.title);
        for (place, note) in self.notes.iter().enumerate() {
            text(&mut out, LEFT, 20.0 + LINE * (place + 1) as f64, "start", note);
        }
        let bottom = marks_at + LETTERS + panels;
        self.lines_of_marks(&mut out, marks_at, bottom);
        for (place, panel) in self.panels.iter().enumerate() {
            let top = marks_at + LETTERS + TITLE + place as f64 * (PANEL + TITLE);
            self.panel(&mut out, panel, top);
        }
        for (at, words) in &self.ticks {
            let place = x(*at);
            let _ = writeln!(
                out,
                "<line x1=\"{place:.1}\" y1=\"{bottom:.1}\" x2=\"{place:.1}\" y2=\"{:.1}\" stroke=\"#111111\"/>",
                bottom + 4.0
            );
            text(&mut out, place, bottom + 16.0, "middle", words);
        }
        text(&mut out, LEFT + inside() / 2.0, bottom + 32.0, "middle", &self.axis);
        for (place, one) in self.marks.iter().take(listed).enumerate() {
            let at = list_at + LINE * (place + 1) as f64;
            text(&mut out, LEFT - 14.0, at, "end", &one.letter.to_string());
            text(&mut out, LEFT, at, "start", &one.text);
        }
        if let Some(unlisted) = &self.unlisted {
            text(&mut out, LEFT, list_at + LINE * (listed + 1) as f64, "start", unlisted);
        }
        out.push_str("</svg>\n");
        out
    }

    /// The letters above the panels, each with a line down through all of them.
    fn lines_of_marks(&self, out: &mut String, top: f64, bottom: f64) {
        for one in &self.marks {
            let place = x(one.at);
            let _ = writeln!(
                out,
                "<line x1=\"{place:.1}\" y1=\"{:.1}\" x2=\"{place:.1}\" y2=\"{bottom:.1}\" stroke=\"#777777\" \
                 stroke-dasharray=\"1 4\"/>",
                top + LETTERS - 4.0
            );
        }
        let mut weightiest: Vec<&TrendMark> = self.marks.iter().collect();
        weightiest.sort_by_key(|one| one.weight);
        let mut drawn: Vec<f64> = Vec::new();
        for one in weightiest {
            let place = x(one.at);
            if drawn.iter().all(|other| (place - other).abs() >= APART) {
                text(out, place, top + LETTERS - 6.0, "middle", &one.letter.to_string());
                drawn.push(place);
            }
        }
    }

    fn panel(&self, out: &mut String, panel: &TrendPanel, top: f64) {
        let TrendPanel { title, range: [low, high], digits, lines } = panel;
        let (low, high) = (*low, if high > low { *high } else { low + 1.0 });
        let y = |value: f64| top + PANEL * (1.0 - (value.clamp(low, high) - low) / (high - low));
        text(out, LEFT, top - 6.0, "start", title);
        for step in 0..=4 {
            let value = low + (high - low) * f64::from(step) / 4.0;
            let at = y(value);
            let _ = writeln!(
                out,
                "<line x1=\"{LEFT}\" y1=\"{at:.1}\" x2=\"{:.1}\" y2=\"{at:.1}\" stroke=\"#cccccc\"/>",
                LEFT + inside()
            );
            text(out, LEFT - 6.0, at + 4.0, "end", &format!("{value:.digits$}"));
        }
        for (place, line) in lines.iter().enumerate() {
            let (color, dashes, shape) = style(line.style);
            let parts = line.points.chunk_by(|one, next| one.step.checked_add(1) == Some(next.step));
            for part in parts {
                let upper = part.iter().map(|point| (x(point.at), y(point.band[1])));
                let lower = part.iter().rev().map(|point| (x(point.at), y(point.band[0])));
                let band: Vec<String> = upper.chain(lower).map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
                let value: Vec<String> =
                    part.iter().map(|point| format!("{:.1},{:.1}", x(point.at), y(point.value))).collect();
                if let [alone] = part {
                    let _ = writeln!(
                        out,
                        "<line x1=\"{0:.1}\" y1=\"{1:.1}\" x2=\"{0:.1}\" y2=\"{2:.1}\" stroke=\"{color}\" \
                         stroke-opacity=\"0.35\" stroke-width=\"3\"/>",
                        x(alone.at),
                        y(alone.band[0]),
                        y(alone.band[1])
                    );
                } else {
                    let _ = writeln!(
                        out,
                        "<polygon points=\"{}\" fill=\"{color}\" fill-opacity=\"0.12\"/>\n<polyline points=\"{}\" \
                         fill=\"none\" stroke=\"{color}\" stroke-width=\"1.6\" stroke-dasharray=\"{dashes}\"/>",
                        band.join(" "),
                        value.join(" ")
                    );
                }
                for point in part {
                    mark(out, shape, x(point.at), y(point.value), color);
                }
            }
            let at = top + 12.0 + 18.0 * place as f64;
            if at < top + PANEL {
                mark(out, shape, LEFT + inside() + 20.0, at, color);
                text(out, LEFT + inside() + 32.0, at + 4.0, "start", &line.name);
            }
        }
        if lines.iter().all(|line| line.points.is_empty()) {
            text(out, LEFT + inside() / 2.0, top + PANEL / 2.0, "middle", &self.empty);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(step: u32, value: f64) -> TrendPoint {
        TrendPoint { at: f64::from(step) / 10.0, step, value, band: [value - 5.0, value + 5.0] }
    }

    fn plot() -> TrendPlot {
        let line = |name: &str, style, steps: &[u32]| TrendLine {
            name: name.to_owned(),
            style,
            points: steps.iter().map(|step| point(*step, 90.0)).collect(),
        };
        TrendPlot {
            title: "grasp & <more>".to_owned(),
            notes: vec!["a note".to_owned()],
            axis: "time, UTC".to_owned(),
            ticks: vec![(0.0, "08:00".to_owned()), (1.0, "18:00".to_owned())],
            panels: vec![TrendPanel {
                title: "success, %".to_owned(),
                range: [0.0, 100.0],
                digits: 0,
                lines: vec![line("grasp@1.0.0", 0, &[0, 1, 2, 5, 6, 9]), line("grasp@1.1.0", 1, &[])],
            }],
            empty: "no values".to_owned(),
            unlisted: None,
            marks: vec![TrendMark { at: 0.3, letter: 'P', weight: 0, text: "promotion of \"x\"".to_owned() }],
        }
    }

    #[test]
    fn gaps_are_not_drawn_over_and_curves_stay_inside() {
        let svg = plot().svg();
        assert_eq!(svg.matches("<polyline").count(), 2, "0 to 2 and 5 to 6; 9 stands alone: {svg}");
        assert_eq!(svg.matches("stroke-opacity=\"0.35\"").count(), 1);
        assert!(svg.contains("grasp &amp; &lt;more&gt;") && svg.contains("promotion of &quot;x&quot;"));
        assert!(svg.contains(">P</text>") && svg.contains(">success, %</text>"));
        for points in svg.split("points=\"").skip(1).filter_map(|rest| rest.split('"').next()) {
            for point in points.split(' ') {
                let (x, y) = point.split_once(',').unwrap();
                let (x, y): (f64, f64) = (x.parse().unwrap(), y.parse().unwrap());
                assert!((0.0..=WIDTH).contains(&x) && (0.0..=400.0).contains(&y), "{point}");
            }
        }
    }

    #[test]
    fn empty_plots_are_noted() {
        let mut plot = plot();
        plot.panels[0].lines.clear();
        plot.panels[0].range = [1.0, 1.0];
        assert!(plot.svg().contains(&plot.empty));
        plot.marks = vec![plot.marks[0].clone(); MARKS_LISTED_MAX + 5];
        plot.unlisted = Some("5 others".to_owned());
        let svg = plot.svg();
        assert!(svg.contains("5 others") && svg.trim_end().ends_with("</svg>"));
        assert_eq!(svg.matches("promotion of").count(), MARKS_LISTED_MAX);
    }
}
