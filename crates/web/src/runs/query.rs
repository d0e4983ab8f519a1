//! The query of a run's pages: a selection, and the order of its episodes.

use std::collections::BTreeMap;

use gleaner_core::{
    Error, Group as _, Result, Values,
    score::ScoreRun,
    selection::{Rule, Selection, SelectionShape},
};
use serde::Deserialize;
use serde_json::Value;

use crate::{page_request::escaped, sheet::Format};

/// The parameters of the address.
#[derive(Debug, Default, Deserialize)]
pub(super) struct RunParameters {
    beta: Option<String>,
    top_fraction: Option<String>,
    sort: Option<String>,
    format: Option<Format>,
    #[serde(flatten)]
    others: Others,
}

/// Parameters by name, among them those of a shape: texts of addresses and forms, and numbers of JSON.
pub(super) type Others = BTreeMap<String, Value>;

/// The columns to sort by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Key {
    /// Kept segments out of the episode's.
    Share,
    /// Kept segments.
    Kept,
    /// The episode's segments.
    Segments,
    /// Mean q of all its segments.
    MeanQ,
}

impl Key {
    pub(super) const ALL: [Self; 4] = [Self::Share, Self::Kept, Self::Segments, Self::MeanQ];

    pub(super) fn as_str(self) -> &'static str {
        match self {
            Self::Share => "share",
            Self::Kept => "kept",
            Self::Segments => "segments",
            Self::MeanQ => "mean_q",
        }
    }
}

/// A key and its direction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Order {
    pub(super) key: Key,
    pub(super) descending: bool,
}

impl Order {
    /// `share`, or `-share` from the highest down.
    fn read(text: &str) -> Result<Self> {
        let (word, descending) = text.strip_prefix('-').map_or((text, false), |word| (word, true));
        let key = Key::ALL.into_iter().find(|key| key.as_str() == word).ok_or_else(|| {
            Error::invalid("sort", "must be share, kept, segments or mean_q, with a - before it from the highest down")
        })?;
        Ok(Self { key, descending })
    }

    pub(super) fn word(self) -> String {
        format!("{}{}", if self.descending { "-" } else { "" }, self.key.as_str())
    }
}

impl RunParameters {
    /// The selection; without a rule, the default threshold of the run.
    ///
    /// # Errors
    /// Invalid, naming the parameter.
    pub(super) fn selection(&self, run: &ScoreRun) -> Result<Selection> {
        let rule = rule(self.beta.as_deref(), self.top_fraction.as_deref())?;
        let rule = rule.unwrap_or_else(|| Rule::Beta(run.origin.default_beta()));
        Ok(Selection { rule, shape: shape(&self.others)? })
    }

    /// # Errors
    /// Invalid.
    pub(super) fn order(&self) -> Result<Order> {
        self.sort.as_deref().map_or(Ok(Order { key: Key::Share, descending: true }), Order::read)
    }

    /// The requested format, or the default.
    pub(super) fn format(&self, usual: Format) -> Format {
        self.format.unwrap_or(usual)
    }
}

/// Parses a rule from two parameters, of which at most one is set.
///
/// # Errors
/// Invalid, naming `beta` or `top_fraction`.
pub(super) fn rule(beta: Option<&str>, top_fraction: Option<&str>) -> Result<Option<Rule>> {
    match (beta, top_fraction) {
        (None, None) => Ok(None),
        (Some(_), Some(_)) => Err(Error::invalid("top_fraction", "is set together with beta; set one of them")),
        (Some(beta), None) => {
            let beta = number("beta", beta)?;
            if !(0.0..=1.0).contains(&beta) {
                return Err(Error::invalid("beta", format!("is {beta}, must be between 0 and 1")));
            }
            Ok(Some(Rule::Beta(beta)))
        }
        (None, Some(part)) => {
            let part = number("top_fraction", part)?;
            if !(part > 0.0 && part <= 1.0) {
                return Err(Error::invalid("top_fraction", format!("is {part}, must be above 0 and at most 1")));
            }
            Ok(Some(Rule::TopFraction(part)))
        }
    }
}

/// Parses the parameters of a shape; those that are missing or empty take their defaults.
///
/// # Errors
/// Invalid, naming the parameter.
pub(super) fn shape(parameters: &Others) -> Result<SelectionShape> {
    let mut values = Values::new();
    for setting in SelectionShape::schema() {
        let value = match parameters.get(&setting.name) {
            None => continue,
            Some(Value::String(text)) if text.trim().is_empty() => continue,
            Some(Value::String(text)) => number(&setting.name, text)?.into(),
            Some(given) => given.clone(),
        };
        values.insert(setting.name, value);
    }
    SelectionShape::from_values(&values).map_err(|problem| Error::invalid(&problem.field, problem.message))
}

fn number(field: &str, text: &str) -> Result<f64> {
    let read = text.trim().parse::<f64>().ok().filter(|number| number.is_finite());
    let shown: String = text.chars().take(32).collect();
    read.ok_or_else(|| Error::invalid(field, format!("{shown:?} is not a number; use one such as 0.8")))
}

/// A selection as parameters of an address.
pub(crate) fn parameters(selection: Selection) -> String {
    let given = fields(selection).into_iter().map(|(name, value)| format!("{name}={}", escaped(&value)));
    given.collect::<Vec<_>>().join("&")
}

/// A selection as names and values: its rule, and the changed settings of its shape.
pub(super) fn fields(Selection { rule, shape }: Selection) -> Vec<(String, String)> {
    let rule = match rule {
        Rule::Beta(beta) => ("beta".to_owned(), beta.to_string()),
        Rule::TopFraction(part) => ("top_fraction".to_owned(), part.to_string()),
    };
    std::iter::once(rule).chain(shape.changed().into_iter().map(|(name, value)| (name, value.to_string()))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn invalid_thresholds_are_refused_by_name() {
        assert_eq!(rule(Some(" 0.75 "), None).unwrap(), Some(Rule::Beta(0.75)));
        assert_eq!(rule(None, Some("1")).unwrap(), Some(Rule::TopFraction(1.0)));
        assert_eq!(rule(None, None).unwrap(), None);
        for beta in ["", "a lot", "NaN", "inf", "-0.1", "1.01", "0,8", "0.8<script>"] {
            let error = rule(Some(beta), None).unwrap_err();
            assert!(error.message().starts_with("beta: "), "{beta}: {error}");
        }
        for part in ["0", "-1", "1.5", "ten"] {
            assert!(rule(None, Some(part)).unwrap_err().message().starts_with("top_fraction: "), "{part}");
        }
        assert!(rule(Some("0.5"), Some("0.5")).is_err());
    }

    #[test]
    fn a_shape_is_parsed_back_and_a_wrong_one_refused_by_name() {
        let given = |pairs: &[(&str, Value)]| -> Others {
            pairs.iter().map(|(name, value)| ((*name).to_owned(), value.clone())).collect()
        };
        let [run, context] = [("min_run", " 5 ".into()), ("context_after", "".into())];
        let read = shape(&given(&[run, ("phases", 4.into()), ("max_per_phase", 3.into()), context])).unwrap();
        assert_eq!(read, SelectionShape { min_run: 5, phases: 4, max_per_phase: 3, ..SelectionShape::default() });
        let selection = Selection { shape: read, ..Selection::beta(0.5) };
        assert_eq!(parameters(selection), "beta=0.5&max_per_phase=3&min_run=5&phases=4");
        for (name, value) in [
            ("min_run", "five"),
            ("min_run", "-1"),
            ("phases", "0"),
            ("max_share_of_episode", "1.5"),
            ("close_gaps", "0.5"),
        ] {
            let error = shape(&given(&[(name, value.into())])).unwrap_err();
            assert!(error.message().starts_with(&format!("{name}: ")), "{name}: {error}");
        }
        assert!(shape(&given(&[("close_gaps", Value::Bool(true))])).is_err());
        assert_eq!(shape(&given(&[("proof", "x".into())])).unwrap(), SelectionShape::default());
    }

    #[test]
    fn an_order_is_parsed_back() {
        for key in Key::ALL {
            for descending in [false, true] {
                let order = Order { key, descending };
                assert_eq!(Order::read(&order.word()).unwrap(), order);
            }
        }
        assert!(Order::read("--share").is_err() && Order::read("").is_err());
        assert_eq!(RunParameters::default().order().unwrap().word(), "-share");
    }
}
