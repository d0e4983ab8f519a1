//! The layout of windows over steps: the required steps, once each, and the step of every place of every window. Places
//! before the episode are padding. A window whose past is hidden requires its newest step alone.

use std::collections::HashMap;

use tch::{Device, Tensor};

use super::{Segment, int};
use crate::device::send;

/// The layout of W windows over N steps, as plain values.
pub(super) struct Places {
    /// The step of each place, row-major.
    index: Vec<i64>,
    /// Whether each place is inside its episode, row-major.
    pub(super) valid_places: Vec<bool>,
    /// The (episode, step) of the N steps.
    pub(super) steps: Vec<(usize, usize)>,
}

/// Layout of W windows of L steps over N steps.
pub(crate) struct Windows {
    /// `[W * L]` of `i64`, indices into the N steps; a padded place has the index of its episode's first step, and a
    /// hidden one that of its window's newest step, whose content must not be read there.
    pub(crate) index: Tensor,
    /// `[W, L]` of `bool`: whether the place is inside the episode.
    pub(crate) valid: Tensor,
    /// The same as plain values, row-major.
    pub(crate) valid_places: Vec<bool>,
    /// L.
    pub(crate) length: usize,
}

impl Windows {
    /// Lays out `segments` of `length` steps; also returns the (episode, step) of the N steps.
    pub(crate) fn lay_out(segments: &[Segment], length: usize, device: Device) -> (Self, Vec<(usize, usize)>) {
        Self::from_places(Self::places(segments, &[], length), length, device)
    }

    pub(super) fn from_places(places: Places, length: usize, device: Device) -> (Self, Vec<(usize, usize)>) {
        let Places { index, valid_places, steps } = places;
        let windows = Self {
            index: send(&Tensor::from_slice(&index), device),
            valid: Self::grid(&valid_places, &[-1, int(length)], device),
            valid_places,
            length,
        };
        (windows, steps)
    }

    /// Lays out `segments` of `length` steps; the past of those that are marked `alone` is hidden (empty: of none).
    pub(super) fn places(segments: &[Segment], alone: &[bool], length: usize) -> Places {
        let mut steps = Vec::new();
        let mut places: HashMap<(usize, usize), i64> = HashMap::new();
        let mut index = Vec::with_capacity(segments.len() * length);
        let mut valid_places = Vec::with_capacity(segments.len() * length);
        for (number, segment) in segments.iter().enumerate() {
            let alone = alone.get(number).is_some_and(|alone| *alone);
            for place in 0..length {
                let inside = segment.step + place + 1 >= length;
                let step = if alone { segment.step } else { (segment.step + place + 1).saturating_sub(length) };
                let key = (segment.trajectory, step);
                let at = *places.entry(key).or_insert_with(|| {
                    steps.push(key);
                    int(steps.len() - 1)
                });
                index.push(at);
                valid_places.push(inside);
            }
        }
        Places { index, valid_places, steps }
    }

    /// The layout of `count` windows of `length` steps whose steps are in sequence.
    pub(crate) fn in_order(valid_places: Vec<bool>, length: usize, device: Device) -> Self {
        let index: Vec<i64> = (0..valid_places.len()).map(int).collect();
        Self {
            index: send(&Tensor::from_slice(&index), device),
            valid: Self::grid(&valid_places, &[-1, int(length)], device),
            valid_places,
            length,
        }
    }

    /// The indices of the last `keep` places of each window, `[W * keep]`.
    pub(crate) fn newest(&self, keep: usize) -> Tensor {
        let (length, keep) = (int(self.length), int(keep));
        self.index.view([-1, length]).narrow(1, length - keep, keep).flatten(0, 1)
    }

    /// These elements of a step (o, m, a) in all steps but the last of each marked window, `[W, L, 3]`; `None` when
    /// windows have a single step.
    pub(crate) fn past_of(&self, marked: &[bool], elements: [bool; 3]) -> Option<Tensor> {
        if self.length < 2 {
            return None;
        }
        let past = self.length - 1;
        let window = |marked: &bool| {
            let marked = *marked;
            let of_step = move |step: usize| elements.map(|element| marked && element && step < past);
            (0..self.length).flat_map(of_step)
        };
        let hidden: Vec<bool> = marked.iter().flat_map(window).collect();
        Some(Self::grid(&hidden, &[int(marked.len()), int(self.length), 3], self.valid.device()))
    }

    /// Truth values as a tensor of `size`.
    pub(crate) fn grid(values: &[bool], size: &[i64], device: Device) -> Tensor {
        send(&Tensor::from_slice(values).view(size), device)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn end(step: usize) -> Segment {
        Segment { trajectory: 7, step, weight: 1.0 }
    }

    #[test]
    fn shared_steps_are_laid_out_once_and_early_places_are_padding() {
        let (windows, steps) = Windows::lay_out(&[end(0), end(1), end(2)], 3, Device::Cpu);
        assert_eq!(steps, vec![(7, 0), (7, 1), (7, 2)]);
        let index = Vec::<i64>::try_from(&windows.index).unwrap();
        assert_eq!(index, vec![0, 0, 0, 0, 0, 1, 0, 1, 2]);
        let valid = vec![false, false, true, false, true, true, true, true, true];
        assert_eq!(windows.valid_places, valid);
    }

    #[test]
    fn a_hidden_past_requires_no_step_and_keeps_its_padding() {
        let segments = [end(1), end(9)];
        let steps = |alone: &[bool]| Windows::places(&segments, alone, 3).steps;
        assert_eq!(steps(&[]), [(7, 0), (7, 1), (7, 7), (7, 8), (7, 9)]);
        assert_eq!(steps(&[true, false]), [(7, 1), (7, 7), (7, 8), (7, 9)]);
        let hidden = Windows::places(&segments, &[true, true], 3);
        assert_eq!(hidden.steps, [(7, 1), (7, 9)]);
        assert_eq!(hidden.index, [0, 0, 0, 1, 1, 1]);
        assert_eq!(hidden.valid_places, Windows::places(&segments, &[], 3).valid_places);
    }

    #[test]
    fn a_stretch_needs_only_its_length_plus_the_history() {
        let ends: Vec<Segment> = (20..28).map(end).collect();
        let (_, steps) = Windows::lay_out(&ends, 7, Device::Cpu);
        assert_eq!(steps.len(), 8 + 6);
    }
}
