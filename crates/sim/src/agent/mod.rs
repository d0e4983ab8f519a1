//! The agents of demonstrations: a scripted expert, and imperfect agents with one fault each.
//!
//! Agents read the true state of the world. They do not depend on images or files.

mod drift;
mod expert;
mod fault;

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::error::SimError;

pub(crate) use drift::FalseStart;
pub(crate) use expert::Expert;
pub(crate) use fault::{Fault, Rehearsal};

/// The fault of an agent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AgentKind {
    /// No fault.
    Expert,
    /// Grasps beside the cube and continues without it.
    MissedGrasp,
    /// Opens the gripper during the carry and keeps it open.
    EarlyRelease,
    /// Carries the cube to a place beside the goal.
    WrongGoal,
    /// Slows down or stops.
    Freeze,
    /// Drifts to random points.
    Wander,
    /// Adds white noise to the displacements and rotations.
    Noise,
}

impl AgentKind {
    /// Every kind, the expert first.
    pub const ALL: [Self; 7] =
        [Self::Expert, Self::MissedGrasp, Self::EarlyRelease, Self::WrongGoal, Self::Freeze, Self::Wander, Self::Noise];

    /// The kind's name: also the cohort of its episodes.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Expert => "expert",
            Self::MissedGrasp => "missed_grasp",
            Self::EarlyRelease => "early_release",
            Self::WrongGoal => "wrong_goal",
            Self::Freeze => "freeze",
            Self::Wander => "wander",
            Self::Noise => "noise",
        }
    }
}

impl fmt::Display for AgentKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// The end of the text of an agent with a false start.
const FALSE_START: &str = "+false_start";

/// An agent: its fault, the grade of the fault, and whether it begins with a false start. Written `kind` or `kind:grade`,
/// as in `early_release:0.8`, and with a false start `early_release:0.8+false_start`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AgentSpec {
    kind: AgentKind,
    grade: f64,
    false_start: bool,
}

impl AgentSpec {
    /// The expert.
    pub const EXPERT: Self = Self { kind: AgentKind::Expert, grade: 0.0, false_start: false };

    /// An agent of this kind and grade: 0 equals the expert, 1 fails in nearly every attempt. The expert has grade 0.
    ///
    /// # Errors
    /// [`SimError::Agent`] if the grade is not in [0, 1], or not 0 for the expert.
    pub fn new(kind: AgentKind, grade: f64) -> Result<Self, SimError> {
        let wrong = |detail: &str| Err(SimError::Agent { text: format!("{kind}:{grade}"), detail: detail.to_owned() });
        if kind == AgentKind::Expert && grade != 0.0 {
            return wrong("the expert has no grade; use \"expert\"");
        }
        if !(0.0..=1.0).contains(&grade) {
            return wrong("the grade must lie between 0 and 1");
        }
        Ok(Self { kind, grade, false_start: false })
    }

    /// The same agent, but for its first 8 to 20 steps it moves towards random points before it follows its script.
    #[must_use]
    pub fn with_false_start(self) -> Self {
        Self { false_start: true, ..self }
    }

    /// Whether it begins with a false start.
    #[must_use]
    pub fn false_start(&self) -> bool {
        self.false_start
    }

    /// The fault.
    #[must_use]
    pub fn kind(&self) -> AgentKind {
        self.kind
    }

    /// The grade of the fault, 0 to 1.
    #[must_use]
    pub fn grade(&self) -> f64 {
        self.grade
    }
}

impl fmt::Display for AgentSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.kind {
            AgentKind::Expert => f.write_str(self.kind.name())?,
            AgentKind::MissedGrasp
            | AgentKind::EarlyRelease
            | AgentKind::WrongGoal
            | AgentKind::Freeze
            | AgentKind::Wander
            | AgentKind::Noise => write!(f, "{}:{}", self.kind, self.grade)?,
        }
        f.write_str(if self.false_start { FALSE_START } else { "" })
    }
}

impl FromStr for AgentSpec {
    type Err = SimError;

    /// Parses `kind` or `kind:grade`, either with `+false_start`; the default grade of an imperfect agent is 1.
    fn from_str(text: &str) -> Result<Self, SimError> {
        let wrong = |detail: String| SimError::Agent { text: text.to_owned(), detail };
        let (agent, false_start) = text.strip_suffix(FALSE_START).map_or((text, false), |agent| (agent, true));
        let (name, grade) = match agent.split_once(':') {
            Some((name, grade)) => (name, Some(grade)),
            None => (agent, None),
        };
        let kind = AgentKind::ALL.into_iter().find(|kind| kind.name() == name).ok_or_else(|| {
            let names = AgentKind::ALL.map(AgentKind::name).join(", ");
            wrong(format!("{name:?} is unknown; use one of {names}"))
        })?;
        let grade = match grade {
            Some(grade) => {
                grade.parse().map_err(|_| wrong(format!("grade {grade:?} is not a number; use one between 0 and 1")))?
            }
            None if kind == AgentKind::Expert => 0.0,
            None => 1.0,
        };
        Ok(Self { false_start, ..Self::new(kind, grade)? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agent_parses_as_it_is_written() {
        for text in ["expert", "early_release:0.8", "noise:1", "noise:1+false_start", "expert+false_start"] {
            assert_eq!(text.parse::<AgentSpec>().unwrap().to_string(), text);
        }
        assert_eq!("freeze".parse::<AgentSpec>().unwrap().grade(), 1.0);
    }

    #[test]
    fn error_of_an_invalid_agent_names_the_fix() {
        let error = |text: &str| text.parse::<AgentSpec>().unwrap_err().to_string();
        assert!(error("noise:1+late_start").contains("\"1+late_start\" is not a number"));
        assert!(error("sleep:1").contains("use one of expert, missed_grasp"));
        assert!(error("noise:much").contains("is not a number"));
        assert!(error("noise:1.5").contains("between 0 and 1"));
        assert!(error("noise:NaN").contains("between 0 and 1"));
        assert!(error("expert:0.5").contains("the expert has no grade"));
    }
}
