//! Stages as the server's API takes them.

use gleaner_proto::v1::evaluate_spec::Subject;
use gleaner_proto::v1::job_spec::Spec;
use gleaner_proto::v1::train_spec::Data;
use gleaner_proto::v1::{
    ActSpec, Augmentation, EvaluateSpec, ModalityScale, OptimSpec, PretrainSpec, RoleRule, ScoreSpec, TrainSpec,
};
use gleaner_sim::AgentKind;

use super::cell::{ActSettings, AugmentationSettings, OptimSettings, RuleSettings};
use super::stage::{Selection, Work};
use crate::choice::DeviceWord;
use crate::cmd::what_if;

/// What a stage works on: what kind of result it is, and its id.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Input<'a> {
    pub(crate) kind: &'a str,
    pub(crate) id: &'a str,
}

/// A stage's job, `None` for the stages that are none.
pub(crate) fn job(work: &Work, input: Input<'_>, simulation: &str, device: DeviceWord) -> Option<Spec> {
    match work {
        Work::Snapshot { .. } | Work::Dataset { .. } => None,
        Work::Pretrain { preset, segment_length, objectives, optim, augmentation, seed } => {
            Some(Spec::Pretrain(PretrainSpec {
                snapshot_id: input.id.to_owned(),
                preset: (*preset).into(),
                segment_length: Some(*segment_length),
                optim: Some(optimiser(optim)),
                seed: *seed,
                device: device.into(),
                objectives: objectives.iter().map(|objective| (*objective).into()).collect(),
                augmentation: images(augmentation),
                ..PretrainSpec::default()
            }))
        }
        Work::Score { scorer, similarity, feature_scale, yardstick, normaliser, scale, seed } => {
            Some(Spec::Score(ScoreSpec {
                encoder_id: input.id.to_owned(),
                device: device.into(),
                scorer: (*scorer).into(),
                similarity: (*similarity).into(),
                feature_scale: (*feature_scale).into(),
                yardstick: (*yardstick).into(),
                normaliser: (*normaliser).into(),
                modality_scale: scale.map(|[image, proprioception, action]| ModalityScale {
                    image,
                    proprioception,
                    action,
                }),
                seed: *seed,
                ..ScoreSpec::default()
            }))
        }
        Work::Train { .. } => Some(Spec::Train(training(work, input, device))),
        Work::Evaluate { episodes, max_steps, seed } => Some(Spec::Evaluate(EvaluateSpec {
            subject: Some(Subject::PolicyId(input.id.to_owned())),
            simulation: simulation.to_owned(),
            episodes: Some(*episodes),
            seeds: vec![*seed],
            max_steps: Some(*max_steps),
            device: device.into(),
        })),
    }
}

fn training(work: &Work, input: Input<'_>, device: DeviceWord) -> TrainSpec {
    let Work::Train { policy, from_scratch, act, lambda, history_dropout, optim, augmentation, seed } = work else {
        return TrainSpec::default();
    };
    let id = input.id.to_owned();
    TrainSpec {
        data: Some(match input.kind {
            "dataset" => Data::DatasetId(id),
            "pretrain" => Data::ExpertsOf(id),
            _ => Data::ExpertsIn(id),
        }),
        optim: Some(optimiser(optim)),
        lambda: *lambda,
        history_dropout: *history_dropout,
        seed: *seed,
        device: device.into(),
        policy: (*policy).into(),
        act: act.as_ref().map(chunks),
        augmentation: images(augmentation),
        preset: from_scratch.map(|(preset, _)| preset.into()).unwrap_or_default(),
        segment_length: from_scratch.map(|(_, length)| length),
        ..TrainSpec::default()
    }
}

/// The rule of a snapshot: roles by cohort, since what an imperfect agent did is imperfect even where it succeeded.
pub(crate) fn rule(settings: &RuleSettings, imperfect: &[&str]) -> RoleRule {
    let named = || settings.cohorts.clone();
    let all = || imperfect.iter().map(|cohort| (*cohort).to_owned()).collect();
    RoleRule {
        expert_cohorts: vec![AgentKind::Expert.name().to_owned()],
        imperfect_cohorts: if settings.cohorts.is_empty() { all() } else { named() },
        imperfect_per_expert: settings.imperfect_per_expert,
        max_experts: settings.experts,
        seed: settings.seed,
    }
}

/// A selection as the server takes it.
pub(crate) fn selection(selection: Selection) -> gleaner_proto::v1::Selection {
    match selection {
        Selection::Beta(beta) => what_if::beta(beta),
        Selection::Top(fraction) => what_if::top(fraction),
    }
}

fn optimiser(settings: &OptimSettings) -> OptimSpec {
    let OptimSettings { steps, batch, learning_rate, weight_decay, warmup_steps, clip_norm } = *settings;
    OptimSpec { steps, batch, learning_rate, weight_decay, warmup_steps, clip_norm }
}

fn chunks(settings: &ActSettings) -> ActSpec {
    let ActSettings { chunk_length, kl_weight, latent_size } = *settings;
    ActSpec { chunk_length, kl_weight, latent_size }
}

fn images(settings: &AugmentationSettings) -> Option<Augmentation> {
    let AugmentationSettings { shift_pixels, brightness, contrast } = *settings;
    (*settings != AugmentationSettings::default()).then_some(Augmentation { shift_pixels, brightness, contrast })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::choice::{PolicyWord, PresetWord};
    use gleaner_proto::v1::PolicyKind;

    fn train(policy: PolicyWord, from_scratch: Option<(PresetWord, u32)>) -> Work {
        Work::Train {
            policy,
            from_scratch,
            act: None,
            lambda: Some(0.1),
            history_dropout: None,
            optim: OptimSettings { steps: Some(9), ..OptimSettings::default() },
            augmentation: AugmentationSettings::default(),
            seed: 3,
        }
    }

    #[test]
    fn a_training_is_on_what_its_input_is() {
        let data = |kind| {
            let input = Input { kind, id: "x_1" };
            let spec = job(&train(PolicyWord::Bc, Some((PresetWord::Small, 4))), input, "pick_cube", DeviceWord::Cpu);
            let Some(Spec::Train(spec)) = spec else { panic!("{spec:?}") };
            assert_eq!((spec.policy(), spec.segment_length, spec.seed), (PolicyKind::Bc, Some(4), 3));
            assert_eq!((spec.optim.unwrap().steps, spec.augmentation), (Some(9), None));
            spec.data.unwrap()
        };
        assert_eq!(data("dataset"), Data::DatasetId("x_1".into()));
        assert_eq!(data("pretrain"), Data::ExpertsOf("x_1".into()));
        assert_eq!(data("snapshot"), Data::ExpertsIn("x_1".into()));
    }

    #[test]
    fn no_cohort_named_is_all_of_them() {
        let all = rule(&RuleSettings { experts: 5, ..RuleSettings::default() }, &["a", "b"]);
        assert_eq!((all.imperfect_cohorts, all.max_experts), (vec!["a".to_owned(), "b".to_owned()], 5));
        assert_eq!(all.expert_cohorts, ["expert"]);
        let one = rule(&RuleSettings { cohorts: vec!["b".into()], ..RuleSettings::default() }, &["a", "b"]);
        assert_eq!(one.imperfect_cohorts, ["b"]);
    }
}
