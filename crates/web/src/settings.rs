//! Settings to read: every value of a JSON object in a row.

use gleaner_core::Values;
use serde_json::Value;

/// Names and values of an object's leaves.
pub(super) fn rows(values: &Values) -> Vec<(String, String)> {
    let mut rows = Vec::new();
    flatten("", &Value::Object(values.clone()), &mut rows);
    rows
}

/// Each leaf by its path. The path omits `spec`, in which a job's settings lie.
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
