//! Evaluations on the wire.

use gleaner_proto::v1;

use super::{field, page};
use crate::{
    error::{Error, Result},
    evaluation::{Evaluation, SeedResult, Success},
    id::{EvaluationId, PolicyId},
    page::Page,
};

/// Longest name of a simulation, in characters.
const LONGEST_SIMULATION: usize = 200;
/// Most seeds of one evaluation.
const MAX_SEEDS: usize = 10_000;

/// Reads a policy's id.
pub fn policy_id(text: &str) -> Result<PolicyId> {
    PolicyId::parse("policy_id", text)
}

/// Reads an evaluation's id.
pub fn evaluation_id(text: &str) -> Result<EvaluationId> {
    EvaluationId::parse("evaluation_id", text)
}

/// The policy, and the page of its evaluations.
///
/// # Errors
/// Invalid names the field.
pub fn list_request(request: v1::ListEvaluationsRequest) -> Result<(PolicyId, Page<EvaluationId>)> {
    let v1::ListEvaluationsRequest { policy_id: policy, page_size, page_token } = request;
    Ok((policy_id(&policy)?, page::page_by_id(page_size, &page_token)?))
}

/// The policy, the name of the simulation, and the results of each seed.
///
/// # Errors
/// Invalid names the field and the remedy.
pub fn report_request(request: v1::ReportEvaluationRequest) -> Result<(PolicyId, String, Vec<SeedResult>)> {
    let v1::ReportEvaluationRequest { policy_id: policy, simulation, seeds } = request;
    let policy = policy_id(&policy)?;
    let length = simulation.chars().count();
    if length == 0 || length > LONGEST_SIMULATION || simulation.chars().any(char::is_control) {
        return Err(Error::invalid(
            "simulation",
            format!("must be a name of 1 to {LONGEST_SIMULATION} characters, such as metaworld/pick-place-v3"),
        ));
    }
    Ok((policy, simulation, seeds_from_proto("seeds", seeds)?))
}

/// Reads the results of each seed.
///
/// # Errors
/// Invalid when there is no trial, a seed is duplicated, or the counts contradict each other.
pub fn seeds_from_proto(at: &str, seeds: Vec<v1::SeedResult>) -> Result<Vec<SeedResult>> {
    if seeds.is_empty() || seeds.len() > MAX_SEEDS {
        return Err(Error::invalid(at, format!("are {}, must be between 1 and {MAX_SEEDS}", seeds.len())));
    }
    let mut total: u32 = 0;
    let mut read: Vec<SeedResult> = Vec::with_capacity(seeds.len());
    for (place, v1::SeedResult { seed, episodes, successes, mean_steps }) in seeds.into_iter().enumerate() {
        let wrong = |name: &str, fix: String| Error::invalid(&format!("{at}[{place}].{name}"), fix);
        if episodes == 0 {
            return Err(wrong("episodes", "must be at least 1".to_owned()));
        }
        if successes > episodes {
            return Err(wrong("successes", format!("are {successes} of {episodes} episodes, must be at most as many")));
        }
        if !mean_steps.is_finite() || mean_steps < 0.0 {
            return Err(wrong("mean_steps", format!("is {mean_steps}, must be 0 (not known) or more")));
        }
        if read.iter().any(|before| before.seed == seed) {
            return Err(wrong("seed", format!("{seed} is duplicated; name each seed once")));
        }
        total =
            total.checked_add(episodes).ok_or_else(|| wrong("episodes", "exceed 4294967295 in total".to_owned()))?;
        read.push(SeedResult { seed, episodes, successes, mean_steps });
    }
    Ok(read)
}

/// The results of one seed.
pub fn seed_to_proto(result: SeedResult) -> v1::SeedResult {
    let SeedResult { seed, episodes, successes, mean_steps } = result;
    v1::SeedResult { seed, episodes, successes, mean_steps }
}

/// An evaluation.
pub fn evaluation(evaluation: Evaluation) -> v1::Evaluation {
    let Success { episodes, successes, rate, interval: (low, high) } = evaluation.success();
    let Evaluation { id, policy_id, job_id, simulation, seeds, created_at } = evaluation;
    v1::Evaluation {
        id: id.into(),
        policy_id: policy_id.into(),
        job_id: job_id.map(String::from).unwrap_or_default(),
        simulation,
        seeds: seeds.into_iter().map(seed_to_proto).collect(),
        episodes,
        successes,
        success_rate: rate,
        low,
        high,
        create_time: Some(field::timestamp(created_at)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_inconsistent_report_is_rejected_by_field() {
        let seed = v1::SeedResult { seed: 1, episodes: 10, successes: 7, mean_steps: 0.0 };
        let good = v1::ReportEvaluationRequest {
            policy_id: PolicyId::new().into(),
            simulation: "metaworld/pick-place-v3".into(),
            seeds: vec![seed],
        };
        assert_eq!(report_request(good.clone()).unwrap().2.len(), 1);
        let with = |seeds: Vec<v1::SeedResult>| v1::ReportEvaluationRequest { seeds, ..good.clone() };
        for (wrong, field) in [
            (v1::ReportEvaluationRequest { policy_id: "pol_7".into(), ..good.clone() }, "policy_id: "),
            (v1::ReportEvaluationRequest { simulation: String::new(), ..good.clone() }, "simulation: "),
            (v1::ReportEvaluationRequest { simulation: "x".repeat(201), ..good.clone() }, "simulation: "),
            (with(vec![]), "seeds: "),
            (with(vec![v1::SeedResult { episodes: 0, successes: 0, ..seed }]), "seeds[0].episodes: "),
            (with(vec![seed, v1::SeedResult { seed: 2, successes: 11, ..seed }]), "seeds[1].successes: "),
            (with(vec![seed, seed]), "seeds[1].seed: "),
            (with(vec![v1::SeedResult { mean_steps: f64::NAN, ..seed }]), "seeds[0].mean_steps: "),
            (
                with(vec![v1::SeedResult { episodes: u32::MAX, ..seed }, v1::SeedResult { seed: 2, ..seed }]),
                "seeds[1].episodes: ",
            ),
        ] {
            let error = report_request(wrong).unwrap_err();
            assert!(error.message().starts_with(field), "{field} expected: {error}");
        }
    }
}
