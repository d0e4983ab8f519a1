//! Snapshots on the wire.

use gleaner_proto::v1;

use super::{episode, field, page};
use crate::{
    error::{Error, Result},
    id::SnapshotId,
    page::Page,
    snapshot::{Role, RoleRule, Snapshot, SnapshotEpisode},
};

/// Reads a snapshot's id.
pub fn snapshot_id(text: &str) -> Result<SnapshotId> {
    SnapshotId::parse("snapshot_id", text)
}

/// The task's name or id, and the rule.
///
/// # Errors
/// Invalid when a cohort is on both sides of the rule.
pub fn create_request(request: v1::CreateSnapshotRequest) -> Result<(String, RoleRule)> {
    let v1::CreateSnapshotRequest { task, rule } = request;
    Ok((field::text("task", task)?, rule_from_proto("rule", rule)?))
}

/// The task's name or id, and the page of its snapshots.
///
/// # Errors
/// Invalid names the field.
pub fn list_request(request: v1::ListSnapshotsRequest) -> Result<(String, Page<SnapshotId>)> {
    let v1::ListSnapshotsRequest { task, page_size, page_token } = request;
    Ok((task, page::page_by_id(page_size, &page_token)?))
}

/// The snapshot, the place of the last episode of the page before, and the size of a page of its episodes. A page token is
/// that place.
///
/// # Errors
/// Invalid when the id or the token is malformed, or the page is too large.
pub fn episodes_request(request: v1::ListSnapshotEpisodesRequest) -> Result<(SnapshotId, Option<u32>, u32)> {
    let v1::ListSnapshotEpisodesRequest { snapshot_id: id, page_size, page_token } = request;
    let behind = match page_token.as_str() {
        "" => None,
        token => Some(token.parse().map_err(|_| field::foreign_page_token())?),
    };
    Ok((snapshot_id(&id)?, behind, field::page_size(page_size)?))
}

/// Most cohorts on one side of a rule.
const MAX_COHORTS: usize = 1000;

/// Reads a rule; a missing one is the default rule: success is expert, failure imperfect.
///
/// # Errors
/// Invalid when a cohort is on both sides or is not a tag, when there are too many cohorts, or a limit is negative or
/// not a number.
pub fn rule_from_proto(at: &str, rule: Option<v1::RoleRule>) -> Result<RoleRule> {
    let v1::RoleRule { expert_cohorts, imperfect_cohorts, imperfect_per_expert, max_experts, seed } =
        rule.unwrap_or_default();
    if !imperfect_per_expert.is_finite() || imperfect_per_expert < 0.0 {
        return Err(Error::invalid(
            &format!("{at}.imperfect_per_expert"),
            format!("is {imperfect_per_expert}, must be above 0, such as 1 or 3, or 0 for all of them"),
        ));
    }
    let expert_cohorts = cohorts(&format!("{at}.expert_cohorts"), expert_cohorts)?;
    let imperfect_cohorts = cohorts(&format!("{at}.imperfect_cohorts"), imperfect_cohorts)?;
    let rule = RoleRule { expert_cohorts, imperfect_cohorts, imperfect_per_expert, max_experts, seed };
    match rule.contradiction() {
        Some(cohort) => {
            Err(Error::invalid(at, format!("the cohort {cohort:?} is both expert and imperfect; leave it on one side")))
        }
        None => Ok(rule),
    }
}

fn cohorts(at: &str, named: Vec<String>) -> Result<Vec<String>> {
    if named.len() > MAX_COHORTS {
        return Err(Error::invalid(at, format!("are {}, must be at most {MAX_COHORTS}", named.len())));
    }
    named.into_iter().enumerate().map(|(place, cohort)| field::tag(&format!("{at}[{place}]"), cohort)).collect()
}

/// A rule.
pub fn rule_to_proto(rule: RoleRule) -> v1::RoleRule {
    let RoleRule { expert_cohorts, imperfect_cohorts, imperfect_per_expert, max_experts, seed } = rule;
    v1::RoleRule { expert_cohorts, imperfect_cohorts, imperfect_per_expert, max_experts, seed }
}

/// A role.
pub fn role_to_proto(role: Role) -> v1::Role {
    match role {
        Role::Expert => v1::Role::Expert,
        Role::Imperfect => v1::Role::Imperfect,
    }
}

/// Reads a role.
pub fn role_from_proto(at: &str, role: i32) -> Result<Role> {
    match v1::Role::try_from(role) {
        Ok(v1::Role::Expert) => Ok(Role::Expert),
        Ok(v1::Role::Imperfect) => Ok(Role::Imperfect),
        Ok(v1::Role::Unspecified) | Err(_) => Err(Error::invalid(at, "must be expert or imperfect")),
    }
}

/// A snapshot.
pub fn snapshot(snapshot: Snapshot) -> v1::Snapshot {
    let Snapshot { id, task_id, rule, expert_episodes, imperfect_episodes, created_at } = snapshot;
    v1::Snapshot {
        id: id.into(),
        task_id: task_id.into(),
        rule: Some(rule_to_proto(rule)),
        expert_episodes,
        imperfect_episodes,
        create_time: Some(field::timestamp(created_at)),
    }
}

/// An episode as frozen in a snapshot.
pub fn snapshot_episode(member: SnapshotEpisode) -> v1::SnapshotEpisode {
    let SnapshotEpisode { episode_id, outcome, cohort, role, steps } = member;
    v1::SnapshotEpisode {
        episode_id: episode_id.into(),
        outcome: episode::outcome_to_proto(outcome).into(),
        cohort,
        role: role_to_proto(role).into(),
        steps,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cohort_has_one_side() {
        let both = v1::RoleRule {
            expert_cohorts: vec!["ada".into()],
            imperfect_cohorts: vec!["ada".into()],
            ..v1::RoleRule::default()
        };
        let error = rule_from_proto("plan.rule", Some(both)).unwrap_err();
        assert!(error.message().starts_with("plan.rule: ") && error.message().contains("\"ada\""), "{error}");
        assert_eq!(rule_from_proto("rule", None).unwrap(), RoleRule::default());
        let fine = RoleRule {
            expert_cohorts: vec!["ada".into()],
            imperfect_cohorts: vec!["bob".into()],
            imperfect_per_expert: 1.5,
            max_experts: 7,
            seed: 3,
        };
        assert_eq!(rule_from_proto("rule", Some(rule_to_proto(fine.clone()))).unwrap(), fine);
    }

    #[test]
    fn a_malformed_page_of_episodes_is_rejected() {
        let id = SnapshotId::new();
        let request = |token: &str, page_size| v1::ListSnapshotEpisodesRequest {
            snapshot_id: id.to_string(),
            page_token: token.into(),
            page_size,
        };
        assert_eq!(episodes_request(request("", 0)).unwrap(), (id.clone(), None, 100));
        assert_eq!(episodes_request(request("17", 5)).unwrap(), (id.clone(), Some(17), 5));
        for (token, size, field) in [("-1", 5, "page_token: "), ("1.5", 5, "page_token: "), ("", 1001, "page_size: ")] {
            let error = episodes_request(request(token, size)).unwrap_err();
            assert!(error.message().starts_with(field), "{error}");
        }
    }

    #[test]
    fn cohorts_are_limited_in_number_and_characters() {
        let refusal = |rule| rule_from_proto("rule", Some(rule)).unwrap_err().message().to_owned();
        let strange = v1::RoleRule { imperfect_cohorts: vec!["a".into(), "b\n".into()], ..v1::RoleRule::default() };
        assert!(refusal(strange).starts_with("rule.imperfect_cohorts[1]: "));
        let many = v1::RoleRule { expert_cohorts: vec!["a".into(); 1001], ..v1::RoleRule::default() };
        assert!(refusal(many).starts_with("rule.expert_cohorts: are 1001"));
    }

    #[test]
    fn invalid_limits_are_rejected() {
        for bad in [-1.0, f64::NAN, f64::INFINITY] {
            let rule = v1::RoleRule { imperfect_per_expert: bad, ..v1::RoleRule::default() };
            let error = rule_from_proto("rule", Some(rule)).unwrap_err();
            assert!(error.message().starts_with("rule.imperfect_per_expert: "), "{error}");
        }
    }
}
