//! Charts: measurements of the tool, the pairs, the shadow, the four kappas and the monitor, with its limits.

use rerun::archetypes::Scalars;

use super::{Drawing, part, style};
use crate::limits::{LIMIT_EVERY_MS, TEXT_WIDTH_MAX};
use crate::rows::RowTime;
use holdpoint_governance::decision::Dimension;
use holdpoint_protocol::event::{DimensionResult, Event, EventKind};
use holdpoint_protocol::film::FilmFrame;
use holdpoint_protocol::monitor_chart::ChartView;
use holdpoint_protocol::snapshot::{CandidateView, MonitorView, PairsView, ShadowView, Snapshot};
use holdpoint_protocol::video_frame::VideoFrame;
use holdpoint_text::Untrusted;

impl Drawing {
    pub(super) fn draw_tool(&mut self, frame: &VideoFrame, time: &RowTime) {
        let values = [frame.speed_m_s, frame.force_n, frame.contact_n];
        for (chart, value) in style::tool_charts().into_iter().zip(values) {
            self.value(chart, f64::from(value), time);
        }
        let Some(envelope) = frame.envelope else { return };
        let limits = [envelope.speed_m_s, envelope.force_n, envelope.contact_n];
        for (chart, limit) in style::tool_charts().into_iter().zip(limits) {
            self.limit(chart, f64::from(limit), frame.at_ms, time);
        }
    }

    /// Joints and tool of one version as named columns, from the base on: angles in rad, torques in N m, speed in m/s,
    /// forces in N.
    pub(super) fn draw_columns(&mut self, who: &str, frame: &FilmFrame, time: &RowTime) {
        for (name, values) in [("q", &frame.q), ("tau", &frame.tau)] {
            for (joint, value) in (1..).zip(values) {
                self.column(&format!("joints/{who}/{name}{joint}"), *value, time);
            }
        }
        let tool = [("speed", frame.speed_m_s), ("grip", frame.grip_n), ("contact", frame.contact_n)];
        for (name, value) in tool {
            self.column(&format!("tool/{who}/{name}"), value, time);
        }
    }

    fn column(&mut self, path: &str, value: f32, time: &RowTime) {
        if value.is_finite() {
            self.rows.at(path, time, &Scalars::single(f64::from(value)));
        }
    }

    pub(super) fn draw_event(&mut self, event: &Event, time: &RowTime) {
        if let EventKind::Decided { version, dimensions, .. } = &event.kind
            && self.version.as_ref() == Some(version)
        {
            for dimension in dimensions {
                self.draw_kappa(dimension, event.at_ms, time);
            }
        }
    }

    fn draw_kappa(&mut self, dimension: &DimensionResult, at_ms: u64, time: &RowTime) {
        let letter = match dimension.dimension {
            Dimension::Interface => "I",
            Dimension::Policy => "P",
            Dimension::Behavior => "B",
            Dimension::Recovery => "R",
            Dimension::Composition
            | Dimension::Shadow
            | Dimension::Gate
            | Dimension::Approval
            | Dimension::Monitor => return,
        };
        if let Some(kappa) = dimension.kappa {
            let chart = format!("kappa/{letter}");
            self.value(&chart, kappa, time);
            self.limits.remove(&chart);
            self.limit(&chart, dimension.threshold, at_ms, time);
        }
    }

    pub(super) fn draw_snapshot(&mut self, snapshot: &Snapshot, time: &RowTime) {
        let Some(version) = self.version.clone() else { return };
        if let Some(view) = snapshot.candidates.iter().find(|view| view.version == version) {
            self.draw_candidate(view, snapshot.at_ms, time);
        }
        if let Some(monitor) = snapshot.live.monitors.iter().find(|monitor| monitor.version == version) {
            self.draw_monitor(monitor, snapshot.at_ms, time);
        }
    }

    fn draw_candidate(&mut self, view: &CandidateView, at_ms: u64, time: &RowTime) {
        if let Some(pairs) = &view.pairs {
            self.draw_pairs(pairs, time);
        }
        if let Some(shadow) = &view.shadow {
            self.draw_shadow(shadow, at_ms, time);
        }
    }

    fn draw_pairs(&mut self, pairs: &PairsView, time: &RowTime) {
        if pairs.n == self.pairs_drawn || pairs.n == 0 {
            return;
        }
        self.pairs_drawn = pairs.n;
        for (who, means) in [("active", &pairs.active), ("candidate", &pairs.candidate)] {
            self.value(&format!("pairs/success/{who}"), means.success, time);
            self.value(&format!("pairs/violations/{who}"), means.violation, time);
            self.value(&format!("pairs/anomalies/{who}"), means.anomaly, time);
        }
    }

    /// Only the new part of the series: one value for each shadowed sequence.
    fn draw_shadow(&mut self, shadow: &ShadowView, at_ms: u64, time: &RowTime) {
        // A restarted shadow counts from 0 again.
        let drawn = if shadow.series.len() < self.shadow_drawn { 0 } else { self.shadow_drawn };
        let Some([output, governance, envelope]) = shadow.series.last().copied() else { return };
        if shadow.series.len() == drawn {
            return;
        }
        self.shadow_drawn = shadow.series.len();
        // If several arrived since the last snapshot, the last one is drawn: they have no time of their own.
        let values = [("output", output), ("governance", governance), ("envelope", envelope)];
        for ((name, value), limit) in values.into_iter().zip(shadow.limits) {
            let chart = format!("shadow/{name}");
            self.value(&chart, f64::from(value), time);
            if let Some(limit) = limit {
                self.limit(&chart, limit, at_ms, time);
            }
        }
    }

    fn draw_monitor(&mut self, monitor: &MonitorView, at_ms: u64, time: &RowTime) {
        if monitor.episodes == self.monitored {
            return;
        }
        let first = self.monitored == 0;
        self.monitored = monitor.episodes;
        for (index, ChartView { rate, level, value, limit }) in monitor.charts.iter().enumerate() {
            let name = format!("{rate} {level}");
            let name = name.trim_end();
            let chart = format!("monitor/{}", part(name));
            if first {
                let shown = Untrusted::new(name).display(TEXT_WIDTH_MAX).into_string();
                let look = style::line(&shown, style::monitor_color(index), false);
                self.rows.always(&format!("plots/{chart}"), &look);
                let look = style::line(&format!("limit of {shown}"), style::monitor_color(index), true);
                self.rows.always(&format!("plots/{chart}/limit"), &look);
            }
            self.value(&chart, *value, time);
            self.limit(&chart, *limit, at_ms, time);
        }
    }

    fn value(&mut self, chart: &str, value: f64, time: &RowTime) {
        // A value that is not a number has no place in a chart.
        if value.is_finite() {
            self.rows.at(&format!("plots/{chart}"), time, &Scalars::single(value));
        }
    }

    /// Writes a limit if it changed or its last point is old.
    fn limit(&mut self, chart: &str, limit: f64, at_ms: u64, time: &RowTime) {
        let current = self.limits.get(chart).is_some_and(|(written_ms, written)| {
            *written == limit && at_ms >= *written_ms && at_ms < written_ms.saturating_add(LIMIT_EVERY_MS)
        });
        if current || !limit.is_finite() {
            return;
        }
        self.limits.insert(chart.to_owned(), (at_ms, limit));
        self.rows.at(&format!("plots/{chart}/limit"), time, &Scalars::single(limit));
    }
}
