//! Stretches of recordings with video: each begins at a key frame, so that it reads as the same steps.

use gleaner_video::{Codec, Format};

use super::{Film, frames, task};
use crate::{Kept, RecordingError, extract, read_episode};

/// Messages of a file by topic.
fn count(bytes: &[u8], of: &str) -> usize {
    let stream = mcap::MessageStream::new(bytes).unwrap();
    stream.filter(|message| message.as_ref().unwrap().channel.topic == of).count()
}

#[test]
fn a_stretch_of_video_reads_as_the_same_steps() {
    for name in ["h264_baseline", "h264_b_frames", "h264_high10", "h265_main", "h265_open", "av1_aom"] {
        let film = Film::read(name);
        let folder = tempfile::tempdir().unwrap();
        let (path, out) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
        std::fs::write(&path, film.scene().mcap()).unwrap();
        let whole = read_episode(&path, &task()).unwrap();
        assert!(frames(&whole) == film.pictures(), "{name}");
        for (first, last) in [(0, 3), (3, 5), (5, 8), (8, 10), (6, 11)] {
            let steps = usize::try_from(last - first + 1).unwrap();
            let kept = Kept::unscored(first, steps);
            extract(&path, &task(), &kept, &out).unwrap();
            let part = read_episode(&out, &task()).unwrap();
            let range = usize::try_from(first).unwrap()..=usize::try_from(last).unwrap();
            assert_eq!(part.episode.stamps(), &whole.episode.stamps()[range.clone()], "{name}: {range:?}");
            assert!(frames(&part) == frames(&whole)[range.clone()], "{name}: {range:?}");
            let copied = count(&std::fs::read(&out).unwrap(), "/front/color");
            assert!(copied < film.messages.len() || first < 2, "{name}: {range:?} copied all");
        }
    }
}

#[test]
fn a_stretch_copies_parameter_sets_that_come_once() {
    let mut film = Film::read("h264_baseline");
    let codec = Codec::H264;
    // The second key frame without its sets: the bytes from its slice.
    let slice = film.messages[6].windows(5).position(|bytes| bytes == [0, 0, 1, 0x65, 0x88]).unwrap();
    film.messages[6].drain(..slice);
    assert_eq!(Format::named(&film.format), Format::Video(codec));
    let folder = tempfile::tempdir().unwrap();
    let (path, out) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    std::fs::write(&path, film.scene().mcap()).unwrap();
    let whole = read_episode(&path, &task()).unwrap();
    let kept = Kept::unscored(8, 3);
    extract(&path, &task(), &kept, &out).unwrap();
    assert!(frames(&read_episode(&out, &task()).unwrap()) == frames(&whole)[8..=10]);
    assert_eq!(count(&std::fs::read(&out).unwrap(), "/front/color"), 6);
}

#[test]
fn a_stretch_whose_clock_is_video_is_refused() {
    let mut spec = task();
    spec.mappings[0].clock = Some("/front/color".into());
    let folder = tempfile::tempdir().unwrap();
    let (path, out) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    std::fs::write(&path, Film::read("h264_baseline").scene().mcap()).unwrap();
    assert_eq!(read_episode(&path, &spec).unwrap().report.steps, 12);
    let kept = Kept::unscored(8, 2);
    let Err(RecordingError::Spec { problem, .. }) = extract(&path, &spec, &kept, &out) else { panic!("accepted") };
    assert!(problem.contains("/front/color") && problem.contains("clock"), "{problem}");
}
