//! The actions of an answer: their number, length and values.

use gleaner_core::{TaskSpec, remote::RemotePolicy};

/// What an answer must be.
#[derive(Debug, Clone)]
pub(crate) struct Actions {
    pub(crate) output: String,
    width: usize,
    least: usize,
    most: usize,
}

impl Actions {
    pub(crate) fn of(policy: &RemotePolicy, task: &TaskSpec) -> Self {
        let (least, most) = (policy.execute_length.max(1) as usize, policy.chunk_length as usize);
        Self { output: policy.output.clone(), width: task.action_size(), least, most }
    }

    /// The most bytes of an answer in 64-bit numbers, twice over, for names and times beside the actions.
    pub(crate) fn bytes(&self) -> usize {
        2 * 8 * self.width * self.most + (64 << 10)
    }

    /// The values as actions.
    ///
    /// # Errors
    /// What is wrong, to follow the name of the server.
    pub(crate) fn chunk(&self, shape: &[usize], values: &[f32]) -> Result<Vec<Vec<f32>>, String> {
        let (output, width) = (&self.output, self.width);
        let count = match *shape {
            [values] if values == width => 1,
            [actions, values] | [1, actions, values] if values == width => actions,
            _ => {
                let shown = &shape[..shape.len().min(8)];
                return Err(format!("{output} has shape {shown:?}, must be [actions, {width}] for this task"));
            }
        };
        if count < self.least || count > self.most {
            let (least, most) = (self.least, self.most);
            return Err(format!("{output} has {count} actions, the policy is registered with {least} to {most}"));
        }
        if count.checked_mul(width) != Some(values.len()) {
            return Err(format!("{output} has {} values, which shape {shape:?} does not have", values.len()));
        }
        if let Some(index) = values.iter().position(|value| !value.is_finite()) {
            return Err(format!("value {index} of {output} is {}, must be finite", values[index]));
        }
        Ok(values.chunks(width.max(1)).map(<[f32]>::to_vec).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn actions() -> Actions {
        Actions { output: "action".into(), width: 2, least: 2, most: 3 }
    }

    #[test]
    fn actions_of_every_shape_are_read() {
        let values = [1.0, 2.0, 3.0, 4.0];
        let chunk = vec![vec![1.0, 2.0], vec![3.0, 4.0]];
        for shape in [&[2, 2][..], &[1, 2, 2]] {
            assert_eq!(actions().chunk(shape, &values).unwrap(), chunk, "{shape:?}");
        }
        let single = Actions { least: 1, ..actions() };
        assert_eq!(single.chunk(&[2], &values[..2]).unwrap(), chunk[..1]);
    }

    #[test]
    fn other_answers_are_refused() {
        for (shape, values, words) in [
            (&[][..], &[][..], "action has shape []"),
            (&[4], &[0.0; 4], "action has shape [4]"),
            (&[2, 3], &[0.0; 6], "action has shape [2, 3]"),
            (&[2, 2, 2], &[0.0; 8], "action has shape [2, 2, 2]"),
            (&[0, 2], &[], "action has 0 actions"),
            (&[2], &[0.0; 2], "action has 1 actions"),
            (&[4, 2], &[0.0; 8], "action has 4 actions"),
            (&[usize::MAX, 2], &[0.0; 2], "actions, the policy is registered with 2 to 3"),
            (&[2, 2], &[0.0; 3], "action has 3 values"),
            (&[2, 2], &[0.0, f32::NAN, 0.0, 0.0], "value 1 of action is NaN"),
            (&[2, 2], &[0.0, 0.0, 0.0, f32::INFINITY], "value 3 of action is inf"),
        ] {
            let problem = actions().chunk(shape, values).unwrap_err();
            assert!(problem.contains(words), "{words} expected: {problem}");
        }
    }
}
