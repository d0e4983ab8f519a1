//! The rules of ARCHITECTURE.md, checked on the sources: which crate is named where, which depends on which (`layers`), and
//! the header of every file.

mod layers;

use crate::support::files;

/// Every Rust source of the workspace, with its path from the root.
fn sources() -> Vec<(String, String)> {
    let folders = ["proto", "crates", "server", "client", "tests", "benches"];
    let paths = folders.iter().flat_map(|folder| files::sources(folder, "rs"));
    let found: Vec<_> = paths.map(|path| files::source(&path)).collect();
    assert!(found.len() > 60, "the walk found too little");
    found
}

/// Whether a line of code names `word` as the first part of a path.
fn names(source: &str, word: &str) -> bool {
    source.lines().map(str::trim_start).filter(|line| !line.starts_with("//")).any(|line| {
        line.match_indices(word).any(|(at, _)| {
            let before = line[..at].chars().next_back();
            !before.is_some_and(|c| c.is_alphanumeric() || c == '_') && line[at + word.len()..].starts_with("::")
        })
    })
}

#[test]
fn crates_are_named_in_their_place_only() {
    let rules: [(&str, &[&str]); 31] = [
        ("tch", &["crates/group/", "crates/learn/", "crates/search/"]),
        ("gleaner_group", &["crates/group/", "crates/learn/", "crates/worker/"]),
        ("sqlx", &["server/src/store/"]),
        ("object_store", &["crates/bucket/"]),
        (
            "gleaner_bucket",
            &["crates/bucket/", "crates/data-folder/src/blobs/", "server/src/config/blob_store.rs", "tests/"],
        ),
        ("mcap", &["crates/recording/"]),
        ("image", &["crates/recording/"]),
        ("serde_norway", &["client/src/parts.rs"]),
        ("arrow_array", &["crates/formats/"]),
        ("arrow_schema", &["crates/formats/"]),
        ("hdf5_pure", &["crates/formats/"]),
        ("gleaner_film", &["crates/film/", "crates/formats/src/lerobot/films.rs"]),
        ("mp4_atom", &["crates/film/"]),
        ("rav1e", &["crates/film/"]),
        ("re_mp4", &["crates/formats/src/import/"]),
        ("gleaner_formats", &["crates/worker/src/kinds/export.rs", "crates/inspector/"]),
        ("gleaner_video", &["crates/recording/", "crates/video/"]),
        ("re_rav1d", &["crates/video/"]),
        ("rust_h264", &["crates/video/"]),
        ("rusty_h265", &["crates/video/"]),
        (
            "gleaner_proto",
            &[
                "crates/core/src/proto",
                "server/src/wire/",
                "server/src/service/",
                "crates/remote/",
                "crates/worker/",
                "server/src/access/",
                "client/",
                "tests/",
                "benches/",
            ],
        ),
        ("axum", &["crates/web/"]),
        ("maud", &["crates/web/"]),
        ("gleaner_web", &["server/src/pages/"]),
        ("gleaner_search", &["crates/search/", "crates/learn/"]),
        (
            "gleaner_edge",
            &[
                "crates/edge/",
                "server/src/access/",
                "server/src/config/connections.rs",
                "server/src/connections.rs",
                "server/src/lib.rs",
                "server/src/openpi/",
                "server/src/pages/",
                "server/src/service/",
                "crates/web/",
            ],
        ),
        ("governor", &["crates/edge/", "server/src/access/"]),
        // In the server, its tests alone read messages by their descriptors.
        (
            "prost_reflect",
            &["crates/recording/", "client/", "tests/", "server/src/access/table.rs", "server/src/service/tests.rs"],
        ),
        ("tokio_rustls", &["crates/edge/", "crates/remote/", "server/src/access/tls/"]),
        ("gleaner_remote", &["crates/remote/", "server/src/config/policy_servers.rs", "server/src/policies/"]),
        (
            "gleaner_sim",
            &[
                "crates/sim/",
                "client/",
                "tests/",
                // Evaluations, and which tasks can be simulated.
                "crates/worker/",
                "server/src/jobs/kinds/",
            ],
        ),
    ];
    let mut broken = Vec::new();
    for (name, source) in sources() {
        for (word, rooms) in &rules {
            // `image` is also a word of our own modules in other rooms.
            let own_module = *word == "image" && (source.contains("mod image;") || name.contains("/image"));
            if names(&source, word) && !own_module && !rooms.iter().any(|room| name.starts_with(room)) {
                broken.push(format!("{name} names {word}, which belongs to {rooms:?}"));
            }
        }
        let status = "Status::";
        if name.starts_with("server/src/")
            && name != "server/src/wire/status.rs"
            && ["new(", "invalid_argument(", "internal(", "not_found(", "unauthenticated(", "unavailable("]
                .iter()
                .any(|call| source.contains(&format!("{status}{call}")))
        {
            broken.push(format!("{name} builds a Status; wire/status.rs does that"));
        }
        // Each rpc is written once: `answer` and `change` convert its result.
        if name.starts_with("server/src/service/")
            && name != "server/src/service/answer.rs"
            && source.contains("from_error")
        {
            broken.push(format!("{name} converts an error; service/answer.rs does that"));
        }
    }
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

/// Helpers are in one room, so that a test file can change or move without another one.
#[test]
fn end_to_end_tests_share_the_support_room_only() {
    let own = ["crate", "::"].concat();
    let mut broken = Vec::new();
    for (name, source) in sources().into_iter().filter(|(name, _)| name.starts_with("tests/end_to_end/")) {
        let used = source.match_indices(&own).map(|(at, path)| &source[at + path.len()..]);
        broken.extend(used.filter(|path| !path.starts_with("support")).map(|path| {
            let module: String = path.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
            format!("{name} uses {module}; move what it needs to tests/end_to_end/support/")
        }));
    }
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

/// `unsafe` code is in one file; the lints of the workspace deny it elsewhere unless a file allows it.
#[test]
fn unsafe_code_is_in_its_room_only() {
    let (lint, allows) = (["unsafe", "_code"].concat(), ["allow", "expect", "warn"]);
    let allowing = |source: &str| allows.iter().any(|level| source.contains(&format!("{level}({lint}")));
    let found: Vec<String> =
        sources().into_iter().filter(|(_, source)| allowing(source)).map(|(name, _)| name).collect();
    assert_eq!(found, ["crates/group/src/bindings.rs"]);
    let root: toml::Table = std::fs::read_to_string(files::root().join("Cargo.toml")).unwrap().parse().unwrap();
    assert_eq!(root["workspace"]["lints"]["rust"][&lint].as_str(), Some("deny"));
    for member in root["workspace"]["members"].as_array().unwrap() {
        let manifest = files::root().join(member.as_str().unwrap()).join("Cargo.toml");
        let manifest: toml::Table = std::fs::read_to_string(manifest).unwrap().parse().unwrap();
        assert_eq!(manifest["lints"]["workspace"].as_bool(), Some(true), "{member} has lints of its own");
    }
}

/// Where no path of libraries is set, only programs below the workspace find libtorch; an example that is merged with
/// others runs as a program in the system's temporary folder, even where it is `no_run`.
#[test]
fn examples_that_link_libtorch_are_crates_of_their_own() {
    let links = ["tch", "gleaner-group", "gleaner-learn", "gleaner-search"];
    let mut seen = 0;
    let mut broken = Vec::new();
    for (name, source) in sources() {
        let Some((folder, _)) = name.split_once("/src/") else { continue };
        let manifest = std::fs::read_to_string(files::root().join(folder).join("Cargo.toml")).unwrap();
        let manifest: toml::Table = manifest.parse().unwrap();
        if !links.iter().any(|link| manifest["dependencies"].get(link).is_some()) {
            continue;
        }
        let fences = source.lines().filter_map(|line| {
            let line = line.trim_start();
            line.strip_prefix("//! ```").or(line.strip_prefix("/// ```")).map(str::to_owned)
        });
        for opening in fences.step_by(2).filter(|tags| !tags.contains("text") && !tags.contains("ignore")) {
            seen += 1;
            if !opening.contains("standalone_crate") {
                broken.push(format!("{name}: ```{opening} lacks standalone_crate"));
            }
        }
    }
    assert!(seen >= 3, "the walk found too little");
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[test]
fn every_file_has_a_header() {
    let without: Vec<String> =
        sources().into_iter().filter(|(_, source)| !source.starts_with("//!")).map(|(name, _)| name).collect();
    assert!(without.is_empty(), "no //! header: {without:?}");
}

#[test]
fn no_stubs_and_no_sleeps() {
    // Built here, so that this file does not name them.
    let marks = [
        ["to", "do!("].concat(),
        ["unimplem", "ented!("].concat(),
        ["thread::", "sleep"].concat(),
        ["#[ig", "nore"].concat(),
    ];
    let found: Vec<String> = sources()
        .into_iter()
        .filter(|(name, source)| {
            // The server's own tasks have intervals.
            let waits = name.starts_with("tests/") && source.contains(&["time::sl", "eep("].concat());
            waits || marks.iter().any(|mark| source.contains(mark.as_str()))
        })
        .map(|(name, _)| name)
        .collect();
    assert!(found.is_empty(), "{found:?}");
}
