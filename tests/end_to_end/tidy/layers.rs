//! Which crate depends on which, checked on the manifests and the lock file.

use std::collections::BTreeSet;

use crate::support::files;

/// Every crate of the workspace but its tests and benches, and the others that it may name.
const CRATES: [(&str, &[&str]); 24] = [
    ("proto", &[]),
    ("crates/bucket", &["core"]),
    ("crates/capacity", &[]),
    ("crates/core", &["proto"]),
    ("crates/data-folder", &["bucket", "core"]),
    ("crates/edge", &[]),
    ("crates/film", &[]),
    ("crates/formats", &["core", "film", "recording"]),
    ("crates/group", &[]),
    ("crates/inspector", &["formats", "recording"]),
    ("crates/learn", &["core", "group", "search"]),
    ("crates/logs", &["core"]),
    ("crates/openpi", &["core"]),
    ("crates/recording", &["core", "video"]),
    ("crates/remote", &["core", "openpi", "proto"]),
    ("crates/search", &[]),
    ("crates/video", &[]),
    ("crates/web", &["core", "edge"]),
    ("crates/sim", &["recording"]),
    ("crates/test-postgres", &[]),
    ("crates/worker", &["core", "data-folder", "formats", "group", "learn", "logs", "proto", "recording", "sim"]),
    ("client", &["core", "proto", "recording", "sim"]),
    ("client/command", &["client", "core", "inspector", "proto", "recording", "sim"]),
    (
        "server",
        &[
            "bucket",
            "capacity",
            "core",
            "data-folder",
            "edge",
            "inspector",
            "learn",
            "logs",
            "openpi",
            "proto",
            "recording",
            "remote",
            "sim",
            // For tests alone.
            "test-postgres",
            "web",
        ],
    ),
];

#[test]
fn crates_depend_downwards_only() {
    let root = files::root();
    let mut folders: Vec<String> = ["proto", "client", "client/command", "server"].map(str::to_owned).to_vec();
    for entry in root.join("crates").read_dir().unwrap() {
        folders.push(format!("crates/{}", entry.unwrap().file_name().to_str().unwrap()));
    }
    let mut broken = Vec::new();
    for folder in folders.iter().filter(|folder| root.join(folder).join("Cargo.toml").is_file()) {
        let Some((_, allowed)) = CRATES.iter().find(|(name, _)| name == folder) else {
            broken.push(format!("{folder} has no row in CRATES"));
            continue;
        };
        let manifest: toml::Table =
            std::fs::read_to_string(root.join(folder).join("Cargo.toml")).unwrap().parse().unwrap();
        for kind in ["dependencies", "dev-dependencies", "build-dependencies"] {
            let Some(listed) = manifest.get(kind).and_then(toml::Value::as_table) else { continue };
            let ours = listed.keys().filter_map(|name| name.strip_prefix("gleaner-"));
            broken
                .extend(ours.filter(|name| !allowed.contains(name)).map(|name| format!("{folder} depends on {name}")));
        }
    }
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[test]
fn the_client_library_does_not_depend_on_command_line_crates() {
    let manifest = files::root().join("client/Cargo.toml");
    let manifest: toml::Table = std::fs::read_to_string(manifest).unwrap().parse().unwrap();
    for name in ["clap", "comfy-table", "indicatif", "jiff", "plotters", "prost-reflect", "statrs", "toml"] {
        assert!(!manifest["dependencies"].as_table().unwrap().contains_key(name), "client/Cargo.toml has {name}");
    }
}

#[test]
fn the_worker_links_no_database_and_no_web_server() {
    let lock: toml::Table = std::fs::read_to_string(files::root().join("Cargo.lock")).unwrap().parse().unwrap();
    let packages = lock["package"].as_array().unwrap();
    let needs = |name: &str| -> Vec<&str> {
        let found = packages.iter().filter(|package| package["name"].as_str() == Some(name));
        found
            .flat_map(|package| package.get("dependencies").and_then(toml::Value::as_array).into_iter().flatten())
            .filter_map(|line| line.as_str().and_then(|line| line.split(' ').next()))
            .collect()
    };
    // tonic has axum for its feature `router` alone, which the lock file does not tell.
    for manifest in ["Cargo.toml", "crates/worker/Cargo.toml"] {
        assert!(!std::fs::read_to_string(files::root().join(manifest)).unwrap().contains("\"router\""), "{manifest}");
    }
    let (mut found, mut open) = (BTreeSet::new(), vec!["gleaner-worker"]);
    while let Some(name) = open.pop() {
        if name != "tonic" && found.insert(name) {
            open.extend(needs(name));
        }
    }
    for name in ["axum", "libsqlite3-sys", "maud", "sqlx"] {
        assert!(!found.contains(name), "gleaner-worker links {name}");
    }
    assert!(found.contains("gleaner-learn"), "the walk found too little");
}
