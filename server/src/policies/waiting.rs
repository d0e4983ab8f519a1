//! The one observation of a session that waits for the model, and what the model does not see of those before it.
//! Independent of models.

use std::time::Duration;

use super::pending_reply::PendingReply;
use crate::domain::observation::Observation;

/// A place for the newest observation. One that still waits is passed over: the model will not see it.
#[derive(Debug, Default)]
pub(super) struct Waiting {
    newest: Option<Queued>,
    /// Control steps that were missed while they waited, or never sent, since the newest one taken.
    unseen: u64,
    /// The executed action of the observation right after the newest one taken, if it was passed over.
    after: Option<Vec<f32>>,
}

#[derive(Debug)]
struct Queued {
    observation: Observation,
    reply: PendingReply,
    /// No control step lies between it and the newest one taken.
    follows: bool,
}

/// An observation for the model.
#[derive(Debug)]
pub(super) struct Taken {
    pub(super) observation: Observation,
    pub(super) reply: PendingReply,
    /// Control steps before it that the model will not see, besides those that its reply counts as dropped.
    pub(super) unseen: u64,
    /// The action executed at the observation taken before it, where one that is passed over has it.
    pub(super) after: Option<Vec<f32>>,
}

impl Waiting {
    /// Queues an observation; `otherwise` is its deadline where it has none of its own. Returns whether another one was
    /// passed over.
    pub(super) fn put(&mut self, observation: Observation, otherwise: Option<Duration>) -> bool {
        let dropped = self.pass_over().map(|reply| reply.dropped + 1);
        let follows = self.unseen == 0 && dropped.is_none() && observation.skipped_steps == 0;
        self.unseen += u64::from(observation.skipped_steps);
        let reply = PendingReply::for_observation(&observation, otherwise, dropped.unwrap_or(0));
        self.newest = Some(Queued { observation, reply, follows });
        dropped.is_some()
    }

    pub(super) fn take(&mut self) -> Option<Taken> {
        let Queued { observation, reply, follows: _ } = self.newest.take()?;
        Some(Taken { observation, reply, unseen: std::mem::take(&mut self.unseen), after: self.after.take() })
    }

    /// The reply to the waiting observation.
    pub(super) fn reply(&self) -> Option<&PendingReply> {
        self.newest.as_ref().map(|queued| &queued.reply)
    }

    /// Takes away the waiting observation, whose deadline has passed. It and those dropped for it stay unseen.
    pub(super) fn miss(&mut self) -> Option<PendingReply> {
        let reply = self.pass_over();
        self.unseen += reply.as_ref().map_or(0, |reply| reply.dropped + 1);
        reply
    }

    fn pass_over(&mut self) -> Option<PendingReply> {
        let Queued { observation, reply, follows } = self.newest.take()?;
        if follows {
            self.after = Some(observation.executed_action).filter(|action| !action.is_empty());
        }
        Some(reply)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::policies::testing::observation;

    #[test]
    fn the_first_observation_that_is_passed_over_has_the_action_after_the_one_taken() {
        let mut waiting = Waiting::default();
        let put = |waiting: &mut Waiting, number: u8, skipped_steps| {
            waiting.put(Observation { skipped_steps, ..observation(number, &[f32::from(number)]) }, None)
        };
        assert!(!put(&mut waiting, 1, 0));
        assert_eq!(waiting.take().unwrap().after, None);
        assert!(!put(&mut waiting, 2, 0) && put(&mut waiting, 3, 0) && put(&mut waiting, 4, 1));
        let taken = waiting.take().unwrap();
        assert_eq!((taken.after, taken.unseen, taken.reply.dropped), (Some(vec![2.0]), 1, 2));

        put(&mut waiting, 5, 0);
        assert_eq!(waiting.miss().unwrap().dropped, 0);
        put(&mut waiting, 6, 0);
        put(&mut waiting, 7, 0);
        let taken = waiting.take().unwrap();
        assert_eq!((taken.after, taken.unseen, taken.reply.dropped), (Some(vec![5.0]), 1, 1));

        assert!(!put(&mut waiting, 8, 2) && put(&mut waiting, 9, 0));
        assert_eq!(waiting.take().unwrap().after, None, "two steps lie before the first one");
        put(&mut waiting, 10, 0);
        assert_eq!(waiting.take().unwrap().after, None, "it was not passed over");
        assert!(waiting.take().is_none() && waiting.reply().is_none() && waiting.miss().is_none());
    }
}
