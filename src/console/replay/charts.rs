//! The charts of a recording: series with their limits, in groups by the first part of their names.
//!
//! Without charts of the tool, speed, force and their limits come from the video frames. Must not draw.

use holdpoint_protocol::video_frame::{EnvelopeView, VideoFrame};
use holdpoint_recordings::recording::{Recording, Series};
use holdpoint_wording::console::replay as wording;

/// Last parts of names that make a series the limit of another.
const LIMITS: [&str; 2] = ["limit", "threshold"];

/// The subject of a group of charts, in the order of Tab.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum ChartGroup {
    /// The tool's speed and forces.
    Tool,
    /// How far a candidate in shadow is from the active version.
    Shadow,
    /// The four compatibility values.
    Kappa,
    /// What the monitor charts of an active version.
    Monitor,
    /// The live cell, and every series without a group in its name.
    Cell,
    /// Candidate and active version on the same episodes.
    Pairs,
    /// A group from another build, by its name.
    Other(String),
}

impl ChartGroup {
    /// The group of a series: the first part of its name.
    fn of(series: &str) -> Self {
        match series.split_once('/').map(|(group, _)| group) {
            Some("tool") => Self::Tool,
            Some("shadow") => Self::Shadow,
            Some("kappa") => Self::Kappa,
            Some("monitor") => Self::Monitor,
            Some("pairs") => Self::Pairs,
            Some("cell") | None => Self::Cell,
            Some(other) => Self::Other(other.to_owned()),
        }
    }

    /// Its name as a heading.
    #[must_use]
    pub fn heading(&self) -> &str {
        match self {
            Self::Tool => "Tool",
            Self::Shadow => "Shadow",
            Self::Kappa => "Checks",
            Self::Monitor => "Monitor",
            Self::Cell => "Live cell",
            Self::Pairs => "Paired episodes",
            Self::Other(name) => name,
        }
    }
}

/// Charts of one kind.
#[derive(Clone, Debug, PartialEq)]
pub struct ChartSection {
    pub about: ChartGroup,
    /// The charts, at least one.
    pub charts: Vec<LimitedSeries>,
}

/// A series and its limit.
#[derive(Clone, Debug, PartialEq)]
pub struct LimitedSeries {
    /// What it shows, with its unit.
    pub title: String,
    /// Values over virtual time, ms.
    pub values: Vec<(u64, f64)>,
    /// The limit over virtual time; empty if there is none.
    pub limits: Vec<(u64, f64)>,
    /// Whether a value may not fall below its limit; else it may not pass it.
    pub at_least: bool,
    /// Whether the values are moments of a movement; else each holds until the next.
    pub moving: bool,
    /// Whether the limit applies to the mean and not to each value, as for shadow's findings in a sequence.
    pub limits_mean: bool,
}

impl LimitedSeries {
    /// The value and the limit in force at a time.
    #[must_use]
    pub fn at(&self, at_ms: u64) -> (Option<f64>, Option<f64>) {
        let limit = in_force(&self.limits, at_ms).or_else(|| self.limits.first().map(|(_, limit)| *limit));
        (in_force(&self.values, at_ms), limit)
    }

    /// The mean of the values up to a time; absent if there is none.
    #[must_use]
    pub fn mean(&self, at_ms: u64) -> Option<f64> {
        let next = self.values.partition_point(|(time_ms, _)| *time_ms <= at_ms);
        let values = self.values.get(..next).filter(|values| !values.is_empty())?;
        Some(values.iter().map(|(_, value)| value).sum::<f64>() / values.len() as f64)
    }

    /// Whether a value is on the wrong side of a limit. A value that is not a number always is.
    #[must_use]
    pub fn is_past(&self, value: f64, limit: f64) -> bool {
        if self.at_least { !(value >= limit) } else { !(value <= limit) }
    }
}

/// The last value at or before a time.
fn in_force(points: &[(u64, f64)], at_ms: u64) -> Option<f64> {
    let next = points.partition_point(|(time_ms, _)| *time_ms <= at_ms);
    next.checked_sub(1).and_then(|last| points.get(last)).map(|(_, value)| *value)
}

/// The charts of a recording.
#[must_use]
pub fn groups(recording: &Recording) -> Vec<ChartSection> {
    let mut all: Vec<Series> = recording.series.clone();
    if !all.iter().any(|series| ChartGroup::of(&series.name) == ChartGroup::Tool) {
        all.extend(frame_series(&recording.pictures));
    }
    let mut groups: Vec<ChartSection> = Vec::new();
    for series in all.iter().filter(|series| limit_of(&series.name).is_none() && !series.points.is_empty()) {
        let limits = all.iter().find(|other| limit_of(&other.name) == Some(series.name.as_str()));
        let about = ChartGroup::of(&series.name);
        let chart = LimitedSeries {
            title: title(&series.name),
            values: series.points.clone(),
            limits: limits.map(|limits| limits.points.clone()).unwrap_or_default(),
            at_least: about == ChartGroup::Kappa,
            moving: about == ChartGroup::Tool,
            limits_mean: about == ChartGroup::Shadow,
        };
        match groups.iter_mut().find(|group| group.about == about) {
            Some(group) => group.charts.push(chart),
            None => groups.push(ChartSection { about, charts: vec![chart] }),
        }
    }
    groups.sort_by(|a, b| a.about.cmp(&b.about));
    groups
}

/// The series that a limit of this name belongs to.
fn limit_of(name: &str) -> Option<&str> {
    let (of, last) = name.rsplit_once('/')?;
    LIMITS.contains(&last).then_some(of)
}

fn title(name: &str) -> String {
    match name {
        "tool/speed" => "speed, m/s".to_owned(),
        "tool/force" => wording::FORCE_AT_THE_PADS.to_owned(),
        "tool/contact" => wording::FORCE_ON_SURROUNDINGS.to_owned(),
        "shadow/output" => "output divergence".to_owned(),
        "shadow/governance" => "governance divergence".to_owned(),
        "shadow/envelope" => "envelope divergence".to_owned(),
        "kappa/I" => "interface".to_owned(),
        "kappa/P" => "policy".to_owned(),
        "kappa/B" => "behavior".to_owned(),
        "kappa/R" => "recovery".to_owned(),
        other => other.split_once('/').map_or(other, |(_, rest)| rest).to_owned(),
    }
}

/// Speed and forces from the video frames.
fn frame_series(frames: &[VideoFrame]) -> Vec<Series> {
    type Value = fn(&VideoFrame) -> f32;
    type Limit = fn(&EnvelopeView) -> f32;
    let table: [(&str, Value, Limit); 3] = [
        ("tool/speed", |frame| frame.speed_m_s, |envelope| envelope.speed_m_s),
        ("tool/force", |frame| frame.force_n, |envelope| envelope.force_n),
        ("tool/contact", |frame| frame.contact_n, |envelope| envelope.contact_n),
    ];
    let both = table.into_iter().map(|(name, value, limit)| {
        let points = |of: &dyn Fn(&VideoFrame) -> Option<f32>| {
            let point = |frame: &VideoFrame| of(frame).map(|value| (frame.at_ms, f64::from(value)));
            frames.iter().filter_map(point).collect()
        };
        let values = points(&|frame| Some(value(frame)));
        let limits = points(&|frame| frame.envelope.as_ref().map(limit));
        [
            Series { name: name.to_owned(), points: values },
            Series { name: format!("{name}/limit"), points: limits },
        ]
    });
    both.flatten().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chart_group_and_limit_follow_from_the_name() {
        for (name, group, limit) in [
            ("tool/speed", ChartGroup::Tool, None),
            ("tool/speed/limit", ChartGroup::Tool, Some("tool/speed")),
            ("kappa/B/threshold", ChartGroup::Kappa, Some("kappa/B")),
            ("success", ChartGroup::Cell, None),
            ("weather/rain", ChartGroup::Other("weather".to_owned()), None),
            ("limit", ChartGroup::Cell, None),
        ] {
            assert_eq!((ChartGroup::of(name), limit_of(name)), (group, limit), "{name}");
        }
    }

    #[test]
    fn the_value_in_force_is_the_last_one_and_its_side_is_known() {
        let mut chart = LimitedSeries {
            title: String::new(),
            values: vec![(10, 1.0), (20, 2.0)],
            limits: vec![(15, 1.5)],
            at_least: false,
            moving: true,
            limits_mean: false,
        };
        for (at_ms, value) in [(9, None), (10, Some(1.0)), (19, Some(1.0)), (99, Some(2.0))] {
            assert_eq!(chart.at(at_ms), (value, Some(1.5)), "{at_ms}");
        }
        assert!(chart.is_past(2.0, 1.5) && !chart.is_past(1.5, 1.5) && chart.is_past(f64::NAN, 1.5));
        for (at_ms, mean) in [(9, None), (10, Some(1.0)), (20, Some(1.5))] {
            assert_eq!(chart.mean(at_ms), mean, "{at_ms}");
        }
        chart.at_least = true;
        assert!(chart.is_past(1.4, 1.5) && !chart.is_past(1.5, 1.5) && chart.is_past(f64::NAN, 1.5));
    }
}
