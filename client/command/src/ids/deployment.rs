//! Policies by the name of a deployment: that of the policy which it serves now.
//!
//! Pure functions on listings.

use std::collections::BTreeSet;

use gleaner_proto::v1::Deployment;

use super::Kind;
use super::choice::{Entry, SHOWN, choose};

/// What a text names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Named {
    pub(super) policy: String,
    /// The deployment that serves it, if that was named.
    pub(super) deployment: Option<String>,
}

/// The note that names the deployment.
pub(super) fn note(Named { policy, deployment }: &Named) -> Option<String> {
    Some(format!("policy {policy} (that {} serves now)", deployment.as_ref()?))
}

/// The policy that a text names: by the name of a deployment, by the beginning of its id, or by what is before the `@` of
/// a deployment's name. `None` for the beginning of an id that no policy has, which the server rejects.
///
/// # Errors
/// Several policies; a text that names none. `limits`: whether the command has `--task`.
pub(super) fn policy(
    text: &str,
    policies: &[Entry],
    deployments: &[Deployment],
    limits: bool,
) -> Result<Option<Named>, String> {
    let served = |deployment: &Deployment| Named {
        policy: deployment.policy_id.clone(),
        deployment: Some(deployment.name.clone()),
    };
    if let Some(deployment) = deployments.iter().find(|deployment| deployment.name == text) {
        return Ok(Some(served(deployment)));
    }
    let is_id = text.starts_with(Kind::Policy.prefix());
    if is_id && let Some(policy) = choose(Kind::Policy, text, policies, limits)? {
        return Ok(Some(Named { policy, deployment: None }));
    }
    let before = |name: &str| name.split_once('@').is_some_and(|(begin, _)| begin == text);
    let named: Vec<&Deployment> = deployments.iter().filter(|deployment| before(&deployment.name)).collect();
    let policies: BTreeSet<&str> = named.iter().map(|deployment| deployment.policy_id.as_str()).collect();
    match (named.as_slice(), policies.len()) {
        ([], _) if is_id => Ok(None),
        ([], _) => Err(format!(
            "{text}: no policy has this id and no deployment this name; `gleaner policies` and `gleaner deployments` list \
             them"
        )),
        ([one, ..], 1) => Ok(Some(served(one))),
        (many, count) => {
            let shown = |deployment: &&Deployment| format!("{} serves {}", deployment.name, deployment.policy_id);
            let listed: Vec<String> = many.iter().take(SHOWN).map(shown).collect();
            let more = if many.len() > SHOWN { ", …" } else { "" };
            Err(format!(
                "{text}: deployments of this name serve {count} policies ({}{more}); give the whole name of a deployment",
                listed.join(", ")
            ))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn deployments() -> Vec<Deployment> {
        let deployment = |name: &str, policy: &str| Deployment {
            name: name.into(),
            policy_id: policy.into(),
            ..Deployment::default()
        };
        vec![
            deployment("lift@prod", "pol_01A"),
            deployment("can@prod", "pol_01B"),
            deployment("can@test", "pol_02"),
            deployment("pick@a", "pol_02"),
            deployment("pick@b", "pol_02"),
            deployment("robot", "pol_01A"),
            deployment("pol_x@prod", "pol_02"),
        ]
    }

    fn named(text: &str) -> Result<Option<Named>, String> {
        let entry = |id: &str| Entry { id: id.into(), task: None };
        policy(text, &["pol_01A", "pol_01B", "pol_02"].map(entry), &deployments(), false)
    }

    fn served(policy: &str, deployment: &str) -> Result<Option<Named>, String> {
        Ok(Some(Named { policy: policy.into(), deployment: Some(deployment.into()) }))
    }

    #[test]
    fn a_deployment_names_the_policy_that_it_serves() {
        assert_eq!(named("can@test"), served("pol_02", "can@test"));
        assert_eq!(named("robot"), served("pol_01A", "robot"));
        assert_eq!(named("lift"), served("pol_01A", "lift@prod"), "without its stage");
        assert_eq!(named("pick"), served("pol_02", "pick@a"), "both serve one policy");
        assert_eq!(named("pol_x"), served("pol_02", "pol_x@prod"));
        let note = |text| note(&named(text).unwrap().unwrap());
        assert_eq!(note("lift"), Some("policy pol_01A (that lift@prod serves now)".into()));
        assert_eq!(note("pol_02"), None);
    }

    #[test]
    fn ids_are_still_given_by_their_beginning() {
        let id = |policy: &str| Ok(Some(Named { policy: policy.into(), deployment: None }));
        assert_eq!(named("pol_02"), id("pol_02"));
        assert_eq!(named("pol_9"), Ok(None));
        assert!(named("pol_01").unwrap_err().contains("2 ids begin so (pol_01A, pol_01B)"));
    }

    #[test]
    fn an_ambiguous_or_unknown_name_is_refused() {
        let several = named("can").unwrap_err();
        assert!(several.contains("serve 2 policies (can@prod serves pol_01B, can@test serves pol_02)"), "{several}");
        for text in ["can@", "lif", "other@prod"] {
            assert!(named(text).unwrap_err().contains("no deployment this name"), "{text}");
        }
    }
}
