//! Recordings that contradict themselves are refused, or read with a finding.

use std::io::Cursor;

use mcap::records::op;

use super::pick_cube;
use super::scene::{Scene, numbers_only, read_bytes};
use crate::mutants::{KINDS, Part, Random, inner, join, mutant, rebuilt, split};
use crate::{Finding, FindingCode, Reading, RecordingError, Severity, extract};

/// A recording with the given number of steps, in chunks of about ten.
fn chunked(steps: i64) -> Vec<u8> {
    let unchunked = Scene::steps(steps).mcap();
    let options = mcap::WriteOptions::new().chunk_size(Some(2400)).compression(Some(mcap::Compression::Lz4));
    let mut writer = options.create(Cursor::new(Vec::new())).unwrap();
    for message in mcap::MessageStream::new(&unchunked).unwrap() {
        writer.write(&message.unwrap()).unwrap();
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

fn read(bytes: &[u8]) -> Reading {
    read_bytes(bytes, &numbers_only()).unwrap()
}

fn subjects(findings: &[Finding]) -> Vec<(FindingCode, &str)> {
    assert!(findings.iter().all(|finding| finding.severity == Severity::Warning), "{findings:?}");
    findings.iter().map(|finding| (finding.code, finding.subject.as_str())).collect()
}

fn chunks(parts: &[Part]) -> Vec<usize> {
    (0..parts.len()).filter(|&at| parts[at].opcode == op::CHUNK).collect()
}

#[test]
fn sound_recording_has_no_contradictions() {
    for bytes in [chunked(80), Scene::steps(80).mcap()] {
        let reading = read(&bytes);
        assert_eq!((reading.report.steps, reading.report.findings.as_slice()), (80, &[][..]));
    }
    assert!(chunks(&split(&chunked(80))).len() > 5);
}

#[test]
fn a_flipped_bit_of_an_unchunked_recording_never_changes_a_value_silently() {
    let bytes = Scene::steps(40).mcap();
    let whole = read(&bytes).episode;
    let (mut random, mut refused, mut found, mut silent) = (Random::new(9), 0, 0, Vec::new());
    for _ in 0..900 {
        let mut changed = bytes.clone();
        let at = random.below(changed.len());
        changed[at] ^= 1 << random.below(8);
        match read_bytes(&changed, &numbers_only()) {
            Err(_) => refused += 1,
            Ok(reading) if !reading.report.findings.is_empty() => found += 1,
            Ok(reading) => {
                let same = reading.episode.stamps() == whole.stamps()
                    && reading.episode.proprioception() == whole.proprioception()
                    && reading.episode.action() == whole.action();
                silent.push((at, same));
            }
        }
    }
    println!("900 flips: {refused} refused, {found} with a finding, {} without", silent.len());
    assert!(silent.iter().all(|(_, same)| *same), "{silent:?}");
    assert!(refused > 600, "{refused}");
}

#[test]
fn a_lost_last_chunk_is_a_finding() {
    let lost = mutant(&chunked(80), "drop_last_chunk", &mut Random::new(0)).unwrap();
    let report = read(&lost).report;
    assert!(report.steps < 80, "{}", report.steps);
    let found = subjects(&report.findings);
    for subject in ["statistics", "chunk index"] {
        assert!(found.contains(&(FindingCode::SummaryMismatch, subject)), "{found:?}");
    }
    let statistics = report.findings.iter().find(|finding| finding.subject == "statistics").unwrap();
    assert!(statistics.detail.contains("they state 240 messages"), "{}", statistics.detail);
}

#[test]
fn two_swapped_chunks_lose_no_step() {
    let bytes = chunked(80);
    let mut parts = split(&bytes);
    let at = chunks(&parts);
    parts.swap(at[0], at[3]);
    let swapped = join(&parts);
    let (reading, whole) = (read(&swapped), read(&bytes));
    assert_eq!(reading.report.steps, 80);
    assert_eq!(reading.episode.action(), whole.episode.action());
    assert_eq!(reading.episode.proprioception(), whole.episode.proprioception());
    let found = subjects(&reading.report.findings);
    assert!(found.iter().any(|(code, _)| *code == FindingCode::UndeclaredChannel), "{found:?}");
    assert!(found.contains(&(FindingCode::SummaryMismatch, "chunk index")), "{found:?}");
}

#[test]
fn a_stretch_of_a_recording_with_late_declarations_has_its_messages() {
    let mut parts = split(&chunked(80));
    let at = chunks(&parts);
    parts.swap(at[0], at[3]);
    let folder = tempfile::tempdir().unwrap();
    let (path, out) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    std::fs::write(&path, join(&parts)).unwrap();
    let kept = crate::Kept::unscored(0, 60);
    extract(&path, &numbers_only(), &kept, &out).unwrap();
    assert_eq!(read(&std::fs::read(&out).unwrap()).report.steps, 60);
}

#[test]
fn messages_without_any_declaration_are_counted() {
    let mut parts = split(&Scene::steps(10).mcap());
    let message = parts.iter().find(|part| part.opcode == op::MESSAGE).unwrap().clone();
    let at = parts.iter().position(|part| part.opcode == op::DATA_END).unwrap();
    parts[at].body = vec![0; 4];
    let body = [&77_u16.to_le_bytes()[..], &message.body[2..]].concat();
    parts.splice(at..at, [Part { body: body.clone(), ..message.clone() }, Part { body, ..message }]);
    let report = read(&join(&parts)).report;
    let finding = report.findings.iter().find(|finding| finding.code == FindingCode::UndeclaredChannel).unwrap();
    assert_eq!(finding.subject, "channel 77");
    assert!(finding.detail.contains("2 messages were left out"), "{}", finding.detail);
}

#[test]
fn bytes_after_the_end_are_a_finding() {
    let bytes = chunked(20);
    for tail in [&b"x"[..], &bytes] {
        let report = read(&[&bytes, tail].concat()).report;
        assert_eq!(subjects(&report.findings), [(FindingCode::TrailingBytes, "file")]);
        assert!(report.findings[0].detail.contains(&format!("{} bytes", tail.len())));
        assert_eq!(report.steps, 20);
    }
}

#[test]
fn a_doubled_chunk_is_a_finding() {
    let doubled = mutant(&chunked(80), "double_chunk", &mut Random::new(4)).unwrap();
    let found = read(&doubled).report.findings;
    assert!(subjects(&found).contains(&(FindingCode::SummaryMismatch, "statistics")), "{found:?}");
}

#[test]
fn wrong_checksum_is_a_finding_if_chunks_have_checksums_and_an_error_otherwise() {
    let wrong = |bytes: &[u8], opcode: u8, begin: usize| {
        let mut parts = split(bytes);
        let part = parts.iter_mut().find(|part| part.opcode == opcode).unwrap();
        part.body[begin] ^= 1;
        read_bytes(&join(&parts), &numbers_only())
    };
    let checked = wrong(&chunked(20), op::DATA_END, 0).unwrap().report.findings;
    assert_eq!(subjects(&checked), [(FindingCode::ChecksumMismatch, "data section")]);
    let unchecked = wrong(&Scene::steps(20).mcap(), op::DATA_END, 0).unwrap_err();
    assert!(unchecked.to_string().contains("checksum of the data section"), "{unchecked}");
    assert!(matches!(wrong(&chunked(20), op::CHUNK, 24), Err(RecordingError::Damaged { .. })));
    let summary = wrong(&chunked(20), op::FOOTER, 16).unwrap().report.findings;
    assert_eq!(subjects(&summary), [(FindingCode::ChecksumMismatch, "summary section")]);
}

#[test]
fn a_message_index_that_names_other_messages_is_a_finding() {
    let mut parts = split(&chunked(20));
    let index = parts.iter_mut().find(|part| part.opcode == op::MESSAGE_INDEX).unwrap();
    index.body[6] ^= 1;
    let found = read(&join(&parts)).report.findings;
    assert!(subjects(&found).contains(&(FindingCode::SummaryMismatch, "message index")), "{found:?}");
}

/// Found by the differential suite: an indexed reader failed on such a recording, and this one had no finding.
#[test]
fn a_summary_that_repeats_some_of_the_channels_is_a_finding() {
    let mut parts = split(&chunked(20));
    let end = parts.iter().position(|part| part.opcode == op::DATA_END).unwrap();
    let channel = end + parts[end..].iter().position(|part| part.opcode == op::CHANNEL).unwrap();
    parts[channel].opcode = 0x80;
    let footer = parts.len() - 1;
    parts[footer].body[16..].fill(0);
    let found = read(&join(&parts)).report.findings;
    assert_eq!(subjects(&found), [(FindingCode::SummaryMismatch, "summary section")]);
}

/// Found by the differential suite: another reader refused these records, and this one skipped them.
#[test]
fn a_record_that_no_step_needs_and_that_does_not_fit_its_length_is_a_finding() {
    let garbage = |opcode| Part { opcode, body: vec![0xff; 40] };
    for (opcode, subject) in [
        (op::ATTACHMENT, "attachments"),
        (op::ATTACHMENT_INDEX, "summary section"),
        (op::METADATA_INDEX, "summary section"),
    ] {
        let mut parts = split(&chunked(20));
        parts.insert(1, garbage(opcode));
        let found = read(&join(&parts)).report.findings;
        assert!(subjects(&found).contains(&(FindingCode::SummaryMismatch, subject)), "{opcode}: {found:?}");
    }
    let mut parts = split(&chunked(20));
    let library = parts[0].body.len() - 1;
    parts[0].body[library] = 0xff;
    assert!(matches!(read_bytes(&join(&parts), &numbers_only()), Err(RecordingError::Damaged { .. })));
}

#[test]
fn an_attachment_that_differs_from_its_checksum_is_a_finding() {
    let mut writer = mcap::WriteOptions::new().use_chunks(false).create(Cursor::new(Vec::new())).unwrap();
    let attachment = mcap::Attachment {
        log_time: 1,
        create_time: 1,
        name: "note".to_owned(),
        media_type: "text/plain".to_owned(),
        data: b"attached".to_vec().into(),
    };
    writer.attach(&attachment).unwrap();
    writer.finish().unwrap();
    let parts = split(&writer.into_inner().into_inner());
    let attached = parts.iter().position(|part| part.opcode == op::ATTACHMENT).unwrap();
    let mut whole = split(&chunked(20));
    for (flip, expected) in [(0, false), (1, true)] {
        let mut part = parts[attached].clone();
        let last = part.body.len() - 5;
        part.body[last] ^= flip;
        whole.insert(1, part);
        let found = read(&join(&whole)).report.findings;
        let reported = subjects(&found).contains(&(FindingCode::ChecksumMismatch, "attachments"));
        assert_eq!(reported, expected, "{found:?}");
        whole.remove(1);
    }
}

#[test]
fn a_second_declaration_with_other_contents_is_a_finding() {
    let mut parts = split(&chunked(20));
    let at = chunks(&parts)[0];
    let mut within = inner(&parts[at]).unwrap();
    let mut channel = within.iter().find(|part| part.opcode == op::CHANNEL).unwrap().clone();
    let last = channel.body.iter().rposition(u8::is_ascii_lowercase).unwrap();
    channel.body[last] ^= 1;
    within.push(channel);
    parts[at] = rebuilt(&parts[at], &within, true);
    let reading = read(&join(&parts));
    assert_eq!(reading.report.steps, 20);
    let found = subjects(&reading.report.findings);
    assert!(found.contains(&(FindingCode::ConflictingDeclaration, "file")), "{found:?}");
}

/// Every mutant is refused, read with a finding, or read with the same values, without a panic. The differential suite
/// compares mutants that checksums cannot detect with another reader.
#[test]
fn mutants_of_every_kind_are_refused_found_or_equal() {
    let (spec, bytes) = (numbers_only(), chunked(40));
    let whole = read(&bytes).episode;
    let undetectable = ["reorder_times", "inner_flip", "flip_unchecked"];
    for (at, (kind, _)) in KINDS.iter().enumerate() {
        let (mut accepted, mut tried) = (0, 0);
        for seed in 0..25 {
            let mut random = Random::new(seed * 1000 + at as u64);
            let Some(changed) = mutant(&bytes, kind, &mut random) else { continue };
            tried += 1;
            let Ok(reading) = read_bytes(&changed, &spec) else { continue };
            accepted += 1;
            let same = reading.episode.action() == whole.action() && reading.episode.stamps() == whole.stamps();
            assert!(
                same || undetectable.contains(kind) || !reading.report.findings.is_empty(),
                "{kind}, seed {seed}: {} steps and no finding",
                reading.report.steps
            );
        }
        assert!(tried > 0 && accepted <= tried, "{kind} was not tried");
    }
}

#[test]
fn real_recordings_have_no_contradictions() {
    for name in ["pick_cube_foxglove.mcap", "pick_cube_ros2.mcap"] {
        let bytes = std::fs::read(super::fixture(name)).unwrap();
        assert_eq!(read_bytes(&bytes, &pick_cube()).unwrap().report.findings, []);
    }
}
