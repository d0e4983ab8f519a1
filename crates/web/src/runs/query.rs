//! The query of a run's pages: a selection, and the order of its episodes.

use gleaner_core::{Error, Result, selection::Selection};
use serde::Deserialize;

use crate::{page_request::escaped, sheet::Format};

/// The default threshold.
pub(super) const BETA: f64 = 0.8;

/// The parameters of the address.
#[derive(Debug, Default, Deserialize)]
pub(super) struct RunParameters {
    beta: Option<String>,
    top_fraction: Option<String>,
    sort: Option<String>,
    format: Option<Format>,
}

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
    /// The selection; the default threshold if none is named.
    ///
    /// # Errors
    /// Invalid, naming `beta` or `top_fraction`.
    pub(super) fn selection(&self) -> Result<Selection> {
        Ok(selection(self.beta.as_deref(), self.top_fraction.as_deref())?.unwrap_or(Selection::Beta(BETA)))
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

/// Parses a selection from two parameters, of which at most one is set.
///
/// # Errors
/// Invalid, naming `beta` or `top_fraction`.
pub(super) fn selection(beta: Option<&str>, top_fraction: Option<&str>) -> Result<Option<Selection>> {
    match (beta, top_fraction) {
        (None, None) => Ok(None),
        (Some(_), Some(_)) => Err(Error::invalid("top_fraction", "is set together with beta; set one of them")),
        (Some(beta), None) => {
            let beta = number("beta", beta)?;
            if !(0.0..=1.0).contains(&beta) {
                return Err(Error::invalid("beta", format!("is {beta}, must be between 0 and 1")));
            }
            Ok(Some(Selection::Beta(beta)))
        }
        (None, Some(part)) => {
            let part = number("top_fraction", part)?;
            if !(part > 0.0 && part <= 1.0) {
                return Err(Error::invalid("top_fraction", format!("is {part}, must be above 0 and at most 1")));
            }
            Ok(Some(Selection::TopFraction(part)))
        }
    }
}

fn number(field: &str, text: &str) -> Result<f64> {
    let read = text.trim().parse::<f64>().ok().filter(|number| number.is_finite());
    let shown: String = text.chars().take(32).collect();
    read.ok_or_else(|| Error::invalid(field, format!("{shown:?} is not a number; use one such as 0.8")))
}

/// A selection as a parameter of an address.
pub(super) fn parameter(selection: Selection) -> String {
    match selection {
        Selection::Beta(beta) => format!("beta={}", escaped(&beta.to_string())),
        Selection::TopFraction(part) => format!("top_fraction={}", escaped(&part.to_string())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn invalid_thresholds_are_refused_by_name() {
        assert_eq!(selection(Some(" 0.75 "), None).unwrap(), Some(Selection::Beta(0.75)));
        assert_eq!(selection(None, Some("1")).unwrap(), Some(Selection::TopFraction(1.0)));
        assert_eq!(selection(None, None).unwrap(), None);
        for beta in ["", "a lot", "NaN", "inf", "-0.1", "1.01", "0,8", "0.8<script>"] {
            let error = selection(Some(beta), None).unwrap_err();
            assert!(error.message().starts_with("beta: "), "{beta}: {error}");
        }
        for part in ["0", "-1", "1.5", "ten"] {
            assert!(selection(None, Some(part)).unwrap_err().message().starts_with("top_fraction: "), "{part}");
        }
        assert!(selection(Some("0.5"), Some("0.5")).is_err());
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
