//! DatasetService.

use gleaner_proto::v1::*;

use super::{alive, nobody, refuse};
use crate::{api::Api, lab, shared::shared};

#[tokio::test]
async fn datasets_that_cannot_be() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let create = |run: &str, selection| CreateDatasetRequest { score_run_id: run.to_owned(), selection };
    let run = shared.run.as_str();
    refuse!(api.datasets:
        create_dataset(create("run_7", Some(lab::above(0.5)))) => InvalidArgument ["score_run_id: "];
        create_dataset(create(&nobody("run"), Some(lab::above(0.5)))) => NotFound [&nobody("run")];
        create_dataset(create(run, None)) => InvalidArgument ["selection: "];
        create_dataset(create(run, Some(Selection { rule: None }))) => InvalidArgument ["selection: "];
        create_dataset(create(run, Some(lab::above(1.5)))) => InvalidArgument ["selection.beta: "];
        create_dataset(create(run, Some(lab::above(f64::NAN)))) => InvalidArgument ["selection.beta: "];
        create_dataset(create(run, Some(lab::top(0.0)))) => InvalidArgument ["selection.top_fraction: "];
        get_dataset(GetDatasetRequest { dataset_id: "x".into() }) => InvalidArgument ["dataset_id: "];
        get_dataset(GetDatasetRequest { dataset_id: nobody("ds") }) => NotFound [&nobody("ds")];
        list_datasets(ListDatasetsRequest { task: "nobody".into() }) => NotFound ["nobody"];
    );
    alive(&mut api).await;
}

#[tokio::test]
async fn contents_that_are_not_there() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let stream = |id: &str| StreamSegmentsRequest { dataset_id: id.to_owned(), ..StreamSegmentsRequest::default() };
    let download =
        |export: &str, name: &str| DownloadExportFileRequest { export_id: export.to_owned(), name: name.to_owned() };
    refuse!(api.datasets:
        stream_segments(stream("ds_7")) => InvalidArgument ["dataset_id: "];
        stream_segments(stream(&nobody("ds"))) => NotFound [&nobody("ds")];
        list_export_files(ListExportFilesRequest { export_id: "x".into() }) => InvalidArgument ["export_id: "];
        list_export_files(ListExportFilesRequest { export_id: nobody("exp") }) => NotFound [&nobody("exp")];
        download_export_file(download("x", "manifest.jsonl")) => InvalidArgument ["export_id: "];
        download_export_file(download(&nobody("exp"), "manifest.jsonl")) => NotFound [&nobody("exp")];
        download_export_file(download(&nobody("exp"), "")) => InvalidArgument ["name: "];
        download_export_file(download(&nobody("exp"), "a\0")) => InvalidArgument ["name: "];
    );
    let dataset = api
        .datasets
        .create_dataset(CreateDatasetRequest { score_run_id: shared.run.clone(), selection: Some(lab::top(0.01)) })
        .await
        .unwrap()
        .into_inner()
        .dataset
        .unwrap();
    let spec = ExportSpec { dataset_id: dataset.id, format: ExportFormat::Mcap.into() };
    let export = api.succeed(lab::TASK, job_spec::Spec::Export(spec)).await.result_id;
    // A name is looked up among the export's own, never a path.
    refuse!(api.datasets:
        download_export_file(download(&export, "../../gleaner.db")) => NotFound ["../../gleaner.db"];
    );
    alive(&mut api).await;
}
