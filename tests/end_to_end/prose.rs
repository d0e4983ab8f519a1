//! The word lists of the project's prose and names, applied to Markdown, to doc comments (which include help texts), to
//! texts of the programs (errors, logs, pages) and to names; and the sources that Markdown names. CONTRIBUTING.md has the
//! rules behind them.

use std::path::PathBuf;

use crate::support::{
    files::{root, source, sources},
    rust_source::{joined, parts},
};

/// A phrase that the prose avoids, and what to write in its place.
type Phrase = (&'static str, &'static str);

const PHRASES: [Phrase; 56] = [
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
    ("all the same", "nevertheless, still"),
    ("what it said", "its message"),
    ("what is said", "the message"),
    ("as often as one likes", "any number of times"),
    ("as many as you like", "any number of"),
    ("the whole way", "every stage"),
    ("go on", "continue, resume"),
    ("goes on", "continues, resumes, lasts"),
    ("gone on", "continued, resumed"),
    ("anew", "again"),
    ("at hand", "available"),
    ("gives back", "returns"),
    ("give back", "return"),
    ("given back", "returned"),
    ("knows nothing", "does not depend on"),
    ("is said", "is reported, is returned"),
    ("was said", "was reported, was returned"),
    ("says so", "state the message"),
    ("let in", "accepted, admitted"),
    ("thrown out", "closed, rejected"),
    ("for ever", "without a limit"),
    ("of our own", "its own, a separate"),
    ("by itself", "automatically, alone"),
    ("of one's own", "its own, a separate"),
    ("holds nothing up", "does not delay others"),
    ("nothing was", "name the subject: no file was, the folder is unchanged"),
    ("deleted for good", "permanently deleted"),
    ("removed for good", "permanently removed"),
    ("gave up", "failed, was cancelled, stopped waiting"),
    ("gives up", "fails, stops waiting"),
    ("given up", "failed, released, closed"),
    ("taken back", "restored"),
    ("takes back", "restores, releases"),
    ("comes twice", "is duplicated"),
    ("is there twice", "is duplicated"),
    ("does not come to", "is busy, has no time for"),
    ("is not ours", "is not valid, is not from this server"),
];

/// Words that no name has as a part between underscores: functions do not speak, and subjects are nouns.
const NAMES: [&str; 16] = [
    "asks", "hears", "house", "knows", "learns", "mend", "mended", "nobody", "said", "says", "somebody", "tells",
    "told", "who", "whoever", "wishes",
];

/// Folders with Markdown, beside the root.
const MARKDOWN: [&str; 8] = ["benches", "client", "crates", "docs", "examples", "proto", "server", "tests"];

/// Reports that `gleaner experiment` wrote; their text is in its sources.
const REPORTS: [&str; 2] = ["docs/experiments/", "client/command/src/experiment/testdata/"];

/// Folders whose sources follow both lists.
const SOURCES: [&str; 7] = ["benches", "client", "crates", "fuzz", "proto", "server", "tests"];

/// Sources that need no list: this one, which has them.
const LISTS: &str = "tests/end_to_end/prose.rs";

/// Names that are given: a column of the database.
const GIVEN: [(&str, &str); 1] = [("server/src/store/audit.rs", "who")];

/// Every Markdown file of the project.
fn markdown() -> Vec<(String, String)> {
    let at_root = sources("", "md").into_iter().filter(|path| path.parent() == Some(root()));
    let paths: Vec<PathBuf> = at_root.chain(MARKDOWN.iter().flat_map(|folder| sources(folder, "md"))).collect();
    assert!(paths.len() > 35, "the walk found too little: {}", paths.len());
    paths.iter().map(|path| source(path)).collect()
}

/// Every source of the folders with this extension.
fn files(extension: &str) -> Vec<(String, String)> {
    let paths = SOURCES.iter().flat_map(|folder| sources(folder, extension));
    let files: Vec<_> = paths.map(|path| source(&path)).filter(|(name, _)| name != LISTS).collect();
    assert!(files.len() > 5, "the walk found too little: {}", files.len());
    files
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

#[test]
fn markdown_avoids_the_phrases_of_the_list() {
    let texts = markdown().into_iter().filter(|(name, _)| !REPORTS.iter().any(|report| name.starts_with(report)));
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
    let sources: Vec<PathBuf> =
        ["rs", "proto", "sql", "py", "sh"].iter().flat_map(|extension| sources("", extension)).collect();
    let mut missing = Vec::new();
    for (name, text) in markdown() {
        // `Path::ends_with` compares whole names, so `routes.rs` does not match `my_routes.rs`.
        let gone = sources_named(&text).filter(|source| !sources.iter().any(|path| path.ends_with(source)));
        missing.extend(gone.map(|source| format!("{name}: {source} does not exist")));
    }
    assert!(missing.is_empty(), "{}", missing.join("\n"));
}

/// The modules and tests that a text names, such as `ingest::tests` and `end_to_end restart::`.
fn tests_named(text: &str) -> impl Iterator<Item = &str> {
    let spans = text.split('`').skip(1).step_by(2).map(|span| span.trim_start_matches("end_to_end "));
    let is_name = |part: &str| part.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_');
    spans.filter(move |span| span.contains("::") && span.split("::").all(is_name))
}

#[test]
fn modules_and_tests_named_in_reliability_exist() {
    let code: Vec<(String, String)> = sources("", "rs").iter().map(|path| source(path)).collect();
    let exists = |name: &str| {
        let declared = [format!("fn {name}("), format!("mod {name};"), format!("mod {name} {{")];
        code.iter().any(|(_, text)| declared.iter().any(|item| text.contains(item)))
    };
    let (name, text) = source(&root().join("docs/reliability.md"));
    let last = |path: &str| path.trim_end_matches("::").rsplit("::").next().unwrap_or_default().to_owned();
    let missing: Vec<&str> = tests_named(&text).filter(|path| !exists(&last(path))).collect();
    assert!(missing.is_empty(), "{name} names what does not exist: {missing:?}");
}

#[test]
fn doc_comments_avoid_the_phrases_of_the_list() {
    let is_doc = |line: &str| line.trim_start().starts_with("///") || line.trim_start().starts_with("//!");
    let broken: Vec<String> = files("rs").iter().flat_map(|(name, text)| found(name, text, is_doc)).collect();
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

/// The rpcs are documented in comments of the protos; Python has docstrings.
#[test]
fn protos_and_python_avoid_the_phrases_of_the_list() {
    let texts = files("proto").into_iter().chain(files("py"));
    let broken: Vec<String> = texts.flat_map(|(name, text)| found(&name, &text, |_| true)).collect();
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

/// Errors, logs, pages, and the messages of assertions.
#[test]
fn texts_of_the_programs_avoid_the_phrases_of_the_list() {
    let mut broken = Vec::new();
    for (file, text) in files("rs") {
        for (line, _, literal) in parts(&text).into_iter().filter(|(_, is_literal, _)| *is_literal) {
            broken.extend(found(&format!("{file}:{line}"), &joined(&literal), |_| true));
        }
    }
    for (file, text) in files("js") {
        broken.extend(found(&file, &text, |_| true));
    }
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

/// The names in a piece of code that have a word of the list.
fn names_found(code: &str) -> Vec<&str> {
    let names = code.split(|c: char| !c.is_alphanumeric() && c != '_');
    names.filter(|name| name.split('_').any(|word| NAMES.contains(&word.to_lowercase().as_str()))).collect()
}

#[test]
fn names_avoid_the_words_of_the_list() {
    let mut broken = Vec::new();
    for (file, text) in files("rs") {
        for (line, _, code) in parts(&text).into_iter().filter(|(_, is_literal, _)| !is_literal) {
            let names = names_found(&code).into_iter().filter(|name| !GIVEN.contains(&(file.as_str(), name)));
            broken.extend(names.map(|name| format!("{file}, after line {line}: {name}")));
        }
    }
    for (file, text) in files("py") {
        let definitions =
            text.lines().map(str::trim_start).filter(|line| line.starts_with("def ") || line.starts_with("class "));
        let names = definitions.flat_map(names_found);
        broken.extend(names.map(|name| format!("{file}: {name}")));
    }
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[test]
fn a_phrase_is_found_as_words_outside_of_code() {
    let text = "Nobody reads.\nA recommended `told` message.\nThe mend.";
    let lines = found("x.md", text, |_| true);
    assert_eq!(lines.len(), 2, "{lines:?}");
    assert!(lines[0].starts_with("x.md:1: \"nobody\": ") && lines[1].starts_with("x.md:3: \"mend\": "), "{lines:?}");
    assert_eq!(names_found("let who_calls = is_told(saying);"), ["who_calls", "is_told"]);
}

#[test]
fn code_and_texts_of_a_source_are_separated_by_quotation_marks() {
    let source = "let a = '\"'; // \"who\"\nfail(\"a \\\"b\\\" \\\n    c\", r#\"d \"e\"\"#);\nlet bar = \"\";";
    let parts = parts(source);
    let texts = |wanted: bool| parts.iter().filter(move |(_, is, _)| *is == wanted);
    let literals: Vec<_> = texts(true).map(|(line, _, text)| (*line, joined(text))).collect();
    assert_eq!(literals, [(2, "a \\\"b\\\" c".into()), (3, "d \"e\"".into()), (4, String::new())]);
    let code: String = texts(false).map(|(_, _, text)| text.as_str()).collect();
    assert_eq!(code, "let a = '\"'; \nfail(, );\nlet bar = ;");
}
