//! Curves with bands over whole numbers, and a radar.

use std::fmt::Write as _;

use super::pen::{STYLES, escaped, head, mark, style, text};

/// Size of a plot, in its own units.
const WIDTH: f64 = 560.0;
const HEIGHT: f64 = 320.0;

/// Room for the axis labels: left, right, top, bottom.
const ROOM: [f64; 4] = [56.0, 150.0, 30.0, 44.0];

/// A curve: a mean and half a band's width at each place of the axis, from 0 on.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    pub name: String,
    /// Its style; a series in several plots has the same style in all.
    pub style: usize,
    pub points: Vec<(f64, f64)>,
}

/// A plot with curves over whole numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Curves {
    pub title: String,
    /// The axis titles, with units.
    pub axes: [String; 2],
    /// Least and greatest value of the vertical axis.
    pub range: [f64; 2],
    pub curves: Vec<Curve>,
}

impl Curves {
    /// The plot as SVG.
    #[must_use]
    pub fn svg(&self) -> String {
        let [left, right, top, bottom] = ROOM;
        let (inner_w, inner_h) = (WIDTH - left - right, HEIGHT - top - bottom);
        let last =
            self.curves.iter().map(|curve| curve.points.len()).max().unwrap_or(1).saturating_sub(1).max(1);
        let [low, high] = self.range;
        let x = |place: usize| left + inner_w * place as f64 / last as f64;
        let y = |value: f64| top + inner_h * (1.0 - (value.clamp(low, high) - low) / (high - low));
        let mut out = String::new();
        head(&mut out, WIDTH, HEIGHT, &self.title);
        text(&mut out, left + inner_w / 2.0, 18.0, "middle", &self.title);
        for step in 0..=4 {
            let value = low + (high - low) * f64::from(step) / 4.0;
            let at = y(value);
            let _ = writeln!(
                out,
                "<line x1=\"{left}\" y1=\"{at:.1}\" x2=\"{:.1}\" y2=\"{at:.1}\" stroke=\"#cccccc\"/>",
                left + inner_w
            );
            text(&mut out, left - 6.0, at + 4.0, "end", &format!("{value:.0}"));
        }
        for place in 0..=last {
            text(&mut out, x(place), top + inner_h + 16.0, "middle", &place.to_string());
        }
        text(&mut out, left + inner_w / 2.0, HEIGHT - 8.0, "middle", &self.axes[0]);
        let _ = writeln!(
            out,
            "<text transform=\"translate(14 {:.1}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
            top + inner_h / 2.0,
            escaped(&self.axes[1])
        );
        for curve in &self.curves {
            let (color, _, _) = style(curve.style);
            let upper = curve.points.iter().enumerate().map(|(at, (mean, half))| (x(at), y(mean + half)));
            let lower =
                curve.points.iter().enumerate().rev().map(|(at, (mean, half))| (x(at), y(mean - half)));
            let points: Vec<String> = upper.chain(lower).map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
            let _ = writeln!(
                out,
                "<polygon points=\"{}\" fill=\"{color}\" fill-opacity=\"0.10\"/>",
                points.join(" ")
            );
        }
        for (place, curve) in self.curves.iter().enumerate() {
            let (color, dashes, shape) = style(curve.style);
            let points: Vec<String> = curve
                .points
                .iter()
                .enumerate()
                .map(|(at, (mean, _))| format!("{:.1},{:.1}", x(at), y(*mean)))
                .collect();
            let line = points.join(" ");
            let _ = writeln!(
                out,
                "<polyline points=\"{line}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"1.8\" \
                 stroke-dasharray=\"{dashes}\"/>"
            );
            for (at, (mean, _)) in curve.points.iter().enumerate() {
                mark(&mut out, shape, x(at), y(*mean), color);
            }
            let at = top + 12.0 + 20.0 * place as f64;
            let from = left + inner_w + 14.0;
            let _ = writeln!(
                out,
                "<line x1=\"{from:.1}\" y1=\"{at:.1}\" x2=\"{:.1}\" y2=\"{at:.1}\" stroke=\"{color}\" \
                 stroke-width=\"1.8\" stroke-dasharray=\"{dashes}\"/>",
                from + 26.0
            );
            mark(&mut out, shape, from + 13.0, at, color);
            text(&mut out, from + 32.0, at + 4.0, "start", &curve.name);
        }
        out.push_str("</svg>\n");
        out
    }
}

/// A radar: values from 0 to 1 on each axis, outer is better; the outline omits an axis without a value.
#[derive(Clone, Debug, PartialEq)]
pub struct Radar {
    pub title: String,
    pub axes: Vec<String>,
    pub outlines: Vec<(String, Vec<Option<f64>>)>,
}

impl Radar {
    /// The plot as SVG.
    #[must_use]
    pub fn svg(&self) -> String {
        let (cx, cy, radius) = (230.0, 175.0, 110.0);
        let count = self.axes.len().max(1) as f64;
        let at = |axis: usize, share: f64| {
            let angle = std::f64::consts::TAU * axis as f64 / count - std::f64::consts::FRAC_PI_2;
            (cx + radius * share * libm::cos(angle), cy + radius * share * libm::sin(angle))
        };
        let outline = |shares: &[f64]| -> String {
            let points = shares.iter().enumerate().map(|(axis, share)| at(axis, *share));
            points.map(|(x, y)| format!("{x:.1},{y:.1}")).collect::<Vec<_>>().join(" ")
        };
        let mut out = String::new();
        head(&mut out, WIDTH, 350.0, &self.title);
        text(&mut out, cx, 18.0, "middle", &self.title);
        for ring in [0.25, 0.5, 0.75, 1.0] {
            let points = outline(&vec![ring; self.axes.len()]);
            let _ = writeln!(out, "<polygon points=\"{points}\" fill=\"none\" stroke=\"#cccccc\"/>");
        }
        for (axis, name) in self.axes.iter().enumerate() {
            let (x, y) = at(axis, 1.0);
            let _ = writeln!(
                out,
                "<line x1=\"{cx}\" y1=\"{cy}\" x2=\"{x:.1}\" y2=\"{y:.1}\" stroke=\"#cccccc\"/>"
            );
            let (x, y) = at(axis, 1.1);
            // Labels stand outside the outline, on the side where their axis ends.
            let anchor = match x - cx {
                right if right > 1.0 => "start",
                left if left < -1.0 => "end",
                _ => "middle",
            };
            text(&mut out, x, y + 4.0, anchor, name);
        }
        for (place, ((name, shares), (color, dashes, shape))) in self.outlines.iter().zip(STYLES).enumerate()
        {
            let points: Vec<String> = shares
                .iter()
                .enumerate()
                .filter_map(|(axis, share)| share.map(|share| at(axis, share)))
                .map(|(x, y)| format!("{x:.1},{y:.1}"))
                .collect();
            let _ = writeln!(
                out,
                "<polygon points=\"{}\" fill=\"{color}\" fill-opacity=\"0.06\" stroke=\"{color}\" stroke-width=\"1.8\" \
                 stroke-dasharray=\"{dashes}\"/>",
                points.join(" ")
            );
            for (axis, share) in shares.iter().enumerate() {
                if let Some(share) = share {
                    let (x, y) = at(axis, *share);
                    mark(&mut out, shape, x, y, color);
                }
            }
            let y = 60.0 + 20.0 * place as f64;
            mark(&mut out, shape, 420.0, y, color);
            text(&mut out, 432.0, y + 4.0, "start", name);
        }
        out.push_str("</svg>\n");
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_stay_inside_the_frame_and_differ_without_color() {
        let curve = |name: &str, value: f64| Curve {
            name: name.to_owned(),
            style: 0,
            points: vec![(value, 30.0); 6],
        };
        let plot = Curves {
            title: "a & b".to_owned(),
            axes: ["round".to_owned(), "percent".to_owned()],
            range: [0.0, 100.0],
            curves: vec![curve("one", 95.0), curve("two", 5.0), curve("three", 50.0)],
        };
        let svg = plot.svg();
        assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>") && svg.contains("a &amp; b"));
        for points in svg.split("points=\"").skip(1).filter_map(|rest| rest.split('"').next()) {
            for point in points.split(' ') {
                let (x, y) = point.split_once(',').unwrap();
                let (x, y): (f64, f64) = (x.parse().unwrap(), y.parse().unwrap());
                assert!((0.0..=WIDTH).contains(&x) && (0.0..=HEIGHT).contains(&y), "{point}");
            }
        }
        let dashes: Vec<&str> = STYLES.iter().map(|(_, dashes, _)| *dashes).collect();
        for (place, dash) in dashes.iter().enumerate() {
            assert!(!dashes[..place].contains(dash), "{dash:?} twice");
        }
    }

    #[test]
    fn radar_omits_missing_values() {
        let radar = Radar {
            title: "six".to_owned(),
            axes: ["a", "b", "c"].map(str::to_owned).to_vec(),
            outlines: vec![("x".to_owned(), vec![Some(1.0), None, Some(0.5)])],
        };
        let svg = radar.svg();
        assert_eq!(svg.matches("<circle").count(), 3, "two values and one in the legend: {svg}");
    }
}
