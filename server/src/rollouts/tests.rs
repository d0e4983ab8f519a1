//! Recordings of sessions with all kinds of ends, stored through a real inspection.

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

    /// As after a start, with all earlier recordings stored.
    async fn start_again(&mut self) {
        self.rollouts = Rollouts::open(&self.fixture.config, self.fixture.ingest.clone()).unwrap();
        self.rollouts.stop().await;
    }

    fn session(&self) -> SessionInfo {
        SessionInfo {
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
        self.rollouts.begin(self.session(), &self.fixture.task).unwrap()
    }

    fn writer(&self, limits: Limits) -> (RolloutFiles, RolloutWriter) {
        let sidecar = RolloutSidecar { session: self.session(), outcome: Outcome::Unknown, steps: None };
        let files = self.rollouts.files(&sidecar.session.session_id);
        (files.clone(), RolloutWriter::new(files, sidecar, self.fixture.task.spec.clone(), limits))
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
        skipped_steps: 0,
    }
}

/// Records this many steps, each answered with its own number.
fn drive(recorder: &mut Recorder, steps: i16) {
    for step in 0..steps {
        let observation = seen(step);
        recorder.observed(&observation);
        recorder.inference_started(observation.stamp_ns);
        recorder.inference_finished(true);
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
async fn a_session_becomes_an_episode_with_its_executed_actions() {
    let lab = Lab::new().await;
    let mut recorder = lab.begin();
    drive(&mut recorder, 6);
    let id = recorder.finish(Outcome::Failure, "closed", ObservationCounts::default()).await.unwrap().unwrap();
    let inspected = lab.fixture.store.episode(&id).await.unwrap();
    let episode = inspected.episode;
    assert_eq!((episode.steps, episode.outcome, episode.cohort.as_str()), (6, Outcome::Failure, "night"));
    let topics: Vec<_> = inspected.report.topics.iter().map(|topic| (topic.topic.as_str(), topic.messages)).collect();
    assert!(topics.contains(&("/policy/action", 6)), "{topics:?}");
    assert!(inspected.report.findings.is_empty(), "{:?}", inspected.report.findings);
    let frames = lab.fixture.ingest.frames(&lab.fixture.task.spec, &episode.recording).await.unwrap();
    let frames = frames.numbers(0..frames.steps()).await.unwrap();
    assert_eq!(frames.stamps, (0..6).map(|at| seen(at).stamp_ns).collect::<Vec<_>>());
    assert_eq!(frames.action, [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
    assert!(lab.left().is_empty(), "{:?}", lab.left());
}

/// The robot continues without its recording; the part on disk is stored once there is room.
#[tokio::test]
async fn a_full_disk_ends_the_recording_and_not_the_session() {
    let mut fixture = real("none", &[]).await;
    let free = fixture.on_a_small_disk();
    let rollouts = Rollouts::open(&fixture.config, fixture.ingest.clone()).unwrap();
    let lab = Lab { fixture, rollouts };
    let mut recorder = lab.begin();
    drive(&mut recorder, 6);
    free.store(0, Ordering::Relaxed);
    let refused = lab.rollouts.begin(lab.session(), &lab.fixture.task).err().unwrap();
    assert!(refused.kind() == Kind::Exhausted && refused.message().contains("without recording"), "{refused}");
    let ended = recorder.finish(Outcome::Success, "closed", ObservationCounts::default()).await.unwrap_err();
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
async fn a_dropped_session_is_stored_with_an_unknown_outcome() {
    let lab = Lab::new().await;
    let mut recorder = lab.begin();
    drive(&mut recorder, 4);
    drop(recorder);
    lab.rollouts.stop().await;
    let episodes = lab.episodes().await;
    // The newest step had no executed action.
    assert_eq!((episodes.len(), episodes[0].steps, episodes[0].outcome), (1, 3, Outcome::Unknown));
    assert!(lab.left().is_empty(), "{:?}", lab.left());
}

#[tokio::test]
async fn fewer_than_two_steps_are_not_stored() {
    let lab = Lab::new().await;
    for steps in 0..2 {
        let mut recorder = lab.begin();
        drive(&mut recorder, steps);
        assert_eq!(recorder.finish(Outcome::Success, "closed", ObservationCounts::default()).await.unwrap(), None);
    }
    assert!(lab.episodes().await.is_empty() && lab.left().is_empty(), "{:?}", lab.left());
}

#[tokio::test]
async fn a_torn_recording_is_salvaged_at_the_next_start() {
    let mut lab = Lab::new().await;
    let queue = event::Queue::new();
    let (files, mut writer) = lab.writer(ALL);
    (0..5).for_each(|number| writer.step(&step(number, &queue)));
    writer.sync();
    (5..9).for_each(|number| writer.step(&step(number, &queue)));
    std::mem::forget(writer);
    // Left by a salvage that was killed at an earlier start.
    fs::write(files.salvaged().with_extension("salvaged.77-0.partial"), b"half").unwrap();
    // A torn tail, as a disk may leave it.
    fs::File::options().append(true).open(files.recording()).unwrap().write_all(&[0; 5000]).unwrap();
    lab.start_again().await;
    let episodes = lab.episodes().await;
    assert_eq!((episodes.len(), episodes[0].steps, episodes[0].outcome), (1, 5, Outcome::Unknown));
    let path = lab.fixture.config.data_dir.join("blobs");
    let recording = episodes[0].recording.as_str();
    let reading = read_episode(&path.join(&recording[..2]).join(&recording[2..]), &lab.fixture.task.spec).unwrap();
    assert!(reading.report.findings.iter().all(|finding| finding.severity == Severity::Note), "a whole file");
    assert!(lab.left().is_empty(), "{:?}", lab.left());
}

/// Killed anywhere between the end of the recording and the end of storing it: one episode, with its outcome.
#[tokio::test]
async fn storing_twice_yields_one_episode() {
    let mut lab = Lab::new().await;
    let queue = event::Queue::new();
    let (files, mut writer) = lab.writer(ALL);
    (0..5).for_each(|number| writer.step(&step(number, &queue)));
    assert!(writer.end(&Ending { outcome: Outcome::Success, ..broken_off() }).unwrap());
    let copies =
        [files.recording(), files.recording().with_extension("json")].map(|path| (fs::read(&path).unwrap(), path));
    let first = lab.rollouts.keep(&files).await.unwrap().unwrap();
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
async fn unusable_recordings_are_set_aside() {
    let mut lab = Lab::new().await;
    let (files, writer) = lab.writer(ALL);
    drop(writer);
    let sidecar = RolloutSidecar { session: lab.session(), outcome: Outcome::Unknown, steps: None };
    files.write(&sidecar).unwrap();
    fs::write(files.recording(), b"not a recording at all").unwrap();
    // An empty recording, one without a sidecar, and one whose sidecar cannot be parsed.
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
    let session = files.recording().file_name().unwrap().to_owned();
    let stray: [std::ffi::OsString; 3] = ["ses_spoilt.json", "ses_spoilt.mcap", "ses_stray.mcap"].map(Into::into);
    assert_eq!(aside[1..], [&[session][..], &stray].concat(), "each with its sidecar, if there is one");
    assert!(aside[0].to_str().unwrap().ends_with(".json"), "{aside:?}");
    assert_eq!(fs::read_dir(&folder).unwrap().count(), 1, "set-aside files are not read again");
    let mut recorder = lab.begin();
    drive(&mut recorder, 3);
    assert!(recorder.finish(Outcome::Success, "closed", ObservationCounts::default()).await.unwrap().is_some());
}

/// A link to itself stands for a disk that fails to respond.
#[tokio::test]
async fn a_recording_that_cannot_be_read_now_is_not_removed() {
    let mut lab = Lab::new().await;
    let queue = event::Queue::new();
    let (files, mut writer) = lab.writer(ALL);
    (0..5).for_each(|number| writer.step(&step(number, &queue)));
    assert!(writer.end(&broken_off()).unwrap());
    let (path, aside) = (files.recording(), lab.fixture.config.data_dir.join("aside"));
    fs::rename(&path, &aside).unwrap();
    std::os::unix::fs::symlink(&path, &path).unwrap();
    lab.start_again().await;
    assert!(fs::symlink_metadata(&path).is_ok() && lab.episodes().await.is_empty());
    fs::rename(&aside, &path).unwrap();
    lab.start_again().await;
    assert_eq!(lab.episodes().await[0].steps, 5, "its sidecar stayed");
}

/// All queued events.
fn drain(events: &mut UnboundedReceiver<Event>) -> Vec<Event> {
    std::iter::from_fn(|| events.try_recv().ok()).collect()
}

#[tokio::test]
async fn a_slow_disk_costs_steps_and_never_a_wait() {
    let (events, mut received) = mpsc::unbounded_channel();
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
    let written = drain(&mut received);
    assert_eq!(written.len(), 3, "the fourth was left out, but completed the action of the third");
    drop(written);
    recorder.observed(&image(6));
    recorder.observed(&image(7));
    drop(recorder.end(Outcome::Unknown, "closed", ObservationCounts::default()));
    let events = drain(&mut received);
    let stamps: Vec<_> = events
        .iter()
        .filter_map(|event| if let Event::Step(step) = event { Some(step.observation.stamp_ns) } else { None })
        .collect();
    assert_eq!(stamps, [seen(6).stamp_ns, seen(7).stamp_ns]);
    let Some(Event::End(ending, _)) = events.last() else { panic!("not ended") };
    assert_eq!(ending.left_out, 3);
}
