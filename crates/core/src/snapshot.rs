//! Snapshots: the episodes of a job, and their roles.

use super::{
    episode::Outcome,
    id::{EpisodeId, SnapshotId, TaskId},
    time::Millis,
};

/// The role of an episode in a snapshot: D_e or D_i of the paper.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// In D_e.
    Expert,
    /// In D_i.
    Imperfect,
}

impl Role {
    /// The word stored in rows.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Expert => "expert",
            Self::Imperfect => "imperfect",
        }
    }

    /// Reads the word stored in rows.
    pub fn from_word(word: &str) -> Option<Self> {
        [Self::Expert, Self::Imperfect].into_iter().find(|role| role.as_str() == word)
    }
}

/// The rule of which episodes are experts and which imperfect. Without expert cohorts every success is an expert, and
/// without imperfect cohorts every failure is imperfect, whatever their own cohort. Of the others those of a named cohort
/// have its role, whatever their outcome, and the rest is left out. The limits then reduce the number of each role; see
/// `limit`.
#[derive(Debug, Clone, Default, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default)]
pub struct RoleRule {
    /// Cohorts whose episodes are experts.
    pub expert_cohorts: Vec<String>,
    /// Cohorts whose episodes are imperfect.
    pub imperfect_cohorts: Vec<String>,
    /// Most imperfect episodes for each expert; 0 takes all.
    pub imperfect_per_expert: f64,
    /// Most experts; 0 takes all.
    pub max_experts: u32,
    /// Seed of the choice that the limits make.
    pub seed: u64,
}

impl RoleRule {
    /// The role of an episode with this label; `None`: it is left out.
    pub fn role(&self, outcome: Outcome, cohort: &str) -> Option<Role> {
        let named = |cohorts: &[String]| cohorts.iter().any(|name| name == cohort);
        let by_outcome = match outcome {
            Outcome::Success => self.expert_cohorts.is_empty().then_some(Role::Expert),
            Outcome::Failure => self.imperfect_cohorts.is_empty().then_some(Role::Imperfect),
            Outcome::Unknown => None,
        };
        let expert = named(&self.expert_cohorts).then_some(Role::Expert);
        by_outcome.or(expert).or_else(|| named(&self.imperfect_cohorts).then_some(Role::Imperfect))
    }

    /// Whether a cohort decides a role.
    pub fn by_cohort(&self) -> bool {
        !self.expert_cohorts.is_empty() || !self.imperfect_cohorts.is_empty()
    }

    /// A cohort that is on both sides, if any: such a rule has no meaning.
    pub fn contradiction(&self) -> Option<&str> {
        self.expert_cohorts.iter().find(|name| self.imperfect_cohorts.contains(name)).map(String::as_str)
    }
}

/// An immutable list of episodes with labels and roles.
#[derive(Debug, Clone)]
pub struct Snapshot {
    /// Its id.
    pub id: SnapshotId,
    /// The task its episodes attempt.
    pub task_id: TaskId,
    /// The rule that gave the roles.
    pub rule: RoleRule,
    /// Number of experts.
    pub expert_episodes: u64,
    /// Number of imperfect episodes.
    pub imperfect_episodes: u64,
    /// When it was frozen.
    pub created_at: Millis,
}

/// One episode as frozen in a snapshot.
#[derive(Debug, Clone)]
pub struct SnapshotEpisode {
    /// The episode.
    pub episode_id: EpisodeId,
    /// Its outcome when the snapshot was frozen.
    pub outcome: Outcome,
    /// Its cohort at that time.
    pub cohort: String,
    /// Its role in the snapshot.
    pub role: Role,
    /// T, its number of steps.
    pub steps: u64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outcome_decides_unless_cohorts_are_named() {
        let by_outcome = RoleRule::default();
        assert_eq!(by_outcome.role(Outcome::Success, "any"), Some(Role::Expert));
        assert_eq!(by_outcome.role(Outcome::Failure, "any"), Some(Role::Imperfect));
        assert_eq!(by_outcome.role(Outcome::Unknown, "any"), None);

        let by_cohort = RoleRule {
            expert_cohorts: vec!["alice".into()],
            imperfect_cohorts: vec!["bob".into()],
            ..RoleRule::default()
        };
        assert_eq!(by_cohort.role(Outcome::Success, "bob"), Some(Role::Imperfect));
        assert_eq!(by_cohort.role(Outcome::Unknown, "alice"), Some(Role::Expert));
        assert_eq!(by_cohort.role(Outcome::Success, "carol"), None);
        assert_eq!(by_cohort.contradiction(), None);

        // A side without cohorts is by outcome, also of episodes whose cohort is named on the other side.
        let failures = RoleRule { expert_cohorts: Vec::new(), ..by_cohort.clone() };
        assert_eq!(["", "bob"].map(|cohort| failures.role(Outcome::Success, cohort)), [Some(Role::Expert); 2]);
        assert_eq!(failures.role(Outcome::Failure, "bob"), Some(Role::Imperfect));
        assert_eq!(failures.role(Outcome::Failure, "carol"), None);
        assert_eq!(failures.role(Outcome::Unknown, ""), None);
        let experts = RoleRule { imperfect_cohorts: Vec::new(), ..by_cohort };
        assert_eq!(["alice", "carol"].map(|of| experts.role(Outcome::Failure, of)), [Some(Role::Imperfect); 2]);
        assert_eq!(experts.role(Outcome::Success, "carol"), None);
    }

    #[test]
    fn a_rule_stored_before_limits_is_read() {
        let rule = serde_json::from_str::<RoleRule>(r#"{"expert_cohorts":["a"],"imperfect_cohorts":["b"]}"#);
        let expected =
            RoleRule { expert_cohorts: vec!["a".into()], imperfect_cohorts: vec!["b".into()], ..RoleRule::default() };
        assert_eq!(rule.ok(), Some(expected));
    }
}
