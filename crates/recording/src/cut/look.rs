//! The first look at a recording that is cut: its times, what marks its episodes, and whether it can be cut at all.

use std::collections::BTreeSet;
use std::path::Path;

use super::declared::Declared;
use super::event::Event;
use crate::channels::Channels;
use crate::container::{Ending, Record, Scanned, scan};
use crate::error::RecordingError;
use crate::limits::Limits;

/// Most episodes of a recording.
const MOST_EPISODES: usize = 100_000;

/// What a look finds.
#[derive(Debug, Default)]
pub(super) struct Look {
    /// The log times of the first and last message.
    pub(super) times: Option<(u64, u64)>,
    /// Whether the file ends in the middle.
    pub(super) is_cut_off: bool,
    /// The messages of the topic, by their log times.
    pub(super) events: Vec<(u64, Event)>,
    /// The topics that there are.
    pub(super) topics: Vec<String>,
    /// The channels that have messages before their declaration, and all schemas if there are such channels.
    pub(super) late: Vec<Declared>,
}

impl Look {
    /// Looks at every message, and at the content of those of `topic`.
    ///
    /// # Errors
    /// [`RecordingError::Damaged`] if parts of the recording are lost: its episodes would not show it.
    /// [`RecordingError::Field`] for a message of the topic that cannot be decoded, or if there are too many; the errors
    /// of reading the recording.
    pub(super) fn at(path: &Path, topic: Option<&str>, limits: &Limits) -> Result<Self, RecordingError> {
        let mut channels = Channels::new(limits);
        let look = Self::pass(path, topic, (limits, &BTreeSet::new()), &mut channels)?;
        let undeclared = channels.undeclared();
        if let Some((channel, ..)) = undeclared.iter().find(|(.., topic)| topic.is_none()) {
            let problem = format!("no record declares channel {channel} of a message; copy the file again");
            return Err(RecordingError::Damaged { problem });
        }
        if undeclared.is_empty() {
            return Ok(look);
        }
        // Every channel is declared from the first message on now.
        channels.rewind();
        let late = undeclared.iter().map(|(channel, ..)| *channel).collect();
        Self::pass(path, topic, (limits, &late), &mut channels)
    }

    fn pass(
        path: &Path,
        topic: Option<&str>,
        (limits, late): (&Limits, &BTreeSet<u16>),
        channels: &mut Channels,
    ) -> Result<Self, RecordingError> {
        let (mut look, mut late_channels) = (Self::default(), Vec::new());
        let scanned = scan(path, limits, &mut |record| {
            if let Record::Message { header, data } = record {
                return look.message((header.channel_id, header.log_time), data, topic, channels);
            }
            if matches!(record, Record::Schema { .. }) && !late.is_empty() {
                look.late.extend(Declared::of(&record));
            }
            if matches!(record, Record::Channel { id, .. } if late.contains(&id)) {
                late_channels.extend(Declared::of(&record));
            }
            channels.declare(&record, &|known| Some(known) == topic)
        })?;
        check_complete(&scanned)?;
        look.is_cut_off = scanned.ending == Ending::Cut;
        look.topics = channels.topics().iter().map(|known| known.topic.clone()).collect();
        // A channel names its schema.
        look.late.append(&mut late_channels);
        Ok(look)
    }

    fn message(
        &mut self,
        (channel, time): (u16, u64),
        data: &[u8],
        topic: Option<&str>,
        channels: &mut Channels,
    ) -> Result<(), RecordingError> {
        let (first, last) = self.times.unwrap_or((time, time));
        self.times = Some((first.min(time), last.max(time)));
        let Some((found, _, decoder)) = channels.next(channel) else { return Ok(()) };
        let Some(topic) = topic.filter(|topic| *topic == found) else { return Ok(()) };
        let wrong = |problem: String| RecordingError::Field { topic: topic.to_owned(), path: "-".to_owned(), problem };
        let event = match decoder.as_ref() {
            Ok(decoder) => decoder.decode(data).map(|value| Event::of(&value)).map_err(&wrong)?,
            // A message that cannot be read still marks a moment.
            Err(_) => Event::Begin,
        };
        self.events.push((time, event));
        if self.events.len() > MOST_EPISODES {
            return Err(wrong(format!(
                "it has more than {MOST_EPISODES} messages; mark episodes on a topic of their own"
            )));
        }
        Ok(())
    }
}

/// Lost or contradictory parts would not be seen in the episodes. The end alone may be missing: the last episode shows it.
fn check_complete(scanned: &Scanned) -> Result<(), RecordingError> {
    let Some(problem) = scanned.problems.first() else { return Ok(()) };
    let problem = format!("{}: {}; recover it with `mcap recover` before it is cut", problem.subject, problem.detail);
    Err(RecordingError::Damaged { problem })
}
