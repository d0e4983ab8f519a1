//! A job's spec: every setting in a row, for any kind.

use maud::{Markup, html};
use serde_json::Value;

use crate::{
    domain::job::JobSpec,
    error::{Error, Result},
    web::artifacts::link,
};

/// Every setting, and the spec as JSON.
pub(super) fn table(spec: &JobSpec) -> Result<Markup> {
    let wrong = |error: serde_json::Error| Error::internal("showing a spec", error);
    let value = serde_json::to_value(spec).map_err(wrong)?;
    let raw = serde_json::to_string_pretty(&value).map_err(wrong)?;
    let mut rows = Vec::new();
    flatten("", &value, &mut rows);
    Ok(html! {
        dl.facts.panel.settings { @for (name, text) in &rows { div { dt { (name) } dd { (link::text(text)) } } } }
        details { summary { "As JSON" } pre.panel tabindex="0" { code { (raw) } } }
    })
}

/// Each leaf by its path, without the outer `spec`.
fn flatten(path: &str, value: &Value, rows: &mut Vec<(String, String)>) {
    let leaf = |text: String| (path.replace('_', " "), text);
    match value {
        Value::Object(fields) => {
            for (name, value) in fields {
                let inner = if path.is_empty() || path == "spec" { name.clone() } else { format!("{path}, {name}") };
                flatten(&inner, value, rows);
            }
        }
        Value::Null => rows.push(leaf("–".to_owned())),
        Value::String(text) => rows.push(leaf(text.clone())),
        Value::Array(values) => {
            let text = values.iter().map(|value| value.as_str().map_or_else(|| value.to_string(), str::to_owned));
            rows.push(leaf(text.collect::<Vec<_>>().join(", ")));
        }
        Value::Bool(_) | Value::Number(_) => rows.push(leaf(value.to_string())),
    }
}

#[cfg(test)]
mod tests {
    use gleaner_learn::TrainSpec;

    use super::*;
    use crate::domain::id::{DatasetId, SnapshotId};

    #[test]
    fn every_setting_is_named_by_its_path() {
        let dataset = DatasetId::new();
        let spec = JobSpec::Train {
            encoder_id: None,
            snapshot_id: SnapshotId::new(),
            dataset_id: Some(dataset.clone()),
            spec: TrainSpec::default(),
        };
        let text = table(&spec).unwrap().into_string();
        for there in ["<dt>optim, batch</dt>", "<dt>encoder id</dt><dd>–</dd>", "<dt>kind</dt><dd>train</dd>"] {
            assert!(text.contains(there), "{there} is not in {text}");
        }
        assert!(text.contains(&format!("href=\"/datasets/{dataset}\"")), "{text}");
    }
}
