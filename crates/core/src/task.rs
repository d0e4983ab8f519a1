//! Tasks: a named skill with its specification.

use crate::TaskSpec;

use super::{id::TaskId, time::Millis};

/// A named robot skill, and how its steps are found in a recording.
#[derive(Debug, Clone)]
pub struct Task {
    /// Its id.
    pub id: TaskId,
    /// The contents of a step, and their location in recordings. Immutable.
    pub spec: TaskSpec,
    /// When it was created.
    pub created_at: Millis,
}

/// Number of a task's episodes by outcome.
#[derive(Debug, Clone, Copy, Default)]
pub struct OutcomeCounts {
    /// Labelled success.
    pub success: u64,
    /// Labelled failure.
    pub failure: u64,
    /// Labelled unknown.
    pub unknown: u64,
}

/// The first part of a specification that a task with episodes cannot change to, by its field, and why. `read` has the
/// mappings by which its episodes were read.
///
/// # Errors
/// The field and the reason.
pub fn check_change(before: &TaskSpec, after: &TaskSpec, read: &[String]) -> Result<(), (String, &'static str)> {
    let (before, after) = (&before.of_steps(), &after.of_steps());
    let differs = [
        ("name", before.name != after.name),
        ("rate_hz", before.rate_hz.to_bits() != after.rate_hz.to_bits()),
        ("cameras", before.cameras != after.cameras),
        ("proprioception", before.proprioception != after.proprioception),
        ("action", before.action != after.action),
        ("alignment", before.alignment != after.alignment),
        ("tolerance", before.tolerance.to_bits() != after.tolerance.to_bits()),
    ];
    if let Some((field, _)) = differs.into_iter().find(|(_, differs)| *differs) {
        return Err((field.to_owned(), "its episodes and results rest on the present value"));
    }
    for mapping in before.mappings.iter().filter(|mapping| read.contains(&mapping.name)) {
        if !after.mappings.contains(mapping) {
            return Err((format!("mappings {}", mapping.name), "episodes were read by it"));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_used_task_can_get_mappings_words_and_units_and_nothing_else() {
        let spec = |text: &str| -> TaskSpec { serde_json::from_str(text).unwrap() };
        let before = spec(
            r#"{"name":"t","rate_hz":5,"action":[{"name":"a","size":3}],
                "mappings":[{"name":"one","fields":[]},{"name":"other","fields":[]}]}"#,
        );
        let read = ["one".to_owned()];
        let mut after = before.clone();
        after.mappings[1].clock = Some("/x".into());
        after.mappings.push(crate::Mapping { name: "third".into(), ..before.mappings[0].clone() });
        assert_eq!(check_change(&before, &after, &read), Ok(()));
        after.mappings.remove(0);
        assert_eq!(check_change(&before, &after, &read).unwrap_err().0, "mappings one");
        let words = TaskSpec {
            instruction: "reach".into(),
            openpi: vec![crate::OpenpiKey { name: "a".into(), key: "b".into() }],
            ..before.clone()
        };
        assert_eq!(check_change(&before, &words, &read), Ok(()));
        let field = |size, unit: &str| crate::FieldSpec { unit: unit.into(), ..crate::FieldSpec::new("a", size) };
        let measured = TaskSpec { action: vec![field(3, "rad")], ..before.clone() };
        assert_eq!(check_change(&before, &measured, &read), Ok(()));
        let longer = TaskSpec { action: vec![field(4, "")], ..before.clone() };
        assert_eq!(check_change(&before, &longer, &read).unwrap_err().0, "action");
        let after = TaskSpec { rate_hz: 10.0, ..before.clone() };
        assert_eq!(check_change(&before, &after, &read).unwrap_err().0, "rate_hz");
    }
}
