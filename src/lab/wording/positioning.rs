//! The paper's description of itself beside others, each line with its place here.

/// A table of fixed texts: its title, columns and note, and its rows; columns and cells are separated by `|`.
pub type FixedTable = ([&'static str; 3], &'static [&'static str]);

/// The stages that each body of work covers, by the words under the paper's figure 3.
pub const COMMUNITIES: FixedTable = (
    [
        "Which stage is covered by whom (the paper's figure 3)",
        "body of work | package | kappa_I | kappa_P | kappa_B | kappa_R | sandbox | shadow | activate | monitor",
        "The paper draws it; these are the words below its drawing, and its judgment of others. Empty: not named as covered. \
         What is done here in each cell of the last row stands in the next table, by what goes wrong.",
    ],
    &[
        "robot architectures, middleware | yes |  |  |  |  |  |  |  | ",
        "modular skills, continual learning | in part |  |  |  |  | in part |  |  | ",
        "safe robotics, runtime governance |  |  | in execution | in execution | in execution |  |  |  | yes",
        "guardrails of LLM agents |  |  | of a plan |  |  |  |  |  | of a plan",
        "MLOps deployment |  |  |  |  |  | yes | yes | yes | yes",
        "here | yes | yes | yes | yes | yes | yes | yes | yes | yes",
    ],
);

/// Faults, and where each is handled.
pub const COVERAGE: FixedTable = (
    [
        "What is done about it, and when",
        "what goes wrong | package | kappa_I | kappa_P | kappa_B | kappa_R | sandbox | shadow | activate | monitor",
        "The kappas are those of validation: estimates without a run.",
    ],
    &[
        "callers break | exports are read | yes |  |  |  | runs | runs | neighbors | ",
        "more is permitted | declared use |  | yes |  |  | use is compared with it | guard | site policies | guard",
        "behaves worse |  |  |  | estimate |  | paired episodes | twin | measured values alone | charts",
        "does more harm |  |  |  |  |  | 21 measures, search | 21 measures |  | charts, safety trips",
        "cannot be stopped or undone | hooks named |  |  |  | declared | drills in every phase |  | rollback target kept \
         | ladder",
        "is not what was tested | digest |  |  |  |  | bound to digests | compared with sandbox | stale evidence closes | \
         compared with shadow",
        "no person is accountable for it | author, provenance |  |  |  |  | on record | on record | people's signatures | \
         audit closed",
    ],
);

/// Common practice and ours.
pub const DEVOPS: FixedTable = (
    ["Common practice and here (the paper's table 1)", "concern | DevOps, MLOps | here | where", ""],
    &[
        "compatibility | API schema diff; accuracy on a held-out set | four dimensions: interface, policy, behavior, \
         recovery | src/governance/{interface,policy,behavior,recovery}",
        "canary, shadow | traffic split across replicas | one actuator; the twin works in a world of its own beside the \
         live one | src/engine/live/shadow.rs",
        "health signal | status, latency, error rate | violations, anomalies, recovery, harm by forces and clearances | \
         src/governance/monitor.rs, harm.rs",
        "rollback trigger | threshold on stateless requests | charts over live tasks, safety events within a tick | \
         src/governance/monitor.rs, src/engine/live/supervisor.rs",
        "rollback semantics | route to the old container | arm to standstill, rollback target from the store by digest, \
         policies compiled again | src/engine/decide/stages/rollback.rs",
        "environment | region | profiles sim, real, human, and own ones | profiles/*.toml",
        "safety constraint | error budget | speed, force, zones and collisions, checked on every command | \
         src/runtime/guard.rs",
    ],
);

/// Dimension; middleware and skills, capability learning, runtime governance, ours; where.
pub const POSITION: FixedTable = (
    [
        "Position (the paper's table 2)",
        "dimension | middleware and skills | capability learning | runtime governance | here | where",
        "The three middle columns are the paper's judgment of others; ours says where to look.",
    ],
    &[
        "persistent agent | half | none | half | full | src/runtime/agent",
        "capability packages | half | half | none | full | src/runtime/capability.rs, src/governance/manifest.rs",
        "versions of capabilities | none | half | none | full | src/registry",
        "governed execution | half | half | full | full | src/runtime/guard.rs, watcher.rs",
        "governed upgrades | none | none | none | full | src/engine/decide/stages",
        "deployment that can be rolled back | none | half | half | full | src/engine/decide/stages/rollback.rs",
    ],
);
