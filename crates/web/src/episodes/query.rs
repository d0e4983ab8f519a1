//! The query of the table of episodes: filters, order and page.

use gleaner_core::{
    Error, Result,
    curation::{SortKey, TableFilter},
    episode::Outcome,
    id::ScoreRunId,
    time::Millis,
};
use jiff::{civil::Date, tz::TimeZone};
use serde::Deserialize;

use crate::{paging, sheet::Format};

/// The parameter's value for episodes without a cohort.
pub(super) const NO_COHORT: &str = "(none)";

/// The parameters of the address; an omitted one is empty.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(default)]
pub(super) struct EpisodeParameters {
    pub(super) outcome: String,
    pub(super) cohort: String,
    pub(super) from: String,
    pub(super) to: String,
    pub(super) findings: String,
    pub(super) text: String,
    pub(super) run: String,
    pub(super) q_from: String,
    pub(super) q_to: String,
    pub(super) sort: String,
    pub(super) page: String,
    pub(super) format: Format,
}

/// The parsed parameters.
#[derive(Debug, Clone)]
pub(super) struct EpisodeQuery {
    pub(super) filter: TableFilter,
    /// The run whose q is shown; `None` for the task's newest.
    pub(super) run: Option<ScoreRunId>,
    /// Only episodes with a mean q in this range; `None` includes those without.
    pub(super) mean_q: Option<(f64, f64)>,
    pub(super) order: Order,
    /// From 1.
    pub(super) page: usize,
}

/// The column and direction of the order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Order {
    pub(super) key: SortKey,
    pub(super) descending: bool,
}

impl Order {
    /// Its word in links: the key's, with `-` before it when descending.
    pub(super) fn word(self) -> String {
        format!("{}{}", if self.descending { "-" } else { "" }, self.key.as_str())
    }

    fn read(word: &str) -> Result<Self> {
        let (descending, key) = word.strip_prefix('-').map_or((false, word), |key| (true, key));
        let key = SortKey::from_word(key).ok_or_else(|| {
            let known = SortKey::ALL.map(SortKey::as_str).join(", ");
            Error::invalid("sort", format!("must be one of {known}, with - before it to begin with the highest"))
        })?;
        Ok(Self { key, descending })
    }

    /// The order after a click on a column's head: reversed if already sorted by it, otherwise the more useful
    /// direction.
    pub(super) fn by(self, key: SortKey) -> Self {
        let first = matches!(key, SortKey::Date | SortKey::Steps | SortKey::Findings);
        Self { key, descending: if self.key == key { !self.descending } else { first } }
    }
}

impl EpisodeParameters {
    /// Reads the parameters.
    ///
    /// # Errors
    /// Invalid, naming the parameter.
    pub(super) fn read(&self) -> Result<EpisodeQuery> {
        let (from, last) = (day("from", &self.from)?, day("to", &self.to)?);
        if from.zip(last).is_some_and(|(from, last)| from > last) {
            return Err(Error::invalid("to", format!("{} is before {}, where it begins", self.to, self.from)));
        }
        let before = last.map(|last| last.tomorrow().unwrap_or(last));
        let sort = if self.sort.is_empty() { "-date" } else { &self.sort };
        Ok(EpisodeQuery {
            filter: TableFilter {
                outcome: given(&self.outcome).map(|word| outcome("outcome", word)).transpose()?,
                cohort: given(&self.cohort).map(|cohort| if cohort == NO_COHORT { "" } else { cohort }.to_owned()),
                from: from.map(midnight).transpose()?,
                before: before.map(midnight).transpose()?,
                warnings: match self.findings.as_str() {
                    "" => None,
                    "some" => Some(true),
                    "none" => Some(false),
                    _ => return Err(Error::invalid("findings", "must be some or none")),
                },
                text: given(self.text.trim()).map(str::to_owned),
            },
            run: given(&self.run).map(|id| ScoreRunId::parse("run", id)).transpose()?,
            mean_q: self.mean_q()?,
            order: Order::read(sort)?,
            page: paging::parse(&self.page)?,
        })
    }

    fn mean_q(&self) -> Result<Option<(f64, f64)>> {
        let (from, to) = (part("q_from", &self.q_from)?, part("q_to", &self.q_to)?);
        if from.is_none() && to.is_none() {
            return Ok(None);
        }
        let (from, to) = (from.unwrap_or(0.0), to.unwrap_or(1.0));
        if from > to {
            return Err(Error::invalid("q_to", format!("{to} is below {from}, where it begins")));
        }
        Ok(Some((from, to)))
    }
}

/// Parses a required outcome.
///
/// # Errors
/// Invalid, naming the field.
pub(super) fn outcome(field: &str, word: &str) -> Result<Outcome> {
    Outcome::from_word(word).ok_or_else(|| Error::invalid(field, "must be success, failure or unknown"))
}

fn given(text: &str) -> Option<&str> {
    (!text.is_empty()).then_some(text)
}

fn day(field: &str, text: &str) -> Result<Option<Date>> {
    let read =
        |text: &str| text.parse::<Date>().map_err(|_| Error::invalid(field, "must be a day such as 2026-11-21 (UTC)"));
    given(text).map(read).transpose()
}

fn midnight(day: Date) -> Result<Millis> {
    let start = day.to_zoned(TimeZone::UTC).map_err(|error| Error::invalid("from", error))?;
    Ok(Millis(start.timestamp().as_millisecond()))
}

/// A number from 0 to 1.
fn part(field: &str, text: &str) -> Result<Option<f64>> {
    let read = |text: &str| {
        let number = text.parse::<f64>().ok().filter(|number| (0.0..=1.0).contains(number));
        number.ok_or_else(|| Error::invalid(field, "must be a number from 0 to 1"))
    };
    given(text).map(read).transpose()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn query(set: impl FnOnce(&mut EpisodeParameters)) -> Result<EpisodeQuery> {
        let mut parameters = EpisodeParameters::default();
        set(&mut parameters);
        parameters.read()
    }

    #[test]
    fn no_parameters_select_all_newest_first() {
        let EpisodeQuery { filter, run, mean_q, order, page } = EpisodeParameters::default().read().unwrap();
        assert!(
            filter.outcome.is_none() && filter.cohort.is_none() && filter.from.is_none() && filter.before.is_none()
        );
        assert!(filter.warnings.is_none() && filter.text.is_none() && run.is_none() && mean_q.is_none());
        assert_eq!((order, page), (Order { key: SortKey::Date, descending: true }, 1));
    }

    #[test]
    fn days_are_whole_and_the_last_one_counts() {
        let query =
            query(|parameters| (parameters.from, parameters.to) = ("2027-01-15".into(), "2027-01-15".into())).unwrap();
        assert_eq!(query.filter.from, Some(Millis(1_799_971_200_000)));
        assert_eq!(query.filter.before, Some(Millis(1_799_971_200_000 + 86_400_000)));
    }

    #[test]
    fn no_cohort_can_be_selected() {
        assert_eq!(query(|parameters| parameters.cohort = "(none)".into()).unwrap().filter.cohort.as_deref(), Some(""));
        assert_eq!(
            query(|parameters| parameters.cohort = "weak".into()).unwrap().filter.cohort.as_deref(),
            Some("weak")
        );
    }

    #[test]
    fn one_end_of_q_is_enough() {
        assert_eq!(query(|parameters| parameters.q_from = "0.25".into()).unwrap().mean_q, Some((0.25, 1.0)));
        assert_eq!(query(|parameters| parameters.q_to = "0.5".into()).unwrap().mean_q, Some((0.0, 0.5)));
    }

    #[test]
    fn invalid_parameters_are_named() {
        type Set = fn(&mut EpisodeParameters);
        let wrong: [(&str, Set); 11] = [
            ("outcome: ", |parameters| parameters.outcome = "won".into()),
            ("from: ", |parameters| parameters.from = "yesterday".into()),
            ("to: ", |parameters| (parameters.from, parameters.to) = ("2027-01-16".into(), "2027-01-15".into())),
            ("findings: ", |parameters| parameters.findings = "many".into()),
            ("run: ", |parameters| parameters.run = "../1".into()),
            ("q_from: ", |parameters| parameters.q_from = "high".into()),
            ("q_to: ", |parameters| parameters.q_to = "NaN".into()),
            ("q_to: ", |parameters| (parameters.q_from, parameters.q_to) = ("0.8".into(), "0.2".into())),
            ("sort: ", |parameters| parameters.sort = "colour".into()),
            ("page: ", |parameters| parameters.page = "0".into()),
            ("page: ", |parameters| parameters.page = "-1".into()),
        ];
        for (field, set) in wrong {
            let error = query(set).unwrap_err();
            assert!(error.message().starts_with(field), "{error}");
        }
    }

    #[test]
    fn a_second_click_reverses_the_order() {
        for key in SortKey::ALL {
            let first = Order { key: SortKey::Date, descending: true }.by(key);
            assert_eq!(Order::read(&first.word()).unwrap(), first);
            assert_eq!(first.by(key), Order { descending: !first.descending, ..first });
        }
        assert_eq!(Order { key: SortKey::Date, descending: true }.by(SortKey::MeanQ).word(), "mean_q");
    }
}
