//! Making a dataset from a run's page.

use axum::{
    Form, Json,
    extract::{FromRequest as _, Path, Request},
    response::Response,
};
use gleaner_core::{Error, Result, id::ScoreRunId, selection::Selection};
use serde::Deserialize;
use serde_json::json;

use super::query;
use crate::{
    change::{change, done, is_json},
    page_request::PageRequest,
    refusal::Answer,
};

/// The selection in a form or in JSON.
#[derive(Deserialize)]
struct Named<T> {
    beta: Option<T>,
    top_fraction: Option<T>,
    #[serde(flatten)]
    others: query::Others,
}

/// Makes the dataset of a selection, or returns the existing one. A form is redirected to its page, JSON is answered
/// with JSON.
pub(crate) async fn make(page_request: PageRequest, Path(id): Path<String>, request: Request) -> Response {
    change(&page_request, [("score_run_id", id.as_str())], create(&page_request, &id, request)).await
}

async fn create(page_request: &PageRequest, id: &str, request: Request) -> Answer {
    let run = ScoreRunId::parse("id", id)?;
    let data = is_json(request.headers());
    let selection = named(request).await?;
    let dataset = page_request.backend().insert_dataset(&run, selection).await?;
    let page = format!("/datasets/{}", dataset.id);
    Ok(done(data, &page, json!({ "dataset_id": dataset.id, "page": page })))
}

async fn named(request: Request) -> Result<Selection> {
    let unreadable = |problem: String| Error::invalid("body", problem);
    let Named { beta, top_fraction, others } = if is_json(request.headers()) {
        let Json(Named { beta, top_fraction, others }) = Json::<Named<f64>>::from_request(request, &())
            .await
            .map_err(|rejection| unreadable(rejection.body_text()))?;
        let text = |number: Option<f64>| number.map(|number| number.to_string());
        Named { beta: text(beta), top_fraction: text(top_fraction), others }
    } else {
        let read = Form::<Named<String>>::from_request(request, &()).await;
        read.map_err(|rejection| unreadable(rejection.body_text()))?.0
    };
    let rule = query::rule(beta.as_deref(), top_fraction.as_deref())?
        .ok_or_else(|| Error::invalid("beta", "must be set, or top_fraction"))?;
    Ok(Selection { rule, shape: query::shape(&others)? })
}

#[cfg(test)]
mod tests {
    use axum::{body::Body, http::header::CONTENT_TYPE};

    use super::*;

    async fn read(kind: &str, body: &'static str) -> Result<Selection> {
        let request = Request::post("/").header(CONTENT_TYPE, kind).body(Body::from(body)).unwrap();
        named(request).await
    }

    #[tokio::test]
    async fn forms_and_json_select_alike() {
        let form = "application/x-www-form-urlencoded";
        assert_eq!(read(form, "proof=x&beta=0.8").await.unwrap(), Selection::beta(0.8));
        assert_eq!(read("application/json", "{\"beta\":0.8}").await.unwrap(), Selection::beta(0.8));
        assert_eq!(read("application/json", "{\"top_fraction\":1}").await.unwrap(), Selection::top_fraction(1.0));
        let shaped = read(form, "proof=x&beta=0.8&min_run=5&phases=").await.unwrap();
        assert_eq!((shaped.shape.min_run, shaped.shape.phases), (5, 10));
        assert_eq!(read("application/json", "{\"beta\":0.8,\"min_run\":5}").await.unwrap(), shaped);
        for (kind, body, field) in [
            (form, "beta=0.8&min_run=few", "min_run: "),
            ("application/json", "{\"beta\":0.8,\"phases\":0}", "phases: "),
            (form, "proof=x", "beta: "),
            (form, "beta=x", "beta: "),
            ("application/json", "{\"beta\":\"0.8\"}", "body: "),
            ("application/json", "{", "body: "),
            ("text/plain", "beta=0.8", "body: "),
        ] {
            let error = read(kind, body).await.unwrap_err();
            assert!(error.message().starts_with(field), "{kind} {body}: {error}");
        }
    }
}
