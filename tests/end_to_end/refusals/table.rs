//! The table of bad input in `docs/reliability.md`: every field of every request has a row, and every row names a test that
//! exists.

use std::collections::{BTreeMap, BTreeSet};

use prost_reflect::{DescriptorPool, Kind, MessageDescriptor};

use crate::support::files::{self, root};

/// The first word of a row whose field has no wrong value.
const ANY: &str = "any";

struct Row {
    wrong: String,
    tests: Vec<String>,
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

#[test]
fn every_field_of_a_request_has_a_row_and_every_row_a_test() {
    let (rows, inputs) = (rows(), inputs());
    let named: BTreeSet<String> = rows.keys().cloned().collect();
    let missing: Vec<&String> = inputs.difference(&named).collect();
    assert!(missing.is_empty(), "no row for {missing:?}");
    let gone: Vec<&String> = named.difference(&inputs).collect();
    assert!(gone.is_empty(), "rows without a field of a request: {gone:?}");

    let code: String = files::sources("", "rs").iter().map(|path| files::source(path).1).collect();
    for (input, Row { wrong, tests }) in &rows {
        assert!(!tests.is_empty() || wrong.starts_with(ANY), "{input} names no test");
        for test in tests {
            let at = code.find(&format!("fn {test}(")).unwrap_or_else(|| panic!("{input}: there is no test {test}"));
            let before = code[..at].lines().rev().take(2).collect::<String>();
            assert!(before.contains("test]"), "{test}, which {input} names, is not a test");
        }
    }
}
