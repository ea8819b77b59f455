//! A chart of a monitor: the rate, the level of the chart, its value and its limit.

use holdpoint_governance::closed_set::Lenient;
use holdpoint_governance::monitor::{ChartLevel, Rate};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A chart of a monitor. An older recording has its name, value and limit in a list, and is read as well.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(from = "ChartForm")]
pub struct ChartView {
    /// The charted rate.
    pub rate: Lenient<Rate>,
    /// What the monitor does at the limit.
    pub level: Lenient<ChartLevel>,
    /// The statistic of the chart.
    pub value: f64,
    /// The limit of the statistic.
    pub limit: f64,
}

#[derive(Deserialize, JsonSchema)]
#[serde(untagged)]
enum ChartForm {
    Fields { rate: Lenient<Rate>, level: Lenient<ChartLevel>, value: f64, limit: f64 },
    Older(String, f64, f64),
}

impl From<ChartForm> for ChartView {
    fn from(form: ChartForm) -> Self {
        match form {
            ChartForm::Fields { rate, level, value, limit } => Self { rate, level, value, limit },
            ChartForm::Older(name, value, limit) => {
                // The level is the last word of the name; a name without a level is that of the rate.
                let split = name.rsplit_once(' ').filter(|(_, level)| level.parse::<ChartLevel>().is_ok());
                let (rate, level) = split.unwrap_or((&name, ""));
                let (rate, level) = (rate.to_owned(), level.to_owned());
                Self { rate: Lenient::read(rate), level: Lenient::read(level), value, limit }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chart_reads_in_both_forms() {
        let read = |json: &str| serde_json::from_str::<ChartView>(json).unwrap();
        let chart = read("[\"near-limit warning\", 0.5, 2.0]");
        assert_eq!((&chart.rate, &chart.level), (&Rate::NearLimit.into(), &ChartLevel::Warning.into()));
        assert_eq!(read(&serde_json::to_string(&chart).unwrap()), chart);
        let older = read("[\"a rate of old\", 0.5, 2.0]");
        assert_eq!(
            (older.rate.to_string(), older.level.to_string()),
            ("a rate of old".into(), String::new())
        );
    }
}
