//! Steps that are left out of a recording.

use super::*;
use crate::{
    domain::observation::Image,
    error::Kind,
    ingest::testing::{USABLE, playing},
};

#[tokio::test]
async fn steps_that_do_not_fit_the_task_or_the_limits_are_left_out() {
    let lab = Lab::new().await;
    let queue = event::Queue::new();
    let (files, mut writer) = lab.writer(Limits { steps: 4, bytes: u64::MAX });
    writer.step(&step(0, &queue));
    for spoil in [
        |o: &mut Observation| o.proprioception[0] = f32::NAN,
        |o: &mut Observation| o.proprioception.truncate(1),
        |o: &mut Observation| o.cameras.push(CameraFrame { camera: "ceiling".into(), color: None, depth: None }),
    ] {
        let mut one = step(1, &queue);
        spoil(&mut one.observation);
        writer.step(&one);
    }
    (2..9).for_each(|number| writer.step(&step(number, &queue)));
    writer.end(&broken_off()).unwrap();
    let id = lab.rollouts.keep(&files).await.unwrap().unwrap();
    assert_eq!(lab.fixture.store.episode(&id).await.unwrap().episode.steps, 4);
}

/// Of a success alone: the part of a failure that was recorded is of a failure.
#[tokio::test]
async fn a_success_whose_recording_lacks_steps_is_stored_as_unknown() {
    let lab = Lab::new().await;
    let queue = event::Queue::new();
    for (recorded, left_out, outcome, stored) in [
        (5, 0, Outcome::Success, Outcome::Success),
        (4, 0, Outcome::Success, Outcome::Unknown),
        (5, 1, Outcome::Success, Outcome::Unknown),
        (4, 0, Outcome::Failure, Outcome::Failure),
    ] {
        let (files, mut writer) = lab.writer(Limits { steps: recorded, bytes: u64::MAX });
        (0..5).for_each(|number| writer.step(&step(number, &queue)));
        writer.end(&Ending { outcome, left_out, ..broken_off() }).unwrap();
        let id = lab.rollouts.keep(&files).await.unwrap().unwrap();
        assert_eq!(
            lab.fixture.store.episode(&id).await.unwrap().episode.outcome,
            stored,
            "{recorded} steps, {left_out}"
        );
    }
}

/// At any rate: the test does not sync.
#[tokio::test]
async fn recordings_stay_below_the_upload_limit() {
    let lab = Lab::new().await;
    let queue = event::Queue::new();
    let (files, mut two) = lab.writer(ALL);
    (0..2).for_each(|number| two.step(&step(number, &queue)));
    two.sync();
    let limit = fs::metadata(files.recording()).unwrap().len() + 2000;
    drop(two);
    files.remove().unwrap();
    let (files, mut small) = lab.writer(Limits { steps: u64::MAX, bytes: limit });
    (0..200).for_each(|number| small.step(&step(number, &queue)));
    small.sync();
    assert!(fs::metadata(files.recording()).unwrap().len() <= limit);
    small.end(&broken_off()).unwrap();
    let id = lab.rollouts.keep(&files).await.unwrap().unwrap();
    let steps = lab.fixture.store.episode(&id).await.unwrap().episode.steps;
    assert!((3..100).contains(&steps), "{steps}");
}

#[tokio::test]
async fn a_recording_that_cannot_be_created_is_an_error() {
    let lab = Lab::new().await;
    fs::remove_dir_all(lab.rollouts.folder()).unwrap();
    let mut recorder = lab.begin();
    drive(&mut recorder, 5);
    let lost = recorder.finish(Outcome::Success, "closed", ObservationCounts::default()).await.unwrap_err();
    assert_eq!(lost.kind(), Kind::Internal, "{lost}");
    assert!(lab.episodes().await.is_empty());
}

#[test]
fn frames_without_an_image_take_room() {
    let frame = |image: Option<Image>| CameraFrame { camera: "a long name".into(), color: image, depth: None };
    let many = Observation { cameras: vec![frame(None); 1000], ..seen(0) };
    assert!(event::bytes(&many) > 1000 * size_of::<CameraFrame>() + 11_000);
}

/// The bucket, say, is away for a moment: no client can repeat the end of a session.
#[tokio::test]
async fn a_session_that_ends_during_an_outage_is_stored_after_it() {
    let here = r#"${frames%/tmp/*}/tried"#;
    let fixture = playing(&format!(r#"if [ -e "{here}" ]; then {USABLE}; else : > "{here}"; kill -TERM $$; fi"#)).await;
    let rollouts = Rollouts::open(&fixture.config, fixture.ingest.clone()).unwrap();
    let lab = Lab { fixture, rollouts };
    let mut recorder = lab.begin();
    drive(&mut recorder, 5);
    let away = recorder.finish(Outcome::Success, "closed", ObservationCounts::default()).await.unwrap_err();
    assert_eq!(away.kind(), Kind::Unavailable, "{away}");
    let stored = async {
        while lab.episodes().await.is_empty() {
            tokio::time::sleep(AGAIN_AFTER).await;
        }
    };
    tokio::time::timeout(Duration::from_secs(60), stored).await.expect("the recording waits for another start");
}

/// A start on a full disk: recordings of earlier sessions wait for room, not for another start.
#[tokio::test]
async fn recordings_found_on_a_full_disk_are_stored_once_there_is_room() {
    let mut lab = Lab::new().await;
    let free = lab.fixture.on_a_small_disk();
    lab.rollouts = Rollouts::open(&lab.fixture.config, lab.fixture.ingest.clone()).unwrap();
    let queue = event::Queue::new();
    let (_, mut writer) = lab.writer(ALL);
    (0..5).for_each(|number| writer.step(&step(number, &queue)));
    writer.end(&broken_off()).unwrap();
    free.store(0, Ordering::Relaxed);
    let found = lab.rollouts.left().unwrap();
    let waiting = tokio::time::timeout(AGAIN_AFTER * 5, lab.rollouts.recover(found.clone()));
    assert!(waiting.await.is_err(), "there is no room yet");
    free.store(u64::MAX, Ordering::Relaxed);
    lab.rollouts.recover(found).await;
    assert_eq!(lab.episodes().await[0].steps, 5);
}
