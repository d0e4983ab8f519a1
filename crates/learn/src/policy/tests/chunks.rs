//! The actions of a chunk that count: none from the first step on that was not kept, nor beyond the end.

use gleaner_core::ensemble::Execution;
use tch::Tensor;

use super::*;
use crate::batch::{Segments, values};
use crate::checkpoint;
use crate::policy::source::{Source, mean_loss};
use crate::random::{Purpose, generator};

/// The loss of a policy of chunks on the segments 2 … 4 of an episode of ten steps, kept with 6 … 9.
fn chunk_loss(policy: &dyn PolicyModel, trajectory: &Trajectory) -> f32 {
    let kept = [2, 3, 4, 6, 7, 8, 9].map(|step| (step, 1.0)).to_vec();
    let kept = [WeightedSegments { trajectory: trajectory.clone(), steps: kept }];
    let source = Source { data: vec![&kept[0].trajectory], segments: Segments::kept(&kept) };
    let (batch, wanted) = source.collect(&policy.info().form(), &source.segments.all()[..3]).unwrap();
    let mut noise = generator(1, Purpose::Style, 0);
    values(&mean_loss(policy, batch, None, &wanted, &mut noise).0)[0]
}

#[test]
fn actions_after_a_step_that_was_not_kept_change_nothing() {
    let trajectory = toy::episode("failure", 40, 10, false);
    for form in ["act", "act by a transformer", "flow", "flow by a transformer", "diffusion"] {
        let policy = untrained(form, &[&trajectory]);
        let plain = chunk_loss(policy.as_ref(), &trajectory);
        let with =
            |step: usize| chunk_loss(policy.as_ref(), &trajectory.changed(|arrays| arrays.action[2 * step] += 3.0));
        for step in [0, 1, 5, 6, 7] {
            assert_eq!(with(step), plain, "{form}: step {step} is not part of any chunk that counts");
        }
        for step in [2, 3, 4] {
            assert!((with(step) - plain).abs() > 1e-3, "{form}: step {step} counts");
        }
    }
}

#[test]
fn a_chunk_reaches_to_the_end_of_an_expert_episode_and_no_further() {
    let data = [toy::episode("a", 1, 6, true), toy::episode("b", 2, 6, true)];
    let data: Vec<&Trajectory> = data.iter().collect();
    let source = Source { segments: Segments::every(&data), data };
    let policy = untrained("act", &source.data);
    let (batch, wanted) = source.collect(&policy.info().form(), &source.segments.all()[2..6]).unwrap();
    assert_eq!(batch.images[0].size()[0], 4, "no frame of a later action is encoded");
    let counted: Vec<i64> = Vec::try_from(wanted.counted.sum_dim_intlist([1i64].as_slice(), false, None)).unwrap();
    assert_eq!(counted, [4, 3, 2, 1]);
}

#[test]
fn act_ensembles_its_chunks_or_executes_one_after_the_other() {
    let run = |execution: &str, session_execution: Option<Execution>| {
        let mut spec = spec("act", 1);
        spec.policy = spec.policy.with(Family::Policy, "chunk_execution", execution).unwrap();
        spec.policy = spec.policy.with(Family::Policy, "execute_length", 3).unwrap();
        let bytes =
            train_policy(&toy::shape(), Pretrained::default(), &toy::experts(2, 8), &[], &spec, None, &mut Silent)
                .unwrap();
        let policy = Policy::load(&bytes).unwrap();
        let mut session = policy.session(1).executing(session_execution.unwrap_or(policy.execution()));
        let lengths = [0.1, 0.5, 0.9, 0.2].map(|place| {
            let step = Observed { frame: &toy::frame(place, place), proprioception: &[0.5; 3], executed: None };
            policy.advance(&mut [(&mut session, &[step])]).unwrap().remove(0).len()
        });
        (policy.execution(), lengths)
    };
    assert_eq!(run("ensembled", None), (Execution::Ensembled, [4, 4, 4, 4]));
    assert_eq!(run("horizon", None), (Execution::Horizon(3), [4, 3, 2, 4]));
    assert_eq!(run("horizon", Some(Execution::Horizon(1))), (Execution::Horizon(3), [4, 4, 4, 4]));
}

#[test]
fn the_grid_of_act_leaves_its_style_encoder_as_it_is_and_its_embedding_is_bounded() {
    let data = toy::episode("e", 1, 6, true);
    let [embedding, grid] = ["act", GRID].map(|form| untrained(form, &[&data]));
    let style = |policy: &dyn PolicyModel| {
        let parameters = policy.parameters().into_iter().filter(|(name, _)| name.starts_with("policy.style."));
        parameters.map(|(name, parameter)| (name, parameter.size())).collect::<Vec<_>>()
    };
    assert!(style(embedding.as_ref()).len() > 10);
    assert_eq!(style(embedding.as_ref()), style(grid.as_ref()));
    // 64 tokens of 64 values: a session keeps that many of its newest frame.
    assert_eq!((embedding.info().width, grid.info().width), (64, 64 * 64));
    let unused = |(name, _): &(String, Tensor)| name.contains("keypoint") || name.starts_with("policy.image.project");
    assert_eq!(grid.parameters().iter().filter(|parameter| unused(parameter)).count(), 0);
}

/// Headers of the first policies of chunks had none of these settings, whose defaults are others today.
#[test]
fn a_policy_of_an_earlier_version_keeps_its_network_its_prediction_and_its_execution() {
    for form in ["act by a transformer", "flow by a transformer", "diffusion by a transformer"] {
        let spec = spec(form, 2);
        let experts = toy::experts(2, 8);
        let bytes =
            train_policy(&toy::shape(), Pretrained::default(), &experts, &[], &spec, None, &mut Silent).unwrap();
        let (mut info, named) = checkpoint::read(&bytes, CheckpointKind::Policy).unwrap();
        for later in ["chunk_network", "chunk_execution", "prediction"] {
            info.settings.remove(later);
        }
        let named: Vec<_> = named.into_iter().collect();
        let earlier = Policy::load(&checkpoint::write(&info, &named).unwrap()).unwrap();
        let today = Policy::load(&bytes).unwrap();
        assert_eq!(earlier.execution(), today.execution(), "{form}");
        assert_eq!(acted(&earlier, 0.1, 0.1), acted(&today, 0.1, 0.1), "{form}");
        // A setting that the header has is never replaced.
        assert_eq!(earlier.chunk_length(), 4, "{form}");
    }
}
