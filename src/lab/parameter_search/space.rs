//! The parameters that are searched, as a point of the unit box.
//!
//! Owns the mapping and its rounding. Reads ranges from the controller and order from the baseline's file; must not
//! know what a parameter is for. Switches and styles are no numbers and stay as the baseline has them.

use toml_edit::DocumentMut;

use super::settings::RefineError;
use holdpoint_governance::manifest::BundleSource;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::skill::native::Controller;

/// Steps per unit that a real value is rounded to: 0.1 mm, 0.1 ms, 0.1 mm/s, 0.1 mN. A file that a person reads
/// has no use for more digits, and what is evaluated is exactly what is written.
const STEPS_PER_UNIT: f64 = 1e4;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axis {
    /// Its name in the parameter file.
    pub name: &'static str,
    pub baseline: f64,
    /// Lowest value the controller takes.
    pub lowest: f64,
    /// Highest value the controller takes.
    pub highest: f64,
    /// Whether it counts something.
    pub whole: bool,
}

/// The box around a baseline.
#[derive(Clone, Debug)]
pub struct Space {
    axes: Vec<Axis>,
    params: DocumentMut,
}

impl Space {
    /// The parameters of a native baseline.
    ///
    /// # Errors
    /// If it is not native, or its parameters do not parse.
    pub fn of(baseline: &Capability) -> Result<Self, RefineError> {
        let text = &baseline.package.params;
        let BundleSource::Native(name) = &baseline.manifest.deployment.bundle else {
            return Err(RefineError::NoBaseline(baseline.id().family));
        };
        let controller = Controller::parse(name, "params.toml", text)?;
        let params: DocumentMut =
            text.parse().map_err(|source| RefineError::Edit { file: "params.toml", source })?;
        let axis = |(name, baseline, lowest, highest)| {
            let whole = params.get(name).is_some_and(toml_edit::Item::is_integer);
            Axis { name, baseline, lowest, highest, whole }
        };
        let axes = controller.ranges().into_iter().map(axis).collect();
        Ok(Self { axes, params })
    }

    /// The parameters, in the order of points and values.
    #[must_use]
    pub fn axes(&self) -> &[Axis] {
        &self.axes
    }

    /// The baseline's place in the unit box.
    #[must_use]
    pub fn start(&self) -> Vec<f64> {
        self.axes.iter().map(|axis| (axis.baseline - axis.lowest) / (axis.highest - axis.lowest)).collect()
    }

    /// The values at a point of the unit box, rounded; what is outside is taken to its edge.
    #[must_use]
    pub fn values(&self, point: &[f64]) -> Vec<f64> {
        let value = |(axis, share): (&Axis, &f64)| {
            let value = axis.lowest + share.clamp(0.0, 1.0) * (axis.highest - axis.lowest);
            let steps = if axis.whole { 1.0 } else { STEPS_PER_UNIT };
            (libm::round(value * steps) / steps).clamp(axis.lowest, axis.highest)
        };
        self.axes.iter().zip(point).map(value).collect()
    }

    /// The baseline's parameter file with these values.
    #[must_use]
    pub fn text(&self, values: &[f64]) -> String {
        let mut params = self.params.clone();
        for (axis, value) in self.axes.iter().zip(values) {
            // Whole numbers of a range below 100.
            #[allow(clippy::cast_possible_truncation)]
            let item = if axis.whole { toml_edit::value(*value as i64) } else { toml_edit::value(*value) };
            params.insert(axis.name, item);
        }
        params.to_string()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use holdpoint_trials::embedded::baselines;

    #[test]
    fn the_start_is_the_baseline_itself() {
        for baseline in baselines().unwrap() {
            let space = Space::of(&baseline).unwrap();
            let text = space.text(&space.values(&space.start()));
            assert_eq!(text, baseline.package.params, "{}", baseline.id());
        }
    }

    proptest! {
        #[test]
        fn every_point_is_a_parameter_file_that_loads(
            family in 0_usize..4,
            point in prop::collection::vec(-0.5_f64..1.5, 64),
        ) {
            let baseline = &baselines().unwrap()[family];
            let space = Space::of(baseline).unwrap();
            let values = space.values(&point[..space.start().len()]);
            let name = match &baseline.manifest.deployment.bundle {
                BundleSource::Native(name) => name.clone(),
                BundleSource::Wasm(_) => unreachable!("baselines are native"),
            };
            let controller = Controller::parse(&name, "params.toml", &space.text(&values)).unwrap();
            let written: Vec<f64> = controller.ranges().iter().map(|(_, value, _, _)| *value).collect();
            prop_assert_eq!(written, values);
        }
    }
}
