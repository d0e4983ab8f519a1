//! What is left out of a recording, and what is lost with it.

use super::*;
use crate::{domain::observation::Image, error::Kind};

#[tokio::test]
async fn what_does_not_fit_the_task_or_is_one_step_too_many_is_left_out() {
    let lab = Lab::new().await;
    let queue = event::Queue::new();
    let (place, mut tape) = lab.tape(Limits { steps: 4, bytes: u64::MAX });
    tape.step(&step(0, &queue));
    for spoil in [
        |o: &mut Observation| o.proprioception[0] = f32::NAN,
        |o: &mut Observation| o.proprioception.truncate(1),
        |o: &mut Observation| o.cameras.push(CameraFrame { camera: "ceiling".into(), color: None, depth: None }),
    ] {
        let mut one = step(1, &queue);
        spoil(&mut one.observation);
        tape.step(&one);
    }
    (2..9).for_each(|number| tape.step(&step(number, &queue)));
    tape.end(&broken_off()).unwrap();
    let id = lab.rollouts.keep(&place).await.unwrap().unwrap();
    assert_eq!(lab.fixture.store.episode(&id).await.unwrap().episode.steps, 4);
}

/// However fast they come: nobody syncs here.
#[tokio::test]
async fn no_recording_grows_beyond_what_an_upload_may_be() {
    let lab = Lab::new().await;
    let queue = event::Queue::new();
    let (place, mut two) = lab.tape(ALL);
    (0..2).for_each(|number| two.step(&step(number, &queue)));
    two.sync();
    let limit = fs::metadata(place.recording()).unwrap().len() + 2000;
    drop(two);
    place.remove().unwrap();
    let (place, mut small) = lab.tape(Limits { steps: u64::MAX, bytes: limit });
    (0..200).for_each(|number| small.step(&step(number, &queue)));
    small.sync();
    assert!(fs::metadata(place.recording()).unwrap().len() <= limit);
    small.end(&broken_off()).unwrap();
    let id = lab.rollouts.keep(&place).await.unwrap().unwrap();
    let steps = lab.fixture.store.episode(&id).await.unwrap().episode.steps;
    assert!((3..100).contains(&steps), "{steps}");
}

#[tokio::test]
async fn a_recording_that_the_disk_does_not_let_begin_is_not_one_without_steps() {
    let lab = Lab::new().await;
    fs::remove_dir_all(lab.rollouts.folder()).unwrap();
    let mut recorder = lab.begin();
    drive(&mut recorder, 5);
    let lost = recorder.finish(Outcome::Success, "closed", Tally::default()).await.unwrap_err();
    assert_eq!(lost.kind(), Kind::Internal, "{lost}");
    assert!(lab.episodes().await.is_empty());
}

#[test]
fn frames_without_an_image_take_room_too() {
    let frame = |image: Option<Image>| CameraFrame { camera: "a long name".into(), color: image, depth: None };
    let many = Observation { cameras: vec![frame(None); 1000], ..seen(0) };
    assert!(event::bytes(&many) > 1000 * size_of::<CameraFrame>() + 11_000);
}

/// A start on a full disk: what a session has left waits for room, and for no other start.
#[tokio::test]
async fn what_is_found_without_room_for_it_is_kept_once_there_is() {
    let mut lab = Lab::new().await;
    let free = lab.fixture.on_a_small_disk();
    lab.rollouts = Rollouts::open(&lab.fixture.config, lab.fixture.ingest.clone()).unwrap();
    let queue = event::Queue::new();
    let (_, mut tape) = lab.tape(ALL);
    (0..5).for_each(|number| tape.step(&step(number, &queue)));
    tape.end(&broken_off()).unwrap();
    free.store(0, Ordering::Relaxed);
    let found = lab.rollouts.left().unwrap();
    let waiting = tokio::time::timeout(AGAIN_AFTER * 5, lab.rollouts.recover(found.clone()));
    assert!(waiting.await.is_err(), "there is no room yet");
    free.store(u64::MAX, Ordering::Relaxed);
    lab.rollouts.recover(found).await;
    assert_eq!(lab.episodes().await[0].steps, 5);
}
