//! Access: roles, stored tokens, and entries of the audit log.
//!
//! Must not depend on rpcs: `access::table` has the role that each one needs.

use super::{id::TokenId, time::Millis};
use crate::error::{Error, Result};

/// The rights of a token. Viewer, contributor, trainer and admin form a ladder, each including the one before; a robot
/// is outside it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Role {
    /// Reads everything.
    Viewer,
    /// Also adds episodes and labels, and requests actions from policies.
    Contributor,
    /// Also runs jobs, makes datasets and moves deployments.
    Trainer,
    /// Requests actions from its own deployments, and nothing else.
    Robot,
    /// Every right.
    Admin,
}

impl Role {
    /// Every role.
    pub const ALL: [Self; 5] = [Self::Viewer, Self::Contributor, Self::Trainer, Self::Robot, Self::Admin];

    /// The word stored for the role.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Viewer => "viewer",
            Self::Contributor => "contributor",
            Self::Trainer => "trainer",
            Self::Robot => "robot",
            Self::Admin => "admin",
        }
    }

    /// The role of a stored word.
    pub fn from_word(word: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|role| role.as_str() == word)
    }

    /// Whether the role includes the rights of `least`. A robot's role includes no other role.
    pub const fn reaches(self, least: Self) -> bool {
        matches!((self.rung(), least.rung()), (Some(own), Some(needed)) if own >= needed)
    }

    const fn rung(self) -> Option<u8> {
        match self {
            Self::Viewer => Some(0),
            Self::Contributor => Some(1),
            Self::Trainer => Some(2),
            Self::Admin => Some(3),
            Self::Robot => None,
        }
    }
}

/// A token as it is stored: every value but the secret itself.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Token {
    /// Its id, which may be shown.
    pub id: TokenId,
    /// Label for people; may be empty.
    pub name: String,
    /// The token's role.
    pub role: Role,
    /// A robot's deployments; empty for other roles.
    pub deployments: Vec<String>,
    /// When it was made.
    pub created_at: Millis,
    /// When the token expires; `None`: never.
    pub expires_at: Option<Millis>,
    /// When it was revoked.
    pub revoked_at: Option<Millis>,
    /// When it was last used, to the minute.
    pub last_used_at: Option<Millis>,
}

impl Token {
    /// Whether the token is valid at this time.
    pub fn is_live(&self, now: Millis) -> bool {
        self.revoked_at.is_none() && self.expires_at.is_none_or(|end| now < end)
    }

    /// The state of the token in words: live, expired or revoked.
    pub fn standing(&self, now: Millis) -> &'static str {
        if self.revoked_at.is_some() {
            "revoked"
        } else if self.is_live(now) {
            "live"
        } else {
            "expired"
        }
    }

    /// Checks that its role is `least` or a higher one.
    ///
    /// # Errors
    /// Forbidden, naming both roles.
    pub fn permit(&self, least: Role) -> Result<()> {
        if self.role.reaches(least) {
            return Ok(());
        }
        let or_higher = if least == Role::Admin { "" } else { " or a higher one" };
        Err(Error::forbidden(format!(
            "this needs the role {}{or_higher}; the token {:?} has the role {}",
            least.as_str(),
            self.label(),
            self.role.as_str()
        )))
    }

    /// Who it is, for people: its name, or its id when it has none.
    pub fn label(&self) -> &str {
        if self.name.is_empty() { self.id.as_str() } else { &self.name }
    }
}

/// A change, or a rejected attempt at one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AuditEntry {
    /// When the response was sent.
    pub at: Millis,
    /// The caller's token, if the call had one.
    pub token_id: Option<TokenId>,
    /// The token's name, or the caller's address.
    pub caller: String,
    /// The caller's address; empty when unknown.
    pub peer: String,
    /// The rpc, as `Service/Method`, or the command.
    pub rpc: String,
    /// The objects of the call, as `field=value`.
    pub subjects: Vec<String>,
    /// `ok`, or the status of the rejection.
    pub outcome: String,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn roles_are_ordered_and_robots_are_separate() {
        let ladder = [Role::Viewer, Role::Contributor, Role::Trainer, Role::Admin];
        for (place, role) in ladder.into_iter().enumerate() {
            for (other, least) in ladder.into_iter().enumerate() {
                assert_eq!(role.reaches(least), place >= other, "{role:?} {least:?}");
            }
            assert!(!Role::Robot.reaches(role) && !role.reaches(Role::Robot));
        }
        assert!(!Role::Robot.reaches(Role::Robot), "the rules of robots are separate");
        for role in Role::ALL {
            assert_eq!(Role::from_word(role.as_str()).unwrap(), role);
        }
        assert_eq!(Role::from_word("root"), None);
    }

    #[test]
    fn a_token_ends_when_it_expires_or_is_revoked() {
        let token = Token {
            id: TokenId::new(),
            name: String::new(),
            role: Role::Viewer,
            deployments: Vec::new(),
            created_at: Millis(0),
            expires_at: Some(Millis(10)),
            revoked_at: None,
            last_used_at: None,
        };
        assert_eq!((token.standing(Millis(9)), token.standing(Millis(10))), ("live", "expired"));
        assert_eq!(token.label(), token.id.as_str());
        let revoked = Token { revoked_at: Some(Millis(5)), name: "arm".into(), ..token };
        assert!(!revoked.is_live(Millis(1)));
        assert_eq!((revoked.standing(Millis(1)), revoked.label()), ("revoked", "arm"));
    }
}
