//! The steps: the clock's ticks from the first at which every stream has begun, and what each picks.

use super::streams::Stream;
use crate::align::{Rule, Timeline};
use gleaner_core::{FieldSpec, TaskSpec};

/// The steps of one recording.
pub(crate) struct Steps<'a> {
    pub(crate) clock: Timeline,
    /// Positions in the clock.
    pub(crate) ticks: Vec<usize>,
    pub(crate) stamps: Vec<i64>,
    pub(crate) rule: Rule,
    pub(crate) streams: Vec<Stream<'a>>,
    /// For each stream, the position in its timeline that each step picks.
    pub(crate) picks: Vec<Vec<usize>>,
}

impl<'a> Steps<'a> {
    pub(crate) fn new(spec: &TaskSpec, clock: Timeline, streams: Vec<Stream<'a>>) -> Self {
        let rule = Rule::new(spec);
        let mut ticks = clock.ticks(rule);
        // Once a stream has begun it stays so, so the first tick that has all of them decides.
        let begun =
            |tick: &usize| streams.iter().all(|stream| rule.pick(&stream.timeline, clock.stamps[*tick]).is_some());
        let first = ticks.iter().position(begun).unwrap_or(ticks.len());
        ticks.drain(..first);
        let stamps: Vec<i64> = ticks.iter().map(|&tick| clock.stamps[tick]).collect();
        let pick =
            |stream: &Stream<'_>| stamps.iter().filter_map(|&stamp| rule.pick(&stream.timeline, stamp)).collect();
        let picks = streams.iter().map(pick).collect();
        Self { clock, ticks, stamps, rule, streams, picks }
    }

    /// The fields' values of each step, one field after the other, row-major.
    pub(crate) fn gather(&self, fields: &[FieldSpec]) -> Vec<f32> {
        let of_field =
            |field: &FieldSpec| self.streams.iter().zip(&self.picks).find(|(stream, _)| stream.is_field(&field.name));
        let columns: Vec<_> = fields.iter().filter_map(of_field).collect();
        let mut out = Vec::new();
        for step in 0..self.stamps.len() {
            for (stream, picks) in &columns {
                out.extend_from_slice(stream.values(picks[step]));
            }
        }
        out
    }
}
