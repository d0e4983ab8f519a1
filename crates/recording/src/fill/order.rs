//! Messages that are decoded on several threads, and their pictures in the order of the messages.
//!
//! Whatever the number of threads, pictures come in the same order, so a cache has the same bytes. The messages and
//! pictures under way are limited by their memory. Independent of what becomes of a picture.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, SyncSender, channel, sync_channel};
use std::thread::{self, Builder, Scope};

use super::look::{Films, Looking, Message, Pictures};
use crate::channels::Readable;
use crate::error::RecordingError;
use crate::limits::ImageThreads;
use crate::video::Shown;

/// An upper bound of the memory that decoding takes for each recorded pixel: progressive JPEG keeps its coefficients
/// beside the pixels.
const PIXEL_BYTES: usize = 16;
/// That of a task itself and of its place in the line.
const TASK_BYTES: usize = 1 << 10;

/// Receives a picture of a stream.
pub(super) type Show<'a> = &'a mut dyn FnMut(usize, Shown) -> Result<(), RecordingError>;
/// Receives a message.
pub(super) type Give<'a> = &'a mut dyn FnMut(&Message<'_>) -> Result<(), RecordingError>;

/// Decodes the messages that `messages` gives, and hands each picture to `show`, in the order of the messages. `topics` has the streams of each topic.
///
/// # Errors
/// The errors of `messages` and of `show`, and of starting a thread.
pub(super) fn in_order(
    looking: &Looking<'_>,
    threads: ImageThreads,
    topics: &[Vec<usize>],
    messages: impl FnOnce(Give<'_>) -> Result<(), RecordingError>,
    show: Show<'_>,
) -> Result<(), RecordingError> {
    let films = topics.iter().filter(|streams| looking.is_video(streams));
    if threads.count < 2 {
        let mut decoders = Films::default();
        messages(&mut |message| each(looking.look(&mut decoders, message), show))?;
        return films.map(|streams| looking.end(&mut decoders, streams)).try_for_each(|shown| each(shown, show));
    }
    thread::scope(|scope| {
        let mut line = Line::begin(scope, looking, threads)?;
        messages(&mut |message| {
            let task = Task::Look {
                at: message.at,
                streams: message.streams.to_vec(),
                decoder: Arc::clone(message.decoder),
                data: message.data.to_vec(),
            };
            line.give(task, show)
        })?;
        films.map(|streams| Task::End(streams.clone())).try_for_each(|task| line.give(task, show))?;
        line.settle(0, show)
    })
}

fn each(pictures: Pictures, show: Show<'_>) -> Result<(), RecordingError> {
    pictures.into_iter().try_for_each(|(stream, shown)| show(stream, shown))
}

/// What a thread does.
enum Task {
    Look { at: usize, streams: Vec<usize>, decoder: Arc<Readable>, data: Vec<u8> },
    End(Vec<usize>),
}

/// A task, and where its pictures go.
type Order = (Task, SyncSender<Pictures>);

/// The tasks under way, the oldest first.
struct Line<'a> {
    looking: &'a Looking<'a>,
    threads: Vec<Sender<Order>>,
    waiting: VecDeque<(Receiver<Pictures>, usize)>,
    /// Upper bound of the memory of the waiting tasks, and the most that it may be.
    held: usize,
    most: usize,
    /// The thread of the next image.
    next: usize,
}

impl<'a> Line<'a> {
    fn begin<'scope>(
        scope: &'scope Scope<'scope, 'a>,
        looking: &'a Looking<'a>,
        ImageThreads { count, bytes }: ImageThreads,
    ) -> Result<Self, RecordingError> {
        let start = |_| {
            let (give, take) = channel::<Order>();
            let work = move || work(looking, &take);
            let started = Builder::new().name("images".to_owned()).spawn_scoped(scope, work);
            started.map(|_| give).map_err(|source| RecordingError::Io { path: "a thread for images".into(), source })
        };
        let threads = (0..count).map(start).collect::<Result<_, _>>()?;
        Ok(Self { looking, threads, waiting: VecDeque::new(), held: 0, most: bytes, next: 0 })
    }

    /// Begins a task; shows the pictures of the oldest ones until there is room for it.
    fn give(&mut self, task: Task, show: Show<'_>) -> Result<(), RecordingError> {
        let bytes = self.bytes(&task);
        self.settle(self.most.saturating_sub(bytes), show)?;
        let streams = match &task {
            Task::Look { streams, .. } | Task::End(streams) => streams,
        };
        // Pictures of video depend on earlier ones, so a topic of video stays with its thread.
        let at = if self.looking.is_video(streams) { streams[0] } else { self.next };
        self.next += 1;
        let (give, take) = sync_channel(1);
        // A thread that is gone has panicked, which ends the scope with a panic.
        let _gone = self.threads[at % self.threads.len()].send((task, give));
        self.waiting.push_back((take, bytes));
        self.held += bytes;
        Ok(())
    }

    /// Shows the pictures of the oldest tasks until the others take at most `most` bytes.
    fn settle(&mut self, most: usize, show: Show<'_>) -> Result<(), RecordingError> {
        while self.held > most || (most == 0 && !self.waiting.is_empty()) {
            let Some((pictures, bytes)) = self.waiting.pop_front() else { break };
            self.held -= bytes;
            each(pictures.recv().unwrap_or_default(), show)?;
        }
        Ok(())
    }

    /// Upper bound of the memory of a task.
    fn bytes(&self, task: &Task) -> usize {
        let Task::Look { streams, data, .. } = task else { return TASK_BYTES };
        let pixels = |&stream: &usize| {
            let (height, width) = self.looking.spec.cameras[self.looking.images[stream].camera].sizes().recorded();
            height as usize * width as usize * PIXEL_BYTES
        };
        streams.iter().map(pixels).sum::<usize>() + data.len() + TASK_BYTES
    }
}

/// One thread: its tasks in their order.
fn work(looking: &Looking<'_>, tasks: &Receiver<Order>) {
    let mut films = Films::default();
    while let Ok((task, done)) = tasks.recv() {
        let shown = match &task {
            Task::Look { at, streams, decoder, data } => {
                looking.look(&mut films, &Message { at: *at, streams, decoder, data })
            }
            Task::End(streams) => looking.end(&mut films, streams),
        };
        // The other end is gone once an error ended the pass.
        let _ended = done.send(shown);
    }
}
