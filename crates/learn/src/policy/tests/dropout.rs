//! Dropped values change the losses of training in every policy, and no loss or action outside of it.

use super::*;

#[test]
fn training_drops_values_in_every_policy_and_validation_does_not() {
    for form in forms() {
        let encoder = (form == "finetune").then(|| encoder(1));
        let run = |dropout: f64| {
            let mut spec = TrainSpec { validation_share: 0.25, dropout, ..spec(form, 2) };
            // No step has an effect, so that the losses are of the same weights.
            spec.optim.learning_rate = 1e-12;
            let (pretrained, mut monitor) =
                (Pretrained { encoder: encoder.as_deref(), ..Pretrained::default() }, Recorder::default());
            let experts = toy::experts(4, 8);
            train_policy(&toy::shape(), pretrained, &experts, &kept(0.9), &spec, None, &mut monitor).unwrap();
            ["loss_expert", "loss_kept", "loss_validation"].map(|name| monitor.metric(name))
        };
        let ([expert, kept, validation], [dropped_expert, dropped_kept, same]) = (run(0.0), run(0.5));
        for (plain, dropped) in [(expert, dropped_expert), (kept, dropped_kept)] {
            let apart = plain.iter().zip(&dropped).all(|(plain, dropped)| (plain - dropped).abs() > 1e-4 * plain);
            assert!(plain.len() == 2 && apart, "{form}: {plain:?} {dropped:?}");
        }
        let near = |(plain, dropped): (&f64, &f64)| (plain - dropped).abs() < 1e-5 * plain;
        assert!(!same.is_empty() && validation.iter().zip(&same).all(near), "{form}: {validation:?} {same:?}");
    }
}
