//! The segments of a dataset as a stream: made one by one as the caller reads, one episode open at a time.

use std::sync::Arc;

use futures::{Stream, stream};
use gleaner_proto::v1;
use gleaner_recording::TaskSpec;

use super::Services;
use crate::{
    domain::{dataset::DatasetContents, id::EpisodeId, snapshot::Role},
    error::{Error, Result},
    ingest::Frames,
    wire::{self, dataset::SegmentsRequest},
};

/// One episode's part of the stream.
struct Part {
    episode: EpisodeId,
    role: Role,
    /// End step and weight of each segment; `None` for every step with weight 1.
    ends: Option<Vec<(u32, f32)>>,
}

/// An episode that is being streamed.
struct Open {
    part: Part,
    ends: std::vec::IntoIter<(u32, f32)>,
    proprioception: Arc<[f32]>,
    action: Arc<[f32]>,
    frames: Frames,
}

/// Where a stream stands.
struct Walk {
    services: Services,
    spec: TaskSpec,
    /// l: a segment is the window of l + 1 steps that ends at its step.
    length: u32,
    include_frames: bool,
    parts: std::vec::IntoIter<Part>,
    open: Option<Open>,
}

/// Begins the stream of a dataset's segments: experts first, then the kept ones, each episode by end step.
///
/// # Errors
/// NotFound; Precondition when the score run is not finished.
pub(super) async fn segments(
    services: &Services,
    request: SegmentsRequest,
) -> Result<impl Stream<Item = Result<v1::Segment>> + Send + use<>> {
    let contents = services.store.dataset_contents(&request.dataset_id).await?;
    services.store.expect_recordings(&contents.snapshot_id).await?;
    let walk = Walk {
        services: services.clone(),
        spec: services.store.task_by_id(&contents.dataset.task_id).await?.spec,
        length: services.store.segment_length(contents.run.origin.encoder_id()).await?,
        include_frames: request.include_frames,
        parts: parts(contents, request.kept_only).into_iter(),
        open: None,
    };
    Ok(stream::try_unfold(walk, |mut walk| async move { Ok(walk.next().await?.map(|segment| (segment, walk))) }))
}

fn parts(contents: DatasetContents, kept_only: bool) -> Vec<Part> {
    let experts = contents.experts.into_iter().filter(|_| !kept_only);
    let experts = experts.map(|episode| Part { episode, role: Role::Expert, ends: None });
    let kept = contents.kept.into_iter().map(|kept| Part {
        episode: kept.episode_id,
        role: Role::Imperfect,
        ends: Some(kept.segments.iter().map(|segment| (segment.end_step, segment.weight)).collect()),
    });
    experts.chain(kept).collect()
}

impl Walk {
    async fn next(&mut self) -> Result<Option<v1::Segment>> {
        loop {
            if let Some(open) = &mut self.open
                && let Some((end, weight)) = open.ends.next()
            {
                return self.segment(end, weight).await.map(Some);
            }
            let Some(part) = self.parts.next() else { return Ok(None) };
            self.open = Some(self.begin(part).await?);
        }
    }

    async fn begin(&self, mut part: Part) -> Result<Open> {
        let (_, recording) = self.services.store.recording_of(&part.episode).await?;
        let frames = self.services.ingest.frames(&self.spec, &recording).await?;
        let numbers = frames.numbers(0..frames.steps()).await?;
        let steps = u32::try_from(frames.steps()).map_err(|error| Error::internal("streaming segments", error))?;
        let ends = part.ends.take().unwrap_or_else(|| (0..steps).map(|end| (end, 1.0)).collect());
        Ok(Open {
            part,
            ends: ends.into_iter(),
            proprioception: numbers.proprioception.into(),
            action: numbers.action.into(),
            frames,
        })
    }

    async fn segment(&self, end: u32, weight: f32) -> Result<v1::Segment> {
        let torn = || Error::internal("streaming segments", "the episode has fewer steps than its scores");
        let open = self.open.as_ref().ok_or_else(torn)?;
        let first = end.saturating_sub(self.length);
        let rows =
            |values: &[f32], width: usize| range(first, end, width).and_then(|at| Some(values.get(at)?.to_vec()));
        let proprioception = rows(&open.proprioception, self.spec.proprioception_size()).ok_or_else(torn)?;
        let action = rows(&open.action, self.spec.action_size()).ok_or_else(torn)?;
        let frames = if self.include_frames {
            open.frames.images(range(first, end, 1).ok_or_else(torn)?).await?
        } else {
            Vec::new()
        };
        Ok(v1::Segment {
            episode_id: open.part.episode.to_string(),
            first_step: first,
            end_step: end,
            role: wire::snapshot::role_to_proto(open.part.role).into(),
            weight,
            proprioception,
            action,
            frames,
        })
    }
}

/// Where the rows of steps `first` to `end`, both inclusive, lie in a row-major array.
fn range(first: u32, end: u32, width: usize) -> Option<std::ops::Range<usize>> {
    let (first, end) = (usize::try_from(first).ok()?, usize::try_from(end).ok()?);
    Some(first.checked_mul(width)?..end.checked_add(1)?.checked_mul(width)?)
}
