//! The word list of the project's prose, applied to Markdown and to the doc comments (which include help texts) of the
//! folders that follow it; and the sources that Markdown names. CONTRIBUTING.md has the rules behind the list.

use std::path::{Path, PathBuf};

/// A phrase that the prose avoids, and what to write in its place.
type Phrase = (&'static str, &'static str);

const PHRASES: [Phrase; 34] = [
    ("nobody", "state what holds: \"Files without an image are rejected.\""),
    ("so many", "up to N, at most N"),
    ("so much of", "up to N, at most N"),
    ("who is none", "callers without …"),
    ("is none that", "unknown value; supported: …"),
    ("that is none", "not a …, malformed …"),
    ("what is no", "files that are not …"),
    ("who has no", "callers without …"),
    ("whoever", "name the subject: a caller, a client, a user"),
    ("somebody", "name the subject: a caller, a client, a user"),
    ("mend", "fix"),
    ("mends", "fixes, corrects"),
    ("mended", "fixed, repaired"),
    ("mending", "fixing, repairing"),
    ("told", "functions return, reject or send"),
    ("hears", "a caller receives"),
    ("hears of", "a caller receives"),
    ("learns of", "a module receives"),
    ("takes up", "loads, resumes"),
    ("gone on with", "resumed"),
    ("go on with", "resume"),
    ("goes on with", "resumes"),
    ("goes on for", "takes, lasts"),
    ("goes on where", "resumes"),
    ("all the same", "nevertheless, still"),
    ("what it said", "its message"),
    ("what is said", "the message"),
    ("as often as one likes", "any number of times"),
    ("as many as you like", "any number of"),
    ("the whole way", "every stage"),
    ("begun anew", "started again"),
    ("by itself", "automatically, alone"),
    ("of one's own", "its own, a separate"),
    ("holds nothing up", "does not delay others"),
];

/// Folders with Markdown.
const MARKDOWN: [&str; 9] = [".", "benches", "client", "crates", "docs", "examples", "proto", "server", "tests"];

/// Reports that `gleaner experiment` wrote; their text is in its sources.
const REPORTS: [&str; 2] = ["docs/experiments/", "client/src/experiment/testdata/"];

/// Rust files and folders whose doc comments follow the list. Add a folder once it does.
const SOURCES: [&str; 28] = [
    "client/src/cli.rs",
    "client/src/cmd/",
    "client/src/demo/",
    "client/src/help.rs",
    "crates/core/src/",
    "crates/inspector/src/recordings.rs",
    "crates/learn/src/objective/",
    "crates/learn/src/policy/",
    "server/src/access/tls/",
    "server/src/config.rs",
    "server/src/config/",
    "server/src/store/lab/",
    "tests/end_to_end/prose.rs",
    "crates/data-folder/src/",
    "crates/edge/src/",
    "crates/learn/src/",
    "crates/logs/src/",
    "crates/search/src/",
    "crates/worker/src/",
    "server/src/curation/",
    "server/src/jobs/",
    "server/src/lib.rs",
    "server/src/main.rs",
    "server/src/maintenance/",
    "server/src/model_cache.rs",
    "server/src/program.rs",
    "server/src/shutdown.rs",
    "server/src/store/",
];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap()
}

fn files(folder: &Path, deep: bool, extension: &str, into: &mut Vec<PathBuf>) {
    for entry in folder.read_dir().unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap();
        // Build outputs, environments and caches.
        let made = name.starts_with('.') || matches!(name, "target" | "node_modules" | "build" | "dist");
        if path.is_dir() && deep && !made {
            files(&path, deep, extension, into);
        } else if path.extension().is_some_and(|found| found == extension) {
            into.push(path);
        }
    }
}

/// A line without its code spans.
fn prose(line: &str) -> String {
    line.split('`').step_by(2).collect::<Vec<_>>().join(" ").to_lowercase()
}

/// Whether a line of prose has the phrase as words of its own.
fn has(line: &str, phrase: &str) -> bool {
    line.match_indices(phrase).any(|(at, _)| {
        let before = line[..at].chars().next_back();
        let after = line[at + phrase.len()..].chars().next();
        ![before, after].iter().flatten().any(|c| c.is_alphanumeric() || *c == '_')
    })
}

/// Each phrase of the list in the prose of a text.
fn found(name: &str, text: &str, is_prose: impl Fn(&str) -> bool) -> Vec<String> {
    let lines = text.lines().enumerate().filter(|(_, line)| is_prose(line));
    lines
        .flat_map(|(at, line)| {
            let line = prose(line);
            let broken = PHRASES.into_iter().filter(|(phrase, _)| has(&line, phrase)).collect::<Vec<_>>();
            broken.into_iter().map(move |(phrase, instead)| format!("{name}:{}: {phrase:?}: {instead}", at + 1))
        })
        .collect()
}

fn read(path: &Path) -> (String, String) {
    let name = path.strip_prefix(root()).unwrap().to_str().unwrap().trim_start_matches("./");
    (name.to_owned(), std::fs::read_to_string(path).unwrap())
}

#[test]
fn markdown_avoids_the_phrases_of_the_list() {
    let mut paths = Vec::new();
    for folder in MARKDOWN {
        files(&root().join(folder), folder != ".", "md", &mut paths);
    }
    assert!(paths.len() > 35, "the walk found too little: {}", paths.len());
    let texts = paths.iter().map(|path| read(path));
    let texts = texts.filter(|(name, _)| !REPORTS.iter().any(|report| name.starts_with(report)));
    let broken: Vec<String> = texts.flat_map(|(name, text)| found(&name, &text, |_| true)).collect();
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

/// The paths of sources that a text names in code spans.
fn sources_named(text: &str) -> impl Iterator<Item = &str> {
    text.split('`').skip(1).step_by(2).filter(|span| {
        let is_path = !span.starts_with('.') && span.chars().all(|c| c.is_ascii_alphanumeric() || "_-./".contains(c));
        is_path && [".rs", ".proto", ".sql", ".py", ".sh"].iter().any(|extension| span.ends_with(extension))
    })
}

#[test]
fn sources_named_in_markdown_exist() {
    let mut sources = Vec::new();
    for extension in ["rs", "proto", "sql", "py", "sh"] {
        files(root(), true, extension, &mut sources);
    }
    let mut paths = Vec::new();
    for folder in MARKDOWN {
        files(&root().join(folder), folder != ".", "md", &mut paths);
    }
    let mut missing = Vec::new();
    for (name, text) in paths.iter().map(|path| read(path)) {
        // `Path::ends_with` compares whole names, so `routes.rs` does not match `my_routes.rs`.
        let gone = sources_named(&text).filter(|source| !sources.iter().any(|path| path.ends_with(source)));
        missing.extend(gone.map(|source| format!("{name}: {source} does not exist")));
    }
    assert!(missing.is_empty(), "{}", missing.join("\n"));
}

#[test]
fn doc_comments_of_clean_folders_avoid_the_phrases_of_the_list() {
    let mut paths = Vec::new();
    for source in SOURCES {
        let path = root().join(source);
        if path.is_dir() { files(&path, true, "rs", &mut paths) } else { paths.push(path) }
    }
    assert!(paths.len() > 35, "the walk found too little: {}", paths.len());
    let is_doc = |line: &str| line.trim_start().starts_with("///") || line.trim_start().starts_with("//!");
    let texts = paths.iter().map(|path| read(path));
    let broken: Vec<String> = texts.flat_map(|(name, text)| found(&name, &text, is_doc)).collect();
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[test]
fn a_phrase_is_found_as_words_outside_of_code() {
    let text = "Nobody reads.\nA recommended `told` message.\nThe mend.";
    let lines = found("x.md", text, |_| true);
    assert_eq!(lines.len(), 2, "{lines:?}");
    assert!(lines[0].starts_with("x.md:1: \"nobody\": ") && lines[1].starts_with("x.md:3: \"mend\": "), "{lines:?}");
}
