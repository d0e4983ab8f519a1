//! A task's score runs; one run, and what any threshold would keep of it; datasets made from there.

mod contact;
mod kept;
mod list;
mod make;
mod picture;
mod query;
mod run;

pub(super) use self::{
    kept::{cohort_sheet, cohorts, figures},
    list::show as list,
    make::make,
    run::{show, what_if},
};

#[cfg(test)]
mod tests;
