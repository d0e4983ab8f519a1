//! Makes a whole recording of one that a crash has torn: everything before the tear, nothing after it.

use std::path::Path;

use crate::channels::Channels;
use crate::container::{Record, scan_whole_chunks};
use crate::copy::Copier;
use crate::error::RecordingError;
use crate::limits::Limits;
use crate::whole_file::write_whole;
use crate::write::{ACTION_TOPIC, mcap_writer};

/// Copies what is whole of a recording to `out`, and says how many actions are among it: the steps, if
/// [`crate::EpisodeWriter`] wrote it. What a disk made of the tail after a power cut is torn off like a missing one, and a
/// chunk goes as a whole: of one whose checksum is wrong nobody knows which messages are what they were.
///
/// # Errors
/// [`RecordingError::Empty`] or `NotMcap` when there is not even a beginning; [`RecordingError::Io`] or `Write`.
pub fn salvage(torn: &Path, out: &Path) -> Result<u64, RecordingError> {
    let mut actions = 0;
    write_whole(out, |file| {
        let mut copier = Copier::new(mcap_writer(file, "")?);
        let mut channels = Channels::new(&Limits::default());
        let read = scan_whole_chunks(torn, &Limits::default(), &mut |record| {
            if let Record::Message { header, data } = record {
                let Some((topic, _, _)) = channels.next(header.channel_id) else { return Ok(()) };
                actions += u64::from(topic == ACTION_TOPIC);
                return copier.message(header, data);
            }
            channels.learn(&record, &|_| false)?;
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

    /// Salvages these bytes; gives the file and how many actions there are.
    fn salvaged(bytes: &[u8]) -> (tempfile::TempDir, Result<u64, RecordingError>) {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("torn"), bytes).unwrap();
        let actions = salvage(&folder.path().join("torn"), &folder.path().join("whole"));
        (folder, actions)
    }

    #[test]
    fn wherever_it_is_torn_what_came_before_reads_whole() {
        let bytes = written(40);
        let mut kept = Vec::new();
        for tail in [&[][..], &[0; 999], &[0xff; 999]] {
            for cut in (64..bytes.len()).step_by(bytes.len() / 23) {
                let torn = [&bytes[..cut], tail].concat();
                let (folder, actions) = salvaged(&torn);
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
    fn wherever_it_is_damaged_nothing_comes_out_that_was_not_in_it() {
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
    fn a_whole_one_stays_as_it_reads() {
        let (folder, actions) = salvaged(&written(5));
        assert_eq!(actions.unwrap(), 5);
        let reading = read_episode(&folder.path().join("whole"), &written_arm()).unwrap();
        assert!(reading.report.topics.iter().any(|topic| topic.topic == "/note" && topic.messages == 1));
    }

    #[test]
    fn without_a_beginning_there_is_nothing() {
        assert!(matches!(salvaged(b"").1, Err(RecordingError::Empty { .. })));
        let (folder, refused) = salvaged(b"something else");
        assert!(matches!(refused, Err(RecordingError::NotMcap { .. })));
        assert!(!folder.path().join("whole").exists());
    }
}
