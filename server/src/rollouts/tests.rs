//! Recordings of sessions that end in every way, stored by a real inspection.

mod limits;

use std::{fs, io::Write as _, sync::atomic::Ordering};

use gleaner_recording::{Severity, read_episode};
use tokio::sync::mpsc::UnboundedReceiver;

use super::{steps::Step, *};
use crate::{
    domain::{
        episode::{Episode, EpisodeFilter},
        id::PolicyId,
        observation::{Acted, CameraFrame, Observation, Timings},
    },
    ingest::testing::{Fixture, real},
};

const START: i64 = 1_700_000_000_000_000_000;

struct Lab {
    fixture: Fixture,
    rollouts: Rollouts,
}

impl Lab {
    async fn new() -> Self {
        let fixture = real("none", &[]).await;
        let rollouts = Rollouts::open(&fixture.config, fixture.ingest.clone()).unwrap();
        Self { fixture, rollouts }
    }

    /// As after a start, with everything that was left kept.
    async fn start_again(&mut self) {
        self.rollouts = Rollouts::open(&self.fixture.config, self.fixture.ingest.clone()).unwrap();
        self.rollouts.stop().await;
    }

    fn about(&self) -> About {
        About {
            session_id: SessionId::new(),
            task_id: self.fixture.task.id.clone(),
            deployment: "reach@prod".into(),
            policy_id: PolicyId::new(),
            score_run_id: None,
            control_rate_hz: 10.0,
            cohort: "night".into(),
        }
    }

    fn begin(&self) -> Recorder {
        self.rollouts.begin(self.about(), &self.fixture.task).unwrap()
    }

    fn tape(&self, limits: Limits) -> (Place, Tape) {
        let slip = Slip { about: self.about(), outcome: Outcome::Unknown, steps: None };
        let place = self.rollouts.place(&slip.about.session_id);
        (place.clone(), Tape::new(place, slip, self.fixture.task.spec.clone(), limits))
    }

    async fn episodes(&self) -> Vec<Episode> {
        let filter =
            EpisodeFilter { task_id: self.fixture.task.id.clone(), outcome: None, cohort: None, deleted: false };
        self.fixture.store.episodes(&filter, None, 100).await.unwrap().0
    }

    fn left(&self) -> Vec<PathBuf> {
        self.fixture.files(&["rollouts", "uploads", "tmp"])
    }
}

const ALL: Limits = Limits { steps: u64::MAX, bytes: u64::MAX };

fn seen(step: i16) -> Observation {
    Observation {
        stamp_ns: START + i64::from(step) * 100_000_000,
        cameras: Vec::new(),
        proprioception: vec![f32::from(step), 0.5],
        executed_action: Vec::new(),
        deadline: None,
    }
}

/// So many steps, each answered with its own number.
fn drive(recorder: &mut Recorder, steps: i16) {
    for step in 0..steps {
        let observation = seen(step);
        recorder.observed(&observation);
        recorder.asks(observation.stamp_ns);
        recorder.turned(true);
        let actions = vec![vec![f32::from(step)], vec![-1.0]];
        let (policy_id, timings) = (PolicyId::new(), Timings::default());
        recorder.commanded(&Acted { stamp_ns: observation.stamp_ns, actions, policy_id, timings });
    }
}

fn step(number: i16, queue: &event::Queue) -> event::Written {
    let action = Some(vec![f32::from(number)]);
    Step { observation: seen(number), action, sound: true, _room: queue.room(1).unwrap() }
}

#[tokio::test]
async fn a_session_becomes_an_episode_that_says_what_was_done() {
    let lab = Lab::new().await;
    let mut recorder = lab.begin();
    drive(&mut recorder, 6);
    let id = recorder.finish(Outcome::Failure, "closed", Tally::default()).await.unwrap().unwrap();
    let inspected = lab.fixture.store.episode(&id).await.unwrap();
    let episode = inspected.episode;
    assert_eq!((episode.steps, episode.outcome, episode.cohort.as_str()), (6, Outcome::Failure, "night"));
    let topics: Vec<_> = inspected.report.topics.iter().map(|topic| (topic.topic.as_str(), topic.messages)).collect();
    assert!(topics.contains(&("/policy/action", 6)), "{topics:?}");
    assert!(inspected.report.findings.is_empty(), "{:?}", inspected.report.findings);
    let frames = lab.fixture.ingest.frames(&lab.fixture.task.spec, &episode.recording).await.unwrap();
    assert_eq!(frames.stamps(), (0..6).map(|at| seen(at).stamp_ns).collect::<Vec<_>>());
    assert_eq!(frames.action(), [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
    assert!(lab.left().is_empty(), "{:?}", lab.left());
}

/// A robot goes on without its recording; what there is of it is kept once there is room.
#[tokio::test]
async fn a_disk_that_fills_up_ends_the_recording_and_not_the_session() {
    let mut fixture = real("none", &[]).await;
    let free = fixture.on_a_small_disk();
    let rollouts = Rollouts::open(&fixture.config, fixture.ingest.clone()).unwrap();
    let lab = Lab { fixture, rollouts };
    let mut recorder = lab.begin();
    drive(&mut recorder, 6);
    free.store(0, Ordering::Relaxed);
    let refused = lab.rollouts.begin(lab.about(), &lab.fixture.task).err().unwrap();
    assert!(refused.kind() == Kind::Exhausted && refused.message().contains("without a recording"), "{refused}");
    let ended = recorder.finish(Outcome::Success, "closed", Tally::default()).await.unwrap_err();
    assert_eq!(ended.kind(), Kind::Exhausted, "{ended}");
    assert!(lab.episodes().await.is_empty() && !lab.left().is_empty());
    free.store(u64::MAX, Ordering::Relaxed);
    let kept = async {
        while lab.episodes().await.is_empty() {
            tokio::task::yield_now().await;
        }
    };
    tokio::time::timeout(std::time::Duration::from_secs(60), kept).await.unwrap();
    assert_eq!(lab.episodes().await[0].steps, 6);
}

#[tokio::test]
async fn a_session_that_nobody_closes_is_kept_and_nobody_knows_how_it_went() {
    let lab = Lab::new().await;
    let mut recorder = lab.begin();
    drive(&mut recorder, 4);
    drop(recorder);
    lab.rollouts.stop().await;
    let episodes = lab.episodes().await;
    // What was done at the newest was never known whole.
    assert_eq!((episodes.len(), episodes[0].steps, episodes[0].outcome), (1, 3, Outcome::Unknown));
    assert!(lab.left().is_empty(), "{:?}", lab.left());
}

#[tokio::test]
async fn less_than_two_steps_leave_nothing() {
    let lab = Lab::new().await;
    for steps in 0..2 {
        let mut recorder = lab.begin();
        drive(&mut recorder, steps);
        assert_eq!(recorder.finish(Outcome::Success, "closed", Tally::default()).await.unwrap(), None);
    }
    assert!(lab.episodes().await.is_empty() && lab.left().is_empty(), "{:?}", lab.left());
}

#[tokio::test]
async fn what_a_crash_tears_is_mended_at_the_next_start() {
    let mut lab = Lab::new().await;
    let queue = event::Queue::new();
    let (place, mut tape) = lab.tape(ALL);
    (0..5).for_each(|number| tape.step(&step(number, &queue)));
    tape.sync();
    (5..9).for_each(|number| tape.step(&step(number, &queue)));
    std::mem::forget(tape);
    // Left by a salvage that was killed, at a start before.
    fs::write(place.mended().with_extension("mended.77-0.partial"), b"half").unwrap();
    // What a disk may make of the tail.
    fs::File::options().append(true).open(place.recording()).unwrap().write_all(&[0; 5000]).unwrap();
    lab.start_again().await;
    let episodes = lab.episodes().await;
    assert_eq!((episodes.len(), episodes[0].steps, episodes[0].outcome), (1, 5, Outcome::Unknown));
    let path = lab.fixture.config.data_dir.join("blobs");
    let recording = episodes[0].recording.as_str();
    let reading = read_episode(&path.join(&recording[..2]).join(&recording[2..]), &lab.fixture.task.spec).unwrap();
    assert!(reading.report.findings.iter().all(|finding| finding.severity == Severity::Note), "a whole file");
    assert!(lab.left().is_empty(), "{:?}", lab.left());
}

/// Killed between the end of the recording and the end of storing it, wherever: one episode, with its outcome.
#[tokio::test]
async fn storing_again_is_storing_once() {
    let mut lab = Lab::new().await;
    let queue = event::Queue::new();
    let (place, mut tape) = lab.tape(ALL);
    (0..5).for_each(|number| tape.step(&step(number, &queue)));
    assert!(tape.end(&Ending { outcome: Outcome::Success, ..broken_off() }).unwrap());
    let copies =
        [place.recording(), place.recording().with_extension("json")].map(|path| (fs::read(&path).unwrap(), path));
    let first = lab.rollouts.keep(&place).await.unwrap().unwrap();
    assert!(lab.left().is_empty());
    for (bytes, path) in copies {
        fs::write(path, bytes).unwrap();
    }
    lab.start_again().await;
    let episodes = lab.episodes().await;
    assert_eq!((episodes.len(), &episodes[0].id, episodes[0].outcome), (1, &first, Outcome::Success));
    assert!(lab.left().is_empty(), "{:?}", lab.left());
}

#[tokio::test]
async fn what_cannot_be_used_is_set_aside_and_in_nobodys_way() {
    let mut lab = Lab::new().await;
    let (place, tape) = lab.tape(ALL);
    drop(tape);
    let slip = Slip { about: lab.about(), outcome: Outcome::Unknown, steps: None };
    place.write(&slip).unwrap();
    fs::write(place.recording(), b"not a recording at all").unwrap();
    // One of which not a byte came to the disk, one without a slip, and one whose slip is spoilt.
    let folder = lab.rollouts.folder().to_owned();
    fs::write(folder.join("ses_empty.mcap"), b"").unwrap();
    fs::write(folder.join("ses_stray.mcap"), b"bytes").unwrap();
    fs::write(folder.join("ses_spoilt.mcap"), b"bytes").unwrap();
    fs::write(folder.join("ses_spoilt.json"), b"{").unwrap();
    lab.start_again().await;
    assert!(lab.episodes().await.is_empty());
    let mut aside: Vec<_> =
        fs::read_dir(folder.join("unusable")).unwrap().map(|file| file.unwrap().file_name()).collect();
    aside.sort();
    let session = place.recording().file_name().unwrap().to_owned();
    let stray: [std::ffi::OsString; 3] = ["ses_spoilt.json", "ses_spoilt.mcap", "ses_stray.mcap"].map(Into::into);
    assert_eq!(aside[1..], [&[session][..], &stray].concat(), "each with its slip, if there is one");
    assert!(aside[0].to_str().unwrap().ends_with(".json"), "{aside:?}");
    assert_eq!(fs::read_dir(&folder).unwrap().count(), 1, "nothing is looked at twice");
    let mut recorder = lab.begin();
    drive(&mut recorder, 3);
    assert!(recorder.finish(Outcome::Success, "closed", Tally::default()).await.unwrap().is_some());
}

/// Everything that waits to be written.
fn drain(told: &mut UnboundedReceiver<Event>) -> Vec<Event> {
    std::iter::from_fn(|| told.try_recv().ok()).collect()
}

#[tokio::test]
async fn a_slow_disk_costs_steps_and_never_a_wait() {
    let (events, mut told) = mpsc::unbounded_channel();
    let mut recorder = Recorder::new(events, 1);
    // Ten megabytes each: three have room.
    let image = |step| {
        let data = vec![0; 10 << 20].into();
        let color =
            Some(crate::domain::observation::Image { format: crate::domain::observation::ImageFormat::Raw, data });
        let cameras = vec![CameraFrame { camera: "top".into(), color, depth: None }];
        Observation { cameras, executed_action: vec![f32::from(step)], ..seen(step) }
    };
    (0..6).for_each(|step| recorder.observed(&image(step)));
    let written = drain(&mut told);
    assert_eq!(written.len(), 3, "the fourth was left out, but said what was done at the third");
    drop(written);
    recorder.observed(&image(6));
    recorder.observed(&image(7));
    drop(recorder.end(Outcome::Unknown, "closed", Tally::default()));
    let events = drain(&mut told);
    let stamps: Vec<_> = events
        .iter()
        .filter_map(|event| if let Event::Step(step) = event { Some(step.observation.stamp_ns) } else { None })
        .collect();
    assert_eq!(stamps, [seen(6).stamp_ns, seen(7).stamp_ns]);
    let Some(Event::End(ending, _)) = events.last() else { panic!("not ended") };
    assert_eq!(ending.left_out, 3);
}
