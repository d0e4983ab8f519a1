//! Makes damaged copies of recordings and reads each: the Rust half of the differential suite in `differential/`.
//!
//! `mutants BASES FIRST COUNT SEED` reads `BASES/spec.json` (a task) and every `BASES/DIALECT-*.mcap`, where DIALECT is
//! the name of one of the task's mappings. For each mutant it writes to standard output: the length of a JSON object
//! (u32, little-endian), the object, the length of the mutant, the mutant. A mutant depends on its number and the seed
//! only.
#![allow(clippy::expect_used, reason = "a test tool, which ends at the first fault")]

use std::io::{BufWriter, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

use gleaner_recording::fuzzing::{KINDS, Random, Sums, mutant, sums};
use gleaner_recording::{Reading, RecordingError, TaskSpec, read_episode};
use serde_json::{Value, json};

/// A sound recording.
struct Base {
    name: String,
    mapping: String,
    bytes: Vec<u8>,
    reading: Reading,
}

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, bases, first, count, seed] = arguments.as_slice() else {
        std::process::exit(2);
    };
    let number = |text: &String| text.parse::<u64>().expect("FIRST, COUNT and SEED are numbers");
    let (first, count, seed) = (number(first), number(count), number(seed));
    let spec = std::fs::read(Path::new(bases).join("spec.json")).expect("BASES has spec.json");
    let spec: TaskSpec = serde_json::from_slice(&spec).expect("spec.json is a task");
    let bases = load(Path::new(bases), &spec);
    let file = std::env::temp_dir().join(format!("gleaner-mutant-{}.mcap", std::process::id()));
    let mut out = BufWriter::new(std::io::stdout().lock());
    for id in first..first.saturating_add(count) {
        let (base, kind, bytes) = make(&bases, id, seed);
        std::fs::write(&file, &bytes).expect("the temporary directory is writable");
        let mut entry = read(&file, &spec, base);
        entry["id"] = json!(id);
        entry["base"] = json!(base.name);
        entry["mapping"] = json!(base.mapping);
        entry["kind"] = json!(kind);
        let entry = entry.to_string();
        for part in [entry.as_bytes(), &bytes] {
            let length = u32::try_from(part.len()).expect("mutants are small");
            out.write_all(&length.to_le_bytes())
                .and_then(|()| out.write_all(part))
                .expect("standard output is writable");
        }
    }
    out.flush().expect("standard output is writable");
    let _ = std::fs::remove_file(&file);
}

fn load(folder: &Path, spec: &TaskSpec) -> Vec<Base> {
    let entries = std::fs::read_dir(folder).expect("BASES is a folder");
    let mut paths: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    paths.retain(|path| path.extension().is_some_and(|extension| extension == "mcap"));
    paths.sort();
    let base = |path: &PathBuf| {
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let mapping = name.split('-').next().unwrap_or_default().to_owned();
        let reading = read_episode(path, spec).expect("a base can be read");
        assert!(reading.report.findings.is_empty(), "{name}: {:?}", reading.report.findings);
        assert_eq!(reading.mapping, mapping, "{name} is named after its mapping");
        Base { name, mapping, bytes: std::fs::read(path).expect("a base can be read"), reading }
    };
    paths.iter().map(base).collect()
}

/// The mutant of this number: bases take turns, then kinds. A kind that does not apply is replaced by the next one.
fn make(bases: &[Base], id: u64, seed: u64) -> (&Base, &'static str, Vec<u8>) {
    let index = usize::try_from(id).unwrap_or_default();
    let base = &bases[index % bases.len()];
    let mut random = Random::new(seed.wrapping_mul(0x0010_0000_0000).wrapping_add(id));
    let made = (0..KINDS.len()).find_map(|next| {
        let (kind, _) = KINDS[(index / bases.len() + next) % KINDS.len()];
        Some((base, kind, mutant(&base.bytes, kind, &mut random)?))
    });
    made.expect("some kind applies to every base")
}

fn read(file: &Path, spec: &TaskSpec, base: &Base) -> Value {
    let read = || {
        let reading = read_episode(file, spec)?;
        let sums = sums(file, spec, &reading.mapping)?;
        Ok::<_, RecordingError>((reading, sums))
    };
    match catch_unwind(AssertUnwindSafe(read)) {
        Err(_) => json!({"outcome": "panicked"}),
        Ok(Err(error)) => json!({"outcome": "refused", "detail": error.to_string()}),
        Ok(Ok((reading, sums))) => {
            let findings: Vec<Value> = reading
                .report
                .findings
                .iter()
                .map(|finding| json!({"code": finding.code, "subject": finding.subject, "detail": finding.detail}))
                .collect();
            json!({
                "outcome": "accepted",
                "steps": reading.report.steps,
                "read_as": reading.mapping,
                "findings": findings,
                "same": same(&reading, &base.reading),
                "sums": described(&sums),
            })
        }
    }
}

fn same(a: &Reading, b: &Reading) -> bool {
    let (a, b) = (&a.episode, &b.episode);
    a.stamps() == b.stamps()
        && a.proprioception() == b.proprioception()
        && a.action() == b.action()
        && a.frames().as_ref() == b.frames().as_ref()
}

fn described(sums: &Sums) -> Value {
    let mut topics = json!({});
    for (name, topic) in &sums.topics {
        topics[name] = json!({
            "messages": topic.messages,
            "ordered": topic.ordered,
            "unordered": topic.unordered,
            "stamps": topic.stamps,
            "images": topic.images,
        });
    }
    json!({"topics": topics, "fields": sums.fields})
}
