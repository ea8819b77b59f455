//! What a second look does before the anchor runs its seeds.

use super::*;
use crate::evaluation::EvaluationPlan;
use crate::scene_stops::SceneStops;
use holdpoint_governance::evidence::{EpisodeValues, EvidenceBinding, Pair};
use holdpoint_governance::ids::Digest;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::tries::{CountedTry, TryAuthor};

const GOOD: EpisodeValues = EpisodeValues { time_s: 5.0, ..EpisodeValues::CLEAN };
const FAILED: EpisodeValues = EpisodeValues { success: false, ..GOOD };

/// A try with 30 equal pairs, for which the anchor has run, and without drills and sequences.
fn first_look(profile: &Profile) -> Evaluation {
    let digest = Digest::of_parts("test", &[]);
    let binding = EvidenceBinding {
        candidate: digest,
        active: None,
        profile: digest,
        policy: digest,
        environment: digest,
        neighbours: None,
        anchor: None,
    };
    let plan = EvaluationPlan { drills: 0, sequences: 0, ..EvaluationPlan::sandbox(profile) };
    let plan = plan.with_anchor(true).with_pairs(30);
    let mut evaluation = Evaluation::new(plan, binding, SceneStops::default());
    evaluation.counted = Some(CountedTry {
        subject: digest,
        drawn: None,
        author: TryAuthor::default(),
        by_author: 1,
        in_family: 1,
        level: 0.05,
        pairs: 30,
        left: 11,
    });
    add_pairs(&mut evaluation, 0..30, |_| GOOD);
    let episodes = (0..30).map(|seed| AnchorEpisode { seed, values: GOOD }).collect();
    evaluation.anchor = Some(AnchorEvidence { version: "align@1.0.0".parse().unwrap(), episodes });
    evaluation.anchored = 30;
    evaluation.is_late = true;
    evaluation
}

fn add_pairs(
    evaluation: &mut Evaluation,
    seeds: std::ops::Range<u64>,
    candidate: impl Fn(u64) -> EpisodeValues,
) {
    evaluation.pairs_tried = seeds.end;
    let pairs = seeds.map(|seed| Pair {
        seed,
        active: GOOD,
        candidate: candidate(seed),
        live_like: seed.is_multiple_of(3),
    });
    evaluation.pairs.extend(pairs);
}

/// The anchor ran 60 more episodes for a version that its pairs rejected already.
#[test]
fn second_look_that_rejects_runs_no_more_of_the_anchor() {
    let profile = Profile::builtin(ProfileName::Sim).unwrap();
    for is_worse in [true, false] {
        let mut evaluation = first_look(&profile);
        assert!(!evaluation.is_lost(&profile), "it is open only for its margin");
        assert!(evaluation.begin_second_look(&profile));
        let fails = |seed: u64| is_worse && seed.is_multiple_of(2);
        add_pairs(&mut evaluation, 30..90, |seed| if fails(seed) { FAILED } else { GOOD });
        assert_eq!(evaluation.next_turn(), Some(NextSlice::Anchor));
        assert!(!evaluation.is_begun(NextSlice::Anchor), "it is asked first whether the pairs reject");
        assert_eq!(evaluation.is_lost(&profile), is_worse);
    }
}
