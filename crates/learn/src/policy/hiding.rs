//! The past that a policy does not see: how often training hides it, and what is hidden of it. Serving hides the same.
//! Independent of the kind of policy.

use gleaner_core::Words as _;
use gleaner_core::schema::number_in;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use tch::Tensor;

use crate::batch::Windows;

gleaner_core::words! {
    /// What is hidden of a history.
    pub(super) enum HiddenHistory {
        /// All of the steps before the newest: the policy acts on the newest step alone.
        Steps = "steps",
        /// Only the past actions. The policy sees its past observations; past actions are the input that is easiest to copy.
        Actions = "actions",
    }
}

gleaner_core::settings! {
    /// Settings of a policy that sees its history.
    #[derive(Copy)]
    pub(super) struct HistorySpec {
        /// Probability of hiding the history of a training window (0: never). A policy that always sees its history
        /// tends to continue it, which predicts an expert's next action well and fails in closed loop.
        pub(super) history_dropout: f64 = 0.5, number_in(0.0, 1.0);
        /// What is hidden of a history, in training and in a deployment with `hide_history`.
        pub(super) hidden_history: HiddenHistory = HiddenHistory::Steps, HiddenHistory::shape();
    }
}

impl HistorySpec {
    /// Of a policy whose history is never hidden, or that has none.
    pub(super) const SHOWN: Self = Self { history_dropout: 0.0, hidden_history: HiddenHistory::Steps };

    /// Whether the history is hidden of every window in training, so that a policy never acts with it either.
    pub(super) fn always_hides(self) -> bool {
        self.history_dropout >= 1.0
    }

    /// Whether all of a hidden step is hidden, so that it need not be read.
    pub(super) fn hides_steps(self) -> bool {
        self.hidden_history == HiddenHistory::Steps
    }

    /// Whether training hides the history of each of `count` windows of `length` steps, by the chance of these settings.
    /// Empty if it hides none ever, or windows have no past.
    pub(super) fn hides(self, length: usize, count: usize, rng: &mut ChaCha8Rng) -> Vec<bool> {
        let count = if length < 2 || self.history_dropout == 0.0 { 0 } else { count };
        (0..count).map(|_| rng.random_bool(self.history_dropout)).collect()
    }

    /// What is hidden of each marked window, `[W, L, 3]`. `None` if no window is marked, or windows have no past.
    pub(super) fn hidden(self, windows: &Windows, marked: &[bool]) -> Option<Tensor> {
        marked.contains(&true).then(|| self.mask(windows, marked)).flatten()
    }

    /// As [`HistorySpec::hidden`], also if no window is marked.
    pub(super) fn mask(self, windows: &Windows, marked: &[bool]) -> Option<Tensor> {
        // o, m and a of a step.
        let elements = match self.hidden_history {
            HiddenHistory::Steps => [true, true, true],
            HiddenHistory::Actions => [false, false, true],
        };
        windows.past_of(marked, elements)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::batch::values;
    use crate::random::{Purpose, generator};

    fn settings(history_dropout: f64, hidden_history: HiddenHistory) -> HistorySpec {
        HistorySpec { history_dropout, hidden_history }
    }

    #[test]
    fn the_past_is_hidden_as_often_as_asked_and_the_newest_step_never() {
        let windows = Windows::in_order(vec![true; 400 * 3], 3, tch::Device::Cpu);
        let mut rng = generator(1, Purpose::Style, 0);
        for (what, of_step) in [(HiddenHistory::Steps, [1.0, 1.0, 1.0]), (HiddenHistory::Actions, [0.0, 0.0, 1.0])] {
            let settings = settings(0.25, what);
            let hidden = settings.mask(&windows, &settings.hides(3, 400, &mut rng)).unwrap();
            assert_eq!(hidden.size(), [400, 3, 3]);
            let each = values(&hidden.to_kind(tch::Kind::Float));
            let whole = [of_step, of_step, [0.0; 3]].concat();
            assert!(each.chunks(9).all(|window| window == whole || window == [0.0; 9]), "a past is hidden as one");
            let count = each.chunks(9).filter(|window| *window == whole).count();
            assert!((70..130).contains(&count), "{count} of 400");
        }
        let steps = HiddenHistory::Steps;
        let rarely = settings(1e-9, steps);
        let rarely = rarely.mask(&windows, &rarely.hides(3, 400, &mut rng)).unwrap();
        assert!(!values(&rarely.to_kind(tch::Kind::Float)).contains(&1.0), "a mask without marks");
        assert!(settings(0.5, steps).hidden(&windows, &[false; 400]).is_none());
        assert!(settings(0.0, steps).hides(3, 400, &mut rng).is_empty());
        let single = Windows::in_order(vec![true; 4], 1, tch::Device::Cpu);
        assert!(settings(1.0, steps).hides(1, 4, &mut rng).is_empty());
        assert!(settings(1.0, steps).mask(&single, &[true; 4]).is_none());
    }
}
