//! Work of rank 0 alone that may last longer than ranks wait for each other, such as storing a checkpoint on a full disk:
//! signs in between show the others that it is alive.

use std::panic::resume_unwind;
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::thread;
use std::time::Duration;

use gleaner_group::{Group, GroupError};
use tch::{Device, Tensor};

use super::{Peers, device_of};
use crate::batch::values;
use crate::error::LearnError;

/// Well below the shortest time that ranks wait for each other, a second.
const SIGN_EVERY: Duration = Duration::from_millis(250);

impl Peers {
    /// Does `work` at rank 0, for which the others wait as long as it lasts; `None` there. `parameters` are those of the
    /// training.
    ///
    /// # Errors
    /// When a rank is lost. Rank 0 has done its work then too.
    pub(crate) fn lead_alone<'a, T>(
        &mut self,
        parameters: impl Iterator<Item = &'a Tensor>,
        work: impl FnOnce() -> T,
    ) -> Result<Option<T>, LearnError> {
        let (lead, device) = (self.lead(), device_of(parameters));
        let Some(group) = &mut self.0 else { return Ok(Some(work())) };
        if !lead {
            while !sign(group, device, false)? {}
            return Ok(None);
        }
        thread::scope(|scope| {
            let (working, ended) = channel::<()>();
            let signs = scope.spawn(move || {
                while ended.recv_timeout(SIGN_EVERY) == Err(RecvTimeoutError::Timeout) {
                    sign(group, device, false)?;
                }
                sign(group, device, true)
            });
            let made = work();
            drop(working);
            signs.join().unwrap_or_else(|panic| resume_unwind(panic))?;
            Ok(Some(made))
        })
    }
}

/// Whether rank 0 has ended its work, as it states.
fn sign(group: &mut Group, device: Device, over: bool) -> Result<bool, GroupError> {
    let mut over = Tensor::from_slice(&[f32::from(u8::from(over))]).to_device(device);
    group.broadcast(&mut over)?;
    Ok(values(&over).iter().any(|value| *value > 0.0))
}
