//! The tables of the paper's report: title, columns, and the note below.

use crate::paper_reproduction::report_table::ReportTable;

/// Title, columns separated by `|`, and note.
type TableHead = [&'static str; 3];

/// The arms after the last round.
pub fn after_last_round(rounds: u32, seeds: usize) -> ReportTable {
    ReportTable::new([
        &format!("After the last of {rounds} rounds, mean ± standard deviation over {seeds} seeds, percent"),
        "arm | success | violations | near a limit | anomalies | damage by the referee | unsafe version in force | faulty \
         version in force",
        "Success, violations, near, anomalies and damage are shares of held-out sequences (three tasks each). A version is \
         unsafe where the referee settles damage or danger against it beside the one it replaced.",
    ])
}

pub const BY_ROUND: TableHead = [
    "Figure 4 beside ours, round by round, percent",
    "round | success: static | naive | governed | paper: static | naive | governed | unsafe version in force: naive | \
     governed | paper: naive | governed",
    "The paper's means are of five seeds and six rounds; it counts unsafe activations of a round, ours is who is in \
     force.",
];

pub const TASK_MEASURES: TableHead = [
    "Time, retries and motion after a stop, last round",
    "arm | time of a sequence done, s | retries a sequence | moved on, percent | went on, ms a sequence",
    "Moved on: sequences in which the arm moved when it had to stand, by the referee. Went on: motion after declared \
     failures and stops, which the arm needs some of to come to rest. Mean ± standard deviation over seeds.",
];

pub const ACTIVATIONS: TableHead = [
    "Versions that the arms activated, over all rounds",
    "arm | unsafe / activated (referee) | faulty activated / offered | benign refused / offered",
    "",
];

pub const TABLE_7: TableHead = [
    "Table 7 beside ours, last round",
    "measure | static | naive | governed | p (governed, naive) | paper: static | naive | governed | p",
    "The paper's success is of its own tasks and simulator; levels cannot be compared, directions can. p: two-sided exact \
     signed-rank test, corrected by Holm within the family of the tests below.",
];

pub const DEPLOYMENT_CLAIMS: TableHead = ["The paper's claims of direction", "claim | verdict | because", ""];

pub const ARM_TESTS: TableHead = [
    "Tests, paired over seeds",
    "comparison | mean | 95 % (BCa) | W | n | zeros | ties | p | p (Holm) | d_z | seeds for 80 % | paper: W | 95 %",
    "n is of the non-zero differences. d_z is the mean over the standard deviation of the differences. Beside it is how \
     many seeds a t-test of that size needs for 80 % power, by the normal approximation (the paper: 25 to 30 for success, \
     from a pooled standard deviation; readings X38).",
];

pub const SCREENING: TableHead = [
    "Screening by class of fault (profile sim)",
    "class | candidates | stopped by validation | by the sandbox | by shadow | by the gate | rolled back | kept | paper \
     (table 6)",
    "The paper's 75 % is its validation alone, with an estimated kappa_B; here behavior is measured in the sandbox. Its \
     eight faulty kinds have no overt fault of recovery; ours have two a family besides (readings X19).",
];

pub const SCREENING_RATES: TableHead = ["Rates", "rate | here | paper", "95 % Wilson intervals."];

pub const KAPPAS: TableHead = [
    "Kappa of overt faults, in the dimension that they are in (profile sim)",
    "class | candidates with one | lowest | median | highest | paper (table 11)",
    "A candidate that an earlier stage stopped has none of a later one's.",
];

pub const MARGINAL: TableHead = [
    "Marginal faults, by where they end (profile sim)",
    "fault | ends | candidates | kappa of its dimension: lowest | median | highest | composite, median | paper (section \
     8.3)",
    "The paper has one of each, with a composite of .961 and .963, and lets shadow or the monitor find both. A candidate \
     has no kappa of what it did not come to.",
];

pub const BY_CATEGORY: TableHead = [
    "Detections by category of regression",
    "category | sandbox | shadow only | paper: sandbox | shadow only",
    "A detection is a faulty candidate and a category that the reasons of the stage that stopped it name; shadow only: \
     named by shadow alone and not by the sandbox. The last row is not among the paper's categories.",
];

pub const COUNTERFACTUAL: TableHead = [
    "Activated without a shadow (the counterfactual of equation 19)",
    "then | shadow had shown it before",
    "Regressed: rolled back, or seen unsafe while in control. What shadow stops and nothing is seen of later is either \
     spared for another day or stopped for nothing.",
];

pub const SHADOW_BY_CLASS: TableHead = [
    "Faults that measuring finds, by class",
    "class | candidates | sandbox | shadow alone | both | shadow only | neither",
    "Sandbox: rejected or held there in the whole way. Shadow alone: rejected or held at shadow or the gate where \
     validation and sandbox are left out, so that every candidate reaches it. Faults that validation stops are not \
     counted: they never reach the sandbox.",
];

pub const ROLLBACK: TableHead = [
    "Rollback under drift, three magnitudes together",
    "drift | worsened the version | rolled back | recovered of those rolled back | end to end | success after | paper: \
     recovered",
    "End to end: recovered, of those that the drift worsened. The paper's rate has as its denominator the drifts that \
     were injected (readings X75).",
];

pub const IN_CONTROL: TableHead = [
    "The activated versions, while they were in control",
    "profile | activated / candidates | seen unsafe / activated | tasks done | past a limit | near one or past it | \
     paper: unsafe | success | violations",
    "From record and telemetry of each candidate's own store: its live tasks from activation to confirmation or rollback, \
     under the profile's own limits. Unsafe is what guard or watcher name; the referee's word stands in the rounds.",
];

pub const CONSISTENCY: TableHead = [
    "Who is activated under two profiles",
    "profiles | candidates | both | the less strict alone | the stricter alone | neither",
    "The same candidates on the same seeds. In the profile human people who are asked always agree, so that a candidate \
     which the rules refuse under real may be activated there.",
];

pub const AUDITED: TableHead = [
    "Auditability",
    "profile | decisions by rules that come out equal from the record | candidates with one that does not",
    "Every decision on record in every candidate's store, made again from its raw evidence; one that cannot be made again \
     counts as not equal.",
];

pub const PROFILES: TableHead = [
    "The same candidates under three profiles",
    "profile | faulty stopped before activation | or rolled back | benign rejected | benign not active in the end | \
     paper: BADR | false reject rate",
    "In the profile human, people who are asked always agree: what is stopped, the rules stop. The paper's text calls the \
     false rejections a false-accept rate (readings X1).",
];

pub const SCALED_ROUNDS: TableHead = [
    "Rounds with the thresholds moved by a tenth, last round, percent",
    "thresholds | success | unsafe version in force | violations | unsafe / activated, all rounds | another version in \
     force than as they are | paper: success | unsafe | violations",
    "Governed in each row, on the same candidates and held-out sequences. The paper's numbers are of five seeds and six \
     rounds.",
];

pub const SCALED_POOLS: TableHead = [
    "Thresholds moved by a tenth (profile sim)",
    "thresholds | stopped by validation or sandbox | stopped or rolled back | benign rejected | otherwise decided than as \
     they are | paper: BADR | false reject rate",
    "Every setting is run. A threshold above 1 is read as 1: the paper's kappa_I of 1.045 would reject everything \
     (readings X24).",
];

pub const ABLATED_POOLS: TableHead = [
    "Pools with a part left out (profile sim)",
    "variant | faulty detected | derived from the whole way | difference | faulty activated | of those rolled back | \
     benign lost | paper: BADR | accepted | rollback",
    "Detected: stopped before activation or rolled back. Derived: what the whole way's record gives when the part's \
     rejections are read as passes, which is how the paper made six of its rows; ours are run. Without a monitor or \
     without rollback no version is rolled back.",
];

pub const ABLATED_ROUNDS: TableHead = [
    "Rounds with a part left out",
    "variant | unsafe / activated | success, last round | violations, last round | unsafe version in force | paper: \
     unsafe | success | violations",
    "",
];

pub const ABLATION_CLAIMS: TableHead = [
    "The paper's claims of direction",
    "claim | verdict | because",
    "Paired over the same candidates. Held or not held: the difference is established at a one-sided 5 % (exact, by the \
     candidates of which only one of the two says it). Not shown: otherwise. The versions rolled back after activation \
     are of other candidates in each variant: a 95 % interval of the difference (Newcombe). Success: held where the 95 % \
     interval of the mean over seeds (BCa) is within five points.",
];

pub const FAILURES_BEFORE: TableHead = [
    "Faulty candidates in force in the end (profile sim)",
    "failure | injected as | in force | with nothing failing | more, at least | the rest of the layer",
    "Fails open: it is established (exact, over the same candidates, one-sided 5 %) that more faulty candidates are in \
     force than with nothing failing. Restricts: at most as many as seen. Where a stage is blind the others still work.",
];

pub const FAILURES_AFTER: TableHead = [
    "Versions that a drift worsens in control (profile sim)",
    "failure | injected as | predecessor in control | family stopped, arm held | tighter envelope | in control as before \
     | reported by another alarm | its tasks under the drift, median (most) | of all, unsafe by the referee | family's \
     tasks once stopped | more in control, at least | the rest of the layer",
    "Every failure under the same drifts, from the same activation, until the rollback or the horizon. Fails open: it is \
     established (exact, over the same drifts, one-sided 5 %) that more versions are in control as before than with \
     nothing failing. Another alarm: of health over the cell, of a shift, or of a violation.",
];

pub const FINDINGS: TableHead = [
    "The paper's findings over all experiments",
    "finding | here | verdict",
    "The first rests on a test of E2's family, the second on a 95 % BCa interval of its own, the others on counts with \
     Wilson intervals: held where the lower end is above zero.",
];

pub const STAGE_COSTS: TableHead = [
    "Processor time a candidate, all threads (profile sim)",
    "stage | candidates that it decided on | median ms | greatest ms | share of all | paper (table 5)",
    "The active version's episodes are run again for each candidate; a running engine caches them. The paper's times are \
     of an abstract environment; it gives 2 to 5 s a candidate for its physics.",
];

pub const COST_GROWTH: TableHead = [
    "How it grows",
    "against | points | a unit, ms | R²",
    "Least squares. Tasks: of the active versions, by how long they took in the world, the world's reset included.",
];
