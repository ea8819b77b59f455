//! Handmade health over time, as from an engine in the middle of a shift.

use holdpoint_governance::alarms::{AlarmState, Priority};
use holdpoint_governance::health::HealthRate;
use holdpoint_governance::ids::Family;
use holdpoint_governance::notice::{Notice, NoticeOrText};
use holdpoint_governance::sensor_health::SensorSignal;
use holdpoint_governance::stats::wilson;
use holdpoint_protocol::health::{
    AlarmEpisode, AlarmStep, HealthClock, HealthCoverage, HealthMark, HealthPoint, HealthSeries, MarkKind,
};

use crate::shift::{NOW_MS, WALL_MS, id};

/// A shift of three families in 15-minute buckets: grasp gets worse after an upgrade, align has a gap, place is even.
pub fn health() -> HealthSeries {
    const QUARTER_MS: i64 = 900_000;
    let buckets = 73;
    let until_ms = (WALL_MS / QUARTER_MS + 1) * QUARTER_MS;
    let from_ms = until_ms - QUARTER_MS * i64::from(buckets);
    let mut points = Vec::new();
    for (family, seed) in [("align", 1_u64), ("grasp", 2), ("place", 3)] {
        for bucket in 5..buckets {
            let upgraded = family == "grasp" && bucket >= 40;
            if family == "align" && (20..30).contains(&bucket) {
                continue;
            }
            let tasks = 40 + u64::from(bucket) * seed % 7;
            let failed = (u64::from(bucket) * 7 + seed) % 3 + if upgraded { 5 } else { 0 };
            let succeeded = tasks - failed;
            let success = wilson(succeeded, tasks, 0.95).unwrap();
            let version = id(&format!("{family}@1.{}.0", u8::from(upgraded)));
            let at_ms = u64::from(bucket) * 900_000;
            points.push(HealthPoint {
                version,
                bucket,
                tasks,
                succeeded,
                success: [success.lower, success.upper],
                violated: failed / 2,
                near: failed,
                time_s: [4.0 + seed as f64 / 2.0, 6.0 + failed as f64 / 4.0],
                force_n: [15.0, 20.0 + failed as f64],
                at_ms: [at_ms, at_ms + 890_000],
            });
        }
    }
    let mark = |kind, bucket: i64, family: Option<&str>, text: &str| HealthMark {
        kind,
        on_clock_ms: from_ms + bucket * QUARTER_MS + 61_000,
        at_ms: u64::try_from(bucket).unwrap() * 900_000 + 61_000,
        wall_ms: Some(from_ms + bucket * QUARTER_MS + 61_000),
        family: family.map(|family| Family::new(family).unwrap()),
        text: text.to_owned(),
        record: 100,
    };
    let marks = vec![
        mark(
            MarkKind::EngineOff,
            5,
            None,
            "no engine was running for 8 h 12 min before this, or the machine slept",
        ),
        mark(MarkKind::Promotion, 40, Some("grasp"), "grasp@1.1.0 took over"),
        mark(
            MarkKind::DriftAlarm,
            61,
            Some("grasp"),
            "grasp@1.1.0 works worse than when the cell was commissioned",
        ),
        mark(MarkKind::Stopped, 66, None, "linus stopped the cell: a key fell into the tray"),
        mark(MarkKind::Released, 66, None, "linus let the cell work: the key is out"),
    ];
    let coverage =
        HealthCoverage { tasks: 7_000, blocks: 300, blocks_read: 300, ..HealthCoverage::default() };
    HealthSeries {
        clock: HealthClock::Wall,
        from_ms,
        bucket_ms: 900_000,
        buckets,
        last_at_ms: NOW_MS,
        last_wall_ms: Some(WALL_MS),
        points,
        marks,
        alarms: spells(),
        coverage,
        unsealed: [(Family::new("align").unwrap(), 9)].into(),
    }
}

/// The course of two alarms, one of which is still open.
fn spells() -> Vec<AlarmEpisode> {
    let step = |back_ms: u64, by: Option<&str>, reason: Option<&str>| AlarmStep {
        at_ms: NOW_MS - back_ms,
        wall_ms: Some(WALL_MS - i64::try_from(back_ms).unwrap()),
        by: by.map(str::to_owned),
        reason: reason.map(str::to_owned),
    };
    let open = AlarmEpisode {
        alarm: "degraded:grasp@1.1.0".to_owned(),
        priority: Priority::High,
        text: Some(NoticeOrText::from(Notice::Degraded {
            version: "grasp@1.1.0".parse().unwrap(),
            rate: HealthRate::Failure,
        })),
        raised: step(245_000, None, None),
        began_before: false,
        acknowledged: Some(step(200_000, Some("linus"), None)),
        shelved: None,
        over: None,
        reset: None,
        ended: None,
        state: AlarmState::Acknowledged,
        changes: 2,
    };
    let closed = AlarmEpisode {
        alarm: "cell-degraded".to_owned(),
        text: Some(NoticeOrText::from(Notice::CameraDegraded {
            signal: SensorSignal::PictureJitter,
            value: Some(0.0021),
            limit: 0.001,
        })),
        raised: step(700_000, None, None),
        acknowledged: Some(step(650_000, Some("grace"), None)),
        shelved: Some(step(640_000, Some("grace"), Some("the mount is on its way"))),
        over: Some(step(500_000, None, None)),
        reset: Some(step(400_000, Some("grace"), Some("a new mount"))),
        ended: Some(step(400_000, None, None)),
        state: AlarmState::Normal,
        changes: 6,
        ..open.clone()
    };
    vec![open, closed]
}
