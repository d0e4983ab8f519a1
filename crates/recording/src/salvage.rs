//! Salvage of a recording that a crash has truncated or damaged: everything before the damage.

use std::path::Path;

use crate::channels::Channels;
use crate::container::{Record, scan_whole_chunks};
use crate::copy::Copier;
use crate::error::RecordingError;
use crate::limits::Limits;
use crate::whole_file::write_whole;
use crate::write::{ACTION_TOPIC, mcap_writer};

/// Copies the intact part of a recording to `out`; returns the number of its actions, which are the steps of a recording by
/// [`crate::EpisodeWriter`]. A damaged tail, as after a power cut, is omitted like a missing one. A chunk with a wrong
/// checksum is omitted as a whole, because any of its messages may be wrong.
///
/// # Errors
/// [`RecordingError::Empty`] or `NotMcap` without a header; [`RecordingError::Io`] or `Write`.
pub fn salvage(damaged: &Path, out: &Path) -> Result<u64, RecordingError> {
    let mut actions = 0;
    write_whole(out, |file| {
        let mut copier = Copier::new(mcap_writer(file, "")?);
        let mut channels = Channels::new(&Limits::default());
        let read = scan_whole_chunks(damaged, &Limits::default(), &mut |record| {
            if let Record::Message { header, data } = record {
                let Some((topic, _, _)) = channels.next(header.channel_id) else { return Ok(()) };
                actions += u64::from(topic == ACTION_TOPIC);
                return copier.message(header, data);
            }
            channels.declare(&record, &|_| false)?;
            copier.declare(&record)
        });
        match read {
            Ok(_) | Err(RecordingError::Damaged { .. } | RecordingError::TooLarge { .. }) => copier.finish(),
            Err(error) => Err(error),
        }
    })?;
    Ok(actions)
}

#[cfg(test)]
mod tests {

    use super::*;
    use crate::container::{Ending, scan};
    use crate::read_episode;
    use crate::write::tests::{written, written_arm};

    /// Salvages these bytes; returns the file and the number of actions.
    fn salvaged(bytes: &[u8]) -> (tempfile::TempDir, Result<u64, RecordingError>) {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("damaged"), bytes).unwrap();
        let actions = salvage(&folder.path().join("damaged"), &folder.path().join("whole"));
        (folder, actions)
    }

    #[test]
    fn truncated_file_is_salvaged_up_to_its_end() {
        let bytes = written(40);
        let mut kept = Vec::new();
        for tail in [&[][..], &[0; 999], &[0xff; 999]] {
            for cut in (64..bytes.len()).step_by(bytes.len() / 23) {
                let damaged = [&bytes[..cut], tail].concat();
                let (folder, actions) = salvaged(&damaged);
                let (actions, path) = (actions.unwrap(), folder.path().join("whole"));
                let ending = scan(&path, &Limits::default(), &mut |_| Ok(())).unwrap().ending;
                assert_eq!(ending, Ending::Whole, "cut at {cut}");
                if actions >= 2 {
                    let reading = read_episode(&path, &written_arm()).unwrap();
                    assert_eq!(reading.report.steps, actions, "cut at {cut}");
                    assert!(reading.report.findings.is_empty(), "{:?}", reading.report.findings);
                }
                kept.push(actions);
            }
        }
        assert!(kept.contains(&40) && kept.iter().any(|&actions| actions < 40), "{kept:?}");
    }

    /// Every message with its time, in the file's order.
    fn messages(path: &Path) -> Vec<(u64, Vec<u8>)> {
        let mut messages = Vec::new();
        let scanned = scan(path, &Limits::default(), &mut |record| {
            if let Record::Message { header, data } = record {
                messages.push((header.log_time, data.to_vec()));
            }
            Ok(())
        });
        assert_eq!(scanned.unwrap().ending, Ending::Whole);
        messages
    }

    #[test]
    fn salvaged_messages_are_messages_of_the_original() {
        let (bytes, folder) = (written(40), tempfile::tempdir().unwrap());
        let whole = folder.path().join("whole");
        std::fs::write(&whole, &bytes).unwrap();
        let (all, mut cut) = (messages(&whole), 0);
        for at in (64..bytes.len()).step_by(bytes.len() / 150) {
            let mut damaged = bytes.clone();
            damaged[at] ^= 0x10;
            let (folder, actions) = salvaged(&damaged);
            if actions.is_ok() {
                let kept = messages(&folder.path().join("whole"));
                // A chunk that is not found any more leaves a gap.
                let mut rest = all.iter();
                assert!(kept.iter().all(|message| rest.any(|one| one == message)), "damaged at {at}");
                cut += usize::from(kept.len() < all.len());
            }
        }
        assert!(cut > 50, "{cut}");
    }

    #[test]
    fn salvage_keeps_an_intact_recording() {
        let (folder, actions) = salvaged(&written(5));
        assert_eq!(actions.unwrap(), 5);
        let reading = read_episode(&folder.path().join("whole"), &written_arm()).unwrap();
        assert!(reading.report.topics.iter().any(|topic| topic.topic == "/note" && topic.messages == 1));
    }

    #[test]
    fn file_without_a_header_is_not_salvaged() {
        assert!(matches!(salvaged(b"").1, Err(RecordingError::Empty { .. })));
        let (folder, refused) = salvaged(b"something else");
        assert!(matches!(refused, Err(RecordingError::NotMcap { .. })));
        assert!(!folder.path().join("whole").exists());
    }
}
