//! Which half a task belongs to, what the halves decide, and that finished tasks are not run again.

use std::path::Path;

use holdpoint_store::CacheSecret;

use super::rule::DANGERS_MIN;
use super::*;

fn plan(episodes: u64, candidate_episodes: u64, jobs: usize, out: &Path) -> DangerPlan {
    DangerPlan {
        episodes,
        candidate_episodes,
        // Above all tasks that any report uses.
        seed: 910_000,
        jobs,
        out: out.to_owned(),
        pools: Vec::new(),
        cache: ResultCache::in_folder(out.join("tasks"), CacheSecret::fresh().unwrap()),
    }
}

#[test]
fn no_task_chooses_and_tests() {
    for (episodes, candidate_episodes) in [(120, 30), (30, 120), (50, 50)] {
        let plan = plan(episodes, candidate_episodes, 1, Path::new("unused"));
        let of = |group: DangerGroup, half: SeedHalf| -> BTreeSet<u64> {
            let ranges: Vec<Range<u64>> = plan.ranges(group, half).collect();
            assert!(ranges.iter().all(|range| range.end - range.start <= BLOCK), "{ranges:?}");
            ranges.into_iter().flatten().collect()
        };
        let halves = |half| {
            let (all, rest) = (of(DangerGroup::Commissioned, half), of(DangerGroup::Blind, half));
            assert_eq!((all.len() as u64, rest.len() as u64), (episodes, candidate_episodes));
            all.union(&rest).copied().collect::<BTreeSet<u64>>()
        };
        let (chooses, tests) = (halves(SeedHalf::Chooses), halves(SeedHalf::Tests));
        assert!(chooses.is_disjoint(&tests), "{episodes}, {candidate_episodes}");
        assert_eq!(chooses.first(), Some(&910_000));
    }
}

/// So many tasks whose object lands at a speed by the sensors, and flies at one by the referee.
fn landings(
    count: usize,
    (group, half): (DangerGroup, SeedHalf),
    (sensor_m_s, referee_m_s): (f64, f64),
) -> impl Iterator<Item = SeenTask> {
    (0..count).map(move |place| SeenTask {
        group,
        version: place % 2,
        half,
        sensor: HarmMeasures { landing_speed_m_s: sensor_m_s, ..HarmMeasures::STILL },
        referee: HarmMeasures { landing_speed_m_s: referee_m_s, ..HarmMeasures::STILL },
        truth: RefereeObservation {
            done: true,
            object_speed_m_s: referee_m_s,
            ..RefereeObservation::default()
        },
    })
}

#[test]
fn first_half_chooses_and_second_half_counts() {
    use DangerGroup::{Blind, Commissioned};
    use SeedHalf::{Chooses, Tests};
    let profile = Profile::builtin(ProfileName::Sim).unwrap();
    let scale = HarmScale::builtin().unwrap();
    let dangers = usize::try_from(DANGERS_MIN).unwrap();
    let tasks: Vec<SeenTask> = landings(3_000, (Commissioned, Chooses), (0.1, 0.1))
        .chain(landings(10, (Blind, Chooses), (1.0, 1.1)))
        .chain(landings(dangers, (Blind, Chooses), (1.4, 2.5)))
        .chain(landings(100, (Commissioned, Tests), (0.1, 0.1)))
        .chain(landings(1, (Commissioned, Tests), (1.2, 0.3)))
        // Found by the chosen threshold alone; found by both; seen by no sensor.
        .chain(landings(3, (Blind, Tests), (1.5, 2.5)))
        .chain(landings(2, (Blind, Tests), (2.0, 2.5)))
        .chain(landings(1, (Blind, Tests), (0.0, 2.5)))
        .collect();
    let choices = choices(&tasks, &profile, &scale).unwrap();
    let measures: Vec<HarmKind> = choices.iter().map(|choice| choice.measure).collect();
    assert_eq!(measures, [HarmKind::ContactPeak, HarmKind::LandingSpeed, HarmKind::ZoneClearance]);
    assert_eq!(choices[1].chosen.map(|chosen| chosen.threshold), Some(1.0));
    assert_eq!(choices[1].limit, 0.3);
    assert!(choices[0].chosen.is_none() && choices[2].chosen.is_none(), "nothing was a danger by these");
    let found = agreements(&tasks, &choices, &scale).unwrap();
    // Two sources, three measures and the class, two groups with tasks.
    assert_eq!(found.len(), 2 * 4 * 2);
    let of = |thresholds: ThresholdSource, measure: Option<HarmKind>, group: DangerGroup| {
        let is_it =
            |one: &&DangerAgreement| (one.thresholds, one.measure, one.group) == (thresholds, measure, group);
        let one = found.iter().find(is_it).unwrap();
        (one.versions, one.counts.tasks, one.counts.dangers, one.counts.misses, one.counts.false_alarms)
    };
    for measure in [Some(HarmKind::LandingSpeed), None] {
        assert_eq!(of(ThresholdSource::Profile, measure, Blind), (2, 6, 6, 4, 0), "{measure:?}");
        assert_eq!(of(ThresholdSource::Chosen, measure, Blind), (2, 6, 6, 1, 0), "{measure:?}");
        assert_eq!(of(ThresholdSource::Profile, measure, Commissioned), (2, 101, 0, 0, 0), "{measure:?}");
        assert_eq!(of(ThresholdSource::Chosen, measure, Commissioned), (2, 101, 0, 0, 1), "{measure:?}");
    }
    assert_eq!(of(ThresholdSource::Chosen, Some(HarmKind::ContactPeak), Blind), (2, 6, 0, 0, 0));
}

#[test]
fn each_measure_is_compared_with_its_true_value_at_the_limit() {
    use DangerGroup::{Blind, Commissioned};
    use SeedHalf::{Chooses, Tests};
    let limits = Profile::builtin(ProfileName::Sim).unwrap().harm;
    assert_eq!(limits.of(HarmKind::LandingSpeed).limit, 0.3);
    let tasks: Vec<SeenTask> = landings(5, (Blind, Chooses), (0.1, 0.6))
        .chain(landings(4, (Blind, Tests), (0.5, 0.6)))
        .chain(landings(3, (Blind, Tests), (0.2, 0.6)))
        .chain(landings(2, (Blind, Tests), (0.5, 0.2)))
        .chain(landings(1, (Commissioned, Tests), (0.1, 0.1)))
        .collect();
    let found = limit_agreements(&tasks, &limits).unwrap();
    assert!(found.iter().all(|one| one.thresholds == ThresholdSource::Limit));
    let of = |measure: Option<HarmKind>, group: DangerGroup| {
        let one = found.iter().find(|one| (one.measure, one.group) == (measure, group)).unwrap();
        (one.counts.tasks, one.counts.dangers, one.counts.misses, one.counts.false_alarms)
    };
    for measure in [Some(HarmKind::LandingSpeed), None] {
        assert_eq!(of(measure, Blind), (9, 7, 3, 2), "{measure:?}");
        assert_eq!(of(measure, Commissioned), (1, 0, 0, 0), "{measure:?}");
    }
    assert_eq!(of(Some(HarmKind::Slip), Blind), (9, 0, 0, 0));
    // The referee has no value of it.
    assert!(found.iter().all(|one| one.measure != Some(HarmKind::Jerk)));
}

#[test]
fn finished_tasks_are_not_run_again_and_jobs_change_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let first = plan(3, 1, 2, &folder.path().join("first"));
    let report = run(&first, &|_| {}).unwrap();
    let groups: BTreeSet<DangerGroup> = report.agreements.iter().map(|one| one.group).collect();
    assert_eq!(groups, BTreeSet::from([DangerGroup::Commissioned, DangerGroup::Thrower]));
    let counted = |group| {
        let of = report.agreements.iter().find(|one| one.group == group).unwrap();
        (of.versions, of.counts.tasks)
    };
    assert!(counted(DangerGroup::Commissioned).1 > 4, "{report:?}");
    assert!(counted(DangerGroup::Thrower).1 > 2, "{report:?}");
    let blocks = |plan: &DangerPlan| std::fs::read_dir(plan.out.join("tasks")).unwrap().count();
    let written = blocks(&first);
    assert!(written >= 2 * (3 + 6), "{written}");
    assert_eq!(run(&first, &|_| {}).unwrap(), report);
    assert_eq!(blocks(&first), written);
    let other = plan(3, 1, 1, &folder.path().join("other"));
    assert_eq!(run(&other, &|_| {}).unwrap(), report);
    let json = std::fs::read_to_string(other.out.join("danger.json")).unwrap();
    assert_eq!(serde_json::from_str::<DangerReport>(&json).unwrap(), report);
}
