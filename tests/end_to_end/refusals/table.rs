//! The table of bad input in `docs/reliability.md` has no gap: a row for every field of every request, and a test that is
//! there in every row.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};

use prost_reflect::{DescriptorPool, Kind, MessageDescriptor};

/// What a row of a field with no wrong value says first.
const ANY: &str = "any";

struct Row {
    wrong: String,
    tests: Vec<String>,
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap()
}

/// The words between backticks.
fn quoted(cell: &str) -> impl Iterator<Item = String> {
    cell.split('`').skip(1).step_by(2).map(str::to_owned)
}

/// The rows of the section "Bad input" by field.
fn rows() -> BTreeMap<String, Row> {
    let text = std::fs::read_to_string(root().join("docs/reliability.md")).unwrap();
    let (_, section) = text.split_once("\n## Bad input\n").expect("the section is there");
    let section = section.split("\n## ").next().unwrap();
    let mut rows = BTreeMap::new();
    for line in section.lines().filter(|line| line.starts_with("| `")) {
        let cells: Vec<&str> = line.trim_matches('|').split('|').map(str::trim).collect();
        let [inputs, wrong, _, shown] = cells[..] else { panic!("four cells are expected in {line}") };
        let tests: Vec<String> = quoted(shown).collect();
        for input in quoted(inputs) {
            let row = Row { wrong: wrong.to_owned(), tests: tests.clone() };
            assert!(rows.insert(input.clone(), row).is_none(), "{input} has two rows");
        }
    }
    rows
}

/// Every field of a request, and of the messages in it.
fn fields(owner: &str, message: &MessageDescriptor, seen: &mut BTreeSet<String>, found: &mut BTreeSet<String>) {
    for field in message.fields() {
        found.insert(format!("{owner}.{}", field.name()));
        if let (Kind::Message(inner), false) = (field.kind(), field.is_map())
            && inner.package_name() != "google.protobuf"
            && seen.insert(inner.full_name().to_owned())
        {
            fields(inner.name(), &inner, seen, found);
        }
    }
}

fn inputs() -> BTreeSet<String> {
    let pool = DescriptorPool::decode(gleaner_proto::DESCRIPTORS).unwrap();
    let (mut seen, mut found) = (BTreeSet::new(), BTreeSet::new());
    for service in pool.services() {
        for rpc in service.methods() {
            fields(rpc.name(), &rpc.input(), &mut seen, &mut found);
        }
    }
    assert!(found.len() > 150, "the walk found too little: {}", found.len());
    found
}

fn sources(dir: &Path, into: &mut String) {
    for entry in dir.read_dir().unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() && path.file_name().is_some_and(|name| name != "target") {
            sources(&path, into);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            into.push_str(&std::fs::read_to_string(path).unwrap());
        }
    }
}

#[test]
fn every_input_has_a_row_and_every_row_a_test() {
    let (rows, inputs) = (rows(), inputs());
    let named: BTreeSet<String> = rows.keys().cloned().collect();
    let missing: Vec<&String> = inputs.difference(&named).collect();
    assert!(missing.is_empty(), "no row for {missing:?}");
    let gone: Vec<&String> = named.difference(&inputs).collect();
    assert!(gone.is_empty(), "rows for what no request has: {gone:?}");

    let mut code = String::new();
    for room in ["crates", "server", "client", "tests"] {
        sources(&root().join(room), &mut code);
    }
    for (input, Row { wrong, tests }) in &rows {
        assert!(!tests.is_empty() || wrong.starts_with(ANY), "{input} names no test");
        for test in tests {
            let at = code.find(&format!("fn {test}(")).unwrap_or_else(|| panic!("{input}: there is no test {test}"));
            let before = code[..at].lines().rev().take(2).collect::<String>();
            assert!(before.contains("test]"), "{test}, which {input} names, is no test");
        }
    }
}
