//! Jobs: the queue, one job's progress, cancelling and retrying.

mod act;
mod course;
mod curves;
mod job;
mod list;
mod log;
mod spec;

pub(super) use self::{
    act::{cancel, retry},
    course::{show as course, state},
    job::show,
    list::show as list,
    log::show as log,
};
