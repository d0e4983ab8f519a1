//! Actions: which candidates are the commands of the task, and the reasons for the roles of all.
//!
//! Works on candidates alone.

use super::candidate::Candidate;
use super::tokens::Command;

/// The rule by which a candidate is a command.
pub(super) struct Actions<'a> {
    /// The topics that the caller named; empty: candidates are judged by their own words.
    pub(super) named: &'a [String],
    /// The least certain command that is an action, if the caller named none.
    pub(super) least: Command,
}

impl Actions<'_> {
    /// Whether a candidate is a command.
    pub(super) fn has(&self, candidate: &Candidate) -> bool {
        match self.named {
            [] => self.least > Command::No && candidate.command >= self.least,
            named => named.contains(&candidate.topic),
        }
    }

    /// Why a candidate is an action or proprioception.
    pub(super) fn reason(&self, candidate: &Candidate) -> String {
        let Candidate { beside, alongside, .. } = candidate;
        let named = !self.named.is_empty();
        if self.has(candidate) {
            return match (beside, alongside) {
                _ if named => "An action, because `--action` names its topic.".to_owned(),
                (Some(command), _) => format!("An action, because {command} of the same topic is one."),
                (None, Some(likeness)) => format!(
                    "An action, because it is on or off and {likeness}. If a sensor sends it, make it \
                     [[proprioception]], without limits and `binary`."
                ),
                (None, None) if candidate.sent => format!(
                    "An action, because no topic is named like commands, and {} is sent to robots as a rule. If it is \
                     measured, draft with --action TOPIC.",
                    candidate.schema
                ),
                (None, None) => "An action, by its name or its topic.".to_owned(),
            };
        }
        match candidate.meaning() {
            Some(meaning) => format!("Proprioception, because it is named like {meaning}."),
            None => "Proprioception, because it is not named like a command; remove it if a robot cannot send it."
                .to_owned(),
        }
    }
}

/// The least certain command that is an action: every way has commands that are as certain.
pub(super) fn certain(candidates: &[Vec<Candidate>]) -> Command {
    // A way without a certain command has its commands by weaker words.
    let strongest = |of_way: &Vec<Candidate>| of_way.iter().map(|candidate| candidate.command).max();
    candidates.iter().filter_map(strongest).min().unwrap_or(Command::No)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn candidate(topic: &str, path: &str, command: Command) -> Candidate {
        let (name, topic, path) = (path.to_owned(), topic.to_owned(), path.to_owned());
        Candidate {
            name,
            topic,
            schema: String::new(),
            path,
            stamped: false,
            command,
            rate_hz: 0.0,
            beside: None,
            alongside: None,
            sent: false,
            open: false,
            orders: Vec::new(),
            values: Vec::new(),
        }
    }

    #[test]
    fn reason_is_that_of_the_caller_where_topics_are_named() {
        let named = ["/teleop".to_owned()];
        let actions = Actions { named: &named, least: Command::Yes };
        let of = |topic, path, command| actions.reason(&candidate(topic, path, command));
        assert_eq!(of("/teleop", "target", Command::Yes), "An action, because `--action` names its topic.");
        assert_eq!(of("/teleop", "x", Command::No), "An action, because `--action` names its topic.");
        assert_eq!(
            of("/state", "joint_position", Command::No),
            "Proprioception, because it is named like joint positions."
        );
        let guessed = Actions { named: &[], least: Command::Yes };
        let action = guessed.reason(&candidate("/cmd", "target", Command::Yes));
        assert_eq!(action, "An action, by its name or its topic.");
    }
}
