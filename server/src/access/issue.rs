//! New tokens: 256 random bits after a prefix that people and secret scanners recognise. Must not depend on commands.

use super::secret;
use crate::{
    config::{NewTokenConfig, Secret},
    domain::{
        access::{Role, Token},
        id::TokenId,
        time::Millis,
    },
    error::{Error, Result},
    wire::{field, policy::deployment_name},
};

const PREFIX: &str = "gleaner_";

/// A new token.
pub(super) struct IssuedToken {
    /// The secret, to be shown once.
    pub(super) secret: Secret,
    /// The hash that the token is found by.
    pub(super) hash: String,
    /// The row to store.
    pub(super) token: Token,
}

/// Issues a token.
///
/// # Errors
/// Invalid, naming the flag.
pub(super) fn issue(config: NewTokenConfig) -> Result<IssuedToken> {
    let NewTokenConfig { role, name, deployments, expires } = config;
    match (role, deployments.is_empty()) {
        (Role::Robot, true) => {
            return Err(Error::invalid("--deployment", "a robot needs at least one, for example pick_cube@prod"));
        }
        (Role::Viewer | Role::Contributor | Role::Trainer | Role::Admin, false) => {
            return Err(Error::invalid("--deployment", "only a robot is bound to deployments; use --role robot"));
        }
        (Role::Robot, false) | (Role::Viewer | Role::Contributor | Role::Trainer | Role::Admin, true) => {}
    }
    let deployments =
        deployments.into_iter().map(|name| deployment_name("--deployment", name)).collect::<Result<Vec<_>>>()?;
    let now = Millis::now();
    let expires_at = expires.map(|text| super::span::span(&text).map(|span| now.after(span))).transpose();
    let bits: [u8; 32] = rand::random();
    let secret = format!("{PREFIX}{}", blake3::Hash::from_bytes(bits).to_hex());
    Ok(IssuedToken {
        hash: secret::hash(&secret),
        secret: Secret::from(secret),
        token: Token {
            id: TokenId::new(),
            name: field::tag("--name", name)?,
            role,
            deployments,
            created_at: now,
            expires_at: expires_at.map_err(|problem| Error::invalid("--expires", problem))?,
            revoked_at: None,
            last_used_at: None,
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn new(role: Role, deployments: &[&str], expires: Option<&str>) -> Result<IssuedToken> {
        let deployments = deployments.iter().map(|&name| name.to_owned()).collect();
        issue(NewTokenConfig { role, name: "arm".into(), deployments, expires: expires.map(str::to_owned) })
    }

    #[test]
    fn tokens_are_long_and_distinct_and_stored_as_hashes() {
        let (one, other) = (new(Role::Admin, &[], None).unwrap(), new(Role::Admin, &[], None).unwrap());
        assert_ne!(one.hash, other.hash);
        assert_eq!(one.secret.reveal().len(), PREFIX.len() + 64);
        assert_eq!(secret::hash(one.secret.reveal()), one.hash);
        assert!(!one.secret.reveal().contains(&one.hash), "the hash does not reveal the token");
        assert_eq!(one.token.expires_at, None);
    }

    #[test]
    fn only_a_robot_has_deployments() {
        let robot = new(Role::Robot, &["arm@prod", "arm@test"], Some("30d")).unwrap().token;
        assert_eq!(robot.deployments, ["arm@prod", "arm@test"]);
        assert_eq!(robot.expires_at.unwrap().0 - robot.created_at.0, 30 * 86_400_000);
        for (role, deployments) in [
            (Role::Robot, vec![]),
            (Role::Viewer, vec!["arm@prod"]),
            (Role::Robot, vec!["../arm"]),
            (Role::Robot, vec![""]),
        ] {
            let problem = new(role, &deployments, None).err().unwrap();
            assert!(problem.message().starts_with("--deployment: "), "{problem}");
        }
        let problem = new(Role::Viewer, &[], Some("never")).err().unwrap();
        assert!(problem.message().starts_with("--expires: "), "{problem}");
    }
}
