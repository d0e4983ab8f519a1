//! Generates the services of both protocols with a pure-Rust compiler, so no protoc is needed.

use std::{fmt::Write as _, path::PathBuf};

use prost::Message as _;
use prost_types::FileDescriptorSet;

const PROTOS: [&str; 11] = [
    "gleaner/v1/task.proto",
    "gleaner/v1/episode.proto",
    "gleaner/v1/snapshot.proto",
    "gleaner/v1/job.proto",
    "gleaner/v1/schedule.proto",
    "gleaner/v1/score.proto",
    "gleaner/v1/selection.proto",
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
    std::fs::write(out.join("rpcs.rs"), rpcs(&descriptors)?)?;
    tonic_prost_build::configure()
        .bytes(".gleaner.v1.WriteUploadRequest.data")
        .bytes(".gleaner.v1.DownloadEpisodeResponse.data")
        .bytes(".gleaner.v1.DownloadExportFileResponse.data")
        .bytes(".gleaner.v1.Image.data")
        .bytes(".gleaner.v1.ScoreRecordingRequest.data")
        .bytes(".inference.ModelInferRequest.raw_input_contents")
        .bytes(".inference.InferTensorContents.bytes_contents")
        // Two bytes of a message can be an empty tensor: what it may hold lies elsewhere until there is any.
        .boxed(".inference.ModelInferRequest.InferInputTensor.contents")
        .btree_map(".inference")
        .btree_map(".gleaner.v1.RecordingSummary")
        .client_mod_attribute(".", "#[cfg(feature = \"services\")]")
        .server_mod_attribute(".", "#[cfg(feature = \"services\")]")
        .compile_fds(descriptors)?;
    Ok(())
}

/// An enum of every rpc, so that a `match` over it without a wildcard fails to build when one is added.
fn rpcs(descriptors: &FileDescriptorSet) -> Result<String, std::fmt::Error> {
    let (mut variants, mut all, mut paths) = (String::new(), String::new(), String::new());
    for file in &descriptors.file {
        for service in &file.service {
            for method in &service.method {
                let variant = format!("{}{}", service.name(), method.name());
                let path = format!("/{}.{}/{}", file.package(), service.name(), method.name());
                writeln!(variants, "    /// `{path}`\n    {variant},")?;
                writeln!(all, "        Self::{variant},")?;
                writeln!(paths, "            Self::{variant} => \"{path}\",")?;
            }
        }
    }
    Ok(format!(
        "/// Every rpc of every service here.\n#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]\n\
         pub enum Rpc {{\n{variants}}}\n\nimpl Rpc {{\n    /// All of them.\n    pub const ALL: &'static [Self] = &[\n{all}    ];\n\n    \
         /// Its path in a request.\n    #[must_use]\n    pub const fn path(self) -> &'static str {{\n        match self {{\n{paths}        }}\n    }}\n}}\n"
    ))
}
