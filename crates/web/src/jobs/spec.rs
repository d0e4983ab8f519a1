//! A job's spec: every setting in a row, for any kind.

use gleaner_core::{Error, Result, Values, job::JobSpec};
use maud::{Markup, html};

use crate::{link, settings};

/// Every setting, and the spec as JSON.
pub(super) fn table(spec: &JobSpec) -> Result<Markup> {
    let wrong = |error: serde_json::Error| Error::internal("showing a spec", error);
    let value = serde_json::to_value(spec).map_err(wrong)?;
    let raw = serde_json::to_string_pretty(&value).map_err(wrong)?;
    let rows = settings::rows(value.as_object().unwrap_or(&Values::new()));
    Ok(html! {
        dl.facts.panel.settings { @for (name, text) in &rows { div { dt { (name) } dd { (link::text(text)) } } } }
        details { summary { "As JSON" } pre.panel tabindex="0" { code { (raw) } } }
    })
}

#[cfg(test)]
mod tests {
    use gleaner_core::{
        TrainSpec,
        id::{DatasetId, SnapshotId},
    };

    use super::*;

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
        for there in ["<dt>batch</dt>", "<dt>encoder id</dt><dd>–</dd>", "<dt>kind</dt><dd>train</dd>"] {
            assert!(text.contains(there), "{there} is not in {text}");
        }
        assert!(text.contains(&format!("href=\"/datasets/{dataset}\"")), "{text}");
    }
}
