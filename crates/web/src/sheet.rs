//! Tables for programs: a page's table as JSON or CSV.

use axum::{
    http::header::{CONTENT_DISPOSITION, CONTENT_TYPE},
    response::{IntoResponse as _, Response},
};
use gleaner_core::{Error, Result};
use maud::{Markup, html};
use serde::Deserialize;
use serde_json::{Map, Value};

use super::page_request::PageRequest;

/// The format of a page.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Format {
    /// A page for people.
    #[default]
    Html,
    /// A list of objects.
    Json,
    /// Lines with a header.
    Csv,
}

/// The query of a page that has no other parameter.
#[derive(Deserialize)]
struct Parameters {
    #[serde(default)]
    format: Format,
}

/// The format of a page without other parameters.
///
/// # Errors
/// Invalid.
pub(super) fn format(request: &PageRequest) -> Result<Format> {
    request.parameters().map(|Parameters { format }| format)
}

/// A table: its file's name, its columns, its rows.
pub(super) struct Sheet {
    pub(super) name: String,
    pub(super) columns: &'static [&'static str],
    pub(super) rows: Vec<Vec<Value>>,
}

impl Sheet {
    /// The table as a file; JSON unless CSV is asked for.
    ///
    /// # Errors
    /// Internal.
    pub(super) fn answer(self, format: Format) -> Result<Response> {
        if format == Format::Csv {
            let file = format!("attachment; filename=\"{}.csv\"", self.name);
            let kind = (CONTENT_TYPE, "text/csv; charset=utf-8".to_owned());
            return Ok(([kind, (CONTENT_DISPOSITION, file)], self.csv()?).into_response());
        }
        let columns = self.columns;
        let row = |row: Vec<Value>| columns.iter().map(|&name| name.to_owned()).zip(row).collect::<Map<_, _>>();
        Ok(axum::Json(self.rows.into_iter().map(row).collect::<Vec<_>>()).into_response())
    }

    fn csv(&self) -> Result<Vec<u8>> {
        let failed = |error: csv::Error| Error::internal("writing a table", error);
        let mut out = csv::Writer::from_writer(Vec::new());
        out.write_record(self.columns).map_err(failed)?;
        for row in &self.rows {
            out.write_record(row.iter().map(cell)).map_err(failed)?;
        }
        out.into_inner().map_err(|error| Error::internal("writing a table", error.into_error()))
    }
}

/// A cell of CSV. Text that a spreadsheet would read as a formula is marked as text.
fn cell(value: &Value) -> String {
    match value {
        Value::Null => String::new(),
        Value::String(text) if text.starts_with(['=', '+', '-', '@', '\t', '\r']) => format!("'{text}"),
        Value::String(text) => text.clone(),
        Value::Bool(_) | Value::Number(_) | Value::Array(_) | Value::Object(_) => value.to_string(),
    }
}

/// Links under a table to the same table for programs.
pub(super) fn links(request: &PageRequest) -> Markup {
    html! {
        p.formats { "This table as " a href=(request.with("format", Some("json"))) { "JSON" } " or "
            a href=(request.with("format", Some("csv"))) { "CSV" } }
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn formulas_are_written_as_text() {
        let row = vec![json!("=1+1"), json!(-1.5), json!("a \"b\", c"), Value::Null, json!(true)];
        let sheet = Sheet { name: "t".into(), columns: &["a", "b", "c", "d", "e"], rows: vec![row] };
        let text = String::from_utf8(sheet.csv().unwrap()).unwrap();
        assert_eq!(text, "a,b,c,d,e\n'=1+1,-1.5,\"a \"\"b\"\", c\",,true\n");
    }
}
