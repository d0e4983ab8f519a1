//! Limits: the choice of a snapshot's episodes when its rule limits their number.

use std::collections::{BTreeMap, HashSet, VecDeque};

use super::{
    id::EpisodeId,
    snapshot::{Role, RoleRule},
};

/// An episode that a rule gives a role.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Member {
    /// The episode.
    pub episode_id: EpisodeId,
    /// BLAKE3 of its recording, in hex: the same on every server.
    pub recording: String,
    /// Its cohort.
    pub cohort: String,
    /// Its role.
    pub role: Role,
}

/// The members within the rule's limits, in their original order.
///
/// Each role's episodes have one fixed sequence: round-robin over the cohorts by name, and within a cohort in the order
/// of a hash of (seed, recording). A limit keeps the start of that sequence. So cohorts are evenly represented, a
/// smaller limit selects a subset of a larger one, and the same recordings give the same choice on every server.
pub fn limited(members: Vec<Member>, rule: &RoleRule) -> Vec<Member> {
    let experts = sequence(&members, Role::Expert, rule.seed);
    let experts = first(&experts, usize::try_from(rule.max_experts).unwrap_or(usize::MAX));
    let imperfect = sequence(&members, Role::Imperfect, rule.seed);
    let imperfect = if rule.imperfect_per_expert > 0.0 {
        first_at_most(&imperfect, most(rule.imperfect_per_expert, experts.len()))
    } else {
        &imperfect[..]
    };
    let taken: HashSet<EpisodeId> = experts.iter().chain(imperfect).map(|&id| id.clone()).collect();
    members.into_iter().filter(|member| taken.contains(&member.episode_id)).collect()
}

/// ⌊ratio · experts⌋, corrected for the rounding of the product: 0.29 of 100 is 29.
#[expect(clippy::cast_precision_loss, reason = "far fewer than 2^52 episodes")]
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a float cast saturates; it is above 0")]
fn most(ratio: f64, experts: usize) -> usize {
    (ratio * experts as f64 * (1.0 + 1e-12)).floor() as usize
}

fn first_at_most<'a, 'b>(sequence: &'b [&'a EpisodeId], count: usize) -> &'b [&'a EpisodeId] {
    &sequence[..count.min(sequence.len())]
}

/// Like [`first_at_most`]; a count of 0 keeps all.
fn first<'a, 'b>(sequence: &'b [&'a EpisodeId], count: usize) -> &'b [&'a EpisodeId] {
    if count == 0 { sequence } else { first_at_most(sequence, count) }
}

fn sequence(members: &[Member], role: Role, seed: u64) -> Vec<&EpisodeId> {
    let mut cohorts: BTreeMap<&str, Vec<&Member>> = BTreeMap::new();
    for member in members.iter().filter(|member| member.role == role) {
        cohorts.entry(&member.cohort).or_default().push(member);
    }
    let mut waiting: VecDeque<VecDeque<&EpisodeId>> = cohorts
        .into_values()
        .map(|mut members| {
            members.sort_by_cached_key(|member| *lot(seed, &member.recording).as_bytes());
            members.into_iter().map(|member| &member.episode_id).collect()
        })
        .collect();
    let mut sequence = Vec::new();
    while let Some(mut cohort) = waiting.pop_front() {
        if let Some(episode) = cohort.pop_front() {
            sequence.push(episode);
            waiting.push_back(cohort);
        }
    }
    sequence
}

fn lot(seed: u64, recording: &str) -> blake3::Hash {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&seed.to_le_bytes()).update(recording.as_bytes());
    hasher.finalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn members() -> Vec<Member> {
        let of = |cohort: &str, role, count| {
            (0..count)
                .map(|i| Member {
                    episode_id: EpisodeId::new(),
                    recording: format!("{cohort} {i}"),
                    cohort: cohort.into(),
                    role,
                })
                .collect::<Vec<_>>()
        };
        [
            of("expert", Role::Expert, 5),
            of("weak", Role::Imperfect, 9),
            of("middling", Role::Imperfect, 9),
            of("rare", Role::Imperfect, 1),
        ]
        .concat()
    }

    fn taken(members: &[Member], rule: &RoleRule, role: Role) -> Vec<Member> {
        limited(members.to_vec(), rule).into_iter().filter(|member| member.role == role).collect()
    }

    #[test]
    fn samples_do_not_depend_on_ids() {
        let rule = RoleRule { max_experts: 3, imperfect_per_expert: 2.0, ..RoleRule::default() };
        let recordings = || {
            let mut taken: Vec<_> = limited(members(), &rule).into_iter().map(|member| member.recording).collect();
            taken.sort();
            taken
        };
        // The episode ids differ between calls.
        assert_eq!(recordings(), recordings());
        assert_eq!(recordings().len(), 9);
    }

    #[test]
    fn zero_limits_select_all_in_order() {
        let members = members();
        assert_eq!(limited(members.clone(), &RoleRule::default()), members);
    }

    #[test]
    fn limits_nest_and_take_cohorts_evenly() {
        let members = members();
        let mut before: Vec<Member> = Vec::new();
        for ratio in [0.6, 1.0, 1.4, 3.0, 100.0] {
            let rule = RoleRule { imperfect_per_expert: ratio, seed: 3, ..RoleRule::default() };
            let now = taken(&members, &rule, Role::Imperfect);
            assert_eq!(now.len(), most(ratio, 5).min(19));
            assert!(before.iter().all(|member| now.contains(member)), "a smaller ratio is a subset");
            let count = |cohort: &str| now.iter().filter(|member| member.cohort == cohort).count();
            assert!(count("weak").abs_diff(count("middling")) <= 1, "{ratio}");
            before = now;
        }
        let few = RoleRule { max_experts: 2, imperfect_per_expert: 3.0, ..RoleRule::default() };
        let more = RoleRule { max_experts: 3, ..few.clone() };
        assert_eq!((taken(&members, &few, Role::Expert).len(), taken(&members, &few, Role::Imperfect).len()), (2, 6));
        for role in [Role::Expert, Role::Imperfect] {
            let more = taken(&members, &more, role);
            assert!(taken(&members, &few, role).iter().all(|member| more.contains(member)));
        }
    }

    #[test]
    fn another_seed_selects_others() {
        let members = members();
        let of = |seed| {
            taken(&members, &RoleRule { imperfect_per_expert: 1.0, seed, ..RoleRule::default() }, Role::Imperfect)
        };
        assert_eq!(of(1), of(1));
        assert!((2..6).any(|seed| of(seed) != of(1)));
    }

    #[test]
    fn ratios_are_not_cut_by_rounding() {
        assert_eq!((most(0.29, 100), most(0.1, 30), most(0.5, 3), most(3.0, 7)), (29, 3, 1, 21));
    }
}
