//! Generates the services of both protocols with a pure-Rust compiler, so no protoc is needed.

use std::path::PathBuf;

use prost::Message as _;

const PROTOS: [&str; 10] = [
    "gleaner/v1/task.proto",
    "gleaner/v1/episode.proto",
    "gleaner/v1/snapshot.proto",
    "gleaner/v1/job.proto",
    "gleaner/v1/schedule.proto",
    "gleaner/v1/score.proto",
    "gleaner/v1/dataset.proto",
    "gleaner/v1/policy.proto",
    "gleaner/v1/worker.proto",
    "inference/inference.proto",
];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // tonic's build step prints no rerun lines; without these every build would recompile.
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-changed=gleaner");
    println!("cargo:rerun-if-changed=inference");

    let descriptors = protox::compile(PROTOS, ["."])?;
    let out = PathBuf::from(std::env::var("OUT_DIR")?);
    std::fs::write(out.join("descriptors.bin"), descriptors.encode_to_vec())?;
    tonic_prost_build::configure()
        .bytes(".gleaner.v1.WriteUploadRequest.data")
        .bytes(".gleaner.v1.DownloadEpisodeResponse.data")
        .bytes(".gleaner.v1.DownloadExportFileResponse.data")
        .bytes(".gleaner.v1.Image.data")
        .bytes(".gleaner.v1.ScoreRecordingRequest.data")
        .bytes(".inference.ModelInferRequest.raw_input_contents")
        .bytes(".inference.InferTensorContents.bytes_contents")
        .compile_fds(descriptors)?;
    Ok(())
}
