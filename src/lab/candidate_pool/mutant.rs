//! Mutants: a version damaged blindly, by its parameters, its timing, what it sees and asks for, and its hooks.
//!
//! Reads no rule, profile or policy, and has no aim: only a mutant's episodes show its class. Numbers come from wide
//! distributions that depend on the number's own range or size, not on any limit of a check.

use holdpoint_cell::rng::Stream;
use holdpoint_runtime::skill::altered::{
    Alteration, AlterationTiming, AlteredHook, AlteredInput, AlteredOutput, HookOverride, WINDOW_TICKS_MAX,
};
use holdpoint_runtime::skill::native::Controller;
use toml::Value;

use super::PoolError;
use super::draft::Draft;
use super::generate::sample_integer;
use holdpoint_governance::manifest::BundleSource;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::skill::altered::FIELD;

/// The rate of damages to the parameters alone.
const PARAMETERS: f64 = 0.35;

/// The rate of changed parameters that take an end of their range.
const EXTREMES: f64 = 0.2;

/// Standard deviations of the logarithm by which a parameter walks.
const WALKS: [f64; 3] = [0.15, 0.4, 1.0];

/// The usual length of a task, ticks: windows and moments are sampled within it.
const WORK_TICKS: u16 = 1_200;

/// Damages a draft once to three times.
///
/// # Errors
/// [`PoolError::Generated`] if the draft is no version of a native controller.
pub fn damage(draft: &mut Draft, baseline: &Capability, stream: &mut Stream) -> Result<(), PoolError> {
    let times = match stream.unit() {
        draw if draw < 0.6 => 1,
        draw if draw < 0.9 => 2,
        _ => 3,
    };
    let mut alterations = Vec::new();
    for _ in 0..times {
        if stream.unit() < PARAMETERS {
            parameters(draft, baseline, stream)?;
        } else {
            alterations.push(alteration(stream));
        }
    }
    // A number may have stayed at the end of its range.
    while alterations.is_empty() && draft.differences().is_empty() {
        parameters(draft, baseline, stream)?;
    }
    if !alterations.is_empty() {
        let value = Value::try_from(&alterations).map_err(|error| fault(baseline, error.to_string()))?;
        draft.param(FIELD, value);
    }
    Ok(())
}

fn fault(baseline: &Capability, problem: String) -> PoolError {
    PoolError::Generated { name: format!("a mutant of {}", baseline.id()), problem }
}

/// The baseline's controller with its parameters.
fn controller(baseline: &Capability) -> Result<Controller, PoolError> {
    let BundleSource::Native(name) = &baseline.manifest.deployment.bundle else {
        return Err(fault(baseline, "its bundle has no parameters to change".to_owned()));
    };
    Controller::parse(name, "params.toml", &baseline.package.params)
        .map_err(|error| fault(baseline, error.to_string()))
}

/// Changes one parameter by 1 in 1,000: a real number that is not 0, up or down within its range.
///
/// # Errors
/// As [`damage`].
pub fn nudge(draft: &mut Draft, baseline: &Capability, stream: &mut Stream) -> Result<(), PoolError> {
    let mut changed: Vec<(&str, f64)> = Vec::new();
    for (name, value, lowest, highest) in controller(baseline)?.ranges() {
        let is_real = draft.params.get(name).is_some_and(Value::is_float);
        let new = [1.001, 0.999].map(|factor| (value * factor * 1e9).round() / 1e9);
        let allowed = |new: &f64| is_real && *new != value && (lowest..=highest).contains(new);
        changed.extend(new.into_iter().filter(allowed).map(|new| (name, new)));
    }
    let Some((name, new)) = changed.get(below(stream, changed.len())) else {
        return Err(fault(baseline, "it has no real parameter to change".to_owned()));
    };
    draft.param(name, *new);
    Ok(())
}

/// Changes one to three parameters: numbers walk or go to an end of their range, and a switch is thrown.
fn parameters(draft: &mut Draft, baseline: &Capability, stream: &mut Stream) -> Result<(), PoolError> {
    let controller = controller(baseline)?;
    let numbers = controller.ranges();
    let switches: Vec<String> =
        draft.params.iter().filter_map(|(name, value)| value.as_bool().map(|_| name.clone())).collect();
    for _ in 0..sample_integer(stream, [1, 3]) {
        let place = below(stream, numbers.len() + switches.len());
        if let Some((name, value, lowest, highest)) = numbers.get(place) {
            // Walks go on from what an earlier damage left.
            let value = draft.params.get(*name).and_then(number).unwrap_or(*value);
            let new = if stream.unit() < EXTREMES {
                if stream.unit() < 0.5 { *lowest } else { *highest }
            } else {
                let width = WALKS[below(stream, WALKS.len())];
                // Zero has no size of its own to walk by.
                let size = if value == 0.0 { 0.1 * (highest - lowest) } else { value.abs() };
                let sign = if value < 0.0 { -1.0 } else { 1.0 };
                let factor = (width * stream.normal()).exp();
                if value == 0.0 { size * (factor - 1.0) } else { sign * size * factor }
            }
            .clamp(*lowest, *highest);
            let is_whole = matches!(draft.params.get(*name), Some(Value::Integer(_)));
            #[allow(clippy::cast_possible_truncation, reason = "within the parameter's range")]
            let new = if is_whole { Value::from(new.round() as i64) } else { Value::from(rounded(new)) };
            draft.param(name, new);
        } else if let Some(name) = switches.get(place - numbers.len()) {
            let now = draft.params.get(name).and_then(Value::as_bool).unwrap_or(false);
            draft.param(name, !now);
        }
    }
    Ok(())
}

/// To six decimals, which keeps it in a range of that many.
fn rounded(value: f64) -> f64 {
    (value * 1e6).round() / 1e6
}

fn number(value: &Value) -> Option<f64> {
    value.as_float().or_else(|| value.as_integer().map(|value| value as f64))
}

/// A place below `count`, which is not 0.
fn below(stream: &mut Stream, count: usize) -> usize {
    sample_integer(stream, [0, u32::try_from(count.saturating_sub(1)).unwrap_or(u32::MAX)]) as usize
}

fn one_of<T: Copy, const N: usize>(stream: &mut Stream, of: [T; N]) -> T {
    of[below(stream, N)]
}

fn ticks(stream: &mut Stream, low: u16, high: u16) -> u16 {
    u16::try_from(sample_integer(stream, [u32::from(low), u32::from(high.min(WINDOW_TICKS_MAX))]))
        .unwrap_or(high)
}

/// One alteration, every kind as likely as another.
fn alteration(stream: &mut Stream) -> Alteration {
    let from = ticks(stream, 0, WORK_TICKS);
    // Short windows are as likely as long ones.
    let longest = one_of(stream, [12, 48, 240, 720]);
    let window = ticks(stream, 1, longest);
    match below(stream, 12) {
        0 => {
            let output = one_of(stream, AlteredOutput::ALL);
            Alteration::Output { output, factor: factor(stream), offset: 0.0, when: when(stream) }
        }
        1 => {
            let output = one_of(stream, AlteredOutput::ALL);
            Alteration::Output { output, factor: 1.0, offset: offset(stream, output), when: when(stream) }
        }
        2 => Alteration::Filter {
            output: one_of(stream, AlteredOutput::ALL),
            weight: rounded((-3.0 * stream.unit()).exp()),
        },
        3 => {
            let output = one_of(stream, AlteredOutput::ALL);
            Alteration::Quantise { output, step: rounded(offset(stream, output).abs().max(1e-5)) }
        }
        4 => Alteration::Flip {
            output: one_of(stream, [AlteredOutput::X, AlteredOutput::Y, AlteredOutput::Z]),
            when: rare(stream),
        },
        5 | 6 => {
            let input = one_of(stream, AlteredInput::ALL);
            let (factor, offset) = match below(stream, 4) {
                // Whatever is compared with it is never, or always, past it.
                0 => (0.0, 0.0),
                1 => (-1.0, 0.0),
                2 => (factor(stream), 0.0),
                _ => (1.0, input_offset(stream, input)),
            };
            Alteration::Input { input, factor, offset, when: when(stream) }
        }
        7 => Alteration::Delay { ticks: ticks(stream, 1, 60) },
        8 => match below(stream, 2) {
            0 => Alteration::Wait { from, ticks: window },
            _ => Alteration::Skip { from, ticks: window },
        },
        9 => match below(stream, 2) {
            0 => Alteration::Repeat { from, ticks: window },
            _ => Alteration::Swap { from, ticks: window },
        },
        10 => Alteration::Finish { tick: from },
        _ => Alteration::Hook {
            hook: one_of(stream, [AlteredHook::SafeAbort, AlteredHook::Rollback]),
            override_with: one_of(stream, [HookOverride::Nothing, HookOverride::Done, HookOverride::WorkOn]),
        },
    }
}

/// Between a fifth and five times, now and then the other way round.
fn factor(stream: &mut Stream) -> f64 {
    let size = (0.6 * stream.normal_bounded()).exp();
    rounded(if stream.chance(0.1) { -size } else { size })
}

/// The error in a number of commands, in its unit.
fn offset(stream: &mut Stream, output: AlteredOutput) -> f64 {
    let size = match output {
        AlteredOutput::X | AlteredOutput::Y | AlteredOutput::Z => 0.02,
        AlteredOutput::Speed | AlteredOutput::GripSpeed => 0.2,
        AlteredOutput::GripWidth => 0.01,
        AlteredOutput::GripForce => 10.0,
    };
    rounded(size * stream.normal_bounded())
}

/// The error in an observed value, in its unit.
fn input_offset(stream: &mut Stream, input: AlteredInput) -> f64 {
    let size = match input {
        AlteredInput::WristForce | AlteredInput::GripForce => 10.0,
        AlteredInput::GripWidth => 0.01,
        AlteredInput::ObjectX
        | AlteredInput::ObjectY
        | AlteredInput::ObjectZ
        | AlteredInput::TargetX
        | AlteredInput::TargetY => 0.02,
        AlteredInput::PictureAge => 30.0,
        AlteredInput::ToolAvailable => 1.0,
    };
    rounded(size * stream.normal_bounded())
}

/// Half of the time always.
fn when(stream: &mut Stream) -> AlterationTiming {
    if stream.chance(0.5) { AlterationTiming::Always } else { rare(stream) }
}

fn rare(stream: &mut Stream) -> AlterationTiming {
    match below(stream, 6) {
        0 => AlterationTiming::After { tick: ticks(stream, 0, WORK_TICKS) },
        1 => {
            let period = ticks(stream, 4, 480);
            AlterationTiming::Every { period, length: ticks(stream, 1, period / 4) }
        }
        2 => AlterationTiming::Gripping { above_n: rounded(stream.uniform(0.0, 30.0)) },
        3 => AlterationTiming::High { above_m: rounded(stream.uniform(0.0, 0.4)) },
        4 => AlterationTiming::Far { above_m: rounded(stream.uniform(0.3, 0.7)) },
        _ => AlterationTiming::Runs {
            share: rounded((-4.0 * stream.unit()).exp()),
            salt: ticks(stream, 0, WINDOW_TICKS_MAX),
        },
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::super::generate::{PoolSpec, draw};
    use super::super::{Class, Preset};

    /// Of two equal ones a family, one has the baseline's parameters and one has a single parameter that differs by 1 in 1,000.
    #[test]
    fn equal_candidates_differ_in_one_parameter_at_most() {
        let pool = draw(PoolSpec { seed: 5, sets: 20, preset: Preset::Equal }).unwrap();
        let truth: crate::candidate_pool::PoolTruth = serde_json::from_slice(&pool.truth).unwrap();
        let changes = |kind: &str| {
            let of_kind = truth.entries.iter().filter(|entry| entry.kind == kind);
            of_kind.map(|entry| entry.what.as_str()).collect::<Vec<_>>()
        };
        assert_eq!(changes("unchanged"), [""; 60]);
        let negligible = changes("negligible");
        assert_eq!(negligible.len(), 60);
        for what in negligible {
            let (old, new) = what.split_once(" -> ").unwrap();
            let number = |text: &str| text.rsplit(' ').next().unwrap().parse::<f64>().unwrap();
            let ratio = number(new) / number(old);
            assert!((0.0009..0.0011).contains(&(ratio - 1.0).abs()), "{what}");
        }
    }

    /// Every mutant loads (the generator checks it), none is the version it was made of, and every kind of damage is
    /// among those of a few.
    #[test]
    fn mutants_load_differ_and_are_of_many_kinds() {
        let order = PoolSpec { seed: 5, sets: 60, preset: Preset::Mutants };
        let pool = draw(order).unwrap();
        assert_eq!(pool, draw(order).unwrap());
        assert_eq!(pool.packages.len(), 180);
        let truth: crate::candidate_pool::PoolTruth = serde_json::from_slice(&pool.truth).unwrap();
        assert!(truth.entries.iter().all(|entry| entry.class == Class::Blind && !entry.what.is_empty()));
        let mut kinds: BTreeMap<String, u32> = BTreeMap::new();
        for package in &pool.packages {
            for kind in package.params.lines().filter_map(|line| line.strip_prefix("kind = ")) {
                *kinds.entry(kind.to_owned()).or_default() += 1;
            }
        }
        let seen: Vec<&str> = kinds.keys().map(|kind| kind.trim_matches('"')).collect();
        assert_eq!(
            seen,
            [
                "delay", "filter", "finish", "flip", "hook", "input", "output", "quantise", "repeat", "skip",
                "swap", "wait"
            ]
        );
        let altered =
            pool.packages.iter().filter(|package| package.params.contains("[[alteration]]")).count();
        assert!((90..=160).contains(&altered), "{altered} of 180 are altered beyond their parameters");
    }
}
