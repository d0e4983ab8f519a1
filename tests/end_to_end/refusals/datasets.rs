//! DatasetService.

use gleaner_proto::v1::*;

use crate::support::{
    api::Api,
    errors::{absent_id, expect_alive, expect_errors},
    lab,
    shared::shared,
};

#[tokio::test]
async fn invalid_datasets_are_rejected() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let create = |run: &str, selection| CreateDatasetRequest { score_run_id: run.to_owned(), selection };
    let run = shared.run.as_str();
    let shaped = |change: fn(&mut SelectionShape)| {
        let mut shape = SelectionShape::default();
        change(&mut shape);
        create(run, Some(Selection { shape: Some(shape), ..lab::above(0.5) }))
    };
    expect_errors!(api.datasets:
        create_dataset(create("run_7", Some(lab::above(0.5)))) => InvalidArgument ["score_run_id: "];
        create_dataset(create(&absent_id("run"), Some(lab::above(0.5)))) => NotFound [&absent_id("run")];
        create_dataset(create(&absent_id("run"), None)) => NotFound [&absent_id("run")];
        create_dataset(create(run, Some(lab::above(1.5)))) => InvalidArgument ["selection.beta: "];
        create_dataset(create(run, Some(lab::above(f64::NAN)))) => InvalidArgument ["selection.beta: "];
        create_dataset(create(run, Some(lab::top(0.0)))) => InvalidArgument ["selection.top_fraction: "];
        create_dataset(shaped(|s| s.min_expert_auroc = Some(-0.1)))
            => InvalidArgument ["selection.shape.min_expert_auroc: "];
        create_dataset(shaped(|s| s.close_gaps = u32::MAX)) => InvalidArgument ["selection.shape.close_gaps: "];
        create_dataset(shaped(|s| s.min_run = u32::MAX)) => InvalidArgument ["selection.shape.min_run: "];
        create_dataset(shaped(|s| s.context_before = u32::MAX)) => InvalidArgument ["selection.shape.context_before: "];
        create_dataset(shaped(|s| s.context_after = u32::MAX)) => InvalidArgument ["selection.shape.context_after: "];
        create_dataset(shaped(|s| s.max_share_of_episode = Some(0.0))) => InvalidArgument ["selection.shape.max_share_of_episode: "];
        create_dataset(shaped(|s| s.max_share_of_episode = Some(f64::NAN))) => InvalidArgument ["selection.shape.max_share_of_episode: "];
        create_dataset(shaped(|s| s.phases = Some(0))) => InvalidArgument ["selection.shape.phases: "];
        create_dataset(shaped(|s| s.max_per_phase = u32::MAX)) => InvalidArgument ["selection.shape.max_per_phase: "];
        get_dataset(GetDatasetRequest { dataset_id: "x".into() }) => InvalidArgument ["dataset_id: "];
        get_dataset(GetDatasetRequest { dataset_id: absent_id("ds") }) => NotFound [&absent_id("ds")];
        list_datasets(ListDatasetsRequest { task: "absent".into(), ..Default::default() }) => NotFound ["absent"];
        list_datasets(ListDatasetsRequest { page_size: 1001, ..Default::default() }) => InvalidArgument ["page_size: "];
        list_datasets(ListDatasetsRequest { page_token: absent_id("run"), ..Default::default() }) => InvalidArgument ["page_token: is not a page token"];
    );
    expect_alive(&mut api).await;
}

#[tokio::test]
async fn unknown_contents_are_rejected() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let files = |page_size, token: &str| ListExportFilesRequest {
        export_id: absent_id("exp"),
        page_size,
        page_token: token.to_owned(),
    };
    let stream = |id: &str| StreamSegmentsRequest { dataset_id: id.to_owned(), ..StreamSegmentsRequest::default() };
    let download = |export: &str, name: &str| DownloadExportFileRequest {
        export_id: export.to_owned(),
        name: name.to_owned(),
        accept_url: true,
    };
    expect_errors!(api.datasets:
        stream_segments(stream("ds_7")) => InvalidArgument ["dataset_id: "];
        stream_segments(stream(&absent_id("ds"))) => NotFound [&absent_id("ds")];
        list_export_files(ListExportFilesRequest { export_id: "x".into(), ..Default::default() }) => InvalidArgument ["export_id: "];
        list_export_files(ListExportFilesRequest { export_id: absent_id("exp"), ..Default::default() }) => NotFound [&absent_id("exp")];
        list_export_files(files(1001, "")) => InvalidArgument ["page_size: "];
        list_export_files(files(5, "17")) => InvalidArgument ["page_token: is not a page token"];
        download_export_file(download("x", "manifest.jsonl")) => InvalidArgument ["export_id: "];
        download_export_file(download(&absent_id("exp"), "manifest.jsonl")) => NotFound [&absent_id("exp")];
        download_export_file(download(&absent_id("exp"), "")) => InvalidArgument ["name: "];
        download_export_file(download(&absent_id("exp"), "a\0")) => InvalidArgument ["name: "];
    );
    let dataset = api
        .datasets
        .create_dataset(CreateDatasetRequest { score_run_id: shared.run.clone(), selection: Some(lab::top(0.01)) })
        .await
        .unwrap()
        .into_inner()
        .dataset
        .unwrap();
    let spec = ExportSpec { dataset_id: dataset.id, format: ExportFormat::Mcap.into(), ..ExportSpec::default() };
    let export = api.succeed(lab::TASK, job_spec::Spec::Export(spec)).await.result_id;
    // A name is one of the export's files and never a path.
    expect_errors!(api.datasets:
        download_export_file(download(&export, "../../gleaner.db")) => NotFound ["../../gleaner.db"];
    );
    expect_alive(&mut api).await;
}
