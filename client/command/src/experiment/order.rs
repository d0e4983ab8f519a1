//! Stages as messages of the server's API.

use gleaner_core::proto::to_struct;
use gleaner_core::{Device, Values, Words as _};
use gleaner_proto::v1::evaluate_spec::Subject;
use gleaner_proto::v1::job_spec::Spec;
use gleaner_proto::v1::train_spec::Data;
use gleaner_proto::v1::{EvaluateSpec, PretrainSpec, RoleRule, ScoreSpec, TrainSpec};

use super::cell::RuleSettings;
use super::stage::Work;

/// The input of a stage: the kind of the result, its id, and that of the result it was made of.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Input<'a> {
    pub(crate) kind: &'a str,
    pub(crate) id: &'a str,
    pub(crate) before: Option<&'a str>,
}

/// A stage's job, `None` for the stages without one.
pub(crate) fn job(work: &Work, input: Input<'_>, simulation: &str, device: Device) -> Option<Spec> {
    let id = || input.id.to_owned();
    let on = |settings: &Values| {
        let mut settings = settings.clone();
        settings.insert("device".to_owned(), device.as_str().into());
        settings
    };
    match work {
        Work::Given { .. } | Work::Snapshot { .. } | Work::Marks | Work::Dataset { .. } | Work::Attempts { .. } => None,
        Work::Pretrain { settings } => Some(Spec::Pretrain(PretrainSpec {
            snapshot_id: id(),
            settings: Some(to_struct(&on(settings))),
            ..PretrainSpec::default()
        })),
        Work::Score { settings } => Some(Spec::Score(ScoreSpec {
            encoder_id: id(),
            settings: Some(to_struct(&on(settings))),
            ..ScoreSpec::default()
        })),
        Work::Train { settings } => Some(Spec::Train(TrainSpec {
            data: Some(match input.kind {
                "dataset" => Data::DatasetId(id()),
                "pretrain" => Data::ExpertsOf(id()),
                _ => Data::ExpertsIn(id()),
            }),
            settings: Some(to_struct(&on(settings))),
        })),
        Work::Evaluate { settings } => {
            let mut settings = on(settings);
            settings.insert("simulation".to_owned(), simulation.into());
            let subject = Some(Subject::PolicyId(id()));
            Some(Spec::Evaluate(EvaluateSpec { subject, settings: Some(to_struct(&settings)) }))
        }
    }
}

/// The rule of a snapshot: roles by cohort, since the episodes of an imperfect agent are imperfect even if they succeed.
pub(crate) fn rule(settings: &RuleSettings, experts: &str, imperfect: &[&str]) -> RoleRule {
    let named = || settings.cohorts.clone();
    let all = || imperfect.iter().map(|cohort| (*cohort).to_owned()).collect();
    RoleRule {
        expert_cohorts: vec![experts.to_owned()],
        imperfect_cohorts: if settings.cohorts.is_empty() { all() } else { named() },
        imperfect_per_expert: settings.imperfect_per_expert,
        max_experts: settings.experts,
        seed: settings.seed,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_policy_trains_on_the_input_of_its_stage() {
        let data = |kind: &str| {
            let input = Input { kind, id: "x_1", before: None };
            let work = Work::Train { settings: Values::new() };
            let Some(Spec::Train(spec)) = job(&work, input, "pick_cube", Device::Cuda) else {
                panic!("not a training")
            };
            let settings = gleaner_core::proto::from_struct(spec.settings);
            assert_eq!(settings.get("device"), Some(&"cuda".into()));
            spec.data.unwrap()
        };
        assert_eq!(data("dataset"), Data::DatasetId("x_1".into()));
        assert_eq!(data("pretrain"), Data::ExpertsOf("x_1".into()));
        assert_eq!(data("snapshot"), Data::ExpertsIn("x_1".into()));
    }

    #[test]
    fn an_empty_list_of_cohorts_selects_all() {
        let all = rule(&RuleSettings { experts: 5, ..RuleSettings::default() }, "expert", &["a", "b"]);
        assert_eq!((all.imperfect_cohorts, all.max_experts), (vec!["a".to_owned(), "b".to_owned()], 5));
        assert_eq!(all.expert_cohorts, ["expert"]);
        let one = rule(&RuleSettings { cohorts: vec!["b".into()], ..RuleSettings::default() }, "teleop", &["a", "b"]);
        assert_eq!((one.expert_cohorts, one.imperfect_cohorts), (vec!["teleop".to_owned()], vec!["b".to_owned()]));
    }
}
