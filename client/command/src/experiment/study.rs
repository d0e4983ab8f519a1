//! Studies: named tables of cells. A study lists its cells, or the axes of a grid, or takes its table's own, which
//! are the paper's.

use serde::{Deserialize, Serialize};
use serde_json::Value as Json;
use toml::{Table, Value};

use super::cell::CellSettings;
use super::grid::{Axis, Draft, flat, grid, merge, set};
use super::method::Method;
use super::scorings::scorings;

/// Which of the paper's tables a study makes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum TableKind {
    /// The seven combinations of the self-supervised objectives.
    Objectives,
    /// The threshold β, with how much each keeps.
    Beta,
    /// The similarity functions.
    Similarity,
    /// How much imperfect data, from how good agents.
    Quantity,
    /// BC to SSDF+ACT.
    Methods,
    /// How well q separates good from bad, without training a policy: SSDF beside simpler baselines.
    Scoring,
    /// Any other comparison.
    Cells,
}

impl TableKind {
    /// The table's title when the study has no name.
    pub(crate) fn title(self) -> &'static str {
        match self {
            Self::Objectives => "Self-supervised objectives",
            Self::Beta => "Quality score threshold β",
            Self::Similarity => "Similarity functions",
            Self::Quantity => "Quantity and quality",
            Self::Methods => "Methods",
            Self::Scoring => "Scoring",
            Self::Cells => "Cells",
        }
    }

    // The table's own cells.
    fn cells(self, cohorts: &[&str]) -> Vec<Draft> {
        if self == Self::Scoring { scorings() } else { grid(&self.axes(cohorts)) }
    }

    fn axes(self, cohorts: &[&str]) -> Vec<Axis> {
        let axis = |key: &str, values: Vec<Value>| Axis { key: key.to_owned(), values };
        let words = |words: &[&str]| words.iter().map(|word| Value::from(*word)).collect::<Vec<_>>();
        let list = |items: &&[&str]| Value::Array(words(items));
        match self {
            Self::Objectives => {
                let combinations: [&[&str]; 7] =
                    [&["mtp"], &["tr"], &["aa"], &["mtp", "tr"], &["mtp", "aa"], &["tr", "aa"], &["mtp", "tr", "aa"]];
                vec![axis("objectives", combinations.iter().map(list).collect())]
            }
            Self::Beta => vec![axis("beta", [0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99].map(Value::from).into())],
            Self::Similarity => {
                vec![axis("similarity", words(&["segment_cosine", "last_cosine", "segment_l2", "last_l2"]))]
            }
            Self::Quantity => vec![
                axis("rule.imperfect_per_expert", [1.0, 3.0].map(Value::from).into()),
                axis("rule.cohorts", cohorts.iter().map(|cohort| list(&&[*cohort][..])).collect()),
            ],
            Self::Methods => {
                vec![axis("method", Method::all().map(|method| Value::from(method.name())).collect())]
            }
            Self::Scoring | Self::Cells => Vec::new(),
        }
    }
}

/// A study as it stands in the file.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct StudySettings {
    pub(crate) table: TableKind,
    #[serde(default)]
    name: Option<String>,
    /// Settings of all its cells, laid over the base.
    #[serde(default)]
    set: Table,
    /// Lists of values, of which every combination is a cell.
    #[serde(default)]
    axes: Option<Table>,
    /// Instead: cells one by one.
    #[serde(default)]
    cells: Option<Vec<NamedCell>>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct NamedCell {
    label: String,
    #[serde(default)]
    set: Table,
}

/// A cell with its place.
#[derive(Clone, Debug)]
pub(crate) struct Cell {
    pub(crate) label: String,
    /// The settings that the study varies, with their values here.
    pub(crate) varied: Vec<(String, Json)>,
    pub(crate) settings: CellSettings,
}

impl StudySettings {
    pub(crate) fn name(&self) -> &str {
        self.name.as_deref().unwrap_or(self.table.title())
    }

    /// The study's cells over a base. Errors name the cell and the field.
    pub(crate) fn cells(&self, base: &Table, cohorts: &[&str]) -> Result<Vec<Cell>, String> {
        let mut shared = base.clone();
        if self.table == TableKind::Scoring && !self.set.contains_key("evaluate") {
            shared.insert("evaluate".into(), false.into());
        }
        merge(&mut shared, &self.set);
        let drafts = match (&self.cells, &self.axes) {
            (Some(_), Some(_)) => return Err("give axes or cells, not both".into()),
            (Some(cells), None) => cells.iter().map(named).collect(),
            (None, Some(axes)) => grid(&flat(axes)?),
            (None, None) => self.table.cells(cohorts),
        };
        if drafts.is_empty() {
            return Err("has no cells; give axes or cells".into());
        }
        let mut cells: Vec<Cell> = Vec::with_capacity(drafts.len());
        for (label, varied) in drafts {
            let here = |problem: String| format!("cell {label:?}: {problem}");
            if cells.iter().any(|other| other.label == label) {
                return Err(here("is duplicated".into()));
            }
            let mut table = shared.clone();
            for (key, value) in &varied {
                set(&mut table, key, value.clone()).map_err(here)?;
            }
            let settings: CellSettings = table.try_into().map_err(|error: toml::de::Error| here(one_line(&error)))?;
            settings.check(cohorts).map_err(here)?;
            if settings.top.is_some() && varied.iter().any(|(key, _)| key == "beta") {
                return Err(here("beta: has no effect while top is set; leave top out".into()));
            }
            settings.check_varied(varied.iter().map(|(key, _)| key.as_str())).map_err(here)?;
            let varied = varied.into_iter().map(|(key, value)| Ok((key, serde_json::to_value(value)?)));
            let varied = varied.collect::<Result<_, serde_json::Error>>().map_err(|error| error.to_string())?;
            cells.push(Cell { label, varied, settings });
        }
        Ok(cells)
    }
}

/// An error of the parser without its picture of the text.
pub(crate) fn one_line(error: &toml::de::Error) -> String {
    error.message().trim().to_owned()
}

fn named(cell: &NamedCell) -> Draft {
    (cell.label.clone(), cell.set.iter().map(|(key, value)| (key.clone(), value.clone())).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cells(study: &str) -> Result<Vec<Cell>, String> {
        let base: Table = toml::from_str("lambda = 0.5\nseeds = [7]\n[rule]\nexperts = 4").unwrap();
        toml::from_str::<StudySettings>(study).unwrap().cells(&base, &["weak", "strong"])
    }

    fn labels(study: &str) -> Vec<String> {
        cells(study).unwrap().into_iter().map(|cell| cell.label).collect()
    }

    #[test]
    fn each_table_has_the_cells_of_the_paper() {
        assert_eq!(labels("table = \"methods\""), Method::all().map(Method::title).collect::<Vec<_>>());
        assert_eq!(labels("table = \"beta\""), ["0", "0.5", "0.7", "0.8", "0.9", "0.95", "0.99"]);
        assert_eq!(labels("table = \"objectives\"").last().unwrap(), "mtp+tr+aa");
        assert_eq!(labels("table = \"quantity\""), ["1:1 weak", "1:1 strong", "1:3 weak", "1:3 strong"]);
        assert_eq!(labels("table = \"similarity\"").len(), 4);
        let scoring = cells("table = \"scoring\"").unwrap();
        assert!(scoring.iter().all(|cell| !cell.settings.evaluate));
        let labels: Vec<&str> = scoring.iter().map(|cell| cell.label.as_str()).collect();
        assert_eq!(
            labels,
            [
                "ssdf",
                "ssdf to the letter",
                "raw",
                "raw + local scale",
                "raw segments",
                "raw segments + local scale",
                "raw segments + local scale + lookahead",
                "raw segments + local scale + pace + lead-in",
                "raw segments + local scale + pace + lead-in + earliness",
                "classifier",
                "deminf",
                "progress",
                "vote"
            ]
        );
        let scales = |index: usize| {
            let set = &scoring[index].settings.settings;
            (set.get("local_scale").cloned(), set.get("feature_scale").cloned())
        };
        assert_eq!(scales(0), (None, None));
        assert_eq!(scales(1), (Some(false.into()), Some("plain".into())));
        assert_eq!((scales(2).0, scales(3).0), (Some(false.into()), Some(true.into())));
        let lookahead = |index: usize| scoring[index].settings.settings.get("lookahead").and_then(Json::as_f64);
        assert_eq!([1, 2, 5, 6, 7, 8].map(lookahead), [0.0, 0.0, 0.0, 0.5, 0.5, 0.5].map(Some));
        // The last is the default, whatever the base.
        let default = gleaner_core::ScoreSpec::default().scorer.settings;
        let here = &scoring[8].settings.settings;
        for name in ["similarity", "local_scale", "lookahead", "progress", "lead_in", "earliness"] {
            assert_eq!(here.get(name), default.get(name), "{name}");
        }
    }

    #[test]
    fn cells_have_the_settings_of_base_study_and_axes() {
        let study = "table = \"cells\"\nset = { lambda = 0.2 }\n[axes]\nbeta = [0.5]\nrule.cohorts = [[\"weak\"], []]";
        let cells = cells(study).unwrap();
        let settings = &cells[0].settings;
        assert_eq!((cells.len(), &settings.settings["lambda"], settings.beta), (2, &0.2.into(), Some(0.5)));
        assert_eq!(
            (settings.rule.experts, &settings.rule.cohorts, &settings.seeds),
            (4, &vec!["weak".into()], &vec![7])
        );
        assert_eq!(cells[0].varied[1], ("rule.cohorts".into(), serde_json::json!(["weak"])));
    }

    #[test]
    fn cells_may_be_listed_one_by_one() {
        let study = "table = \"cells\"\ncells = [{ label = \"a\" }, { label = \"b\", set = { rule = { seed = 3 } } }]";
        let cells = cells(study).unwrap();
        assert_eq!((cells[0].settings.rule.seed, cells[1].settings.rule.seed), (0, 3));
        assert_eq!(cells[1].settings.rule.experts, 4);
    }

    #[test]
    fn errors_name_their_cell_and_field() {
        for (study, parts) in [
            ("table = \"beta\"\naxes = { betta = [0.5] }", ["cell \"0.5\"", "unknown field `betta`"]),
            ("table = \"beta\"\naxes = { beta = [2.0] }", ["cell \"2\"", "beta: 2 is outside"]),
            ("table = \"beta\"\nset = { top = 0.1 }", ["cell \"0\"", "beta: has no effect while top is set"]),
            ("table = \"beta\"\naxes = { beta = 0.5 }", ["axes.beta", "a list"]),
            ("table = \"beta\"\naxes = { beta = [0.5, 0.5] }", ["cell \"0.5\"", "duplicated"]),
            ("table = \"cells\"", ["no cells", "axes"]),
            (
                "table = \"scoring\"\naxes = { scorer = [\"ssdf\", \"raw\"], feature_scale = [\"plain\"] }",
                ["cell \"plain raw\"", "feature_scale: has no effect"],
            ),
            ("table = \"cells\"\naxes = { rule.experts = [-1] }", ["cell \"-1\"", "u32"]),
        ] {
            let message = cells(study).unwrap_err();
            assert!(parts.iter().all(|part| message.contains(part)), "{message}");
        }
    }
}
