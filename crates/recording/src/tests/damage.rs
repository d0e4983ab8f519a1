//! Damaged and hostile files: the intact part is read, and the crate never panics.

use super::scene::{Scene, numbers_only, read_bytes};
use super::{fixture, pick_cube};
use crate::write::tests::{written, written_arm};
use crate::{FindingCode, Limits, RecordingError, Severity};

#[test]
fn truncated_file_gives_its_steps_and_a_finding() {
    let (bytes, spec) = (Scene::steps(20).mcap(), numbers_only());
    let mut last = 0;
    for cut in [900, 1200, 1500, 2000, 3000, 4000] {
        let reading = read_bytes(&bytes[..cut], &spec).unwrap();
        let finding = &reading.report.findings[0];
        assert_eq!((finding.severity, finding.code), (Severity::Warning, FindingCode::Truncated));
        assert!(reading.report.steps > last, "cut at {cut}: {} steps", reading.report.steps);
        last = reading.report.steps;
    }
}

#[test]
fn truncated_real_recording_is_read_or_refused_with_an_error() {
    let (bytes, spec) = (std::fs::read(fixture("pick_cube_ros2.mcap")).unwrap(), pick_cube());
    let mut salvaged = 0;
    for cut in (0..bytes.len()).step_by(bytes.len() / 40) {
        match read_bytes(&bytes[..cut], &spec) {
            Ok(reading) => {
                assert_eq!(reading.report.findings[0].code, FindingCode::Truncated, "cut at {cut}");
                salvaged = salvaged.max(reading.report.steps);
            }
            Err(RecordingError::Rejected(report)) => assert!(report.has_errors(), "cut at {cut}"),
            Err(error) => assert!(cut < 8, "cut at {cut}: {error}"),
        }
    }
    assert_eq!(salvaged, 6);
}

/// A small generator of repeatable numbers, so that a failure can be found again.
fn numbers(mut state: u64) -> impl FnMut(usize) -> usize {
    move |below| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        usize::try_from(state >> 33).unwrap() % below
    }
}

#[test]
fn changed_bytes_never_panic() {
    let files = [
        (std::fs::read(fixture("pick_cube_ros2.mcap")).unwrap(), pick_cube(), 60),
        (written(3), written_arm(), 150),
        (Scene::steps(4).mcap(), numbers_only(), 300),
    ];
    let mut refused = 0;
    for (bytes, spec, rounds) in &files {
        for seed in 0..*rounds {
            let mut next = numbers(seed);
            let mut changed = bytes.clone();
            for _ in 0..=next(8) {
                let at = next(changed.len());
                changed[at] = u8::try_from(next(256)).unwrap();
            }
            // A panic of the container crate is caught within; one of this crate fails the test.
            refused += usize::from(read_bytes(&changed, spec).is_err());
        }
    }
    assert!(refused > 100, "only {refused} of the changed files were refused");
}

#[test]
fn changed_messages_never_panic() {
    use crate::container::{Record, scan};
    use crate::dialect::{ChannelSchema, Decoder};
    use crate::picture::{Channel, decode};
    for name in ["pick_cube_ros2.mcap", "pick_cube_foxglove.mcap"] {
        let (mut schemas, mut messages) = (Vec::new(), Vec::new());
        scan(&fixture(name), &Limits::default(), &mut |record| {
            match record {
                Record::Schema { name, encoding, data, .. } => {
                    schemas.push((name.to_owned(), encoding.to_owned(), data.to_vec()));
                }
                Record::Message { data, .. } => messages.push(data.to_vec()),
                Record::Header { .. }
                | Record::Channel { .. }
                | Record::Metadata { .. }
                | Record::Attachment { .. } => {}
            }
            Ok(())
        })
        .unwrap();
        let mut next = numbers(7);
        for (name, encoding, mut data) in schemas {
            for _ in 0..30 {
                let message_encoding = if encoding == "ros2msg" { "cdr" } else { "protobuf" };
                let schema = ChannelSchema { message_encoding, schema_encoding: &encoding, name: &name, data: &data };
                if let Ok(decoder) = Decoder::new(schema, &Limits::default()) {
                    let mut message = messages[next(messages.len())].clone();
                    let at = next(message.len().min(64));
                    message[at] = u8::try_from(next(256)).unwrap();
                    if let Ok(value) = decoder.decode(&message) {
                        let _ = value.stamp();
                        let _ = decode(&value, Channel::Color, &pick_cube().cameras[0]);
                        let _ = decode(&value, Channel::Depth, &pick_cube().cameras[0]);
                    }
                }
                let at = next(data.len());
                data[at] = u8::try_from(next(256)).unwrap();
            }
        }
        assert!(messages.len() > 30);
    }
}
