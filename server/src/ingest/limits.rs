//! Checks of what a client declares about a recording, before its first byte: its size, what its own summary states, and
//! the room of the disk beside the uploads that are on their way. A declaration may be wrong; the inspection decides.

use gleaner_inspector::most_written;
use gleaner_recording::{InspectionEstimate, MAX_MESSAGES, RecordingSummary, TaskSpec, estimate};

use super::Ingest;
use crate::{
    domain::episode::NewUpload,
    error::{Error, Result},
    file_limit::largest_file,
};

impl Ingest {
    /// Whether a recording of this size may be stored here at all.
    ///
    /// # Errors
    /// Exhausted names the limit and its value.
    pub(super) fn within_limits(&self, field: &str, size_bytes: u64) -> Result<()> {
        let most = self.max_upload_bytes;
        if size_bytes > most {
            return Err(Error::exhausted(format!(
                "{field}: {size_bytes} is above this server's limit of {most} bytes a recording (--max-upload-bytes): \
                 split the recording, or raise the limit at the server"
            )));
        }
        match largest_file().filter(|most| size_bytes > *most) {
            Some(most) => Err(Error::exhausted(format!(
                "{field}: {size_bytes} is above the file size limit of the server's process, {most} bytes: raise it there \
                 (`ulimit -f`, LimitFSIZE= of its service), then push the file again"
            ))),
            None => Ok(()),
        }
    }

    /// Whether a recording with this declaration may be stored here. Returns what its inspection takes, if the declaration
    /// has a summary.
    ///
    /// # Errors
    /// Exhausted names the limit, its value and the declared number.
    pub(super) async fn within_declared_limits(&self, new: &NewUpload) -> Result<Option<InspectionEstimate>> {
        self.within_limits("size_bytes", new.size_bytes)?;
        let Some(summary) = &new.summary else { return Ok(None) };
        let task = self.store.task_by_id(&new.task_id).await?.spec;
        self.content_fits("summary", (summary, new.size_bytes), &task).map(Some)
    }

    /// Whether a recording of this size with this summary, which `field` declares, can be inspected here. Returns what its
    /// inspection takes.
    ///
    /// # Errors
    /// Exhausted names the limit, its value and the declared number.
    pub(super) fn content_fits(
        &self,
        field: &str,
        (summary, size_bytes): (&RecordingSummary, u64),
        task: &TaskSpec,
    ) -> Result<InspectionEstimate> {
        self.within_content_limits(field, summary)?;
        messages_fit(field, summary, task)?;
        let estimate = estimate(summary, task);
        let memory = self.inspector.memory_bytes;
        let length = format!("{} s with {} steps", summary.duration_ns / 1_000_000_000, estimate.steps);
        if estimate.least_memory_bytes > memory {
            return Err(Error::exhausted(format!(
                "{field}: reading {length} takes at least {} bytes of memory, and an inspection has {memory} \
                 (--inspect-memory-bytes): record shorter episodes, or raise the limit at the server",
                estimate.least_memory_bytes
            )));
        }
        let most = most_written(memory, size_bytes);
        if estimate.least_decoded_bytes > most {
            return Err(Error::exhausted(format!(
                "{field}: the decoded images of {length} take at least {} bytes, and an inspection may write {most} \
                 (--inspect-memory-bytes, and 16 times the recording): record shorter episodes or smaller images, or \
                 raise the limit at the server",
                estimate.least_decoded_bytes
            )));
        }
        Ok(estimate)
    }

    /// Whether the reader accepts this many messages, channels and bytes in a chunk.
    fn within_content_limits(&self, declared: &str, summary: &RecordingSummary) -> Result<()> {
        let limits = self.inspector.limits.limits();
        let channels = limits.channels as u64;
        let topics = summary.topics.len() as u64;
        let longest = summary.topics.keys().map(String::len).max().unwrap_or_default();
        for (field, stated, what, most, flag, remedy) in [
            ("messages", summary.messages, "messages", limits.records, "--max-records", "split the recording"),
            ("channels", summary.channels, "channels", channels, "--max-channels", "record fewer topics"),
            ("schemas", summary.schemas, "schemas", channels, "--max-channels", "record fewer topics"),
            ("topics", topics, "topics", channels, "--max-channels", "record fewer topics"),
            (
                "topics",
                longest as u64,
                "bytes in a topic's name",
                limits.name_bytes as u64,
                "--max-name-bytes",
                "record it under a shorter name",
            ),
            (
                "largest_chunk_bytes",
                summary.largest_chunk_bytes,
                "bytes in a chunk",
                limits.chunk_bytes as u64,
                "--max-chunk-bytes",
                "record smaller chunks",
            ),
        ] {
            if stated > most {
                return Err(Error::exhausted(format!(
                    "{declared}.{field}: the recording states {stated} {what}, and this server reads at most {most} ({flag}): \
                     {remedy}, or raise the limit at the server"
                )));
            }
        }
        Ok(())
    }

    /// Makes room for a recording of this size beside the bytes that active uploads still have to send.
    ///
    /// # Errors
    /// Exhausted when too little would stay free.
    pub(super) async fn make_room_for_upload(&self, size_bytes: u64) -> Result<()> {
        let uploads = self.store.uploads().await?;
        let active = uploads.iter().filter(|upload| !self.claims.is_idle(&upload.id));
        let coming: u64 = active.map(|upload| upload.size_bytes - upload.committed.min(upload.size_bytes)).sum();
        self.blobs.room_for(size_bytes.saturating_add(coming)).await.map_err(|error| match coming {
            0 => error,
            _ => Error::exhausted(format!("{}; uploads in progress are to take {coming} of them", error.message())),
        })
    }
}

/// Whether the reader accepts this many messages of the topics that the task reads.
fn messages_fit(field: &str, summary: &RecordingSummary, task: &TaskSpec) -> Result<()> {
    let read = |topic: &str| task.mappings.iter().any(|mapping| mapping.topics(task).contains(topic));
    match summary.topics.iter().find(|(topic, count)| **count > MAX_MESSAGES as u64 && read(topic)) {
        Some((topic, count)) => Err(Error::exhausted(format!(
            "{field}.topics: the recording states {count} messages of {topic}, and {MAX_MESSAGES} of a topic are read at \
             most: split the recording"
        ))),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests;
